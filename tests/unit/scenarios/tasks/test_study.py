"""A study's table: the same for any number of processes, for what was stopped, resumed, raised,
killed or damaged.
"""

from __future__ import annotations

import dataclasses
import errno
import io
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from scenarios.tasks import work as shards
from scenarios.tasks.processes import START_METHOD, THREADS
from scenarios.tasks.study import TaskRequest, run_study
from scenarios.tasks.work import RowTable, tasks_of
from sim.errors import FlightidError
from tests.unit.scenarios.tasks.toy import Toy, row_of

COUNT = 30
ASKED = TaskRequest(COUNT, 7)


def same(one: RowTable, other: RowTable) -> bool:
    """To the last bit."""
    if list(one.columns) != list(other.columns) or len(one) != len(other):
        return False
    return all(
        a.tobytes() == b.tobytes() if a.dtype != object else a.tolist() == b.tolist()
        for a, b in zip(one.columns.values(), other.columns.values(), strict=True)
    )


@pytest.fixture(scope="module")
def whole() -> RowTable:
    return run_study(Toy(), ASKED)


def test_the_table_is_the_rows_of_its_tasks(whole: RowTable) -> None:
    assert whole.whole and whole.sound.all()
    for at, task in enumerate(tasks_of(7, range(COUNT))):
        row = row_of(task)
        assert whole.columns["number"][at] == task.number and whole.columns["seed"][at] == task.seed
        assert whole.columns["x"][at] == row["x"] and whole.columns["n"][at] == row["n"]
        assert whole.columns["flag"][at] is row["flag"] and whole.columns["word"][at] == row["word"]
        assert (
            np.isnan(whole.columns["gap"][at])
            if row["gap"] is None
            else whole.columns["gap"][at] == row["gap"]
        )


@pytest.mark.sampled
@pytest.mark.parametrize("jobs", [2, 3])
def test_processes_give_the_same_table(whole: RowTable, jobs: int, tmp_path: Path) -> None:
    assert same(run_study(Toy(), dataclasses.replace(ASKED, jobs=jobs)), whole)
    assert same(
        run_study(Toy(quick=True), dataclasses.replace(ASKED, jobs=jobs, folder=tmp_path / "kept")),
        whole,
    )


