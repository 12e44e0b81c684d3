"""Conversion of time stamps to seconds: dates, times of day and counters.

Stamps with few digits, counters that overflow, and repeated or unsorted rows are also corrected
here.
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
# Rates of a clock without a unit, Hz, if it were in seconds:
USUAL_RATE = 50.0  # a counter gets the unit with the rate nearest to this
LOWEST_COUNTER_RATE = 0.1  # a counter of whole numbers with a lower rate is not in seconds
HIGHEST_CLOCK_RATE = 50_000.0  # a clock with a higher rate has a longer unit than seconds
DOUBTFUL_CLOCK_RATE = 1000.0  # a clock with a higher rate is read in seconds with a note
FEWEST_STEPS = 20  # fewest steps of a clock whose unit is decided by its rate
LEAST_DATE_STAMP = 1e8  # s; larger stamps are dates
LATEST_EPOCH_STAMP = 4.2e9  # s; seconds since 1970 stay below it until the year 2103
# longest time from the end of a day or week to the first stamp after it, over a day or week
ROLLOVER_DELAY_SHARE = 1e-3
OVERFLOW_SHARE = 0.9  # a counter that decreases by a larger share of its range has an overflow
HOUR = 3600.0  # s
DAY = 86400.0  # s
# numbers of the days of the years 1970 to 2100 in Excel and in MATLAB
CALENDAR_DAYS = ((25_569.0, 73_415.0), (719_529.0, 767_376.0))
# smallest share of uneven steps that is attributed to rounding of the stamps: right for all of 1500
# records at 10 to 400 Hz with 2 to 4 digits; 0.05 fails for 33 Hz in 0.01 s
ROUNDED_STEP_SHARE = 0.01
COARSE_STAMP_SHARE = 0.01  # stamps whose rounding is a larger share of the step are coarse
MOST_FIT_STAMPS = 4000  # most stamps that determine an even grid, so that the fit is fast
FEWEST_GRID_STAMPS = 10  # fewest stamps to which an even grid is fitted
MOST_DISPLACED_SHARE = 0.02  # largest share of displaced rows of a record that is sorted
_TIME_OF_DAY = re.compile(
    r"(?:(?:(?:\d{4}[:-])?(\d{1,3})|(-?\d+) days?)[ "
    r":-])?(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+|:\d{3})?)"
)
_MINUTES = re.compile(r"(\d{1,3}):(\d{2}[.,]\d+)")  # form of a time of day in spreadsheets
_DAY_AND_MONTH = re.compile(r"(\d{1,2})[./](\d{1,2})[./](\d{4})(.*)")


@dataclass(frozen=True, eq=False)
class Clock:
    """Time stamps in seconds.

    Attributes
    ----------
    time : ``(N,)``, s; NaN for rows without a readable time.
    notes : sentences on the interpretation of the stamps.
    origin : s, subtracted from the stamps. The sum of both is the same time for all clocks of a
        log.
    """

    time: np.ndarray
    notes: tuple[str, ...] = ()
    origin: float = 0.0


@dataclass(frozen=True, eq=False)
class Sorted:
    """Rows in the order of their times.

    Attributes
    ----------
    time : ``(M,)``, s, increasing.
    order : ``(M,)`` position of each row in the file.
    notes : sentences on rows that were moved or left out.
    """

    time: np.ndarray
    order: np.ndarray
    notes: tuple[str, ...] = ()


def counter_unit(name: str) -> str | None:
    """Return the unit in the name of a clock such as ``TimeUS``; None for a name without one."""
    return COUNTERS.get(name.strip().lower())


def times_of_texts(cells: Sequence[object]) -> Clock | None:
    """Return texts of times in seconds from the first; None for other texts.

    - Dates: ISO 8601, or day, month and year; day and month in either order.
    - Times of day: ``hh:mm:ss.sss``, also with a comma or a colon before the fraction, or
      ``mm:ss.s``. A decrease by more than half a day is midnight. A decrease of ``mm:ss.s`` by more
      than half an hour is the full hour.
    - IRIG times: ``DDD:hh:mm:ss.sss``, also with a year before the day or a dash after it.
    - Durations of pandas: ``0 days 00:00:01.5``.
    """
    texts = ["" if cell is None else str(cell).strip() for cell in cells]
    filled = [text for text in texts if text]
    if not filled:
        return None
    without_hours = _MINUTES.fullmatch(filled[0]) is not None
    match = _TIME_OF_DAY.fullmatch(filled[0])
    if match is None and not without_hours:
        return _dates(texts)
    seconds = np.full(len(texts), np.nan)
    for row, text in enumerate(texts):
        if not text:
            continue
        parts = (_MINUTES if without_hours else _TIME_OF_DAY).fullmatch(text)
        if parts is None:
            return None
        if without_hours:
            seconds[row] = 60.0 * int(parts[1]) + _seconds_with_fraction(parts[2])
        else:
            seconds[row] = _seconds_of_day(parts)
    if without_hours:
        kind, period = "minutes and seconds", HOUR
    elif match is not None and match[1]:
        kind, period = "IRIG times (days of the year)", 0.0
    elif match is not None and match[2]:
        kind, period = "durations", 0.0
    else:
        kind, period = "times of day", DAY
    note = f"{kind} count from the first, {filled[0]}"
    finite_rows = np.flatnonzero(np.isfinite(seconds))
    if period:
        decreases = np.diff(seconds[finite_rows]) < -0.5 * period
        periods = np.concatenate([[0.0], np.cumsum(decreases)])
        seconds[finite_rows] += period * periods
        if periods[-1]:
            note += "; the full hour is passed" if without_hours else "; midnight is passed"
    first = float(seconds[finite_rows[0]])
    return Clock(np.round(seconds - first, 9), (note,), first)


def _seconds_of_day(parts: re.Match[str]) -> float:
    """Return the seconds of a match of ``_TIME_OF_DAY``, days included."""
    days = int(parts[1] or parts[2] or 0)
    minutes = 60.0 * int(parts[3]) + int(parts[4])
    return DAY * days + 60.0 * minutes + _seconds_with_fraction(parts[5])


def _seconds_with_fraction(text: str) -> float:
    """Return the number of seconds; a point, a comma or a colon precedes the fraction."""
    return float(text.replace(",", ".").replace(":", "."))


def times_of_dates(dates: np.ndarray) -> Clock:
    """Return dates or durations of NumPy in seconds; dates are counted from the first."""
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

    A counter of 16 or 32 bits continues after an overflow. Stamps that are dates are counted from
    the first sample.

    Parameters
    ----------
    values : ``(N,)``, NaN if missing.
    unit : ``s``, ``ms``, ``us`` or ``ns``; None decides by the rate.
    where : file and column, for messages.

    Raises
    ------
    RecordError : if ``unit`` is None and the rate in seconds is impossible: the clock may be in
        minutes, hours or days.
    """
    notes: list[str] = []
    seconds_are_stated = unit == "s"
    finite = np.isfinite(values)
    if np.count_nonzero(finite) < 2:
        return Clock(values)
    values, overflows = _without_overflows(values)
    if overflows:
        times = "time" if overflows == 1 else "times"
        notes.append(f"the counter of the clock begins anew {overflows} {times} and goes on")
    if unit is None:
        unit, sentence = _unit_by_rate(values[finite], where)
        if sentence:
            notes.append(sentence)
    if unit == "d":
        first = float(values[finite][0])
        days = (values - first) * DAY
        return Clock(days, (*notes, "the time counts from the first sample"), first * DAY)
    factor, first = SECONDS[unit], 0.0
    if not seconds_are_stated and abs(values[finite][0]) * factor > LEAST_DATE_STAMP:
        notes.append("the time counts from the first sample")
        first = float(values[finite][0])
        values = values - first
    seconds, period = _past_midnight(values * factor if factor != 1.0 else values)
    if period:
        notes.append(f"the clock begins anew after a {period} and goes on")
    return Clock(seconds, tuple(notes), first * factor)


