"""Every contender of every job gives flightid's answer on a small problem; who is not installed is
skipped with the reason.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import import_module

import numpy as np
import pytest

from benchmarks.comparison.job import Answer, Contender, Job, Problem
from benchmarks.jobs import flight
from benchmarks.jobs.catalogue import JOBS
from benchmarks.jobs.rigid_flight import rigid_problem

DEAR = {"dynamax", "aeroid", "pysindy"}  # seconds to import and compile
PAIRS = [
    pytest.param(
        job,
        peer,
        id=f"{job.name}-{peer.module}",
        marks=[pytest.mark.slow] if DEAR.intersection(peer.needs) else [],
    )
    for job in JOBS
    for peer in job.peers
]
SMALL: Mapping[str, Problem] = {"many-runs": {**rigid_problem(4.0, 3), "share": np.array(2)}}


@cache
def problem(job: Job) -> Problem:
    return SMALL.get(job.name) or job.problem(True)


@cache
def answer(job: Job, contender: Contender) -> Answer:
    found: Answer = import_module(f"benchmarks.peers.{contender.module}").prepare(problem(job))()
    return found


@pytest.mark.sampled
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(("job", "peer"), PAIRS)
def test_a_peer_gives_the_same_answer(job: Job, peer: Contender) -> None:
    if peer.absent:
        pytest.skip(peer.absent)
    agreement = job.check(problem(job), answer(job, job.ours), answer(job, peer), peer.tolerance)
    assert agreement.near, agreement.said


@pytest.mark.parametrize("job", JOBS, ids=lambda job: job.name)
def test_another_answer_is_seen(job: Job) -> None:
    ours = answer(job, job.ours)
    other = {name: values * 1.01 for name, values in ours.items()}
    if "estimate" in ours:
        other = {**ours, "estimate": ours["estimate"] + 2.0 * ours["estimate_std"]}
    for peer in job.peers:
        assert not job.check(problem(job), ours, other, peer.tolerance).near, peer.label


def test_the_c_by_hand_does_every_run() -> None:
    job = next(job for job in JOBS if job.name == "many-runs")
    by_hand = next(peer for peer in job.peers if peer.module == "c_bank")
    if by_hand.absent:
        pytest.skip(by_hand.absent)
    assert (
        answer(job, by_hand)["estimate"].shape == answer(job, job.ours)["estimate"].shape == (6, 3)
    )


def test_dop853_is_asked_for_flightids_accuracy_and_no_more() -> None:
    from benchmarks.peers import flightid_fly, scipy_dop853

    flown = flight.problem(True)
    tolerance = float(flown["tolerance"])

    def error(clean: np.ndarray) -> float:
        return float(
            np.max(
                np.abs(clean - flown["clean"])
                / np.max(np.abs(flown["clean"]), axis=1, keepdims=True)
            )
        )

    ours = error(flightid_fly.prepare(flown)()["clean"])
    assert tolerance == flight.LADDER[-1] or error(scipy_dop853.flown(flown, tolerance)) <= ours
    assert (
        tolerance == flight.LADDER[0] or error(scipy_dop853.flown(flown, 10.0 * tolerance)) > ours
    )
