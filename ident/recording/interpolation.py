"""Search for channels that are interpolated between samples of a lower rate.

Between two measured samples, second differences (straight line) or fourth differences (cubic) are
zero to the last printed digit. At the measured samples they are not zero, because of the noise of
the sensor.
"""

from __future__ import annotations

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

# ---- Period of the updates of a channel

# Fewest updates that show a period of k samples: by chance all of them have one phase with the
# probability k^-14.
FEWEST_UPDATES = 15
LONGEST_PERIOD = 60  # samples
ON_PHASE_SHARE = 0.97  # smallest share of changes on one phase; missing rows shift the others


def phase_period(changes: np.ndarray, count: int) -> int:
    """Return the longest period, in samples, for which nearly all changes have the same phase; 1 if
    there is none.

    ``changes`` are the positions of samples that differ from the one before, among ``count``.
    """
    best = 1
    for period in range(2, min(LONGEST_PERIOD, count // FEWEST_UPDATES) + 1):
        if np.bincount(changes % period).max() >= ON_PHASE_SHARE * len(changes):
            best = period
    return best


# ---- Interpolated channels

SINGLE_PRECISION_SHARE = 2e-7  # rounding of single precision, as a share of the largest value
# A bend is the deviation of a sample from the curve through its neighbours. The median bend at
# updates, over the rounding, must be larger than this: with less noise one in ten looks straight.
BEND_TO_ROUNDING_RATIO = 8.0
STRAIGHT_ROUNDINGS = 4.0  # largest bend of a nearly straight sample, in roundings
LARGEST_NEARLY_STRAIGHT_SHARE = 0.05  # largest share of nearly straight samples: noise gives more
STRAIGHT_SAMPLE_SHARE = 0.3  # smallest share of straight samples at uneven updates
# smallest share of the bends on the phases of the updates; missing rows shift the others
INTERPOLATED_ON_PHASE = 0.97
EVEN_STEP_TOLERANCE = 0.02  # largest relative deviation of a step from the median step
# largest share of bends at changes of an input: more bends are a response of the vehicle
RESPONSE_BEND_SHARE = 0.9
RESPONSE_TIME = 2.6  # largest distance of a response from the change, in steps of the input


@dataclass(frozen=True, eq=False)
class _Pattern:
    """A pattern of interpolation.

    Attributes
    ----------
    measured : ``(n,)`` False for interpolated samples.
    period : mean distance of measured samples, in samples.
    curve : name of the curves between them.
    """

    measured: np.ndarray
    period: float
    curve: str


def interpolation_finding(
    series: Series, count: int, inputs: Sequence[Series] = (), *, is_input: bool = False
) -> RecordFinding | None:
    """Return the finding of samples that are interpolated between measured ones; else None.

    The finding masks the interpolated samples, except those of an input. Straight lines are found
    if measured samples are at least two samples apart, or three at uneven distances. Cubics are
    found if measured samples are at least four samples apart at even distances. ``count`` is the
    number of rows of the record.
    """
    if len(series.values) < 2 * FEWEST_UPDATES:
        return None
    pattern = _straight_lines(series, inputs) or _cubics(series, inputs)
    if pattern is None:
        return None
    step = float(np.median(np.diff(series.time)))
    filled = int(np.count_nonzero(~pattern.measured))
    rate = f"measured every {pattern.period:.3g} samples ({1.0 / (pattern.period * step):.3g} Hz)"
    text = (
        f"is interpolated: {rate}, with {pattern.curve} between: {filled} of {len(series.values)} "
        "samples follow from their neighbours"
    )
    numbers = {
        "period": FindingQuantity(pattern.period * step, "s"),
        "samples": FindingQuantity(pattern.period, "1"),
    }
    if is_input:
        return RecordFinding(series.name, Kind.INTERPOLATED, Certainty.NOTED, text, "", (), numbers)
    mask = np.zeros(count, dtype=bool)
    mask[series.rows[~pattern.measured]] = True
    remedy = "export the channel at the rate at which it was measured"
    return RecordFinding(
        series.name, Kind.INTERPOLATED, Certainty.COSTS_INFORMATION, text, remedy, (), numbers, mask
    )


def _rounding(series: Series) -> float:
    """Return the largest rounding error of a sample from its printed digits."""
    largest = float(np.max(np.abs(series.values)))
    return max(0.51 * exact_step(series.values), SINGLE_PRECISION_SHARE * largest)


def _straight_lines(series: Series, inputs: Sequence[Series]) -> _Pattern | None:
    """Return the pattern of straight lines between measured samples; None without it."""
    t, v = series.time, series.values
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    bends = np.abs(v[1:-1] - (1.0 - share) * v[:-2] - share * v[2:])
    rounding = 2.0 * _rounding(series)
    bent = bends > rounding
    moves = np.abs(v[2:] - v[:-2])[~bent] > rounding
    if (
        not _is_bimodal(bends, rounding, bent)
        or not moves.size
        or np.mean(moves) < 0.5
        or _bends_are_response(t[1:-1][bent], inputs)
    ):
        return None
    at = np.flatnonzero(bent) + 1
    period = phase_period(at, len(v))
    measured = np.zeros(len(v), dtype=bool)
    if period > 1 and len(at) * period > 0.5 * len(v):
        measured[int(np.bincount(at % period, minlength=period).argmax()) :: period] = True
        return _Pattern(measured, float(period), "straight lines")
    lines = runs_of(~bent)
    if np.mean(~bent) < STRAIGHT_SAMPLE_SHARE or len(lines) < FEWEST_UPDATES:
        return None
    # The measurements lie between rows: the first sample of each line counts as measured.
    measured[[begin for begin, _ in lines]] = True
    return _Pattern(measured, len(v) / len(lines), "straight lines")


def _cubics(series: Series, inputs: Sequence[Series]) -> _Pattern | None:
    """Return the pattern of cubics between measured samples; None without it."""
    steps = np.diff(series.time)
    if np.max(np.abs(steps - np.median(steps))) > EVEN_STEP_TOLERANCE * np.median(steps):
        return None
    bends, rounding = np.abs(np.diff(series.values, 4)), 16.0 * _rounding(series)
    bent = bends > rounding
    times = series.time[2:-2][bent]
    if not _is_bimodal(bends, rounding, bent) or _bends_are_response(times, inputs):
        return None
    at = np.flatnonzero(bent) + 2
    # Only fourth differences about a measured sample and its two neighbours contain a bend.
    for period in range(min(LONGEST_PERIOD, len(bends) // FEWEST_UPDATES), 3, -1):
        phases = np.bincount(at % period, minlength=period)
        around = phases + np.roll(phases, 1) + np.roll(phases, -1)
        phase = int(np.argmax(around))
        on_phase = around[phase] >= INTERPOLATED_ON_PHASE * len(at)
        if on_phase and len(at) * period > 1.5 * len(bends):
            measured = np.zeros(len(series.values), dtype=bool)
            measured[phase::period] = True
            return _Pattern(measured, float(period), "cubics")
    return None


def _is_bimodal(bends: np.ndarray, rounding: float, bent: np.ndarray) -> bool:
    """Return whether nearly every bend is either within the rounding or far above it. ``bent`` is
    True where a bend exceeds the rounding.
    """
    if (
        np.count_nonzero(bent) < FEWEST_UPDATES
        or np.count_nonzero(~bent) < FEWEST_UPDATES
        or np.median(bends[bent]) < BEND_TO_ROUNDING_RATIO * rounding
    ):
        return False
    nearly_straight = bent & (bends < STRAIGHT_ROUNDINGS * rounding)
    return bool(np.mean(nearly_straight) < LARGEST_NEARLY_STRAIGHT_SHARE)


def _bends_are_response(times: np.ndarray, inputs: Sequence[Series]) -> bool:
    """Return whether the ``times (B,)`` of bends, s, coincide with changes of an input that is
    piecewise constant.
    """
    for control in inputs:
        changes = control.time[np.flatnonzero(np.diff(control.values))]
        if not changes.size or len(changes) > 0.7 * len(control.time):
            continue
        step = float(np.median(np.diff(control.time)))
        distance = np.min(np.abs(times[:, None] - changes[None, :]), axis=1)
        response_share = np.mean(distance < RESPONSE_TIME * step)
        if response_share > RESPONSE_BEND_SHARE and len(changes) < 2 * len(times):
            return True
    return False
