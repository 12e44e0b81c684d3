"""Read the lines of a stream, and convert them to rows in SI units and in the order of time."""

from __future__ import annotations

import csv
import math
import os
import queue
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scenarios.files.declarations import CHANNEL_UNITS, STICK, TIME, ColumnChoice
from scenarios.files.formats.cells import CellTable, is_number
from scenarios.files.measured.columns import (
    RecordFile,
    Sidecar,
    SourceColumn,
    column_place,
    find_column,
    missing_column,
    refuse_unknown_units,
)
from scenarios.files.measured.derived import source_columns, with_derived
from scenarios.files.measured.expressions import is_plain_name
from scenarios.files.sources import InputFile
from scenarios.files.units import to_si
from scenarios.watching.line_cells import (
    COMMA,
    header_cells,
    numbers_of,
    plain_numbers,
    separator_of,
)
from sim.errors import RecordError

# ---- Complete lines as they arrive, from a file that grows or from standard input

POLL_INTERVAL = 0.1  # s between reads of a source without new data
LARGEST_PIECE = 1 << 16  # bytes that are read at a time
STANDARD_INPUT = 0  # file descriptor
MOST_WAITING_PIECES = 16  # pieces of standard input that are read ahead
LONGEST_LINE = 1 << 20  # bytes
_NOT_LINES = (".gz", ".parquet", ".pq", ".mat")  # suffixes of files that are no text

# Returns new bytes, empty bytes if there are none yet, None at the end of the source.
Read = Callable[[], bytes | None]


class Lines(NamedTuple):
    """New lines of a stream.

    Attributes
    ----------
    whole : complete lines without their ends.
    unfinished : at the end of the stream, an incomplete line.
    """

    whole: list[bytes]
    unfinished: bytes = b""


def lines_of(read: Read, idle: float | None, name: str) -> Iterator[Lines]:
    """Yield new lines of a source; ``Lines`` without any if the source has nothing new.

    Parameters
    ----------
    read : reads the source; it waits ``POLL_INTERVAL`` before it returns empty bytes.
    idle : s; the stream ends after this time without a byte. None: it ends with the source.
    name : name of the stream, for errors.

    Raises
    ------
    RecordError : a line is longer than ``LONGEST_LINE``.
    """
    rest, last_read = b"", time.monotonic()
    while (piece := read()) is not None:
        if piece:
            last_read = time.monotonic()
            *whole, rest = (rest + piece).split(b"\n")
            if len(rest) > LONGEST_LINE:
                raise RecordError(
                    "a line without end",
                    where=name,
                    remedy="stream comma-separated text, one row a line",
                )
            yield Lines([line.removesuffix(b"\r") for line in whole])
        elif idle is not None and time.monotonic() - last_read >= idle:
            break
        else:
            yield Lines([])
    yield Lines([], rest)


@contextmanager
def growing_file(path: Path, until_end: bool) -> Iterator[Read]:
    """Give the body a function that reads a file piece by piece, also while the file grows.

    The source ends if the file becomes shorter. ``until_end``: it also ends at the end of the file.

    Raises
    ------
    RecordError : there is no such file, it is a folder or no text, or it cannot be read.
    """
    if not path.exists():
        raise RecordError("there is no such file", where=str(path), remedy="check the path")
    if path.is_dir():
        raise RecordError("this is a folder", where=str(path), remedy="name the record file in it")
    if path.suffix.lower() in _NOT_LINES:
        raise RecordError(
            "only comma-separated text arrives line by line",
            where=str(path),
            remedy="give a CSV file, or use flightid identify",
        )
    try:
        file = path.open("rb", buffering=0)
    except OSError as error:
        raise RecordError(
            f"cannot be read ({error.strerror})",
            where=str(path),
            remedy="check the file and its permissions",
        ) from None
    with file:

        def read() -> bytes | None:
            piece = file.read(LARGEST_PIECE)
            if piece:
                return piece
            if until_end or (path.is_file() and os.fstat(file.fileno()).st_size < file.tell()):
                return None
            time.sleep(POLL_INTERVAL)
            return b""

        yield read


