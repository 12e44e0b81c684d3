"""A record file as it was read: opened once, its table and sidecar kept for everyone who takes channels out of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from scenarios.files.measured.cells import Table
from scenarios.files.measured.sidecar import Sidecar, read_sidecar
from scenarios.files.measured.tables import table_of
from scenarios.files.sources import InputFile, read_source
from sim.errors import RecordError


@dataclass(frozen=True, eq=False)
class RecordFile:
    """A record file's path, its cells as they stand, what the JSON beside it says, and its name with the hash of what was read.

    ``identity.name`` is what the file is called wherever it is spoken of: its bare name, with folders where another is called the same.
    """

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
    """Several record files, in their order, told apart where their names are the same."""
    return told_apart([read_record_file(path) for path in paths])


def read_with_validation(paths: Iterable[Path], validate: Iterable[Path]) -> tuple[tuple[RecordFile, ...], tuple[RecordFile, ...]]:
    """Record files for a fit and those that are predicted, in their order, all of them told apart."""
    first = [read_record_file(path) for path in paths]
    both = told_apart([*first, *(read_record_file(path) for path in validate)])
    return both[: len(first)], both[len(first) :]


def told_apart(files: Sequence[RecordFile]) -> tuple[RecordFile, ...]:
    """The files, those with equal names named with as many of their folders as it takes: ``flight1/record.csv``, ``flight2/record.csv``."""
    by_name: dict[str, list[Path]] = {}
    for file in files:
        by_name.setdefault(file.path.name, []).append(file.path.resolve())
    deep = {name: _depth(same) for name, same in by_name.items()}
    names = ["/".join(file.path.resolve().parts[-deep[file.path.name] :]) for file in files]
    return tuple(replace(file, identity=replace(file.identity, name=name)) for file, name in zip(files, names, strict=True))


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


def refuse_twice(paths: Sequence[Path], remedy: str = "name each record once") -> None:
    """Raise RecordError where two paths lead to the same file."""
    seen: set[Path] = set()
    for path in paths:
        if path.resolve() in seen:
            raise RecordError("the record is named twice", where=str(path), remedy=remedy)
        seen.add(path.resolve())
