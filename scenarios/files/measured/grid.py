"""Merge columns of topics with different clocks on one time grid.

The grid is the clock of the fastest topic with an output, over the time common to all topics.
Faster columns are low-pass filtered (zero phase). Slower outputs have samples only at the grid
times nearest to their own. Inputs are held or linear between their samples. Notes report this.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from scenarios.files.declarations import TIME, ColumnChoice, is_clock, split_header
from scenarios.files.formats.cells import CellTable, Topic, numbers
from scenarios.files.measured.clock import (
    SECONDS,
    Clock,
    counter_unit,
    seconds_of_counter,
    times_of_dates,
    times_of_texts,
)
from scenarios.files.measured.columns import RecordFile, inside_unit, split_at, suffix_unit
from scenarios.files.measured.expressions import Expression, evaluate
from scenarios.files.units import QUANTITIES, to_si
from sim.errors import RecordError

SAME_RATE = 1.5  # ratio of rates below which two topics count as equally fast
BELOW_HALF = 0.8  # corner of the low-pass, as a share of half the new rate
FILTER_ORDER = 4
SI_TRIED = ("rad", "rad/s", "m/s", "m", "s", "N", "Pa", "m/s2", "kg", "kg/m3", "m2", "rad/s2")
NO_NAMES = ("", "index", "unnamed: 0")  # headers of an index that has no name
FIRST_CELLS = 5  # cells that say whether a column holds dates
UNEVEN_CLOCK_SHARE = 0.1  # relative deviation that is reported as an uneven clock
Place = tuple[int, int]  # topic and column


@dataclass(frozen=True, eq=False)
class Wanted:
    """A channel to compute: from which columns, by which expression, and as an input or an
    output.
    """

    channel: str
    choice: ColumnChoice
    expression: Expression
    places: Mapping[str, Place]
    is_input: bool

    @property
    def computed(self) -> bool:
        """Whether it is anything but one column's own numbers."""
        return (
            self.choice.computed
            or len(self.places) != 1
            or not self.expression.text.startswith("`")
        )


def clock_place(table: CellTable) -> int | None:
    """Return the column with the clock of a table, or None.

    In this order: ``time``, other names of clocks, an unnamed first column with dates (pandas).
    """
    named = [index for index, cell in enumerate(table.header) if is_clock(split_header(cell)[0])]
    first = [
        index for index in named if split_header(table.header[index])[0].strip().lower() == TIME
    ]
    chosen = first or named
    if (
        not chosen
        and table.header
        and table.header[0].lower() in NO_NAMES
        and holds_dates(table.columns[0])
    ):
        return 0
    return chosen[0] if chosen else None


def holds_dates(column: Sequence[object] | np.ndarray) -> bool:
    """Whether a column holds dates, times of day or durations, by its type or its first cells."""
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
    """Return the stamps of a table's clock in seconds.

    Parameters
    ----------
    table, index : the column.
    unit : its unit where that is known; None: as the header says, else as the numbers do.

    Raises
    ------
    RecordError : a unit that measures no time.
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
    if stated in SECONDS or stated is None:
        return seconds_of_counter(values, stated, f"{table.file}, column {table.header[index]!r}")
    return Clock(
        np.asarray(to_si(values, stated, "s", f"{table.file}, column {table.header[index]!r}"))
    )


def stated_unit(table: CellTable, index: int) -> str | None:
    """Return the unit in a header, in the row under it or in a clock's name; None without one."""
    name, unit = split_at(table.header, index)
    under = table.units[index] if table.units else ""
    if unit or under:
        chosen = unit or under
        if table.stated_apart and is_clock(name) and not measures(chosen, "s"):
            return None
        return {
            "µs": "us",
            "usec": "us",
            "msec": "ms",
            "sec": "s",
            "seconds": "s",
            "nsec": "ns",
        }.get(chosen, chosen)
    if not is_clock(name):
        return None
    suffix = suffix_unit(name.lower(), TIME) or suffix_unit(name.lower(), "timestamp")
    return counter_unit(name) or (suffix if suffix in SECONDS else None)


