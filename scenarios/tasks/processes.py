"""Blocks of tasks shared out among processes of this machine."""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, TimeoutError, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.context import BaseContext, SpawnContext, SpawnProcess
from typing import TYPE_CHECKING, Any, NamedTuple

from pebble import ProcessExpired, ProcessPool
from threadpoolctl import threadpool_limits

from scenarios.tasks.work import Ended, Task, Work
from sim.errors import FlightidError

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess


# ---- One block of tasks in this process; failures are recorded


def run_block(work: Work, block: Sequence[Task]) -> list[Ended]:
    """Return one block in this process; what fails is recorded."""
    started = time.perf_counter()
    try:
        rows = list(work.run(block))
        if len(rows) != len(block):
            raise ValueError(f"{len(rows)} rows of {len(block)} tasks")
    except Exception as error:
        line = " ".join(f"{type(error).__name__}: {error}".split())
        rows = [line] * len(block)
    seconds = (time.perf_counter() - started) / len(block)
    return [
        Ended(task, None, row, seconds) if isinstance(row, str) else Ended(task, row, "", seconds)
        for task, row in zip(block, rows, strict=True)
    ]


def failed_by_circumstance(block: Sequence[Task], why: str, seconds: float = 0.0) -> list[Ended]:
    """Return a block that something other than its tasks ended."""
    return [Ended(task, None, why, seconds / len(block), passing=True) for task in block]


# ---- Blocks of tasks shared out among processes of this machine

if sys.platform != "win32":
    from multiprocessing.context import ForkServerContext, ForkServerProcess


START_METHOD = "FLIGHTID_START_METHOD"  # environment: "fork" (as if unset) or "spawn"
CHECK_INTERVAL = 0.5  # s between looks whether all processes live
MOST_DEATHS_PER_BLOCK = 2  # processes that may die over one block, before it is given up
THREADS = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
_PARENT_DIES = 1  # PR_SET_PDEATHSIG of Linux
# a pool starts the successor of a dead process from a thread of its own
_STARTING = threading.Lock()


def can_fork() -> bool:
    """Return whether worker processes may be forks of this one.

    True on Linux. Windows has no ``os.fork``, and system libraries of macOS do not survive one.
    There, and where the environment variable ``FLIGHTID_START_METHOD`` is ``spawn``, worker
    processes are started afresh. Results are the same bytes.

    Raises
    ------
    FlightidError : the variable has another value, or asks for forks on a system without them.
    """
    able = sys.platform.startswith("linux") and hasattr(os, "fork")
    wanted = os.environ.get(START_METHOD, "")
    if wanted not in ("", "fork", "spawn"):
        raise FlightidError(
            f"{wanted!r} is no start method",
            where=START_METHOD,
            remedy="set it to fork or spawn, or unset it",
        )
    if wanted == "fork" and not able:
        raise FlightidError(
            "this system cannot fork", where=START_METHOD, remedy="set it to spawn, or unset it"
        )
    return able and wanted != "spawn"


class _Spawned(SpawnProcess):
    """A newly started process that imports the work's module; used where fork is not available."""

    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Any:
        with _held_back():
            return _started(SpawnProcess._Popen, process_obj)


class _Spawning(SpawnContext):
    Process = _Spawned


if sys.platform != "win32":

    class _Forked(ForkServerProcess):
        """A process forked from the server."""

        @staticmethod
        def _Popen(process_obj: BaseProcess) -> Any:
            return _started(ForkServerProcess._Popen, process_obj)

    class _Forking(ForkServerContext):
        Process = _Forked


def _started(start: Callable[[BaseProcess], Any], process_obj: BaseProcess) -> Any:
    """Start a process that does not import the caller's own script again, which need not be guarded
    against that.
    """
    with _STARTING:
        main = sys.modules["__main__"]
        hidden = {
            name: getattr(main, name) for name in ("__spec__", "__file__") if hasattr(main, name)
        }
        try:
            main.__spec__ = None
            with contextlib.suppress(AttributeError):
                del main.__file__
            return start(process_obj)
        finally:
            for name, value in hidden.items():
                setattr(main, name, value)


