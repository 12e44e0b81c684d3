"""Merging of columns of topics with different clocks on one time grid.

The grid is the clock of the fastest topic with an output, over the time common to all topics.
Faster columns pass a zero-phase low-pass filter. A slower output has samples only at the grid times
nearest to its own samples. A slower input is held or linear between its samples. A sentence reports
each of these changes.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scenarios.files.declarations import TIME, ColumnChoice, is_clock, shortened_list, split_header
from scenarios.files.formats.cells import CellTable, Topic, numbers
from scenarios.files.measured.clock import (
    SECONDS,
    Clock,
    counter_unit,
    seconds_of_counter,
    times_of_dates,
    times_of_texts,
)
from scenarios.files.measured.columns import RecordFile, name_and_unit, program_unit, suffix_unit
from scenarios.files.measured.expressions import Expression, evaluate
from scenarios.files.units import QUANTITIES, to_si
from sim.errors import RecordError

SAME_RATE = 1.5  # ratio of rates below which two topics count as equally fast
CORNER_SHARE = 0.8  # corner frequency of the low-pass, as a share of half the new rate
FILTER_ORDER = 4
SHORTEST_FILTERED = 20  # samples; a shorter column is not filtered
COMMAND_CHANGE_SHARE = 0.3  # a signal that changes at a smaller share of its samples is held
# factor by which a duration is increased, so that rounding does not lose the last sample
ROUNDING = 1.0 + 1e-9
SI_UNITS_TRIED = ("rad", "rad/s", "m/s", "m", "s", "N", "Pa", "m/s2", "kg", "kg/m3", "m2", "rad/s2")
INDEX_HEADERS = ("", "index", "unnamed: 0")  # headers that pandas gives an index without a name
# Spellings of units of time -> their symbols.
TIME_UNITS = {"µs": "us", "usec": "us", "msec": "ms", "sec": "s", "seconds": "s", "nsec": "ns"}
FIRST_CELLS = 5  # cells that show whether a column has dates
LONGEST_SHOWN_CELL = 40  # characters of a cell in a message
PADDING_STEPS = 6.0  # length of the padding of the low-pass, in steps of the grid
UNEVEN_CLOCK_SHARE = 0.1  # jitter over interval from which a clock is reported as uneven
Place = tuple[int, int]  # numbers of a topic and of a column in it


@dataclass(frozen=True, eq=False)
class ChannelRequest:
    """A requested channel, which is computed from columns.

    Attributes
    ----------
    channel : name of the channel.
    choice : entry of the channel in the channel map.
    expression : expression over columns.
    places : name of a column in the expression -> its place.
    is_input : whether the channel is an input of the model; else it is an output.
    """

    channel: str
    choice: ColumnChoice
    expression: Expression
    places: Mapping[str, Place]
    is_input: bool

    @property
    def computed(self) -> bool:
        """Whether the channel differs from the numbers of a single column."""
        return (
            self.choice.computed
            or len(self.places) != 1
            or not self.expression.text.startswith("`")
        )


def clock_place(table: CellTable) -> int | None:
    """Return the index of the column that is the clock of a table; None without one.

    It is the column ``time``, else the first column with another name of a clock, else a first
    column with dates and without a name, as pandas writes it.
    """
    names = [split_header(cell)[0] for cell in table.header]
    clocks = [index for index, name in enumerate(names) if is_clock(name)]
    called_time = [index for index in clocks if names[index].strip().lower() == TIME]
    if called_time:
        return called_time[0]
    if clocks:
        return clocks[0]
    has_index = bool(names) and table.header[0].lower() in INDEX_HEADERS
    return 0 if has_index and holds_dates(table.columns[0]) else None


def holds_dates(column: Sequence[object] | np.ndarray) -> bool:
    """Return whether a column has dates, times of day or durations, by its type or its first
    cells.
    """
    if isinstance(column, np.ndarray) and column.dtype.kind in "mM":
        return True
    if isinstance(column, np.ndarray) and column.dtype.kind in "fiub":
        return False
    filled = [
        cell
        for cell in itertools.islice(column, FIRST_CELLS)
        if cell is not None and str(cell).strip()
    ]
    return bool(filled) and times_of_texts(filled) is not None


def clock_of(table: CellTable, index: int, unit: str | None = None) -> Clock:
    """Return the time stamps of a clock in seconds.

    Parameters
    ----------
    table : the table.
    index : index of the column of the clock.
    unit : its unit; None takes that of the header, else the unit that the numbers suggest.

    Raises
    ------
    RecordError : if the unit measures no time.
    """
    column = table.columns[index]
    if isinstance(column, np.ndarray) and column.dtype.kind in "mM":
        return times_of_dates(column)
    if not (isinstance(column, np.ndarray) and column.dtype.kind in "fiu"):
        first = next(
            (str(cell).strip() for cell in column if cell is not None and str(cell).strip()), ""
        )
        if ":" in first or first[4:5] == "-" or first.count(".") == 2 or first.count("/") == 2:
            clock = times_of_texts(list(column))
            if clock is not None:
                return clock
    stated = unit if unit is not None else stated_unit(table, index)
    values = numbers(table, index).values
    where = f"{table.file}, column {table.header[index]!r}"
    if stated in SECONDS or stated is None:
        return seconds_of_counter(values, stated, where)
    return Clock(np.asarray(to_si(values, stated, "s", where)))


def stated_unit(table: CellTable, index: int) -> str | None:
    """Return the unit that a header, the row under it or the name of a clock states; None without
    one.
    """
    name, unit = name_and_unit(table.header, index)
    stated = unit or (table.units[index] if table.units else "")
    if stated:
        if table.stated_apart and is_clock(name) and not measures(stated, "s"):
            return None
        return TIME_UNITS.get(stated, stated)
    if not is_clock(name):
        return None
    suffix = suffix_unit(name.lower(), TIME) or suffix_unit(name.lower(), "timestamp")
    return counter_unit(name) or (suffix if suffix in SECONDS else None)


def unit_of(
    request: ChannelRequest, topics: Sequence[Topic], channel_units: Mapping[str, str]
) -> tuple[str | None, str]:
    """Return the unit of the numbers of a channel, and a note if the unit in the file is not used.

    The unit in the channel map has precedence over that in the file. The unit is None for a
    computed channel without a unit in the map: its columns are converted to SI units first.

    Raises
    ------
    RecordError : if the unit in the header does not measure the channel.
    """
    if request.choice.unit is not None or request.computed:
        return request.choice.unit, ""
    topic, index = next(iter(request.places.values()))
    table, inside = topics[topic].table, program_unit(request.channel, channel_units)
    stated = stated_unit(table, index)
    if not stated or not inside or measures(stated, inside):
        return stated or inside, ""
    if not table.stated_apart:
        to_si(1.0, stated, inside, f"{table.file}, column {table.header[index]!r}")
    return inside, f"the unit {stated} that the file states is no unit of it and is not used"


def measures(unit: str, inside: str) -> bool:
    """Return whether a unit can be converted to the unit ``inside``."""
    if not inside:
        return False
    try:
        to_si(1.0, unit, inside, "")
    except RecordError:
        return False
    return True


def with_calibration(values: np.ndarray, choice: ColumnChoice) -> np.ndarray:
    """Return values after the calibration table, scale and offset of the channel map."""
    if choice.table is not None:
        values = np.where(np.isnan(values), np.nan, np.interp(values, *choice.table))
    if (choice.scale, choice.offset) == (1.0, 0.0):
        return values
    return choice.scale * values + choice.offset


def topic_numbers(
    file: RecordFile, topics: Sequence[Topic], place: Place, request: ChannelRequest, *, si: bool
) -> np.ndarray:
    """Return the numbers ``(N,)`` of a column that a channel needs. If ``si`` is True and the file
    states a known unit, they are in SI units.
    """
    table = topics[place[0]].table
    content = numbers(table, place[1])
    where = f"{table.file}, column {table.header[place[1]]!r}"
    if content.texts:
        row, text = next(iter(content.texts.items()))
        raise RecordError(
            f"{text[:LONGEST_SHOWN_CELL]!r} in row {table.rows[row]} is not a number",
            where=where,
            remedy=f"{request.channel} is computed from it",
        )
    unit = stated_unit(table, place[1])
    if not si or not unit or unit in QUANTITIES:
        return content.values
    for target in SI_UNITS_TRIED:
        try:
            return np.asarray(to_si(content.values, unit, target, where))
        except RecordError:
            continue
    return content.values


def without_delay(time: np.ndarray, values: np.ndarray, delay: float) -> np.ndarray:
    """Return the values ``(N,)`` of a column at ``time (N,)`` plus its ``delay``, s. They are
    constant beyond the ends of the column.
    """
    finite = np.isfinite(values) & np.isfinite(time)
    if not np.any(finite):
        return values
    return np.interp(time + delay, time[finite], values[finite])


def merge_topics(
    file: RecordFile,
    topics: Sequence[Topic],
    requests: Sequence[ChannelRequest],
    rate: float | None,
    hold: str | None,
    channel_units: Mapping[str, str],
) -> tuple[RecordFile, Mapping[str, ColumnChoice]]:
    """Return a file with one table of the requested channels of several topics, and the channel
    map of this table.

    Parameters
    ----------
    rate : rate of an even grid, Hz; None takes the clock of a topic as grid.
    hold : ``previous`` or ``linear``, for slower inputs without a hold in the channel map; None
        holds inputs that move in steps.
    channel_units : SI unit of every known channel.
    """
    used = sorted({place[0] for channel in requests for place in channel.places.values()})
    clocks = topic_clocks(file, topics, used)
    with_outputs = [
        topic
        for channel in requests
        if not channel.is_input
        for topic in {place[0] for place in channel.places.values()}
    ]
    grid, grid_note = grid_of(file, topics, clocks, used, with_outputs or used, rate)
    notes = [grid_note, *unread_topics(topics, used)]
    step = float(np.median(np.diff(grid)))
    header, columns, choices = [f"{TIME}"], [grid], {}
    for channel in requests:
        values, unit, note = on_grid(file, topics, clocks, channel, grid, step, hold, channel_units)
        header.append(channel.channel)
        columns.append(values)
        choices[channel.channel] = ColumnChoice(channel.channel, unit)
        if note:
            notes.append(f"{channel.channel}: {note}")
    table = CellTable(str(file.path), tuple(header), tuple(columns), np.arange(1, grid.size + 1))
    merged_file = replace(file, table=table, topics=(), notes=(*file.notes, *notes))
    return merged_file, choices


def topic_clocks(
    file: RecordFile, topics: Sequence[Topic], used: Sequence[int]
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return number of a topic -> its increasing times, s, and their rows. The times of all topics
    count from one origin.
    """
    clock_by_topic: dict[int, Clock] = {}
    for number in used:
        table = topics[number].table
        index = clock_place(table)
        if index is None:
            remedy = (
                f"it has the columns {', '.join(table.header[:8])}; a clock is called time or "
                "timestamp"
            )
            raise RecordError(
                f"topic {topics[number].name} has no clock", where=str(file.path), remedy=remedy
            )
        clock_by_topic[number] = clock_of(table, index)
    origin = min(clock.origin for clock in clock_by_topic.values())
    clocks = {}
    for number, clock in clock_by_topic.items():
        time = clock.time + (clock.origin - origin)
        rows = np.flatnonzero(np.isfinite(time))
        rows = rows[np.argsort(time[rows], kind="stable")]
        rows = rows[np.concatenate([[True], np.diff(time[rows]) > 0.0])] if rows.size else rows
        if rows.size < 2:
            raise RecordError(
                f"topic {topics[number].name} has no two times",
                where=str(file.path),
                remedy="leave its columns out",
            )
        clocks[number] = (time[rows], rows)
    return clocks


