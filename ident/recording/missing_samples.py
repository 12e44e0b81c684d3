"""Samples that are not measurements: drop-outs, missing rows, held values, interpolated channels.

A repeated value is no fault where the least bit is coarse or the channel is at rest. A run of one
value counts only if noise excludes it while other channels change, if another channel moves
meanwhile, or if the value jumps at the end of the run.

Interpolated samples have zero second (straight line) or fourth (cubic) differences, to the last
printed digit; the sensor's noise bends the curve at the updates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.recording.series import (
    Certainty,
    FindingQuantity,
    Kind,
    RecordFinding,
    Series,
    exact_step,
    runs_of,
)
from sim.errors import instant, time_span
from sim.record import Record

# ---- Values that mark missing samples: runs of exact zeros, and a fill value such as -999

ZERO_SIGMAS = 8.0  # smallest step to and from a zero, in sigmas of the noise
ZERO_BITS = 4.0
ZERO_SPAN_SHARE = 0.1  # smallest step, as a share of the span of the other samples
FILL_VALUE_SPANS = 5.0  # distance of a fill value, in spans of the other samples
SHORTEST_PULSE = 0.1  # s: commanded steps to zero and back are longer
MOST_ZEROS = 5  # most zeros in a row


def dropouts(series: Series, count: int, *, is_input: bool = False) -> list[RecordFinding]:
    """Find zeros and fill values among other samples and mask them; in an input, which must have no
    gap, they are a warning.
    """
    result = [("exact zeros", 0.0, _zeros(series))]
    fill, at = _fill(series)
    result.append((f"the fill value {fill:g}", fill, at))
    out = []
    for word, value, where in result:
        if not np.any(where):
            continue
        runs = runs_of(where)
        if is_input:
            runs = np.array(
                [
                    (b, e)
                    for b, e in runs
                    if e - b <= MOST_ZEROS and _lasts(series, b, e) <= SHORTEST_PULSE
                ]
            ).reshape(-1, 2)
            if not len(runs):
                continue
        out.append(_finding(series, runs, word, value, count, is_input=is_input))
    return out


def _finding(
    series: Series, runs: np.ndarray, word: str, value: float, count: int, *, is_input: bool
) -> RecordFinding:
    times = tuple((float(series.time[b]), float(series.time[e - 1])) for b, e in runs)
    samples = int(sum(e - b for b, e in runs))
    first = ", ".join(f"{instant(begin)} s" for begin, _ in times[:3])
    text = (
        f"has {samples} sample(s) that are {word}, at "
        f"{first}{' and so on' if len(times) > 3 else ''}, while it is elsewhere before and after"
    )
    numbers = {
        "value": FindingQuantity(value, series.unit),
        "samples": FindingQuantity(float(samples), "1"),
    }
    if is_input:
        return RecordFinding(
            series.name,
            Kind.DROPOUT,
            Certainty.LIKELY,
            text,
            "fill the dropouts of an input, or cut the record there",
            times,
            numbers,
        )
    mask = np.zeros(count, dtype=bool)
    for b, e in runs:
        mask[series.rows[b:e]] = True
    remedy = "leave cells empty where there is no measurement"
    return RecordFinding(
        series.name, Kind.DROPOUT, Certainty.COSTS_INFORMATION, text, remedy, times, numbers, mask
    )


def _zeros(series: Series) -> np.ndarray:
    """Runs of exact zeros between two similar values far from zero."""
    values = series.values
    where = np.zeros(len(values), dtype=bool)
    zero = values == 0.0
    if not np.any(zero) or np.all(zero):
        return where
    rest = values[~zero]
    noise = max(ZERO_SIGMAS * series.noise, ZERO_BITS * series.least_bit)
    least = max(noise, ZERO_SPAN_SHARE * float(np.ptp(rest)), 1e-300)
    for begin, end in runs_of(zero):
        if begin == 0 or end == len(values):
            continue
        before, after = float(values[begin - 1]), float(values[end])
        if (
            min(abs(before), abs(after)) > least
            and before * after > 0.0
            and _is_sudden(values, begin, end, least)
        ):
            where[begin:end] = True
    return where


def _is_sudden(values: np.ndarray, begin: int, end: int, least: float) -> bool:
    """Return whether the step to zero is several times the steps before and after it."""
    before = np.abs(np.diff(values[max(0, begin - 4) : begin]))
    after = np.abs(np.diff(values[end : end + 4]))
    usual = float(np.max(np.concatenate([before, after]))) if before.size + after.size else 0.0
    return min(abs(float(values[begin - 1])), abs(float(values[end]))) > max(3.0 * usual, least)


def _fill(series: Series) -> tuple[float, np.ndarray]:
    result = fill_value(series.values, series.noise)
    at = np.zeros(len(series.values), dtype=bool) if result is None else series.values == result
    return result or 0.0, at


def fill_value(values: np.ndarray, noise: float = 0.0) -> float | None:
    """Return the largest or smallest value if it occurs at least twice, far outside the range of
    all others (as -999 for no measurement); else None. ``noise``: standard deviation, in the unit
    of the channel.
    """
    for value in (float(np.max(values)), float(np.min(values))) if values.size else ():
        at = values == value
        rest = values[~at]
        if value == 0.0 or np.count_nonzero(at) < 2 or len(rest) < len(values) // 2:
            continue
        if (
            float(np.min(np.abs(rest - value)))
            > FILL_VALUE_SPANS * max(float(np.ptp(rest)), 10.0 * noise)
            > 0.0
        ):
            return value
    return None


def _lasts(series: Series, begin: int, end: int) -> float:
    return float(series.time[min(end, len(series.time) - 1)] - series.time[begin])


# ---- Missing rows: gaps in time, reported if an input moves across them

# largest deviation, as a share of the usual step, of nine tenths of the steps of an even record
EVEN_SAMPLING_TOLERANCE = 0.05
EVEN_GAP = 1.6  # longest step of an even record without missing rows, in usual steps
UNEVEN_GAP = 4.0  # the same for an uneven record
MOVING_INPUT_SHARE = 0.05  # smallest motion of an input, as a share of its span
MOST_COUNTED_ROWS = 1e15  # largest number of missing rows that is stated


def missing_rows(record: Record) -> list[RecordFinding]:
    """Find gaps in time: a warning if an input moves during a gap, else a note."""
    steps = np.diff(record.time)
    usual = float(np.median(steps))
    even = float(np.mean(np.abs(steps - usual) < EVEN_SAMPLING_TOLERANCE * usual)) > 0.9
    uneven = max(UNEVEN_GAP * usual, 2.0 * float(np.percentile(steps, 98.0)))
    least = EVEN_GAP * usual if even else uneven
    gaps = np.flatnonzero(steps > least)
    if not gaps.size:
        return []
    moving = np.zeros(len(gaps), dtype=bool)
    for channel in record.inputs:
        span = float(np.ptp(channel.values))
        if span > 0.0:
            lowest, highest = _range_about(channel.values, gaps)
            moving |= highest - lowest > MOVING_INPUT_SHARE * span
    out = []
    for some, certainty, word in (
        (gaps[moving], Certainty.LIKELY, "while an input moves"),
        (gaps[~moving], Certainty.NOTED, ""),
    ):
        if some.size:
            out.append(_rows_finding(record, some, usual, certainty, word))
    return out


def _rows_finding(
    record: Record, gaps: np.ndarray, usual: float, certainty: Certainty, word: str
) -> RecordFinding:
    steps = np.diff(record.time)
    times = tuple((float(record.time[gap]), float(record.time[gap + 1])) for gap in gaps)
    rows = int(np.sum(np.round(np.minimum(steps[gaps], MOST_COUNTED_ROWS * usual) / usual) - 1))
    places = ", ".join(f"{time_span(begin, end, 4)}" for begin, end in times[:3])
    text = (
        f"{rows} {'row is' if rows == 1 else 'rows are'} missing "
        f"{word + ' ' if word else ''}({places}{' and so on' if len(times) > 3 else ''})"
    )
    likely = certainty is Certainty.LIKELY
    if record.inputs:
        text += "; the last input is kept there" + (", which may be wrong" if likely else "")
    remedy = (
        "give the parts before and after as segments, --from and --to in pairs" if likely else ""
    )
    numbers = {
        "rows": FindingQuantity(float(rows), "1"),
        "longest": FindingQuantity(float(np.max(steps[gaps])), "s"),
    }
    return RecordFinding("time", Kind.ROWS_MISSING, certainty, text, remedy, times, numbers)


def _range_about(values: np.ndarray, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the minimum and maximum of the two samples on either side of each gap."""
    at = np.clip(gaps[:, None] + np.arange(-1, 3)[None, :], 0, len(values) - 1)
    return np.min(values[at], axis=1), np.max(values[at], axis=1)


