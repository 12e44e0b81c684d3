"""Runs of one value: a channel that is updated at a lower rate than it is written (sample and hold), or stuck for a while.

An exact repeat is no fault where the least bit is coarse against the noise, or where the channel rests. So a run counts only if the channel's
own noise forbids it while other channels are alive, if another channel moves meanwhile, or if the value catches up at its end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.recording.finding import Certainty, Finding, Kind, Number
from ident.recording.series import Series, runs_of

SHORTEST = 3  # repeats in a row: fewer cost nothing worth a word
CHANCE = 1e-6  # of one such run in a record by chance
UPDATES = 15  # updates without which no period is known; k^-14 is the chance that all of them fall on one phase of k
SLOWEST = 60  # samples of the longest period looked for
ON_PHASE = 0.97  # share of changes on one phase; the rest are lost rows
SEVERAL_BITS = 3.0  # least bits, beyond which a step is no flicker of the last digit
JITTER = 0.4  # samples of scatter about an even clock of any period: rounding alone gives 0.3
# Differences of Gaussian noise, half of which exceed b bits, repeat with probability 0.27/b; three to four times as much is no chance.
OFTEN = 1.0
ABRUPT = 0.7  # share of the repeats that end with a step of several bits: those of a rest end with one
IRREGULAR = 0.05  # share of samples that repeat, from which updates that come anyhow are told
LEAD = 0.5  # s, by which one output may move before another: delays and lags of sensors
MOVES = 6.0  # standard deviations of the noise and least bits that a motion exceeds
INPUT_STEPS = 0.05  # of an input's span, from which its step may be what the channel answers
CATCHES_UP = 3.0  # times the usual step


def held(series: Series, count: int) -> Finding | None:
    """Sample and hold at a lower rate: period and phase, the repeats masked; the first sample of each run is the fresh one. ``count`` rows in all."""
    same = np.diff(series.values) == 0.0
    changes = np.flatnonzero(~same) + 1
    if len(changes) < UPDATES or np.count_nonzero(same) < UPDATES // 2:
        return None
    steps = np.diff(series.values)[changes - 1]
    bits = float(np.median(np.abs(steps))) / series.least_bit if series.least_bit else math.inf
    dense = bits >= SEVERAL_BITS
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
            repeats[0] = False  # the first value of the record: not known to be old
        return _held(series, repeats, float(period), count)
    grid = SEVERAL_BITS * series.least_bit
    leaves = np.abs(np.append(np.diff(series.values), 0.0))
    abrupt = [int(end - begin) for begin, end in runs_of(same) if leaves[end] > grid]
    if not dense or np.mean(same) < max(IRREGULAR, OFTEN / bits) or sum(abrupt) < ABRUPT * np.count_nonzero(same):
        return None
    repeats = np.concatenate([[False], same])
    lengths = np.diff(changes)
    usual = lengths[lengths <= 3.0 * np.median(lengths)]
    mean = float(np.mean(usual))
    if mean > 1.15 and len(usual) > 0.9 * len(lengths) and _even(changes, mean):
        return _held(series, repeats, mean, count)
    short = [length for length in abrupt if length <= 2 * max(1.0, mean)]
    if len(short) >= UPDATES and sum(short) > max(IRREGULAR, OFTEN / bits) * len(same):
        return _held(series, repeats, mean, count, regular=False)
    return None


def stuck(series: Series, others: Sequence[Series], inputs: Sequence[Series], count: int, taken: np.ndarray) -> Finding | None:
    """Longer runs of one value that nothing but a fault explains, masked but for their first sample. ``taken``: rows that are masked already.

    The first sample of a run is a measurement, but for exact zeros in a channel that has noise: those stand for none at all.
    """
    same = np.diff(series.values) == 0.0
    runs = [(int(b), int(e)) for b, e in runs_of(same) if e - b >= SHORTEST and not np.any(taken[series.rows[b + 1 : e + 1]])]
    chosen = [run for run in runs if _impossible(series, others, *run) or _catches_up(series, inputs, *run)]
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
    told = f"is stuck {places}{_between(times)}: {int(np.count_nonzero(mask))} samples {what}"
    numbers = {"longest": Number(longest, "s"), "runs": Number(float(len(times)), "1")}
    remedy = "see why the channel stood; cut the record there if much of a maneuver is lost"
    return Finding(series.name, Kind.STUCK, Certainty.COSTS_INFORMATION, told, remedy, times, numbers, mask)


def _held(series: Series, repeats: np.ndarray, period: float, count: int, *, regular: bool = True) -> Finding:
    step = float(np.median(np.diff(series.time)))
    mask = np.zeros(count, dtype=bool)
    mask[series.rows[repeats]] = True
    first = float(series.time[int(np.argmax(~repeats[1:])) + 1])
    often = f"every {period:.3g} samples ({1.0 / (period * step):.3g} Hz)" if regular else f"irregularly, every {period:.2g} samples in the mean"
    told = f"is updated {often}, held between: {int(np.count_nonzero(mask))} of {len(series.values)} samples repeat an older one"
    numbers = {"period": Number(period * step, "s"), "samples": Number(period, "1"), "phase": Number(first - float(series.time[0]), "s")}
    remedy = "leave cells empty where there is no new sample, or record the channel at its own rate"
    return Finding(series.name, Kind.HELD, Certainty.COSTS_INFORMATION, told, remedy, (), numbers, mask)


def phase_period(changes: np.ndarray, count: int) -> int:
    """The longest period on one phase of which nearly all changes fall; 1 where there is none."""
    best = 1
    for period in range(2, min(SLOWEST, count // UPDATES) + 1):
        if np.bincount(changes % period).max() >= ON_PHASE * len(changes):
            best = period
    return best


def _even(changes: np.ndarray, mean: float) -> bool:
    """Whether changes come as from an even clock of another rate, stretch by stretch of a hundred."""
    scatter = []
    for begin in range(0, len(changes) - UPDATES + 1, 100):
        some = changes[begin : begin + 100]
        number = np.round((some - some[0]) / mean)
        if len(some) >= UPDATES:
            slope, level = np.polyfit(number, some, 1)
            scatter.append(float(np.std(some - slope * number - level)))
    return bool(scatter) and max(scatter) < JITTER * max(1.0, 0.3 * mean)


def _impossible(series: Series, others: Sequence[Series], begin: int, end: int) -> bool:
    """Whether the samples from ``begin`` to ``end`` cannot all be alike by noise, or by rest."""
    values, time = series.values, series.time
    if series.resolved and _alive(others, time[begin], time[end]):
        # Twice the noise forgives its estimate: quantised noise is measured up to a factor of 1.5 too large.
        alike = math.erf(series.least_bit / (series.noise * math.sqrt(2.0))) if series.least_bit else 0.0
        if len(values) * alike ** (end - begin) < CHANCE:
            return True
    leaves = abs(float(values[end + 1] - values[end])) if end + 1 < len(values) else math.inf
    elsewhere = np.concatenate([np.diff(values[: begin + 1]), np.diff(values[end:])])
    lively = len(elsewhere) >= UPDATES and float(np.mean(elsewhere == 0.0)) < 0.5
    return lively and leaves > SEVERAL_BITS * series.least_bit and time[end] - time[begin] > LEAD and _moving(others, time[begin], time[end] - LEAD)


def _catches_up(series: Series, inputs: Sequence[Series], begin: int, end: int) -> bool:
    """Whether a moving channel leaves its run with a step several times its usual one, which no input makes there."""
    values = series.values
    if series.white or begin == 0 or end + 2 >= len(values):
        return False
    around = np.abs(np.diff(values[max(0, begin - 15) : end + 17]))
    usual = float(np.median(around[around > 0.0]))
    if abs(float(values[end + 1] - values[end])) < CATCHES_UP * max(usual, series.least_bit) or usual <= series.least_bit:
        return False
    for other in inputs:
        near = (other.time >= series.time[end - 2]) & (other.time <= series.time[end + 2])
        if np.count_nonzero(near) > 2 and float(np.max(np.abs(np.diff(other.values[near], 2)))) > INPUT_STEPS * other.span:
            return False
    return True


def _alive(others: Sequence[Series], begin: float, end: float) -> bool:
    """Whether no other channel stands still as well, or there is none."""
    for other in others:
        inside = other.values[(other.time >= begin) & (other.time <= end)]
        if len(inside) > 1 and float(np.ptp(inside)) == 0.0:
            return False
    return True


def _moving(others: Sequence[Series], begin: float, end: float) -> bool:
    """Whether another channel moves in that time, by more than its noise and by a tenth of all that it ever moves."""
    for other in others:
        inside = other.values[(other.time >= begin) & (other.time <= end)]
        if len(inside) < 5:
            continue
        smooth = np.median(np.lib.stride_tricks.sliding_window_view(inside, 5), axis=1)
        if float(np.ptp(smooth)) > max(MOVES * (other.noise + other.least_bit), 0.1 * other.span):
            return True
    return False


def _between(times: Sequence[tuple[float, float]]) -> str:
    first = ", ".join(f"{begin:.4g} to {end:.4g} s" for begin, end in times[:3])
    return f"from {first}{' and so on' if len(times) > 3 else ''}"
