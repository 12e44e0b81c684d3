"""Run blocks of tasks on the workers of an existing Dask cluster."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import pickle
import queue
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from scenarios.files.sources import versions
from scenarios.tasks.processes import failed_by_circumstance
from scenarios.tasks.work import Ended, Task, Work
from sim.errors import FlightidError

if TYPE_CHECKING:
    from distributed import Client, Future

FLAG = "--cluster"
INSTALL = 'in the folder of the project: python -m pip install -e ".[cluster]"'
START = "start one with dask scheduler, and give the address that it prints"
CONNECTION_TIMEOUT = 6.0  # s, longest wait for a scheduler's answer
SILENCE_TIMEOUT = 20.0  # s without an answer after which a scheduler is lost
CHECK_INTERVAL = 2.0  # s between checks of the scheduler and its workers
POLL_INTERVAL = 0.01  # s between checks for finished blocks
# Blocks that are sent for each thread of the workers: enough that no thread waits, few enough to
# limit memory.
BLOCKS_PER_THREAD = 3
BLOCKS_WITHOUT_WORKERS = 4  # blocks that are sent while the cluster has no workers
CLOSING_TIMEOUT = 1.0  # s, longest wait when disconnecting


def run_on_cluster(
    work: Work,
    blocks: Sequence[Sequence[Task]],
    address: str,
    longest: float | None = None,
    report: Callable[[str], None] = lambda words: None,
) -> Generator[list[Ended], None, None]:
    """Run blocks as ``run_blocks`` does, on the workers of a Dask scheduler.

    The work is sent once to each worker. A block whose worker dies is run by another worker. After
    several deaths Dask stops, which is recorded as the error of the block.

    Parameters
    ----------
    work, blocks, longest : as for ``run_blocks``.
    address : address of the scheduler.
    report : called with a sentence if the cluster has no workers.

    Raises
    ------
    FlightidError : Dask is not installed; no scheduler answers or it is lost; or a worker has
        another version of flightid.
    """
    if not len(blocks):
        return
    with _connected(address) as client:
        yield from _results(client, _Sender(client, work, longest), blocks, address, report)


class _SentBlock(NamedTuple):
    """A block that was sent: its number and its future result."""

    number: int
    future: Future


class _Sender:
    """Sends blocks to the cluster.

    It sends plain values, and functions as code. So the scheduler does not need flightid, and a
    worker without flightid can report this.
    """

    def __init__(self, client: Client, work: Work, longest: float | None) -> None:
        self.client, self.longest = client, longest
        self.token = f"flightid-{uuid.uuid4().hex}"

        def loaded(content: bytes) -> bytes:
            return content

        def run(
            content: bytes,
            token: str,
            block: list[tuple[int, int]],
            longest: float | None,
            here: dict[str, str],
        ) -> Any:
            import socket

            try:
                from scenarios.tasks.cluster_worker import run_sent
            except ImportError as error:
                return (
                    f"the worker on {socket.gethostname()} has no flightid, or an older one "
                    f"({error})"
                )
            return run_sent(content, token, block, longest, here)

        # Sent as a task, not as scattered data, so that it survives the loss of workers.
        self._work = client.submit(loaded, pickle.dumps(work), key=f"{self.token}-work")
        self._run = run

    def __call__(self, index: int, block: Sequence[Task]) -> Future:
        """Send a block and return its future result."""
        plain_block = [(task.number, task.seed) for task in block]
        return self.client.submit(
            self._run,
            self._work,
            self.token,
            plain_block,
            self.longest,
            versions(),
            key=f"{self.token}-{index}",
            pure=False,
        )


def _results(
    client: Client,
    send: _Sender,
    blocks: Sequence[Sequence[Task]],
    address: str,
    report: Callable[[str], None],
) -> Generator[list[Ended], None, None]:
    """Send all blocks, a limited number at a time, and yield the results of each that has ended."""
    from distributed import as_completed

    completed: Any = as_completed([], loop=client.loop, with_results=True, raise_errors=False)
    running: dict[str, _SentBlock] = {}
    sent, most_running, last_check = 0, BLOCKS_WITHOUT_WORKERS, -CHECK_INTERVAL
    while sent < len(blocks) or running:
        if time.monotonic() - last_check > CHECK_INTERVAL:
            threads = _threads(client, address)
            most_running = max(BLOCKS_WITHOUT_WORKERS, BLOCKS_PER_THREAD * threads)
            last_check = time.monotonic()
            if not threads and not sent:
                report("the cluster has no workers yet")
            elif not threads:
                report("the cluster has no workers, waiting for some")
        while sent < len(blocks) and len(running) < most_running:
            future = send(sent, blocks[sent])
            running[str(future.key)] = _SentBlock(sent, future)
            completed.add(future)
            sent += 1
        batch = completed.next_batch(block=False)
        if not batch:
            time.sleep(POLL_INTERVAL)
        for future, result in batch:
            sent_block = running.pop(str(future.key))
            ended = _ended(blocks[sent_block.number], future, result, address)
            future.release()
            yield ended


def _ended(block: Sequence[Task], future: Future, result: Any, address: str) -> list[Ended]:
    """Return the ended tasks of a block. Failures of Dask are recorded as ``passing`` errors.

    A worker that cannot run the block returns the reason, alone or with a remedy.
    """
    if isinstance(result, tuple):
        what, remedy = result
        raise FlightidError(what, where=address, remedy=remedy)
    if isinstance(result, str):
        own_versions = ", ".join(f"{name} {number}" for name, number in versions().items())
        raise FlightidError(
            result, where=address, remedy=f"install on every worker what is here: {own_versions}"
        )
    if future.status == "finished":
        return list(result)
    if future.status != "error":
        raise _lost(address)
    error = future.exception(timeout=CONNECTION_TIMEOUT)
    if type(error).__name__ == "KilledWorker":
        return failed_by_circumstance(
            block,
            f"{error.allowed_failures + 1} workers died while they ran it, the last "
            f"{error.last_worker.address}",
        )
    return failed_by_circumstance(block, " ".join(f"{type(error).__name__}: {error}".split()))


def _threads(client: Client, address: str) -> int:
    """Return the number of threads of all workers; raise FlightidError without an answer."""
    scheduler = client.scheduler
    if client.status != "running" or scheduler is None:
        raise _lost(address)
    try:
        return sum(client.sync(scheduler.ncores, callback_timeout=SILENCE_TIMEOUT).values())
    except (OSError, TimeoutError):
        raise _lost(address) from None


def _lost(address: str) -> FlightidError:
    """Return the error for a scheduler that has stopped to answer."""
    return FlightidError("the scheduler no longer answers", where=address, remedy="start it again")


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    """Connect to the scheduler, without log output; at the end, cancel the tasks of the client."""
    try:
        import dask
        from distributed import Client
    except ImportError:
        raise FlightidError("Dask is not installed", where=FLAG, remedy=INSTALL) from None
    settings = {
        "distributed.comm.timeouts.connect": CONNECTION_TIMEOUT,
        "distributed.admin.large-graph-warning-threshold": "1GiB",
    }
    with _quiet(), dask.config.set(settings):
        try:
            kind, client = _kind(address), None
            if kind == "Scheduler":
                client = Client(
                    address, timeout=CONNECTION_TIMEOUT, set_as_default=False, name="flightid"
                )
        except MemoryError:
            # The first bytes of another protocol are read as the length of a message.
            raise FlightidError(
                "what answers there is no Dask scheduler", where=address, remedy=START
            ) from None
        except Exception as error:
            raise FlightidError(
                f"no Dask scheduler answers ({_short(error)})", where=address, remedy=START
            ) from None
        if client is None:
            raise FlightidError(
                f"this is a Dask {kind.lower()} and no scheduler", where=address, remedy=START
            )
        try:
            yield client
        finally:
            with contextlib.suppress(Exception):
                client.close(timeout=CLOSING_TIMEOUT)


def _kind(address: str) -> str:
    """Return the kind of the process at an address, as ``"Scheduler"`` or ``"Worker"``.

    A client would wait for ever for a process of another kind.
    """
    from distributed.core import rpc

    async def request_kind() -> str:
        async with rpc(address, timeout=CONNECTION_TIMEOUT) as process:
            return str((await process.identity())["type"])

    async def request_in_time() -> str:
        return await asyncio.wait_for(request_kind(), CONNECTION_TIMEOUT)

    answers: queue.SimpleQueue[str | Exception] = queue.SimpleQueue()

    def run() -> None:
        try:
            answers.put(asyncio.run(request_in_time()))
        except Exception as error:
            answers.put(error)

    # A thread, because a notebook has an event loop of its own; a daemon, so that Ctrl-C works.
    threading.Thread(target=run, daemon=True).start()
    answer = answers.get()
    if isinstance(answer, Exception):
        raise answer
    return answer


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Suppress log output and warnings of Dask."""
    names = [
        name
        for name in logging.root.manager.loggerDict
        if name.split(".")[0] in ("distributed", "tornado")
    ]
    loggers = [logger for logger in map(logging.getLogger, names) if not logger.disabled]
    for logger in loggers:
        logger.disabled = True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger in loggers:
            logger.disabled = False


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:120] or f"none in {CONNECTION_TIMEOUT:g} s"
