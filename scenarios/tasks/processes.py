"""Blocks of tasks shared out among processes of this machine, each with one thread of linear algebra."""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, TimeoutError, wait
from multiprocessing import forkserver
from multiprocessing.context import ForkServerContext, ForkServerProcess
from typing import TYPE_CHECKING, Any

from pebble import ProcessExpired, ProcessPool
from threadpoolctl import threadpool_limits

from scenarios.tasks.running import failed_by_circumstance, run_block
from scenarios.tasks.work import Ended, Task, Work

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

AHEAD = 2  # blocks that wait for each process, so that none is idle while this one writes
LIVES = 2  # processes that may die over one block, before it is given up
_PARENT_DIES = 1  # PR_SET_PDEATHSIG of Linux


class _Process(ForkServerProcess):
    """A process that does not import the caller's own script again, which need not be guarded against that."""

    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Any:
        main = sys.modules["__main__"]
        hidden = {name: getattr(main, name) for name in ("__spec__", "__file__") if hasattr(main, name)}
        try:
            main.__spec__ = None
            with contextlib.suppress(AttributeError):
                del main.__file__
            return ForkServerProcess._Popen(process_obj)
        finally:
            for name, value in hidden.items():
                setattr(main, name, value)


class _Context(ForkServerContext):
    Process = _Process


def run_in_processes(work: Work, blocks: Sequence[Sequence[Task]], jobs: int, longest: float | None = None) -> Iterator[list[Ended]]:
    """As ``run_blocks``, by ``jobs`` processes, which are ended at once where the caller stops, fails or is interrupted.

    A process that dies takes no study with it: its block is given to another, once.
    """
    _start_server(type(work).__module__)
    pool = ProcessPool(max_workers=min(jobs, len(blocks)), initializer=_begin, initargs=(work,), context=_Context())
    waiting: dict[Future[list[Ended]], tuple[int, int]] = {}  # the block, and which of its lives it is

    def give(at: int, life: int) -> None:
        waiting[pool.schedule(_run, args=(list(blocks[at]),), timeout=longest)] = at, life

    given = 0
    try:
        while given < len(blocks) or waiting:
            while given < len(blocks) and len(waiting) < AHEAD * jobs:
                give(given, 1)
                given += 1
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                at, life = waiting.pop(future)
                try:
                    ended = future.result()
                except TimeoutError:
                    ended = failed_by_circumstance(blocks[at], f"ended after {longest:g} s, the time that it was given", float(longest or 0.0))
                except ProcessExpired as error:
                    if life < LIVES:
                        give(at, life + 1)
                        continue
                    ended = failed_by_circumstance(blocks[at], f"{life} processes died over it, the last with exit code {error.exitcode}")
                yield ended
    finally:
        pool.stop()
        pool.join()


def _start_server(module: str) -> None:
    """The process that others are forked from: it has loaded what the work needs, runs no threads, and is deaf to Ctrl-C as they are.

    A terminal sends Ctrl-C to all processes, and the first alone answers it.
    """
    multiprocessing.get_context("forkserver").set_forkserver_preload(["numpy", module])
    with _held_back():
        forkserver.ensure_running()


@contextlib.contextmanager
def _held_back() -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


_given: Work | None = None  # in a worker: what it works at


def _begin(work: Work) -> None:
    global _given
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # at once, also out of a long call of native code
    with contextlib.suppress(OSError, AttributeError):  # elsewhere than on Linux, a worker ends after its block
        ctypes.CDLL(None).prctl(_PARENT_DIES, signal.SIGKILL)
    threadpool_limits(1)
    _given = work


def _run(block: Sequence[Task]) -> list[Ended]:
    assert _given is not None
    return run_block(_given, block)
