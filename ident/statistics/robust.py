"""A standard deviation that outliers do not move."""

from __future__ import annotations

import numpy as np

ROBUST = 1.4826  # median absolute deviation to sigma


def robust_sigma(values: np.ndarray) -> float:
    """Standard deviation from the median absolute deviation, insensitive to outliers."""
    return float(ROBUST * np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def robust_sigma_about_zero(values: np.ndarray) -> float:
    """The same of values whose middle is known to be zero, such as differences of a signal that moves both ways."""
    return float(ROBUST * np.median(np.abs(values)))
