"""Output error by aeroid's identify, differences by its own choice.

aeroid takes an input as straight between samples. The elevator is held, so that it is handed in as
the mean of two samples, which is half a sample late like the hold; handed in as recorded, its
estimates are a dozen sigmas off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from aeroid import FlightData, Model, identify

from benchmarks.peers.names import DERIVATIVES, OUTPUTS
from benchmarks.peers.short_period import Problem, scales_of


def data_of(problem: Problem) -> FlightData:
    """The record as aeroid's."""
    elevator = problem["elevator"]
    between = 0.5 * (elevator + np.concatenate([elevator[:1], elevator[:-1]]))
    return FlightData(
        problem["time"], {"elevator": between, **dict(zip(OUTPUTS, problem["z"], strict=True))}
    )


def model_of(problem: Problem, stack: Callable[[list[Any]], Any]) -> Model:
    """The rigid short period; ``stack`` makes an array of two numbers."""
    lift, moment, hat = scales_of(problem)

    def dynamics(t: float, x: Any, u: Any, p: Mapping[str, float]) -> Any:
        CL = p["CL_alpha"] * x[0] + p["CL_q"] * hat * x[1] + p["CL_de"] * u[0]
        Cm = p["Cm_alpha"] * x[0] + p["Cm_q"] * hat * x[1] + p["Cm_de"] * u[0]
        return stack([x[1] - lift * CL, moment * Cm])

    return Model(
        OUTPUTS,
        ("elevator",),
        dict(zip(DERIVATIVES, problem["start"][2:].tolist(), strict=True)),
        dynamics,
    )


def identified(problem: Problem, model: Model, gradient: str) -> dict[str, np.ndarray]:
    """aeroid's estimates and sigmas, the motion beginning at rest."""
    weights = dict(zip(OUTPUTS, (1.0 / problem["noise_std"]).tolist(), strict=True))
    found = identify(
        model, data_of(problem), DERIVATIVES, weights=weights, x0=np.zeros(2), gradient=gradient
    )
    return {
        "estimate": np.array([found.parameters[name] for name in DERIVATIVES]),
        "estimate_std": np.array([found.stderr[name] for name in DERIVATIVES]),
    }


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    model = model_of(problem, np.array)
    return lambda: identified(problem, model, "fd")
