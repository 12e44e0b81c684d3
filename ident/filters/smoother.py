"""Fixed-interval smoother: what the whole record says of every sample, from what a filter kept.

The Rauch-Tung-Striebel smoother (AIAA Journal 3(8), 1965) in the form of Bryson and Frazier (Bierman, "Fixed Interval
Smoothing with Discrete Measurements", Int. J. Control 18(1), 1973): the same numbers without inverting the predicted
covariance, which is singular where a state is known exactly, and nearly so for parameters without process noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.estimate import FilterHistory


@dataclass(frozen=True, eq=False)
class SmoothedHistory:
    """States and free parameters given the whole record (N samples, n names).

    Attributes
    ----------
    time : ``(N,)`` s.
    names : as in the filter's history.
    mean, std : ``(n, N)``.
    covariance : ``(N, n, n)``.
    """

    time: np.ndarray
    names: tuple[str, ...]
    mean: np.ndarray
    std: np.ndarray
    covariance: np.ndarray


def smooth(history: FilterHistory) -> SmoothedHistory:
    """Run back over a filter's history, of an extended or an unscented filter.

    With r and W zero after the last sample, back over sample k, K = P_pred H^T S^-1 (nothing where no sample was used):
    r <- H^T S^-1 y + (I - K H)^T r,  W <- H^T S^-1 H + (I - K H)^T W (I - K H), then r <- G^T r, W <- G^T W G with the
    history's ``transition``; at each sample x_s = x + P r, P_s = P - P W P. A smoothed variance never exceeds the
    filter's. Should W leave the range of numbers, the samples before keep the filter's values.
    """
    N = len(history.time)
    mean, covariance = history.mean.copy(), history.covariance.copy()
    with np.errstate(all="ignore"):
        r, W = _backwards(history)
        x = mean[:, :-1] + (covariance[:-1] @ r[:, :, None])[:, :, 0].T
        reduced = covariance[:-1] - covariance[:-1] @ W @ covariance[:-1]
        lost = np.flatnonzero(~(np.all(np.isfinite(x), axis=0) & np.all(np.isfinite(reduced), axis=(1, 2))))
    held = slice(lost[-1] + 1 if lost.size else 0, N - 1)
    mean[:, held] = x[:, held]
    symmetric = 0.5 * (reduced[held] + reduced[held].transpose(0, 2, 1))
    covariance[held] = _at_most(symmetric, np.diagonal(covariance[held], axis1=1, axis2=2))
    std = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2).T, 0.0))
    return SmoothedHistory(history.time, history.names, mean, std, covariance)


def _backwards(history: FilterHistory) -> tuple[np.ndarray, np.ndarray]:
    """r and W at every sample but the last, ``(N - 1, n)`` and ``(N - 1, n, n)``: r <- c + M^T r, W <- D + M^T W M with what each sample brings."""
    H, G, later = history.sensitivity[1:], history.transition[1:], slice(1, None)
    N, n = len(G), len(history.names)
    # A channel that is missing has zeros in H and one in S: it brings nothing.
    weighted = np.linalg.solve(history.innovation_covariance[later], H).transpose(0, 2, 1)
    M = G - (history.predicted_covariance[later] @ weighted) @ (H @ G)
    brought = G.transpose(0, 2, 1) @ weighted
    c, D, M_turned = (brought @ history.innovation.T[later, :, None])[:, :, 0], brought @ (H @ G), M.transpose(0, 2, 1)
    r, W = np.empty((N, n)), np.empty((N, n, n))
    if N:
        r[-1], W[-1] = c[-1], D[-1]
    room, dot, add = np.empty((n, n)), np.dot, np.add
    for k in range(N - 1, 0, -1):
        turned, before = M_turned[k - 1], W[k - 1]
        add(dot(turned, r[k]), c[k - 1], r[k - 1])
        dot(turned, W[k], room)
        dot(room, M[k - 1], before)
        add(before, D[k - 1], before)
    return r, W


def _at_most(P: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """``P (N, n, n)`` with rows and columns scaled where a variance exceeds the limit ``(N, n)`` or is negative."""
    own = np.diagonal(P, axis1=1, axis2=2)
    factor = np.sqrt(np.divide(np.minimum(own, variance), own, out=np.zeros_like(own), where=own > 0))
    return np.asarray(P * (factor[:, :, None] * factor[:, None]))
