"""The same study on a Dask cluster: a real scheduler with workers in processes of their own, killed
and lost.
"""

from __future__ import annotations

import dataclasses
import os
import re
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest

from scenarios.files.sources import versions
from scenarios.tasks import cluster as on_cluster
from scenarios.tasks.study import TaskRequest, run_study
from scenarios.tasks.work import RowTable
from sim.errors import FlightidError
from tests.unit.scenarios.tasks.dask_cluster import Cluster, cluster_of
from tests.unit.scenarios.tasks.test_study import same
from tests.unit.scenarios.tasks.toy import Loads, Threads, Toy

COUNT = 60
ASKED = TaskRequest(COUNT, 7)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with cluster_of(tmp_path_factory.mktemp("cluster"), workers=2, nannies=1) as made:
        yield made


@pytest.fixture(scope="module")
def whole() -> RowTable:
    return run_study(Toy(), ASKED)


def _there(cluster: Cluster, asked: TaskRequest = ASKED) -> TaskRequest:
    return dataclasses.replace(asked, cluster=cluster.address)


@pytest.mark.long
def test_the_table_is_that_of_one_process(
    cluster: Cluster, whole: RowTable, tmp_path: Path
) -> None:
    assert same(run_study(Toy(), _there(cluster)), whole)
    kept = dataclasses.replace(_there(cluster), folder=tmp_path / "kept")
    assert same(
        run_study(Toy(), dataclasses.replace(kept, count=23)),
        run_study(Toy(), dataclasses.replace(ASKED, count=23)),
    )
    assert same(run_study(Toy(), dataclasses.replace(kept, resume=True)), whole)


@pytest.mark.long
def test_work_is_sent_once_to_each_worker_and_has_one_thread(cluster: Cluster) -> None:
    table = run_study(Loads(pause=0.1), _there(cluster))
    columns = pd.DataFrame(dict(table.columns))
    assert columns["loads"].eq(1).all() and columns["process"].nunique() == 2
    assert set(run_study(Threads(), _there(cluster)).columns["threads"]) == {1}


@pytest.mark.long
def test_what_fails_or_takes_too_long_is_recorded_and_ends_nothing(cluster: Cluster) -> None:
    work = Toy(raising=(9,), refused=(2,), killing=(21,))
    table, here = (
        run_study(work, _there(cluster)),
        run_study(work, dataclasses.replace(ASKED, jobs=2)),
    )
    assert same(table, here) and re.match(
        "2 processes died while they ran it", table.columns["error"][21]
    )
    late = run_study(Toy(stuck=(13,)), dataclasses.replace(_there(cluster), count=20, longest=0.7))
    assert [bool(error) for error in late.columns["error"]] == [
        number // 4 == 3 for number in range(20)
    ]
    assert late.columns["error"][12] == "ended after 0.7 s, the time limit"


@pytest.mark.long
def test_ctrl_c_ends_it_and_gives_up_what_was_sent(cluster: Cluster, whole: RowTable) -> None:
    from distributed import Client

    since: list[float] = []

    def stop(stage: str, share: float) -> None:
        if share > 0.2 and not since:
            since.append(time.monotonic())
            os.kill(os.getpid(), signal.SIGINT)

    table = run_study(Toy(pause=0.1), _there(cluster), stop)
    assert time.monotonic() - since[0] < 2.0 and 12 <= len(table) < COUNT
    assert same(
        table,
        RowTable(
            {n: c[table.columns["number"]] for n, c in whole.columns.items()}, COUNT, table.times
        ),
    )
    with Client(cluster.address, set_as_default=False) as client:
        until = time.monotonic() + 5.0
        while (
            left := client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks))
        ) and time.monotonic() < until:
            time.sleep(0.05)
    assert not left


