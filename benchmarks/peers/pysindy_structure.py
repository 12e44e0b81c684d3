"""Sequentially thresholded least squares by pysindy, the columns handed in as the library."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pysindy import STLSQ

from benchmarks.peers.least_squares import answer_of
from benchmarks.peers.short_period import Problem

THRESHOLD = 0.15  # of columns of variance one, whose factors are 0.4 at least


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    def work() -> dict[str, np.ndarray]:
        found = STLSQ(threshold=THRESHOLD, alpha=0.0)
        found.fit(problem["columns"], problem["coefficients"].T)
        return answer_of(problem, [np.flatnonzero(row).tolist() for row in found.coef_])

    return work
