"""Interleaved timing, and what is told of it: medians and quartiles of times, and of ratios round
by round.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

FEWEST = 3  # rounds that everybody takes part in, however long they are
SHORTEST = 0.02  # s: what is shorter is done several times in a row


class Quartiles(NamedTuple):
    """Median with the lower and upper quartile of ``number`` values."""

    median: float
    lower: float
    upper: float
    number: int


def quartiles(values: Sequence[float]) -> Quartiles:
    lower, median, upper = np.quantile(np.asarray(values, dtype=float), [0.25, 0.5, 0.75])
    return Quartiles(float(median), float(lower), float(upper), len(values))


def interleaved(
    works: Mapping[str, Callable[[], Any]],
    rounds: int,
    patience: float,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, list[float]]:
    """Seconds of each work, round by round in turn: A B C A B C ...

    The first calls of each are not counted but tell how often it fits into ``SHORTEST``. Who has
    used up its ``patience``, s, after ``FEWEST`` rounds takes no further part, so that lists may be
    of different length; the k-th entries are of one round.
    """
    often: dict[str, int] = {}
    for name, work in works.items():
        # the first call of all may compile; what is long all the same is warm enough after it
        for _ in range(2):
            begin = clock()
            work()
            took = clock() - begin
            if took > patience:
                break
        often[name] = max(1, round(SHORTEST / max(took, 1e-9)))
    times: dict[str, list[float]] = {name: [] for name in works}
    for turn in range(rounds):
        for name, work in works.items():
            if turn >= FEWEST and sum(times[name]) * often[name] > patience:
                continue
            begin = clock()
            for _ in range(often[name]):
                work()
            times[name].append((clock() - begin) / often[name])
    return times


def ratios(theirs: Sequence[float], ours: Sequence[float]) -> Quartiles:
    """How many times longer theirs takes, paired by round."""
    return quartiles([a / b for a, b in zip(theirs, ours, strict=False)])
