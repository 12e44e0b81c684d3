"""A computation beside this process: the same result, a failure that is no failure, and nothing
left behind.
"""

from __future__ import annotations

import builtins
import os
import sys
import time

import pytest

from ident.background_task import START_METHOD, BackgroundTask, spare_processor

forks = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="no fork that is safe beside threads"
)


@pytest.fixture(autouse=True)
def spare(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests may run in a worker, or on one processor, where no fork is made."""
    monkeypatch.setattr(
        "ident.background_task.spare_processor", lambda: sys.platform.startswith("linux")
    )


@forks
def test_a_result_comes_from_another_process() -> None:
    beside = BackgroundTask(os.getpid)
    beside.begin()
    beside.begin()
    assert beside.result() != os.getpid()
    assert beside.result() == os.getpid()  # taken once; what is asked again is computed here


def test_where_nothing_can_fork_it_is_computed_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    monkeypatch.setenv(START_METHOD, "spawn")
    beside = BackgroundTask(os.getpid)
    beside.begin()
    assert not spare_processor() and beside.result() == os.getpid()


def test_what_was_never_begun_is_computed_here() -> None:
    assert BackgroundTask(os.getpid).result() == os.getpid()


@forks
def test_a_fork_that_fails_is_replaced(capfd: pytest.CaptureFixture[str]) -> None:
    here = os.getpid()

    def only_here() -> int:
        if os.getpid() != here:
            raise MemoryError
        return 7

    beside = BackgroundTask(only_here)
    beside.begin()
    assert beside.result() == 7


@forks
def test_what_nobody_wants_is_ended() -> None:
    beside = BackgroundTask(lambda: time.sleep(60.0))
    begun = time.monotonic()
    beside.begin()
    child = beside._child
    beside.drop()
    assert time.monotonic() - begun < 30.0
    with pytest.raises(ChildProcessError):
        os.waitpid(child, os.WNOHANG)
    beside.drop()


@forks
def test_an_interrupted_wait_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    beside = BackgroundTask(lambda: time.sleep(60.0))
    beside.begin()
    child, opened = beside._child, builtins.open

    def interrupted(*of: object) -> object:
        opened(of[0], "rb").close()  # type: ignore[call-overload]
        raise KeyboardInterrupt

    monkeypatch.setattr("builtins.open", interrupted)
    with pytest.raises(KeyboardInterrupt):
        beside.result()
    monkeypatch.setattr("builtins.open", opened)
    beside.drop()
    with pytest.raises(ChildProcessError):
        os.waitpid(child, os.WNOHANG)


@forks
def test_more_than_a_pipe_holds_comes_through() -> None:
    beside = BackgroundTask(lambda: bytes(5_000_000))
    beside.begin()
    assert len(beside.result()) == 5_000_000
