"""Inverses of information matrices in which some directions hold nothing."""

from __future__ import annotations

import numpy as np

_UNDETERMINED = 1e-9


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
