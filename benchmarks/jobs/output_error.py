"""An output-error fit of one record."""

from __future__ import annotations

from benchmarks.comparison.agreement import same_estimates
from benchmarks.comparison.job import Contender, Job, Problem
from benchmarks.jobs.rigid_flight import rigid_problem


def problem(small: bool) -> Problem:
    return rigid_problem(4.0 if small else 8.0)


JOB = Job(
    "output-error",
    "Output error",
    """The same record, six derivatives, the motion beginning at rest. flightid estimates the noise of each channel and corrects the sigmas for
coloured residuals; the others are told the noise. `lfilter` serves models that are linear in their states only, and its transfer function is written
for this one. aeroid takes inputs as straight between samples: it is handed the mean of two samples, without which it is a dozen sigmas off.""",  # noqa: E501
    Contender("flightid_fit", "flightid", "flightid"),
    (
        Contender(
            "scipy_lfilter", "SciPy, least_squares on lfilter", "scipy", ("scipy",), tolerance=0.1
        ),
        Contender(
            "scipy_loop", "SciPy, least_squares on a plain loop", "scipy", ("scipy",), tolerance=0.1
        ),
        Contender("aeroid_fit", "aeroid, differences", "aeroid", ("aeroid",), tolerance=0.5),
        Contender(
            "aeroid_jax", "aeroid, gradient by JAX", "aeroid", ("aeroid", "jax"), tolerance=0.5
        ),
    ),
    problem,
    same_estimates,
)
