"""A computation made by a fork of this process while this one goes on: half of a screening, or the check of the kinematics beside a search."""

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

T = TypeVar("T")


@dataclass(eq=False)
class Alongside(Generic[T]):
    """``compute()`` by a fork from ``begin`` on; here where that was never called, cannot be done, or failed."""

    compute: Callable[[], T]
    _pipe: int | None = field(default=None, init=False)
    _child: int = field(default=0, init=False)

    def begin(self) -> None:
        """Start the fork, once; nothing is done where the system has none that is safe, and where no processor is left for it."""
        if self._child or not spare_processor():
            return
        receive, send = os.pipe()
        with warnings.catch_warnings():
            # The threads of this process draw its progress; the fork neither prints nor waits for them.
            warnings.simplefilter("ignore", DeprecationWarning)
            try:
                child = os.fork()
            except OSError:
                os.close(receive)
                os.close(send)
                return
        if child == 0:
            self._send(receive, send)
        os.close(send)
        self._pipe, self._child = receive, child

    def _send(self, receive: int, send: int) -> None:
        """In the fork: compute, hand over, end. Nothing of this process is left behind, neither its buffers nor its exit handlers."""
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
    """Whether a fork has a processor to itself: on Linux, whose libraries bear a fork beside threads, and not in a worker of many."""
    if not sys.platform.startswith("linux") or multiprocessing.parent_process() is not None:
        return False
    return len(os.sched_getaffinity(0)) > 1
