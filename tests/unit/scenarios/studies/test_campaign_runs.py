"""Runs of a campaign: the same to the last bit however many there are, in whatever blocks, by
whoever; each again by its seed.
"""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from scenarios.studies.campaign import EstimatorRuns, Rebuilt, campaign_of, fly_campaign
from scenarios.studies.catalogue import load_document, load_scenario
from scenarios.studies.estimating import BATCH_MULTIPLE
from scenarios.studies.study import run_scenario
from scenarios.tasks.study import Execution, TaskRequest, run_study
from scenarios.tasks.work import RowTable, tasks_of
from sim.errors import FlightidError

SHORT = ("flight.duration=4 s", "flight.rate=50")
BATCHED = [
    ("rigid", "main"),
    ("flexible-ac1-equivalent", "main"),
    ("ballistic", "main"),
    ("rigid-process-noise-a", "main"),
]


@pytest.mark.sampled
@pytest.mark.parametrize(("name", "method"), BATCHED)
def test_a_row_does_not_depend_on_how_full_its_block_is(name: str, method: str) -> None:
    scenario = load_scenario(name, () if name == "ballistic" else SHORT)
    work = EstimatorRuns(
        scenario, next(each for each in scenario.estimations if each.name == method)
    )
    tasks = tasks_of(3, range(2 * BATCH_MULTIPLE + 3))
    whole = work.run(tasks)
    for first, last in ((0, 1), (0, 2), (1, 2), (5, 12), (BATCH_MULTIPLE, 2 * BATCH_MULTIPLE + 3)):
        assert work.run(tasks[first:last]) == whole[first:last]


@pytest.mark.long
@pytest.mark.parametrize("method", ["main", pytest.param("output-error", marks=pytest.mark.slow)])
def test_a_campaign_is_the_same_stopped_and_raised_and_in_processes(
    method: str, tmp_path: Path
) -> None:
    scenario = load_scenario("flexible-ac1-equivalent", SHORT)
    once = fly_campaign(scenario, 9, 4, method)
    fly_campaign(scenario, 5, 4, method, execution=Execution(1, tmp_path))
    raised = fly_campaign(scenario, 9, 4, method, execution=Execution(1, tmp_path, resume=True))
    shared = fly_campaign(scenario, 9, 4, method, execution=Execution(2, limit=60.0))
    for other in (raised, shared):
        for name in ("seeds", "values", "std", "nees", "nis", "degrees"):
            assert getattr(other, name).tobytes() == getattr(once, name).tobytes(), name
    with pytest.raises(
        FlightidError, match=r"another study: flight\.rate was 50\.0 and now is 25\.0"
    ):
        fly_campaign(
            load_scenario("flexible-ac1-equivalent", ("flight.duration=4 s", "flight.rate=25")),
            9,
            4,
            method,
            execution=Execution(1, tmp_path, True),
        )


def test_a_run_is_flown_again_by_its_seed_and_its_errors_are_weighed() -> None:
    scenario = load_scenario("rigid", SHORT)
    found = fly_campaign(scenario, 3, 7)
    for at, seed in enumerate(found.seeds):
        estimate = run_scenario(scenario, int(seed)).main.result.estimate
        np.testing.assert_allclose(found.values[:, at], estimate.values, rtol=1e-9)
        error = estimate.values - np.array([spread.reference for spread in found.spreads])
        assert found.nees[at] == pytest.approx(
            float(error @ np.linalg.inv(estimate.covariance) @ error), rel=1e-5
        )
        assert estimate.history is not None
        assert found.nis[at] == pytest.approx(float(estimate.history.nis.sum()), rel=1e-6)
        assert found.degrees[at] == int(estimate.history.degrees.sum())


def test_runs_that_break_down_are_counted_by_what_ended_them() -> None:
    scenario = load_scenario("rigid", SHORT)
    work = EstimatorRuns(scenario, scenario.estimations[0])
    whole = run_study(work, TaskRequest(7, 1))
    columns = {name: column.copy() for name, column in whole.columns.items()}
    columns["outcome"][[1, 4]] = "diverged"
    columns["outcome"][2], columns["error"][2] = None, "ended after 3 s, the time limit"
    found = campaign_of(work, RowTable(columns, 7, whole.times), 1)
    assert (
        found.failures == {"diverged": 2, "ended after 3 s, the time limit": 1}
        and found.broken == 3
    )
    assert found.values.shape == (6, 4) and found.kept.tolist() == [
        True,
        False,
        False,
        True,
        False,
        True,
        True,
    ]
    assert found.values[0].tolist() == columns["estimate:CL_alpha"][[0, 3, 5, 6]].tolist()
    columns["outcome"][[0, 3, 5]] = "diverged"
    with pytest.raises(FlightidError, match=r"6 of 7 runs broke down \(diverged\)"):
        campaign_of(work, RowTable(columns, 7, whole.times), 1)


def test_a_users_own_model_is_made_again_where_it_cannot_be_sent() -> None:
    document, name, where = load_document("own-model", ("flight.duration=5 s",))
    again = Rebuilt({key: value for key, value in document.items() if key != "kind"}, name, where)
    scenario = again.scenario()
    work = EstimatorRuns(scenario, scenario.estimations[1], again)
    sent = pickle.loads(pickle.dumps(work))
    assert sent.identity() == work.identity() and "own_model.py" in work.identity()["files"]
    assert sent.run(tasks_of(1, range(2))) == work.run(tasks_of(1, range(2)))
