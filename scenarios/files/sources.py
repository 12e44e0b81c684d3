"""Files opened once: their bytes, and the hash of just these bytes."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from sim.errors import FlightidError


@dataclass(frozen=True)
class InputFile:
    """A file that a result rests on: its bare name and the SHA-256 of the bytes that were read."""

    name: str
    sha256: str


@dataclass(frozen=True, eq=False)
class Source:
    """A file as it was read: what is later written under its name changes neither the content here nor the hash."""

    path: Path
    content: bytes
    identity: InputFile


def read_source(path: str | Path, error: type[FlightidError], wanted: str) -> Source:
    """Open a file, once. ``wanted`` says what to name where ``path`` is a folder, ``"a TOML file"``.

    Raises
    ------
    FlightidError : of the kind ``error``: there is no such file, it is a folder, or it cannot be read.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise error("there is no such file", where=str(path), remedy="check the path") from None
    except IsADirectoryError:
        raise error("this is a folder", where=str(path), remedy=f"name {wanted} in it") from None
    except OSError as fault:
        raise error(f"cannot be read ({fault.strerror or fault})", where=str(path), remedy="check the file and its permissions") from None
    return Source(path, content, InputFile(path.name, hashlib.sha256(content).hexdigest()))