def run_in_processes(
    work: Work, blocks: Sequence[Sequence[Task]], jobs: int, longest: float | None = None
) -> Generator[list[Ended], None, None]:
    """Run blocks as ``run_blocks`` does, by ``jobs`` processes, which are ended at once if the
    caller stops, fails or is interrupted.

    A process that dies takes no study with it: its block is given to another, once.
    """
    context = _context(type(work).__module__)
    pools: list[ProcessPool] = []
    idle: list[ProcessPool] = []
    waiting: dict[Future[list[Ended]], _GivenBlock] = {}

    def another() -> ProcessPool:
        # Pools of one process: processes of a pool share locks, and a dying one could block them.
        pools.append(
            ProcessPool(max_workers=1, initializer=_begin, initargs=(work,), context=context)
        )
        return pools[-1]

    def give(at: int, life: int) -> None:
        while idle:
            pool = idle.pop()
            with contextlib.suppress(RuntimeError):  # died while idle
                waiting[pool.schedule(_run, args=(list(blocks[at]),), timeout=longest)] = (
                    _GivenBlock(at, life, pool)
                )
                return
            _end(pools, pool)
        pool = another()
        try:
            waiting[pool.schedule(_run, args=(list(blocks[at]),), timeout=longest)] = _GivenBlock(
                at, life, pool
            )
        except BrokenProcessPool:
            raise FlightidError(
                "no process can be started",
                where="--jobs",
                remedy="ask for fewer, or close what takes memory",
            ) from None

    given = 0
    try:
        while given < len(blocks) or waiting:
            while given < len(blocks) and len(waiting) < jobs:
                give(given, 1)
                given += 1
            done = wait(waiting, timeout=CHECK_INTERVAL, return_when=FIRST_COMPLETED).done
            for future in done | {each for each, to in waiting.items() if not to.pool.active}:
                to = waiting.pop(future)
                try:
                    ended = _result(future)
                    idle.append(to.pool)
                except TimeoutError:
                    _end(pools, to.pool)
                    ended = failed_by_circumstance(
                        blocks[to.at],
                        f"ended after {longest:g} s, the time that it was given",
                        float(longest or 0.0),
                    )
                except BrokenProcessPool as error:
                    _end(pools, to.pool)
                    if to.life < MOST_DEATHS_PER_BLOCK:
                        give(to.at, to.life + 1)
                        continue
                    ended = failed_by_circumstance(
                        blocks[to.at], f"{to.life} processes died over it{error}"
                    )
                yield ended
    finally:
        _end(pools, *pools)


class _GivenBlock(NamedTuple):
    """A block, which of its lives it is, and who has it."""

    at: int
    life: int
    pool: ProcessPool


def _result(future: Future[list[Ended]]) -> list[Ended]:
    """Return the results of a block. Raises TimeoutError, and BrokenProcessPool if its process
    died.
    """
    try:
        if not wait([future], timeout=CHECK_INTERVAL).done:
            raise BrokenProcessPool("")
        return future.result()
    except ProcessExpired as error:
        raise BrokenProcessPool(f", the last with exit code {error.exitcode}") from None
    except BrokenProcessPool:
        raise BrokenProcessPool("") from None


def _end(pools: list[ProcessPool], *ending: ProcessPool) -> None:
    """End the processes of some pools at once, whatever they do."""
    for pool in ending:
        pool.stop()
    for pool in ending:
        pool.join()
        pools.remove(pool)


def _context(module: str) -> BaseContext:
    """Return the start method: fork from a server that has loaded ``module``, or spawn.

    The server and its processes ignore Ctrl-C, which a terminal sends to all processes; only the
    main process handles it.
    """
    if sys.platform == "win32" or not can_fork():
        return _Spawning()
    from multiprocessing import forkserver

    multiprocessing.get_context("forkserver").set_forkserver_preload(["numpy", module])
    with _held_back():
        forkserver.ensure_running()
    return _Forking()


@contextlib.contextmanager
def _held_back() -> Iterator[None]:
    """Context manager that delays Ctrl-C; processes started inside ignore it. Not on Windows."""
    if sys.platform == "win32":
        yield
        return
    former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


_given: Work | None = None  # in a worker: its current work


def _begin(work: Work) -> None:
    global _given
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # at once, also out of a long call of native code
    if sys.platform.startswith("linux"):  # elsewhere a worker ends after its block
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PARENT_DIES, signal.SIGKILL)
    threadpool_limits(1)  # of what is loaded; what is loaded later reads the environment
    os.environ.update(dict.fromkeys(THREADS, "1"))
    _given = work


def _run(block: Sequence[Task]) -> list[Ended]:
    assert _given is not None
    return run_block(_given, block)


# ---- Who runs blocks of tasks: this process, or several of this machine

LEAST_WORK_FOR_POOL = 2.0  # s of remaining work above which further processes are started


def available_cores() -> int:
    """Processors that this process may use, which a batch system may have made fewer than the
    machine has.
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_blocks(
    work: Work, blocks: Sequence[Sequence[Task]], jobs: int = 1, longest: float | None = None
) -> Iterator[list[Ended]]:
    """Each block's tasks as they end, in whatever order. Nothing in a row depends on ``jobs``.

    ``longest`` : s of wall time that a block may take; then it is ended, and its tasks have that as
    their error. What is ``quick`` begins here, and goes to processes if enough is left for them.
    """
    if jobs > 1:
        can_fork()  # refuses a start method that there is not, whether or not one is needed
    at = 0
    if longest is None:
        while at < len(blocks) and (
            jobs < 2 or len(blocks) - at < 2 or getattr(work, "quick", False)
        ):
            started = time.perf_counter()
            yield run_block(work, blocks[at])
            at += 1
            if jobs > 1 and (time.perf_counter() - started) * (
                len(blocks) - at
            ) > LEAST_WORK_FOR_POOL * jobs / (jobs - 1.0):
                break
    if at < len(blocks):
        yield from run_in_processes(work, blocks[at:], jobs, longest)
