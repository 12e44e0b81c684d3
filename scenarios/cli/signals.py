"""Signals that end the process from outside: handled as Ctrl-C is, so that nothing temporary stays
behind, with their own exit codes.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextmanager
def ending_signals() -> Iterator[list[int]]:
    """While the body runs, SIGTERM and SIGHUP raise KeyboardInterrupt; the list holds the numbers
    of those that came.

    A signal that the process was started to ignore, as ``nohup`` does, stays ignored. A fork ends
    at once, as it would without this.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came
        return
    first = os.getpid()

    def end(number: int, frame: FrameType | None) -> None:
        if os.getpid() != first:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        came.append(number)
        raise KeyboardInterrupt

    former = {number: signal.getsignal(number) for number in ENDING}
    taken = [number for number, handler in former.items() if handler is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, end)
    try:
        yield came
    finally:
        for number in taken:
            signal.signal(number, former[number])
