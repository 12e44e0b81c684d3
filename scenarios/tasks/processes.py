"""Run blocks of tasks in this process or in several processes of this machine."""

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


# ---- One block of tasks in this process


def run_block(work: Work, block: Sequence[Task]) -> list[Ended]:
    """Run a block in this process; an exception is recorded as the error of its tasks."""
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
    """Return the tasks of a block that failed for a reason outside them."""
    return [Ended(task, None, why, seconds / len(block), passing=True) for task in block]


# ---- Blocks of tasks in several processes

if sys.platform != "win32":
    from multiprocessing.context import ForkServerContext, ForkServerProcess


START_METHOD = "FLIGHTID_START_METHOD"  # environment variable: "fork" (the default) or "spawn"
CHECK_INTERVAL = 0.5  # s between checks for processes that have died
MOST_DEATHS_PER_BLOCK = 2  # processes that may die during one block before it is recorded as failed
THREADS = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
_PARENT_DIES = 1  # PR_SET_PDEATHSIG of Linux
_STARTING = threading.Lock()  # pools replace dead processes from threads of their own


def can_fork() -> bool:
    """Return whether worker processes are forked; otherwise they are spawned.

    Processes are forked on Linux, unless the environment variable ``FLIGHTID_START_METHOD`` is
    ``spawn``. Windows has no ``os.fork``, and system libraries of macOS fail after one. Results do
    not depend on the start method.

    Raises
    ------
    FlightidError : the variable has another value, or asks for forks on a system without them.
    """
    system_forks = sys.platform.startswith("linux") and hasattr(os, "fork")
    method = os.environ.get(START_METHOD, "")
    if method not in ("", "fork", "spawn"):
        raise FlightidError(
            f"{method!r} is no start method",
            where=START_METHOD,
            remedy="set it to fork or spawn, or unset it",
        )
    if method == "fork" and not system_forks:
        raise FlightidError(
            "this system cannot fork", where=START_METHOD, remedy="set it to spawn, or unset it"
        )
    return system_forks and method != "spawn"


class _Spawned(SpawnProcess):
    """A new process that imports the work's module; used if processes are not forked."""

    @staticmethod
    def _Popen(process_obj: BaseProcess) -> Any:
        with _ctrl_c_blocked():
            return _start(SpawnProcess._Popen, process_obj)


class _Spawning(SpawnContext):
    Process = _Spawned


if sys.platform != "win32":

    class _Forked(ForkServerProcess):
        """A process forked from the server."""

        @staticmethod
        def _Popen(process_obj: BaseProcess) -> Any:
            return _start(ForkServerProcess._Popen, process_obj)

    class _Forking(ForkServerContext):
        Process = _Forked


def _start(start: Callable[[BaseProcess], Any], process_obj: BaseProcess) -> Any:
    """Start a process that does not import the caller's script, which may have no guard
    ``if __name__ == "__main__"``.
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
    """Run blocks as ``run_blocks`` does, in ``jobs`` processes.

    The processes end at once if the caller stops, fails or is interrupted. If a process dies, its
    block is run once more by another.
    """
    context = _context(type(work).__module__)
    pools: list[ProcessPool] = []
    idle: list[ProcessPool] = []
    running: dict[Future[list[Ended]], _RunningBlock] = {}

    def new_pool() -> ProcessPool:
        # Each pool has one process. Processes of a pool share locks, which a dying one could block.
        pools.append(
            ProcessPool(max_workers=1, initializer=_initialize, initargs=(work,), context=context)
        )
        return pools[-1]

    def schedule(index: int, attempt: int, pool: ProcessPool) -> None:
        future = pool.schedule(_run, args=(list(blocks[index]),), timeout=longest)
        running[future] = _RunningBlock(index, attempt, pool)

    def give(index: int, attempt: int) -> None:
        while idle:
            pool = idle.pop()
            with contextlib.suppress(RuntimeError):  # raised if the process died while idle
                schedule(index, attempt, pool)
                return
            _end(pools, pool)
        try:
            schedule(index, attempt, new_pool())
        except BrokenProcessPool:
            raise FlightidError(
                "no process can be started",
                where="--jobs",
                remedy="use fewer processes, or close programs that use much memory",
            ) from None

    given = 0
    try:
        while given < len(blocks) or running:
            while given < len(blocks) and len(running) < jobs:
                give(given, 1)
                given += 1
            done = wait(running, timeout=CHECK_INTERVAL, return_when=FIRST_COMPLETED).done
            dead = {future for future, block in running.items() if not block.pool.active}
            for future in done | dead:
                block = running.pop(future)
                try:
                    ended = _result(future)
                    idle.append(block.pool)
                except TimeoutError:
                    _end(pools, block.pool)
                    reason = f"ended after {longest:g} s, the time limit"
                    ended = failed_by_circumstance(
                        blocks[block.number], reason, float(longest or 0.0)
                    )
                except BrokenProcessPool as error:
                    _end(pools, block.pool)
                    if block.attempt < MOST_DEATHS_PER_BLOCK:
                        give(block.number, block.attempt + 1)
                        continue
                    reason = f"{block.attempt} processes died while they ran it{error}"
                    ended = failed_by_circumstance(blocks[block.number], reason)
                yield ended
    finally:
        _end(pools, *pools)


class _RunningBlock(NamedTuple):
    """A block that a process runs: its number, the number of the attempt, and the pool."""

    number: int
    attempt: int
    pool: ProcessPool


def _result(future: Future[list[Ended]]) -> list[Ended]:
    """Return the results of a block.

    Raises
    ------
    TimeoutError : the block took too long.
    BrokenProcessPool : its process died.
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
    """End the processes of the pools ``ending`` at once, and remove these from ``pools``."""
    for pool in ending:
        pool.stop()
    for pool in ending:
        pool.join()
        pools.remove(pool)


