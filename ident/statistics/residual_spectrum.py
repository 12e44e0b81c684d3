"""Power spectra of the residuals of a fit, by autoregressions, freed of what the fit has taken out of them.

The residuals of a fit are the noise less what the fitted unknowns have followed of it. Of noise with a long memory that is a large part of
its power at low frequency, where maneuvers have theirs too: autocovariances of residuals are too small, and their taper makes them smaller
(Kiefer and Vogelsang, Econometric Theory 21(6), 2005). Here each output's noise is an autoregression, its order by Akaike's criterion (Berk,
Annals of Statistics 2(3), 1974; den Haan and Levin, NBER technical paper 197, 1996), and its autocovariance is moved by the difference between
noise and residual that this autoregression itself leads to, until both agree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

_PASSES = 4  # of the autocovariance towards that of the noise; the bias is a share b of it, and what is left b^5


@dataclass(frozen=True, eq=False)
class Autoregression:
    """``w[k] = e[k] + sum a[j] e[k - 1 - j]`` is white with ``variance``; ``coefficients`` a ``(p,)`` from ``count`` samples."""

    coefficients: np.ndarray
    variance: float
    count: float

    def transfer(self, size: int) -> np.ndarray:
        """``1 + sum a[j] exp(-i w (j + 1))`` at the frequencies of a real transform of ``size``."""
        padded = np.zeros(size)
        padded[0] = 1.0
        padded[1 : len(self.coefficients) + 1] = self.coefficients
        return np.asarray(np.fft.rfft(padded))

    def covariance(self, autocovariance: np.ndarray) -> np.ndarray:
        """Covariance ``(p, p)`` of the coefficients, from the autocovariance to which they were fitted."""
        p = len(self.coefficients)
        toeplitz = autocovariance[np.abs(np.subtract.outer(np.arange(p), np.arange(p)))]
        return np.asarray(self.variance / self.count * np.linalg.pinv(toeplitz, hermitian=True))


@dataclass(frozen=True, eq=False)
class RecordScores:
    """What one record adds to the gradient of a fit.

    Attributes
    ----------
    at : ``(c,)`` positions of its unknowns. weights : ``(m, N, c)`` such that the gradient is their sum with the residuals.
    jacobian : ``(m, N, c)`` by which a change of the unknowns changes the fitted outputs. residual, valid : ``(m, N)``; all zero where missing.
    """

    at: np.ndarray
    weights: np.ndarray
    jacobian: np.ndarray
    residual: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True, eq=False)
class ScoreCovariance:
    """Covariance ``middle (n, n)`` of the gradient, and the variance ``spread (n,)`` of each diagonal entry of ``inverse middle inverse^T``."""

    middle: np.ndarray
    spread: np.ndarray


def score_covariance(records: Sequence[RecordScores], inverse: np.ndarray) -> ScoreCovariance:
    """Covariance of the gradient under the noise that the residuals of each record show.

    Parameters
    ----------
    inverse : ``(n, n)`` by which a gradient turns into a step of the unknowns.
    """
    spectra = [_Record(each) for each in records]
    n = len(inverse)
    for turn in range(_PASSES):
        middle = np.zeros((n, n))
        for each in spectra:
            middle[np.ix_(each.scores.at, each.scores.at)] += each.middle()
        if turn == _PASSES - 1:
            break
        covariance = inverse @ middle @ inverse.T
        for each in spectra:
            at = np.ix_(each.scores.at, each.scores.at)
            each.refit(inverse[at], covariance[at])
    spread = np.zeros(n)
    for each in spectra:
        spread += each.spread(inverse[:, each.scores.at])
    return ScoreCovariance(middle, spread)


class _Record:
    """Transforms of one record's scores, and the autoregression of each of its outputs as it stands."""

    def __init__(self, scores: RecordScores) -> None:
        self.scores = scores
        m, self.count = scores.residual.shape
        self.size = good_length(2 * self.count)
        self.rows = [i for i in range(m) if np.any(scores.valid[i]) and np.any(scores.residual[i])]
        most = min(int(10.0 * np.log10(max(self.count, 2))), max(self.count // 10, 1))
        self.lags = min(most, self.count - 1)
        self.spectra = {i: np.fft.rfft(scores.weights[i].T, self.size) for i in self.rows}
        self.measured = {i: paired_autocovariance(scores.residual[i], scores.valid[i], self.lags) for i in self.rows}
        self.autocovariance = dict(self.measured)
        self._fit()

    def _fit(self) -> None:
        samples = {i: float(np.count_nonzero(self.scores.valid[i])) for i in self.rows}
        self.models = {i: autoregression(self.autocovariance[i], samples[i]) for i in self.rows}
        self.transfers = {i: model.transfer(self.size) for i, model in self.models.items()}
        self.shared = self._correlation()

    def _correlation(self) -> np.ndarray:
        """Correlation of the outputs' white noises at the same sample, ``(rows, rows)``."""
        whitened = np.array([np.fft.irfft(np.fft.rfft(self.scores.residual[i], self.size) * self.transfers[i]) for i in self.rows])
        if not len(whitened):
            return np.zeros((0, 0))
        whitened = whitened[:, : self.count]
        product = whitened @ whitened.T
        size = np.sqrt(np.maximum(np.diag(product), 1e-300))
        return np.asarray(product / np.outer(size, size))

    def density(self, a: int, b: int) -> np.ndarray:
        """Cross-spectral density of the noises of the outputs in places ``a`` and ``b`` of ``rows``."""
        i, j = self.rows[a], self.rows[b]
        level = self.shared[a, b] * np.sqrt(self.models[i].variance * self.models[j].variance)
        return np.asarray(level / (self.transfers[i] * np.conj(self.transfers[j])))

    def driven(self) -> dict[int, np.ndarray]:
        """Transforms ``(c, F)`` of the covariance between the gradient and each output's noise."""
        out = {}
        for b, j in enumerate(self.rows):
            out[j] = sum(self.spectra[i] * np.conj(self.density(a, b)) for a, i in enumerate(self.rows))
        return out

    def middle(self) -> np.ndarray:
        """Covariance of the record's gradient, ``(c, c)``, by Parseval."""
        c = len(self.scores.at)
        weight = np.full(self.size // 2 + 1, 2.0 / self.size)
        weight[0] *= 0.5
        weight[-1] *= 0.5 if self.size % 2 == 0 else 1.0
        total = np.zeros((c, c))
        for j, driven in self.driven().items():
            total += ((driven * weight) @ np.conj(self.spectra[j]).T).real
        return 0.5 * (total + total.T)

    def refit(self, inverse: np.ndarray, covariance: np.ndarray) -> None:
        """Autoregressions anew, of the autocovariances that the noise must have for the residuals to have theirs."""
        driven = self.driven()
        for i in self.rows:
            following = inverse @ np.fft.irfft(driven[i], self.size)[:, : self.count]
            J = np.where(self.scores.valid[i][:, None], self.scores.jacobian[i], 0.0)
            half = J @ covariance
            taken = np.empty(self.lags + 1)
            for k in range(self.lags + 1):
                ahead, now = slice(k, None), slice(None, self.count - k)
                both = np.sum(J[now] * following.T[ahead]) + np.sum(J[ahead] * following.T[now])
                taken[k] = both - np.sum(half[now] * J[ahead])
            share = max(float(np.mean(self.scores.valid[i])), 1e-12)
            self.autocovariance[i] = self.measured[i] + taken / (share * self.count)
        self._fit()

    def spread(self, inverse: np.ndarray) -> np.ndarray:
        """Variance of the diagonal of ``inverse middle inverse^T`` ``(n,)`` through what the autoregressions do not know exactly."""
        total = np.zeros(len(inverse))
        angles = np.exp(-2j * np.pi * np.arange(self.size // 2 + 1) / self.size)
        for i in self.rows:
            model, transfer = self.models[i], self.transfers[i]
            power = np.abs(inverse @ self.spectra[i]) ** 2 * (2.0 / self.size) * (model.variance / np.abs(transfer) ** 2)
            power[:, 0] *= 0.5
            total += 2.0 / model.count * power.sum(axis=1) ** 2
            p = len(model.coefficients)
            if p:
                slopes = -2.0 * (angles[None, :] ** np.arange(1, p + 1)[:, None] / transfer).real
                by = power @ slopes.T
                total += np.einsum("np,pq,nq->n", by, model.covariance(self.autocovariance[i]), by)
        return total


def autoregression(autocovariance: np.ndarray, count: float) -> Autoregression:
    """The autoregression of least Akaike criterion of an autocovariance at lags 0 to P, of ``count`` samples, by Levinson and Durbin."""
    variance = float(max(autocovariance[0], 1e-300))
    a: np.ndarray = np.zeros(0)
    best, least = Autoregression(a, variance, count), count * np.log(variance)
    for p in range(1, len(autocovariance)):
        reflected = -(autocovariance[p] + a @ autocovariance[p - 1 : 0 : -1]) / variance
        if not abs(reflected) < 1.0:
            break
        a = np.append(a + reflected * a[::-1], reflected)
        variance *= 1.0 - reflected * reflected
        score = count * np.log(variance) + 2.0 * p
        if score < least:
            best, least = Autoregression(a, variance, count), score
    return best


def paired_autocovariance(residual: np.ndarray, valid: np.ndarray, lags: int) -> np.ndarray:
    """Autocovariance ``(lags + 1,)`` of a series ``(N,)`` with missing samples, tapered as of a complete one (the sum over N - k pairs by N)."""
    n = len(residual)
    size = good_length(n + lags)
    known = valid.astype(float)
    products = np.fft.irfft(np.abs(np.fft.rfft(residual * known, size)) ** 2, size)[: lags + 1]
    pairs = np.fft.irfft(np.abs(np.fft.rfft(known, size)) ** 2, size)[: lags + 1]
    complete = n - np.arange(lags + 1.0)
    return np.asarray(products / np.maximum(pairs, 0.5) * complete / n)


@lru_cache(maxsize=64)
def good_length(least: int) -> int:
    """The smallest product of twos, threes and fives that is not less: of such lengths transforms are quick."""
    found, fives = 1 << (least - 1).bit_length(), 1
    while fives < found:
        threes = fives
        while threes < found:
            found = min(found, threes << max(0, (-(-least // threes) - 1).bit_length()))
            threes *= 3
        fives *= 5
    return found
