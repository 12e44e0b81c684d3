"""Prior knowledge: of declared derivatives, of an effect's parameters, and of sets of effects."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ident.tracing.fitted_model import FittedModel
from sim.declaration.effect import Parameter, full_name
from sim.declaration.proposal import SearchContext, Traceable

DERIVATIVE_PRIOR_SHARE = 0.3  # one sigma of a derivative of the vehicle file, as a share of it
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
    """A Gaussian prior; ``one_sided`` where the value lies on one side of ``mean`` only."""

    mean: float
    sigma: float
    one_sided: bool = False


def prior_of(
    effect: Traceable, item: Parameter, value: float, context: SearchContext
) -> NormalPrior:
    """Return the prior of an effect's parameter that a search has found at ``value``.

    An amplitude lies about the effect's absence, by its declared size. A limit is known to a
    factor. A time of an event may be anywhere in the record.
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
    mean, precision : ``(n,)``; zero precision where it is flat.
    constant : sum of ln(1/sigma).
    one_sided : position, side (1 or -1) and bound.
    ranges : position and ends of plausible values.
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
