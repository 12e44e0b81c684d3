"""The same flight measured a thousand times, a filter for each."""

from __future__ import annotations

import numpy as np

from benchmarks.comparison.agreement import same_estimates_and_likelihood
from benchmarks.comparison.job import Contender, Job, Problem
from benchmarks.jobs.rigid_flight import rigid_problem
from benchmarks.peers.c_bank import compiler

RUNS, SHARE = 1000, 5


def problem(small: bool) -> Problem:
    return {**rigid_problem(8.0, RUNS), "share": np.array(SHARE)}


JOB = Job(
    "many-runs",
    "A thousand runs",
    f"""The record above with {RUNS} draws of its noise, a filter each: final estimates, sigmas and log-likelihoods. filterpy takes one record
after the other; {SHARE} are timed and scaled to {RUNS}. The C is written by hand for this one model, is compiled when it starts (part of its cold
start), and uses what is zero in its matrices. dynamax runs under jit and vmap, and linearises the Runge-Kutta step itself.""",  # noqa: E501
    Contender("flightid_bank", "flightid, batched", "flightid"),
    (
        Contender(
            "filterpy_one_by_one",
            "filterpy, one by one",
            "filterpy",
            ("filterpy",),
            share=SHARE / RUNS,
        ),
        Contender("dynamax_bank", "dynamax, jitted", "dynamax", ("dynamax", "jax"), tolerance=1.0),
        Contender("c_bank", "C by hand", missing=lambda: "" if compiler() else "no C compiler"),
    ),
    problem,
    same_estimates_and_likelihood,
)
