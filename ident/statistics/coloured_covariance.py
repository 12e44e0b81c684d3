"""Parameter covariance corrected for residuals that are not white.

Morelli and Klein, "Accuracy of Aerodynamic Model Parameters Estimated from Flight Test Data", J. Guidance,
Control and Dynamics 20(1), 1997: the information matrix stays, the scatter of the gradient is formed with the
estimated autocorrelation of the residuals instead of that of white noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np


def autocovariance(residual: np.ndarray, lags: int) -> np.ndarray:
    """Biased autocovariance of a series ``(N,)`` at lags 0 to ``lags``, its mean not removed."""
    n = len(residual)
    size = _length(n + lags)
    spectrum = np.abs(np.fft.rfft(residual, size)) ** 2
    return np.fft.irfft(spectrum, size)[: lags + 1] / n


def corrected_covariance(
    inverse: np.ndarray,
    parts: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]],
    variance: np.ndarray,
    prior: np.ndarray | None = None,
) -> np.ndarray:
    """Sandwich covariance of a whole-record fit.

    Parameters
    ----------
    inverse : ``(n, n)`` inverse information matrix under white noise, that of the prior included.
    parts : for each record the positions of its columns in theta, its jacobian ``(m, N, c)``, residuals and validity
        ``(m, N)``; missing samples count as zero.
    variance : ``(m,)`` noise variance of each output.
    prior : ``(n, n)`` information of the prior, which no colour touches; None where there is none.

    Returns
    -------
    ``(n, n)``; each diagonal entry is at least that of white noise of the same variance, so that a lucky record
    does not shrink a sigma.
    """
    middle = np.zeros_like(inverse) if prior is None else np.array(prior, dtype=float)
    for at, jacobian, residual, valid in parts:
        for i in range(len(residual)):
            if not np.any(valid[i]):
                continue
            lags = min(max(10, residual.shape[1] // 5), residual.shape[1] - 1)
            covariance = autocovariance(residual[i], lags) * (1.0 - np.arange(lags + 1) / (lags + 1.0))
            sensitivity = np.where(valid[i][:, None], jacobian[i], 0.0) / variance[i]
            middle[at[:, None], at] += filtered_product(sensitivity, covariance)
    corrected = inverse @ middle @ inverse
    white, own = np.diag(inverse), np.diag(corrected)
    # Where the residuals say nothing at all (exact data) the white value stands alone.
    told = own > 1e-12 * white
    factor = np.sqrt(np.maximum(np.divide(white, own, out=np.zeros_like(own), where=told), 1.0)) * told
    return corrected * np.outer(factor, factor) + np.diag(np.where(told, 0.0, white))


def filtered_product(sensitivity: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Sum over i, j of s_i R(i - j) s_j^T for a symmetric autocovariance: over frequencies, by Parseval, of spectra of padded series."""
    n, lags = len(sensitivity), len(covariance) - 1
    size = _length(n + 2 * lags + 1)
    kernel = np.zeros(size)
    kernel[: lags + 1] = covariance
    kernel[size - lags :] = covariance[:0:-1]
    spectrum, weight = np.fft.rfft(sensitivity.T, size), np.fft.rfft(kernel).real * (2.0 / size)
    weight[0] *= 0.5
    weight[-1] *= 0.5 if size % 2 == 0 else 1.0
    parts = np.concatenate([spectrum.real, spectrum.imag], axis=1)
    return np.asarray((parts * np.concatenate([weight, weight])) @ parts.T)


@lru_cache(maxsize=64)
def _length(least: int) -> int:
    """The smallest product of twos, threes and fives that is not less: of such lengths transforms are quick."""
    found, fives = 1 << (least - 1).bit_length(), 1
    while fives < found:
        threes = fives
        while threes < found:
            found = min(found, threes << max(0, (-(-least // threes) - 1).bit_length()))
            threes *= 3
        fives *= 5
    return found


def effective_share(residuals: Sequence[np.ndarray], valid: Sequence[np.ndarray]) -> float:
    """Share of the samples that count as independent where squares of residuals are compared, 0 to 1.

    1/(1 + 2 sum rho_k^2) over a fifth of the record, rho the residual's correlation (Bartlett, 1946), the mean over channels and records
    by their samples. Residuals and validity ``(m, N)`` a record; missing samples count as zero.
    """
    weight, total = 0.0, 0.0
    for residual, mask in zip(residuals, valid, strict=True):
        for row, known in zip(residual, mask, strict=True):
            count = float(np.count_nonzero(known))
            if count < 10 or not np.any(row[known]):
                continue
            lags = max(5, len(row) // 5)
            covariance = autocovariance(np.where(known, row, 0.0), lags)
            rho = covariance[1:] / covariance[0]
            # Estimates scatter by (1 + 2 excess)/N at every lag, which is no correlation.
            excess = max(0.0, (float(np.sum(rho**2)) - lags / count) / (1.0 + 2.0 * lags / count))
            weight, total = weight + count, total + count / (1.0 + 2.0 * excess)
    return total / weight if weight > 0 else 1.0