def standard_input() -> Read:
    """Return a function that reads piped input until the pipe ends.

    A thread reads the pipe a few pieces ahead: Windows cannot wait for a pipe with a time limit.
    """
    pieces: queue.Queue[bytes | OSError] = queue.Queue(MOST_WAITING_PIECES)
    ended = False

    def wait() -> None:
        piece: bytes | OSError = b" "
        while piece and not isinstance(piece, OSError):
            try:
                piece = os.read(STANDARD_INPUT, LARGEST_PIECE)
            except OSError as error:
                piece = error
            pieces.put(piece)

    threading.Thread(target=wait, daemon=True, name="standard input").start()

    def read() -> bytes | None:
        nonlocal ended
        if ended:
            return None
        try:
            piece = pieces.get(timeout=POLL_INTERVAL)
        except queue.Empty:
            return b""
        if isinstance(piece, OSError):
            raise RecordError(
                f"cannot be read ({piece.strerror})",
                where="standard input",
                remedy="check what is piped in",
            )
        ended = not piece
        return piece or None

    return read


# ---- Rows in SI units and in the order of time

INPUTS, OUTPUTS = (STICK,), ("alpha", "q", "nz")
LARGEST_JUMP = 1.0  # s; a larger jump of the time must be confirmed by the next row
UNWRAP = re.compile(r"\bunwrap\s*\(")
LONGEST_BRIDGED_GAP = 600.0  # s; after a longer gap the filter cannot continue


@dataclass(frozen=True)
class StreamSignals:
    """Signals that are read from a stream.

    Attributes
    ----------
    inputs, outputs : names of the channels.
    channel_units : SI unit of every known channel.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    channel_units: Mapping[str, str] = field(default_factory=lambda: CHANNEL_UNITS)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the rows of a table: time, inputs, outputs."""
        return (TIME, *self.inputs, *self.outputs)


LOES = StreamSignals(INPUTS, OUTPUTS)


@dataclass(frozen=True)
class Header:
    """Columns and units of a stream's rows.

    Attributes
    ----------
    columns : column of each signal, in the order of ``signals.names``; None for an output or clock
        that the stream does not have.
    width : number of cells in a row.
    name : name of the stream.
    rate : sampling rate of a stream without a clock, Hz.
    first : number of the line with the first row.
    computed : if the channel map computes channels, a file without rows and the map. ``columns``
        are then columns of a table with the computed channels.
    sources : indices of the columns that are read, ascending.
    signals : the signals.
    separator : separator of the cells of a row.
    """

    columns: tuple[SourceColumn | None, ...]
    width: int
    name: str
    rate: float | None = None
    first: int = 2
    computed: tuple[RecordFile, Mapping[str, ColumnChoice]] | None = None
    sources: tuple[int, ...] = ()
    signals: StreamSignals = LOES
    separator: str = COMMA

    @property
    def stick_unit(self) -> str:
        """Unit of the stick as the stream calls it."""
        column = self.columns[1]
        assert column is not None
        return column.unit


class Fault(NamedTuple):
    """A fault of a line.

    Attributes
    ----------
    row : number of the line; the header is row 1.
    what : the fault.
    left_out : whether the line was left out; else a cell was filled in.
    """

    row: int
    what: str
    left_out: bool = True


class Order(NamedTuple):
    """State of the check that rows are in the order of time.

    Attributes
    ----------
    time : time of the last accepted row, s.
    last_inputs : inputs of the last accepted row.
    waiting : a row after a jump of the time, which the next row must confirm, or None.
    waiting_row : number of the line of this row.
    lost : time before a jump by more than ``LONGEST_BRIDGED_GAP``, s; later rows are left out.
    inputs : names of the inputs.
    """

    time: float = -math.inf
    last_inputs: tuple[float, ...] = ()
    waiting: np.ndarray | None = None
    waiting_row: int = 0
    lost: float | None = None
    inputs: tuple[str, ...] = INPUTS


