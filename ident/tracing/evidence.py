"""Log evidence of a fitted set of effects: its unknowns integrated out of the likelihood.

The noise of each output has two levels, one below a few hertz and one above (``ColouredNoise``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import dct, idct, prev_fast_len

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.fitted_model import FittedModel
from ident.tracing.priors import half_normal_factor, log_mass, set_prior
from ident.tracing.whiteness import LOW_FREQUENCY
from ident.whole_record.gauss_newton import Fit
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


# ---- Noise with a level below a few hertz and one above

FEWEST_COEFFICIENTS = 16  # coefficients of a band whose level is estimated


def blocks_of(n: int) -> tuple[slice, ...]:
    """Return blocks that cover ``n`` samples, of lengths whose cosine transforms are fast.

    The transform of a length with a large prime factor takes five times as long.
    """
    most = prev_fast_len(n)
    return (slice(0, most), slice(most, n)) if most < n else (slice(0, n),)


def cosines(values: np.ndarray, inverse: bool = False) -> np.ndarray:
    """Orthonormal cosine transform along the last axis, block by block, or its inverse."""
    transform = idct if inverse else dct
    made = [
        transform(values[..., block], axis=-1, norm="ortho")
        for block in blocks_of(values.shape[-1])
    ]
    return np.concatenate(made, axis=-1)


@dataclass(frozen=True, eq=False)
class ColouredNoise:
    """Levels of the noise of a fit's residuals in two bands.

    Filters and least bits of a recorder colour the noise: it has more power at the frequencies of
    the motion than above. A model of white noise would overstate the evidence. The level below a
    few hertz is therefore estimated from the periodogram of the residual at these frequencies [1]_.
    For white noise the two levels are equal.

    Attributes
    ----------
    fit : the fit whose residuals are used.
    averaged : number of neighbouring samples that are averaged.

    References
    ----------
    .. [1] P. Whittle, "Estimation and information in stationary time series", Arkiv foer Matematik
       2, 1953.
    """

    fit: Fit
    averaged: int = 1

    @cached_property
    def _low(self) -> tuple[np.ndarray, ...]:
        """Mask ``(N,)`` of each record: low coefficients of the cosine transform."""
        found = []
        for problem in self.fit.layout.problems:
            time, n = problem.record.time, self.samples(problem.valid.shape[1])
            interval = self.averaged * (time[-1] - time[0]) / max(len(time) - 1, 1)
            lengths = [block.stop - block.start for block in blocks_of(n)]
            frequency = [np.arange(each) / (2.0 * each * interval) for each in lengths]
            found.append(np.concatenate(frequency) < LOW_FREQUENCY)
        return tuple(found)

    def samples(self, count: int) -> int:
        """Return the number of averages of ``count`` samples."""
        return -(-count // self.averaged)

    def _averages(self, values: np.ndarray) -> np.ndarray:
        """Return averages of values ``(..., N)``, times the root of their count to keep the noise
        level.
        """
        if self.averaged == 1:
            return values
        count, step = values.shape[-1], self.averaged
        sums = np.zeros((*values.shape[:-1], self.samples(count)))
        for k in range(step):
            part = values[..., k::step]
            sums[..., : part.shape[-1]] += part
        return sums / math.sqrt(step)

    def _standard(self, r: int, values: np.ndarray) -> np.ndarray:
        """Values ``(m, N)`` or ``(m, N, c)`` of a record in standard deviations of the fit."""
        valid = self.fit.layout.problems[r].valid
        weight = np.where(valid, 1.0 / np.sqrt(self.fit.variance)[:, None], 0.0)
        return values * (weight if values.ndim == 2 else weight[:, :, None])

    @cached_property
    def _bands(self) -> tuple[np.ndarray, np.ndarray]:
        """Counts and mean squares ``(m, 2)`` of the low and the high band, of all samples."""
        if self.averaged > 1:
            return ColouredNoise(self.fit)._bands
        m = len(self.fit.variance)
        counts, squares = np.zeros((m, 2)), np.zeros((m, 2))
        for r, (problem, low) in enumerate(zip(self.fit.layout.problems, self._low, strict=True)):
            e = cosines(self._standard(r, self.fit.residuals[r]))
            share = problem.valid.mean(axis=1)
            for band, inside in enumerate((low, ~low)):
                counts[:, band] += share * np.count_nonzero(inside)
                squares[:, band] += np.sum(e[:, inside] ** 2, axis=1)
        enough = np.all(counts >= FEWEST_COEFFICIENTS, axis=1)[:, None] & (squares > 0.0)
        means = np.where(enough, squares / np.maximum(counts, 1.0), 1.0)
        return counts, means

    @property
    def log_likelihood(self) -> float:
        """Log likelihood of the data, with two levels of noise for each output."""
        counts, means = self._bands
        return self.fit.log_likelihood - 0.5 * float(np.sum(counts * np.log(means)))

    def whitened(
        self, r: int, values: np.ndarray, outputs: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Cosine transform of values ``(..., m, N)`` of a record in standard deviations of the fit,
        over the level of each band; of some outputs or all."""
        found = cosines(self._averages(values))
        found *= self._scales(r)[outputs]
        return found

    def _scales(self, r: int) -> np.ndarray:
        means = self._bands[1]
        low = self._low[r]
        return np.where(low[None, :], means[:, :1], means[:, 1:]) ** -0.5

    def residual(self, r: int) -> np.ndarray:
        """Whitened residual ``(m, N)`` of a record over the frequencies."""
        return self.whitened(r, self._standard(r, self.fit.residuals[r]))

    def sensitivities(self, r: int) -> np.ndarray:
        """Whitened sensitivities ``(m, N, c)`` of a record over the frequencies."""
        standard = self._standard(r, self.fit.jacobians[r])
        return np.moveaxis(self.whitened(r, np.moveaxis(standard, 2, 0)), 0, 2)

    def in_time(self, r: int) -> np.ndarray:
        """Whitened residual ``(m, N)`` of a record over the samples."""
        return cosines(self.residual(r), inverse=True)

    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Information ``(n, n)`` and gradient ``(n,)`` of the log likelihood at the fit."""
        normal, gradient = (each.copy() for each in self.fit.normal_equations())
        for r in range(len(self.fit.layout.problems)):
            at = np.arange(len(gradient))[self.fit.layout.columns(r)]
            for sign, e, A in (
                (1.0, self.residual(r), self.sensitivities(r)),
                (
                    -1.0,
                    self._standard(r, self.fit.residuals[r]),
                    self._standard(r, self.fit.jacobians[r]),
                ),
            ):
                flat = A.reshape(-1, A.shape[2])
                normal[np.ix_(at, at)] += sign * (flat.T @ flat)
                gradient[at] += sign * (flat.T @ e.ravel())
        return normal, gradient
