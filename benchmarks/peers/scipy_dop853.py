"""The rigid flight by SciPy's DOP853, begun anew at every switch of the elevator, at the tolerance
that gives flightid's accuracy.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.peers.short_period import Problem, rates, scales_of

SLACK = 1e-9  # s: samples at 0.01 k and switches differ by rounding


def flown(problem: Problem, tolerance: float) -> np.ndarray:
    """Angle of attack and pitch rate at the samples, ``(2, N)``, without noise."""
    scales, p, time = scales_of(problem), problem["true"].tolist(), problem["time"]
    edges = [
        float(time[0]),
        *(t for t in problem["switches"].tolist() if t < time[-1]),
        float(time[-1]),
    ]
    out, state = np.zeros((2, len(time))), np.zeros(2)
    for begin, end, level in zip(edges[:-1], edges[1:], problem["levels"].tolist(), strict=False):

        def motion(t: float, x: np.ndarray, u: float = level) -> tuple[float, float]:
            return rates(scales, x[0], x[1], u, p)

        inside = (time >= begin - SLACK) & (time < end - SLACK)
        at = np.append(np.maximum(time[inside], begin), end)
        found = solve_ivp(
            motion,
            (begin, end),
            state,
            method="DOP853",
            t_eval=at,
            rtol=tolerance,
            atol=1e-3 * tolerance,
        )
        out[:, inside], state = found.y[:, :-1], found.y[:, -1]
    out[:, -1] = state
    return out


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    tolerance, std = float(problem["tolerance"]), problem["noise_std"][:, None]

    def work() -> dict[str, np.ndarray]:
        clean = flown(problem, tolerance)
        return {
            "clean": clean,
            "z": clean + std * np.random.default_rng(1).standard_normal(clean.shape),
        }

    return work