def read_header(
    line: bytes,
    name: str,
    choices: Mapping[str, ColumnChoice] | None = None,
    units: Mapping[str, str] | None = None,
    names: Sequence[str] = (),
    rate: float | None = None,
    first: int = 2,
    signals: StreamSignals = LOES,
) -> Header:
    """Return the header of a stream, by the rules for records.

    Parameters
    ----------
    line : the header; the first row if ``names`` are given and the stream has no header.
    name : name of the stream.
    choices : channel map.
    units : unit by channel, from the sidecar.
    names : names of the columns, in place of those in the header.
    rate : sampling rate of a stream without a clock, Hz.
    first : number of the line with the first row.
    signals : signals to read.

    Raises
    ------
    RecordError : the header is not UTF-8; time, an input or every output is missing; a channel
        needs other rows than its own; a rate is given and the stream has a clock. Also as
        ``find_column``.
    """
    cells = header_cells(line, name)
    if names:
        if len(names) != len(cells):
            what = f"{len(names)} names for {len(cells)} columns of {name}"
            remedy = "give one name a column, separated by commas"
            raise RecordError(what, where="--columns", remedy=remedy)
        cells = list(names)
    width, computed = len(cells), None
    sources: tuple[int, ...] = ()
    inputs, outputs = signals.inputs, signals.outputs
    refuse_unknown_units(
        Sidecar(units=units or {}), cells, Path(name), {*signals.channel_units, *(choices or {})}
    )
    if choices is not None:
        choices = {channel: _by_name(choice, cells) for channel, choice in choices.items()}
        _refuse_other_rows(choices, name)
        file = RecordFile(
            Path(name), _table(name, cells, {}, 0), Sidecar(units=units or {}), InputFile(name, "")
        )
        sources = source_columns(file, choices, inputs, outputs)
        if sources:
            computed = file, choices
            with_computed, choices = with_derived(file, choices, inputs, outputs)
            cells = list(with_computed.table.header)
    columns = tuple(
        find_column(channel, cells, name, choices, units, signals.channel_units)
        for channel in signals.names
    )
    if rate is not None and columns[0] is not None:
        raise RecordError(
            "the stream has a clock of its own",
            where=f"{name}, --rate",
            remedy="leave --rate out: a stream is not resampled",
        )
    for channel, column in zip((TIME, *inputs), columns, strict=False):
        if column is None and (channel != TIME or rate is None):
            raise _missing(channel, cells, name)
    if not any(columns[1 + len(inputs) :]):
        raise _missing(outputs[0], cells, name)
    direct = {column.index for column in columns if column is not None and column.index < width}
    return Header(
        columns,
        width,
        name,
        rate,
        first,
        computed,
        tuple(sorted({*direct, *sources})),
        signals,
        separator_of(line),
    )


def _missing(channel: str, cells: Sequence[str], name: str) -> RecordError:
    """Return the error for a stream without a channel."""
    error = missing_column(channel, cells, name)
    if all(is_number(cell) for cell in cells):
        return RecordError(
            "there is no header, the first row holds numbers",
            where=f"{name}, row 1",
            remedy="name the columns with --columns",
        )
    clock = "; of a stream without a clock give --rate HZ" if channel == TIME else ""
    return RecordError(error.what, where=error.where, remedy=f"{error.remedy}{clock}")


def _by_name(choice: ColumnChoice, cells: Sequence[str]) -> ColumnChoice:
    """Return a choice that names its column by its header if it has only the column's number."""
    if isinstance(choice.column, int) and not choice.computed and choice.column <= len(cells):
        return replace(choice, column=cells[choice.column - 1])
    return choice


