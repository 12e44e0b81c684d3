"""The linear closed loop by python-control's forced_response."""

from __future__ import annotations

from collections.abc import Callable

import control
import numpy as np

from benchmarks.peers.short_period import Problem


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    loop = control.ss(
        problem["A"], problem["B"], problem["C"], problem["D"], float(problem["frame"])
    )
    time, stick = problem["time"], problem["stick"]
    return lambda: {
        "clean": np.asarray(control.forced_response(loop, timepts=time, inputs=stick).outputs)
    }
