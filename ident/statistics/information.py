"""Inverse of an information matrix that need not be regular."""

from __future__ import annotations

import numpy as np

UNDETERMINED = 1e-14  # share of the largest eigenvalue of the scaled information below which a direction is not determined: rounding
OPEN = 1e-9  # the same where the sensitivities themselves are good to some digits only: differences of simulated kinematics
FOLLOWED = 1e-12  # share below which a step does not follow a direction at all


def conditional_scale(information: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Sigma of each unknown with the others known, ``(n,)``; its ``size`` (at least 1) where it has no influence at all."""
    diagonal = np.diag(information)
    return np.where(diagonal > 0, 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), np.maximum(np.abs(size), 1.0))


def inverse_information(information: np.ndarray, size: np.ndarray | float = 0.0, floor: float = UNDETERMINED) -> tuple[np.ndarray, bool]:
    """Covariance ``(n, n)`` and whether every direction is determined.

    A direction that holds less than ``floor`` of the scaled information keeps a finite, very large sigma: ``1 / sqrt(floor)`` in units of
    ``conditional_scale``. ``size`` of the unknowns: see there. Of no unknown at all nothing is open.
    """
    if not len(information):
        return np.zeros((0, 0)), True
    square, values, vectors = _spectrum(information, size)
    least = floor * (float(values[-1]) if values[-1] > 0 else 1.0)
    return square * ((vectors / np.maximum(values, least)) @ vectors.T), bool(values[0] > least)


def determined_and_open(information: np.ndarray, size: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The covariance of ``inverse_information`` as a sum, ``(n, n)`` each: of the directions that are determined, and of the others.

    A product with the sum would lose the first part to rounding: the second is larger by up to ``1 / UNDETERMINED``.
    """
    if not len(information):
        return np.zeros((0, 0)), np.zeros((0, 0))
    square, values, vectors = _spectrum(information, size)
    least = UNDETERMINED * (float(values[-1]) if values[-1] > 0 else 1.0)
    known = values > least
    return (
        square * ((vectors[:, known] / values[known]) @ vectors[:, known].T),
        square * ((vectors[:, ~known] / least) @ vectors[:, ~known].T),
    )


def variance_along(covariance: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Variances ``(k,)`` of the linear combinations ``rows (k, n)`` of unknowns, each with what rounding may have taken from it.

    Where directions are open, huge covariances cancel in a combination that does not contain them. The sum then holds no more than its
    rounding error, which is the variance reported: it is never zero, and never smaller than what the arithmetic resolves.
    """
    n = covariance.shape[0]
    sizes = np.abs(rows) @ np.sqrt(np.maximum(np.diag(covariance), 0.0))
    found = np.einsum("ki,ij,kj->k", rows, covariance, rows)
    return np.asarray(np.maximum(found, 0.0) + n * np.finfo(float).eps * sizes**2)


def bounded_inverse(information: np.ndarray) -> np.ndarray:
    """Inverse ``(n, n)`` for a step, without the directions that hold less than FOLLOWED of the scaled information."""
    square, values, vectors = _spectrum(information, 0.0)
    told = values > FOLLOWED * max(float(values[-1]), 1e-300)
    return square * ((vectors * np.where(told, 1.0 / np.where(told, values, 1.0), 0.0)) @ vectors.T)


def _spectrum(information: np.ndarray, size: np.ndarray | float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Products of the conditional sigmas ``(n, n)``, and eigenvalues and eigenvectors of the information in their units."""
    scale = conditional_scale(information, np.broadcast_to(np.asarray(size, dtype=float), len(information)))
    square = np.outer(scale, scale)
    values, vectors = np.linalg.eigh(information * square)
    return square, values, vectors
