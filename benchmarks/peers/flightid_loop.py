"""flightid's flight under the control law, with its limits, gearing and telemetry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.peers.short_period import Problem
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.nonlinear import fly_closed_loop


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    x29, duration = load_x29("F"), float(problem["time"][-1])
    straight = replace(x29, stick=replace(x29.stick, dead_band=0.0))

    def work() -> dict[str, np.ndarray]:
        _, truth = fly_closed_loop(straight, problem["stick"], duration)
        return {"clean": np.array([truth.alpha, truth.q, truth.nz - 1.0])}

    return work
