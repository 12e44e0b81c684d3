"""Intervals that rest on chi-square: of a deviation, of a ratio of deviations, of mean squares that should be their degrees of freedom."""

from __future__ import annotations

import numpy as np

from ident.statistics.shares import LEVEL


def quantile(share: float, degrees: float) -> float:
    """The value below which chi-square with ``degrees`` of freedom lies with the probability ``share``; without the second of scipy.stats."""
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(0.5 * degrees, share))


def deviation_factors(count: int, level: float = LEVEL) -> tuple[float, float]:
    """By what a standard deviation of ``count`` independent normal numbers is multiplied to give the ends of its interval; infinite of one number."""
    if count < 2:
        return 0.0, float("inf")
    degrees, tail = count - 1, 0.5 * (1.0 - level)
    return (degrees / quantile(1.0 - tail, degrees)) ** 0.5, (degrees / quantile(tail, degrees)) ** 0.5


def mean_square_interval(degrees: float, level: float = LEVEL) -> tuple[float, float]:
    """Where a sum of squares of chi-square with ``degrees`` of freedom lies, over ``degrees``: about one."""
    tail = 0.5 * (1.0 - level)
    return quantile(tail, degrees) / degrees, quantile(1.0 - tail, degrees) / degrees


def inside(squares: np.ndarray, degrees: np.ndarray, level: float = LEVEL) -> np.ndarray:
    """Which of ``squares (N,)`` lie within the interval of chi-square with their ``degrees (N,)``, half of the rest to either side."""
    from scipy.special import gammainc

    share, tail = gammainc(0.5 * degrees, 0.5 * squares), 0.5 * (1.0 - level)
    return np.asarray((share >= tail) & (share <= 1.0 - tail))
