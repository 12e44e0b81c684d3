"""Maneuvers that are constant between switches, and how maneuvers combine.

A maneuver is a function of time that knows its exact mean over any interval, so a simulation meets
a switch at its own time and not at the next step. Smooth ones are in ``sim.maneuvers.multisine``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from sim.errors import ModelError
from sim.record import Hold

# A time this close to a switch, in s, is at the switch: samples at 0.01 k and sums of durations differ by rounding.
SWITCH_TOLERANCE = 1e-9


class Maneuver(Protocol):
    """An input as a function of time.

    Calling it gives the value at ``t`` (s, float or array), at a switch the new one; ``before(t)`` gives the
    limit from the left; ``mean(begin, end)`` the exact mean over each interval (s, arrays); ``breakpoints`` the
    times at which value or slope may jump, in order; ``hold`` how a record of its samples is best interpolated.
    """

    @property
    def breakpoints(self) -> tuple[float, ...]: ...
    @property
    def hold(self) -> Hold: ...
    def __call__(self, t: Any) -> np.ndarray: ...
    def before(self, t: Any) -> np.ndarray: ...
    def mean(self, begin: Any, end: Any) -> np.ndarray: ...


@dataclass(frozen=True)
class MultiStep:
    """Constant levels between switching times, zero before the first and after the last.

    Attributes
    ----------
    levels : value in each interval, unit of the input.
    times : switching times, one more than levels, s, increasing; the last may be infinite.

    Raises
    ------
    ModelError : times that do not increase, numbers that are not finite, lengths that do not match.
    """

    levels: tuple[float, ...]
    times: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.levels) == 0 or len(self.times) != len(self.levels) + 1:
            raise _bad(
                f"{len(self.levels)} level(s) and {len(self.times)} switching time(s)", "give one time more than levels, and at least one level"
            )
        if not all(math.isfinite(value) for value in (*self.levels, *self.times[:-1])) or math.isnan(self.times[-1]):
            raise _bad("a level or a switching time is not a finite number", "give finite numbers")
        if any(later - earlier <= SWITCH_TOLERANCE for earlier, later in zip(self.times[:-1], self.times[1:], strict=True)):
            raise _bad("switching times do not increase", "give every interval a positive duration")

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return tuple(time for time in self.times if math.isfinite(time))

    @property
    def hold(self) -> Hold:
        return Hold.PREVIOUS

    def __call__(self, t: Any) -> np.ndarray:
        return self._padded[np.searchsorted(self._switches, np.asarray(t, dtype=float) + SWITCH_TOLERANCE, side="right")]

    def before(self, t: Any) -> np.ndarray:
        return self._padded[np.searchsorted(self._switches, np.asarray(t, dtype=float) - SWITCH_TOLERANCE, side="left")]

    def mean(self, begin: Any, end: Any) -> np.ndarray:
        begin, end = np.broadcast_arrays(np.asarray(begin, dtype=float), np.asarray(end, dtype=float))
        first, last = (np.searchsorted(self._switches, begin, side="right"), np.searchsorted(self._switches, end, side="left"))
        # Only intervals with a switch inside need noise_model; elsewhere the level itself is exact.
        out = self._padded[first]
        mixed = last > first
        if np.any(mixed):
            a, b = begin[mixed], end[mixed]
            total = np.zeros(a.shape)
            for level, start, stop in zip(self.levels, self.times[:-1], self.times[1:], strict=True):
                total += level * np.maximum(0.0, np.minimum(b, stop) - np.maximum(a, start))
            out = np.array(out)
            out[mixed] = total / (b - a)
        return out

    @property
    def _switches(self) -> np.ndarray:
        return np.asarray(self.times)

    @property
    def _padded(self) -> np.ndarray:
        return np.array([0.0, *self.levels, 0.0])


def three_two_one_one(amplitude: float, unit: float, start: float = 0.0) -> MultiStep:
    """The 3-2-1-1: steps of 3, 2, 1 and 1 ``unit`` (s) with alternating sign, the first of ``amplitude``, from ``start`` (s)."""
    return alternating(amplitude, [3.0 * unit, 2.0 * unit, unit, unit], start)


def doublet(amplitude: float, unit: float, start: float = 0.0) -> MultiStep:
    """``amplitude`` for one ``unit`` (s), then its opposite for another, from ``start`` (s)."""
    return alternating(amplitude, [unit, unit], start)


def pulse(amplitude: float, unit: float, start: float = 0.0) -> MultiStep:
    """``amplitude`` for one ``unit`` (s) from ``start`` (s)."""
    return alternating(amplitude, [unit], start)


def step(amplitude: float, start: float = 0.0) -> MultiStep:
    """``amplitude`` from ``start`` (s) on, without end."""
    return MultiStep((float(amplitude),), (float(start), math.inf))


def alternating(amplitude: float, durations: Sequence[float], start: float = 0.0) -> MultiStep:
    """Steps of alternating sign with the given durations (s), the first of ``amplitude``, from ``start`` (s)."""
    for duration in durations:
        if not (duration > SWITCH_TOLERANCE and math.isfinite(duration)):
            raise _bad(f"a step lasts {duration:g} s", "give a positive duration")
    times = [float(start)]
    for duration in np.cumsum(durations):
        times.append(float(start + duration))
    return MultiStep(tuple(float(amplitude) * (-1.0) ** i for i in range(len(durations))), tuple(times))


@dataclass(frozen=True)
class Sum:
    """Several maneuvers added; of none, an input at rest. A smooth part makes the record's hold linear."""

    parts: tuple[Maneuver, ...] = ()

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return tuple(sorted({time for part in self.parts for time in part.breakpoints}))

    @property
    def hold(self) -> Hold:
        return Hold.LINEAR if any(part.hold is Hold.LINEAR for part in self.parts) else Hold.PREVIOUS

    def __call__(self, t: Any) -> np.ndarray:
        return sum((part(t) for part in self.parts), start=np.zeros(np.shape(t)))

    def before(self, t: Any) -> np.ndarray:
        return sum((part.before(t) for part in self.parts), start=np.zeros(np.shape(t)))

    def mean(self, begin: Any, end: Any) -> np.ndarray:
        return sum((part.mean(begin, end) for part in self.parts), start=np.zeros(np.broadcast_shapes(np.shape(begin), np.shape(end))))


