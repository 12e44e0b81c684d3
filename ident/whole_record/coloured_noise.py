"""Coloured noise of each output over whole records, with one level below a few hertz and another
one above.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import dct, idct, irfft, next_fast_len, prev_fast_len, rfft

from ident.statistics.residuals import LOW_FREQUENCY
from ident.whole_record.gauss_newton import Fit

FEWEST_COEFFICIENTS = 16  # fewest coefficients of a band from which its level is estimated
_BATCH = 64  # cosine coefficients whose products are computed at once


def fast_transform_blocks(n: int) -> tuple[slice, ...]:
    """Return consecutive slices that cover ``n`` samples, of lengths whose cosine transforms are
    fast.

    The transform of a length with a large prime factor takes five times as long.
    """
    longest = prev_fast_len(n)
    return (slice(0, longest), slice(longest, n)) if longest < n else (slice(0, n),)


def cosine_transform(values: np.ndarray, inverse: bool = False) -> np.ndarray:
    """Return the orthonormal cosine transform along the last axis, block by block, or its
    inverse.
    """
    transform = idct if inverse else dct
    transformed = np.empty(values.shape)
    for block in fast_transform_blocks(values.shape[-1]):
        transformed[..., block] = transform(values[..., block], axis=-1, norm="ortho")
    return transformed


@dataclass(frozen=True, eq=False)
class ColouredNoise:
    """Noise of the residuals of a fit, with one level in each of two frequency bands.

    Filters and the resolution of a recorder colour the noise: it has more power at the frequencies
    of the motion than above. A model of white noise would then overstate the evidence. Therefore
    the level below a few hertz is estimated from the periodogram of the residual at these
    frequencies alone [1]_. For white noise the two levels are equal.

    Attributes
    ----------
    fit : the fit whose residuals are used.
    averaged : number of neighbouring samples that are averaged into one; 1 averages none.

    References
    ----------
    .. [1] P. Whittle, "Estimation and information in stationary time series", Arkiv foer Matematik
       2, 1953.
    """

    fit: Fit
    averaged: int = 1

    @cached_property
    def _low(self) -> tuple[np.ndarray, ...]:
        """Mask ``(N,)`` of each record: True for the coefficients of the cosine transform below
        ``LOW_FREQUENCY``.
        """
        masks = []
        for problem in self.fit.layout.problems:
            time, n = problem.record.time, self.samples(problem.valid.shape[1])
            interval = self.averaged * (time[-1] - time[0]) / max(len(time) - 1, 1)
            lengths = [block.stop - block.start for block in fast_transform_blocks(n)]
            frequency = [np.arange(length) / (2.0 * length * interval) for length in lengths]
            masks.append(np.concatenate(frequency) < LOW_FREQUENCY)
        return tuple(masks)

    def samples(self, count: int) -> int:
        """Return the number of averages that ``count`` samples give."""
        return -(-count // self.averaged)

    def _averages(self, values: np.ndarray) -> np.ndarray:
        """Return averages of neighbouring ``values (..., N)``, times the square root of the number
        of averaged values, which keeps the level of white noise.
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
        """Return ``values (m, N)`` or ``(m, N, c)`` of record ``r`` over the noise standard
        deviations of the fit; zero where a sample is missing.
        """
        valid = self.fit.layout.problems[r].valid
        weight = np.where(valid, 1.0 / np.sqrt(self.fit.variance)[:, None], 0.0)
        return values * (weight if values.ndim == 2 else weight[:, :, None])

    @cached_property
    def _bands(self) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of coefficients, and mean squares of the residual, ``(m, 2)`` each, in the low
        and the high band over all records. Mean squares are 1 where a band has too few.
        """
        if self.averaged > 1:
            return ColouredNoise(self.fit)._bands
        m = len(self.fit.variance)
        counts, squares = np.zeros((m, 2)), np.zeros((m, 2))
        for r, (problem, low) in enumerate(zip(self.fit.layout.problems, self._low, strict=True)):
            coefficients = cosine_transform(self._standard(r, self.fit.residuals[r]))
            valid_share = problem.valid.mean(axis=1)
            for band, in_band in enumerate((low, ~low)):
                counts[:, band] += valid_share * np.count_nonzero(in_band)
                squares[:, band] += np.sum(coefficients[:, in_band] ** 2, axis=1)
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
        """Return the whitened cosine transform of ``values (..., m, N)`` of record ``r``.

        The values are in standard deviations of the fit. Their transform is divided by the level of
        its band. ``outputs`` are the positions of the outputs that the values have.
        """
        transformed = cosine_transform(self._averages(values))
        transformed *= self._scales(r)[outputs]
        return transformed

    def _scales(self, r: int) -> np.ndarray:
        """Return the factors ``(m, N)`` that whiten the cosine coefficients of record ``r``."""
        means = self._bands[1]
        low = self._low[r]
        return np.where(low[None, :], means[:, :1], means[:, 1:]) ** -0.5

    def residual(self, r: int) -> np.ndarray:
        """Return the whitened cosine transform ``(m, N)`` of the residual of record ``r``."""
        return self.whitened(r, self._standard(r, self.fit.residuals[r]))

    def sensitivities(self, r: int) -> np.ndarray:
        """Return the whitened cosine transform ``(m, N, c)`` of the sensitivities of record
        ``r``.
        """
        standard = self._standard(r, self.fit.jacobians[r])
        return np.moveaxis(self.whitened(r, np.moveaxis(standard, 2, 0)), 0, 2)

    def products_at_all_shifts(
        self, r: int, output: int, signatures: np.ndarray, fixed: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return inner products of whitened signatures that are shifted to later times by 0, 1,
        ... N - 1 samples.

        The products of a shifted signature with a fixed row are their cross-correlation, computed
        by Fourier transforms. The products of two shifted signatures are those that white noise of
        the upper level would give, plus a correction for the cosine coefficients of the lower band,
        whose level differs.

        Parameters
        ----------
        r, output : positions of the record and of the output.
        signatures : ``(k, N)`` in the unit of the output, at shift zero; one a row.
        fixed : ``(c, N)`` whitened cosine transforms that are not shifted; one a row.

        Returns
        -------
        Products ``(N, k, k)`` of the shifted signatures with each other, and ``(N, k, c)`` of the
        shifted signatures with the fixed rows. The first axis is the shift.
        """
        problem, sigma = self.fit.layout.problems[r], math.sqrt(self.fit.variance[output])
        valid, n = problem.valid[output].astype(float), signatures.shape[1]
        length = next_fast_len(2 * n, real=True)

        def correlated(rows: np.ndarray, moved: np.ndarray) -> np.ndarray:
            spectrum = rfft(rows, length)[:, None] * np.conj(rfft(moved, length))
            return np.asarray(irfft(spectrum, length)[..., :n])

        in_time = valid * cosine_transform(fixed * self._scales(r)[output], inverse=True) / sigma
        with_fixed = correlated(in_time, signatures).transpose(2, 1, 0)
        k = len(signatures)
        pairs = (signatures[:, None] * signatures[None]).reshape(k * k, n)
        low, high = (1.0 / (self._bands[1][output] * self.fit.variance[output])).tolist()
        squares = high * correlated(valid[None], pairs)[0].reshape(k, k, n)
        low_positions = np.flatnonzero(self._low[r]) if low != high else np.zeros(0, dtype=int)
        for first in range(0, len(low_positions), _BATCH):
            chosen = low_positions[first : first + _BATCH]
            unit = np.zeros((len(chosen), n))
            unit[np.arange(len(chosen)), chosen] = 1.0
            low_products = correlated(valid * cosine_transform(unit, inverse=True), signatures)
            squares += (low - high) * np.einsum("fkn,fln->kln", low_products, low_products)
        return squares.transpose(2, 0, 1), with_fixed

    def in_time(self, r: int) -> np.ndarray:
        """Return the whitened residual ``(m, N)`` of record ``r`` over the samples."""
        return cosine_transform(self.residual(r), inverse=True)

    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the information ``(n, n)`` and the gradient ``(n,)`` of the log likelihood at the
        fit.
        """
        normal, gradient = (array.copy() for array in self.fit.normal_equations())
        for r in range(len(self.fit.layout.problems)):
            columns = np.arange(len(gradient))[self.fit.layout.columns(r)]
            # add the terms of the coloured residual, and subtract those of the white one
            for sign, residual, sensitivities in (
                (1.0, self.residual(r), self.sensitivities(r)),
                (
                    -1.0,
                    self._standard(r, self.fit.residuals[r]),
                    self._standard(r, self.fit.jacobians[r]),
                ),
            ):
                A = sensitivities.reshape(-1, sensitivities.shape[2])
                normal[np.ix_(columns, columns)] += sign * (A.T @ A)
                gradient[columns] += sign * (A.T @ residual.ravel())
        return normal, gradient