def _unit_by_rate(values: np.ndarray, where: str) -> tuple[str, str]:
    """Return the unit of a clock without a stated unit, ``s``, ``ms``, ``us``, ``ns`` or ``d``, and
    a sentence on it; the sentence is empty if there is no doubt.

    Parameters
    ----------
    values : ``(N,)`` stamps, finite.
    where : file and column, for messages.

    Raises
    ------
    RecordError : if the rate in seconds is impossible, and no other unit is certain.
    """
    steps = np.diff(values)
    forward = steps > 0.0
    # Stamps with few digits repeat: the interval is the step, times the share of changed stamps.
    step = float(np.median(steps[forward]) * np.mean(forward)) if np.any(forward) else 0.0
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
    """Return the even grid ``(N,)`` of times, s, whose rounding gives the stamps ``time (N,)``, s,
    and a sentence on it; None if the stamps are exact enough, or if no even grid explains them.

    Notes
    -----
    Every stamp may differ from the grid ``a + b k`` by half a unit of its last digit. The last
    digit is determined for each power of ten, since larger numbers with the same significant digits
    have fewer decimals. A linear program in ``a`` and ``b`` minimizes the largest deviation.
    """
    if (
        time.size < FEWEST_GRID_STAMPS
        or not np.max(np.abs(time)) < LARGEST_NUMBER
        or not np.all(np.diff(time) >= 0.0)
    ):
        return None
    step = (time[-1] - time[0]) / (time.size - 1)
    if not step > 0.0:
        return None
    usual = float(np.median(np.diff(time)))
    uneven = np.abs(np.diff(time) - usual) > COARSE_STAMP_SHARE * step
    # If the usual step is zero, most stamps repeat, so that other steps are no faults.
    if usual > 0.0 and np.mean(uneven) < ROUNDED_STEP_SHARE:
        return None
    unit = _last_digits(time)
    if np.max(unit) < COARSE_STAMP_SHARE * step:
        return None
    from scipy.optimize import linprog

    samples = np.linspace(0, time.size - 1, min(time.size, MOST_FIT_STAMPS))
    samples = np.unique(samples.astype(int))
    # Unknowns: offset a, length b of the grid, largest deviation d in units of half a last digit.
    k, half_digit = samples / (time.size - 1), 0.5 * unit[samples]
    ones = np.ones_like(k)
    above = np.column_stack([ones, k, -half_digit])
    below = np.column_stack([-ones, -k, -half_digit])
    shifted = time[samples] - time[0]
    solution = linprog(
        [0.0, 0.0, 1.0],
        A_ub=np.vstack([above, below]),
        b_ub=np.concatenate([shifted, -shifted]),
        bounds=[(None, None), (None, None), (0.0, None)],
    )
    if solution.status != 0:
        return None
    grid = time[0] + solution.x[0] + solution.x[1] * np.arange(time.size) / (time.size - 1)
    if np.any(np.abs(grid - time) > 0.5 * unit * (1.0 + 1e-6) + 1e-12):
        return None
    interval = solution.x[1] / (time.size - 1)
    repeats = int(np.count_nonzero(np.diff(time) == 0.0))
    repeated = f" and repeat {repeats} times" if repeats else ""
    sentence = (
        f"the time stamps have few digits{repeated}: an even grid of {interval:.6g} s explains all "
        "of them and is used"
    )
    return grid, sentence