def unit_of(
    wanted: Wanted, topics: Sequence[Topic], channel_units: Mapping[str, str]
) -> tuple[str | None, str]:
    """Return the unit of a channel's numbers, and a note on an unused stated unit.

    The unit of the choice has precedence over that of the file. None for expressions over columns
    with units, which are computed in SI.

    Raises
    ------
    RecordError : somebody wrote a unit to the column that is none of the channel.
    """
    if wanted.choice.unit is not None or wanted.computed:
        return wanted.choice.unit, ""
    topic, index = next(iter(wanted.places.values()))
    table, inside = topics[topic].table, inside_unit(wanted.channel, channel_units)
    stated = stated_unit(table, index)
    if not stated or not inside or measures(stated, inside):
        return stated or inside, ""
    if not table.stated_apart:
        to_si(1.0, stated, inside, f"{table.file}, column {table.header[index]!r}")
    return inside, f"the unit {stated} that the file states is no unit of it and is not used"


def measures(unit: str, inside: str) -> bool:
    if not inside:
        return False
    try:
        to_si(1.0, unit, inside, "")
    except RecordError:
        return False
    return True


def calibrated(values: np.ndarray, choice: ColumnChoice) -> np.ndarray:
    if choice.table is not None:
        values = np.where(np.isnan(values), np.nan, np.interp(values, *choice.table))
    return (
        choice.scale * values + choice.offset
        if (choice.scale, choice.offset) != (1.0, 0.0)
        else values
    )


def topic_numbers(
    file: RecordFile, topics: Sequence[Topic], place: Place, wanted: Wanted, *, si: bool
) -> np.ndarray:
    """Return a column as numbers; in SI where ``si`` and its unit is stated and known."""
    table = topics[place[0]].table
    result = numbers(table, place[1])
    where = f"{table.file}, column {table.header[place[1]]!r}"
    if result.texts:
        row, text = next(iter(result.texts.items()))
        raise RecordError(
            f"{text[:40]!r} in row {table.rows[row]} is not a number",
            where=where,
            remedy=f"{wanted.channel} is computed from it",
        )
    unit = stated_unit(table, place[1])
    if not si or not unit or unit in QUANTITIES:
        return result.values
    for target in SI_TRIED:
        try:
            return np.asarray(to_si(result.values, unit, target, where))
        except RecordError:
            continue
    return result.values


def delayed(time: np.ndarray, values: np.ndarray, delay: float) -> np.ndarray:
    """A column corrected for ``delay``, s, at the times of its rows; constant beyond its ends."""
    finite = np.isfinite(values) & np.isfinite(time)
    return np.interp(time + delay, time[finite], values[finite]) if np.any(finite) else values


def merged(
    file: RecordFile,
    topics: Sequence[Topic],
    wanted: Sequence[Wanted],
    rate: float | None,
    hold: str | None,
    channel_units: Mapping[str, str],
) -> tuple[RecordFile, Mapping[str, ColumnChoice]]:
    """Return the wanted channels of several topics on one grid."""
    used = sorted({place[0] for each in wanted for place in each.places.values()})
    clocks = topic_clocks(file, topics, used)
    notes: list[str] = []
    leading = [
        topic
        for each in wanted
        if not each.is_input
        for topic in {place[0] for place in each.places.values()}
    ] or used
    grid, grid_note = grid_of(file, topics, clocks, used, leading, rate)
    notes += [grid_note, *unread_topics(topics, used)]
    step = float(np.median(np.diff(grid)))
    header, columns, choices = [f"{TIME}"], [grid], {}
    for each in wanted:
        values, unit, note = on_grid(file, topics, clocks, each, grid, step, hold, channel_units)
        header.append(each.channel)
        columns.append(values)
        choices[each.channel] = ColumnChoice(each.channel, unit)
        if note:
            notes.append(f"{each.channel}: {note}")
    table = CellTable(str(file.path), tuple(header), tuple(columns), np.arange(1, grid.size + 1))
    single = replace(file, table=table, topics=(), notes=(*file.notes, *notes))
    return single, choices


