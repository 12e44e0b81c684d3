"""Channels that a recorder or an exporter has interpolated: samples between two updates follow from their neighbours and measure nothing.

Between updates a straight line has no second difference and a cubic no fourth one, to the last printed digit; at the updates the noise of
the sensor bends them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.recording.finding import Certainty, Finding, Kind, Number
from ident.recording.repeats import SLOWEST, UPDATES, phase_period
from ident.recording.series import Series, exact_step, runs_of

SINGLE = 2e-7  # of the largest value: files of single precision round to that
BENT = 8.0  # times the rounding that the bends at updates reach in the middle: white noise then looks straight at one sample in ten
BETWEEN, FEW = 4.0, 0.05  # of all samples, which bend by one to four times the rounding: noise of any size leaves more than straight ones
STRAIGHT = 0.3  # share of straight samples where updates have no even clock
ON_PHASE = 0.97  # share of bends on their phases; lost rows shift the rest
EVEN = 0.02  # of the usual step, within which steps are even
ANSWERED = 0.9  # share of the bends at changes of an input: the vehicle answers these


@dataclass(frozen=True, eq=False)
class _Pattern:
    """Which samples ``(n,)`` were measured, every how many samples (mean), and by what the others were filled."""

    fresh: np.ndarray
    period: float
    curve: str


def interpolated(series: Series, count: int, inputs: Sequence[Series] = (), *, is_input: bool = False) -> Finding | None:
    """Interpolation between updates of a lower rate: the samples between are masked, of an input it is only noted.

    Straight lines are found from two samples an update on, also of uneven updates from three on; cubics from four on, on an even clock.
    """
    if len(series.values) < 2 * UPDATES:
        return None
    found = _straight(series, inputs) or _cubic(series, inputs)
    if found is None:
        return None
    step = float(np.median(np.diff(series.time)))
    filled = int(np.count_nonzero(~found.fresh))
    rate = f"measured every {found.period:.3g} samples ({1.0 / (found.period * step):.3g} Hz)"
    told = f"is interpolated: {rate}, with {found.curve} between: {filled} of {len(series.values)} samples follow from their neighbours"
    numbers = {"period": Number(found.period * step, "s"), "samples": Number(found.period, "1")}
    if is_input:
        return Finding(series.name, Kind.INTERPOLATED, Certainty.NOTED, told, "", (), numbers)
    mask = np.zeros(count, dtype=bool)
    mask[series.rows[~found.fresh]] = True
    remedy = "export the channel at the rate at which it was measured"
    return Finding(series.name, Kind.INTERPOLATED, Certainty.COSTS_INFORMATION, told, remedy, (), numbers, mask)


def _rounding(series: Series) -> float:
    """By how much a sample may be off for its digits."""
    return max(0.51 * exact_step(series.values), SINGLE * float(np.max(np.abs(series.values))))


def _straight(series: Series, inputs: Sequence[Series]) -> _Pattern | None:
    t, v = series.time, series.values
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    off, least = np.abs(v[1:-1] - (1.0 - share) * v[:-2] - share * v[2:]), 2.0 * _rounding(series)
    bent = off > least
    moves = np.abs(v[2:] - v[:-2])[~bent] > least
    if not _parted(off, least, bent) or not moves.size or np.mean(moves) < 0.5 or _answers(t[1:-1][bent], inputs):
        return None
    at = np.flatnonzero(bent) + 1
    period = phase_period(at, len(v))
    fresh = np.zeros(len(v), dtype=bool)
    if period > 1 and len(at) * period > 0.5 * len(v):
        fresh[int(np.bincount(at % period, minlength=period).argmax()) :: period] = True
        return _Pattern(fresh, float(period), "straight lines")
    pieces = runs_of(~bent)
    if np.mean(~bent) < STRAIGHT or len(pieces) < UPDATES:
        return None
    # Updates lie between two rows: of each line its first sample serves for the measurement beside it.
    fresh[[begin for begin, _ in pieces]] = True
    return _Pattern(fresh, len(v) / len(pieces), "straight lines")


def _cubic(series: Series, inputs: Sequence[Series]) -> _Pattern | None:
    steps = np.diff(series.time)
    if np.max(np.abs(steps - np.median(steps))) > EVEN * np.median(steps):
        return None
    off, least = np.abs(np.diff(series.values, 4)), 16.0 * _rounding(series)
    bent = off > least
    if not _parted(off, least, bent) or _answers(series.time[2:-2][bent], inputs):
        return None
    at = np.flatnonzero(bent) + 2
    # Five samples cross an update at three places, next to each other; they are inside one piece at the others.
    for period in range(min(SLOWEST, len(off) // UPDATES), 3, -1):
        phases = np.bincount(at % period, minlength=period)
        around = phases + np.roll(phases, 1) + np.roll(phases, -1)
        phase = int(np.argmax(around))
        if around[phase] >= ON_PHASE * len(at) and len(at) * period > 1.5 * len(off):
            fresh = np.zeros(len(series.values), dtype=bool)
            fresh[phase::period] = True
            return _Pattern(fresh, float(period), "cubics")
    return None


def _parted(off: np.ndarray, least: float, bent: np.ndarray) -> bool:
    """Whether samples are either straight or bent by far more than their digits round."""
    if np.count_nonzero(bent) < UPDATES or np.count_nonzero(~bent) < UPDATES or np.median(off[bent]) < BENT * least:
        return False
    return bool(np.mean(bent & (off < BETWEEN * least)) < FEW)


def _answers(times: np.ndarray, inputs: Sequence[Series]) -> bool:
    """Whether the bends come at the changes of an input that stands still between, as a motion without noise bends."""
    for other in inputs:
        changes = other.time[np.flatnonzero(np.diff(other.values))]
        if not changes.size or len(changes) > 0.7 * len(other.time):
            continue
        step = float(np.median(np.diff(other.time)))
        nearest = np.min(np.abs(times[:, None] - changes[None, :]), axis=1)
        if np.mean(nearest < 2.6 * step) > ANSWERED and len(changes) < 2 * len(times):
            return True
    return False