@dataclass(frozen=True)
class Delayed:
    """A maneuver that comes ``delay`` s later (earlier when negative)."""

    part: Maneuver
    delay: float

    def __post_init__(self) -> None:
        if not math.isfinite(self.delay):
            raise _bad(f"delay {self.delay}", "give a finite delay in s")

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return tuple(time + self.delay for time in self.part.breakpoints)

    @property
    def hold(self) -> Hold:
        return self.part.hold

    def __call__(self, t: Any) -> np.ndarray:
        return self.part(np.asarray(t) - self.delay)

    def before(self, t: Any) -> np.ndarray:
        return self.part.before(np.asarray(t) - self.delay)

    def mean(self, begin: Any, end: Any) -> np.ndarray:
        return self.part.mean(np.asarray(begin) - self.delay, np.asarray(end) - self.delay)


def sequence(parts: Sequence[Maneuver], gap: float, start: float = 0.0) -> Sum:
    """Maneuvers one after another: the first begins at ``start`` (s), each next ``gap`` (s) after the last break of the one before.

    Raises ModelError for a negative gap or a part that never begins.
    """
    if not (gap >= 0 and math.isfinite(gap)):
        raise _bad(f"gap {gap:g} s", "give a gap of zero or more")
    placed: list[Maneuver] = []
    at = float(start)
    for part in parts:
        if not part.breakpoints:
            raise _bad("a part of the sequence has no beginning", "leave it out")
        placed.append(Delayed(part, at - part.breakpoints[0]))
        at = placed[-1].breakpoints[-1] + gap
    return Sum(tuple(placed))


def _bad(what: str, remedy: str) -> ModelError:
    return ModelError(what, where="maneuver", remedy=remedy)
