"""A record from a user's CSV, Parquet or MAT file, in SI units, every fault told by file, row and column."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from scenarios.files.channel_names import CHANNEL_UNITS, TIME
from scenarios.files.channels import ColumnChoice
from scenarios.files.measured.cells import Numbers, Table, mark_fault, numbers
from scenarios.files.measured.columns import Column, column_place, find_column, missing_column, named_otherwise
from scenarios.files.measured.record_file import RecordFile, read_record_file
from scenarios.files.units import to_si
from sim.errors import RecordError
from sim.record import Channel, Hold, Record


def read_record(
    source: str | Path | RecordFile,
    model_inputs: Sequence[str] = (),
    model_outputs: Sequence[str] = (),
    channel_map: Mapping[str, ColumnChoice] | None = None,
    start: float | None = None,
    stop: float | None = None,
    optional: Sequence[str] = (),
    hold: Hold | None = None,
    instead: Mapping[str, str] | None = None,
    known: Mapping[str, str] = CHANNEL_UNITS,
) -> Record:
    """The channels of a model from a file of any of our formats.

    Parameters
    ----------
    source : ``.csv`` (also ``.gz``), ``.parquet`` or ``.mat``; or the file as it was read.
    model_inputs : inputs; each must be there, without a gap.
    model_outputs : outputs; those that are absent are left out, one must be there.
    channel_map : channel -> column, where headers are not ours; else the file's own.
    start, stop : s; only the rows from ``start`` to ``stop`` are read, and only they are checked.
    optional : further channels, read as outputs where they are there. Beside ``model_outputs`` a column of theirs without a single
        number counts as absent, and so does a header such as ``airspeed_raw`` whose last word is no unit.
    instead : output -> channel that is read, under its own name, where that output has no column.
    hold : behaviour of the inputs between samples; None: as the sidecar says, else previous.
    known : all channels that there are, and their units inside.
    SI, radians and g inside; the stick keeps its numbers and its unit as a label. Columns that nobody asked
    for are never looked at. Row numbers in messages are the file's: the first line of a CSV file is row 1, the
    first sample of a Parquet or MAT file is row 1.

    The window is one block of rows in the file's order. Each of its two ends is put where it contradicts the fewest
    time stamps, so broken stamps outside do no harm, and one inside stays inside and is reported.

    Raises
    ------
    RecordError : anything that keeps the file from being used as it stands.
    """
    file = source if isinstance(source, RecordFile) else read_record_file(source)
    table, channel_map = file.table, channel_map or file.choices
    further = {name for name in optional if name not in (*model_inputs, *model_outputs)} if model_outputs else set()
    wanted = [TIME, *model_inputs, *model_outputs, *(name for name in optional if name not in model_outputs)]
    columns = _columns(file, wanted, further, channel_map, known)
    substitutes = [other for name, other in (instead or {}).items() if columns.get(name, ...) is None and other not in columns]
    columns |= _columns(file, substitutes, set(), channel_map, known)
    wanted += substitutes
    for name in (TIME, *model_inputs):
        if columns[name] is None:
            raise missing_column(name, table.header, table.file)
    outputs = [name for name in wanted[1 + len(model_inputs) :] if columns[name] is not None]
    needed = [name for name in outputs if name in (*model_outputs, *substitutes)] if model_outputs else outputs
    if not needed and (model_outputs or optional):
        raise missing_column((*model_outputs, *optional)[0], table.header, table.file)
    time, rows = _time(table, _there(columns[TIME]), start, stop)
    outputs = [name for name in outputs if name not in further or not _empty(table, _there(columns[name]), rows)]
    return Record(
        time,
        tuple(_channel(table, _there(columns[name]), rows, is_input=True) for name in model_inputs),
        tuple(_channel(table, _there(columns[name]), rows, is_input=False) for name in outputs),
        file.sidecar.hold if hold is None else hold,
        file.sidecar.name or file.path.name,
    )


def window_of(file: RecordFile, start: float | None = None, stop: float | None = None) -> tuple[np.ndarray, slice]:
    """Time stamps of a file between two times, s, checked as ``read_record`` checks them, and their rows. Raises RecordError."""
    return _time(file.table, column_of(file, TIME), start, stop)


def column_of(file: RecordFile, channel: str) -> Column:
    """The column of one of our channels by the file's own channel map. Raises RecordError where there is none, as ``find_column`` else."""
    column = _columns(file, [channel], set(), file.choices, CHANNEL_UNITS)[channel]
    if column is None:
        raise missing_column(channel, file.table.header, file.table.file)
    return column


def _columns(
    file: RecordFile, names: Sequence[str], further: set[str], channel_map: Mapping[str, ColumnChoice] | None, known: Mapping[str, str]
) -> dict[str, Column | None]:
    """Channel -> its column, None where there is none; one of ``further`` counts as absent where only a header of another meaning recalls it."""
    header = file.table.header
    return {
        name: None
        if name in further and named_otherwise(name, header, channel_map)
        else find_column(name, header, file.table.file, channel_map, file.sidecar.units, known, file.table.units)
        for name in names
    }


def rows_between(time: np.ndarray, start: float | None, stop: float | None) -> slice:
    """The block of rows from ``start`` to ``stop``, s, both inclusive, by the fewest contradicted stamps.

    ``time`` has shape ``(N,)`` and may hold NaN, which has no say. An end that was asked for stands at a row inside the window.
    """
    low, high = -math.inf if start is None else start, math.inf if stop is None else stop
    inside = (time >= low) & (time <= high)
    first, last = 0, time.size
    if start is not None:
        first = _boundary(time < low, inside)
        while first < last and not inside[first]:
            first += 1
    if stop is not None:
        last = first + _boundary(inside[first:], time[first:] > high)
        while last > first and not inside[last - 1]:
            last -= 1
    return slice(first, last)


