"""Inverse of an information matrix that need not be regular."""

from __future__ import annotations

import numpy as np

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