def grid_of(
    file: RecordFile,
    topics: Sequence[Topic],
    clocks: Mapping[int, tuple[np.ndarray, np.ndarray]],
    used: Sequence[int],
    leading: Sequence[int],
    rate: float | None,
) -> tuple[np.ndarray, str]:
    """Return the times of the grid, s, and a sentence on it.

    The grid is the clock of the fastest topic in ``leading``, or an even grid of a given ``rate``,
    Hz.
    """
    begin, end = max(clocks[n][0][0] for n in used), min(clocks[n][0][-1] for n in used)
    spans = ", ".join(
        f"{topics[n].name} {clocks[n][0][0]:g} to {clocks[n][0][-1]:g} s" for n in used
    )
    if not end > begin:
        raise RecordError(
            "the topics share no time", where=str(file.path), remedy=f"they cover {spans}"
        )
    if rate is not None:
        grid = begin + np.arange(int((end - begin) * rate * ROUNDING) + 1) / rate
        grid_text = f"an even grid of {rate:g} Hz"
    else:
        fastest = min(dict.fromkeys(leading), key=lambda n: float(np.median(np.diff(clocks[n][0]))))
        time = clocks[fastest][0]
        grid = time[(time >= begin) & (time <= end)]
        steps = np.diff(time)
        step = float(np.median(steps))
        jitter = float(np.median(np.abs(steps - step)))
        grid_text = f"the clock of {topics[fastest].name}, {1.0 / step:.4g} Hz"
        if jitter > UNEVEN_CLOCK_SHARE * step:
            grid_text += f" with a jitter of {1e3 * jitter:.2g} ms"
    if grid.size < 2:
        raise RecordError(
            "the topics share fewer than two samples",
            where=str(file.path),
            remedy=f"they cover {spans}",
        )
    if len(used) == 1:
        return grid, f"the rows are those of {grid_text}"
    names = ", ".join(topics[n].name for n in used)
    return grid, f"{len(used)} topics are put on one grid, {grid_text}: {names}"


