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
    has_other_suffixes_only,
    map_command,
    missing_column,
    read_record_file,
    refuse_unknown_units,
)
from scenarios.files.measured.derived import with_derived
from scenarios.files.measured.grid import clock_of, clock_place, moves_in_steps, stated_unit
from scenarios.files.units import to_si
from sim.errors import RecordError, time_span
from sim.record import Channel, Hold, Record

P = ParamSpec("P")
# Longest interval between samples of an input at a lower rate, over their median interval: one
# lost sample doubles an interval, and uneven rows add half of one.
_LONGEST_GAP = 2.5
_LONGEST_SHOWN_CELL = 40  # characters of a cell in a message


@dataclass(frozen=True, eq=False)
class Window:
    """Rows of a table between two times.

    Attributes
    ----------
    time : ``(N,)``, s, increasing.
    rows : block of rows of the file.
    order : ``(N,)`` position of each sample in the block; None if the block is in the order of
        time.
    notes : sentences on changes of the time stamps.
    """

    time: np.ndarray
    rows: slice
    order: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    def samples_of(self, values: np.ndarray) -> np.ndarray:
        """Return the samples ``(N,)`` of a column in the window, in the order of time."""
        block = values[self.rows]
        return block if self.order is None else block[self.order]


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
    hold_word = None if hold is None else hold.value
    file, channel_map = with_derived(
        file,
        channel_map,
        model_inputs,
        possible_outputs,
        rate=rate,
        hold=hold_word,
        channel_units=channel_units,
    )
    table = file.table
    names = (model_inputs, model_outputs, optional)
    columns, outputs, dropped_if_empty = _columns_to_read(
        file, names, instead or {}, channel_map, channel_units
    )
    clock = _clock_column(file, channel_map, channel_units, rate)
    window = _checked_window(table, clock, start, stop, rate)
    for name in dropped_if_empty.intersection(outputs):
        if _is_empty(table, _present(columns[name]), window.rows):
            outputs.remove(name)
    notes, inputs = [*file.notes, *window.notes], []
    for name in model_inputs:
        chosen_hold = getattr((channel_map or {}).get(name), "hold", None) or hold_word
        channel, note = _input(table, _present(columns[name]), window, chosen_hold)
        inputs.append(channel)
        if note:
            notes.append(note)
    output_channels = tuple(_channel(table, _present(columns[name]), window) for name in outputs)
    input_hold = hold or file.sidecar.hold
    record_name = file.sidecar.name or file.path.name
    record = Record(window.time, tuple(inputs), output_channels, input_hold, record_name)
    return record, tuple(notes)


def _columns_to_read(
    file: RecordFile,
    names: tuple[Sequence[str], Sequence[str], Sequence[str]],
    instead: Mapping[str, str],
    channel_map: Mapping[str, ColumnChoice] | None,
    channel_units: Mapping[str, str],
) -> tuple[dict[str, SourceColumn | None], list[str], set[str]]:
    """Return channel -> column (None if the file has none), the outputs to read, and the outputs
    that are not read if their column is empty.

    ``names`` are the inputs, the outputs and the optional channels.

    Raises
    ------
    RecordError : if an input or every output has no column.
    """
    inputs, model_outputs, optional = names
    dropped_if_empty: set[str] = set()
    if model_outputs:
        dropped_if_empty = {name for name in optional if name not in (*inputs, *model_outputs)}
    further = [name for name in optional if name not in model_outputs]
    columns = _columns(
        file, [*inputs, *model_outputs, *further], dropped_if_empty, channel_map, channel_units
    )
    substitutes = [
        substitute
        for name, substitute in instead.items()
        if columns.get(name, ...) is None and substitute not in columns
    ]
    columns |= _columns(file, substitutes, set(), channel_map, channel_units)
    for name in inputs:
        if columns[name] is None:
            raise missing_column(name, file.table.header, file.table.file)
    candidates = (*model_outputs, *further, *substitutes)
    outputs = [name for name in candidates if columns[name] is not None]
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
    """Return the time stamps ``(N,)`` of a file from ``start`` to ``stop``, s, and their rows. They
    are checked as in ``read_record``, which may raise RecordError.
    """
    window = _checked_window(
        file.table, _clock_column(file, file.choices, CHANNEL_UNITS, None), start, stop, None
    )
    return window.time, window.rows


