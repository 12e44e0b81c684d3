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

_lock = threading.Lock()  # protects ``_idle`` and ``_works``
_sweeping = threading.Lock()  # held while a timer for ``_sweep`` runs
_idle: list[_BlockProcess] = []
_works: dict[str, Work] = {}  # token -> work; only the last one


def run_sent(
    content: bytes,
    token: str,
    block: Sequence[tuple[int, int]],
    longest: float | None,
    client_versions: Mapping[str, str],
) -> list[Ended] | str | tuple[str, str]:
    """Run a block in a process of this worker.

    The worker survives a block that ends its process or exceeds its time. Each thread of a worker
    has a process of its own.

    Parameters
    ----------
    content : the pickled work.
    token : identifier of the work.
    block : number and seed of each task.
    longest : time limit of the block, s.
    client_versions : versions of packages at the client.

    Returns
    -------
    The ended tasks. If this worker cannot run the block: the reason, alone or with a remedy.
    """
    if difference := _version_difference(client_versions, versions()):
        return f"the worker on {socket.gethostname()} has {difference}"
    try:
        process = _block_process(content, token, longest)
    except Exception as error:
        return (
            f"the worker on {socket.gethostname()} cannot load what is to be done "
            f"({' '.join(f'{type(error).__name__}: {error}'.split())})"
        )
    if isinstance(process, tuple):
        return process
    ended = process.run([Task(number, seed) for number, seed in block])
    with _lock:
        process.idle_since = time.monotonic()
        _idle.append(process)
    _sweep_later()
    return ended


class _NextBlock(Sequence[Sequence[Task]]):
    """An endless sequence of blocks; ``block`` is set before each is requested."""

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


class _BlockProcess:
    """A process that runs blocks of one work, one after the other."""

    def __init__(self, work: Work, token: str, longest: float | None) -> None:
        self.token, self.idle_since = token, time.monotonic()
        self._blocks = _NextBlock()
        self._results = run_in_processes(work, self._blocks, 1, longest)

    def run(self, block: Sequence[Task]) -> list[Ended]:
        self._blocks.block = block
        return next(self._results)

    def end(self) -> None:
        self._results.close()


def _block_process(
    content: bytes, token: str, longest: float | None
) -> _BlockProcess | tuple[str, str]:
    """Return an idle or new process for a work; a reason and remedy if the work is not ready."""
    # Dask starts workers as daemons, which must not have children. These children end with them.
    vars(multiprocessing.current_process())["_config"]["daemon"] = False
    with _lock:
        for process in _idle:
            if process.token == token:
                _idle.remove(process)
                return process
        work = _works.get(token)
        if work is None:
            work = pickle.loads(content)
            _works.clear()
            _works[token] = work
    unready: tuple[str, str] | None = getattr(work, "unready", lambda: None)()
    return unready or _BlockProcess(work, token, longest)


def _sweep_later() -> None:
    """Start a timer that ends idle processes, unless one is running."""
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
        old = [process for process in _idle if time.monotonic() - process.idle_since >= longest]
        for process in old:
            _idle.remove(process)
        if old and not _idle:
            _works.clear()
    for process in old:
        process.end()


def _version_difference(client: Mapping[str, str], worker: Mapping[str, str]) -> str:
    """Return the first difference of versions that may change last digits; empty without one.

    Of Python, major and minor version are compared.
    """
    for name in (*DECIDING, "python"):
        client_version, worker_version = client.get(name), worker.get(name)
        if name == "python":
            client_version, worker_version = (
                version and ".".join(version.split(".")[:2])
                for version in (client_version, worker_version)
            )
        if client_version != worker_version:
            return (
                f"{name} {worker_version or 'not installed'}, and here is "
                f"{client_version or 'none'}"
            )
    return ""


# Without this, the worker would wait for its idle processes when it ends.
multiprocessing.util.Finalize(None, _end_idle, args=(0.0,), exitpriority=100)
