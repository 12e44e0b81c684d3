"""Works shared out between a process and its fork: each done once, whoever fails."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from ident.background_task import START_METHOD
from scenarios.plots.drawing import shared_out
from tests.forks import remembered_forks

COUNT = 400  # more than the values of a byte
HERE = os.getpid()

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")


def noted(file: Path, number: int, failing: Callable[[], bool] = lambda: False) -> None:
    """Note that the work was done, and by whom; the first that this process does waits until the
    other has begun one.
    """
    begun = file.with_suffix(".begun")
    if os.getpid() != HERE:
        begun.touch()
    until = time.monotonic() + 20.0
    while os.getpid() == HERE and not begun.exists() and time.monotonic() < until:
        time.sleep(0.001)
    if failing():
        raise ValueError("broken")
    with file.open("ab", buffering=0) as lines:
        lines.write(f"{number} {os.getpid()}\n".encode())


def done(file: Path) -> tuple[Counter[int], set[int]]:
    """How often each work was done, and the processes that worked."""
    told = [tuple(map(int, line.split())) for line in file.read_text().splitlines()]
    return Counter(number for number, _ in told), {process for _, process in told}


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing that would forbid a fork: no other thread, and no other way of starting processes."""
    monkeypatch.delenv(START_METHOD, raising=False)
    monkeypatch.setattr("threading.active_count", lambda: 1)


@pytest.mark.usefixtures("alone")
def test_each_work_is_done_once_by_two_processes(tmp_path: Path) -> None:
    shared_out([partial(noted, tmp_path / "done", number) for number in range(COUNT)])
    counts, processes = done(tmp_path / "done")
    assert counts == Counter(range(COUNT)) and len(processes) == 2 and HERE in processes


def test_beside_other_threads_all_is_done_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("threading.active_count", lambda: 2)
    (tmp_path / "done.begun").touch()
    shared_out([partial(noted, tmp_path / "done", number) for number in range(9)])
    assert done(tmp_path / "done") == (Counter(range(9)), {HERE})


@pytest.mark.usefixtures("alone")
def test_where_nothing_can_fork_all_is_done_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(START_METHOD, "spawn")
    (tmp_path / "done.begun").touch()
    shared_out([partial(noted, tmp_path / "done", number) for number in range(9)])
    assert done(tmp_path / "done") == (Counter(range(9)), {HERE})


@pytest.mark.usefixtures("alone")
def test_what_a_fork_fails_at_is_done_here(tmp_path: Path) -> None:
    shared_out(
        [
            partial(noted, tmp_path / "done", number, lambda: os.getpid() != HERE)
            for number in range(9)
        ]
    )
    assert (
        done(tmp_path / "done") == (Counter(range(9)), {HERE})
        and (tmp_path / "done.begun").exists()
    )


@pytest.mark.usefixtures("alone")
def test_a_work_that_fails_here_leaves_the_fork_nothing_to_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    helpers = remembered_forks(monkeypatch)
    with pytest.raises(ValueError, match="broken"):
        shared_out(
            [
                partial(noted, tmp_path / "done", number, lambda: os.getpid() == HERE)
                for number in range(COUNT)
            ]
        )
    with pytest.raises(ChildProcessError):
        os.waitpid(helpers[0], os.WNOHANG)  # it was waited for
    assert not (tmp_path / "done").exists() or len(done(tmp_path / "done")[0]) < COUNT
