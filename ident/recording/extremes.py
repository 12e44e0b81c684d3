"""Flat extremes: a channel that does not go beyond a level, as at the end of its converter's range or of its travel."""

from __future__ import annotations

import math

import numpy as np

from ident.recording.finding import Certainty, Finding, Kind, Number, shown
from ident.recording.series import Series, runs_of

FEWEST = 4  # samples at the level
IN_A_ROW = 3
CHANCE = 1e-6
KINK = 6.0  # times the usual bend: the corner where a moving signal meets a level
SEVERAL_BITS = 3.0
BEYOND = 6.0  # standard deviations of the noise, from the channel's middle, so that it is a motion that is cut and not the noise
CONTINUOUS = 0.3  # share of samples of an input that differ from the one before: a commanded square is flat and no fault


def clipped(series: Series, count: int, *, is_input: bool = False) -> list[Finding]:
    """Levels at which a channel is flat, the samples there masked; of an input, where it is only noted: it may stand at its stop."""
    if is_input and np.mean(np.diff(series.values) != 0.0) < CONTINUOUS:
        return []
    out = []
    for sign in (1.0, -1.0):
        values = sign * series.values
        level = float(np.max(values))
        at = values == level
        runs = runs_of(at)
        # A run at either end of the record may be a rest.
        inside = [(b, e) for b, e in runs if b > 0 and e < len(values)]
        if np.count_nonzero(at) < FEWEST or not inside or max(e - b for b, e in inside) < IN_A_ROW:
            continue
        if _piles_up(series, values, level, at) or any(_cornered(series, values, b, e) for b, e in inside):
            out.append(_finding(series, at, sign * level, "highest" if sign > 0 else "lowest", count, is_input=is_input))
    return out


def _piles_up(series: Series, values: np.ndarray, level: float, at: np.ndarray) -> bool:
    """More samples at the level than noise leaves there, whose density falls towards an extreme."""
    if not series.resolved or level - float(np.median(values)) < BEYOND * series.noise:
        return False
    width = max(series.least_bit, 0.25 * series.noise)
    below = np.count_nonzero((values < level) & (values >= level - 3.5 * width))
    per_level = below / 3.0 * (min(1.0, series.least_bit / width) if series.least_bit else 1e-6)
    return _poisson_tail(int(np.count_nonzero(at)), 2.0 * per_level + 0.5) < CHANCE


def _cornered(series: Series, values: np.ndarray, begin: int, end: int) -> bool:
    """Whether a moving signal meets the level at a corner on both sides."""
    if end - begin < IN_A_ROW or begin < 3 or end + 3 > len(values):
        return False
    around = np.concatenate([values[max(0, begin - 8) : begin], values[end : end + 8]])
    before, behind = values[max(0, begin - 8) : begin], values[end : end + 8]
    bends = np.concatenate([np.abs(np.diff(before, 2)), np.abs(np.diff(behind, 2))])
    usual = float(np.median(bends)) if bends.size else math.inf
    # The level cuts the slope at some place between two samples: the slope beside it is the one further out.
    slopes = abs(float(values[begin - 1] - values[begin - 2])), abs(float(values[end + 1] - values[end]))
    return len(around) > 8 and min(slopes) > max(KINK * usual, SEVERAL_BITS * series.least_bit, KINK * series.noise)


def _finding(series: Series, at: np.ndarray, level: float, word: str, count: int, *, is_input: bool) -> Finding:
    runs = runs_of(at)
    times = tuple((float(series.time[b]), float(series.time[e - 1])) for b, e in runs if e - b > 1)
    numbers = {"level": Number(level, series.unit)}
    told = f"flat at its {word} value, {shown(level, series.unit)}, for {int(np.count_nonzero(at))} samples"
    if is_input:
        said = f"is {told}: at its stop, or clipped by the recorder"
        return Finding(series.name, Kind.CLIPPED, Certainty.NOTED, said, "say which, if you know: a stop is felt by the vehicle", times, numbers)
    mask = np.zeros(count, dtype=bool)
    mask[series.rows[at]] = True
    remedy = "widen the channel's range, or fly a smaller maneuver"
    return Finding(series.name, Kind.CLIPPED, Certainty.COSTS_INFORMATION, f"is clipped: {told}", remedy, times, numbers, mask)


def _poisson_tail(count: int, mean: float) -> float:
    """Probability of ``count`` or more."""
    if count > 50.0 + 10.0 * mean:
        return 0.0
    below = sum(math.exp(k * math.log(mean) - mean - math.lgamma(k + 1)) for k in range(count))
    return max(0.0, 1.0 - below)
