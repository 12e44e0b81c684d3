"""Files opened once: their bytes, and the hash of just these bytes; what has no end or is too large
is refused before it is read.
"""

from __future__ import annotations

import hashlib
import os
import select
import stat
import time
from dataclasses import dataclass
from pathlib import Path

from sim.errors import FlightidError

MOST_RECORD = 1 << 30  # bytes of a record file, as it stands and unpacked: a few times that has room in memory
MOST_DECLARED = 1 << 22  # bytes of a TOML or Python file: the parser takes a second for each million
MOST_DOCUMENT = 1 << 27  # bytes of a JSON document of ours, which may hold figures
PATIENCE = 5.0  # s, in which a program must begin to write into a pipe
_PIECE = 1 << 20


@dataclass(frozen=True)
class InputFile:
    """A file that a result rests on: its bare name and the SHA-256 of the bytes that were read."""

    name: str
    sha256: str


@dataclass(frozen=True, eq=False)
class Source:
    """A file as it was read: what is later written under its name changes neither the content here
    nor the hash.
    """

    path: Path
    content: bytes
    identity: InputFile


def read_source(path: str | Path, error: type[FlightidError], wanted: str, most: int = MOST_DECLARED) -> Source:
    """Open a file, once.

    Parameters
    ----------
    path : the file; a pipe serves as long as something writes into it.
    error : the kind of error to raise.
    wanted : what to name instead where ``path`` is no file, ``"a TOML file"``.
    most : bytes that are read at most.

    Raises
    ------
    FlightidError : of the kind ``error``: there is no such file, it is a folder, a device or a
        pipe that nothing writes into,
        it is larger than ``most`` bytes, or it cannot be read.
    """
    path = Path(path)
    content = read_content(path, error, wanted, most)
    return Source(path, content, InputFile(path.name, hashlib.sha256(content).hexdigest()))


def read_content(path: Path, error: type[FlightidError], wanted: str, most: int) -> bytes:
    """The bytes of a file. Parameters and errors as ``read_source``."""
    where = str(path)
    try:
        return _content(path, error, wanted, most)
    except (FileNotFoundError, NotADirectoryError):
        raise error("there is no such file", where=where, remedy="check the path") from None
    except IsADirectoryError:
        raise error("this is a folder", where=where, remedy=f"name {wanted} in it") from None
    except OSError as fault:
        raise error(
            f"cannot be read ({fault.strerror or fault})",
            where=where,
            remedy="check the file and its permissions",
        ) from None


def resolved(path: str | Path) -> Path:
    """A path without links in it; a circle of links stays, for whoever opens it to name."""
    return Path(os.path.realpath(path))


def too_large(error: type[FlightidError], where: str, size: str, most: int, remedy: str = "") -> FlightidError:
    """The error for a file beyond a limit; ``size`` says how large it is, in words that go before
    "is more than".
    """
    limit = f"{most >> 20} MiB" if most >= 1 << 20 else f"{most} bytes"
    return error(
        f"{size} is more than the {limit} that are read at most",
        where=where,
        remedy=remedy or "name a smaller file",
    )


def _content(path: Path, error: type[FlightidError], wanted: str, most: int) -> bytes:
    # Without blocking: a pipe that nothing writes into would be waited for without end.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    try:
        found = os.fstat(handle)
        if stat.S_ISDIR(found.st_mode):
            raise IsADirectoryError
        is_pipe = stat.S_ISFIFO(found.st_mode)
        if not (stat.S_ISREG(found.st_mode) or is_pipe):
            raise error("this is a device, not a file", where=str(path), remedy=f"name {wanted}")
        if found.st_size > most:
            raise too_large(error, str(path), f"{found.st_size / (1 << 20):.4g} MiB", most)
        piece = _first_piece(handle) if is_pipe else _piece(handle)
        if is_pipe and not piece:
            raise error("nothing writes into this pipe", where=str(path), remedy=f"name {wanted}")
        pieces, size = [], 0
        while piece:
            pieces.append(piece)
            size += len(piece)
            if size > most:
                raise too_large(error, str(path), "what comes out of it", most)
            piece = _piece(handle)
    finally:
        os.close(handle)
    return b"".join(pieces)


def _piece(handle: int) -> bytes:
    """The next bytes, none at the end; of a pipe that is written into they are waited for."""
    while True:
        try:
            return os.read(handle, _PIECE)
        except BlockingIOError:
            select.select([handle], [], [])


def _first_piece(handle: int) -> bytes:
    """The first bytes of a pipe; none where no program has come to write into it before
    ``PATIENCE`` is over.
    """
    until = time.monotonic() + PATIENCE
    while not (piece := _piece(handle)) and time.monotonic() < until:
        time.sleep(0.02)
    return piece