VECTOR_ELEMENT = re.compile(r"\w*\[\d+\]|[xyz]")  # xyz[0], control[1], x


def unread_topics(topics: Sequence[Topic], used: Sequence[int]) -> list[str]:
    """Return a sentence for each used topic that has the same columns as unread topics.

    A spreadsheet with a sheet for each run has such topics.
    """
    sentences = []
    for used_number in used:
        header = topics[used_number].table.header
        fields = [cell for cell in header if not is_clock(split_header(cell)[0])]
        if all(VECTOR_ELEMENT.fullmatch(cell) for cell in fields):
            continue  # any vector of a log has these names
        unread = [
            topic.name
            for number, topic in enumerate(topics)
            if number not in used and topic.table.header == header
        ]
        if unread:
            have, are = ("has", "is") if len(unread) == 1 else ("have", "are")
            sentences.append(
                f"{shortened_list(unread, 6)} {have} the same columns as "
                f"{topics[used_number].name} and {are} not read"
            )
    return sentences


def on_grid(
    file: RecordFile,
    topics: Sequence[Topic],
    clocks: Mapping[int, tuple[np.ndarray, np.ndarray]],
    request: ChannelRequest,
    grid: np.ndarray,
    step: float,
    hold: str | None,
    channel_units: Mapping[str, str],
) -> tuple[np.ndarray, str, str]:
    """Return the values of a channel at the times of the grid, NaN where an output has no sample;
    their unit; and a text on the resampling.
    """
    unit, unused_unit = unit_of(request, topics, channel_units)
    resampled: dict[str, np.ndarray] = {}
    longest_interval = 0.0
    notes: list[str] = [unused_unit] if unused_unit else []
    for name, place in request.places.items():
        time, rows = clocks[place[0]]
        values = topic_numbers(file, topics, place, request, si=unit is None)[rows]
        resampled[name], interval, sentence = _resampled(
            time, values, grid + request.choice.delay, step, request, hold
        )
        longest_interval = max(longest_interval, interval)
        if sentence:
            notes.append(sentence)
    where = f"{file.path}, channel {request.channel}"
    values = with_calibration(evaluate(request.expression, resampled, where), request.choice)
    if not request.is_input and longest_interval > SAME_RATE * step:
        values = np.where(_nearest_to_samples(clocks, request, grid), values, np.nan)
        notes.append(
            f"its own samples come every {longest_interval:.3g} s, the grid's every {step:.3g} s: "
            "it has samples only where it was measured"
        )
    if unit is None:
        unit = program_unit(request.channel, channel_units)
    return values, unit, "; ".join(dict.fromkeys(notes))


