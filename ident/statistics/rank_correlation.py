"""Do two quantities grow together? Spearman's rank correlation, without the half second that loading scipy.stats takes."""

from __future__ import annotations

import numpy as np


def ranks(values: np.ndarray) -> np.ndarray:
    """Rank of each of ``values (n,)`` from 1, the mean of their ranks where several are equal."""
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    return (last - 0.5 * (counts - 1.0))[place.ravel()]


def p_value_of_growth(a: np.ndarray, b: np.ndarray) -> float:
    """P-value of Spearman's test that ``a`` and ``b`` ``(n,)`` do not grow together: small where they do; not a number where one is constant.

    The correlation r of ranks is compared by t = r sqrt((n - 2) / (1 - r^2)), Student's with n - 2 degrees of freedom (Kendall and Stuart).
    """
    from scipy.special import stdtr

    first, other = ranks(a) - 0.5 * (len(a) + 1.0), ranks(b) - 0.5 * (len(b) + 1.0)
    size = float(np.sqrt((first @ first) * (other @ other)))
    if size == 0.0:
        return float("nan")
    r = float(np.clip(first @ other / size, -1.0, 1.0))
    return float(stdtr(len(a) - 2.0, -r * np.sqrt((len(a) - 2.0) / max(1.0 - r * r, 1e-300))))
