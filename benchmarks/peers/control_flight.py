"""The rigid flight by python-control: the linear model sampled with its input held, which is exact,
and forced_response.
"""

from __future__ import annotations

from collections.abc import Callable

import control
import numpy as np

from benchmarks.peers.short_period import Problem, linear_model, scales_of


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    time, elevator, std = problem["time"], problem["elevator"], problem["noise_std"][:, None]

    def work() -> dict[str, np.ndarray]:
        A, B = linear_model(scales_of(problem), problem["true"])
        sampled = control.ss(A, B, np.eye(2), np.zeros((2, 1))).sample(
            float(time[1] - time[0]), "zoh"
        )
        clean = np.asarray(control.forced_response(sampled, timepts=time, inputs=elevator).outputs)
        return {
            "clean": clean,
            "z": clean + std * np.random.default_rng(1).standard_normal(clean.shape),
        }

    return work
