"""Is what is left as large where the aircraft hardly moves as where it does, and throughout? Rough air is; what a model of the forces lacks is not.

Nor is an episode: the wake of another aircraft is a gust, and no turbulence.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.statistics.rank_correlation import p_value_of_growth
from ident.tracing import thresholds
from ident.tracing.diagnosis import Requirement
from ident.whole_record.gauss_newton import Fit

Seconds = Sequence[tuple[np.ndarray, np.ndarray]]  # of each record: mean square of the motion, and of what is left


def is_even(fits: Sequence[Fit]) -> bool:
    """Whether enough seconds of all records say so."""
    return _even(seconds_of(fits)) is True


def is_uneven(fits: Sequence[Fit]) -> bool:
    """Whether enough seconds of all records deny it."""
    return _even(seconds_of(fits)) is False


def behind_gaps(fits: Sequence[Fit]) -> bool:
    """Whether most of what is left of a record lies right behind rows that are missing: nobody knows where inputs took the states meanwhile."""
    return any(_share_behind_gaps(fit, r) > thresholds.HALF_OF_IT for fit in fits for r in range(len(fit.lines)))


def what_is_uneven(fits: Sequence[Fit]) -> Requirement:
    """The requirement of rough air that what is left does not meet: no correlation with the motion, or no loud episode."""
    seconds = seconds_of(fits)
    chance = chance_that_even(seconds)
    if chance is not None and chance <= thresholds.EVEN:
        return Requirement("the p-value of no correlation between residual and motion", chance, thresholds.EVEN, at_least=True)
    asked = "the share of the residual's power in the loudest fifth of the time"
    return Requirement(asked, loudest_fifth(seconds), thresholds.EPISODE, at_least=False)


def what_lies_behind_gaps(fits: Sequence[Fit]) -> Requirement:
    """The largest share of what is left of a record that lies right behind missing rows, against its bar."""
    share = max(_share_behind_gaps(fit, r) for fit in fits for r in range(len(fit.lines)))
    return Requirement("the share of the residual's power right behind missing rows", share, thresholds.HALF_OF_IT, at_least=False)


def _share_behind_gaps(fit: Fit, r: int) -> float:
    time, left = fit.layout.problems[r].record.time, np.sum(fit.residuals[r] ** 2 / fit.variance[:, None], axis=0)
    steps = np.diff(time)
    behind = np.zeros(len(time), dtype=bool)
    for end in time[1:][steps > thresholds.GAP * np.median(steps)]:
        behind |= (time >= end) & (time < end + thresholds.WINDOW)
    return float(left[behind].sum() / (left.sum() + 1e-300))


def _even(seconds: Seconds) -> bool | None:
    chance = chance_that_even(seconds)
    return None if chance is None else chance > thresholds.EVEN and loudest_fifth(seconds) < thresholds.EPISODE


def loudest_fifth(seconds: Seconds) -> float:
    """Share of the power of what is left that falls into the loudest fifth of each record's seconds; the mean over records."""
    shares = []
    for _, unordered in seconds:
        left = np.sort(unordered)[::-1]
        shares.append(float(left[: max(1, round(0.2 * len(left)))].sum() / (left.sum() + 1e-300)))
    return float(np.mean(shares))


def chance_that_even(seconds: Seconds) -> float | None:
    """P-value of the rank correlation of what is left with the motion, over seconds of all records; None with too few of them."""
    moved, left = (np.concatenate(rows) for rows in zip(*seconds, strict=True))
    if len(moved) < thresholds.FEWEST_SECONDS:
        return None
    return p_value_of_growth(moved, left)


def seconds_of(fits: Sequence[Fit]) -> Seconds:
    """Each record of all fits, second by second."""
    return [_by_second(fit, r) for fit in fits for r in range(len(fit.lines))]


def _by_second(fit: Fit, r: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean square of the simulated motion, each output about its median and over its own size, and of the residual, second by second."""
    time, y = fit.layout.problems[r].record.time, fit.lines[r].y
    away = y - np.median(y, axis=1, keepdims=True)
    moved = np.mean((away / (np.std(away, axis=1, keepdims=True) + 1e-300)) ** 2, axis=0)
    left = np.mean(fit.residuals[r] ** 2 / fit.variance[:, None], axis=0)
    edges = np.searchsorted(time, np.arange(time[0], time[-1], 1.0))
    counts = np.diff(np.append(edges, len(time)))
    inside = counts > 0
    return np.add.reduceat(moved, edges[inside]) / counts[inside], np.add.reduceat(left, edges[inside]) / counts[inside]
