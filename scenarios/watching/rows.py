"""Rows in SI units and in order of time, from the lines of a stream."""

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
LARGEST_PIECE = 1 << 16
STANDARD_INPUT = 0  # file descriptor
MOST_WAITING_PIECES = 16  # queued pieces of standard input
LONGEST_LINE = 1 << 20
_NOT_LINES = (".gz", ".parquet", ".pq", ".mat")

Read = Callable[[], bytes | None]


class Lines(NamedTuple):
    """Complete lines without their ends, and at the end of the stream the beginning of an
    incomplete line.
    """

    whole: list[bytes]
    unfinished: bytes = b""


def lines_of(read: Read, idle: float | None, name: str) -> Iterator[Lines]:
    """Yield lines from a source, an empty list whenever it has nothing new.

    Parameters
    ----------
    read : new bytes, none if there are none after waiting a tick, None when the source has ended.
    idle : s without a byte after which the stream counts as ended; None waits for the source's end.
    name : for messages.

    Raises
    ------
    RecordError : a line without end.
    """
    rest, heard = b"", time.monotonic()
    while (piece := read()) is not None:
        if piece:
            heard = time.monotonic()
            *whole, rest = (rest + piece).split(b"\n")
            if len(rest) > LONGEST_LINE:
                raise RecordError(
                    "a line without end",
                    where=name,
                    remedy="stream comma-separated text, one row a line",
                )
            yield Lines([line.removesuffix(b"\r") for line in whole])
        elif idle is not None and time.monotonic() - heard >= idle:
            break
        else:
            yield Lines([])
    yield Lines([], rest)


@contextmanager
def growing_file(path: Path, until_end: bool) -> Iterator[Read]:
    """Yield pieces of a file from its beginning, and continue while it grows.

    With ``until_end``, stop at the end of the file. Also stops if the file is truncated.

    Raises
    ------
    RecordError : no such file, a folder, no text, or it cannot be read.
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
    """Source of piped input, which ends with the pipe.

    A thread waits for the pipe, since Windows can only wait for sockets; it reads a few pieces
    ahead.
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


# ---- From lines to rows in SI units and in the order of time

INPUTS, OUTPUTS = (STICK,), ("alpha", "q", "nz")
ROWS_AHEAD = 1.0  # s; a larger jump of the time stamps must be confirmed by the next one
UNWRAP = re.compile(r"\bunwrap\s*\(")
LONGEST_BRIDGED_GAP = 600.0  # s; after a longer gap the filter cannot continue


@dataclass(frozen=True)
class StreamSignals:
    """Inputs and outputs that a stream is read for; ``channel_units``: all channels and their units
    inside.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    channel_units: Mapping[str, str] = field(default_factory=lambda: CHANNEL_UNITS)

    @property
    def names(self) -> tuple[str, ...]:
        """The rows of a table: time, inputs, outputs."""
        return (TIME, *self.inputs, *self.outputs)


LOES = StreamSignals(INPUTS, OUTPUTS)


@dataclass(frozen=True)
class Header:
    """Columns and units of a stream's rows.

    Attributes
    ----------
    columns : of the channels in the order time, stick, alpha, q, nz; None if an output is
        absent, or the clock.
    width : number of cells in a row.
    name : of the stream.
    rate : Hz, of a stream without a clock; ``first``: the line of its first row.
    computed : the file without rows and the channel map, where channels are computed; ``columns``
        are then those of the wider table.
    sources : columns of the stream that are read, in the order of their places.
    signals : the channels.
    separator : the mark between the cells of a row.
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
        """The stick's label."""
        column = self.columns[1]
        assert column is not None
        return column.unit


class Fault(NamedTuple):
    """A line that was left out, or a cell that was corrected: its row (the header is row 1), and
    the reason.
    """

    row: int
    what: str
    left_out: bool = True


class Order(NamedTuple):
    """State of the ordering of rows: time (s) and inputs of the last row, and a waiting row.

    A waiting row has a late time stamp, which the next row must confirm. ``lost``: time of a jump
    by more than ``LONGEST_BRIDGED_GAP``, after which rows are ignored.
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
    line : the header, or the first row where ``names`` are given and there is none.
    name : of the stream.
    choices : channel map.
    units : the sidecar's.
    names : of the columns, in their order, instead of the header's.
    rate : Hz, of a stream without a clock.
    first : line of the first row.
    signals : channels to read.

    Raises
    ------
    RecordError : not UTF-8, no time or input, none of the outputs, or as
        for ``find_column``; a channel that needs other rows than its own; a rate beside a clock.
    """
    cells = _named(header_cells(line, name), name, names)
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
        result = source_columns(file, choices, inputs, outputs)
        if result:
            computed, sources = (file, choices), result
            wider, choices = with_derived(file, choices, inputs, outputs)
            cells = list(wider.table.header)
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


