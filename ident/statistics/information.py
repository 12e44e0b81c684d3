"""Inverse of an information matrix that need not be regular."""

from __future__ import annotations

import numpy as np

_UNDETERMINED = 1e-9

UNDETERMINED = 1e-14  # share of the largest eigenvalue of the scaled information below which a direction is not determined


def conditional_scale(information: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Sigma of each unknown with the others known, ``(n,)``; its ``size`` (at least 1) where it has no influence at all."""
    diagonal = np.diag(information)
    return np.where(diagonal > 0, 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), np.maximum(np.abs(size), 1.0))


def inverse_information(information: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, bool]:
    """Covariance ``(n, n)`` and whether every direction is determined.

    A direction that is not keeps a finite, very large sigma: ``1 / sqrt(UNDETERMINED)`` in units of ``conditional_scale``.
    """
    scale = conditional_scale(information, size)
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    floor = UNDETERMINED * (float(values[-1]) if values[-1] > 0 else 1.0)
    inverse = np.outer(scale, scale) * ((vectors / np.maximum(values, floor)) @ vectors.T)
    return inverse, bool(values[0] > floor)


def covariance_of(information: np.ndarray) -> np.ndarray:
    """Inverse in which a direction that is not determined keeps a variance far beyond all others."""
    scale = 1.0 / np.sqrt(np.where(np.diag(information) > 0, np.diag(information), 1.0))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    return np.asarray(np.outer(scale, scale) * ((vectors / np.maximum(values, _UNDETERMINED * max(float(values[-1]), 1e-300))) @ vectors.T))


def bounded_inverse(information: np.ndarray) -> np.ndarray:
    """Inverse without directions that hold less than 1e-12 of the scaled information."""
    scale = 1.0 / np.sqrt(np.where(np.diag(information) > 0, np.diag(information), 1.0))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    told = values > 1e-12 * max(float(values[-1]), 1e-300)
    return np.asarray(np.outer(scale, scale) * ((vectors * np.where(told, 1.0 / np.where(told, values, 1.0), 0.0)) @ vectors.T))