def _context(module: str) -> BaseContext:
    """Return the start method: fork from a server that has loaded ``module``, or spawn.

    A terminal sends Ctrl-C to all processes. Only the main process handles it; the server and its
    processes ignore it.
    """
    if sys.platform == "win32" or not can_fork():
        return _Spawning()
    from multiprocessing import forkserver

    multiprocessing.get_context("forkserver").set_forkserver_preload(["numpy", module])
    with _ctrl_c_blocked():
        forkserver.ensure_running()
    return _Forking()


@contextlib.contextmanager
def _ctrl_c_blocked() -> Iterator[None]:
    """Delay Ctrl-C; processes that are started inside ignore it. Without effect on Windows."""
    if sys.platform == "win32":
        yield
        return
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


_work: Work | None = None  # the work of a worker process


def _initialize(work: Work) -> None:
    """Prepare a worker process: signals, one thread of linear algebra, and its work."""
    global _work
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # also ends a long call of native code at once
    if sys.platform.startswith("linux"):  # on other systems a worker ends after its block
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PARENT_DIES, signal.SIGKILL)
    threadpool_limits(1)  # for loaded libraries; those loaded later read the environment
    os.environ.update(dict.fromkeys(THREADS, "1"))
    _work = work


def _run(block: Sequence[Task]) -> list[Ended]:
    assert _work is not None
    return run_block(_work, block)


# ---- Blocks of tasks in this process or in several

LEAST_WORK_FOR_POOL = 2.0  # s of remaining work above which further processes are started


def available_cores() -> int:
    """Return the number of processors that this process may use; a batch system may have limited
    it.
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_blocks(
    work: Work, blocks: Sequence[Sequence[Task]], jobs: int = 1, longest: float | None = None
) -> Iterator[list[Ended]]:
    """Run blocks and yield the results of each block when it ends, in any order.

    Rows do not depend on ``jobs``. Quick work begins in this process; further processes are started
    if enough work remains.

    Parameters
    ----------
    work : the work.
    blocks : blocks of tasks.
    jobs : number of processes.
    longest : time limit of a block, s of wall time; a block that exceeds it is ended, which is the
        error of its tasks.
    """
    if jobs > 1:
        can_fork()  # refuses an unknown start method even if no process is started
    done = 0
    if longest is None:
        quick = getattr(work, "quick", False)
        while done < len(blocks) and (jobs < 2 or len(blocks) - done < 2 or quick):
            started = time.perf_counter()
            yield run_block(work, blocks[done])
            done += 1
            remaining_time = (time.perf_counter() - started) * (len(blocks) - done)
            if jobs > 1 and remaining_time > LEAST_WORK_FOR_POOL * jobs / (jobs - 1.0):
                break
    if done < len(blocks):
        yield from run_in_processes(work, blocks[done:], jobs, longest)
