"""Read a record from a user's file, in SI units. An error names file, row and column."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from itertools import pairwise
from pathlib import Path
from typing import ParamSpec

import numpy as np

from scenarios.files.declarations import CHANNEL_UNITS, TIME, ColumnChoice
from scenarios.files.formats.cells import CellTable, Numbers, mark_fault, numbers
from scenarios.files.measured.clock import grid_of_coarse_stamps, sorted_rows
from scenarios.files.measured.columns import (
    RecordFile,
    SourceColumn,
    column_place,
    find_column,
    map_command,
    missing_column,
    named_otherwise,
    read_record_file,
    refuse_unknown_units,
)
from scenarios.files.measured.derived import with_derived
from scenarios.files.measured.grid import clock_of, clock_place, leaps, stated_unit
from scenarios.files.units import to_si
from sim.errors import RecordError, time_span
from sim.record import Channel, Hold, Record

P = ParamSpec("P")
# Longest interval between samples of an input at a lower rate, over their median interval: one
# lost sample doubles an interval, and half an interval more allows for uneven rows.
_LONGEST_GAP = 2.5


@dataclass(frozen=True, eq=False)
class Window:
    """Rows of a table between two times.

    Attributes
    ----------
    time : shape ``(N,)``, s, increasing.
    rows : the block of rows, in the file's order.
    order : shape ``(N,)``, row of each sample, counted in the block; None if the block is already
        in the order of time.
    notes : sentences on the changes to the time stamps.
    """

    time: np.ndarray
    rows: slice
    order: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    def of(self, values: np.ndarray) -> np.ndarray:
        """Return the samples of a column in the window."""
        cut = values[self.rows]
        return cut if self.order is None else cut[self.order]


def read_with_notes(
    source: str | Path | RecordFile,
    model_inputs: Sequence[str] = (),
    model_outputs: Sequence[str] = (),
    channel_map: Mapping[str, ColumnChoice] | None = None,
    start: float | None = None,
    stop: float | None = None,
    optional: Sequence[str] = (),
    hold: Hold | None = None,
    instead: Mapping[str, str] | None = None,
    channel_units: Mapping[str, str] = CHANNEL_UNITS,
    rate: float | None = None,
) -> tuple[Record, tuple[str, ...]]:
    """Read the channels of a model from a file of any format.

    Values are in SI, radians and g; the stick keeps the numbers and the unit of the file. Columns
    that no argument names are not read. Row numbers in messages are those of the file: the first
    line of a CSV file is row 1, the first sample of a Parquet or MAT file is row 1.

    The rows from ``start`` to ``stop`` are one block of the file. Its ends are placed so that the
    fewest time stamps contradict them; wrong stamps inside are reported.

    Parameters
    ----------
    source : path of a file of any format of ``scenarios.files.formats``, or the open file.
    model_inputs : inputs; each must be in the file, without a gap.
    model_outputs : outputs; at least one must be in the file.
    channel_map : channel -> column, if headers are not channel names; None: the map of the file.
    start : s; earlier rows are neither read nor checked; None: from the first row.
    stop : s; later rows are neither read nor checked; None: to the last row.
    optional : further channels, read as outputs if the file has them. A channel without a number
        counts as absent, and so does a header such as ``airspeed_raw`` whose last word is no unit.
    hold : behaviour of the inputs between samples; None: that of the sidecar, ``PREVIOUS`` without
        a sidecar.
    instead : output -> channel that is read, under its own name, if the file lacks that output.
    channel_units : SI unit of every known channel.
    rate : Hz; sample rate of a file without a clock, and of the grid for topics of a log.

    Returns
    -------
    The record, and a sentence on each decision about the file: encoding, clock, merged topics,
    inputs that are continued between their samples.

    Raises
    ------
    RecordError : the file cannot be used as it is.
    """
    file = source if isinstance(source, RecordFile) else read_record_file(source)
    channel_map = channel_map or file.choices
    possible_outputs = list(dict.fromkeys((*model_outputs, *optional, *(instead or {}).values())))
    refuse_unknown_units(
        file.sidecar, file.table.header, file.path, {*CHANNEL_UNITS, *channel_units, *channel_map}
    )
    hold_as = None if hold is None else hold.value
    file, channel_map = with_derived(
        file,
        channel_map,
        model_inputs,
        possible_outputs,
        rate=rate,
        hold=hold_as,
        channel_units=channel_units,
    )
    table = file.table
    names = (model_inputs, model_outputs, optional)
    columns, outputs, dropped_if_empty = _chosen(
        file, names, instead or {}, channel_map, channel_units
    )
    window = _time(table, _clock_column(file, channel_map, channel_units, rate), start, stop, rate)
    outputs = [
        name
        for name in outputs
        if name not in dropped_if_empty or not _empty(table, _present(columns[name]), window.rows)
    ]
    notes, inputs = [*file.notes, *window.notes], []
    for name in model_inputs:
        chosen_hold = getattr((channel_map or {}).get(name), "hold", None) or hold_as
        channel, note = _input(table, _present(columns[name]), window, chosen_hold)
        inputs.append(channel)
        if note:
            notes.append(note)
    output_channels = tuple(_channel(table, _present(columns[name]), window) for name in outputs)
    input_hold = hold or file.sidecar.hold
    record_name = file.sidecar.name or file.path.name
    record = Record(window.time, tuple(inputs), output_channels, input_hold, record_name)
    return record, tuple(notes)


def _chosen(
    file: RecordFile,
    names: tuple[Sequence[str], Sequence[str], Sequence[str]],
    instead: Mapping[str, str],
    channel_map: Mapping[str, ColumnChoice] | None,
    channel_units: Mapping[str, str],
) -> tuple[dict[str, SourceColumn | None], list[str], set[str]]:
    """Find the columns of the channels to read.

    ``names``: inputs, outputs and optional channels.

    Returns the column by channel (None if the file has none), the outputs to read, and those that
    are not read if their column is empty. Raises RecordError if an input or every output has no
    column.
    """
    inputs, model_outputs, optional = names
    dropped_if_empty: set[str] = set()
    if model_outputs:
        dropped_if_empty = {name for name in optional if name not in (*inputs, *model_outputs)}
    added = [name for name in optional if name not in model_outputs]
    columns = _columns(
        file, [*inputs, *model_outputs, *added], dropped_if_empty, channel_map, channel_units
    )
    substitutes = [
        other
        for name, other in instead.items()
        if columns.get(name, ...) is None and other not in columns
    ]
    columns |= _columns(file, substitutes, set(), channel_map, channel_units)
    for name in inputs:
        if columns[name] is None:
            raise missing_column(name, file.table.header, file.table.file)
    outputs = [name for name in (*model_outputs, *added, *substitutes) if columns[name] is not None]
    required = (*model_outputs, *substitutes) if model_outputs else outputs
    if not any(name in required for name in outputs) and (model_outputs or optional):
        missing = (*model_outputs, *optional)[0]
        raise missing_column(missing, file.table.header, file.table.file)
    return columns, outputs, dropped_if_empty


def _without_notes(read: Callable[P, tuple[Record, tuple[str, ...]]]) -> Callable[P, Record]:
    """Return a function with the arguments of ``read`` that returns the record only."""

    @wraps(read)
    def record_only(*arguments: P.args, **keywords: P.kwargs) -> Record:
        return read(*arguments, **keywords)[0]

    return record_only


read_record = _without_notes(read_with_notes)


def window_of(
    file: RecordFile, start: float | None = None, stop: float | None = None
) -> tuple[np.ndarray, slice]:
    """Return the time stamps of a file from ``start`` to ``stop``, shape ``(N,)``, s, checked as in
    ``read_record``, and their rows. Raises RecordError.
    """
    window = _time(
        file.table, _clock_column(file, file.choices, CHANNEL_UNITS, None), start, stop, None
    )
    return window.time, window.rows


def raw_column(file: RecordFile, index: int) -> np.ndarray:
    """Return the numbers of a column in the unit of the file, shape ``(N,)``; NaN if a cell has no
    number. Raises RecordError.
    """
    window = _time(
        file.table, _clock_column(file, file.choices, CHANNEL_UNITS, None), None, None, None
    )
    return window.of(numbers(file.table, index).values)


def refuse_without_clock(file: RecordFile) -> None:
    """Raise RecordError if a file has no column of time, or if it is a log of several topics, each
    with a clock of its own.
    """
    if file.topics:
        remedy = f"name its channels with a channel map; {map_command(file.path)} drafts one"
        raise RecordError(
            f"a log of {len(file.topics)} topics", where=str(file.path), remedy=remedy
        )
    _clock_column(file, file.choices, CHANNEL_UNITS, None)


def has_clock(file: RecordFile, channel_map: Mapping[str, ColumnChoice] | None = None) -> bool:
    """Return whether a file has one clock, in the channel map or found by its name."""
    if file.topics:
        return False  # each topic has a clock
    return TIME in (channel_map or file.choices) or clock_place(file.table) is not None


def refuse_rate(file: RecordFile, channel_map: Mapping[str, ColumnChoice] | None = None) -> None:
    """Raise RecordError if a user gives a rate to a search for maneuvers in a file with a clock."""
    if has_clock(file, channel_map):
        where, remedy = f"{file.path}, --rate", "leave --rate out: nothing is resampled here"
        raise RecordError("the file has a clock of its own", where=where, remedy=remedy)


def column_of(file: RecordFile, channel: str) -> SourceColumn:
    """Return the column of a channel by the file's own channel map.

    Raises RecordError if the file has no such column, and as ``find_column``.
    """
    column = _columns(file, [channel], set(), file.choices, CHANNEL_UNITS)[channel]
    if column is None:
        raise missing_column(channel, file.table.header, file.table.file)
    return column


def _columns(
    file: RecordFile,
    names: Sequence[str],
    optional: set[str],
    channel_map: Mapping[str, ColumnChoice] | None,
    channel_units: Mapping[str, str],
) -> dict[str, SourceColumn | None]:
    """Return the column of each channel, None if the file has none; a channel of ``optional``
    counts as absent if the only similar header has another meaning.
    """
    header = file.table.header
    columns: dict[str, SourceColumn | None] = {}
    for name in names:
        if name in optional and named_otherwise(name, header, channel_map):
            columns[name] = None
            continue
        columns[name] = find_column(
            name,
            header,
            file.table.file,
            channel_map,
            file.sidecar.units,
            channel_units,
            file.table.units,
            lenient=file.table.stated_apart,
        )
    return columns


def rows_between(time: np.ndarray, start: float | None, stop: float | None) -> slice:
    """Return the block of rows from ``start`` to ``stop`` that the fewest time stamps contradict.

    ``time``: ``(N,)``, s; NaN are ignored. ``start`` and ``stop``: s, inclusive; the first and the
    last row of a block with such an end lie between them.
    """
    low = -math.inf if start is None else start
    high = math.inf if stop is None else stop
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
    """Return the first row k with the fewest rows of ``after`` in front of k and of ``before`` from
    k on.
    """
    wrong_ahead = np.concatenate([[0], np.cumsum(after)])
    wrong_behind = np.concatenate([np.cumsum(before[::-1])[::-1], [0]])
    return int(np.argmin(wrong_ahead + wrong_behind))


def _clock_column(
    file: RecordFile,
    channel_map: Mapping[str, ColumnChoice] | None,
    channel_units: Mapping[str, str],
    rate: float | None,
) -> SourceColumn | None:
    """Return the column of the clock: ``time``, else one with another usual name of a clock; None
    if the file has no clock and its rate is known.
    """
    column = _columns(file, [TIME], set(), channel_map, channel_units)[TIME]
    table = file.table
    if column is not None:
        mapped = (channel_map or {}).get(TIME)
        if mapped is not None and mapped.unit is not None:
            unit: str | None = column.unit
        else:
            unit = stated_unit(table, column.index)
        if unit is None and (TIME in file.sidecar.units or column.unit != CHANNEL_UNITS[TIME]):
            unit = column.unit  # from a header such as ``time_ms``, or from the sidecar
        return replace(column, unit=unit or "")
    index = clock_place(table)
    if index is not None:
        unit = stated_unit(table, index) or ""
        return SourceColumn(TIME, table.header[index], index, unit, CHANNEL_UNITS[TIME])
    if rate is not None:
        return None
    raise missing_clock(table)


def missing_clock(table: CellTable) -> RecordError:
    """Return the error for a table in which no column is a clock."""
    error = missing_column(TIME, table.header, table.file)
    remedy = error.remedy
    if table.header and table.header[0] == "column 1":  # the file has no header
        names = ",".join([TIME, *(f"NAME{n}" for n in range(2, min(len(table.header), 4) + 1))])
        more = ",..." if len(table.header) > 4 else ""
        remedy = f"name the columns with --columns {names}{more}"
    return RecordError(
        error.what,
        where=error.where,
        remedy=f"{remedy}; of a record without a clock give --rate HZ",
    )


def _time(
    table: CellTable,
    column: SourceColumn | None,
    start: float | None,
    stop: float | None,
    rate: float | None,
) -> Window:
    """Return the rows from ``start`` to ``stop``, s, with their time stamps, checked and in order;
    without a clock (``column`` is None) ``rate``, Hz, gives the time.
    """
    for option, bound in (("--from", start), ("--to", stop)):
        if bound is not None and (not isinstance(bound, int | float | np.number) or bound != bound):
            raise RecordError(
                f"{option} is not a number", where=table.file, remedy="give a time in s"
            )
    if start is not None and stop is not None and start >= stop:
        what = f"--from {start:g} is not before --to {stop:g}"
        raise RecordError(what, where=table.file, remedy="give the earlier time first")
    if column is None:
        assert rate is not None
        time = np.arange(table.rows.size) / rate
        notes = [f"the file has no clock: its rows are taken at {rate:g} Hz"]
        stamps, column = Numbers(time, {}), SourceColumn(TIME, TIME, 0, "s", "s")
    else:
        if len(table.columns[column.index]) != table.rows.size:
            _sized(table, column)
        clock = clock_of(table, column.index, column.unit or None)
        time, notes = clock.time, list(clock.notes)
        texts = numbers(table, column.index).texts if not np.all(np.isfinite(time)) else {}
        stamps = Numbers(time, texts)
    rows = rows_between(time, start, stop)
    cut = time[rows]
    finite = time[np.isfinite(time)]
    if cut.size == 0:
        span = (
            f"the record covers {time_span(finite.min(), finite.max())}"
            if finite.size
            else "no row of the record has a time"
        )
        raise RecordError("there is no row between --from and --to", where=table.file, remedy=span)
    _check_cells(table, column, stamps, rows)
    for position in np.flatnonzero(~np.isfinite(cut)):
        where = _cell(table, column, rows.start + int(position))
        remedy = "give every row a time, or cut with --from and --to"
        raise RecordError("time is missing", where=where, remedy=remedy)
    if cut.size == 1:
        where = _cell(table, column, rows.start)
        remedy = "a record needs at least two rows"
        raise RecordError("one sample only", where=where, remedy=remedy)
    regular = grid_of_coarse_stamps(cut)
    if regular is not None:
        return Window(regular[0], rows, None, (*notes, regular[1]))
    wrong = np.flatnonzero(np.diff(cut) <= 0)
    if not wrong.size:
        return Window(cut, rows, None, tuple(notes))
    ordered = sorted_rows(cut, _repeats(table, cut, rows))
    if ordered is not None:
        return Window(ordered.time, rows, ordered.order, (*notes, *ordered.notes))
    first = int(wrong[0])
    earlier, later = cut[first], cut[first + 1]
    what = "time is repeated" if earlier == later else "time goes back"
    where = _cell(table, column, rows.start + first + 1)
    more = f", and in {wrong.size - 1} more rows" if wrong.size > 1 else ""
    name = repr(column.header)
    raise RecordError(
        f"{what} ({earlier:.9g} s, then {later:.9g} s{more})",
        where=where,
        remedy="leave these rows out with --from and --to, or sort the rows and remove duplicates "
        f"(pandas: table.sort_values({name}).drop_duplicates({name}))",
    )


def _repeats(table: CellTable, time: np.ndarray, rows: slice) -> np.ndarray:
    """Return which rows repeat time and cells of the row before them, in the order of time.

    ``time``: shape ``(N,)``, s. Returns booleans, shape ``(N,)``, by position in the block.
    """
    order = np.argsort(time, kind="stable")
    repeated = np.zeros(time.size, dtype=bool)
    for earlier, later in pairwise(order):
        if time[earlier] == time[later]:
            cells = (
                (column[rows.start + earlier], column[rows.start + later])
                for column in table.columns
            )
            repeated[later] = all(a == b or (a != a and b != b) for a, b in cells)  # NaN like NaN
    return repeated


def _input(
    table: CellTable, column: SourceColumn, window: Window, hold: str | None
) -> tuple[Channel, str]:
    """Return an input, and a sentence on how it continues between samples, or an empty text.

    An input may be sampled at a lower rate than the rows: then it is held or joined by lines
    (``hold``; None: held if it leaps). A gap beyond ``_LONGEST_GAP`` is an error instead.
    """
    content = _sized(table, column)
    _check_cells(table, column, content, window.rows)
    values = window.of(content.values)
    finite_rows = np.flatnonzero(np.isfinite(values))
    if finite_rows.size in (0, values.size):
        return _channel(table, column, window), ""
    time = window.time
    intervals = np.diff(time[finite_rows]) if finite_rows.size > 2 else np.array([np.inf])
    usual = float(np.median(intervals))
    gap_at_ends = max(time[finite_rows[0]] - time[0], time[-1] - time[finite_rows[-1]])
    if (
        not np.isfinite(usual)
        or np.median(np.diff(finite_rows)) < 2
        or max(float(intervals.max()), gap_at_ends) > _LONGEST_GAP * usual
    ):
        where = _cell(table, column, _row_of(window, int(np.flatnonzero(~np.isfinite(values))[0])))
        remedy = "fill the gap, or cut the record there with --from and --to"
        raise RecordError("an input sample is missing", where=where, remedy=remedy)
    chosen = hold or ("previous" if leaps(values[finite_rows]) else "linear")
    if chosen == "previous":
        latest = np.searchsorted(finite_rows, np.arange(values.size), side="right") - 1
        filled = values[finite_rows[np.clip(latest, 0, finite_rows.size - 1)]]
    else:
        filled = np.interp(time, time[finite_rows], values[finite_rows])
    word = "held" if chosen == "previous" else "joined by lines"
    note = (
        f"{column.channel} has a sample every {usual:.3g} s; between them it is {word} (hold in "
        "the channel map, or --hold, decides otherwise)"
    )
    return _converted(table, column, filled), note


def _channel(table: CellTable, column: SourceColumn, window: Window) -> Channel:
    """Return the samples of a column in the window, in SI; NaN where a sample is missing."""
    content = _sized(table, column)
    rows = window.rows
    _check_cells(table, column, content, rows)
    values = window.of(content.values)
    if np.all(np.isnan(values)):
        span = f" from row {table.rows[rows.start]} to row {table.rows[rows.stop - 1]}"
        place = column_place(table.file, column)
        raise RecordError(
            f"not a single number{span}",
            where=place,
            remedy="leave the column out, or read other rows with --from and --to",
        )
    return _converted(table, column, values)


def _converted(table: CellTable, column: SourceColumn, values: np.ndarray) -> Channel:
    if not column.inside:
        return Channel.of(column.channel, column.unit, values)
    return Channel.of(
        column.channel,
        column.inside,
        np.asarray(to_si(values, column.unit, column.inside, column_place(table.file, column))),
    )


def _row_of(window: Window, sample: int) -> int:
    """Return the row of the table that holds a sample of the window."""
    return window.rows.start + (sample if window.order is None else int(window.order[sample]))


def _empty(table: CellTable, column: SourceColumn, rows: slice) -> bool:
    """Return whether a column has neither a number nor a text in the rows."""
    content = numbers(table, column.index)
    has_text = any(position in range(rows.start, rows.stop) for position in content.texts)
    return not has_text and bool(np.all(np.isnan(content.values[rows])))


def _sized(table: CellTable, column: SourceColumn) -> Numbers:
    """Return the cells of a column; raise RecordError unless it has one for each row."""
    content = numbers(table, column.index)
    if content.values.size != table.rows.size:
        what = f"{content.values.size} values for {table.rows.size} times"
        raise RecordError(
            what, where=column_place(table.file, column), remedy="give each time one value"
        )
    return content


def _check_cells(table: CellTable, column: SourceColumn, content: Numbers, rows: slice) -> None:
    """Raise RecordError for the first row with too few or too many cells, else for the first cell
    of the column that is a text or infinite.
    """
    inside = range(rows.start, rows.stop)
    for position in sorted(set(table.ragged) & set(inside))[:1]:
        what = f"{table.ragged[position]} cells under a header of {len(table.header)}"
        where = f"{table.file}, row {table.rows[position]}"
        raise RecordError(what, where=where, remedy=_row_remedy(table, position))
    texts = [position for position in content.texts if position in inside]
    infinite = [
        rows.start + int(position) for position in np.flatnonzero(np.isinf(content.values[rows]))
    ]
    if not texts and not infinite:
        return
    position = min(texts + infinite)
    where = _cell(table, column, position)
    if position in content.texts:
        text = content.texts[position]
        if (fault := mark_fault(table, text)) is not None:
            raise RecordError(fault[0], where=where, remedy=fault[1])
        shown = repr(text if len(text) <= 40 else text[:37] + "...")
        remedy = "write a number, or leave the cell empty where the sample is missing"
        raise RecordError(f"{shown} is not a number", where=where, remedy=remedy)
    if column.channel == TIME:
        remedy = "give every row a finite time"
        raise RecordError("time is infinite", where=where, remedy=remedy)
    remedy = "leave the cell empty where the sample is missing"
    raise RecordError("an infinite value", where=where, remedy=remedy)


def _row_remedy(table: CellTable, position: int) -> str:
    if table.separator == "," and table.ragged[position] > len(table.header):
        return "give each row one cell a column, numbers with points, not decimal commas"
    return "give each row one cell a column, empty where a sample is missing"


def _cell(table: CellTable, column: SourceColumn, position: int) -> str:
    """Return the place of a cell as errors name it."""
    return f"{table.file}, row {table.rows[position]}, column {column.header!r}"


def _present(column: SourceColumn | None) -> SourceColumn:
    """Return a column that ``_chosen`` has found; for the type checker."""
    assert column is not None
    return column