def sorted_rows(time: np.ndarray, repeats: np.ndarray) -> Sorted | None:
    """Return the rows in the order of time, without rows that repeat the row before them.

    The result is None if too many rows are out of order, or if two different rows have the same
    time.

    Parameters
    ----------
    time : ``(N,)``, s, finite.
    repeats : ``(N,)`` whether a row has the same cells as the row of equal time before it.
    """
    order = np.argsort(time, kind="stable")
    notes = []
    misplaced = int(np.count_nonzero(np.diff(time) < 0.0))
    if misplaced:
        most = MOST_DISPLACED_SHARE * time.size
        largest_distance = np.max(np.abs(order - np.arange(time.size)))
        if misplaced > most or largest_distance > max(10, most):
            return None
        notes.append(f"rows are sorted by time ({misplaced} stood after a later one)")
    order = order[~repeats[order]]
    dropped = time.size - order.size
    if dropped:
        rows, are = ("row that repeats", "is") if dropped == 1 else ("rows that repeat", "are")
        notes.append(f"{dropped} {rows} the one before {are} left out")
    if order.size < 2 or np.any(np.diff(time[order]) <= 0.0):
        return None
    return Sorted(time[order], order, tuple(notes))


def _dates(texts: Sequence[str]) -> Clock | None:
    """Return dates in seconds from the first; None for other texts."""
    import pandas

    first_text = next(text for text in texts if text)
    if not re.match(r"\d{4}-?\d{2}-?\d{2}|\d{1,2}[./]\d{1,2}[./]\d{4}", first_text):
        return None
    readings = []
    for texts_in_order, words in _orders_of_day_and_month(texts):
        series = pandas.Series([text or None for text in texts_in_order])
        for form in ("ISO8601", "mixed"):
            try:
                stamps = pandas.to_datetime(series, utc=True, format=form)
            except (ValueError, TypeError, OverflowError):
                continue
            valid = stamps.dropna()
            readings.append((valid.max() - valid.min(), stamps, words))
            break
    if not readings:
        return None
    # Records are short: the order of day and month with the shorter duration is right.
    _, stamps, words = min(readings, key=lambda reading: reading[0])
    first = stamps[stamps.first_valid_index()]
    seconds = (stamps - first).dt.total_seconds().to_numpy(dtype=float)
    return Clock(
        seconds,
        (f"dates{words} count from the first, {first.isoformat()}",),
        float(first.timestamp()),
    )