def _resampled(
    time: np.ndarray,
    values: np.ndarray,
    grid: np.ndarray,
    step: float,
    request: ChannelRequest,
    hold: str | None,
) -> tuple[np.ndarray, float, str]:
    """Return the values of a column at the times of the grid; its sampling interval, s; and a
    sentence if it was filtered, held or joined by lines.

    ``step`` is that of the grid, s.
    """
    finite = np.isfinite(values)
    if np.count_nonzero(finite) < 2:
        return np.full(grid.size, np.nan), 0.0, ""
    time, values = time[finite], values[finite]
    interval = float(np.median(np.diff(time)))
    if np.array_equal(time, grid):
        return values, interval, ""
    if interval * SAME_RATE < step:
        sentence = f"passes a zero-phase low-pass of {0.5 * CORNER_SHARE / step:.3g} Hz"
        smooth = _smoothed(time, values, interval, step)
        return np.interp(grid, time, smooth), interval, sentence
    linear = np.interp(grid, time, values)
    if not request.is_input or interval <= SAME_RATE * step:
        return linear, interval, ""
    chosen = request.choice.hold or hold or ("previous" if moves_in_steps(values) else "linear")
    sentence = (
        f"its own samples come every {interval:.3g} s and are "
        f"{'held' if chosen == 'previous' else 'joined by lines'} between them"
    )
    if chosen == "previous":
        latest = np.clip(np.searchsorted(time, grid, side="right") - 1, 0, time.size - 1)
        return values[latest], interval, sentence
    return linear, interval, sentence


