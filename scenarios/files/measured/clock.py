"""Time stamps of a record as seconds: dates, times of day, counters, few digits, roll-over,
repeated and unsorted rows.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scenarios.files.sources import LARGEST_NUMBER
from sim.errors import RecordError

COUNTERS = {"timeus": "us", "timems": "ms", "timens": "ns", "seconds": "s", "sec": "s"}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
USUAL_RATE = 50.0  # Hz; an unlabelled counter has the unit with the rate nearest to this
# Hz: a counter of whole numbers that would be slower in seconds does not count seconds
LOWEST_COUNTER_RATE = 0.1
FEWEST_STEPS = 20  # least number of steps that determine the unit of a counter
# Hz: an unlabelled clock that would be faster in seconds is in a longer unit
HIGHEST_CLOCK_RATE = 50_000.0
# Hz, from which a note says that an unlabelled clock is read in seconds
DOUBTFUL_CLOCK_RATE = 1000.0
LEAST_DATE_STAMP = 1e8  # s; larger stamps are dates
LATEST_EPOCH_STAMP = 4.2e9  # s: seconds since 1970 stay below it until the year 2103
# Largest delay of the first stamp after the end of a day or week, share of it.
ROLLOVER_DELAY_SHARE = 1e-3
HOUR = 3600.0  # s
DAY = 86400.0  # s
# Days of the years 1970 to 2100 as Excel and as MATLAB count them.
CALENDAR_DAYS = ((25_569.0, 73_415.0), (719_529.0, 767_376.0))
# Least share of uneven steps that is attributed to rounding of the stamps. Measured: correct for
# all of 1500 records at 10 to 400 Hz with 2 to 4 digits; 0.05 fails for 33 Hz in 0.01 s.
ROUNDED_STEP_SHARE = 0.01
COARSE_STAMP_SHARE = 0.01  # rounding of the stamps over the step that counts as coarse
# share of the rows that may stand in the wrong place; in order, a record has none and this decides
# nothing
MOST_DISPLACED_SHARE = 0.02
_TIME_OF_DAY = re.compile(
    r"(?:(?:(?:\d{4}[:-])?(\d{1,3})|(-?\d+) days?)[ "
    r":-])?(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+|:\d{3})?)"
)
_MINUTES = re.compile(r"(\d{1,3}):(\d{2}[.,]\d+)")  # as spreadsheets show a time of day
_DAY_AND_MONTH = re.compile(r"(\d{1,2})[./](\d{1,2})[./](\d{4})(.*)")


@dataclass(frozen=True, eq=False)
class Clock:
    """Time stamps in seconds.

    Attributes
    ----------
    time : ``(N,)``, s, NaN for rows without a readable time.
    notes : sentences on the decisions.
    origin : s, subtracted from the stamps; relates the clocks of one log.
    """

    time: np.ndarray
    notes: tuple[str, ...] = ()
    origin: float = 0.0


@dataclass(frozen=True, eq=False)
class Sorted:
    """Rows in the order of their times.

    Attributes
    ----------
    time : shape ``(M,)``, s.
    order : position of each row before, shape ``(M,)``.
    notes : one sentence each.
    """

    time: np.ndarray
    order: np.ndarray
    notes: tuple[str, ...] = ()


def counter_unit(name: str) -> str | None:
    """Unit that a clock's name alone states, as ``TimeUS`` does; None if it states none."""
    return COUNTERS.get(name.strip().lower())


def times_of_texts(cells: Sequence[object]) -> Clock | None:
    """Dates, times of day, IRIG times or durations in seconds from the first; None for others.

    Dates are ISO 8601, or day, month and year in either order. Times of day are ``hh:mm:ss.sss``,
    with a comma or a colon before the fraction, or ``mm:ss.s``. IRIG times are
    ``DDD:hh:mm:ss.sss``, also with a year before or a dash after the day. Durations are those of
    pandas, ``0 days 00:00:01.5``. A time of day that falls by more than half a day has passed
    midnight; one of minutes that falls by more than half an hour has passed the hour.
    """
    texts = ["" if cell is None else str(cell).strip() for cell in cells]
    filled = [text for text in texts if text]
    if not filled:
        return None
    of_minutes = _MINUTES.fullmatch(filled[0]) is not None
    match = _TIME_OF_DAY.fullmatch(filled[0])
    if match is None and not of_minutes:
        return _dates(texts)
    seconds = np.full(len(texts), np.nan)
    for row, text in enumerate(texts):
        if not text:
            continue
        parts = (_MINUTES if of_minutes else _TIME_OF_DAY).fullmatch(text)
        if parts is None:
            return None
        seconds[row] = (
            60.0 * int(parts[1]) + _fraction(parts[2]) if of_minutes else _seconds_of_day(parts)
        )
    irig, duration = (False, False) if match is None else (bool(match[1]), bool(match[2]))
    kind = "IRIG times (days of the year)" if irig else "durations" if duration else "times of day"
    kind = "minutes and seconds" if of_minutes else kind
    note = f"{kind} count from the first, {filled[0]}"
    finite_rows = np.flatnonzero(np.isfinite(seconds))
    turn = 0.0 if irig or duration else HOUR if of_minutes else DAY
    turns = (
        np.concatenate([[0.0], np.cumsum(np.diff(seconds[finite_rows]) < -0.5 * turn)])
        if turn
        else np.zeros(finite_rows.size)
    )
    seconds[finite_rows] += turn * turns
    if turns.size and turns[-1]:
        note += "; the full hour is passed" if of_minutes else "; midnight is passed"
    return Clock(
        np.round(seconds - seconds[finite_rows[0]], 9), (note,), float(seconds[finite_rows[0]])
    )


