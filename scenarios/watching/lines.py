"""Complete lines as they arrive, from a file that grows or from standard input."""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from sim.errors import RecordError

TICK = 0.1  # s between two looks at a source that has nothing new
LARGEST_PIECE = 1 << 16
AHEAD = 16  # pieces of standard input that wait to be taken
LONGEST_LINE = 1 << 20
_NOT_LINES = (".gz", ".parquet", ".pq", ".mat")

Read = Callable[[], bytes | None]


class Lines(NamedTuple):
    """What came: whole lines without their ends, and at the end of the stream the beginning of a line that never ended."""

    whole: list[bytes]
    unfinished: bytes = b""


def lines_of(read: Read, idle: float | None, name: str) -> Iterator[Lines]:
    """Lines as a source gives them, an empty list whenever it has nothing new.

    Parameters
    ----------
    read : new bytes, none if there are none after waiting a tick, None when the source has ended.
    idle : s without a byte after which the stream counts as ended; None waits for the source's end.
    name : for messages.

    Raises
    ------
    RecordError : a line without end.
    """
    rest, heard = b"", time.monotonic()
    while (piece := read()) is not None:
        if piece:
            heard = time.monotonic()
            *whole, rest = (rest + piece).split(b"\n")
            if len(rest) > LONGEST_LINE:
                raise RecordError("a line without end", where=name, remedy="stream comma-separated text, one row a line")
            yield Lines([line.removesuffix(b"\r") for line in whole])
        elif idle is not None and time.monotonic() - heard >= idle:
            break
        else:
            yield Lines([])
    yield Lines([], rest)


@contextmanager
def growing_file(path: Path, until_end: bool) -> Iterator[Read]:
    """A source that reads a file from its beginning and goes on as it grows; with ``until_end`` it ends where the file does.

    A file that is cut short while it is read ends too.

    Raises
    ------
    RecordError : no such file, a folder, no text, or it cannot be read.
    """
    if not path.exists():
        raise RecordError("there is no such file", where=str(path), remedy="check the path")
    if path.is_dir():
        raise RecordError("this is a folder", where=str(path), remedy="name the record file in it")
    if path.suffix.lower() in _NOT_LINES:
        raise RecordError("only comma-separated text arrives line by line", where=str(path), remedy="give a CSV file, or use flightid identify")
    try:
        file = path.open("rb", buffering=0)
    except OSError as error:
        raise RecordError(f"cannot be read ({error.strerror})", where=str(path), remedy="check the file and its permissions") from None
    with file:

        def read() -> bytes | None:
            piece = file.read(LARGEST_PIECE)
            if piece:
                return piece
            if until_end or (path.is_file() and os.fstat(file.fileno()).st_size < file.tell()):
                return None
            time.sleep(TICK)
            return b""

        yield read


def standard_input(descriptor: int = 0) -> Read:
    """A source that reads what is piped in; it ends where the pipe does.

    A thread waits for the pipe, since Windows waits for sockets alone. It reads a few pieces ahead, no more.
    """
    pieces: queue.Queue[bytes | OSError] = queue.Queue(AHEAD)
    ended = False

    def wait() -> None:
        piece: bytes | OSError = b" "
        while piece and not isinstance(piece, OSError):
            try:
                piece = os.read(descriptor, LARGEST_PIECE)
            except OSError as error:
                piece = error
            pieces.put(piece)

    threading.Thread(target=wait, daemon=True, name="standard input").start()

    def read() -> bytes | None:
        nonlocal ended
        if ended:
            return None
        try:
            piece = pieces.get(timeout=TICK)
        except queue.Empty:
            return b""
        if isinstance(piece, OSError):
            raise RecordError(f"cannot be read ({piece.strerror})", where="standard input", remedy="check what is piped in")
        ended = not piece
        return piece or None

    return read