def _boundary(before: np.ndarray, after: np.ndarray) -> int:
    """First k with the fewest rows of ``after`` ahead of k and of ``before`` from k on."""
    wrong_ahead = np.concatenate([[0], np.cumsum(after)])
    wrong_behind = np.concatenate([np.cumsum(before[::-1])[::-1], [0]])
    return int(np.argmin(wrong_ahead + wrong_behind))


def _time(table: Table, column: Column, start: float | None, stop: float | None) -> tuple[np.ndarray, slice]:
    """Checked time stamps of the window, s, and its rows."""
    for option, bound in (("--from", start), ("--to", stop)):
        if bound is not None and math.isnan(bound):
            raise RecordError(f"{option} is not a number", where=table.file, remedy="give a time in s")
    if start is not None and stop is not None and start >= stop:
        raise RecordError(f"--from {start:g} is not before --to {stop:g}", where=table.file, remedy="give the earlier time first")
    stamps = _sized(table, column)
    time = np.asarray(to_si(stamps.values, column.unit, CHANNEL_UNITS[TIME], column_place(table.file, column)))
    rows = rows_between(time, start, stop)
    cut = time[rows]
    finite = time[np.isfinite(time)]
    if cut.size == 0:
        span = f"the record covers {finite.min():g} to {finite.max():g} s" if finite.size else "no row of the record has a time"
        raise RecordError("there is no row between --from and --to", where=table.file, remedy=span)
    _check_cells(table, column, stamps, rows)
    for position in np.flatnonzero(~np.isfinite(cut)):
        where = _cell(table, column, rows.start + int(position))
        raise RecordError("time is missing", where=where, remedy="give every row a time, or cut with --from and --to")
    if cut.size == 1:
        raise RecordError("one sample only", where=_cell(table, column, rows.start), remedy="a record needs at least two rows")
    for position in np.flatnonzero(np.diff(cut) <= 0):
        earlier, later = cut[position], cut[position + 1]
        what = "time is repeated" if earlier == later else "time goes back"
        where = _cell(table, column, rows.start + int(position) + 1)
        raise RecordError(f"{what} ({earlier:.9g} s, then {later:.9g} s)", where=where, remedy="sort the rows and remove duplicates")
    return cut, rows


def _channel(table: Table, column: Column, rows: slice, *, is_input: bool) -> Channel:
    content = _sized(table, column)
    _check_cells(table, column, content, rows)
    place = column_place(table.file, column)
    values = content.values[rows]
    gaps = np.flatnonzero(np.isnan(values))
    if gaps.size == values.size:
        span = f" from row {table.rows[rows.start]} to row {table.rows[rows.stop - 1]}"
        raise RecordError(f"not a single number{span}", where=place, remedy="leave the column out, or read other rows with --from and --to")
    if is_input and gaps.size:
        where = _cell(table, column, rows.start + int(gaps[0]))
        raise RecordError("an input sample is missing", where=where, remedy="fill the gap, or cut the record there with --from and --to")
    if not column.inside:
        return Channel.of(column.channel, column.unit, values)
    return Channel.of(column.channel, column.inside, np.asarray(to_si(values, column.unit, column.inside, place)))


def _empty(table: Table, column: Column, rows: slice) -> bool:
    content = numbers(table, column.index)
    return not np.any(~np.isnan(content.values[rows])) and not any(position in range(rows.start, rows.stop) for position in content.texts)


def _sized(table: Table, column: Column) -> Numbers:
    content = numbers(table, column.index)
    if content.values.size != table.rows.size:
        what = f"{content.values.size} values for {table.rows.size} times"
        raise RecordError(what, where=column_place(table.file, column), remedy="give each time one value")
    return content


def _check_cells(table: Table, column: Column, content: Numbers, rows: slice) -> None:
    """Refuse, within the window, the first row that is ragged, holds text or an infinite number."""
    inside = range(rows.start, rows.stop)
    for position in sorted(set(table.ragged) & set(inside))[:1]:
        what, where = f"{table.ragged[position]} cells under a header of {len(table.header)}", f"{table.file}, row {table.rows[position]}"
        raise RecordError(what, where=where, remedy=_row_remedy(table, position))
    texts = [position for position in content.texts if position in inside]
    infinite = [rows.start + int(position) for position in np.flatnonzero(np.isinf(content.values[rows]))]
    if not texts and not infinite:
        return
    position = min(texts + infinite)
    where = _cell(table, column, position)
    if position in content.texts:
        text = content.texts[position]
        if (fault := mark_fault(table, text)) is not None:
            raise RecordError(fault[0], where=where, remedy=fault[1])
        shown = repr(text if len(text) <= 40 else text[:37] + "...")
        raise RecordError(f"{shown} is not a number", where=where, remedy="write a number, or leave the cell empty where the sample is missing")
    remedy = "give every row a finite time" if column.channel == TIME else "leave the cell empty where the sample is missing"
    raise RecordError("an infinite value" if column.channel != TIME else "time is infinite", where=where, remedy=remedy)


def _row_remedy(table: Table, position: int) -> str:
    more = table.separator == "," and table.ragged[position] > len(table.header)
    return f"give each row one cell a column, {'numbers with points, not decimal commas' if more else 'empty where a sample is missing'}"


def _cell(table: Table, column: Column, position: int) -> str:
    return f"{table.file}, row {table.rows[position]}, column {column.header!r}"


def _there(column: Column | None) -> Column:
    assert column is not None
    return column
