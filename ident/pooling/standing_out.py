"""Flights whose value lies beyond the scatter of the others."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from ident.pooling.false_discovery import adjusted

NORMAL_QUARTILE = 0.6745  # of a Gaussian in standard deviations
RARE = 0.01  # rate of false discoveries among the flights that are told
FEWEST = 5  # flights: with fewer, the median is no measure of the others


def standing_out(residuals: np.ndarray, sigmas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """By how many standard deviations each flight is off ``(n,)``, and which stand out ``(n,)``, from what is left ``(n,)`` about a common value.

    Residuals are taken from their median; the scatter between flights is what their median absolute deviation shows beyond ``sigmas (n,)``, so that
    the flights sought do not hide themselves (Rousseeuw and Croux, J. American Statistical Association 88, 1993). False ones are controlled over
    all flights.
    """
    n = len(residuals)
    if n < FEWEST:
        return np.zeros(n), np.zeros(n, dtype=bool)
    off = residuals - np.median(residuals)
    spread = float(np.median(np.abs(off))) / NORMAL_QUARTILE
    between = max(0.0, spread**2 - float(np.median(sigmas)) ** 2)
    far = off / np.sqrt(sigmas**2 + between)
    p_values = 2.0 * ndtr(-np.abs(far))
    return far, adjusted(p_values) < RARE
