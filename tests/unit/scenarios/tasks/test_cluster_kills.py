"""The scheduler and the workers of a Dask cluster killed at moments drawn at random: what is
resumed has the table of one that ran through.
"""

from __future__ import annotations

import dataclasses
import random
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest

from scenarios.tasks.study import TaskRequest, run_study
from scenarios.tasks.work import RowTable
from sim.errors import FlightidError
from tests.unit.scenarios.tasks.dask_cluster import Cluster, cluster_of
from tests.unit.scenarios.tasks.test_study import same
from tests.unit.scenarios.tasks.toy import Toy

MOMENTS = 20
WORK, ASKED = Toy(pause=0.04), TaskRequest(200, 11)  # 50 blocks: about 1 s of two workers

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def whole() -> RowTable:
    return run_study(dataclasses.replace(WORK, pause=0.0), ASKED)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with cluster_of(tmp_path_factory.mktemp("cluster")) as made:
        yield made


@pytest.mark.parametrize("moment", range(MOMENTS))
def test_the_scheduler_is_killed(
    moment: int, cluster: Cluster, tmp_path: Path, whole: RowTable
) -> None:
    asked = dataclasses.replace(ASKED, folder=tmp_path / "kept", cluster=cluster.address)
    begun = threading.Event()

    def kill() -> None:
        begun.wait()
        time.sleep(random.Random(moment).uniform(0.0, 1.5))
        cluster.kill_scheduler()

    killer = threading.Thread(target=kill)
    killer.start()
    since = time.monotonic()
    try:
        assert same(run_study(WORK, asked, lambda stage, share: begun.set()), whole)
    except FlightidError as lost:
        assert "no longer answers" in str(lost) or "no Dask scheduler answers" in str(lost)
    assert time.monotonic() - since < 20.0
    killer.join()
    cluster.end()
    cluster.start()
    resumed = dataclasses.replace(asked, resume=(tmp_path / "kept" / "manifest.json").exists())
    assert same(run_study(dataclasses.replace(WORK, pause=0.0), resumed), whole)
    assert _each_once(tmp_path / "kept")


@pytest.mark.parametrize("moment", range(MOMENTS))
def test_a_worker_is_killed(moment: int, cluster: Cluster, tmp_path: Path, whole: RowTable) -> None:
    cluster.ready(2)
    begun = threading.Event()

    def kill() -> None:
        begun.wait()
        time.sleep(random.Random(100 + moment).uniform(0.0, 1.5))
        cluster.kill_worker()
        cluster.start(workers=1)

    killer = threading.Thread(target=kill)
    killer.start()
    asked = dataclasses.replace(ASKED, folder=tmp_path / "kept", cluster=cluster.address)
    table = run_study(WORK, asked, lambda stage, share: begun.set())
    killer.join()
    assert same(table, whole) and _each_once(tmp_path / "kept")


def _each_once(folder: Path) -> bool:
    rows = pd.concat([pd.read_parquet(path) for path in folder.glob("rows-*.parquet")])
    return sorted(rows["number"]) == list(range(ASKED.count))
