"""A computation made by a fork of this process while this one goes on: the search and the check of the kinematics need nothing of each other."""

from __future__ import annotations

import contextlib
import os
import pickle
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(eq=False)
class Alongside(Generic[T]):
    """``compute()``, once: by a fork from ``begin`` on, or here where that was never called, cannot be done, or failed."""

    compute: Callable[[], T]
    _pipe: int | None = field(default=None, init=False)
    _child: int = field(default=0, init=False)

    def begin(self) -> None:
        """Start the fork, once; where the system has none, or no second processor, nothing is done."""
        if self._pipe is not None or not hasattr(os, "fork") or (os.cpu_count() or 1) < 2:
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
        with open(self._pipe, "rb") as stream:
            content = stream.read()
        self._pipe = None
        if self._ended() != 0:
            return self.compute()
        found: T = pickle.loads(content)
        return found

    def drop(self) -> None:
        """End a fork whose result nobody wants."""
        if self._pipe is not None:
            os.close(self._pipe)
            self._pipe = None
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._child, 9)
            self._ended()

    def _ended(self) -> int:
        with contextlib.suppress(ChildProcessError):
            return os.waitpid(self._child, 0)[1]
        return 1
