"""Fixed-interval smoother: what the whole record says of every sample, from what a filter kept.

Rauch, Tung and Striebel, "Maximum Likelihood Estimates of Linear Dynamic Systems", AIAA Journal 3(8), 1965.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.estimate import FilterHistory

SMALLEST = 1e-14  # share of the largest eigenvalue below which a direction counts as known


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

    With the gain A = P G^T P_pred^+, G the history's ``transition``:
    x_s[k] = x[k] + A (x_s[k+1] - x_pred[k+1]),  P_s[k] = P[k] + A (P_s[k+1] - P_pred[k+1]) A^T.
    The pseudo-inverse, of the correlation matrix, leaves out what the prediction knows exactly (held states, no
    process noise). Where rounding makes a smoothed variance exceed the filter's it is set back, correlations kept.
    """
    mean, covariance = history.mean.copy(), history.covariance.copy()
    for k in range(len(history.time) - 2, -1, -1):
        predicted = history.predicted_covariance[k + 1]
        gain = history.covariance[k] @ history.transition[k + 1].T @ scaled_pseudo_inverse(predicted)
        mean[:, k] += gain @ (mean[:, k + 1] - history.predicted_mean[:, k + 1])
        covariance[k] += gain @ (covariance[k + 1] - predicted) @ gain.T
        covariance[k] = _at_most(0.5 * (covariance[k] + covariance[k].T), np.diag(history.covariance[k]))
    std = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2).T, 0.0))
    return SmoothedHistory(history.time, history.names, mean, std, covariance)


def scaled_pseudo_inverse(P: np.ndarray) -> np.ndarray:
    """Pseudo-inverse of a covariance ``(n, n)`` through its correlation matrix, zero where there is no variance."""
    scale = np.sqrt(np.maximum(np.diag(P), 0.0))
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    values, vectors = np.linalg.eigh(P * np.outer(inverse, inverse))
    kept = values > SMALLEST * max(values[-1], 0.0)
    reciprocal = np.divide(1.0, values, out=np.zeros_like(values), where=kept)
    return inverse[:, None] * ((vectors * reciprocal) @ vectors.T) * inverse


def _at_most(P: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """``P`` with rows and columns scaled where a variance exceeds the limit or is negative."""
    own = np.diag(P)
    wanted = np.clip(own, 0.0, variance)
    factor = np.sqrt(np.divide(wanted, own, out=np.zeros_like(own), where=own > 0))
    return P * np.outer(factor, factor)