# ---- Runs of one value

FEWEST_REPEATS = 3  # fewest repeats in a row: fewer are harmless
CHANCE_OF_RUN = 1e-6  # probability of one such run in a record without fault
# fewest updates of a known period k: by chance all fall on one phase with probability k^-14
FEWEST_UPDATES = 15
LONGEST_PERIOD = 60  # longest period looked for, samples
ON_PHASE_SHARE = 0.97  # smallest share of the changes on one phase; missing rows shift the rest
FEWEST_STEP_BITS = 3.0  # smallest step in least bits that is not a flicker of the last digit
LARGEST_JITTER = 0.4  # largest deviation from an even clock, samples: rounding alone gives 0.3
# If half the differences of Gaussian noise exceed b bits, a repeat has probability 0.27/b; three to
# four times as many are a fault.
REPEAT_FACTOR = 1.0
# smallest share of the repeats that end with a step of several bits: a rest ends with one bit
ABRUPT_END_SHARE = 0.7
IRREGULAR_SHARE = 0.05  # smallest share of repeated samples at uneven updates
LONGEST_OUTPUT_LEAD = 0.5  # s, longest time by which one output moves before another (sensor lags)
FEWEST_MOTION_SIGMAS = 6.0  # smallest motion, in sigmas of the noise and in least bits
# smallest step of an input that a channel may respond to, as a share of its span
INPUT_STEP = 0.05
CATCH_UP_RATIO = 3.0  # smallest step at the end of a run, over the usual step


