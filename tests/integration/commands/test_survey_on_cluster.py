"""`flightid survey --cluster`: the files of a local survey to the last byte, from workers that
share no folder but that of the records.
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import flightid as fid
from scenarios.survey.flights import Diagnoses, read_flights, stored_diagnosis
from scenarios.survey.growing import run_flights, sent
from sim.errors import FlightidError
from tests.integration.command_line import CommandLine
from tests.integration.commands.test_survey_command import HEAD, LATE, short_flights
from tests.integration.commands.test_without_forks import written
from tests.unit.scenarios.tasks.dask_cluster import Cluster, cluster_of


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with cluster_of(tmp_path_factory.mktemp("cluster"), workers=2, nannies=1) as made:
        yield made


@pytest.fixture
def fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with three flights of which two are late, named by paths relative to
    it.
    """
    tables = short_flights(tmp_path, {"a": LATE, "b": 0.0, "c": LATE})
    (tmp_path / "flights.toml").write_text(HEAD + "\n".join(tables))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.long
def test_workers_write_the_same_survey(
    flightid: CommandLine, cluster: Cluster, fleet: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # what pages show of how they were made
    monkeypatch.setattr("sys.argv", ["flightid", "survey", "flights.toml"])
    here = flightid("survey", "flights.toml", "--jobs", "1", "--out", "here", "--figures", "png")
    there = flightid(
        "survey", "flights.toml", "--cluster", cluster.address, "--out", "there", "--figures", "png"
    )
    assert here.code == there.code == 0 and there.out == here.out.replace("here", "there")
    local, remote = written(fleet / "here"), written(fleet / "there")
    assert (
        local.keys() == remote.keys()
        and "flights/c/sets.json" in local
        and "flights/a/report.html" in local
    )
    for name, content in local.items():
        if name == "study.txt":  # says in which folder the survey lies
            content = content.replace(b"here", b"there")
        assert content == remote[name], name
    # Only what is new or changed is computed, by a cluster too; a flight that cannot be used ends
    # nothing.
    (fleet / "records" / "b.csv").write_text("time\n")
    again = fid.survey("flights.toml", "there", cluster=cluster.address)
    assert (again.computed, tuple(again.failed)) == ((), ("b",))


@pytest.mark.long
def test_ctrl_c_keeps_the_flights_that_have_come(cluster: Cluster, fleet: Path) -> None:
    asked = read_flights("flights.toml")

    def stop(stage: str, share: float) -> None:
        if share > 0.0:
            os.kill(os.getpid(), signal.SIGINT)

    since = time.monotonic()
    table = run_flights(
        Diagnoses(asked.flights, Path("morning")), 3, 1, Path("morning"), stop, cluster.address
    )
    kept = sorted(
        path.parent.name for path in (fleet / "morning" / "flights").glob("*/flight.json")
    )
    assert 1 <= len(table) < 3 and len(kept) == len(table) and time.monotonic() - since < 60.0
    assert not list((fleet / "morning").rglob("*.part")) and not list(
        (fleet / "morning").rglob(".?-*")
    )
    # so that the next survey leaves them as they are
    assert [
        flight.name for flight in asked.flights if stored_diagnosis(flight, Path("morning"))
    ] == kept


@pytest.mark.long
def test_a_worker_that_does_not_see_the_records_is_one_line(
    flightid: CommandLine, cluster: Cluster, fleet: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "scenarios.survey.growing.sent", lambda work: replace(sent(work), place=fleet / "other")
    )
    call = flightid("survey", "flights.toml", "--cluster", cluster.address, "--out", "out")
    line = call.err.splitlines()[-1]
    assert call.code == 2 and line.endswith(
        "put the flights on a disk that every worker sees at the same path"
    )
    assert (
        f"does not see {fleet / 'other' / 'records' / 'a.csv'}" in line
        and not (fleet / "out").exists()
    )


@pytest.mark.long
def test_a_scheduler_that_does_not_answer_is_one_line(flightid: CommandLine, fleet: Path) -> None:
    pytest.importorskip("distributed")
    call = flightid("survey", "flights.toml", "--cluster", "tcp://127.0.0.1:9", "--out", "out")
    assert call.code == 2 and "no Dask scheduler answers" in call.err.splitlines()[-1]
    assert "Traceback" not in call.err and not (fleet / "out").exists()


@pytest.mark.long
def test_a_failure_says_where_the_flights_are_kept(
    fleet: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(*given: Any) -> Iterator[list[Any]]:
        from scenarios.tasks.processes import run_block
        from scenarios.tasks.work import Task

        yield run_block(given[0], [Task(0, 0)])
        raise FlightidError(
            "the scheduler no longer answers", where="tcp://x", remedy="start it again"
        )

    monkeypatch.setattr("scenarios.tasks.cluster.run_on_cluster", lost)
    with pytest.raises(
        FlightidError,
        match=r"1 of 3 flights are kept in out; start it again, then give the same command again",
    ):
        fid.survey("flights.toml", "out", cluster="tcp://x")
    assert json.loads((fleet / "out" / "flights" / "a" / "flight.json").read_bytes())["name"] == "a"
