"""The elevator of a surrogate flight: usual and hand-flown maneuvers, rounded by the servo of the
surface.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.errors import DeclarationError
from sim.maneuvers import (
    Maneuver,
    Sum,
    alternating,
    doublet,
    schroeder_multisine,
    three_two_one_one,
)
from sim.record import Hold

CELL = 0.005  # s, spacing of the table


@dataclass(frozen=True, eq=False)
class Table:
    """A maneuver that is linear between the values ``(n,)`` at even times from ``start`` (s) on,
    and constant outside.
    """

    values: np.ndarray
    spacing: float
    start: float = 0.0

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return ()

    @property
    def hold(self) -> Hold:
        return Hold.LINEAR

    def __call__(self, t: Any) -> np.ndarray:
        return np.interp(t, self._times, self.values)

    def before(self, t: Any) -> np.ndarray:
        return self(t)

    def mean(self, begin: Any, end: Any) -> np.ndarray:
        """Return the exact mean over each interval."""
        begin, end = np.broadcast_arrays(
            np.asarray(begin, dtype=float), np.asarray(end, dtype=float)
        )
        return (self._integral(end) - self._integral(begin)) / (end - begin)

    def _integral(self, t: np.ndarray) -> np.ndarray:
        times, v = self._times, self.values
        whole = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) * self.spacing])
        at = np.clip(((t - self.start) / self.spacing).astype(int), 0, len(v) - 2)
        first = np.minimum(np.maximum(t, times[0]), times[-1]) - times[at]
        inside = whole[at] + first * (v[at] + 0.5 * first * (v[at + 1] - v[at]) / self.spacing)
        return (
            inside + np.maximum(t - times[-1], 0.0) * v[-1] + np.minimum(t - times[0], 0.0) * v[0]
        )

    @property
    def _times(self) -> np.ndarray:
        return self.start + self.spacing * np.arange(len(self.values))


Draw = Callable[[np.random.Generator, float, float, float], Maneuver]


def maneuver(
    kind: str,
    rng: np.random.Generator,
    amplitude: float,
    unit: float,
    duration: float,
    surface: float,
) -> Table:
    """Return a maneuver as the surface moves.

    ``amplitude`` is in rad; ``unit`` is the step of a 3-2-1-1 that suits the short period, s;
    ``surface`` is the servo's frequency, rad/s.

    Raises
    ------
    DeclarationError : there is no such kind.
    """
    if kind not in KINDS:
        raise DeclarationError(
            f"there is no maneuver {kind!r}",
            where="key flight.maneuvers",
            remedy=f"use {', '.join(KINDS)}",
        )
    return carried_out(KINDS[kind](rng, amplitude, unit, duration), surface, duration)


def carried_out(commanded: Maneuver, surface: float, duration: float) -> Table:
    """Return a command behind a well-damped servo of frequency ``surface``: two equal lags."""
    from sim.maths import linear_recurrence

    edges = CELL * np.arange(math.ceil(duration / CELL) + 2)
    u = commanded.mean(edges[:-1], edges[1:])
    share = np.full(len(u), math.exp(-surface * CELL))
    for _ in range(2):
        u = linear_recurrence(share, (1.0 - share) * u, u[0])[1:]
    return Table(np.concatenate([[0.0], u]), CELL)


def _steps(rng: np.random.Generator, amplitude: float, unit: float, duration: float) -> Maneuver:
    return three_two_one_one(
        _sign(rng) * amplitude, unit * rng.uniform(0.9, 1.1), rng.uniform(1.0, 2.0)
    )


def _doublets(rng: np.random.Generator, amplitude: float, unit: float, duration: float) -> Maneuver:
    sign, start = _sign(rng), rng.uniform(1.0, 2.0)
    return Sum(
        (
            doublet(sign * amplitude, 1.8 * unit, start),
            doublet(-0.7 * sign * amplitude, unit, start + rng.uniform(8.0, 11.0)),
        )
    )


def _two_doublets(
    rng: np.random.Generator, amplitude: float, unit: float, duration: float
) -> Maneuver:
    """A slow doublet and a quick one, within half of a record."""
    sign, begin = _sign(rng), rng.uniform(1.0, 2.0)
    return Sum(
        (
            doublet(sign * amplitude, 1.9 * unit, begin),
            doublet(-0.7 * sign * amplitude, 1.1 * unit, begin + 0.55 * duration),
        )
    )


def _multisine(
    rng: np.random.Generator, amplitude: float, unit: float, duration: float
) -> Maneuver:
    period = math.floor(duration) - 3.0
    highest = max(5, round(period * rng.uniform(1.2, 1.8)))
    return schroeder_multisine(
        0.4 * amplitude, period, range(2, highest, int(rng.integers(2, 4))), 1.0
    )


def _hand_flown(
    rng: np.random.Generator, amplitude: float, unit: float, duration: float
) -> Maneuver:
    """A 3-2-1-1 as a pilot flies it, then taps: uneven times and levels, which do not return to
    zero exactly.
    """
    parts: list[Maneuver] = []
    start = rng.uniform(1.0, 2.0)
    sign = _sign(rng)
    for count in (3.0, 2.0, 1.0, 1.0, 1.5):
        length = unit * count * rng.uniform(0.75, 1.3)
        parts.append(alternating(sign * amplitude * rng.uniform(0.6, 1.1), [length], start))
        start, sign = start + length, -sign
    start += rng.uniform(2.0, 4.0)
    while start < duration - 4.0:
        length = unit * rng.uniform(1.0, 3.0)
        parts.append(
            alternating(
                _sign(rng) * amplitude * rng.uniform(0.2, 0.7), [length, 0.8 * length], start
            )
        )
        start += 2.0 * length + rng.uniform(1.0, 3.0)
    return Sum(tuple(parts))


def _two(rng: np.random.Generator, amplitude: float, unit: float, duration: float) -> Maneuver:
    sign, start = _sign(rng), rng.uniform(1.0, 1.5)
    second = doublet(-0.8 * sign * amplitude, 1.5 * unit, start + 0.45 * duration)
    return Sum((three_two_one_one(sign * amplitude, 0.85 * unit, start), second))


def _step(rng: np.random.Generator, amplitude: float, unit: float, duration: float) -> Maneuver:
    """One level for 60 to 80 per cent of the record, and back."""
    return alternating(
        _sign(rng) * amplitude, [duration * rng.uniform(0.6, 0.8)], rng.uniform(1.0, 2.0)
    )


def _held(rng: np.random.Generator, amplitude: float, unit: float, duration: float) -> Maneuver:
    """A third of the level for 30 to 40 per cent of the record, and back. If held longer or
    further, it would end in a loop.
    """
    return alternating(
        _sign(rng) * amplitude / 3.0, [duration * rng.uniform(0.3, 0.4)], rng.uniform(1.0, 2.0)
    )


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


KINDS: Mapping[str, Draw] = {
    "3-2-1-1": _steps,
    "doublets": _doublets,
    "two-doublets": _two_doublets,
    "multisine": _multisine,
    "hand-flown": _hand_flown,
    "two": _two,
    "step": _step,
    "held": _held,
}
USUAL = ("3-2-1-1", "doublets", "multisine", "hand-flown", "two")