def _seconds_of_day(parts: re.Match[str]) -> float:
    days = int(parts[1] or parts[2] or 0)
    return DAY * days + 60.0 * (60.0 * int(parts[3]) + int(parts[4])) + _fraction(parts[5])


def _fraction(text: str) -> float:
    """Seconds with a fraction after a point, a comma or a colon."""
    return float(text.replace(",", ".").replace(":", "."))


def times_of_dates(dates: np.ndarray) -> Clock:
    """NumPy's dates or durations in seconds, dates from the first."""
    if dates.dtype.kind == "m":
        return Clock(np.where(np.isnat(dates), np.nan, dates / np.timedelta64(1, "ns") * 1e-9))
    finite_rows = np.flatnonzero(~np.isnat(dates))
    if not finite_rows.size:
        return Clock(np.full(dates.size, np.nan))
    first = dates[finite_rows[0]]
    seconds = np.where(np.isnat(dates), np.nan, (dates - first) / np.timedelta64(1, "ns") * 1e-9)
    origin = float((first - np.datetime64(0, "ns")) / np.timedelta64(1, "ns") * 1e-9)
    return Clock(
        seconds, (f"dates count from the first, {np.datetime_as_string(first, unit='ms')}",), origin
    )


def seconds_of_counter(values: np.ndarray, unit: str | None, where: str = "the clock") -> Clock:
    """Return the numbers of a clock in seconds.

    Parameters
    ----------
    values : shape ``(N,)``, NaN if missing.
    unit : ``s``, ``ms``, ``us`` or ``ns``; None: decided by the rate.
    where : the column, for a message.

    A counter of 16 or 32 bits that begins anew goes on. Stamps of a calendar count from the first
    sample.

    Raises
    ------
    RecordError : no unit is stated, and the rate would be impossible in seconds, so that the clock
        may be in minutes, hours or days.
    """
    notes: list[str] = []
    stated = unit == "s"
    finite = np.isfinite(values)
    if np.count_nonzero(finite) < 2:
        return Clock(values)
    values, turns = _unrolled(values)
    if turns:
        notes.append(
            f"the counter of the clock begins anew {turns} time{'s' * (turns > 1)} and goes on"
        )
    if unit is None:
        unit, sentence = _unit_by_rate(values[finite], where)
        notes += [sentence] if sentence else []
    if unit == "d":
        first = float(values[finite][0])
        days = (values - first) * DAY
        return Clock(days, (*notes, "the time counts from the first sample"), first * DAY)
    factor, first = SECONDS[unit], 0.0
    if not stated and abs(values[finite][0]) * factor > LEAST_DATE_STAMP:
        notes.append("the time counts from the first sample")
        first = float(values[finite][0])
        values = values - first
    seconds, period = _past_midnight(values * factor if factor != 1.0 else values)
    notes += [f"the clock begins anew after a {period} and goes on"] if period else []
    return Clock(seconds, tuple(notes), first * factor)