def held_samples(series: Series, count: int) -> RecordFinding | None:
    """Find sample and hold at a lower rate, with period and phase; the repeats are masked.

    The first sample of each run is the measurement. ``count``: rows of the record.
    """
    same = np.diff(series.values) == 0.0
    changes = np.flatnonzero(~same) + 1
    if len(changes) < FEWEST_UPDATES or np.count_nonzero(same) < FEWEST_UPDATES // 2:
        return None
    steps = np.diff(series.values)[changes - 1]
    bits = float(np.median(np.abs(steps))) / series.least_bit if series.least_bit else math.inf
    dense = bits >= FEWEST_STEP_BITS
    both_ways = min(np.mean(steps > 0), np.mean(steps < 0)) > 0.2
    if not (dense or both_ways):
        return None
    period = phase_period(changes, len(series.values))
    if period > 1 and len(changes) * period > 0.5 * len(series.values):
        phase = int(np.bincount(changes % period, minlength=period).argmax())
        repeats = np.ones(len(series.values), dtype=bool)
        repeats[phase::period] = False
        repeats[changes] = False
        if phase:
            repeats[0] = False  # the first value may be new
        return _held_finding(series, repeats, float(period), count)
    grid = FEWEST_STEP_BITS * series.least_bit
    leaves = np.abs(np.append(np.diff(series.values), 0.0))
    abrupt = [int(end - begin) for begin, end in runs_of(same) if leaves[end] > grid]
    if (
        not dense
        or np.mean(same) < max(IRREGULAR_SHARE, REPEAT_FACTOR / bits)
        or sum(abrupt) < ABRUPT_END_SHARE * np.count_nonzero(same)
    ):
        return None
    repeats = np.concatenate([[False], same])
    lengths = np.diff(changes)
    usual = lengths[lengths <= 3.0 * np.median(lengths)]
    mean = float(np.mean(usual))
    if mean > 1.15 and len(usual) > 0.9 * len(lengths) and _fits_even_clock(changes, mean):
        return _held_finding(series, repeats, mean, count)
    short = [length for length in abrupt if length <= 2 * max(1.0, mean)]
    repeated = max(IRREGULAR_SHARE, REPEAT_FACTOR / bits) * len(same)
    if len(short) >= FEWEST_UPDATES and sum(short) > repeated:
        return _held_finding(series, repeats, mean, count, regular=False)
    return None


