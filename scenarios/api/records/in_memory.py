"""DataFrames, arrays and records in memory as the record files that everything else reads: same names, same units, same messages."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenarios.files.channel_names import TIME, split_header
from scenarios.files.channels import ColumnChoice
from scenarios.files.formats.cells import Table, header_cell
from scenarios.files.formats.parquet import frame_header
from scenarios.files.measured.record_file import RecordFile
from scenarios.files.measured.sidecar import Sidecar
from scenarios.files.records import window_of
from scenarios.files.sources import InputFile
from sim.errors import RecordError
from sim.record import Hold, Record

if TYPE_CHECKING:
    import pandas

NAME = "record"


def file_of_columns(
    columns: Mapping[str, Any],
    name: str | None = None,
    units: Mapping[str, str] | None = None,
    hold: Hold | None = None,
    choices: Mapping[str, ColumnChoice] | None = None,
    unreadable: Mapping[str, str] | None = None,
) -> RecordFile:
    """A record file of named sequences, rows counted from 1. A time of datetimes counts from its first sample, one of timedeltas from zero, s.

    ``unreadable``: further names, and why they hold no sequence of numbers; whoever asks for one of them is refused.

    Raises
    ------
    RecordError : no column, no row, or columns that are not one-dimensional.
    """
    label = name or NAME
    header = tuple(header_cell(str(column), label) for column in columns)
    if not header:
        raise RecordError("there is no column", where=label, remedy="give time and one column a channel")
    values = tuple(_column(label, cell, column) for cell, column in zip(header, columns.values(), strict=True))
    rows = max(column.size for column in values)
    if rows == 0:
        raise RecordError("there is a header but no rows", where=label, remedy="give one row a sample")
    others = {} if unreadable is None else dict(unreadable)
    faults = {len(header) + at: fault for at, fault in enumerate(others.values())}
    header = (*header, *(header_cell(name, label) for name in others))
    table = Table(label, header, (*values, *(np.full(rows, np.nan) for _ in others)), np.arange(1, rows + 1), unreadable=faults)
    sidecar = Sidecar(label, hold or Hold.PREVIOUS, dict(units or {}), hold is not None)
    return RecordFile(Path(label), table, sidecar, InputFile(label, _digest(table)), dict(choices or {}), in_memory=True)


def columns_of_frame(frame: pandas.DataFrame) -> dict[str, Any]:
    """Columns of a DataFrame by their texts, and its index where that has a name.

    The time comes from the index where no column is named so and the index is one of times, or is named time.

    Raises RecordError where two columns have one name.
    """
    import pandas

    names = [frame_header(name) for name in frame.columns]
    columns: dict[str, Any] = {}
    for position, name in enumerate(names):
        if name in columns:
            raise RecordError(f"{names.count(name)} columns are headed {name!r}", where=NAME, remedy="rename all but one of them")
        columns[name] = frame.iloc[:, position]
    index = frame.index
    named = index.name is not None and split_header(str(index.name))[0] == TIME
    if named or (isinstance(index, pandas.DatetimeIndex | pandas.TimedeltaIndex) and not _has_time(names)):
        return {str(index.name) if named else TIME: index, **columns}
    levels = {str(name): index.get_level_values(at) for at, name in enumerate(index.names) if name is not None}
    return {**{name: values for name, values in levels.items() if name not in columns}, **columns}


def columns_of_record(record: Record) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Columns and units of a record in SI."""
    columns = {TIME: record.time, **{channel.name: channel.with_gaps() for channel in record.channels}}
    return columns, {TIME: "s", **{channel.name: channel.unit for channel in record.channels}}


def rows_of_file(file: RecordFile, start: float | None, stop: float | None) -> RecordFile:
    """The rows of a record file between two times, s, under a name that tells them; row numbers stay those of the file.

    Raises RecordError where there is no such row.
    """
    time, rows = window_of(file, start, stop)
    span = f"{time[0] if start is None else start:g}-{time[-1] if stop is None else stop:g} s"
    label = f"{file.identity.name}[{span}]"
    old = file.table
    ragged = {position - rows.start: cells for position, cells in old.ragged.items() if rows.start <= position < rows.stop}
    table = replace(old, file=label, columns=tuple(column[rows] for column in old.columns), rows=old.rows[rows], ragged=ragged)
    return replace(file, path=Path(label), table=table, identity=InputFile(label, _digest(table)), in_memory=True)


def numbered_apart(files: Sequence[RecordFile]) -> list[RecordFile]:
    """Record files of which those in memory bear names of their own: ``record``, ``record 2`` ..."""
    taken: set[str] = {file.path.name for file in files if not file.in_memory}
    out = []
    for file in files:
        name = file.path.name
        if file.in_memory:
            name = next(each for n in itertools.count(1) if (each := name if n == 1 else f"{name} {n}") not in taken)
            taken.add(name)
        out.append(file if name == file.path.name else _renamed(file, name))
    return out


def _renamed(file: RecordFile, name: str) -> RecordFile:
    return replace(file, path=Path(name), table=replace(file.table, file=name), identity=replace(file.identity, name=name))


def _has_time(names: Sequence[str]) -> bool:
    return any(split_header(name)[0] == TIME or name.startswith(f"{TIME}_") for name in names)


def _column(label: str, name: str, values: Any) -> np.ndarray:
    """One column as a table of a file holds it: numbers, or cells as they stand."""
    array = _plain(values)
    if array.ndim != 1:
        raise RecordError(f"{array.ndim} dimensions", where=f"{label}, column {name!r}", remedy="give one value a sample")
    if array.dtype.kind == "M":
        return np.where(np.isnat(array), np.nan, (array - array[0]) / np.timedelta64(1, "ns") * 1e-9) if array.size else np.zeros(0)
    if array.dtype.kind == "m":
        return np.where(np.isnat(array), np.nan, array / np.timedelta64(1, "ns") * 1e-9)
    return array.astype(float) if array.dtype.kind in "fiu" else array.astype(object)


def _plain(values: Any) -> np.ndarray:
    """A NumPy array; of a pandas column with NaN where a number is missing, and without its time zone."""
    dtype = getattr(values, "dtype", None)
    if getattr(dtype, "tz", None) is not None:
        values = (values.dt if hasattr(values, "dt") else values).tz_convert(None)  # to UTC: a clock may be put forward
    if not isinstance(dtype, np.dtype | None) and hasattr(values, "to_numpy"):
        import pandas

        if pandas.api.types.is_numeric_dtype(dtype) and not pandas.api.types.is_bool_dtype(dtype):
            return values.to_numpy(dtype=float, na_value=np.nan)
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "fiu":
        return np.asarray(np.ma.filled(values.astype(float), np.nan))
    return np.asarray(values)


def _digest(table: Table) -> str:
    """SHA-256 of header and cells."""
    digest = hashlib.sha256("\x1f".join(table.header).encode())
    for column in table.columns:
        array = np.asarray(column)
        digest.update(array.tobytes() if array.dtype.kind == "f" else repr(array.tolist()).encode())
    return digest.hexdigest()
