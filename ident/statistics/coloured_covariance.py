"""Parameter covariance corrected for residuals that are not white.

Morelli and Klein, "Accuracy of Aerodynamic Model Parameters Estimated from Flight Test Data", J. Guidance,
Control and Dynamics 20(1), 1997: the information matrix stays, the scatter of the gradient is formed with the
spectrum of the residuals instead of that of white noise (`ident.statistics.residual_spectrum`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr, stdtrit

from ident.statistics.residual_spectrum import RecordScores, good_length, score_covariance

_MANY, _FEWEST = 1e6, 2.0  # degrees of freedom: normal from there on; fewer give quantiles that say nothing


def autocovariance(residual: np.ndarray, lags: int) -> np.ndarray:
    """Biased autocovariance of a series ``(N,)`` at lags 0 to ``lags``, its mean not removed."""
    n = len(residual)
    size = good_length(n + lags)
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
    does not shrink a sigma. Where the spectrum of the residuals is itself uncertain, sigmas are Student's: two of
    them hold as much as two of a normal distribution do (``student_factor``).
    """
    records = []
    for at, jacobian, residual, valid in parts:
        known = np.where(valid[:, :, None], jacobian, 0.0)
        records.append(RecordScores(at, known / variance[:, None, None], known, residual, valid))
    found = score_covariance(records, inverse)
    corrected = inverse @ (found.middle if prior is None else found.middle + prior) @ inverse
    white, own = np.diag(inverse), np.diag(corrected)
    # Where the residuals say nothing at all (exact data) the white value is kept.
    shown = own > 1e-12 * white
    factor = np.sqrt(np.maximum(np.divide(white, own, out=np.zeros_like(own), where=shown), 1.0))
    factor *= shown * student_factor(own, found.spread)
    return corrected * np.outer(factor, factor) + np.diag(np.where(shown, 0.0, white))


def sandwich(inverse: np.ndarray, records: Sequence[RecordScores], *, coloured: bool = True) -> np.ndarray:
    """Covariance ``(n, n)`` of an estimate of which ``inverse (n, n)`` times the gradient is a step: instrumental variables, say.

    ``coloured`` : with the spectra of the residuals and Student's quantiles as in ``corrected_covariance``; else as of white noise.
    """
    if coloured:
        found = score_covariance(records, inverse)
        covariance = inverse @ found.middle @ inverse.T
        factor = student_factor(np.diag(covariance), found.spread)
        return np.asarray(covariance * np.outer(factor, factor))
    middle = np.zeros_like(inverse)
    for each in records:
        count = np.maximum(each.valid.sum(axis=1), 1)
        level = (each.residual**2).sum(axis=1) / count
        middle[np.ix_(each.at, each.at)] += np.einsum("eni,e,enj->ij", each.weights, level, each.weights)
    return np.asarray(inverse @ middle @ inverse.T)


def student_factor(variance: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """By how much sigmas grow whose own ``variance (n,)`` is an estimate with the variance ``spread (n,)``: ``(n,)``.

    Satterthwaite's degrees of freedom 2 variance^2/spread, and Student's quantile of 97.7 % over the normal one of two sigmas.
    """
    freedom = 2.0 * np.divide(variance**2, spread, out=np.full_like(variance, np.inf), where=spread > 0)
    return np.where(freedom < _MANY, stdtrit(np.clip(freedom, _FEWEST, _MANY), ndtr(2.0)) / 2.0, 1.0)


def filtered_product(sensitivity: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Sum over i, j of s_i R(i - j) s_j^T for a symmetric autocovariance: over frequencies, by Parseval, of spectra of padded series."""
    n, lags = len(sensitivity), len(covariance) - 1
    size = good_length(n + 2 * lags + 1)
    kernel = np.zeros(size)
    kernel[: lags + 1] = covariance
    kernel[size - lags :] = covariance[:0:-1]
    spectrum, weight = np.fft.rfft(sensitivity.T, size), np.fft.rfft(kernel).real * (2.0 / size)
    weight[0] *= 0.5
    weight[-1] *= 0.5 if size % 2 == 0 else 1.0
    parts = np.concatenate([spectrum.real, spectrum.imag], axis=1)
    return np.asarray((parts * np.concatenate([weight, weight])) @ parts.T)


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
