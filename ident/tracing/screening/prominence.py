"""How far do the peaks of a curve stand out? Their prominence, without the half second that loading
scipy.signal takes.
"""

from __future__ import annotations

import numpy as np


def prominent_peaks(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places of the inner peaks of a curve and their prominences, the most prominent first, the
    earlier of two equal ones first.

    A peak is a place higher than its neighbour before and no lower than the one after, from which
    the curve falls before it rises again; a level top counts at its first place. Its prominence is
    its height above the higher of the two lowest places between it and whatever is higher on either
    side, or the end.

    Parameters
    ----------
    y : ``(n,)``, finite.

    Returns
    -------
    Places ``(k,)`` and prominences ``(k,)`` in the unit of ``y``; both empty where the curve has no
    inner peak.
    """
    y = np.asarray(y, dtype=float)
    places, heights = [], []
    for i in range(1, len(y) - 1):
        if not y[i] > y[i - 1]:
            continue
        onward = y[i:] != y[i]
        if not onward.any() or y[i + int(onward.argmax())] > y[i]:
            continue  # the top reaches the end, or the curve goes on rising
        before, after = y[:i][::-1], y[i:]
        higher_before, higher_after = before > y[i], after > y[i]
        left = before[: int(higher_before.argmax())] if higher_before.any() else before
        right = after[: int(higher_after.argmax())] if higher_after.any() else after
        places.append(i)
        heights.append(y[i] - max(left.min(), right.min()))
    order = np.argsort(-np.array(heights), kind="stable").astype(int)
    return np.array(places, dtype=int)[order], np.array(heights, dtype=float)[order]