def stuck(
    series: Series,
    others: Sequence[Series],
    inputs: Sequence[Series],
    count: int,
    taken: np.ndarray,
) -> RecordFinding | None:
    """Find longer runs of one value that only a fault explains, and mask all but their first
    sample.

    ``taken``: rows that are masked already. Exact zeros in a noisy channel are all masked.
    """
    same = np.diff(series.values) == 0.0
    runs = [
        (int(b), int(e))
        for b, e in runs_of(same)
        if e - b >= FEWEST_REPEATS and not np.any(taken[series.rows[b + 1 : e + 1]])
    ]
    chosen = [
        run
        for run in runs
        if _cannot_be_equal(series, others, *run) or _catches_up(series, inputs, *run)
    ]
    if not chosen:
        return None
    mask = np.zeros(count, dtype=bool)
    void = [run for run in chosen if series.values[run[0]] == 0.0 and series.noise > 0.0]
    for begin, end in chosen:
        mask[series.rows[begin + ((begin, end) not in void) : end + 1]] = True
    times = tuple((float(series.time[begin]), float(series.time[end])) for begin, end in chosen)
    longest = max(last - first for first, last in times)
    places = f"{len(times)} times, " if len(times) > 1 else ""
    what = "are exact zeros" if len(void) == len(chosen) else "repeat the one before exactly"
    text = f"is stuck {places}{_between(times)}: {int(np.count_nonzero(mask))} samples {what}"
    numbers = {
        "longest": FindingQuantity(longest, "s"),
        "runs": FindingQuantity(float(len(times)), "1"),
    }
    remedy = "see why the channel stood; cut the record there if much of a maneuver is lost"
    return RecordFinding(
        series.name, Kind.STUCK, Certainty.COSTS_INFORMATION, text, remedy, times, numbers, mask
    )


def _held_finding(
    series: Series, repeats: np.ndarray, period: float, count: int, *, regular: bool = True
) -> RecordFinding:
    step = float(np.median(np.diff(series.time)))
    mask = np.zeros(count, dtype=bool)
    mask[series.rows[repeats]] = True
    first = float(series.time[int(np.argmax(~repeats[1:])) + 1])
    often = (
        f"every {period:.3g} samples ({1.0 / (period * step):.3g} Hz)"
        if regular
        else f"irregularly, every {period:.2g} samples in the mean"
    )
    text = (
        f"is updated {often}, held between: {int(np.count_nonzero(mask))} of {len(series.values)} "
        "samples repeat an older one"
    )
    numbers = {
        "period": FindingQuantity(period * step, "s"),
        "samples": FindingQuantity(period, "1"),
        "phase": FindingQuantity(first - float(series.time[0]), "s"),
    }
    remedy = "leave cells empty where there is no new sample, or record the channel at its own rate"
    return RecordFinding(
        series.name, Kind.HELD, Certainty.COSTS_INFORMATION, text, remedy, (), numbers, mask
    )


