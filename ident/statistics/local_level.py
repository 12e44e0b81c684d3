"""Noise whose level changes along a series: found by its fourth differences, which hardly see motion, and divided out.

White noise with a burst of four times its level fails tests for whiteness more often than not, since a few loud samples weigh as much as
all others; divided by its local level it passes.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ident.statistics.robust import robust_sigma_about_zero

PARTS = 8
FEWEST = 40  # differences of a part
FACTOR = 1.5  # chosen: weights that are wrong by two in the variance hardly change a test
SCATTER = 1.6  # standard deviation of the logarithm of a robust sigma of n fourth differences, times sqrt(n), by simulation
SURE = 4.5  # of its standard deviations between the quietest and the loudest part: by chance once in 5000 series
MOTION = 1.25  # level by second over level by fourth differences, beyond which a part holds motion and tells no noise


def levelled(series: np.ndarray) -> np.ndarray:
    """A series ``(N,)`` over its local noise level, of the same mean level; itself where that does not change beyond chance.

    What varies slowly against the sampling stays as it is, so that a residual that is not noise is not hidden: a part whose second
    differences are larger than its fourth's takes its level from the others.
    """
    count = len(series)
    parts = min(PARTS, count // FEWEST)
    if parts < 3:
        return series
    second, fourth = _differences(series, 2)[1:-1], _differences(series, 4)
    edges = np.linspace(0, len(fourth), parts + 1).astype(int)
    levels = np.array([robust_sigma_about_zero(fourth[a:b]) for a, b in pairwise(edges)])
    seconds = np.array([robust_sigma_about_zero(second[a:b]) for a, b in pairwise(edges)])
    told = (levels > 0.0) & (seconds < MOTION * levels)
    if np.count_nonzero(told) < 3:
        return series
    ratio = float(levels[told].max() / levels[told].min())
    if ratio < FACTOR or np.log(ratio) < SURE * SCATTER * np.sqrt(2.0 * parts / len(fourth)):
        return series
    local = _running_level(fourth, int(len(fourth) / (4 * parts)))
    middle = np.clip(np.arange(count) - 2, 0, len(local) - 1)
    # A part with motion is no louder than the loudest part that tells.
    level = np.clip(local, levels[told].min(), levels[told].max())[middle]
    return np.asarray(series / level * np.sqrt(np.mean(level**2)))


def _differences(series: np.ndarray, order: int) -> np.ndarray:
    """Differences of an order, scaled so that white noise keeps its standard deviation: 6 and 70 are sums of squared binomials."""
    return np.diff(series, order) / np.sqrt({2: 6.0, 4: 70.0}[order])


def _running_level(fourth: np.ndarray, half: int) -> np.ndarray:
    """Robust sigma over windows of ``half`` to both sides, at every tenth of a window and linear between."""
    at = np.unique(np.linspace(0, len(fourth) - 1, max(2, 20 * len(fourth) // (2 * half))).astype(int))
    rough = [robust_sigma_about_zero(fourth[max(0, k - half) : k + half + 1]) for k in at]
    return np.interp(np.arange(len(fourth)), at, rough)
