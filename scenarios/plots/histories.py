"""Rows of a filter's history by name, up to where the filter broke down, and axis limits that show where it settled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.estimate import FilterHistory

_HUGE = 1e30  # a filter that diverges may end near the largest number; a figure needs no more than this


@dataclass(frozen=True, eq=False)
class Course:
    """One entry of the filter's state over time: ``time``, ``mean``, ``std``, all ``(K,)``, K = sound samples."""

    time: np.ndarray
    mean: np.ndarray
    std: np.ndarray


def course(history: FilterHistory, name: str, factor: float = 1.0) -> Course:
    """Estimate and standard deviation of one state or parameter, multiplied by ``factor``; the samples after a breakdown are left out."""
    row, sound = history.names.index(name), sound_samples(history)
    mean = np.clip(factor * history.mean[row, :sound], -_HUGE, _HUGE)
    std = np.clip(factor * history.std[row, :sound], 0.0, _HUGE)
    return Course(history.time[:sound], mean, std)


def sound_samples(history: FilterHistory) -> int:
    """How many samples the filter got through; after a breakdown a history only repeats its last sound sample.

    A repeated sample has no measurement and an identity for a transition. A gap in the data has a transition of its own.
    """
    identity = np.eye(len(history.names))
    repeated = ~np.any(history.valid, axis=0) & np.all(history.transition == identity, axis=(1, 2))
    good = np.flatnonzero(~repeated)
    return int(good[-1]) + 1 if good.size else 0


def settled_limits(low: np.ndarray, middle: np.ndarray, high: np.ndarray, marks: Sequence[float]) -> tuple[float, float]:
    """Limits of an axis that show where a course ``(K,)`` ended, the marks, and of its early part what does not dwarf them."""
    half = len(middle) // 2
    ends = np.array([low[-1], high[-1], middle[half:].min(), middle[half:].max(), *marks])
    bottom, top = float(ends.min()), float(ends.max())
    span = top - bottom or abs(top) or 1.0
    bottom, top = max(bottom - 1.2 * span, min(bottom, float(middle.min()))), min(top + 1.2 * span, max(top, float(middle.max())))
    margin = 0.12 * (top - bottom or span)
    return bottom - margin, top + margin