def raw_column(file: RecordFile, index: int) -> np.ndarray:
    """Return the numbers ``(N,)`` of a column in the unit of the file, NaN where a cell has no
    number. The time stamps are checked as in ``read_record``.
    """
    window = _checked_window(
        file.table, _clock_column(file, file.choices, CHANNEL_UNITS, None), None, None, None
    )
    return window.samples_of(numbers(file.table, index).values)


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
    """Raise RecordError if a file has a clock, so that a rate given by the user has no meaning."""
    if has_clock(file, channel_map):
        where, remedy = f"{file.path}, --rate", "leave --rate out: nothing is resampled here"
        raise RecordError("the file has a clock of its own", where=where, remedy=remedy)


def column_of(file: RecordFile, channel: str) -> SourceColumn:
    """Return the column of a channel by the channel map of the file.

    Raises
    ------
    RecordError : if the file has no such column, and as ``find_column``.
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
    """Return channel -> column, None if the file has none. A channel in ``optional`` counts as
    absent if the only similar header has another meaning.
    """
    header = file.table.header
    columns: dict[str, SourceColumn | None] = {}
    for name in names:
        if name in optional and has_other_suffixes_only(name, header, channel_map):
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

    Parameters
    ----------
    time : ``(N,)``, s; NaN are ignored.
    start, stop : s, inclusive; None for the first or last row of the file. The time of the first
        and last row of the block is between them.
    """
    low = -math.inf if start is None else start
    high = math.inf if stop is None else stop
    target_unit = (time >= low) & (time <= high)
    first, last = 0, time.size
    if start is not None:
        first = _boundary(time < low, target_unit)
        while first < last and not target_unit[first]:
            first += 1
    if stop is not None:
        last = first + _boundary(target_unit[first:], time[first:] > high)
        while last > first and not target_unit[last - 1]:
            last -= 1
    return slice(first, last)


def _boundary(before: np.ndarray, after: np.ndarray) -> int:
    """Return the row at which a block best begins: rows marked in ``before (N,)`` should be earlier
    than it, and rows marked in ``after (N,)`` should not. The first of equally good rows is taken.
    """
    wrong_earlier_rows = np.concatenate([[0], np.cumsum(after)])
    wrong_later_rows = np.concatenate([np.cumsum(before[::-1])[::-1], [0]])
    return int(np.argmin(wrong_earlier_rows + wrong_later_rows))


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