def _orders_of_day_and_month(texts: Sequence[str]) -> list[tuple[Sequence[str], str]]:
    """Return the possible readings of dates, each as texts with year, month and day in this order,
    with words on the reading.

    Dates with the year first have one reading. Other dates have two: day first and month first.
    """
    matches = [_DAY_AND_MONTH.fullmatch(text) for text in texts]
    if not any(matches):
        return [(texts, "")]
    orders: list[tuple[Sequence[str], str]] = []
    for day, month, words in ((1, 2, " (day first)"), (2, 1, " (month first)")):
        ordered = [
            f"{match[3]}-{int(match[month]):02d}-{int(match[day]):02d}{match[4]}" if match else text
            for match, text in zip(matches, texts, strict=True)
        ]
        orders.append((ordered, words))
    return orders


def _past_midnight(time: np.ndarray) -> tuple[np.ndarray, str]:
    """Return seconds of the day, or of the GPS week, made continuous over its end, ``(N,)``; and
    ``"day"``, ``"week"``, or an empty text if there is no such end.
    """
    finite_rows = np.flatnonzero(np.isfinite(time))
    finite = time[finite_rows]
    for period, name in ((DAY, "day"), (7.0 * DAY, "week")):
        rollovers = np.abs(np.diff(finite) + period) < ROLLOVER_DELAY_SHARE * period
        if np.any(rollovers) and np.min(finite) >= 0.0 and np.max(finite) <= period:
            continuous = time.copy()
            continuous[finite_rows] += period * np.concatenate([[0.0], np.cumsum(rollovers)])
            return continuous, name
    return time, ""


def _without_overflows(values: np.ndarray) -> tuple[np.ndarray, int]:
    """Return a counter of 16 or 32 bits made continuous, and the number of its overflows."""
    finite_rows = np.flatnonzero(np.isfinite(values))
    steps = np.diff(values[finite_rows])
    for bits in (16, 32):
        span = 2.0**bits
        overflows = steps < -OVERFLOW_SHARE * span
        if (
            np.any(overflows)
            and np.nanmax(values) < span
            and np.all(values[finite_rows] == np.round(values[finite_rows]))
        ):
            continuous = values.copy()
            continuous[finite_rows] += span * np.concatenate([[0], np.cumsum(overflows)])
            return continuous, int(np.count_nonzero(overflows))
    return values, 0


def _last_digits(time: np.ndarray) -> np.ndarray:
    """Return the unit of the last written digit of each stamp, s, ``(N,)``.

    Stamps of one power of ten have one unit: the largest one of which all are whole multiples.
    """
    power = np.floor(np.log10(np.maximum(np.abs(time), 1e-12))).astype(int)
    unit = np.zeros_like(time)
    for exponent in np.unique(power):
        here = power == exponent
        values = time[here]
        for decimals in range(-6, 13):
            scaled = values * 10.0**decimals
            rounded = np.round(scaled)
            # A number below half a unit rounds to zero, so that it is not written in this unit.
            whole = np.all((rounded != 0.0) | (values == 0.0))
            if whole and np.all(
                np.abs(scaled - rounded) < 1e-6 * np.maximum(1.0, np.abs(scaled) * 1e-6)
            ):
                unit[here] = 10.0**-decimals
                break
    # A written number has at least as many decimals as a larger one. Some small numbers have zeros
    # as last digits by chance.
    for exponent in np.unique(power)[::-1]:
        here = power == exponent
        larger = unit[power > exponent]
        if larger.size:
            unit[here] = np.minimum(unit[here], larger.min())
    return unit