def _unit_by_rate(values: np.ndarray, where: str) -> tuple[str, str]:
    """Return the unit of an unlabelled clock, ``d`` among them, and a sentence on it; ``values``
    are finite.

    Raises
    ------
    RecordError : the rate is impossible in seconds, and no unit is certain.
    """
    steps = np.diff(values)
    moves = steps > 0.0
    # Stamps with few digits repeat more often than they change.
    step = float(np.median(steps[moves]) * np.mean(moves)) if np.any(moves) else 0.0
    if not step > 0.0 or steps.size < FEWEST_STEPS:
        return "s", ""
    whole = bool(np.all(values == np.round(values)))
    if whole and (step * LOWEST_COUNTER_RATE >= 1.0 or abs(values[0]) > LATEST_EPOCH_STAMP):
        unit = min(SECONDS, key=lambda name: abs(np.log(step * SECONDS[name] * USUAL_RATE)))
        return (
            unit,
            f"the time is read in {unit} (steps of {step:g}): {1.0 / (step * SECONDS[unit]):.4g} "
            "samples a second",
        )
    rate = 1.0 / step
    if rate > HIGHEST_CLOCK_RATE:
        if any(low <= values[0] <= high for low, high in CALENDAR_DAYS):
            return "d", f"the time is read in days of a calendar: {rate / DAY:.4g} samples a second"
        what = f"in seconds these times would be {rate:.3g} samples a second, and no unit is stated"
        remedy = (
            'state the unit: time = {column = "HEADER", unit = "h"} in the channel map, or "min", '
            'or "d"'
        )
        raise RecordError(what, where=where, remedy=remedy)
    if rate > DOUBTFUL_CLOCK_RATE or (whole and step > 1.0):
        other = "min" if rate > DOUBTFUL_CLOCK_RATE else "ms"
        return (
            "s",
            f"the time is read in s: {rate:.4g} samples a second; if it is in {other}, state the "
            "unit in the channel map",
        )
    return "s", ""


def grid_of_coarse_stamps(time: np.ndarray) -> tuple[np.ndarray, str] | None:
    """Return the even grid that was rounded to the stamps, and a sentence; None if the stamps
    are exact enough or no even grid explains them.

    Parameters
    ----------
    time : shape ``(N,)``, s, finite.

    Notes
    -----
    The grid ``a + b k`` has to lie within half a unit of the last digit of every stamp; the digits
    are counted for each power of ten, as numbers printed with a fixed number of significant digits
    have fewer decimals the larger they are. Of all such grids the one with the least largest
    deviation is taken (a linear program in ``a``, ``b``).
    """
    if (
        time.size < 10
        or not np.max(np.abs(time)) < LARGEST_NUMBER
        or not np.all(np.diff(time) >= 0.0)
    ):
        return None
    step = (time[-1] - time[0]) / (time.size - 1)
    if not step > 0.0:
        return None
    usual = float(np.median(np.diff(time)))
    uneven = np.abs(np.diff(time) - usual) > COARSE_STAMP_SHARE * step
    # If most stamps repeat, the few changes are no faults.
    if usual > 0.0 and np.mean(uneven) < ROUNDED_STEP_SHARE:
        return None
    unit = _last_digits(time)
    if np.max(unit) < COARSE_STAMP_SHARE * step:
        return None
    from scipy.optimize import linprog

    some = np.unique(np.linspace(0, time.size - 1, min(time.size, 4000)).astype(int))
    k, scale = some / (time.size - 1), 0.5 * unit[some]
    ones = np.ones_like(k)
    rows = np.vstack([np.column_stack([ones, k, -scale]), np.column_stack([-ones, -k, -scale])])
    shifted = time[some] - time[0]
    solution = linprog(
        [0.0, 0.0, 1.0],
        A_ub=rows,
        b_ub=np.concatenate([shifted, -shifted]),
        bounds=[(None, None), (None, None), (0.0, None)],
    )
    if solution.status != 0:
        return None
    grid = time[0] + solution.x[0] + solution.x[1] * np.arange(time.size) / (time.size - 1)
    if np.any(np.abs(grid - time) > 0.5 * unit * (1.0 + 1e-6) + 1e-12):
        return None
    even = solution.x[1] / (time.size - 1)
    repeats = int(np.count_nonzero(np.diff(time) == 0.0))
    repeated = f" and repeat {repeats} times" if repeats else ""
    return (
        grid,
        f"the time stamps have few digits{repeated}: an even grid of {even:.6g} s explains all of "
        "them and is used",
    )


def sorted_rows(time: np.ndarray, repeats: np.ndarray) -> Sorted | None:
    """Sorted rows without exact repeats; None if too many are out of order, or a time remains
    twice.

    Parameters
    ----------
    time : shape ``(N,)``, s, finite.
    repeats : shape ``(N,)``, whether a row has the same cells as the row of equal time before it.
    """
    order = np.argsort(time, kind="stable")
    notes = []
    misplaced = int(np.count_nonzero(np.diff(time) < 0.0))
    if misplaced:
        if misplaced > MOST_DISPLACED_SHARE * time.size or np.max(
            np.abs(order - np.arange(time.size))
        ) > max(10, MOST_DISPLACED_SHARE * time.size):
            return None
        notes.append(f"rows are sorted by time ({misplaced} stood after a later one)")
    order = order[~repeats[order]]
    dropped = time.size - order.size
    if dropped:
        notes.append(
            f"{dropped} row{'s that repeat' if dropped > 1 else ' that repeats'} the one before "
            f"{'are' if dropped > 1 else 'is'} left out"
        )
    if order.size < 2 or np.any(np.diff(time[order]) <= 0.0):
        return None
    return Sorted(time[order], order, tuple(notes))


