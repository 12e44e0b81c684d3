"""Turns, pull-ups and trim points, from the motion of the aircraft."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from ident.maneuver_detection.shapes import Lobe, lobes_of
from ident.maneuver_detection.signals import Maneuver, Stretch, trim_of

BANK = math.radians(12.0)  # a smaller one is no turn
LEVEL = 0.25  # of the bank, at which a turn begins and ends
HELD = 8.0  # s, for which the bank is held to a fifth of itself
HELD_SHARE = 0.5  # of a turn, for which at least the bank is held
PULL = 0.25  # g about that of the bank, which a pull-up exceeds
PULL_TIME = 1.2  # s, for which half of it lasts
SMOOTH = 0.5  # s, over which motion is averaged
TRIM_TIME = 10.0  # s, of the shortest trim point
# Spread of 1 s averages within TRIM_TIME that a trim point may have; of the airspeed as a share.
TRIM_SPREAD = {
    "airspeed": 0.025,
    "height": 8.0,
    "altitude": 8.0,
    "theta": math.radians(1.5),
    "phi": math.radians(4.0),
}


def turns(stretch: Stretch) -> list[Maneuver]:
    """Parts in which the bank is held."""
    if "phi" not in stretch.outputs:
        return []
    bank = uniform_filter1d(stretch.outputs["phi"], stretch.samples(SMOOTH), mode="nearest")
    out = []
    for lobe in lobes_of(bank, BANK, join=False):
        inside = bank[lobe.first : lobe.last]
        middle = float(np.median(inside))
        if np.count_nonzero(np.abs(inside - middle) < 0.2 * abs(middle)) * stretch.step < HELD:
            continue
        first, last = _to_level(bank * math.copysign(1.0, middle), lobe, LEVEL * abs(middle))
        if np.count_nonzero(np.abs(bank[first:last] - middle) < 0.2 * abs(middle)) * stretch.step > HELD_SHARE * (last - first) * stretch.step:
            out.append(
                Maneuver(
                    float(stretch.time[first]),
                    float(stretch.time[last]),
                    "roll",
                    "turn",
                    "phi",
                    abs(middle),
                )
            )
    return out


def _to_level(signal: np.ndarray, lobe: Lobe, level: float) -> tuple[int, int]:
    """The samples before and after a positive lobe at which the signal is below ``level``; the ends of the signal where it never is."""
    before = np.flatnonzero(signal[: lobe.first] < level)
    after = np.flatnonzero(signal[lobe.last :] < level)
    return int(before[-1]) if before.size else 0, lobe.last + int(after[0]) if after.size else signal.size - 1


def pulls(stretch: Stretch) -> list[tuple[int, int]]:
    """Parts in which the load factor stays away from that of the bank: first sample, and the one after the last."""
    if "nz" not in stretch.outputs:
        return []
    steady = 1.0
    if "phi" in stretch.outputs:
        steady = 1.0 / np.maximum(np.cos(stretch.outputs["phi"]), 0.2)
    excess = uniform_filter1d(stretch.outputs["nz"] - steady, stretch.samples(SMOOTH), mode="nearest")
    excess = excess - trim_of(stretch, excess)
    out = []
    for lobe in lobes_of(excess, PULL, join=False):
        inside = np.abs(excess[lobe.first : lobe.last])
        if np.count_nonzero(inside > 0.5 * inside.max()) * stretch.step >= PULL_TIME:
            out.append((lobe.first, lobe.last))
    return out


def trim_points(stretch: Stretch, quiet: np.ndarray, controls: Mapping[str, np.ndarray]) -> list[Maneuver]:
    """Parts of at least ``TRIM_TIME`` in which the inputs are quiet (``(N,)``) and speed, height, attitude and controls are constant.

    ``controls`` : by how much the averages over 1 s of each may change meanwhile, ``(N,)``, in its unit.
    """
    size = stretch.samples(TRIM_TIME)
    steady = quiet.copy()
    looked = [(name, stretch.outputs[name], spread) for name, spread in TRIM_SPREAD.items() if name in stretch.outputs]
    for name, values, spread in [*looked, *((name, stretch.inputs[name], spread) for name, spread in controls.items())]:
        smooth = uniform_filter1d(values, stretch.samples(1.0), mode="nearest")
        allowed = spread * np.abs(smooth) if name == "airspeed" else spread
        around = maximum_filter1d(smooth, size, mode="nearest") - minimum_filter1d(smooth, size, mode="nearest")
        steady &= around <= allowed
    # Each steady sample is the middle of a steady window; between two of them it stays steady.
    edges = np.flatnonzero(np.diff(steady.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    out: list[Maneuver] = []
    for first, last in edges:
        low, high = max(0, first - size // 2), min(quiet.size, last + size // 2)
        while low < first and not quiet[low:first].all():
            low += 1 + int(np.flatnonzero(~quiet[low:first])[-1])
        loud = np.flatnonzero(~quiet[last:high])
        high = last + int(loud[0]) if loud.size else high
        if (high - low) * stretch.step >= TRIM_TIME:
            if out and stretch.time[low] <= out[-1].end:
                low = int(np.searchsorted(stretch.time, out.pop().start))
            out.append(Maneuver(float(stretch.time[low]), float(stretch.time[high - 1]), "all", "trim", "", 0.0))
    return out


def mean_conditions(stretch: Stretch, start: float, end: float) -> dict[str, float]:
    """Mean airspeed and height between two times, of what is recorded."""
    rows = stretch.rows(start, end)
    names: Sequence[tuple[str, str]] = (
        ("airspeed", "airspeed"),
        ("altitude", "height"),
        ("height", "height"),
    )
    return {shown: float(np.mean(stretch.outputs[name][rows])) for name, shown in names if name in stretch.outputs}
