"""Weighted regression of one signal's segments on others', at every frequency by itself.

    y_r = sum over k of z_rk b_k + e_r,   r a segment, E[e_r conj(e_s)] = S c_rs

with c the inner products of the windows. The estimate is b = (L* A z)^-1 L* A y; the instruments L
are z itself (least squares) or the transforms of a signal that the noise does not reach
(instrumental variables; Soderstrom and Stoica, "Instrumental Variable Methods for System
Identification", Springer 1983). Its covariance is S (L* A z)^-1 L* A c A L (z* A L)^-1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

_SMALLEST = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class Regression:
    """Coefficients of one output.

    Attributes
    ----------
    coefficients : complex ``(F, K)``.
    covariance : ``(F, K, K)``, of the real and of the imaginary part of each: half of E[|error|^2].
    noise : ``(F,)``, the noise spectrum S. degrees : ``(F,)``, real degrees of freedom of it.
    """

    coefficients: np.ndarray
    covariance: np.ndarray
    noise: np.ndarray
    degrees: np.ndarray


def regress(
    output: np.ndarray,
    regressors: np.ndarray,
    weights: np.ndarray,
    overlap: csr_array,
    instruments: np.ndarray | None = None,
) -> Regression:
    """Regress the segments of an output on those of the inputs.

    Parameters
    ----------
    output : complex ``(R, F)``. regressors, instruments : complex ``(K, R, F)``.
    weights : ``(R, F)``, not negative. overlap : ``(R, R)``.
    """
    z = np.moveaxis(regressors, 2, 0)  # (F, K, R)
    left = z if instruments is None else np.moveaxis(instruments, 2, 0)
    weighted = np.conj(left) * weights.T[:, None, :]
    normal = weighted @ np.swapaxes(z, 1, 2)
    scale = np.sqrt(np.maximum(np.abs(np.einsum("fkk->fk", normal)), _SMALLEST))
    normal = normal / (scale[:, :, None] * scale[:, None, :])
    inverse = np.linalg.pinv(normal, rcond=1e-12) / (scale[:, :, None] * scale[:, None, :])
    gain = inverse @ weighted  # (F, K, R): coefficients are gain @ output
    y = output.T[:, :, None]
    coefficients = (gain @ y)[:, :, 0]
    errors = output.T - np.einsum("fkr,fk->fr", z, coefficients)
    correlated = _times(gain, overlap)
    spread = correlated @ np.conj(np.swapaxes(gain, 1, 2))
    # E of the weighted squares of e = (1 - z gain) noise, over S.
    fitted = np.conj(z) * weights.T[:, None, :]
    power = fitted @ np.swapaxes(z, 1, 2)
    crossed = np.einsum("fkr,fkr->f", correlated, np.conj(fitted)).real
    lowered = 2.0 * crossed - np.einsum("fkl,flk->f", power, spread).real
    expected = weights.T @ overlap.diagonal()
    remaining = np.maximum(expected - lowered, 1e-6 * np.maximum(expected, _SMALLEST))
    noise = np.einsum("rf,fr->f", weights, np.abs(errors) ** 2)
    spectrum = noise / remaining
    averages = effective_averages(weights, overlap)
    degrees = np.maximum(2.0 * averages * remaining / np.maximum(expected, _SMALLEST), 1e-3)
    return Regression(coefficients, 0.5 * spectrum[:, None, None] * spread, spectrum, degrees)


def effective_averages(weights: np.ndarray, overlap: csr_array) -> np.ndarray:
    """Number of independent segments whose mean has the variance of the weighted one, ``(F,)``.

    Welch's formula for segments that overlap, for any weights and window lengths.
    """
    total = weights.T @ overlap.diagonal()
    squares = np.einsum("rf,rf->f", weights, overlap.multiply(overlap) @ weights)
    return np.asarray(total**2 / np.maximum(squares, _SMALLEST))


def _times(rows: np.ndarray, overlap: csr_array) -> np.ndarray:
    """``rows @ overlap`` of ``(F, K, R)``; the overlap is real and symmetric."""
    flat = rows.reshape(-1, rows.shape[2]).T
    return np.asarray((overlap @ flat).T.reshape(rows.shape))


def spectral_matrix(signals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted mean spectral matrices ``(F, S, S)`` of signals ``(S, R, F)``: E[x_i conj(x_j)]."""
    x = np.moveaxis(signals, 2, 0)
    share = weights / np.maximum(weights.sum(axis=0), _SMALLEST)
    return np.asarray((x * share.T[:, None, :]) @ np.conj(np.swapaxes(x, 1, 2)))


def coherences(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Multiple coherence ``(F,)`` of the last signal with the others, and partial ones ``(S-1, F)``.

    Bendat and Piersol, "Random Data", 4th edition, chapter 7: by the inverse P of the spectral
    matrix, 1 - 1/(S_yy P_yy) and |P_iy|^2/(P_ii P_yy).
    """
    scale = np.sqrt(np.maximum(np.einsum("fss->fs", matrix).real, _SMALLEST))
    plain = matrix / (scale[:, :, None] * scale[:, None, :])
    size = matrix.shape[1]
    inverse = np.linalg.inv(plain + 1e-13 * np.eye(size))
    last = inverse[:, -1, -1].real
    multiple = 1.0 - 1.0 / np.maximum(last, 1.0)
    partial = np.abs(inverse[:, :-1, -1]) ** 2 / (np.einsum("fss->fs", inverse).real[:, :-1] * last[:, None])
    return np.clip(multiple, 0.0, 1.0), np.clip(partial.T, 0.0, 1.0)