def moves_in_steps(values: np.ndarray) -> bool:
    """Return whether a signal is constant between single steps, as a digital command."""
    changes = np.diff(values) != 0.0
    return not changes.size or bool(np.mean(changes) < COMMAND_CHANGE_SHARE)


def _smoothed(time: np.ndarray, values: np.ndarray, interval: float, step: float) -> np.ndarray:
    """Return a column after the low-pass filter for a grid with intervals ``step``, s.

    ``interval`` is the median sampling interval of the column, s. A short column is not filtered.
    """
    from scipy.signal import butter, sosfiltfilt

    samples = int((time[-1] - time[0]) / interval * ROUNDING) + 1
    even_time = time[0] + interval * np.arange(samples)
    if even_time.size < SHORTEST_FILTERED:
        return values
    corner = 0.5 * CORNER_SHARE / step
    sections = butter(FILTER_ORDER, corner, fs=1.0 / interval, output="sos")
    padding = min(even_time.size - 1, round(PADDING_STEPS * step / interval))
    smooth = sosfiltfilt(sections, np.interp(even_time, time, values), padlen=padding)
    return np.interp(time, even_time, smooth)


def _nearest_to_samples(
    clocks: Mapping[int, tuple[np.ndarray, np.ndarray]], request: ChannelRequest, grid: np.ndarray
) -> np.ndarray:
    """Return whether each time of the grid is nearest to a sample of the slowest topic of a
    channel.
    """
    slowest = max(
        {place[0] for place in request.places.values()},
        key=lambda n: float(np.median(np.diff(clocks[n][0]))),
    )
    time = clocks[slowest][0]
    right = np.clip(np.searchsorted(grid, time), 1, grid.size - 1)
    nearest = np.where(time - grid[right - 1] < grid[right] - time, right - 1, right)
    has_sample = np.zeros(grid.size, dtype=bool)
    has_sample[nearest[(time >= grid[0]) & (time <= grid[-1])]] = True
    return has_sample