def _refuse_other_rows(choices: Mapping[str, ColumnChoice], name: str) -> None:
    """Raise RecordError for a channel that is computed from earlier or later rows."""
    remedy = "leave it out of the map, or use flightid identify on the whole record"
    for channel, choice in choices.items():
        where = f"{name}, channel {channel}"
        if choice.delay:
            raise RecordError(
                "a delay needs rows that have not come yet", where=where, remedy=remedy
            )
        if UNWRAP.search(str(choice.column)):
            raise RecordError("unwrap needs the rows before", where=where, remedy=remedy)
        if channel == TIME and (choice.computed or not is_plain_name(str(choice.column))):
            raise RecordError(
                "the clock of a stream is one column",
                where=where,
                remedy='write time = {column = "HEADER", unit = "ms"}',
            )


def _table(
    name: str, cells: Sequence[str], columns: Mapping[int, np.ndarray], rows: int
) -> CellTable:
    """Return rows of a stream as a table; ``columns``: values by index, other columns are NaN."""
    blank = np.full(rows, np.nan)
    return CellTable(
        name,
        tuple(cells),
        tuple(columns.get(index, blank) for index in range(len(cells))),
        np.arange(1, rows + 1),
    )


def read_lines(
    header: Header, lines: Sequence[bytes], first: int
) -> tuple[np.ndarray, list[int], list[Fault]]:
    """Return the numbers in lines of a stream; empty lines are skipped.

    ``first``: number of the first line.

    Returns
    -------
    values : values in SI units, ``(signals, N)``; NaN for an empty cell.
    numbers : numbers of these N lines.
    faults : faults of the other lines.
    """
    places, signals = header.sources, header.signals
    values: list[list[float]] = []
    numbers: list[int] = []
    faults: list[Fault] = []
    for number, line in enumerate(lines, start=first):
        try:
            form = places, header.width, header.separator
            row_values = plain_numbers(line, *form) or numbers_of(line, *form)
        except (ValueError, csv.Error) as error:
            faults.append(
                Fault(number, "not plain text" if isinstance(error, UnicodeError) else str(error))
            )
            continue
        if row_values:
            values.append(row_values)
            numbers.append(number)
    table = np.full((len(header.columns), len(values)), math.nan)
    cells_read = np.array(values, dtype=float).reshape(-1, len(places)).T
    by_index = {place: cells_read[row] for row, place in enumerate(places)}
    if header.computed is not None:
        file, choices = header.computed
        file = replace(file, table=_table(header.name, file.table.header, by_index, len(values)))
        with_computed, _ = with_derived(file, choices, signals.inputs, signals.outputs)
        by_index = dict(enumerate(map(np.asarray, with_computed.table.columns)))
    for row, column in enumerate(header.columns):
        if column is not None:
            table[row] = by_index[column.index]
    if header.rate is not None:
        table[0] = (np.array(numbers, dtype=float) - header.first) / header.rate
    for row, (column, channel) in enumerate(zip(header.columns, signals.names, strict=True)):
        if column is not None and channel != STICK and signals.channel_units[channel]:
            table[row] = to_si(
                table[row],
                column.unit,
                signals.channel_units[channel],
                column_place(header.name, column),
            )
    return table, numbers, faults