def topic_clocks(
    file: RecordFile, topics: Sequence[Topic], used: Sequence[int]
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return ordered times (s, common origin) and their rows, by topic."""
    result: dict[int, Clock] = {}
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
        result[number] = clock_of(table, index)
    origin = min(clock.origin for clock in result.values())
    clocks = {}
    for number, clock in result.items():
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
    begin, end = max(clocks[n][0][0] for n in used), min(clocks[n][0][-1] for n in used)
    spans = ", ".join(
        f"{topics[n].name} {clocks[n][0][0]:g} to {clocks[n][0][-1]:g} s" for n in used
    )
    if not end > begin:
        raise RecordError(
            "the topics share no time", where=str(file.path), remedy=f"they cover {spans}"
        )
    if rate is not None:
        grid = begin + np.arange(int((end - begin) * rate * (1.0 + 1e-9)) + 1) / rate
        grid_text = f"an even grid of {rate:g} Hz"
    else:
        fastest = min(dict.fromkeys(leading), key=lambda n: float(np.median(np.diff(clocks[n][0]))))
        time = clocks[fastest][0]
        grid = time[(time >= begin) & (time <= end)]
        steps = np.diff(time)
        step = float(np.median(steps))
        jitter = float(np.median(np.abs(steps - step)))
        grid_text = f"the clock of {topics[fastest].name}, {1.0 / step:.4g} Hz"
        grid_text += (
            f" with a jitter of {1e3 * jitter:.2g} ms" if jitter > UNEVEN_CLOCK_SHARE * step else ""
        )
    if grid.size < 2:
        raise RecordError(
            "the topics share fewer than two samples",
            where=str(file.path),
            remedy=f"they cover {spans}",
        )
    if len(used) == 1:
        return grid, f"the rows are those of {grid_text}"
    return (
        grid,
        f"{len(used)} topics are put on one grid, {grid_text}: "
        f"{', '.join(topics[n].name for n in used)}",
    )


PART_OF_A_VECTOR = re.compile(r"\w*\[\d+\]|[xyz]")  # xyz[0], control[1], x


def unread_topics(topics: Sequence[Topic], used: Sequence[int]) -> list[str]:
    """Return a sentence on topics that have the same columns as those that are read, as the sheets
    of several runs have.
    """
    sentences = []
    for at in used:
        header = topics[at].table.header
        named = [cell for cell in header if not is_clock(split_header(cell)[0])]
        if all(PART_OF_A_VECTOR.fullmatch(cell) for cell in named):
            continue  # names that any vector of a log has
        others = [
            topic.name
            for n, topic in enumerate(topics)
            if n not in used and topic.table.header == header
        ]
        if others:
            shown = ", ".join(others[:6]) + (", ..." if len(others) > 6 else "")
            have, are = ("has", "is") if len(others) == 1 else ("have", "are")
            sentences.append(
                f"{shown} {have} the same columns as {topics[at].name} and {are} not read"
            )
    return sentences


def on_grid(
    file: RecordFile,
    topics: Sequence[Topic],
    clocks: Mapping[int, tuple[np.ndarray, np.ndarray]],
    wanted: Wanted,
    grid: np.ndarray,
    step: float,
    hold: str | None,
    channel_units: Mapping[str, str],
) -> tuple[np.ndarray, str, str]:
    """Return a channel's values on the grid, NaN if an output has no sample, their unit, and how
    it got there.
    """
    unit, unused = unit_of(wanted, topics, channel_units)
    laid: dict[str, np.ndarray] = {}
    slowest = 0.0
    notes: list[str] = [unused] if unused else []
    for name, place in wanted.places.items():
        time, rows = clocks[place[0]]
        values = topic_numbers(file, topics, place, wanted, si=unit is None)[rows]
        laid[name], own, sentence = _laid(
            time, values, grid + wanted.choice.delay, step, wanted, hold
        )
        slowest = max(slowest, own)
        notes += [sentence] if sentence else []
    where = f"{file.path}, channel {wanted.channel}"
    values = calibrated(evaluate(wanted.expression, laid, where), wanted.choice)
    if not wanted.is_input and slowest > SAME_RATE * step:
        values = np.where(_nearest(clocks, wanted, grid), values, np.nan)
        notes.append(
            f"its own samples come every {slowest:.3g} s, the grid's every {step:.3g} s: it has "
            "samples only where it was measured"
        )
    return (
        values,
        unit if unit is not None else inside_unit(wanted.channel, channel_units),
        "; ".join(dict.fromkeys(notes)),
    )


def _laid(
    time: np.ndarray,
    values: np.ndarray,
    at: np.ndarray,
    step: float,
    wanted: Wanted,
    hold: str | None,
) -> tuple[np.ndarray, float, str]:
    """Return a column at the times of the grid, its own sampling interval, and a sentence if it was
    filtered or continued.
    """
    sound = np.isfinite(values)
    if np.count_nonzero(sound) < 2:
        return np.full(at.size, np.nan), 0.0, ""
    time, values = time[sound], values[sound]
    own = float(np.median(np.diff(time)))
    if np.array_equal(time, at):
        return values, own, ""
    if own * SAME_RATE < step:
        return (
            np.interp(at, time, _smoothed(time, values, own, step)),
            own,
            f"passes a zero-phase low-pass of {0.5 * BELOW_HALF / step:.3g} Hz",
        )
    if wanted.is_input and own > SAME_RATE * step:
        way = wanted.choice.hold or hold or ("previous" if leaps(values) else "linear")
        sentence = (
            f"its own samples come every {own:.3g} s and are "
            f"{'held' if way == 'previous' else 'joined by lines'} between them"
        )
        if way == "previous":
            return (
                values[np.clip(np.searchsorted(time, at, side="right") - 1, 0, time.size - 1)],
                own,
                sentence,
            )
        return np.interp(at, time, values), own, sentence
    return np.interp(at, time, values), own, ""


def leaps(values: np.ndarray) -> bool:
    """Return whether a signal is constant except for single steps, as a computer's command."""
    moves = np.diff(values) != 0.0
    return bool(np.mean(moves) < 0.3) if moves.size else True


def _smoothed(time: np.ndarray, values: np.ndarray, own: float, step: float) -> np.ndarray:
    from scipy.signal import butter, sosfiltfilt

    even = time[0] + own * np.arange(int((time[-1] - time[0]) / own * (1.0 + 1e-9)) + 1)
    if even.size < 20:
        return values
    sections = butter(FILTER_ORDER, 0.5 * BELOW_HALF / step, fs=1.0 / own, output="sos")
    smooth = sosfiltfilt(
        sections, np.interp(even, time, values), padlen=min(even.size - 1, round(6.0 * step / own))
    )
    return np.interp(time, even, smooth)


def _nearest(
    clocks: Mapping[int, tuple[np.ndarray, np.ndarray]], wanted: Wanted, grid: np.ndarray
) -> np.ndarray:
    """Grid times that are nearest to a sample of the slowest topic of a channel."""
    slow = max(
        {place[0] for place in wanted.places.values()},
        key=lambda n: float(np.median(np.diff(clocks[n][0]))),
    )
    time = clocks[slow][0]
    right = np.clip(np.searchsorted(grid, time), 1, grid.size - 1)
    nearest = np.where(time - grid[right - 1] < grid[right] - time, right - 1, right)
    result = np.zeros(grid.size, dtype=bool)
    result[nearest[(time >= grid[0]) & (time <= grid[-1])]] = True
    return result