def test_other_versions_there_are_refused(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = versions()
    monkeypatch.setattr("scenarios.tasks.cluster.versions", lambda: {**here, "scipy": "0.1"})
    with pytest.raises(
        FlightidError,
        match=r"the worker on \S+ has scipy [\d.]+, and here is 0.1; install on every worker",
    ) as told:
        run_study(Toy(), dataclasses.replace(_there(cluster), folder=tmp_path / "study" / "runs"))
    assert "\n" not in str(told.value) and not list(tmp_path.iterdir())


def test_nothing_answers_and_nothing_is_left_behind(
    cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(on_cluster, "CONNECTION_TIMEOUT", 0.5)
    for address in ("tcp://127.0.0.1:1", "http://127.0.0.1:1", "nonsense"):
        with pytest.raises(
            FlightidError,
            match=f"^{address}: no Dask scheduler answers .*; start one with dask scheduler",
        ):
            run_study(
                Toy(),
                dataclasses.replace(ASKED, cluster=address, folder=tmp_path / "study" / "runs"),
            )
    assert not list(tmp_path.iterdir())

    def of_http(address: str) -> str:
        raise MemoryError("Unable to allocate 3.07 EiB")

    with monkeypatch.context() as patched:
        patched.setattr(on_cluster, "_kind", of_http)
        with pytest.raises(FlightidError, match=r"^http://there: what answers there is no Dask"):
            run_study(
                Toy(),
                dataclasses.replace(
                    ASKED, cluster="http://there", folder=tmp_path / "study" / "runs"
                ),
            )
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(
        FlightidError,
        match=r"^--cluster: Dask is not installed; in the folder of the project: "
        r'python -m pip install -e "\.\[cluster\]"$',
    ):
        run_study(Toy(), _there(cluster))


@pytest.mark.long
def test_a_worker_without_flightid_says_so(tmp_path: Path) -> None:
    (tmp_path / "path" / "scenarios").mkdir(parents=True)
    (tmp_path / "path" / "scenarios" / "__init__.py").write_text(
        "raise ImportError('nothing here')"
    )
    words = r"the worker on \S+ has no flightid, or an older one \(nothing here\); have the same"
    with (
        cluster_of(tmp_path / "cluster", workers=1, path=tmp_path / "path") as made,
        pytest.raises(FlightidError, match=words),
    ):
        run_study(Toy(), _there(made))


def test_a_block_whose_worker_dies_is_run_by_another(
    cluster: Cluster, whole: RowTable, tmp_path: Path
) -> None:
    killed: list[str] = []

    def kill(stage: str, share: float) -> None:
        if share > 0.3 and not killed:
            cluster.kill_worker()
            killed.append(stage)

    kept = dataclasses.replace(_there(cluster), folder=tmp_path)
    assert same(run_study(Toy(pause=0.05), kept, kill), whole) and killed
    assert sorted(_rows(tmp_path)["number"]) == list(range(COUNT))
    cluster.start(workers=1)


@pytest.mark.long
def test_the_scheduler_is_lost_and_what_had_ended_is_kept(
    cluster: Cluster, whole: RowTable, tmp_path: Path
) -> None:
    kept = dataclasses.replace(_there(cluster), folder=tmp_path)
    killed: list[float] = []

    def kill(stage: str, share: float) -> None:
        if share > 0.4 and not killed:
            killed.append(time.monotonic())
            cluster.kill_scheduler()

    words = (
        r"the scheduler no longer answers; (\d+) of 60 runs are kept in \S+; start it again, then "
        r"go on with --resume$"
    )
    with pytest.raises(FlightidError, match=words) as told:
        run_study(Toy(pause=0.1), kept, kill)
    assert time.monotonic() - killed[0] < 10.0
    rows = _rows(tmp_path)
    assert rows["number"].is_unique and (rows["error"] == "").all()
    assert int(str(told.value).split("answers; ")[1].split()[0]) == len(rows) >= 24
    cluster.end()
    cluster.start(workers=1)
    assert same(run_study(Toy(), dataclasses.replace(kept, resume=True)), whole)


def _rows(folder: Path) -> pd.DataFrame:
    return pd.concat([pd.read_parquet(path) for path in folder.glob("rows-*.parquet")])
