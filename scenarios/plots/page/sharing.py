"""Figures shared out between this process and a fork of it: each takes the next one that nobody has begun."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence

_BYTES = 2  # of a number in the pipe, which a system reads as a whole


def shared_out(works: Sequence[Callable[[], None]]) -> None:
    """Do every work once, of which each leaves its result in files; the longest first share the time best.

    Alone where there may be no fork, or where the system has no room for one. What a fork that failed had taken is done again here.
    A work that raises ends this after the fork is waited for: nobody writes from here on.
    """
    if len(works) < 2 or not _may_fork():
        for work in works:
            work()
        return
    waiting = _queue(len(works))
    own: set[int] = set()
    failed = 0
    try:
        helper = _fork()
        if helper == 0:
            _help(works, waiting)
        try:
            for number in _taken(waiting):
                own.add(number)
                works[number]()
        finally:
            if helper is not None:
                failed = os.waitpid(helper, 0)[1]
    finally:
        os.close(waiting)
    if failed:
        for number in sorted(set(range(len(works))) - own):
            works[number]()


def _queue(count: int) -> int:
    """The end to read of a pipe that holds the numbers below ``count``."""
    waiting, filling = os.pipe()
    os.write(filling, b"".join(number.to_bytes(_BYTES, "little") for number in range(count)))
    os.close(filling)
    return waiting


def _taken(waiting: int) -> Iterator[int]:
    """Numbers as this process takes them, until none is left."""
    while number := os.read(waiting, _BYTES):
        yield int.from_bytes(number, "little")


def _help(works: Sequence[Callable[[], None]], waiting: int) -> None:
    """What the fork does; it ends here, whatever happens."""
    failed = 1
    try:
        for number in _taken(waiting):
            works[number]()
        failed = 0
    finally:
        os._exit(failed)


def _fork() -> int | None:
    """The helper's id, 0 within it; None where the system has no room for another process."""
    try:
        return os.fork()
    except OSError:
        return None


def _may_fork() -> bool:
    """Whether a fork is safe: this thread is the only one, and no system library of the platform forbids it."""
    return hasattr(os, "fork") and sys.platform != "darwin" and threading.active_count() == 1
