"""Output error as the handbooks' first program: SciPy's least_squares on a simulation loop in plain
Python.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

from benchmarks.peers.short_period import Problem, rk4, scales_of


def solved(problem: Problem, simulate: Callable[[np.ndarray], np.ndarray]) -> dict[str, np.ndarray]:
    """Six derivatives whose simulated outputs ``(2, N)`` come nearest, with their sigmas."""
    z, weight, start = problem["z"], 1.0 / problem["noise_std"][:, None], problem["start"][2:]
    found = least_squares(
        lambda p: ((z - simulate(p)) * weight).ravel(), start, x_scale=np.abs(start), xtol=1e-10
    )
    return {
        "estimate": found.x,
        "estimate_std": np.sqrt(np.diagonal(np.linalg.inv(found.jac.T @ found.jac))),
    }


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    scales, elevator = scales_of(problem), problem["elevator"].tolist()
    dt, N = float(problem["time"][1] - problem["time"][0]), len(elevator)

    def simulate(p: np.ndarray) -> np.ndarray:
        values, out, alpha, q = p.tolist(), np.zeros((2, N)), 0.0, 0.0
        for k in range(1, N):
            alpha, q = rk4(scales, alpha, q, elevator[k - 1], values, dt)
            out[0, k], out[1, k] = alpha, q
        return out

    return lambda: solved(problem, simulate)
