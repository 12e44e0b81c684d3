"""The same flight by DOP853 at a tolerance of 1e-6, as most would ask for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.peers import scipy_dop853
from benchmarks.peers.short_period import Problem

TOLERANCE = 1e-6


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    return scipy_dop853.prepare({**problem, "tolerance": np.array(TOLERANCE)})
