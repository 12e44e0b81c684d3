"""Log evidence of a fitted set of effects: its unknowns integrated out of the likelihood.

The noise of each output has two levels, one below a few hertz and one above (``ColouredNoise``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.fitted_model import FittedModel
from ident.tracing.priors import half_normal_factor, log_mass, set_prior
from ident.whole_record.coloured_noise import ColouredNoise
from sim.declaration.proposal import SearchContext

Key = frozenset[str]
ROUNDING_EIGENVALUE_SHARE = 1e-10  # smallest eigenvalue of a scaled precision that is not rounding


@dataclass(frozen=True, eq=False)
class WeighedSet:
    """A fitted set of effects with its evidence.

    Attributes
    ----------
    fitted : the fit.
    evidence : ln p(data | set).
    weight : with the set's prior odds.
    offset : ``(n,)`` from the fit to the posterior's mode.
    covariance : ``(n, n)`` of the posterior.
    """

    fitted: FittedModel
    evidence: float
    weight: float
    offset: np.ndarray
    covariance: np.ndarray

    @property
    def names(self) -> Key:
        """Names of its effects."""
        return frozenset(self.fitted.names)


def evidence_of(
    fitted: FittedModel, context: SearchContext
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the log evidence of a set by Laplace's approximation about its fit [1]_.

    Parameters
    ----------
    fitted : a set of effects, fitted by maximum likelihood.
    context : what the priors of some effects depend on.

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
    normal, gradient, likelihood = _of_data(fitted)
    precision = normal + np.diag(prior.precision)
    right = gradient + prior.precision * prior.mean
    # An unknown without data (bias of a missing channel) adds the same to every set.
    known = np.diag(precision) > 0.0
    scale = 1.0 / np.sqrt(np.where(known, np.diag(precision), 1.0))
    inside = precision * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(0.5 * (inside + inside.T))
    values = np.maximum(values, ROUNDING_EIGENVALUE_SHARE)
    inverse = (vectors / values) @ vectors.T
    offset = scale * (inverse @ (scale * right))
    covariance = inverse * np.outer(scale, scale)
    logdet = float(np.sum(np.log(values))) - 2.0 * float(np.sum(np.log(scale)))
    away = offset - prior.mean
    total = likelihood + float(gradient @ offset - 0.5 * offset @ normal @ offset)
    total += prior.constant - 0.5 * float(away @ (prior.precision * away)) - 0.5 * logdet
    flat = len(fit.theta) - int(np.count_nonzero(prior.precision))
    total += 0.5 * flat * math.log(2.0 * math.pi) + _of_noise_levels(fitted)
    for place, low, high in prior.ranges:
        sigma = math.sqrt(max(covariance[place, place], 1e-300))
        total += log_mass(float(offset[place]), sigma, low, high)
    for place, side, bound in prior.one_sided:
        sigma = math.sqrt(max(covariance[place, place], 1e-300))
        total += half_normal_factor(side * (float(offset[place]) - bound), sigma)
    return float(total), offset, covariance


def _of_data(fitted: FittedModel) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the information ``(n, n)``, gradient ``(n,)`` and log likelihood of the data alone.

    Priors used in the fit are removed: the evidence adds them once.
    """
    fit = fitted.fit
    noise = ColouredNoise(fit)
    normal, gradient = noise.normal_equations()
    likelihood = noise.log_likelihood
    known = fit.layout.prior
    if known is not None:
        away = fit.theta[known.positions] - known.mean
        likelihood += 0.5 * float(away @ known.information @ away)
        normal[np.ix_(known.positions, known.positions)] -= known.information
        gradient[known.positions] += known.information @ away
    return normal, gradient, likelihood


def _of_noise_levels(fitted: FittedModel) -> float:
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
