"""Run a block of tasks on a worker of a Dask cluster.

Each block runs in a separate process, as ``processes`` does on one machine.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.util
import pickle
import socket
import threading
import time
from collections.abc import Mapping, Sequence
from typing import overload

from scenarios.files.sources import versions
from scenarios.tasks.processes import run_in_processes
from scenarios.tasks.work import DECIDING, Ended, Task, Work

IDLE_TIMEOUT = 30.0  # s after which an idle process is ended

_lock = threading.Lock()
_sweeping = threading.Lock()  # held while a sweep is due
_idle: list[_Lane] = []
_works: dict[str, Work] = {}  # the one that was sent last, by its token


def run_sent(
    content: bytes,
    token: str,
    block: Sequence[tuple[int, int]],
    longest: float | None,
    asked: Mapping[str, str],
) -> list[Ended] | str | tuple[str, str]:
    """Return a block ``(number, seed)`` of the pickled work ``content``; or, in words, why this
    worker cannot run it, with the remedy if it is known.

    A block that ends its process, or takes longer than ``longest`` s, leaves the worker alive, and
    threads of one worker do not share an interpreter: in a worker with four, four processes work.
    """
    if differing := _differing(asked, versions()):
        return f"the worker on {socket.gethostname()} has {differing}"
    try:
        lane = _lane(content, token, longest)
    except Exception as error:
        return (
            f"the worker on {socket.gethostname()} cannot load what is to be done "
            f"({' '.join(f'{type(error).__name__}: {error}'.split())})"
        )
    if isinstance(lane, tuple):
        return lane
    ended = lane.run([Task(number, seed) for number, seed in block])
    with _lock:
        lane.since = time.monotonic()
        _idle.append(lane)
    _sweep_later()
    return ended


class _One(Sequence[Sequence[Task]]):
    """Blocks that are requested one after another and put in as they come."""

    block: Sequence[Task] = ()

    def __len__(self) -> int:
        return 2**62

    @overload
    def __getitem__(self, at: int) -> Sequence[Task]: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[Sequence[Task]]: ...
    def __getitem__(self, at: int | slice) -> Sequence[Task] | Sequence[Sequence[Task]]:
        assert isinstance(at, int)
        return self.block


class _Lane:
    """A process that waits for blocks of one work."""

    def __init__(self, work: Work, token: str, longest: float | None) -> None:
        self.token, self.since = token, time.monotonic()
        self._blocks = _One()
        self._ended = run_in_processes(work, self._blocks, 1, longest)

    def run(self, block: Sequence[Task]) -> list[Ended]:
        self._blocks.block = block
        return next(self._ended)

    def end(self) -> None:
        self._ended.close()


def _lane(content: bytes, token: str, longest: float | None) -> _Lane | tuple[str, str]:
    # Nannies start their workers as daemons, which may have no children; ours end with them.
    vars(multiprocessing.current_process())["_config"]["daemon"] = False
    with _lock:
        for lane in _idle:
            if lane.token == token:
                _idle.remove(lane)
                return lane
        work = _works.get(token)
        if work is None:
            work = pickle.loads(content)
            _works.clear()
            _works[token] = work
    unready: tuple[str, str] | None = getattr(work, "unready", lambda: None)()
    return unready or _Lane(work, token, longest)


def _sweep_later() -> None:
    if _sweeping.acquire(blocking=False):
        timer = threading.Timer(IDLE_TIMEOUT / 2.0, _sweep)
        timer.daemon = True
        timer.start()


def _sweep() -> None:
    _end_idle(IDLE_TIMEOUT)
    _sweeping.release()
    if _idle:
        _sweep_later()


def _end_idle(longest: float) -> None:
    """End processes that have been idle for ``longest`` s."""
    with _lock:
        old = [lane for lane in _idle if time.monotonic() - lane.since >= longest]
        for lane in old:
            _idle.remove(lane)
        if old and not _idle:
            _works.clear()
    for lane in old:
        lane.end()


def _differing(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """Return the first difference on which the last digits hang, in words; of Python, the second
    number of its version.
    """
    for name in (*DECIDING, "python"):
        one, other = here.get(name), there.get(name)
        if name == "python":
            one, other = (text and ".".join(text.split(".")[:2]) for text in (one, other))
        if one != other:
            return f"{name} {other or 'not installed'}, and here is {one or 'none'}"
    return ""


# When the worker ends: its process would else wait for them.
multiprocessing.util.Finalize(None, _end_idle, args=(0.0,), exitpriority=100)