def _named(cells: list[str], name: str, names: Sequence[str]) -> list[str]:
    """The header with the names that are given. Raises RecordError if they are not as many."""
    if names and len(names) != len(cells):
        what = f"{len(names)} names for {len(cells)} columns of {name}"
        raise RecordError(
            what, where="--columns", remedy="give one name a column, separated by commas"
        )
    return list(names) if names else cells


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
    """Return a column that is chosen by its number alone, chosen by its header."""
    known = isinstance(choice.column, int) and not choice.computed and choice.column <= len(cells)
    return replace(choice, column=cells[int(choice.column) - 1]) if known else choice


def _refuse_other_rows(choices: Mapping[str, ColumnChoice], name: str) -> None:
    """Raise RecordError for a channel that is computed from other rows than its own: a stream has
    only those that came."""
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
    """Return the rows of a stream as a table, NaN if a column is not read."""
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
    """Return numbers ``(signals, N)`` in SI (NaN: empty cell), row numbers, and invalid lines.

    ``first``: number of the first line. Empty lines are skipped.
    """
    places, signals = header.sources, header.signals
    values: list[list[float]] = []
    numbers: list[int] = []
    faults: list[Fault] = []
    for number, line in enumerate(lines, start=first):
        try:
            cells = line, places, header.width, header.separator
            found = plain_numbers(*cells) or numbers_of(*cells)
        except (ValueError, csv.Error) as error:
            faults.append(
                Fault(number, "not plain text" if isinstance(error, UnicodeError) else str(error))
            )
            continue
        if found:
            values.append(found)
            numbers.append(number)
    table = np.full((len(header.columns), len(values)), math.nan)
    came = np.array(values, dtype=float).reshape(-1, len(places)).T
    read = {place: came[row] for row, place in enumerate(places)}
    if header.computed is not None:
        file, choices = header.computed
        file = replace(file, table=_table(header.name, file.table.header, read, len(values)))
        read = dict(
            enumerate(
                np.asarray(each)
                for each in with_derived(file, choices, signals.inputs, signals.outputs)[
                    0
                ].table.columns
            )
        )
    for row, column in enumerate(header.columns):
        if column is not None:
            table[row] = read[column.index]
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
    """Return the valid rows that follow ``order``, ``(signals, N)``, and the faults of the others.

    A row with a missing, repeated or decreasing time is dropped. A row after a jump of the time
    waits until the next row confirms it. A missing input keeps its last value; if there is none,
    the row is dropped.
    """
    if _goes_on(table, order):
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
                    faults += [
                        Fault(each, f"the time jumps from {order.time:g} s to {ahead[0]:g} s")
                        for each in (ahead_row, number)
                    ]
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
        ahead_of_all = time - order.time > ROWS_AHEAD
        order = (
            order._replace(waiting=row, waiting_row=number)
            if ahead_of_all
            else _accept(row, number, order, rows, faults)
        )
    return np.array(rows, dtype=float).reshape(-1, table.shape[0]).T, faults, order


def at_end(order: Order, height: int = 2 + len(OUTPUTS)) -> tuple[np.ndarray, list[Fault], Order]:
    """Accept a row that still waits at the end of the stream, unless its gap is too long."""
    rows: list[np.ndarray] = []
    faults: list[Fault] = []
    if order.waiting is not None:
        row, number, order = order.waiting, order.waiting_row, order._replace(waiting=None)
        if row[0] - order.time > LONGEST_BRIDGED_GAP and order.time > -math.inf:
            faults.append(Fault(number, f"the time jumps from {order.time:g} s to {row[0]:g} s"))
        else:
            order = _accept(row, number, order, rows, faults)
    return np.array(rows, dtype=float).reshape(-1, height).T, faults, order


def _goes_on(table: np.ndarray, order: Order) -> bool:
    """Return whether all rows simply continue from ``order``, without missing times or inputs."""
    if table.shape[1] == 0 or order.waiting is not None or order.lost is not None:
        return False
    steps = np.diff(table[0], prepend=order.time)
    return bool(
        np.all((steps > 0.0) & (steps <= ROWS_AHEAD))
        and not np.isnan(table[1 : 1 + len(order.inputs)]).any()
    )


def _accept(
    row: np.ndarray, number: int, order: Order, rows: list[np.ndarray], faults: list[Fault]
) -> Order:
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