@pytest.mark.long
@pytest.mark.parametrize("jobs", [2, 3])
def test_processes_that_are_started_afresh_give_the_same_table(
    whole: RowTable, jobs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(START_METHOD, "spawn")

    def no_fork() -> int:
        raise AssertionError("forked")

    monkeypatch.setattr(os, "fork", no_fork)
    assert same(run_study(Toy(), dataclasses.replace(ASKED, jobs=jobs)), whole)
    killed = run_study(Toy(killing=(13,)), dataclasses.replace(ASKED, jobs=jobs))
    monkeypatch.undo()
    assert same(killed, run_study(Toy(killing=(13,)), dataclasses.replace(ASKED, jobs=2)))


def test_ctrl_c_ends_processes_that_are_started_afresh(
    whole: RowTable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(START_METHOD, "spawn")

    def stop(stage: str, share: float) -> None:
        if share > 0.2:
            os.kill(os.getpid(), signal.SIGINT)

    table = run_study(Toy(pause=0.1), dataclasses.replace(ASKED, jobs=2), stop)
    assert 0 < len(table) < COUNT
    assert same(
        table,
        RowTable(
            {n: c[table.columns["number"]] for n, c in whole.columns.items()}, COUNT, table.times
        ),
    )


def test_the_lock_of_windows_is_of_the_first_byte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import fcntl

    def locking(descriptor: int, mode: int, count: int) -> None:
        assert (mode, count) == (2, 1)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)

    monkeypatch.setitem(sys.modules, "msvcrt", SimpleNamespace(locking=locking, LK_NBLCK=2))
    monkeypatch.setitem(sys.modules, "fcntl", None)
    with (
        shards.locked(tmp_path),
        pytest.raises(FlightidError, match="another process is writing here"),
        shards.locked(tmp_path),
    ):
        pass
    with shards.locked(tmp_path):
        pass


def test_a_study_is_resumed_raised_and_cut(whole: RowTable, tmp_path: Path) -> None:
    for count in (1, 11, 19, COUNT, COUNT, 12):
        kept = dataclasses.replace(ASKED, count=count, folder=tmp_path, resume=count > 1)
        table = run_study(Toy(), kept)
        assert len(table) == count and same(
            table, RowTable({n: c[:count] for n, c in whole.columns.items()}, count, table.times)
        )
    assert json.loads((tmp_path / "manifest.json").read_text())["count"] == COUNT


def test_only_what_is_missing_is_computed(tmp_path: Path) -> None:
    run_study(Toy(), dataclasses.replace(ASKED, count=10, folder=tmp_path))
    # of the same identity: what it refuses is not asked of it
    refusing = Toy(refused=tuple(range(10)))
    assert run_study(refusing, dataclasses.replace(ASKED, folder=tmp_path, resume=True)).sound.all()


def test_a_task_that_fails_is_recorded_and_ends_nothing() -> None:
    work = Toy(raising=(9,), refused=(2,))
    one, two = run_study(work, ASKED), run_study(work, dataclasses.replace(ASKED, jobs=2))
    assert same(one, two) and one.whole
    assert one.columns["error"][2] == "no row of 2" and one.columns["error"][3] == ""
    assert set(one.columns["error"][8:12]) == {"ValueError: a task that raises"}
    assert np.isnan(one.columns["x"][2]) and one.columns["word"][2] is None


def test_a_cell_of_another_type_is_an_error() -> None:
    class Wrong(Toy):
        def run(self, tasks):
            return [
                {**row_of(task), "n": 1.5} if task.number == 1 else {"x": 1.0} for task in tasks
            ]

    errors = run_study(Wrong(), TaskRequest(2, 7)).columns["error"]
    assert "column" in errors[0] and "declared" in errors[0] and "1.5" in errors[1]


def test_a_process_that_dies_is_replaced(whole: RowTable, tmp_path: Path) -> None:
    table = run_study(Toy(killing=(5, 17), once=tmp_path), dataclasses.replace(ASKED, jobs=2))
    assert same(table, whole)


def test_what_kills_every_process_is_given_up_and_tried_again_when_resumed(
    whole: RowTable, tmp_path: Path
) -> None:
    asked = dataclasses.replace(ASKED, jobs=2, folder=tmp_path)
    table = run_study(Toy(killing=(5,)), asked)
    assert table.whole and list(np.flatnonzero(~table.sound)) == [4, 5, 6, 7]
    assert all("2 processes died" in error for error in table.columns["error"][4:8])
    assert same(run_study(Toy(), dataclasses.replace(asked, resume=True)), whole)


def test_what_takes_too_long_is_ended_and_tried_again(whole: RowTable, tmp_path: Path) -> None:
    asked = dataclasses.replace(ASKED, count=12, folder=tmp_path, longest=0.7)
    table = run_study(Toy(stuck=(5,)), asked)
    assert (
        table.whole
        and [error[:17] for error in table.columns["error"]]
        == [""] * 4 + ["ended after 0.7 s"] * 4 + [""] * 4
    )
    assert same(run_study(Toy(), dataclasses.replace(ASKED, folder=tmp_path, resume=True)), whole)


def test_ctrl_c_ends_it_within_two_seconds_and_keeps_what_had_ended(
    whole: RowTable, tmp_path: Path
) -> None:
    asked = dataclasses.replace(ASKED, jobs=2, folder=tmp_path)
    came: list[float] = []

    def stop() -> None:
        came.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(1.0, stop)

    def tell(stage: str, share: float) -> None:
        if share > 0.0 and timer.ident is None:  # processes start, on a busy machine, when they may
            timer.start()

    table = run_study(Toy(stuck=(9, 21)), asked, tell)
    assert time.monotonic() - came[0] < 2.0
    assert 0 < len(table) < COUNT and not table.whole and table.sound.all()
    assert same(run_study(Toy(), dataclasses.replace(asked, resume=True)), whole)


@pytest.mark.parametrize(
    ("change", "work", "says"),
    [
        ({"resume": False}, Toy(), "a study is kept here"),
        ({"root": 8}, Toy(), "seed was 7 and now is 8"),
        ({}, Toy(meaning=2), "meaning was 1 and now is 2"),
        ({}, Toy(block=5), "block was 4 and now is 5"),
    ],
)
def test_another_study_is_refused(
    tmp_path: Path, change: dict[str, object], work: Toy, says: str
) -> None:
    kept = dataclasses.replace(ASKED, folder=tmp_path)
    run_study(Toy(), kept)
    with pytest.raises(FlightidError, match=says):
        run_study(work, dataclasses.replace(kept, **{"resume": True, **change}))  # type: ignore[arg-type]


def test_nothing_to_resume(tmp_path: Path) -> None:
    with pytest.raises(FlightidError, match="no folder to go on with"):
        run_study(Toy(), dataclasses.replace(ASKED, resume=True))
    with pytest.raises(FlightidError, match="no study to go on with"):
        run_study(Toy(), dataclasses.replace(ASKED, folder=tmp_path, resume=True))


def test_one_process_a_folder(tmp_path: Path) -> None:
    with shards.locked(tmp_path), pytest.raises(FlightidError, match="another process"):
        run_study(Toy(), dataclasses.replace(ASKED, folder=tmp_path))


def test_damaged_and_half_written_shards_are_computed_again(
    whole: RowTable, tmp_path: Path
) -> None:
    kept = dataclasses.replace(ASKED, folder=tmp_path)
    run_study(Toy(), dataclasses.replace(kept, count=10))
    run_study(Toy(), dataclasses.replace(kept, count=20, resume=True))
    first = sorted(tmp_path.glob("rows-*.parquet"))[0]
    data = bytearray(first.read_bytes())
    data[len(data) // 3] ^= 0xFF
    first.write_bytes(data)
    (tmp_path / ".rows-000009.parquet.part").write_bytes(b"PAR1")
    assert same(run_study(Toy(), dataclasses.replace(kept, resume=True)), whole)
    assert [path.name for path in tmp_path.glob("*.damaged")] == [
        "rows-000000.damaged"
    ] and not list(tmp_path.glob(".*.part"))


def test_many_shards_become_one_and_a_kill_between_costs_nothing(
    whole: RowTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shards, "SHARD_INTERVAL", -1.0)
    monkeypatch.setattr(shards, "MOST_SHARDS", 3)
    kept = dataclasses.replace(ASKED, folder=tmp_path)
    with monkeypatch.context() as inner:
        inner.setattr(Path, "unlink", lambda *a, **k: None)  # killed after the new shard is there
        assert same(run_study(Toy(), kept), whole)
    assert len(list(tmp_path.glob("rows-*"))) == 9
    assert same(run_study(Toy(), dataclasses.replace(kept, resume=True)), whole)
    assert len(list(tmp_path.glob("rows-*"))) == 1
    assert same(run_study(Toy(), dataclasses.replace(kept, resume=True)), whole)


def test_a_full_disk_is_one_line_and_costs_no_row(
    whole: RowTable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shards, "SHARD_INTERVAL", -1.0)
    kept = dataclasses.replace(ASKED, folder=tmp_path)
    calls: list[int] = []

    def full(handle: int) -> None:
        calls.append(handle)
        if len(calls) == 4:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as inner:
        inner.setattr(os, "fsync", full)
        with pytest.raises(
            FlightidError, match=r"No space left on device\); \d+ of 30 runs are kept; make room"
        ):
            run_study(Toy(), kept)
    assert not list(tmp_path.glob(".*.part"))
    assert same(run_study(Toy(), dataclasses.replace(kept, resume=True)), whole)


def test_progress_counts_what_was_kept_and_shares_what_is_left(tmp_path: Path) -> None:
    kept = dataclasses.replace(ASKED, folder=tmp_path, unit="flights")
    told: list[tuple[str, float]] = []
    run_study(Toy(), dataclasses.replace(kept, count=10))
    run_study(
        Toy(),
        dataclasses.replace(kept, resume=True),
        lambda stage, share: told.append((stage, share)),
    )
    assert told[0] == ("10 of 30 flights", 0.0) and told[-1][1] == 1.0
    # from which the time that is left is told; block 2 begins at task 8, of which 10 and 11 are
    # missing
    assert told[1][1] == 2 / 20
    assert told[-1][0].startswith("30 of 30 flights, ") and told[-1][0].endswith(" a second")


@pytest.mark.long
def test_a_script_without_a_guard_is_not_run_again_by_its_processes_which_have_one_thread_each(
    tmp_path: Path,
) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "print('once')\n"
        "from scenarios.tasks.study import TaskRequest, run_study\nfrom "
        "tests.unit.scenarios.tasks.toy import Threads\n"
        "print(*run_study(Threads(), TaskRequest(12, 1, jobs=2)).columns['threads'])\n"
    )
    root = Path(__file__).parents[4]
    environment = {
        **{name: value for name, value in os.environ.items() if name not in THREADS},
        "PYTHONPATH": str(root),
    }
    found = subprocess.run(
        [sys.executable, script],
        cwd=root,
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert found.stdout.split() == ["once", *["1"] * 12] and found.stderr == ""


def test_rows_read_back_as_a_frame(tmp_path: Path, whole: RowTable) -> None:
    import pandas as pd

    run_study(Toy(), dataclasses.replace(ASKED, folder=tmp_path))
    frame = pd.concat(
        pd.read_parquet(io.BytesIO(path.read_bytes()))
        for path in sorted(tmp_path.glob("rows-*.parquet"))
    )
    assert list(frame.sort_values("number")["x"]) == list(whole.columns["x"])
