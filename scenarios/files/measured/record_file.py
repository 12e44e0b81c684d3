"""A record file as it was read: opened once, its table and sidecar kept for everyone who takes channels out of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from scenarios.files.measured.sidecar import Sidecar, read_sidecar
from scenarios.files.measured.tables import Table, table_of
from scenarios.files.sources import InputFile, read_source
from sim.errors import RecordError


@dataclass(frozen=True, eq=False)
class RecordFile:
    """A record file's path, its cells as they stand, what the JSON beside it says, and its name with the hash of what was read."""

    path: Path
    table: Table
    sidecar: Sidecar
    identity: InputFile


def read_record_file(path: str | Path) -> RecordFile:
    """Open a record file of any of our formats and its sidecar, each once.

    Raises
    ------
    RecordError : the file is missing, unreadable, empty, not UTF-8, or has a header and no rows; the sidecar says what cannot be used.
    """
    source = read_source(path, RecordError, "the record file")
    return RecordFile(source.path, table_of(source), read_sidecar(source.path), source.identity)


def read_record_files(paths: Iterable[Path]) -> tuple[RecordFile, ...]:
    """Several record files, in their order."""
    return tuple(read_record_file(path) for path in paths)


def identities(files: Iterable[RecordFile]) -> tuple[InputFile, ...]:
    """Names and hashes of record files, in their order."""
    return tuple(file.identity for file in files)


def all_simulated(files: Iterable[RecordFile]) -> bool:
    """Whether a program made all of them, by what the JSON beside them says."""
    return all(file.sidecar.simulated for file in files)


def refuse_twice(paths: Sequence[Path], remedy: str = "name each record once") -> None:
    """Raise RecordError where two paths lead to the same file."""
    seen: set[Path] = set()
    for path in paths:
        if path.resolve() in seen:
            raise RecordError("the record is named twice", where=str(path), remedy=remedy)
        seen.add(path.resolve())
