"""Figures shared out between this process and a fork of it: each takes the next one that nobody has begun."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from ident.alongside import can_fork, fork

_BYTES = 2  # of a number in the pipe, which a system reads as a whole
_MOST = 65536 // _BYTES  # numbers that a pipe holds


def shared_out(works: Sequence[Callable[[], None]]) -> None:
    """Do every work once, of which each leaves its result in files. With the longest first the two end at about the same time.

    Alone where there may be no fork, or where the system has no room for one. What a fork that failed had taken is done again here.
    A work that raises, and an interrupt, end this after the fork has ended its own: nobody writes from here on.
    """
    if not 2 <= len(works) <= _MOST or not _may_fork():
        for work in works:
            work()
        return
    waiting = _queue(len(works))
    own: set[int] = set()
    failed = 0
    try:
        helper = _helper(works, waiting)
        try:
            for number in _taken(waiting):
                own.add(number)
                works[number]()
        finally:
            failed = _ended(helper, waiting) if helper is not None else 0
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


def _helper(works: Sequence[Callable[[], None]], waiting: int) -> int | None:
    """The id of a fork that takes works too and then ends; None where the system has no room for another process."""
    with _undisturbed():  # an interrupt in between would let the fork go on as if it were this process
        try:
            helper = fork()
        except OSError:
            return None
        if helper == 0:
            failed = 1
            try:
                for number in _taken(waiting):
                    works[number]()
                failed = 0
            finally:
                os._exit(failed)
        return helper


def _ended(helper: int, waiting: int) -> int:
    """Leave the fork nothing to take, wait until it has ended, and tell whether it failed."""
    with _undisturbed():
        for _ in _taken(waiting):
            pass
        return os.waitpid(helper, 0)[1]


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Ctrl-C waits until the body is left."""
    former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def _may_fork() -> bool:
    """Whether a fork is safe: the system allows it, and this thread is the only one."""
    return can_fork() and threading.active_count() == 1
