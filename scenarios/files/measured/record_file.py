"""A record file as it was read: opened once, its table and sidecar kept for everyone who takes channels out of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from scenarios.files.channels import ColumnChoice
from scenarios.files.measured.sidecar import Sidecar, read_sidecar
from scenarios.files.measured.tables import Table, table_of
from scenarios.files.sources import InputFile, read_source
from sim.errors import RecordError


@dataclass(frozen=True, eq=False, repr=False)
class RecordFile:
    """A record file's path, its cells as they stand, what the JSON beside it says, and its name with the hash of what was read.

    ``choices``: a channel map of its own. ``in_memory``: it never was a file, and ``path`` is its name alone.
    """

    path: Path
    table: Table
    sidecar: Sidecar
    identity: InputFile
    choices: Mapping[str, ColumnChoice] = field(default_factory=dict)
    in_memory: bool = False

    def __repr__(self) -> str:
        return f"<RecordFile {self.path}: {self.table!r}>"


def read_record_file(path: str | Path) -> RecordFile:
    """Open a record file of any of our formats and its sidecar, each once.

    Raises
    ------
    RecordError : the file is missing, unreadable, empty, not UTF-8, or has a header and no rows; the sidecar says what cannot be used.
    """
    source = read_source(path, RecordError, "the record file")
    return RecordFile(source.path, table_of(source), read_sidecar(source.path), source.identity)


def read_record_files(records: Iterable[Path | RecordFile]) -> tuple[RecordFile, ...]:
    """Several record files, in their order; one that is open already is itself."""
    return tuple(record if isinstance(record, RecordFile) else read_record_file(record) for record in records)


def identities(files: Iterable[RecordFile]) -> tuple[InputFile, ...]:
    """Names and hashes of record files, in their order."""
    return tuple(file.identity for file in files)


def path_of(record: Path | RecordFile) -> Path | None:
    """Where a record file is; None of one that never was a file."""
    if isinstance(record, RecordFile):
        return None if record.in_memory else record.path
    return record


def refuse_twice(records: Sequence[Path | RecordFile], remedy: str = "name each record once") -> None:
    """Raise RecordError where two paths lead to the same file, or a record in memory is given twice."""
    seen: set[Path | int] = set()
    for record in records:
        path = path_of(record)
        key = path.resolve() if path is not None else id(record)
        if key in seen:
            raise RecordError("the record is named twice", where=_name_of(record), remedy=remedy)
        seen.add(key)


def _name_of(record: Path | RecordFile) -> str:
    return str(record.path if isinstance(record, RecordFile) else record)