def phase_period(changes: np.ndarray, count: int) -> int:
    """Return the longest period for which nearly all changes fall on one phase; 1 where there is
    none.
    """
    best = 1
    for period in range(2, min(LONGEST_PERIOD, count // FEWEST_UPDATES) + 1):
        if np.bincount(changes % period).max() >= ON_PHASE_SHARE * len(changes):
            best = period
    return best


def _fits_even_clock(changes: np.ndarray, mean: float) -> bool:
    """Return whether the changes fit an even clock of another rate, in blocks of a hundred."""
    scatter = []
    for begin in range(0, len(changes) - FEWEST_UPDATES + 1, 100):
        some = changes[begin : begin + 100]
        number = np.round((some - some[0]) / mean)
        if len(some) >= FEWEST_UPDATES:
            slope, level = np.polyfit(number, some, 1)
            scatter.append(float(np.std(some - slope * number - level)))
    return bool(scatter) and max(scatter) < LARGEST_JITTER * max(1.0, 0.3 * mean)


def _cannot_be_equal(series: Series, others: Sequence[Series], begin: int, end: int) -> bool:
    """Return whether neither noise nor rest can explain equal samples from ``begin`` to ``end``."""
    values, time = series.values, series.time
    if series.resolved and _others_change(others, time[begin], time[end]):
        # Twice the noise allows for its estimate: quantised noise is overestimated by up to 1.5.
        alike = (
            math.erf(series.least_bit / (series.noise * math.sqrt(2.0)))
            if series.least_bit
            else 0.0
        )
        if len(values) * alike ** (end - begin) < CHANCE_OF_RUN:
            return True
    leaves = abs(float(values[end + 1] - values[end])) if end + 1 < len(values) else math.inf
    elsewhere = np.concatenate([np.diff(values[: begin + 1]), np.diff(values[end:])])
    lively = len(elsewhere) >= FEWEST_UPDATES and float(np.mean(elsewhere == 0.0)) < 0.5
    return (
        lively
        and leaves > FEWEST_STEP_BITS * series.least_bit
        and time[end] - time[begin] > LONGEST_OUTPUT_LEAD
        and _another_moves(others, time[begin], time[end] - LONGEST_OUTPUT_LEAD)
    )


def _catches_up(series: Series, inputs: Sequence[Series], begin: int, end: int) -> bool:
    """Return whether a moving channel leaves its run with a step several times the usual one."""
    values = series.values
    if series.white or begin == 0 or end + 2 >= len(values):
        return False
    around = np.abs(np.diff(values[max(0, begin - 15) : end + 17]))
    usual = float(np.median(around[around > 0.0]))
    if (
        abs(float(values[end + 1] - values[end])) < CATCH_UP_RATIO * max(usual, series.least_bit)
        or usual <= series.least_bit
    ):
        return False
    for other in inputs:
        near = (other.time >= series.time[end - 2]) & (other.time <= series.time[end + 2])
        if (
            np.count_nonzero(near) > 2
            and float(np.max(np.abs(np.diff(other.values[near], 2)))) > INPUT_STEP * other.span
        ):
            return False
    return True


def _others_change(others: Sequence[Series], begin: float, end: float) -> bool:
    """Return whether another channel changes meanwhile, or none exists."""
    for other in others:
        inside = other.values[(other.time >= begin) & (other.time <= end)]
        if len(inside) > 1 and float(np.ptp(inside)) == 0.0:
            return False
    return True


def _another_moves(others: Sequence[Series], begin: float, end: float) -> bool:
    """Return whether another channel moves meanwhile by more than its noise and a tenth of its
    range.
    """
    for other in others:
        inside = other.values[(other.time >= begin) & (other.time <= end)]
        if len(inside) < 5:
            continue
        smooth = np.median(np.lib.stride_tricks.sliding_window_view(inside, 5), axis=1)
        if float(np.ptp(smooth)) > max(
            FEWEST_MOTION_SIGMAS * (other.noise + other.least_bit), 0.1 * other.span
        ):
            return True
    return False


def _between(times: Sequence[tuple[float, float]]) -> str:
    first = ", ".join(f"{time_span(begin, end, 4)}" for begin, end in times[:3])
    return f"from {first}{' and so on' if len(times) > 3 else ''}"


# ---- Interpolated channels

SINGLE_SHARE = 2e-7  # rounding of single precision, as a share of the largest value
# smallest median bend at updates over the rounding: white noise then looks straight at one sample
# in ten
BEND_TO_ROUNDING_RATIO = 8.0
STRAIGHT_ROUNDINGS = 4.0  # largest bend of a nearly straight sample, in roundings
LARGEST_NEARLY_STRAIGHT_SHARE = 0.05  # largest share of nearly straight samples: noise gives more
STRAIGHT_SAMPLE_SHARE = 0.3  # smallest share of straight samples at uneven updates
# smallest share of the bends on their phases; missing rows shift the rest
INTERPOLATED_ON_PHASE = 0.97
EVEN_STEP_TOLERANCE = 0.02  # largest deviation of an evenly sampled step, as a share
# share of the bends at changes of an input from which they are the vehicle's response
ANSWERED_BEND_SHARE = 0.9


@dataclass(frozen=True, eq=False)
class _Pattern:
    """Measured samples ``(n,)``, their mean spacing, and the interpolation of the others."""

    fresh: np.ndarray
    period: float
    curve: str


def interpolated(
    series: Series, count: int, inputs: Sequence[Series] = (), *, is_input: bool = False
) -> RecordFinding | None:
    """Find samples interpolated between updates of a lower rate, and mask them; in an input they
    are only noted.

    Updates must be at least two samples apart for straight lines (three if uneven), and four for
    cubics, on an even clock.
    """
    if len(series.values) < 2 * FEWEST_UPDATES:
        return None
    result = _straight(series, inputs) or _cubic(series, inputs)
    if result is None:
        return None
    step = float(np.median(np.diff(series.time)))
    filled = int(np.count_nonzero(~result.fresh))
    rate = f"measured every {result.period:.3g} samples ({1.0 / (result.period * step):.3g} Hz)"
    text = (
        f"is interpolated: {rate}, with {result.curve} between: {filled} of {len(series.values)} "
        "samples follow from their neighbours"
    )
    numbers = {
        "period": FindingQuantity(result.period * step, "s"),
        "samples": FindingQuantity(result.period, "1"),
    }
    if is_input:
        return RecordFinding(series.name, Kind.INTERPOLATED, Certainty.NOTED, text, "", (), numbers)
    mask = np.zeros(count, dtype=bool)
    mask[series.rows[~result.fresh]] = True
    remedy = "export the channel at the rate at which it was measured"
    return RecordFinding(
        series.name, Kind.INTERPOLATED, Certainty.COSTS_INFORMATION, text, remedy, (), numbers, mask
    )


def _rounding(series: Series) -> float:
    """Return the largest rounding error of a sample from its printed digits."""
    largest = float(np.max(np.abs(series.values)))
    return max(0.51 * exact_step(series.values), SINGLE_SHARE * largest)


def _straight(series: Series, inputs: Sequence[Series]) -> _Pattern | None:
    t, v = series.time, series.values
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    off, least = np.abs(v[1:-1] - (1.0 - share) * v[:-2] - share * v[2:]), 2.0 * _rounding(series)
    bent = off > least
    moves = np.abs(v[2:] - v[:-2])[~bent] > least
    if (
        not _is_bimodal(off, least, bent)
        or not moves.size
        or np.mean(moves) < 0.5
        or _bends_are_response(t[1:-1][bent], inputs)
    ):
        return None
    at = np.flatnonzero(bent) + 1
    period = phase_period(at, len(v))
    fresh = np.zeros(len(v), dtype=bool)
    if period > 1 and len(at) * period > 0.5 * len(v):
        fresh[int(np.bincount(at % period, minlength=period).argmax()) :: period] = True
        return _Pattern(fresh, float(period), "straight lines")
    pieces = runs_of(~bent)
    if np.mean(~bent) < STRAIGHT_SAMPLE_SHARE or len(pieces) < FEWEST_UPDATES:
        return None
    # Updates lie between rows: the first sample of each line is taken for them.
    fresh[[begin for begin, _ in pieces]] = True
    return _Pattern(fresh, len(v) / len(pieces), "straight lines")


def _cubic(series: Series, inputs: Sequence[Series]) -> _Pattern | None:
    steps = np.diff(series.time)
    if np.max(np.abs(steps - np.median(steps))) > EVEN_STEP_TOLERANCE * np.median(steps):
        return None
    off, least = np.abs(np.diff(series.values, 4)), 16.0 * _rounding(series)
    bent = off > least
    if not _is_bimodal(off, least, bent) or _bends_are_response(series.time[2:-2][bent], inputs):
        return None
    at = np.flatnonzero(bent) + 2
    # A fourth difference spans an update at three adjacent phases only.
    for period in range(min(LONGEST_PERIOD, len(off) // FEWEST_UPDATES), 3, -1):
        phases = np.bincount(at % period, minlength=period)
        around = phases + np.roll(phases, 1) + np.roll(phases, -1)
        phase = int(np.argmax(around))
        if around[phase] >= INTERPOLATED_ON_PHASE * len(at) and len(at) * period > 1.5 * len(off):
            fresh = np.zeros(len(series.values), dtype=bool)
            fresh[phase::period] = True
            return _Pattern(fresh, float(period), "cubics")
    return None


def _is_bimodal(off: np.ndarray, least: float, bent: np.ndarray) -> bool:
    """Return whether each sample is either straight or bent by far more than rounding."""
    if (
        np.count_nonzero(bent) < FEWEST_UPDATES
        or np.count_nonzero(~bent) < FEWEST_UPDATES
        or np.median(off[bent]) < BEND_TO_ROUNDING_RATIO * least
    ):
        return False
    return bool(np.mean(bent & (off < STRAIGHT_ROUNDINGS * least)) < LARGEST_NEARLY_STRAIGHT_SHARE)


def _bends_are_response(times: np.ndarray, inputs: Sequence[Series]) -> bool:
    """Return whether the bends coincide with changes of an input that is piecewise constant."""
    for other in inputs:
        changes = other.time[np.flatnonzero(np.diff(other.values))]
        if not changes.size or len(changes) > 0.7 * len(other.time):
            continue
        step = float(np.median(np.diff(other.time)))
        nearest = np.min(np.abs(times[:, None] - changes[None, :]), axis=1)
        if np.mean(nearest < 2.6 * step) > ANSWERED_BEND_SHARE and len(changes) < 2 * len(times):
            return True
    return False
