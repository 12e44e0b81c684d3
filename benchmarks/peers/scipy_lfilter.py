"""Output error on the exact discrete transfer functions of the linear model by
scipy.signal.lfilter: the quick way where a model is linear.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from benchmarks.peers.scipy_loop import solved
from benchmarks.peers.short_period import Problem, linear_model, scales_of


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    scales, elevator = scales_of(problem), problem["elevator"]
    dt = float(problem["time"][1] - problem["time"][0])

    def simulate(p: np.ndarray) -> np.ndarray:
        A, B = linear_model(scales, p)
        block = np.zeros((3, 3))
        block[:2, :2], block[:2, 2:] = A, B
        held = expm(block * dt)
        Ad, Bd = held[:2, :2], held[:2, 2]
        # (z I - Ad)^-1 = (z I + Ad - tr(Ad) I) / (z^2 - tr(Ad) z + det(Ad)) of a matrix of two
        # rows.
        trace, below = np.trace(Ad), [1.0, -np.trace(Ad), np.linalg.det(Ad)]
        second = Ad @ Bd - trace * Bd
        return np.stack([lfilter([0.0, Bd[i], second[i]], below, elevator) for i in range(2)])

    return lambda: solved(problem, simulate)
