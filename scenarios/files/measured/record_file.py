"""A record file as it was read: opened once, its table and sidecar kept for everyone who takes
channels out of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from scenarios.files.channels import ColumnChoice
from scenarios.files.formats.cells import CellTable
from scenarios.files.formats.registry import topics_of
from scenarios.files.formats.topic import Topic
from scenarios.files.measured.columns import Sidecar, read_sidecar
from scenarios.files.sources import MOST_RECORD, InputFile, read_source, resolved
from sim.errors import RecordError


@dataclass(frozen=True, eq=False, repr=False)
class RecordFile:
    """A record file's path, its cells as they stand, what the JSON beside it says, and its name
    with the hash of what was read.

    ``identity.name`` is what the file is called wherever it is spoken of: its bare name, with
    folders where another is called the same. ``choices``: a channel map of its own. ``in_memory``:
    it never was a file, and ``path`` is its name alone. ``topics``: those of a log with several
    clocks, of which ``table`` then has the headers alone, as ``topic.field``. ``notes``: how the
    file was understood.
    """

    path: Path
    table: CellTable
    sidecar: Sidecar
    identity: InputFile
    choices: Mapping[str, ColumnChoice] = field(default_factory=dict)
    in_memory: bool = False
    topics: tuple[Topic, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<RecordFile {self.path}: {self.table!r}>"


def read_record_file(path: str | Path) -> RecordFile:
    """Open a record file of any of our formats and its sidecar, each once.

    Raises
    ------
    RecordError : the file is missing, unreadable, empty, not UTF-8, or has a header and no rows;
    the sidecar says what cannot be used.
    """
    source = read_source(path, RecordError, "the record file", MOST_RECORD)
    topics = topics_of(source)
    sidecar = read_sidecar(source.path)
    if len(topics) == 1:
        return RecordFile(
            source.path, topics[0].table, sidecar, source.identity, notes=topics[0].notes
        )
    notes = tuple(f"{topic.name}: {note}" for topic in topics for note in topic.notes)
    return RecordFile(
        source.path,
        _headers_of(source.path, topics),
        sidecar,
        source.identity,
        topics=topics,
        notes=notes,
    )


def with_names(file: RecordFile, names: Sequence[str]) -> RecordFile:
    """The file with its columns named anew, in their order.

    Raises
    ------
    RecordError : not one name for each column, or a log of several topics.
    """
    if not names:
        return file
    if file.topics:
        raise RecordError(
            "a log of several topics has names of its own",
            where="--columns",
            remedy="leave it out, and use a channel map",
        )
    if len(names) != len(file.table.header):
        what = f"{len(names)} names for {len(file.table.header)} columns of {file.path.name}"
        raise RecordError(
            what, where="--columns", remedy="give one name a column, separated by commas"
        )
    return replace(file, table=replace(file.table, header=tuple(name.strip() for name in names)))


def _headers_of(path: Path, topics: Sequence[Topic]) -> CellTable:
    """A table without rows that has all columns of a log, for messages."""
    header = tuple(f"{topic.name}.{cell}" for topic in topics for cell in topic.table.header)
    return CellTable(str(path), header, tuple(np.zeros(0) for _ in header), np.zeros(0, dtype=int))


def read_record_files(records: Iterable[Path | RecordFile]) -> tuple[RecordFile, ...]:
    """Several record files, in their order, told apart where their names are the same; one that is
    open already is itself.
    """
    return with_distinct_names([opened(record) for record in records])


def opened(record: Path | RecordFile) -> RecordFile:
    """A record file read; itself where it is open already."""
    return record if isinstance(record, RecordFile) else read_record_file(record)


def read_with_validation(
    records: Iterable[Path | RecordFile], validate: Iterable[Path | RecordFile]
) -> tuple[tuple[RecordFile, ...], tuple[RecordFile, ...]]:
    """Record files for a fit and those that are predicted, in their order, all of them told
    apart.
    """
    first = [opened(record) for record in records]
    both = with_distinct_names([*first, *(opened(record) for record in validate)])
    return both[: len(first)], both[len(first) :]


def with_distinct_names(files: Sequence[RecordFile]) -> tuple[RecordFile, ...]:
    """The files, those with equal names named with as many of their folders as it takes:
    ``flight1/record.csv``, ``flight2/record.csv``.
    """
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
    return next(
        (
            depth
            for depth in range(1, most)
            if len({path.parts[-depth:] for path in paths}) == len(paths)
        ),
        most,
    )


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


def refuse_twice(
    records: Sequence[Path | RecordFile], remedy: str = "name each record once"
) -> None:
    """Raise RecordError where two paths lead to the same file, or a record in memory is given
    twice.
    """
    seen: set[Path | int] = set()
    for record in records:
        path = path_of(record)
        key = resolved(path) if path is not None else id(record)
        if key in seen:
            raise RecordError("the record is named twice", where=_name_of(record), remedy=remedy)
        seen.add(key)


def _name_of(record: Path | RecordFile) -> str:
    return str(record.path if isinstance(record, RecordFile) else record)
