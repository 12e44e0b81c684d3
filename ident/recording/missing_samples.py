"""Search for samples that are not measurements: dropouts, missing rows, held values.

A value may also repeat because the least bit is coarse or the channel is at rest. A run of one
value is a fault if the noise makes the run improbable while other channels change, if another
channel moves during the run, or if the value jumps at the end of the run.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.recording.distorted_channels import FEWEST_UPDATES, phase_period
from ident.recording.series import Certainty, Kind, RecordFinding, Series, quantities, runs_of
from sim.errors import instant, time_span
from sim.record import Record

# ---- Dropouts: runs of exact zeros, or of a fill value such as -999, that mark missing samples

ZERO_SIGMAS = 8.0  # smallest step to and from a zero, in sigmas of the noise
ZERO_BITS = 4.0  # smallest step to and from a zero, in least bits
ZERO_SPAN_SHARE = 0.1  # smallest step, as a share of the span of the other samples
SUDDEN_STEP_RATIO = 3.0  # smallest step, over the steps before and after it
FILL_VALUE_SPANS = 5.0  # smallest distance of a fill value, in spans of the other samples
FILL_VALUE_SIGMAS = 50.0  # smallest distance of a fill value, in sigmas of the noise
SHORTEST_PULSE = 0.1  # s: commanded steps of an input to zero and back are longer
MOST_ZEROS = 5  # most samples of a dropout of an input


def dropout_findings(series: Series, count: int, *, is_input: bool = False) -> list[RecordFinding]:
    """Return findings of zeros and fill values among other samples. They mask these samples.

    An input must have no gap: its dropouts are a warning and are not masked. ``count`` is the
    number of rows of the record.
    """
    candidates = [("exact zeros", 0.0, _zeros(series))]
    fill = fill_value(series.values, series.noise)
    if fill is not None:
        candidates.append((f"the fill value {fill:g}", fill, series.values == fill))
    findings = []
    for name, value, is_dropout in candidates:
        runs = runs_of(is_dropout)
        if is_input:
            is_short = [
                end - begin <= MOST_ZEROS and _duration(series, begin, end) <= SHORTEST_PULSE
                for begin, end in runs
            ]
            runs = runs[np.array(is_short, dtype=bool)]
        if len(runs):
            findings.append(_dropout_finding(series, runs, name, value, count, is_input=is_input))
    return findings


def _dropout_finding(
    series: Series, runs: np.ndarray, name: str, value: float, count: int, *, is_input: bool
) -> RecordFinding:
    """Return the finding of runs of one value, which ``name`` describes."""
    times = tuple((float(series.time[b]), float(series.time[e - 1])) for b, e in runs)
    samples = int(sum(e - b for b, e in runs))
    first = _first_three([f"{instant(begin)} s" for begin, _ in times])
    text = (
        f"has {samples} sample(s) that are {name}, at {first}, far from the samples before and "
        "after"
    )
    numbers = quantities(value=(value, series.unit), samples=float(samples))
    if is_input:
        remedy = "fill the dropouts of an input, or cut the record there"
        return RecordFinding(
            series.name, Kind.DROPOUT, Certainty.LIKELY, text, remedy, times, numbers
        )
    mask = np.zeros(count, dtype=bool)
    for b, e in runs:
        mask[series.rows[b:e]] = True
    remedy = "leave cells empty where there is no measurement"
    return RecordFinding(
        series.name, Kind.DROPOUT, Certainty.COSTS_INFORMATION, text, remedy, times, numbers, mask
    )


def _zeros(series: Series) -> np.ndarray:
    """Return whether each sample is in a run of zeros far from both neighbours of one sign."""
    values = series.values
    is_dropout = np.zeros(len(values), dtype=bool)
    zero = values == 0.0
    if not np.any(zero) or np.all(zero):
        return is_dropout
    noise = max(ZERO_SIGMAS * series.noise, ZERO_BITS * series.least_bit)
    least = max(noise, ZERO_SPAN_SHARE * float(np.ptp(values[~zero])), 1e-300)
    for begin, end in runs_of(zero):
        if begin == 0 or end == len(values):
            continue
        before, after = float(values[begin - 1]), float(values[end])
        if (
            min(abs(before), abs(after)) > least
            and before * after > 0.0
            and _is_sudden(values, begin, end, least)
        ):
            is_dropout[begin:end] = True
    return is_dropout


def _is_sudden(values: np.ndarray, begin: int, end: int, least: float) -> bool:
    """Return whether the steps to and from zero exceed ``least`` and the usual steps."""
    before = np.abs(np.diff(values[max(0, begin - 4) : begin]))
    after = np.abs(np.diff(values[end : end + 4]))
    usual = float(np.max(np.concatenate([before, after]))) if before.size + after.size else 0.0
    smaller_step = min(abs(float(values[begin - 1])), abs(float(values[end])))
    return smaller_step > max(SUDDEN_STEP_RATIO * usual, least)


def fill_value(values: np.ndarray, noise: float = 0.0) -> float | None:
    """Return the value that marks missing samples, such as -999; None without one.

    It is the largest or the smallest value, occurs at least twice, and is far outside the range of
    all other values. ``noise`` is the standard deviation, in the unit of the channel.
    """
    if not values.size:
        return None
    for value in (float(np.max(values)), float(np.min(values))):
        is_fill = values == value
        others = values[~is_fill]
        if value == 0.0 or np.count_nonzero(is_fill) < 2 or len(others) < len(values) // 2:
            continue
        least = max(FILL_VALUE_SPANS * float(np.ptp(others)), FILL_VALUE_SIGMAS * noise)
        if float(np.min(np.abs(others - value))) > least > 0.0:
            return value
    return None


def _duration(series: Series, begin: int, end: int) -> float:
    """Return the time, s, from sample ``begin`` to sample ``end``, or to the last one."""
    return float(series.time[min(end, len(series.time) - 1)] - series.time[begin])


# ---- Missing rows: gaps in time

# A record is evenly sampled if this share of the steps deviates less than the tolerance, relative
# to the median step.
EVEN_STEP_SHARE, EVEN_SAMPLING_TOLERANCE = 0.9, 0.05
EVEN_GAP = 1.6  # longest step of an even record without missing rows, in median steps
UNEVEN_GAP = 4.0  # the same for an uneven record
MOVING_INPUT_SHARE = 0.05  # smallest motion of an input, as a share of its span
MOST_COUNTED_ROWS = 1e15  # largest number of missing rows that is stated


def missing_rows_findings(record: Record) -> list[RecordFinding]:
    """Return a warning on the gaps in time during which an input moves, and a note on the other
    gaps.
    """
    steps = np.diff(record.time)
    step = float(np.median(steps))
    even_share = float(np.mean(np.abs(steps - step) < EVEN_SAMPLING_TOLERANCE * step))
    if even_share > EVEN_STEP_SHARE:
        longest = EVEN_GAP * step
    else:
        longest = max(UNEVEN_GAP * step, 2.0 * float(np.percentile(steps, 98.0)))
    gaps = np.flatnonzero(steps > longest)
    if not gaps.size:
        return []
    moving = np.zeros(len(gaps), dtype=bool)
    for channel in record.inputs:
        span = float(np.ptp(channel.values))
        if span > 0.0:
            # the two samples on either side of each gap
            rows = np.clip(gaps[:, None] + np.arange(-1, 3), 0, len(record) - 1)
            moving |= np.ptp(channel.values[rows], axis=1) > MOVING_INPUT_SHARE * span
    findings = []
    if np.any(moving):
        findings.append(_rows_finding(record, gaps[moving], step, input_moves=True))
    if not np.all(moving):
        findings.append(_rows_finding(record, gaps[~moving], step, input_moves=False))
    return findings


def _rows_finding(
    record: Record, gaps: np.ndarray, step: float, *, input_moves: bool
) -> RecordFinding:
    """Return the finding of missing rows after the rows ``gaps``, at the median ``step``, s."""
    steps = np.diff(record.time)
    times = tuple((float(record.time[gap]), float(record.time[gap + 1])) for gap in gaps)
    rows = int(np.sum(np.round(np.minimum(steps[gaps], MOST_COUNTED_ROWS * step) / step) - 1))
    places = _first_three([time_span(begin, end, 4) for begin, end in times])
    text = (
        f"{rows} {'row is' if rows == 1 else 'rows are'} missing "
        f"{'while an input moves ' if input_moves else ''}({places})"
    )
    if record.inputs:
        text += "; the last input is kept there" + (", which may be wrong" if input_moves else "")
    remedy = ""
    if input_moves:
        remedy = "give the parts before and after as segments, --from and --to in pairs"
    certainty = Certainty.LIKELY if input_moves else Certainty.NOTED
    numbers = quantities(rows=float(rows), longest=(float(np.max(steps[gaps])), "s"))
    return RecordFinding("time", Kind.ROWS_MISSING, certainty, text, remedy, times, numbers)


# ---- Runs of one value: sample and hold at a lower rate, and stuck channels

FEWEST_REPEATS = 3  # fewest repeats in a row of a stuck channel
FALSE_RUN_PROBABILITY = 1e-6  # probability that noise causes such a run in a record
FEWEST_STEP_BITS = 3.0  # smallest step, in least bits, that is no change of the last digit alone
LARGEST_JITTER = 0.4  # largest deviation from an even clock, samples: rounding alone gives 0.3
# smallest product of the share of repeats and the median step in least bits; Gaussian noise has
# 0.27
REPEAT_FACTOR = 1.0
# smallest share of repeats before a step of several bits: a channel at rest changes by one bit
ABRUPT_END_SHARE = 0.7
IRREGULAR_SHARE = 0.05  # smallest share of repeated samples at uneven updates
LONGEST_OUTPUT_LEAD = 0.5  # s, longest time by which one output moves before another (sensor lags)
FEWEST_MOTION_SIGMAS = 6.0  # smallest motion, in sigmas of the noise plus least bits
LEAST_MOTION_SHARE = 0.1  # smallest motion, as a share of the span of the channel
# smallest step of an input that a channel may respond to, as a share of its span
INPUT_STEP = 0.05
JUMP_RATIO = 3.0  # smallest step at the end of a run, over the usual step


def held_samples_finding(series: Series, count: int) -> RecordFinding | None:
    """Return the finding of a channel that holds each value until the next update, at a lower rate
    than that of the rows; else None.

    The first sample of each run is the measurement, and the finding masks the others. ``count`` is
    the number of rows of the record.
    """
    same = np.diff(series.values) == 0.0
    changes = np.flatnonzero(~same) + 1
    if len(changes) < FEWEST_UPDATES or np.count_nonzero(same) < FEWEST_UPDATES // 2:
        return None
    steps = np.diff(series.values)[changes - 1]
    bits = float(np.median(np.abs(steps))) / series.least_bit if series.least_bit else math.inf
    fine = bits >= FEWEST_STEP_BITS
    both_ways = min(np.mean(steps > 0), np.mean(steps < 0)) > 0.2
    if not (fine or both_ways):
        return None
    period = phase_period(changes, len(series.values))
    if period > 1 and len(changes) * period > 0.5 * len(series.values):
        phase = int(np.bincount(changes % period, minlength=period).argmax())
        repeats = np.ones(len(series.values), dtype=bool)
        repeats[phase::period] = False
        repeats[changes] = False
        if phase:
            repeats[0] = False  # the first sample may be an update
        return _held_finding(series, repeats, float(period), count)
    return _held_at_other_period(series, same, changes, bits, count) if fine else None


def _held_at_other_period(
    series: Series, same: np.ndarray, changes: np.ndarray, bits: float, count: int
) -> RecordFinding | None:
    """Return the finding of held values whose period is uneven or not an integer number of samples;
    None without it.

    Parameters
    ----------
    same : ``(N - 1,)`` whether a sample equals the one before.
    changes : positions of the other samples.
    bits : median size of a change, in least bits.
    """
    next_steps = np.abs(np.append(np.diff(series.values), 0.0))
    # lengths of the runs that end with a step of several bits
    abrupt = [
        int(end - begin)
        for begin, end in runs_of(same)
        if next_steps[end] > FEWEST_STEP_BITS * series.least_bit
    ]
    least_share = max(IRREGULAR_SHARE, REPEAT_FACTOR / bits)
    if np.mean(same) < least_share or sum(abrupt) < ABRUPT_END_SHARE * np.count_nonzero(same):
        return None
    repeats = np.concatenate([[False], same])
    intervals = np.diff(changes)
    usual = intervals[intervals <= 3.0 * np.median(intervals)]
    period = float(np.mean(usual))
    if period > 1.15 and len(usual) > 0.9 * len(intervals) and _fits_even_clock(changes, period):
        return _held_finding(series, repeats, period, count)
    short = [length for length in abrupt if length <= 2 * max(1.0, period)]
    if len(short) >= FEWEST_UPDATES and sum(short) > least_share * len(same):
        return _held_finding(series, repeats, period, count, regular=False)
    return None


def stuck_finding(
    series: Series,
    others: Sequence[Series],
    inputs: Sequence[Series],
    count: int,
    masked: np.ndarray,
) -> RecordFinding | None:
    """Return the finding of runs of one value that only a fault explains; else None.

    The finding masks all samples of a run but the first. It masks the first one too if the value is
    an exact zero in a noisy channel.

    Parameters
    ----------
    others : the other outputs.
    count : number of rows of the record.
    masked : ``(count,)`` True at rows that are masked already.
    """
    same = np.diff(series.values) == 0.0
    runs = [
        (int(b), int(e))
        for b, e in runs_of(same)
        if e - b >= FEWEST_REPEATS and not np.any(masked[series.rows[b + 1 : e + 1]])
    ]
    stuck_runs = [
        run
        for run in runs
        if _is_improbable(series, others, *run) or _jumps_at_end(series, inputs, *run)
    ]
    if not stuck_runs:
        return None
    mask = np.zeros(count, dtype=bool)
    zero_runs = [run for run in stuck_runs if series.values[run[0]] == 0.0 and series.noise > 0.0]
    for begin, end in stuck_runs:
        first = begin if (begin, end) in zero_runs else begin + 1
        mask[series.rows[first : end + 1]] = True
    times = tuple((float(series.time[begin]), float(series.time[end])) for begin, end in stuck_runs)
    longest = max(last - first for first, last in times)
    places = f"{len(times)} times, " if len(times) > 1 else ""
    all_zero = len(zero_runs) == len(stuck_runs)
    what = "are exact zeros" if all_zero else "repeat the one before exactly"
    spans = _first_three([time_span(begin, end, 4) for begin, end in times])
    text = f"is stuck {places}from {spans}: {int(np.count_nonzero(mask))} samples {what}"
    numbers = quantities(longest=(longest, "s"), runs=float(len(times)))
    remedy = "find out why it was stuck; cut the record there if much of a maneuver is lost"
    return RecordFinding(
        series.name, Kind.STUCK, Certainty.COSTS_INFORMATION, text, remedy, times, numbers, mask
    )


def _held_finding(
    series: Series, repeats: np.ndarray, period: float, count: int, *, regular: bool = True
) -> RecordFinding:
    """Return the finding of held values, which masks ``repeats (N,)``; ``period`` is in samples."""
    step = float(np.median(np.diff(series.time)))
    mask = np.zeros(count, dtype=bool)
    mask[series.rows[repeats]] = True
    first = float(series.time[int(np.argmax(~repeats[1:])) + 1])
    if regular:
        often = f"every {period:.3g} samples ({1.0 / (period * step):.3g} Hz)"
    else:
        often = f"irregularly, every {period:.2g} samples on average"
    text = (
        f"is updated {often} and held in between: {int(np.count_nonzero(mask))} of "
        f"{len(series.values)} samples repeat an older one"
    )
    numbers = quantities(
        period=(period * step, "s"), samples=period, phase=(first - float(series.time[0]), "s")
    )
    remedy = "leave cells empty where there is no new sample, or record the channel at its own rate"
    return RecordFinding(
        series.name, Kind.HELD, Certainty.COSTS_INFORMATION, text, remedy, (), numbers, mask
    )


def _fits_even_clock(changes: np.ndarray, period: float) -> bool:
    """Return whether changes are multiples of ``period`` samples, in each block of a hundred."""
    jitter = []
    for begin in range(0, len(changes) - FEWEST_UPDATES + 1, 100):
        block = changes[begin : begin + 100]
        number = np.round((block - block[0]) / period)
        if len(block) >= FEWEST_UPDATES:
            slope, level = np.polyfit(number, block, 1)
            jitter.append(float(np.std(block - slope * number - level)))
    return bool(jitter) and max(jitter) < LARGEST_JITTER * max(1.0, 0.3 * period)


def _is_improbable(series: Series, others: Sequence[Series], begin: int, end: int) -> bool:
    """Return whether neither noise nor a channel at rest explains the equal samples."""
    values, time = series.values, series.time
    if series.resolved and _all_others_change(others, time[begin], time[end]):
        # The probability of a repeat is computed for half the noise, to be safe: the estimate of
        # quantised noise is up to 1.5 times too large.
        repeat_probability = 0.0
        if series.least_bit:
            repeat_probability = math.erf(series.least_bit / (series.noise * math.sqrt(2.0)))
        if len(values) * repeat_probability ** (end - begin) < FALSE_RUN_PROBABILITY:
            return True
    next_step = abs(float(values[end + 1] - values[end])) if end + 1 < len(values) else math.inf
    other_steps = np.concatenate([np.diff(values[: begin + 1]), np.diff(values[end:])])
    changes_elsewhere = (
        len(other_steps) >= FEWEST_UPDATES and float(np.mean(other_steps == 0.0)) < 0.5
    )
    return (
        changes_elsewhere
        and next_step > FEWEST_STEP_BITS * series.least_bit
        and time[end] - time[begin] > LONGEST_OUTPUT_LEAD
        and _another_moves(others, time[begin], time[end] - LONGEST_OUTPUT_LEAD)
    )


def _jumps_at_end(series: Series, inputs: Sequence[Series], begin: int, end: int) -> bool:
    """Return whether a run ends with a step several times the usual one, while no input steps."""
    values = series.values
    if series.white or begin == 0 or end + 2 >= len(values):
        return False
    steps = np.abs(np.diff(values[max(0, begin - 15) : end + 17]))
    usual = float(np.median(steps[steps > 0.0]))
    next_step = abs(float(values[end + 1] - values[end]))
    if next_step < JUMP_RATIO * max(usual, series.least_bit) or usual <= series.least_bit:
        return False
    for control in inputs:
        near = (control.time >= series.time[end - 2]) & (control.time <= series.time[end + 2])
        if np.count_nonzero(near) > 2:
            largest_bend = float(np.max(np.abs(np.diff(control.values[near], 2))))
            if largest_bend > INPUT_STEP * control.span:
                return False
    return True


def _all_others_change(others: Sequence[Series], begin: float, end: float) -> bool:
    """Return whether no other channel keeps one value from time ``begin`` to ``end``, s."""
    for other in others:
        inside = other.values[(other.time >= begin) & (other.time <= end)]
        if len(inside) > 1 and float(np.ptp(inside)) == 0.0:
            return False
    return True


def _another_moves(others: Sequence[Series], begin: float, end: float) -> bool:
    """Return whether another channel moves from ``begin`` to ``end``, s, by a share of its span."""
    for other in others:
        inside = other.values[(other.time >= begin) & (other.time <= end)]
        if len(inside) < 5:
            continue
        smooth = np.median(np.lib.stride_tricks.sliding_window_view(inside, 5), axis=1)
        if float(np.ptp(smooth)) > max(
            FEWEST_MOTION_SIGMAS * (other.noise + other.least_bit), LEAST_MOTION_SHARE * other.span
        ):
            return True
    return False


def _first_three(texts: Sequence[str]) -> str:
    """Return the first three texts, and whether there are more."""
    return f"{', '.join(texts[:3])}{' and so on' if len(texts) > 3 else ''}"
