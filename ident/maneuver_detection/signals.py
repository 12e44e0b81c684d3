"""Signals of a long record on an even grid, and the detected maneuvers."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import median_filter, percentile_filter, uniform_filter1d

# control -> axis that it moves; all controls of an axis are searched
AXES: Mapping[str, str] = {
    "elevator": "pitch",
    "stick": "pitch",
    "aileron": "roll",
    "rudder": "yaw",
    "thrust": "throttle",
    "roll_command": "roll",
    "pitch_command": "pitch",
    "yaw_command": "yaw",
    "thrust_command": "throttle",
}
HIGHEST_RATE = 50.0  # Hz; samples of a faster record are averaged to this rate at most
LONGEST_GAP = 1.0  # s; a longer time without rows separates two segments
TRIM_WINDOW = 60.0  # s; an input that is held for less than half of it does not change the trim
TRIM_RATE = 2.0  # Hz, rate of the running median
REST_WINDOW = 300.0  # s, window of the quantile that gives the rest level
# per cent, quantile that gives the rest level: maneuvers may fill three quarters of the window
REST_SHARE = 25.0
ENERGY_WINDOW = 1.0  # s, window of the short-time energy
LEAST_REST = 0.02  # smallest rest level, relative to the largest deviation


@dataclass(frozen=True, eq=False)
class FlightSignals:
    """Recorded signals on one time base.

    Attributes
    ----------
    time : ``(N,)`` increasing times, s.
    inputs : control -> ``(N,)`` in SI units. The controls in ``AXES`` are searched.
    outputs : signal -> ``(N,)`` in SI units, nz in g; NaN where a sample is missing. The search
        uses alpha, q, nz, theta, airspeed, height or altitude, beta, p, r, phi and psi.
    """

    time: np.ndarray
    inputs: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class DetectedManeuver:
    """One maneuver, or a trim point.

    Attributes
    ----------
    start, end : begin and end, s, of the input; for a turn those of the bank angle, and for a trim
        point those of the quiet time.
    axis : ``"pitch"``, ``"roll"``, ``"yaw"`` or ``"throttle"``; ``"all"`` for a trim point.
    kind : one of ``KINDS``.
    channel : name of the input that moves; ``"phi"`` for a turn, empty for a trim point.
    amplitude : largest deviation from trim, in the unit of the channel; zero for a trim point.
    conditions : mean ``"airspeed"`` (m/s) and ``"height"`` (m), if recorded.
    excitation : derivative -> absolute t value of its equation-error estimate from this maneuver
        alone.
    """

    start: float
    end: float
    axis: str
    kind: str
    channel: str
    amplitude: float
    conditions: Mapping[str, float] = field(default_factory=dict)
    excitation: Mapping[str, float] = field(default_factory=dict)


_INPUT_KINDS = ("step", "pulse", "doublet", "3-2-1-1", "multistep", "sweep", "multisine")
KINDS = ("trim", *_INPUT_KINDS, "pull-up", "turn")


@dataclass(frozen=True, eq=False)
class EvenSegment:
    """A part of a record without gaps, on an even grid.

    Attributes
    ----------
    time : ``(N,)``, s.
    step : sampling interval, s.
    inputs, outputs : as in `FlightSignals`, but without NaN. Outputs with fewer than two samples in
        this part are left out.
    """

    time: np.ndarray
    step: float
    inputs: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]

    def samples(self, seconds: float) -> int:
        """Return the number of samples in a time, at least one."""
        return max(1, round(seconds / self.step))

    def rows(self, start: float, stop: float) -> slice:
        """Return the rows from ``start`` to ``stop``, s."""
        return slice(
            int(np.searchsorted(self.time, start)),
            int(np.searchsorted(self.time, stop, side="right")),
        )


@dataclass(frozen=True, eq=False)
class Activity:
    """Motion of a control about its trim.

    Attributes
    ----------
    deviation : ``(N,)`` control minus trim.
    energy : ``(N,)`` short-time root mean square of the deviation.
    rest : ``(N,)`` rest level: local value of ``energy`` between maneuvers.
    """

    deviation: np.ndarray
    energy: np.ndarray
    rest: np.ndarray


def stretches(signals: FlightSignals) -> Iterator[EvenSegment]:
    """Return the parts of a record between gaps, each on an even grid with a rate of at most
    ``HIGHEST_RATE``. Parts with fewer than eight rows are left out.
    """
    time = np.asarray(signals.time, dtype=float)
    intervals = np.diff(time)
    usual = float(np.median(intervals)) if intervals.size else 1.0
    breaks = np.flatnonzero(intervals > max(LONGEST_GAP, 5.0 * usual)) + 1
    edges = [0, *breaks.tolist(), time.size]
    for first, last in itertools.pairwise(edges):
        if last - first >= 8:
            yield _even(signals, slice(first, last), usual)


def _even(signals: FlightSignals, rows: slice, usual: float) -> EvenSegment:
    """Return some rows of a record on an even grid; ``usual`` is the median interval, s."""
    time = np.asarray(signals.time[rows], dtype=float)
    block = max(1, round(1.0 / (HIGHEST_RATE * usual)))
    count = max(2, round((time[-1] - time[0]) / usual) + 1)
    grid = time[0] + usual * np.arange(count)
    even = count == time.size and bool(np.all(np.abs(time - grid) < 0.1 * usual))

    def on_grid(values: np.ndarray) -> np.ndarray | None:
        whole = np.asarray(values[rows], dtype=float)
        finite = np.isfinite(whole)
        if np.count_nonzero(finite) < 2:
            return None
        if not even or not finite.all():
            whole = np.interp(grid, time[finite], whole[finite])
        return (
            whole[: count // block * block].reshape(-1, block).mean(axis=1) if block > 1 else whole
        )

    inputs = {
        name: values
        for name in AXES
        if name in signals.inputs and (values := on_grid(signals.inputs[name])) is not None
    }
    outputs = {
        name: values
        for name, each in signals.outputs.items()
        if (values := on_grid(each)) is not None
    }
    if block > 1:
        grid = grid[: count // block * block].reshape(-1, block).mean(axis=1)
    return EvenSegment(grid, usual * block, inputs, outputs)


def activity_of(stretch: EvenSegment, values: np.ndarray) -> Activity:
    """Return the deviation of a control from its running median, the short-time energy and the rest
    level.
    """
    deviation = values - trim_of(stretch, values)
    return Activity(
        deviation, short_time_energy(stretch, deviation), rest_level(stretch, deviation)
    )


def short_time_energy(stretch: EvenSegment, deviation: np.ndarray) -> np.ndarray:
    """Return the root mean square over ``ENERGY_WINDOW`` about each sample."""
    # The running sum leaves rounding errors of either sign where an input without noise is at rest.
    power = uniform_filter1d(deviation**2, stretch.samples(ENERGY_WINDOW), mode="nearest")
    return np.sqrt(np.maximum(power, 0.0))


def rest_level(stretch: EvenSegment, deviation: np.ndarray) -> np.ndarray:
    """Return the rest level ``(N,)``: a low quantile of the short-time energy over ``REST_WINDOW``,
    on which maneuvers have little effect.
    """
    every = stretch.samples(ENERGY_WINDOW)
    coarse = short_time_energy(stretch, deviation)[every // 2 :: every]
    size = round(REST_WINDOW / ENERGY_WINDOW)
    if coarse.size <= size:
        rest = np.full(coarse.size, float(np.percentile(coarse, REST_SHARE)))
    else:  # near the ends of a record, its first or last complete window is used
        half = size // 2
        rest = percentile_filter(coarse, REST_SHARE, size=size)
        rest[:half], rest[-half:] = rest[half], rest[-half - 1]
    floor = LEAST_REST * float(np.max(np.abs(deviation)))
    positions = np.arange(coarse.size) * every + every // 2
    return np.maximum(np.interp(np.arange(deviation.size), positions, rest), floor)


def trim_of(stretch: EvenSegment, values: np.ndarray) -> np.ndarray:
    """Return the trim ``(N,)`` of a signal: its running median over ``TRIM_WINDOW``. Inputs shorter
    than half of the window do not change it.
    """
    block = stretch.samples(1.0 / TRIM_RATE)
    if values.size < 4 * block:
        return np.full(values.size, float(np.median(values)))
    count = values.size // block
    blocks = np.median(values[: count * block].reshape(count, block), axis=1)
    size = min(count, round(TRIM_WINDOW * TRIM_RATE)) | 1
    return np.interp(
        np.arange(values.size),
        np.arange(count) * block + 0.5 * (block - 1),
        median_filter(blocks, size=size, mode="reflect"),
    )