def _dates(texts: Sequence[str]) -> Clock | None:
    import pandas

    first_text = next(text for text in texts if text)
    if not re.match(r"\d{4}-?\d{2}-?\d{2}|\d{1,2}[./]\d{1,2}[./]\d{4}", first_text):
        return None
    result = []
    for texts_in_order, words in _orders_of_day_and_month(texts):
        series = pandas.Series([text or None for text in texts_in_order])
        for form in ("ISO8601", "mixed"):
            try:
                stamps = pandas.to_datetime(series, utc=True, format=form)
            except (ValueError, TypeError, OverflowError):
                continue
            valid = stamps.dropna()
            result.append((valid.max() - valid.min(), stamps, words))
            break
    if not result:
        return None
    # Records are short: use the order of day and month with the shorter duration.
    _, stamps, words = min(result, key=lambda each: each[0])
    first = stamps[stamps.first_valid_index()]
    seconds = (stamps - first).dt.total_seconds().to_numpy(dtype=float)
    return Clock(
        seconds,
        (f"dates{words} count from the first, {first.isoformat()}",),
        float(first.timestamp()),
    )


def _orders_of_day_and_month(texts: Sequence[str]) -> list[tuple[Sequence[str], str]]:
    """Return the dates as year, month, day; without the year first, for both orders."""
    parted = [_DAY_AND_MONTH.fullmatch(text) for text in texts]
    if not any(parted):
        return [(texts, "")]
    orders: list[tuple[Sequence[str], str]] = []
    for day, month, words in ((1, 2, " (day first)"), (2, 1, " (month first)")):
        ordered = [
            f"{each[3]}-{int(each[month]):02d}-{int(each[day]):02d}{each[4]}" if each else text
            for each, text in zip(parted, texts, strict=True)
        ]
        orders.append((ordered, words))
    return orders


def _past_midnight(time: np.ndarray) -> tuple[np.ndarray, str]:
    """Seconds of the day or of the GPS week, which begin anew at the end of it, made continuous;
    and which.
    """
    finite_rows = np.flatnonzero(np.isfinite(time))
    steps = np.diff(time[finite_rows])
    for period, name in ((DAY, "day"), (7.0 * DAY, "week")):
        turns = np.abs(steps + period) < ROLLOVER_DELAY_SHARE * period
        if (
            np.any(turns)
            and np.min(time[finite_rows]) >= 0.0
            and np.max(time[finite_rows]) <= period
        ):
            out = time.copy()
            out[finite_rows] += period * np.concatenate([[0.0], np.cumsum(turns)])
            return out, name
    return time, ""


def _unrolled(values: np.ndarray) -> tuple[np.ndarray, int]:
    """Return a counter of 16 or 32 bits without its overflows."""
    finite_rows = np.flatnonzero(np.isfinite(values))
    steps = np.diff(values[finite_rows])
    for bits in (16, 32):
        span = 2.0**bits
        turns = steps < -0.9 * span
        if (
            np.any(turns)
            and np.nanmax(values) < span
            and np.all(values[finite_rows] == np.round(values[finite_rows]))
        ):
            out = values.copy()
            out[finite_rows] += span * np.concatenate([[0], np.cumsum(turns)])
            return out, int(np.count_nonzero(turns))
    return values, 0


def _last_digits(time: np.ndarray) -> np.ndarray:
    """Return the unit of the last digit with which stamps of each power of ten are written, s,
    shape ``(N,)``.
    """
    power = np.floor(np.log10(np.maximum(np.abs(time), 1e-12))).astype(int)
    unit = np.zeros_like(time)
    for each in np.unique(power):
        here = power == each
        values = time[here]
        for decimals in range(-6, 13):
            scaled = values * 10.0**decimals
            rounded = np.round(scaled)
            # A number below half a unit rounds to zero, but is not written in that unit.
            whole = np.all((rounded != 0.0) | (values == 0.0))
            if whole and np.all(
                np.abs(scaled - rounded) < 1e-6 * np.maximum(1.0, np.abs(scaled) * 1e-6)
            ):
                unit[here] = 10.0**-decimals
                break
    # Small numbers may by chance need fewer digits than larger ones: a stamp has no fewer decimals
    # than a larger one.
    for each in np.unique(power)[::-1]:
        here = power == each
        larger = unit[power > each]
        if larger.size:
            unit[here] = np.minimum(unit[here], larger.min())
    return unit
