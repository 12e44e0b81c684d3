"""The same filterpy subclass with the log-likelihood of every sample."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.peers.filterpy_ekf import filtered
from benchmarks.peers.short_period import Problem


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    return lambda: filtered(problem, problem["z"], likelihood=True)
