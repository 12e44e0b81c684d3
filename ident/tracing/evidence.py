"""Priors, and log evidence of a fitted set of effects.

The evidence is the likelihood with all unknowns of the set integrated out.

The noise of each output has two levels, one below a few hertz and one above (``ColouredNoise``).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.fitted_model import FittedModel
from ident.whole_record.coloured_noise import ColouredNoise
from sim.declaration.effect import Parameter, full_name
from sim.declaration.proposal import SearchContext, Traceable

# ---- Priors of derivatives, of parameters of effects, and of sets

DERIVATIVE_PRIOR_SHARE = 0.3  # prior sigma of a derivative, relative to its declared value
FAMILY_ODDS = 0.03  # prior odds of one family of effects against its absence
# least number of members that share a family's odds: a small family is no likelier
FEWEST_FAMILY_MEMBERS = 5
CATCH_ALL_ODDS_RATIO = 0.1  # odds of a catch-all term relative to an effect
COMMON_MOTION_ODDS = 0.5  # prior odds of nuisance dynamics, and of effects with kinematic evidence
ABSENT_LIMIT = 1e5  # smallest value of a limit that never acts
# factor of a wide prior: of a limit about the value found, of a curve's shape
WIDE_PRIOR_FACTOR = 3.0


@dataclass(frozen=True)
class NormalPrior:
    """A Gaussian prior; ``one_sided`` if values on one side of ``mean`` are impossible."""

    mean: float
    sigma: float
    one_sided: bool = False


def prior_of(
    effect: Traceable, item: Parameter, value: float, context: SearchContext
) -> NormalPrior:
    """Return the prior of an effect's parameter that a search has found at ``value``.

    The prior of an amplitude has its mean at the absence of the effect, and the declared size as
    sigma. A limit is known to a factor. The time of an event may be anywhere in the record.
    """
    if item.name == effect.traits.onset:
        return NormalPrior(value, context.duration / 3.5)
    absent = effect.absent.get(item.name)
    if absent is None:
        if math.isfinite(item.prior_std):
            return NormalPrior(item.value, item.prior_std)
        return NormalPrior(value, max(abs(value), abs(item.value), 1e-6))
    if abs(absent) > ABSENT_LIMIT:
        return NormalPrior(value, max(abs(value), 1e-6) * math.log(WIDE_PRIOR_FACTOR))
    if math.isfinite(item.prior_std):
        return NormalPrior(absent, item.prior_std)
    size = effect.traits.usual.get(item.name, abs(item.value - absent))
    if item.name.startswith("shape"):
        size *= WIDE_PRIOR_FACTOR
    return NormalPrior(absent, max(size, 1e-9), absent in item.bounds)


def family(name: str) -> str:
    """Return the family of an effect, which shares prior odds: its name without a channel."""
    return name.partition(":")[0]


def family_sizes(candidates: Iterable[Traceable]) -> Mapping[str, int]:
    """Return the number of members of each family of effects."""
    return Counter(family(name) for name in {candidate.name for candidate in candidates})


def log_odds(
    effects: Iterable[Traceable], families: Mapping[str, int], kinematic: Collection[str] = ()
) -> float:
    """Return the logarithm of the prior odds of a set of effects against the empty set.

    Parameters
    ----------
    effects : the set.
    families : number of members of each family (``family_sizes``).
    kinematic : names of effects with kinematic evidence.
    """
    total = 0.0
    for effect in effects:
        if effect.traits.background or effect.name in kinematic:
            total += math.log(COMMON_MOTION_ODDS)
        else:
            shared = max(FEWEST_FAMILY_MEMBERS, families.get(family(effect.name), 1))
            total += math.log(
                FAMILY_ODDS * (CATCH_ALL_ODDS_RATIO if effect.traits.guard else 1.0) / shared
            )
    return total


def half_normal_factor(mean: float, sigma: float) -> float:
    """Return the logarithm of the posterior's share on the allowed side of a bound, times the
    prior's factor of two.

    ``mean`` is the distance from the bound, positive inside; ``sigma`` is the posterior's.
    """
    from scipy.special import log_ndtr

    return math.log(2.0) + float(log_ndtr(mean / max(sigma, 1e-300)))


def log_mass(mean: float, sigma: float, low: float, high: float) -> float:
    """Return the logarithm of the share of a Gaussian posterior between two values.

    Only the nearer end is counted: the other one is far away.
    """
    from scipy.special import log_ndtr

    return float(min(log_ndtr((high - mean) / sigma), log_ndtr((mean - low) / sigma)))


def declared_sigma(value: float) -> float:
    """Return one sigma of a declared derivative; infinite for zero, which gives no size."""
    return DERIVATIVE_PRIOR_SHARE * abs(value) if value else np.inf


@dataclass(frozen=True, eq=False)
class SetPrior:
    """Prior of the unknowns of a fitted set, as offsets from the fit.

    Attributes
    ----------
    mean, precision : ``(n,)`` of the Gaussian priors; the precision of a flat prior is zero.
    constant : sum of ln(1/sigma) over the Gaussian priors.
    one_sided : for each one-sided prior its position among the unknowns, the allowed side (1 above
        the bound, -1 below) and the bound.
    ranges : for each range of plausible values its position and its two ends.
    """

    mean: np.ndarray
    precision: np.ndarray
    constant: float
    one_sided: tuple[tuple[int, float, float], ...]
    ranges: tuple[tuple[int, float, float], ...] = ()


def set_prior(fitted: FittedModel, context: SearchContext) -> SetPrior:
    """Return the prior of all unknowns of a fitted set; it is flat for biases and initial
    states.
    """
    fit = fitted.fit
    mean, precision, constant = np.zeros(len(fit.theta)), np.zeros(len(fit.theta)), 0.0
    effects = {full_name(e, i.name): (e, i) for e in fitted.effects for i in e.parameters if i.free}
    one_sided: list[tuple[int, float, float]] = []
    ranges: list[tuple[int, float, float]] = []
    for at, name in enumerate(fit.layout.names):
        plain, value = name.partition(", record")[0], float(fit.theta[at])
        if plain in effects:
            effect, item = effects[plain]
            believed = effect.traits.plausible.get(item.name)
            if believed is not None:
                ranges.append((at, believed[0] - value, believed[1] - value))
            known = prior_of(effect, item, value, context)
            centre, sigma = known.mean, known.sigma
            if known.one_sided:
                one_sided.append(
                    (at, 1.0 if item.bounds[0] == known.mean else -1.0, known.mean - value)
                )
        elif plain.startswith("bias_") or plain.endswith("(0)"):
            continue
        else:
            item = fitted.declared.parameters[plain]
            centre, sigma = item.value, declared_sigma(item.value)
        if np.isfinite(sigma):
            mean[at], precision[at] = centre - value, sigma**-2.0
            constant -= math.log(sigma)
    return SetPrior(mean, precision, constant, tuple(one_sided), tuple(ranges))


# ---- Log evidence of a fitted set

Key = frozenset[str]
ROUNDING_EIGENVALUE_SHARE = 1e-10  # smallest eigenvalue of a scaled precision that is not rounding


@dataclass(frozen=True, eq=False)
class WeighedSet:
    """A fitted set of effects with its evidence and prior odds.

    Attributes
    ----------
    fitted : the fit.
    evidence : log evidence, ln p(data | set).
    weight : log evidence plus log prior odds; minus infinity excludes the set.
    offset : ``(n,)`` difference of the mode of the posterior from the fit.
    covariance : ``(n, n)`` covariance of the unknowns in the posterior.
    """

    fitted: FittedModel
    evidence: float
    weight: float
    offset: np.ndarray
    covariance: np.ndarray

    @property
    def names(self) -> Key:
        """Names of the effects of the set."""
        return frozenset(self.fitted.names)


def evidence_of(
    fitted: FittedModel, context: SearchContext
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the log evidence of a set by Laplace's approximation about its fit [1]_.

    Parameters
    ----------
    fitted : a set of effects, fitted by maximum likelihood.
    context : search context, on which the priors of some effects depend.

    Returns
    -------
    ln p(data | set); the offset ``(n,)`` from the fit to the posterior's mode; the covariance
    ``(n, n)`` of the posterior.

    References
    ----------
    .. [1] D. J. C. MacKay, "Information Theory, Inference, and Learning Algorithms", ch. 27 and 28,
       Cambridge, 2003.
    """
    fit = fitted.fit
    prior = set_prior(fitted, context)
    normal, gradient, likelihood = _information_of_data(fitted)
    precision = normal + np.diag(prior.precision)
    right_side = gradient + prior.precision * prior.mean
    # An unknown without data and prior (bias of a missing channel) adds the same to every set.
    known = np.diag(precision) > 0.0
    scale = 1.0 / np.sqrt(np.where(known, np.diag(precision), 1.0))
    scaled = precision * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    values = np.maximum(values, ROUNDING_EIGENVALUE_SHARE)
    inverse = (vectors / values) @ vectors.T
    offset = scale * (inverse @ (scale * right_side))
    covariance = inverse * np.outer(scale, scale)
    logdet = float(np.sum(np.log(values))) - 2.0 * float(np.sum(np.log(scale)))
    deviation = offset - prior.mean
    total = likelihood + float(gradient @ offset - 0.5 * offset @ normal @ offset)
    total += prior.constant - 0.5 * float(deviation @ (prior.precision * deviation)) - 0.5 * logdet
    flat = len(fit.theta) - int(np.count_nonzero(prior.precision))
    total += 0.5 * flat * math.log(2.0 * math.pi) + _noise_level_term(fitted)
    for place, low, high in prior.ranges:
        sigma = math.sqrt(max(covariance[place, place], 1e-300))
        total += log_mass(float(offset[place]), sigma, low, high)
    for place, side, bound in prior.one_sided:
        sigma = math.sqrt(max(covariance[place, place], 1e-300))
        total += half_normal_factor(side * (float(offset[place]) - bound), sigma)
    return float(total), offset, covariance


def _information_of_data(fitted: FittedModel) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the information ``(n, n)``, gradient ``(n,)`` and log likelihood of the data alone.

    Priors used in the fit are removed: the evidence adds them once.
    """
    fit = fitted.fit
    noise = ColouredNoise(fit)
    normal, gradient = noise.normal_equations()
    likelihood = noise.log_likelihood
    known = fit.layout.prior
    if known is not None:
        deviation = fit.theta[known.positions] - known.mean
        likelihood += 0.5 * float(deviation @ known.information @ deviation)
        normal[np.ix_(known.positions, known.positions)] -= known.information
        gradient[known.positions] += known.information @ deviation
    return normal, gradient, likelihood


def _noise_level_term(fitted: FittedModel) -> float:
    """Return the contribution of the noise levels to the log evidence, with a flat prior on each
    logarithm.

    Without process noise they are concentrated out of the fit: the curvature in ln(sigma) is 2 N.
    With it they are among the unknowns.
    """
    fit = fitted.fit
    if has_process_noise(fitted.system):
        levels = fit.theta[len(fit.layout.names) :]
        return -float(np.sum(np.log(np.maximum(levels, 1e-300))))
    return sum(0.5 * math.log(math.pi / n) for n in fit.counts.tolist() if n)
