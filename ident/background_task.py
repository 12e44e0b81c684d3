"""A background task: a computation made by a fork of this process while this one goes on."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from sim.errors import FlightidError

T = TypeVar("T")

START_METHOD = "FLIGHTID_START_METHOD"  # environment: "fork" (as if unset) or "spawn"


def can_fork() -> bool:
    """Whether flightid may fork this process, the one question that every use of ``os.fork`` asks.

    True on Linux. Windows has no ``os.fork``, and system libraries of macOS do not survive one.
    There, and where the environment variable ``FLIGHTID_START_METHOD`` is ``spawn``, worker
    processes are started afresh, and what a fork would compute in addition to this process is
    computed by this process. Results are the same bytes.

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


def fork() -> int:
    """``os.fork()``, which Python 3.12 and later warn of where the system sees other threads.
    Raises OSError.

    Those draw the progress or wait inside a library; a fork of ours neither prints nor waits for
    them.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


@dataclass(eq=False)
class BackgroundTask(Generic[T]):
    """``compute()`` by a fork from ``begin`` on; here where that was never called, cannot be done,
    or failed.
    """

    compute: Callable[[], T]
    _pipe: int | None = field(default=None, init=False)
    _child: int = field(default=0, init=False)

    def begin(self) -> None:
        """Start the fork, once; nothing is done where the system has none that is safe, and where
        no processor is left for it.
        """
        if self._child or not spare_processor():
            return
        receive, send = os.pipe()
        try:
            child = fork()
        except OSError:
            os.close(receive)
            os.close(send)
            return
        if child == 0:
            self._send(receive, send)
        os.close(send)
        self._pipe, self._child = receive, child

    def _send(self, receive: int, send: int) -> None:
        """In the fork: compute, hand over, end. Nothing of this process is left behind, neither its
        buffers nor its exit handlers.
        """
        failed = 1
        try:
            os.close(receive)
            with open(send, "wb") as stream:
                stream.write(pickle.dumps(self.compute()))
            failed = 0
        finally:
            os._exit(failed)

    def result(self) -> T:
        """The result; waits for the fork."""
        if self._pipe is None:
            return self.compute()
        pipe, self._pipe = self._pipe, None
        with open(pipe, "rb") as stream:
            content = stream.read()
        if self._ended() != 0:
            return self.compute()
        found: T = pickle.loads(content)
        return found

    def drop(self) -> None:
        """End a fork whose result nobody wants."""
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None
        if self._child:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._child, signal.SIGKILL)
            self._ended()

    def _ended(self) -> int:
        """Wait for the fork to end; its exit status, none of which is zero but success."""
        child, self._child = self._child, 0
        with contextlib.suppress(ChildProcessError):
            return os.waitpid(child, 0)[1]
        return 1


def spare_processor() -> bool:
    """Whether a fork is possible and has a processor to itself: not on one core, and not in a
    worker of many.
    """
    if not can_fork() or multiprocessing.parent_process() is not None:
        return False
    return len(os.sched_getaffinity(0)) > 1
