"""Values that stand for no measurement: runs of exact zeros, and a fill value such as -999."""

from __future__ import annotations

import numpy as np

from ident.recording.finding import Certainty, Finding, Kind, Number
from ident.recording.series import Series, runs_of

FAR = 8.0  # standard deviations of the noise between a zero and its neighbours on both sides
BITS = 4.0
OF_SPAN = 0.1  # of the channel's span without the zeros
OUTSIDE = 5.0  # spans of all other samples, beyond which a value that comes twice is a fill value
BRIEF, FEW = 0.1, 5  # s and samples: no pilot's or computer's step to zero and back is as short


def dropouts(series: Series, count: int, *, is_input: bool = False) -> list[Finding]:
    """Zeros and fill values among samples that are elsewhere, masked; in an input, which must have no gap, a warning."""
    found = [("exact zeros", 0.0, _zeros(series))]
    fill, at = _fill(series)
    found.append((f"the fill value {fill:g}", fill, at))
    out = []
    for word, value, where in found:
        if not np.any(where):
            continue
        runs = runs_of(where)
        if is_input:
            runs = np.array([(b, e) for b, e in runs if e - b <= FEW and _lasts(series, b, e) <= BRIEF]).reshape(-1, 2)
            if not len(runs):
                continue
        out.append(_finding(series, runs, word, value, count, is_input=is_input))
    return out


def _finding(series: Series, runs: np.ndarray, word: str, value: float, count: int, *, is_input: bool) -> Finding:
    times = tuple((float(series.time[b]), float(series.time[e - 1])) for b, e in runs)
    samples = int(sum(e - b for b, e in runs))
    first = ", ".join(f"{begin:.4g} s" for begin, _ in times[:3])
    told = f"has {samples} sample(s) that are {word}, at {first}{' and so on' if len(times) > 3 else ''}, while it is elsewhere before and after"
    numbers = {"value": Number(value, series.unit), "samples": Number(float(samples), "1")}
    if is_input:
        return Finding(series.name, Kind.DROPOUT, Certainty.LIKELY, told, "fill the dropouts of an input, or cut the record there", times, numbers)
    mask = np.zeros(count, dtype=bool)
    for b, e in runs:
        mask[series.rows[b:e]] = True
    remedy = "leave cells empty where there is no measurement"
    return Finding(series.name, Kind.DROPOUT, Certainty.COSTS_INFORMATION, told, remedy, times, numbers, mask)


def _zeros(series: Series) -> np.ndarray:
    """Runs of exact zeros that stand off both neighbours, which are alike: no signal goes to zero and back in one step each way."""
    values = series.values
    where = np.zeros(len(values), dtype=bool)
    zero = values == 0.0
    if not np.any(zero) or np.all(zero):
        return where
    rest = values[~zero]
    least = max(FAR * series.noise, BITS * series.least_bit, OF_SPAN * float(np.ptp(rest)), 1e-300)
    for begin, end in runs_of(zero):
        if begin == 0 or end == len(values):
            continue
        before, after = float(values[begin - 1]), float(values[end])
        if min(abs(before), abs(after)) > least and before * after > 0.0 and _sudden(values, begin, end, least):
            where[begin:end] = True
    return where


def _sudden(values: np.ndarray, begin: int, end: int, least: float) -> bool:
    """Whether the channel was not on its way to zero: the step there is several of those before and after."""
    before = np.abs(np.diff(values[max(0, begin - 4) : begin]))
    after = np.abs(np.diff(values[end : end + 4]))
    usual = float(np.max(np.concatenate([before, after]))) if before.size + after.size else 0.0
    return min(abs(float(values[begin - 1])), abs(float(values[end]))) > max(3.0 * usual, least)


def _fill(series: Series) -> tuple[float, np.ndarray]:
    found = fill_value(series.values, series.noise)
    at = np.zeros(len(series.values), dtype=bool) if found is None else series.values == found
    return found or 0.0, at


def fill_value(values: np.ndarray, noise: float = 0.0) -> float | None:
    """The largest or smallest value where it comes twice at least and is far outside the range of all
    others, as -999 for no measurement; else None. ``noise``: standard deviation, in their unit."""
    for value in (float(np.max(values)), float(np.min(values))) if values.size else ():
        at = values == value
        rest = values[~at]
        if value == 0.0 or np.count_nonzero(at) < 2 or len(rest) < len(values) // 2:
            continue
        if float(np.min(np.abs(rest - value))) > OUTSIDE * max(float(np.ptp(rest)), 10.0 * noise) > 0.0:
            return value
    return None


def _lasts(series: Series, begin: int, end: int) -> float:
    return float(series.time[min(end, len(series.time) - 1)] - series.time[begin])
