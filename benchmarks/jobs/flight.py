"""The truth of the rigid flight, simulated, and its record."""

from __future__ import annotations

import numpy as np

from benchmarks.comparison.agreement import same_motion
from benchmarks.comparison.job import Contender, Job, Problem
from benchmarks.jobs.rigid_flight import rigid_problem
from benchmarks.peers import flightid_fly, scipy_dop853

LADDER = tuple(10.0**-k for k in range(3, 14))
# of the largest value: what motions must be within, and what one at the usual tolerance must
NEAR, USUAL = 1e-6, 1e-4


def exact_motion(problem: Problem) -> np.ndarray:
    """The motion under the held elevator by the matrix exponential over each sample, ``(2, N)``."""
    from scipy.linalg import expm

    from benchmarks.peers.short_period import linear_model, scales_of

    A, B = linear_model(scales_of(problem), problem["true"])
    block = np.zeros((3, 3))
    block[:2, :2], block[:2, 2:] = A, B
    step = expm(block * float(problem["time"][1] - problem["time"][0]))
    out = np.zeros((2, problem["time"].size))
    for k, u in enumerate(problem["elevator"][:-1]):
        out[:, k + 1] = step[:2, :2] @ out[:, k] + step[:2, 2] * u
    return out


def problem(small: bool) -> Problem:
    """The flight with its switches and levels, and the loosest tolerance that makes DOP853 as
    accurate as flightid.
    """
    base = rigid_problem(4.0 if small else 8.0)
    changes = np.flatnonzero(np.diff(base["elevator"])) + 1
    flown = {
        **base,
        "clean": exact_motion(base),
        "switches": base["time"][changes],
        "levels": np.append(0.0, base["elevator"][changes]),
    }
    size = np.max(np.abs(flown["clean"]), axis=1, keepdims=True)

    def error(clean: np.ndarray) -> float:
        return float(np.max(np.abs(clean - flown["clean"]) / size))

    ours = error(flightid_fly.prepare(flown)()["clean"])
    tolerance = next(
        (each for each in LADDER if error(scipy_dop853.flown(flown, each)) <= ours), LADDER[-1]
    )
    return {**flown, "tolerance": np.array(tolerance)}


JOB = Job(
    "truth",
    "Simulation of a flight",
    """The rigid aircraft through the 3-2-1-1, angle of attack and pitch rate at 100 Hz, then the noise of the sensors. DOP853 begins anew at
every switch; once it has the loosest tolerance at which it is as accurate as flightid in this run (1e-13 where none is), once 1e-6.
python-control samples the linear model exactly, which serves linear models only. Errors are against the matrix exponential.""",  # noqa: E501
    Contender("flightid_fly", "flightid", "flightid"),
    (
        Contender("scipy_dop853", "SciPy, DOP853 as accurate", "scipy", ("scipy",), tolerance=NEAR),
        Contender(
            "scipy_dop853_usual", "SciPy, DOP853 at 1e-6", "scipy", ("scipy",), tolerance=USUAL
        ),
        Contender("control_flight", "python-control", "control", ("control",), tolerance=NEAR),
    ),
    problem,
    same_motion,
)
