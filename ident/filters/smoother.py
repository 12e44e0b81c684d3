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
    mean, covariance = history.mean.copy(), history.covariance.copy()
    n, last = len(history.names), len(history.time) - 1
    r, W = np.zeros(n), np.zeros((n, n))
    with np.errstate(all="ignore"):
        for k in range(last, -1, -1):
            P = history.covariance[k]
            if k < last:
                x, reduced = mean[:, k] + P @ r, P - P @ W @ P
                if not (np.all(np.isfinite(x)) and np.all(np.isfinite(reduced))):
                    break
                mean[:, k], covariance[k] = x, _at_most(0.5 * (reduced + reduced.T), np.diag(P))
            if np.any(history.valid[:, k]):
                H, S = history.sensitivity[k], history.innovation_covariance[k]
                weighted = np.linalg.solve(S, H)
                kept = np.eye(n) - history.predicted_covariance[k] @ weighted.T @ H
                r = weighted.T @ history.innovation[:, k] + kept.T @ r
                W = weighted.T @ H + kept.T @ W @ kept
            G = history.transition[k]
            r, W = G.T @ r, G.T @ W @ G
    std = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2).T, 0.0))
    return SmoothedHistory(history.time, history.names, mean, std, covariance)


def _at_most(P: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """``P`` with rows and columns scaled where a variance exceeds the limit or is negative."""
    own = np.diag(P)
    factor = np.sqrt(np.divide(np.minimum(own, variance), own, out=np.zeros_like(own), where=own > 0))
    return P * np.outer(factor, factor)
