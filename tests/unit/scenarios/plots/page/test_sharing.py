"""Works shared out between a process and its fork: each done once, whoever fails."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from scenarios.plots.page.sharing import shared_out

COUNT = 400  # more than the values of a byte


def noted(file: Path, number: int, failing: Callable[[int], bool] = lambda number: False) -> None:
    if failing(number):
        raise ValueError("broken")
    with file.open("ab", buffering=0) as lines:
        lines.write(f"{number} {os.getpid()}\n".encode())


def done(file: Path) -> tuple[Counter[int], set[int]]:
    """How often each work was done, and the processes that worked."""
    told = [tuple(map(int, line.split())) for line in file.read_text().splitlines()]
    return Counter(number for number, _ in told), {process for _, process in told}


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """No other thread, which would forbid a fork."""
    monkeypatch.setattr("threading.active_count", lambda: 1)


@pytest.mark.usefixtures("alone")
def test_each_work_is_done_once_by_two_processes(tmp_path: Path) -> None:
    shared_out([partial(noted, tmp_path / "done", number) for number in range(COUNT)])
    counts, processes = done(tmp_path / "done")
    assert counts == Counter(range(COUNT)) and len(processes) <= 2 and os.getpid() in processes


def test_beside_other_threads_all_is_done_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("threading.active_count", lambda: 2)
    shared_out([partial(noted, tmp_path / "done", number) for number in range(9)])
    assert done(tmp_path / "done") == (Counter(range(9)), {os.getpid()})


@pytest.mark.usefixtures("alone")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="there are no forks")
def test_what_a_fork_fails_at_is_done_here(tmp_path: Path) -> None:
    here = os.getpid()
    shared_out([partial(noted, tmp_path / "done", number, lambda _: os.getpid() != here) for number in range(9)])
    assert done(tmp_path / "done") == (Counter(range(9)), {here})


@pytest.mark.usefixtures("alone")
def test_a_work_that_fails_here_ends_it(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="broken"):
        shared_out([partial(noted, tmp_path / "done", number, lambda number: number == 0) for number in range(2)])
