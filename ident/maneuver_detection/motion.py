"""Turns, pull-ups and trim points, from the motion of the aircraft."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from ident.maneuver_detection.shapes import Lobe, Shape, lobes_of
from ident.maneuver_detection.signals import DetectedManeuver, EvenSegment, trim_of

ALL_AXES = "all"  # axis of a trim point
LEAST_TURN_BANK = math.radians(12.0)  # smallest bank angle of a turn
TURN_EDGE_SHARE = 0.25  # bank at which a turn begins and ends, relative to its median bank
HELD_BANK_TIME = 8.0  # s, shortest time for which the bank is within a fifth of its median
LEAST_HELD_SHARE = 0.5  # smallest share of a turn with constant bank
PULL_UP_LOAD = 0.25  # g, smallest load factor of a pull-up beyond that of the bank
PULL_UP_TIME = 1.2  # s, shortest time above half of the largest load factor
MOTION_AVERAGING_TIME = 0.5  # s, time over which motion is averaged
SHORTEST_TRIM = 10.0  # s, shortest trim point
# Largest change of 1 s averages within SHORTEST_TRIM in a trim point; that of the airspeed is
# relative.
TRIM_SPREAD = {
    "airspeed": 0.025,
    "height": 8.0,
    "altitude": 8.0,
    "theta": math.radians(1.5),
    "phi": math.radians(4.0),
}


def turns(stretch: EvenSegment) -> list[DetectedManeuver]:
    """Return the turns: parts of a segment in which the bank angle is held."""
    if "phi" not in stretch.outputs:
        return []
    averaged = stretch.samples(MOTION_AVERAGING_TIME)
    bank = uniform_filter1d(stretch.outputs["phi"], averaged, mode="nearest")
    result = []
    for lobe in lobes_of(bank, LEAST_TURN_BANK, join=False):
        middle = float(np.median(bank[lobe.first : lobe.last]))
        held = np.abs(bank - middle) < 0.2 * abs(middle)
        if np.count_nonzero(held[lobe.first : lobe.last]) * stretch.step < HELD_BANK_TIME:
            continue
        first, last = _extended_to_level(
            bank * math.copysign(1.0, middle), lobe, TURN_EDGE_SHARE * abs(middle)
        )
        held_time = np.count_nonzero(held[first:last]) * stretch.step
        if held_time > LEAST_HELD_SHARE * (last - first) * stretch.step:
            result.append(
                maneuver_of(stretch, Shape("turn", first, last, abs(middle)), "roll", "phi")
            )
    return result


def maneuver_of(
    stretch: EvenSegment, shape: Shape, axis: str, channel: str = ""
) -> DetectedManeuver:
    """Return the maneuver whose shape is that of an input, of a bank angle or of a quiet part."""
    start, end = (
        float(stretch.time[min(k, stretch.time.size - 1)]) for k in (shape.first, shape.last)
    )
    return DetectedManeuver(start, end, axis, shape.kind, channel, shape.amplitude)


def _extended_to_level(signal: np.ndarray, lobe: Lobe, level: float) -> tuple[int, int]:
    """Return the samples before and after a positive lobe at which the signal is below ``level``;
    the ends of the signal where it never is.
    """
    before = np.flatnonzero(signal[: lobe.first] < level)
    after = np.flatnonzero(signal[lobe.last :] < level)
    return int(before[-1]) if before.size else 0, lobe.last + int(
        after[0]
    ) if after.size else signal.size - 1


def load_factor_excursions(stretch: EvenSegment) -> list[tuple[int, int]]:
    """Return the parts in which the load factor differs from that of the bank angle for some time:
    the first sample of each, and the one after the last.
    """
    if "nz" not in stretch.outputs:
        return []
    steady = 1.0
    if "phi" in stretch.outputs:
        steady = 1.0 / np.maximum(np.cos(stretch.outputs["phi"]), 0.2)
    averaged = stretch.samples(MOTION_AVERAGING_TIME)
    excess = uniform_filter1d(stretch.outputs["nz"] - steady, averaged, mode="nearest")
    excess = excess - trim_of(stretch, excess)
    result = []
    for lobe in lobes_of(excess, PULL_UP_LOAD, join=False):
        inside = np.abs(excess[lobe.first : lobe.last])
        if np.count_nonzero(inside > 0.5 * inside.max()) * stretch.step >= PULL_UP_TIME:
            result.append((lobe.first, lobe.last))
    return result


def trim_points(
    stretch: EvenSegment, quiet: np.ndarray, controls: Mapping[str, np.ndarray]
) -> list[DetectedManeuver]:
    """Return the trim points: parts of at least ``SHORTEST_TRIM`` in which inputs are quiet, and
    airspeed, height, attitude and controls are constant.

    Parameters
    ----------
    quiet : ``(N,)`` True at samples without activity of a control.
    controls : control -> ``(N,)`` largest change of its 1 s averages, in the unit of the control.
    """
    size = stretch.samples(SHORTEST_TRIM)
    steady = quiet.copy()
    spreads: dict[str, float | np.ndarray] = {
        name: spread for name, spread in TRIM_SPREAD.items() if name in stretch.outputs
    }
    for name, spread in (*spreads.items(), *controls.items()):
        values = (stretch.inputs if name in controls else stretch.outputs)[name]
        smooth = uniform_filter1d(values, stretch.samples(1.0), mode="nearest")
        allowed = spread * np.abs(smooth) if name == "airspeed" else spread
        around = maximum_filter1d(smooth, size, mode="nearest") - minimum_filter1d(
            smooth, size, mode="nearest"
        )
        steady &= around <= allowed
    # Each steady sample is the middle of a steady window: a run extends by half a window.
    result: list[DetectedManeuver] = []
    for first, last in runs_of(steady):
        low, high = max(0, first - size // 2), min(quiet.size, last + size // 2)
        while low < first and not quiet[low:first].all():
            low += 1 + int(np.flatnonzero(~quiet[low:first])[-1])
        not_quiet = np.flatnonzero(~quiet[last:high])
        high = last + int(not_quiet[0]) if not_quiet.size else high
        if (high - low) * stretch.step >= SHORTEST_TRIM:
            if result and stretch.time[low] <= result[-1].end:
                low = int(np.searchsorted(stretch.time, result.pop().start))
            result.append(maneuver_of(stretch, Shape("trim", low, high - 1, 0.0), ALL_AXES))
    return result


def runs_of(mask: np.ndarray) -> np.ndarray:
    """Return the first sample of each run of True, and the one after the last, ``(K, 2)``."""
    return np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)


def mean_conditions(stretch: EvenSegment, start: float, end: float) -> dict[str, float]:
    """Return the mean ``"airspeed"`` and ``"height"`` between two times, s, if recorded."""
    rows = stretch.rows(start, end)
    conditions = {"airspeed": "airspeed", "altitude": "height", "height": "height"}
    return {
        condition: float(np.mean(stretch.outputs[name][rows]))
        for name, condition in conditions.items()
        if name in stretch.outputs
    }