def in_order(
    table: np.ndarray, numbers: Sequence[int], order: Order
) -> tuple[np.ndarray, list[Fault], Order]:
    """Return the rows that continue a stream in the order of time.

    A row with a missing, repeated or decreasing time is left out. A row after a jump of the time
    waits until the next row confirms it. A missing input keeps its last value; a row before any
    value of the input is left out.

    Parameters
    ----------
    table : new rows, shape ``(signals, N)``.
    numbers : numbers of their lines.
    order : state before these rows.

    Returns
    -------
    rows : the accepted rows, ``(signals, M)``.
    faults : faults of the other rows, and cells that were filled in.
    order : the state after the rows.
    """
    if _all_in_order(table, order):
        return (
            table,
            [],
            order._replace(
                time=float(table[0, -1]),
                last_inputs=tuple(table[1 : 1 + len(order.inputs), -1].tolist()),
            ),
        )
    rows: list[np.ndarray] = []
    faults: list[Fault] = []
    for row, number in zip(table.T, numbers, strict=True):
        if order.lost is not None:
            faults.append(Fault(number, f"it comes after a jump of the time at {order.lost:g} s"))
            continue
        time = float(row[0])
        if math.isnan(time):
            faults.append(Fault(number, "time is missing"))
            continue
        if time <= order.time:
            faults.append(
                Fault(
                    number,
                    f"time {'is repeated' if time == order.time else 'goes back'} "
                    f"({order.time:.9g} s, then {time:.9g} s)",
                )
            )
            continue
        if order.waiting is not None:
            ahead, ahead_row = order.waiting, order.waiting_row
            order = order._replace(waiting=None)
            if time > ahead[0]:
                if ahead[0] - order.time > LONGEST_BRIDGED_GAP and order.time > -math.inf:
                    order = order._replace(lost=order.time)
                    what = f"the time jumps from {order.time:g} s to {ahead[0]:g} s"
                    faults += [Fault(ahead_row, what), Fault(number, what)]
                    continue
                order = _accept(ahead, ahead_row, order, rows, faults)
            else:
                time_before = f"{order.time:.9g} s, then " if order.time > -math.inf else "first "
                faults.append(
                    Fault(
                        ahead_row,
                        f"time jumps ahead ({time_before}{ahead[0]:.9g} s) and comes back",
                    )
                )
        if time - order.time > LARGEST_JUMP:
            order = order._replace(waiting=row, waiting_row=number)
        else:
            order = _accept(row, number, order, rows, faults)
    return np.array(rows, dtype=float).reshape(-1, table.shape[0]).T, faults, order


def at_end(order: Order, height: int = 2 + len(OUTPUTS)) -> tuple[np.ndarray, list[Fault], Order]:
    """Accept a row that waits at the end of the stream, unless the time jumps too far before it.

    Returns as ``in_order``. ``height``: number of signals in a row.
    """
    rows: list[np.ndarray] = []
    faults: list[Fault] = []
    if order.waiting is not None:
        row, number, order = order.waiting, order.waiting_row, order._replace(waiting=None)
        if row[0] - order.time > LONGEST_BRIDGED_GAP and order.time > -math.inf:
            faults.append(Fault(number, f"the time jumps from {order.time:g} s to {row[0]:g} s"))
        else:
            order = _accept(row, number, order, rows, faults)
    return np.array(rows, dtype=float).reshape(-1, height).T, faults, order


def _all_in_order(table: np.ndarray, order: Order) -> bool:
    """Return whether all rows are in the order of time, without missing times or inputs."""
    if table.shape[1] == 0 or order.waiting is not None or order.lost is not None:
        return False
    steps = np.diff(table[0], prepend=order.time)
    return bool(
        np.all((steps > 0.0) & (steps <= LARGEST_JUMP))
        and not np.isnan(table[1 : 1 + len(order.inputs)]).any()
    )


def _accept(
    row: np.ndarray, number: int, order: Order, rows: list[np.ndarray], faults: list[Fault]
) -> Order:
    """Append a row to ``rows``, with missing inputs filled in, and return the new state.

    A row whose missing input has no earlier value is not appended. ``faults`` gets an entry for
    each missing input.
    """
    for place, name in enumerate(order.inputs, start=1):
        if math.isnan(row[place]):
            if not order.last_inputs:
                faults.append(Fault(number, f"the {name} is missing, and there is none before"))
                return order
            row = row.copy()
            row[place] = order.last_inputs[place - 1]
            faults.append(
                Fault(number, f"the {name} is missing, the last one holds", left_out=False)
            )
    rows.append(row)
    return order._replace(
        time=float(row[0]), last_inputs=tuple(row[1 : 1 + len(order.inputs)].tolist())
    )
