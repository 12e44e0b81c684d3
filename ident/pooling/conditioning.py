"""A flight's estimates once other flights have told a value that they share."""

from __future__ import annotations

import numpy as np


def conditioned(
    estimate: np.ndarray, covariance: np.ndarray, at: np.ndarray, value: np.ndarray, value_covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """``estimate (n,)`` and ``covariance (n, n)`` of one flight, given what others know of its entries ``at (k,)``.

    ``value (k,)`` with ``value_covariance (k, k)`` is independent of this flight. The product of two Gaussians: over all flights it is the
    joint fit with the entries shared, as far as each likelihood is quadratic.
    """
    gain = covariance[:, at] @ np.linalg.inv(covariance[np.ix_(at, at)] + value_covariance)
    moved = estimate + gain @ (value - estimate[at])
    left = covariance - gain @ covariance[at, :]
    return moved, 0.5 * (left + left.T)


def without_one(value: np.ndarray, covariance: np.ndarray, own: np.ndarray, own_covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """A pooled ``value (k,)`` with ``covariance (k, k)`` without one of the flights in it; None where nothing is left."""
    information = np.linalg.inv(covariance) - np.linalg.inv(own_covariance)
    if np.linalg.eigvalsh(0.5 * (information + information.T))[0] <= 1e-9 * np.trace(np.linalg.inv(covariance)):
        return None
    left = np.linalg.inv(information)
    return left @ (np.linalg.solve(covariance, value) - np.linalg.solve(own_covariance, own)), left
