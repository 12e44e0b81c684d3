"""A record file as it was read: opened once, its table and sidecar kept for everyone who takes channels out of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from scenarios.files.channels import ColumnChoice
from scenarios.files.measured.cells import Table
from scenarios.files.measured.sidecar import Sidecar, read_sidecar
from scenarios.files.measured.tables import table_of
from scenarios.files.sources import MOST_RECORD, InputFile, read_source, resolved
from sim.errors import RecordError


@dataclass(frozen=True, eq=False, repr=False)
class RecordFile:
    """A record file's path, its cells as they stand, what the JSON beside it says, and its name with the hash of what was read.

    ``identity.name`` is what the file is called wherever it is spoken of: its bare name, with folders where another is called the same.
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
    source = read_source(path, RecordError, "the record file", MOST_RECORD)
    return RecordFile(source.path, table_of(source), read_sidecar(source.path), source.identity)


def read_record_files(records: Iterable[Path | RecordFile]) -> tuple[RecordFile, ...]:
    """Several record files, in their order, told apart where their names are the same; one that is open already is itself."""
    return told_apart([opened(record) for record in records])


def opened(record: Path | RecordFile) -> RecordFile:
    """A record file read; itself where it is open already."""
    return record if isinstance(record, RecordFile) else read_record_file(record)


def read_with_validation(
    records: Iterable[Path | RecordFile], validate: Iterable[Path | RecordFile]
) -> tuple[tuple[RecordFile, ...], tuple[RecordFile, ...]]:
    """Record files for a fit and those that are predicted, in their order, all of them told apart."""
    first = [opened(record) for record in records]
    both = told_apart([*first, *(opened(record) for record in validate)])
    return both[: len(first)], both[len(first) :]


def told_apart(files: Sequence[RecordFile]) -> tuple[RecordFile, ...]:
    """The files, those with equal names named with as many of their folders as it takes: ``flight1/record.csv``, ``flight2/record.csv``."""
    by_name: dict[str, list[Path]] = {}
    on_disk = [file for file in files if not file.in_memory]
    for file in on_disk:
        by_name.setdefault(file.path.name, []).append(resolved(file.path))
    deep = {name: _depth(same) for name, same in by_name.items()}

    def named(file: RecordFile) -> RecordFile:
        if file.in_memory:
            return file
        name = "/".join(resolved(file.path).parts[-deep[file.path.name] :])
        return replace(file, identity=replace(file.identity, name=name))

    return tuple(named(file) for file in files)


def _depth(paths: Sequence[Path]) -> int:
    """How many parts of paths with the same last one tell them apart."""
    most = max(len(path.parts) for path in paths)
    return next((depth for depth in range(1, most) if len({path.parts[-depth:] for path in paths}) == len(paths)), most)


def identities(files: Iterable[RecordFile]) -> tuple[InputFile, ...]:
    """Names and hashes of record files, in their order."""
    return tuple(file.identity for file in files)


def all_simulated(files: Iterable[RecordFile]) -> bool:
    """Whether a program made all of them, by what the JSON beside them says."""
    return all(file.sidecar.simulated for file in files)


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
        key = resolved(path) if path is not None else id(record)
        if key in seen:
            raise RecordError("the record is named twice", where=_name_of(record), remedy=remedy)
        seen.add(key)


def _name_of(record: Path | RecordFile) -> str:
    return str(record.path if isinstance(record, RecordFile) else record)
