"""The X-29-like aircraft under its control law, a stick so small that nothing is limited."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.comparison.agreement import same_motion
from benchmarks.comparison.job import Contender, Job, Problem
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.linear import closed_loop
from sim.closed_loop.nonlinear import three_two_one_one

NEAR = 1e-6  # of the largest value; the curve of the stick's gearing alone accounts for 5e-8


def problem(small: bool) -> Problem:
    """The sampled closed loop as matrices, the stick at the frames, and its response marched."""
    x29 = load_x29("F")
    x29 = replace(x29, stick=replace(x29.stick, dead_band=0.0))
    loop = closed_loop(x29)
    time = x29.frame * np.arange(round((10.0 if small else 20.0) / x29.frame) + 1)
    stick = np.asarray(three_two_one_one(1e-6)(time))
    x, out = np.zeros(loop.A.shape[0]), np.zeros((3, time.size))
    for k, u in enumerate(stick):
        out[:, k] = loop.C[:3] @ x + loop.D[:3, 0] * u
        x = loop.A @ x + loop.B[:, 0] * u
    matrices = {name: np.asarray(getattr(loop, name)) for name in "ABCD"}
    return {
        **matrices,
        "C": matrices["C"][:3],
        "D": matrices["D"][:3],
        "frame": np.array(x29.frame),
        "time": time,
        "stick": stick,
        "clean": out,
    }


JOB = Job(
    "simulation",
    "Simulation of a closed loop",
    """The X-29-like aircraft under its control law for twenty seconds at 80 frames a second, a stick so small that no limit is met.
python-control has the linear loop, handed in as four matrices; flightid flies it with rate and travel limits, gearing and telemetry, which here
change nothing.""",  # noqa: E501
    Contender("flightid_loop", "flightid, with limits", "flightid"),
    (Contender("control_loop", "python-control, linear", "control", ("control",), tolerance=NEAR),),
    problem,
    same_motion,
)
