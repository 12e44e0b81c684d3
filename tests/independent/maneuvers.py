"""Elevator maneuvers as a pilot or a flight computer makes them: pulses on the command, each begun
and ended by a short ramp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# s: pulses begin and end on these, so that every sample rate from 10 Hz on sees them begin at a
# sample
TICK = 0.1


@dataclass(frozen=True)
class Pulse:
    """A held deflection from ``start`` for ``width`` (s), of ``size`` (1 is the largest of the
    maneuver).
    """

    start: float
    width: float
    size: float


@dataclass(frozen=True)
class Maneuver:
    """Pulses over a record of ``duration`` seconds; ``ramp`` (s) is how long the hand takes from
    one level to the next.
    """

    pulses: tuple[Pulse, ...]
    duration: float
    ramp: float = 0.2

    def at(self, time: np.ndarray) -> np.ndarray:
        """The command over time, its ramps half a cosine long."""
        total = np.zeros_like(time)
        for pulse in self.pulses:
            total += pulse.size * (
                self._risen(time - pulse.start) - self._risen(time - pulse.start - pulse.width)
            )
        return total

    def _risen(self, since: np.ndarray) -> np.ndarray:
        if self.ramp == 0.0:
            return (since >= -1e-9).astype(float)
        return 0.5 - 0.5 * np.cos(np.pi * np.clip(since / self.ramp, 0.0, 1.0))


def in_turn(
    start: float, tick: float, sizes: Sequence[float], widths: Sequence[float]
) -> tuple[Pulse, ...]:
    """Pulses one after the other, each ``widths`` ticks long, laid on multiples of `TICK`."""
    edges = start + np.concatenate([[0.0], np.cumsum(tick * np.asarray(widths))])
    edges = np.round(edges / TICK) * TICK
    return tuple(
        Pulse(float(a), float(b - a), float(size))
        for a, b, size in zip(edges[:-1], edges[1:], sizes, strict=True)
    )


def three_two_one_one(start: float, tick: float, size: float = 1.0) -> tuple[Pulse, ...]:
    return in_turn(start, tick, (size, -size, size, -size), (3, 2, 1, 1))


def doublet(start: float, half: float, size: float = 1.0) -> tuple[Pulse, ...]:
    return in_turn(start, half, (size, -size), (1, 1))


def tick_for(frequency: float) -> float:
    """The tick (s) of a 3-2-1-1 whose energy lies about a short period of ``frequency`` rad/s: 1.6
    over it, between 0.3 and 1 s.
    """
    return float(np.round(np.clip(1.6 / max(frequency, 0.1), 0.3, 1.0) / TICK) * TICK)


def training(tick: float) -> tuple[Maneuver, Maneuver]:
    """Two records to fit: a 3-2-1-1 and a smaller doublet behind it; two doublets of different
    length and a turned 3-2-1-1.
    """
    first = three_two_one_one(2.0, tick) + doublet(16.0, 1.5 * tick, -0.7)
    second = (
        doublet(1.5, 2.0 * tick, 0.8)
        + three_two_one_one(9.0, 0.8 * tick, -0.7)
        + doublet(18.0, tick, 0.5)
    )
    return Maneuver(first, 25.0), Maneuver(second, 24.0)


def validation(tick: float) -> Maneuver:
    """A record to predict, with other shapes: a 1-1-2, a single long pulse, and a quick doublet."""
    pulses = (
        in_turn(2.0, 1.3 * tick, (0.8, -0.8, 0.8), (1, 1, 2))
        + in_turn(11.0, tick, (-0.5,), (3,))
        + doublet(17.0, 0.8 * tick, -0.6)
    )
    return Maneuver(pulses, 22.0)