def _checked_window(
    table: CellTable,
    column: SourceColumn | None,
    start: float | None,
    stop: float | None,
    rate: float | None,
) -> Window:
    """Return the rows from ``start`` to ``stop``, s, with their checked time stamps.

    ``column`` is that of the clock. If it is None, the time follows from the ``rate``, Hz.
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
            _numbers_of_all_rows(table, column)
        clock = clock_of(table, column.index, column.unit or None)
        time, notes = clock.time, list(clock.notes)
        texts = numbers(table, column.index).texts if not np.all(np.isfinite(time)) else {}
        stamps = Numbers(time, texts)
    rows = rows_between(time, start, stop)
    block_time = time[rows]
    if block_time.size == 0:
        finite, span = time[np.isfinite(time)], "no row of the record has a time"
        if finite.size:
            span = f"the record covers {time_span(finite.min(), finite.max())}"
        raise RecordError("there is no row between --from and --to", where=table.file, remedy=span)
    _check_cells(table, column, stamps, rows)
    for position in np.flatnonzero(~np.isfinite(block_time)):
        where = _cell(table, column, rows.start + int(position))
        remedy = "give every row a time, or cut the record with --from and --to"
        raise RecordError("time is missing", where=where, remedy=remedy)
    if block_time.size == 1:
        where = _cell(table, column, rows.start)
        remedy = "a record needs at least two rows"
        raise RecordError("one sample only", where=where, remedy=remedy)
    regular = grid_of_coarse_stamps(block_time)
    if regular is not None:
        return Window(regular[0], rows, None, (*notes, regular[1]))
    wrong = np.flatnonzero(np.diff(block_time) <= 0)
    if not wrong.size:
        return Window(block_time, rows, None, tuple(notes))
    ordered = sorted_rows(block_time, _repeats(table, block_time, rows))
    if ordered is not None:
        return Window(ordered.time, rows, ordered.order, (*notes, *ordered.notes))
    first = int(wrong[0])
    earlier, later = block_time[first], block_time[first + 1]
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
    """Return whether each row of a block repeats the time and all cells of the row before it in the
    order of time, ``(N,)``. ``time (N,)``, s, is that of the block.
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
    """Return an input, and a sentence on its interpolation; empty if it has a sample in each row.

    An input with a lower rate than the rows is held, or joined by lines, between its samples.
    ``hold`` says which; None holds an input that moves in steps. A gap beyond ``_LONGEST_GAP`` is
    an error.
    """
    content = _numbers_of_all_rows(table, column)
    _check_cells(table, column, content, window.rows)
    values = window.samples_of(content.values)
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
    chosen = hold or ("previous" if moves_in_steps(values[finite_rows]) else "linear")
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
    return _channel_in_si(table, column, filled), note


def _channel(table: CellTable, column: SourceColumn, window: Window) -> Channel:
    """Return the samples of a column in the window, in SI; NaN where a sample is missing."""
    content = _numbers_of_all_rows(table, column)
    rows = window.rows
    _check_cells(table, column, content, rows)
    values = window.samples_of(content.values)
    if np.all(np.isnan(values)):
        span = f" from row {table.rows[rows.start]} to row {table.rows[rows.stop - 1]}"
        place = column_place(table.file, column)
        remedy = "leave the column out, or read other rows with --from and --to"
        raise RecordError(f"not a single number{span}", where=place, remedy=remedy)
    return _channel_in_si(table, column, values)


def _channel_in_si(table: CellTable, column: SourceColumn, values: np.ndarray) -> Channel:
    """Return a channel with values in its unit in the program, or in that of the file if it has
    none.
    """
    if not column.target_unit:
        return Channel.of(column.channel, column.unit, values)
    return Channel.of(
        column.channel,
        column.target_unit,
        np.asarray(
            to_si(values, column.unit, column.target_unit, column_place(table.file, column))
        ),
    )


def _row_of(window: Window, sample: int) -> int:
    return window.rows.start + (sample if window.order is None else int(window.order[sample]))


def _is_empty(table: CellTable, column: SourceColumn, rows: slice) -> bool:
    """Return whether a column has neither a number nor a text in the rows."""
    content = numbers(table, column.index)
    has_text = any(position in range(rows.start, rows.stop) for position in content.texts)
    return not has_text and bool(np.all(np.isnan(content.values[rows])))


def _numbers_of_all_rows(table: CellTable, column: SourceColumn) -> Numbers:
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
    target_unit = range(rows.start, rows.stop)
    for position in sorted(set(table.ragged) & set(target_unit))[:1]:
        what = f"{table.ragged[position]} cells under a header of {len(table.header)}"
        where = f"{table.file}, row {table.rows[position]}"
        raise RecordError(what, where=where, remedy=_row_remedy(table, position))
    texts = [position for position in content.texts if position in target_unit]
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
        if len(text) > _LONGEST_SHOWN_CELL:
            text = text[: _LONGEST_SHOWN_CELL - 3] + "..."
        remedy = "write a number, or leave the cell empty where the sample is missing"
        raise RecordError(f"{text!r} is not a number", where=where, remedy=remedy)
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
    return f"{table.file}, row {table.rows[position]}, column {column.header!r}"


def _present(column: SourceColumn | None) -> SourceColumn:
    """Return a column that is known to exist, with a type that excludes None."""
    assert column is not None
    return column
