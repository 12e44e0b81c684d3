"""Maneuvers of equal peak amplitude and equal length, as the samples that a flight computer holds."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from sim.maneuvers import Maneuver, MultiStep, Spacing, Sweep, doublet, least_peak_multisine, three_two_one_one
from sim.record import Record

TAPER = 0.05  # of a sweep's length
SLOWEST = 0.3  # of the roots' frequency, where a sweep begins if its length allows
MOST_HARMONICS = 60  # of all inputs together


@dataclass(frozen=True)
class Room:
    """Where maneuvers have room: sample times ``(N,)`` in s, a ``pulse`` (s) that the roots ask for, and the number of inputs.

    The first and last two pulses are rest: the trim shows, and the motion dies out.
    ``corners`` : rad/s of each input, above which a sine of full amplitude is faster than the limit
    of its rate: limit over amplitude; empty where no rate is limited. ``band`` : rad/s, of sweeps and
    multisines; None follows the pace.
    """

    time: np.ndarray
    pulse: float
    inputs: int
    corners: tuple[float, ...] = ()
    band: tuple[float, float] | None = None

    def corner(self, one: int) -> float:
        """The corner of an input, rad/s; infinite where its rate is not limited."""
        return self.corners[one] if self.corners else math.inf

    def slow_enough(self, one: int, row: np.ndarray) -> np.ndarray:
        """A row of peak one, scaled down where its fastest change exceeds the limit of the rate."""
        row = row / np.max(np.abs(row))
        fastest = float(np.max(np.abs(np.diff(row)))) / self.interval
        return np.asarray(row * min(1.0, self.corner(one) / max(fastest, 1e-300)))

    @property
    def interval(self) -> float:
        return float(self.time[1] - self.time[0])

    @property
    def lead(self) -> float:
        return max(1.0, round(2.0 * self.pulse / self.interval)) * self.interval

    @property
    def active(self) -> float:
        """Time between the rests, s."""
        return float(self.time[-1]) - 2.0 * self.lead


Shapes = np.ndarray | None  # (inputs, N) of largest magnitude one; None where the pace leaves no room


def steps_in_turn(room: Room, pace: float, single: Callable[[float, float, float], Maneuver], units: float) -> Shapes:
    """A maneuver of ``units`` paces on one input after the other, each round with the other sign, while there is time."""
    length, gap = units * pace, max(2.0 * room.pulse, pace)
    out = np.zeros((room.inputs, len(room.time)))
    at, count = room.lead, 0
    while at + length <= room.lead + room.active + 1e-9:
        sign = (-1.0) ** (count // room.inputs)
        begin = round(at / room.interval) * room.interval
        out[count % room.inputs] += np.asarray(single(sign, pace, begin)(room.time))
        at, count = begin + length + gap, count + 1
    return out if count >= room.inputs else None


def sweeps(room: Room, pace: float) -> Shapes:
    """A logarithmic sweep on one input after the other, up to half a period of ``pace``.

    Where it would be faster than the limit of the rate, its amplitude falls with the frequency.
    """
    each = room.active / room.inputs
    low, high = max(2.0 * math.pi / each, SLOWEST * 1.5 / room.pulse), math.pi / pace
    low, high = room.band or (low, high)
    if high < 1.5 * low:
        return None
    rows = []
    for i in range(room.inputs):
        begin = room.lead + i * each
        row = Sweep(1.0, low, high, each, begin, TAPER * each, Spacing.LOGARITHMIC)(room.time)
        at = np.clip((room.time - begin) / each, 0.0, 1.0)
        rows.append(room.slow_enough(i, row * np.minimum(1.0, room.corner(i) / (low * (high / low) ** at))))
    return np.array(rows)


def multisines(room: Room, pace: float) -> Shapes:
    """Orthogonal multisines on all inputs at once, harmonics dealt out in turn up to half a period of ``pace``, phases of least peak.

    Harmonics that would be faster than the limit of the rate are smaller, so that nothing is cut off
    and the inputs stay orthogonal.
    """
    samples = math.floor(room.active / room.interval + 1e-9)
    period = samples * room.interval
    lowest, highest = 1, min(math.floor(period / (2.0 * pace)), MOST_HARMONICS)
    if room.band is not None:
        lowest, highest = (round(omega * period / (2.0 * math.pi)) for omega in room.band)
        lowest = max(lowest, 1)
    if highest - lowest + 1 < 2 * room.inputs:
        return None
    begin = round(room.lead / room.interval) * room.interval
    rows = []
    for i in range(room.inputs):
        own = range(lowest + i, highest + 1, room.inputs)
        shares = [min(1.0, room.corner(i) * period / (2.0 * math.pi * harmonic)) for harmonic in own]
        equal = min(shares) == max(shares)
        row = least_peak_multisine(1.0, period, own, begin, shares=None if equal else shares)(room.time)
        rows.append(room.slow_enough(i, row))
    return np.array(rows)


KINDS: Mapping[str, Callable[[Room, float], Shapes]] = {
    "3-2-1-1": lambda room, pace: steps_in_turn(room, pace, three_two_one_one, 7.0),
    "doublet": lambda room, pace: steps_in_turn(room, pace, doublet, 2.0),
    "sweep": sweeps,
    "multisine": multisines,
}
OVER_A_BAND = ("sweep", "multisine")  # kinds that take a band
PACE_IS = {"3-2-1-1": "step", "doublet": "step", "sweep": "up to", "multisine": "up to"}


def no_faster(rows: np.ndarray, rate: np.ndarray, interval: float) -> np.ndarray:
    """Samples ``(inputs, N)`` that follow ``rows`` and change by no more than ``rate (inputs,)`` in a second."""
    out = rows.copy()
    if not np.any(np.isfinite(rate)):
        return out
    most = rate * interval
    for k in range(1, rows.shape[1]):
        out[:, k] = out[:, k - 1] + np.clip(rows[:, k] - out[:, k - 1], -most, most)
    return out


def as_held(record: Record) -> dict[str, MultiStep]:
    """The inputs of a record as maneuvers that hold each sample until the next, for a truth to fly."""
    interval = float(record.time[-1] - record.time[-2])
    times = (*record.time.tolist(), float(record.time[-1] + interval))
    return {channel.name: MultiStep(tuple(channel.values.tolist()), times) for channel in record.inputs}
