"""One record through one extended Kalman filter, without and with likelihoods."""

from __future__ import annotations

from benchmarks.comparison.agreement import same_estimates_and_likelihood, same_histories
from benchmarks.comparison.job import Contender, Job, Problem
from benchmarks.jobs.rigid_flight import rigid_problem

OURS = Contender("flightid_ekf", "flightid", "flightid")
# A change of 1e-6 sigma is rounding; dynamax linearises the discrete step, which moves estimates by
# tenths of a sigma.
DYNAMAX = Contender("dynamax_ekf", "dynamax, jitted", "dynamax", ("dynamax", "jax"), tolerance=1.0)
SAME = """Eight seconds at 100 Hz of the scenario `rigid`: two states and six derivatives as states, Runge-Kutta for the mean, three terms of the
exponential for the covariance, Joseph's update; means and sigmas are kept at every sample. The subclass of filterpy has its Jacobian written by
hand for this one model; flightid works it out from the declared equations. What is timed is flightid's own kernel, `--engine batched`; by default a
single record is filtered by filterpy itself."""  # noqa: E501


def problem(small: bool) -> Problem:
    return rigid_problem(4.0 if small else 8.0)


PLAIN = Job(
    "ekf",
    "One record, one filter",
    f"{SAME} flightid computes likelihoods, innovations and the tests of them besides, filterpy "
    "here does not.",
    OURS,
    (Contender("filterpy_ekf", "filterpy, a subclass", "filterpy", ("filterpy",)),),
    problem,
    same_histories,
)
WITH_LIKELIHOODS = Job(
    "ekf-likelihood",
    "One record, one filter, with likelihoods",
    """The same, and everybody gives the log-likelihood. dynamax is jitted and linearises the Runge-Kutta step itself: its estimates differ by tenths
of a sigma.""",  # noqa: E501
    OURS,
    (
        Contender("filterpy_ekf_likelihood", "filterpy, a subclass", "filterpy", ("filterpy",)),
        DYNAMAX,
    ),
    problem,
    same_estimates_and_likelihood,
)
