"""Many flights, one seed each, shared out among processes."""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from typing import TypeVar

Found = TypeVar("Found")


class Interrupted(KeyboardInterrupt):
    """Ctrl-C while flights were on their way: ``found`` by the seeds of those that had ended."""

    def __init__(self, found: dict[int, object]) -> None:
        super().__init__()
        self.found = found


def of_each_seed(
    fly: Callable[[int], Found], seeds: range, progress: Callable[[str, float], None] = lambda stage, share: None, workers: int = 1
) -> tuple[Found, ...]:
    """What ``fly`` finds for each seed, in their order: one after another, or shared out among ``workers`` processes, on which nothing depends.

    Raises
    ------
    Interrupted : by Ctrl-C, with what had been found; the processes are ended, not waited for.
    """
    count = len(seeds)

    def tell(done: int) -> None:
        progress(f"{done} of {count} flights", done / count)

    tell(0)
    if workers < 2:
        found: dict[int, Found] = {}
        try:
            for seed in seeds:
                found[seed] = fly(seed)
                tell(len(found))
        except KeyboardInterrupt:
            raise Interrupted({**found}) from None
        return tuple(found.values())
    with _pool(min(workers, count)) as pool:
        with _unheard():
            futures = {seed: pool.submit(fly, seed) for seed in seeds}
        try:
            for done, future in enumerate(as_completed(futures.values()), start=1):
                future.result()
                tell(done)
        except KeyboardInterrupt:
            raise Interrupted(_ended(futures)) from None
        return tuple(future.result() for future in futures.values())


@contextlib.contextmanager
def _pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Processes that are ended at once where the body fails or is stopped: a flight on its way may take a minute."""
    pool = ProcessPoolExecutor(workers, initializer=_deaf)
    try:
        yield pool
    except BaseException:
        for process in multiprocessing.active_children():
            process.kill()
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def _deaf() -> None:
    """In a worker: a terminal sends Ctrl-C to all processes, and the first alone answers it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """While workers are started: they inherit that Ctrl-C is held back, until they are deaf to it by themselves."""
    with warnings.catch_warnings():
        # The thread that shows progress neither prints nor is waited for in a worker.
        warnings.simplefilter("ignore", DeprecationWarning)
        if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "pthread_sigmask"):
            yield
            return
        former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, former)


def _ended(futures: dict[int, Future[Found]]) -> dict[int, object]:
    """What had been found, by seed."""
    done = {seed: future for seed, future in futures.items() if future.done() and not future.cancelled()}
    return {seed: future.result() for seed, future in done.items() if future.exception() is None}
