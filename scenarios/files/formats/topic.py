"""The interface between readers and everything else: topics, each a table whose columns share one
clock.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from scenarios.files.formats.cells import CellTable, header_cell
from sim.errors import RecordError

FIRST_LINES = 4096  # bytes


@dataclass(frozen=True, eq=False, repr=False)
class Topic:
    """Columns that were sampled by one clock.

    Attributes
    ----------
    name : name of the message, sheet or group in the file; empty where the file has one table only.
    table : the columns, the clock among them.
    notes : sentences on how the reader understood the file.
    """

    name: str
    table: CellTable
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Topic {self.name or '(only one)'}: {self.table!r}>"


class Reader(Protocol):
    """A module of this package: the suffixes and first bytes of its format, and its reading
    function.

    A mark of ``MAGIC`` that begins with a line break may stand at the begin of any of the first
    lines, below what a program wrote above.
    ``EXTRA`` names the optional dependency group of ``pyproject.toml`` that installs the library,
    empty where none is needed.
    """

    FORMAT: str
    SUFFIXES: tuple[str, ...]
    MAGIC: tuple[bytes, ...]
    EXTRA: str

    def read(self, path: Path, raw: bytes) -> tuple[Topic, ...]:
        """The topics of a file. Raises RecordError where it is damaged or holds no table."""


def table_of_columns(
    path: Path,
    columns: Mapping[str, Any],
    units: Mapping[str, str] | None = None,
    *,
    place: str = "",
    rows: int | None = None,
    unreadable: Mapping[str, str] | None = None,
) -> CellTable:
    """A table of named columns; shorter ones are refused when a channel asks for them.

    Parameters
    ----------
    path : the file, for messages. place : the topic in it.
    columns : name -> one-dimensional sequence.
    units : name -> unit, where the file states it apart from the header.
    rows : number of rows; None: as many as the longest column has.
    unreadable : further names, and why they hold no sequence of numbers; whoever asks for one of
    them is refused.
    """
    known = units or {}
    vectors = tuple(_vector(values) for values in columns.values())
    count = rows if rows is not None else max((vector.size for vector in vectors), default=0)
    under = tuple(known.get(name, "") for name in columns) if any(known.values()) else ()
    where = f"{path}, {place}" if place else str(path)
    others = dict(unreadable or {})
    header = tuple(header_cell(str(name), where) for name in (*columns, *others))
    faults = {len(vectors) + at: fault for at, fault in enumerate(others.values())}
    under = (*under, *("" for _ in others)) if under else ()
    vectors = (*vectors, *(np.full(count, np.nan) for _ in others))
    return CellTable(
        where,
        header,
        vectors,
        np.arange(1, count + 1),
        units=under,
        stated_apart=True,
        unreadable=faults,
    )


def missing_library(error: ImportError, path: Path, format_name: str, extra: str) -> RecordError:
    """The error for a format whose library is not installed."""
    library = (error.name or "its library").split(".")[0]
    wanted = f'"flightid[{extra}]"' if extra else library
    what = f"reading {format_name} needs {library}, which is not installed"
    return RecordError(
        what, where=str(path), remedy=f"python -m pip install {wanted}, or export the record as CSV"
    )


def damaged(fault: BaseException, path: Path, format_name: str) -> RecordError:
    """The error for a file that the format's library cannot read."""
    text = re.sub(r"'?<[^<>]* object at 0x[0-9a-f]+>'?", "the file", str(fault)).strip()
    said = " ".join(text.splitlines()[0].split())[:160] if text else type(fault).__name__
    return RecordError(
        f"not a readable {format_name} file ({said})",
        where=str(path),
        remedy="export it again, or save the record as CSV",
    )


def no_table(path: Path, seen: Sequence[str], remedy: str) -> RecordError:
    """The error for a file without a column; ``seen`` are the names of what is in it instead."""
    listed = ", ".join(seen[:12]) + (", ..." if len(seen) > 12 else "")
    return RecordError(
        f"no column of numbers is in the file{f'; it holds {listed}' if listed else ''}",
        where=str(path),
        remedy=remedy,
    )


def begins_with(raw: bytes, mark: bytes) -> bool:
    """Whether a file begins with a mark; of a mark that begins with a line break, whether one of
    its first lines does."""
    return mark in b"\n" + raw[:FIRST_LINES] if mark.startswith(b"\n") else raw.startswith(mark)


def as_module(module: ModuleType) -> Reader:
    """A module seen as a reader."""
    return module


def _vector(values: Any) -> np.ndarray:
    array = np.asarray(values)
    if array.dtype.kind in "fiu":
        return array.astype(float, copy=False).reshape(-1)
    if array.dtype.kind == "b":
        return array.astype(float).reshape(-1)
    if array.dtype.kind in "mM":
        return array.reshape(-1)
    return array.astype(object).reshape(-1)
