"""Pilot's stick inputs as functions of time: steps with exact switching times, and a hand-flown-like history. Inches, aft +."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.errors import ModelError

# Rounding of a time built by adding up frames must not move a switch to the next frame.
_TIME_SLACK = 1e-9


@dataclass(frozen=True)
class SteppedStick:
    """Constant between switches: ``levels[i]`` (in) from ``times[i]`` (s) on, 0 before the first.

    Called with times, any shape, it returns the stick there; at a switch the new level holds.
    Raises ModelError when times and levels differ in number or the times do not increase.
    """

    times: tuple[float, ...]
    levels: tuple[float, ...]

    def __post_init__(self) -> None:
        _check(self.times, self.levels)

    def __call__(self, time: np.ndarray) -> np.ndarray:
        steps = np.searchsorted(self.times, np.asarray(time) + _TIME_SLACK, side="right")
        return np.concatenate([[0.0], self.levels])[steps]


@dataclass(frozen=True)
class SmoothStick:
    """A stepped stick through a critically damped second-order hand, bandwidth w (rad/s), in closed form.

    Each change d of level at t_i adds d [1 - (1 + w s) exp(-w s)] with s = t - t_i > 0. Errors as for SteppedStick.
    """

    times: tuple[float, ...]
    levels: tuple[float, ...]
    bandwidth: float

    def __post_init__(self) -> None:
        _check(self.times, self.levels)
        if not self.bandwidth > 0:
            raise ModelError(f"bandwidth {self.bandwidth:g} rad/s", where="stick", remedy="give a positive one")

    def __call__(self, time: np.ndarray) -> np.ndarray:
        since = np.maximum(np.asarray(time)[..., None] - np.array(self.times), 0.0) * self.bandwidth
        changes = np.diff(np.concatenate([[0.0], self.levels]))
        return np.asarray((1.0 - (1.0 + since) * np.exp(-since)) @ changes)


def three_two_one_one(amplitude: float = 1.0, unit: float = 0.5, start: float = 1.0) -> SteppedStick:
    """The 3-2-1-1: +, -, +, - for 3, 2, 1 and 1 units (s) from ``start`` (s), then 0; a negative amplitude (in) turns the sign."""
    return alternating((3.0, 2.0, 1.0, 1.0), amplitude, unit, start)


def doublet(amplitude: float = 1.0, unit: float = 1.0, start: float = 1.0) -> SteppedStick:
    """One unit (s) of + ``amplitude`` (in), one of -, then 0."""
    return alternating((1.0, 1.0), amplitude, unit, start)


def alternating(lengths: tuple[float, ...], amplitude: float, unit: float, start: float) -> SteppedStick:
    """Steps of alternating sign, ``lengths`` in units (s), then 0; switches at ``start + unit * sum(lengths so far)``."""
    edges = np.concatenate([[0.0], np.cumsum(lengths)])
    levels = [amplitude * (-1.0) ** i for i in range(len(lengths))]
    return SteppedStick(tuple(float(start + unit * edge) for edge in edges), (*levels, 0.0))


def hand_flown(rng: np.random.Generator, duration: float, amplitude: float = 1.0, bandwidth: float = 10.0, start: float = 0.5) -> SmoothStick:
    """A history as a pilot flies it: pulls and pushes of uneven size and length, now and then a rest near zero; 0 at the end.

    Levels change every 0.3 to 1.5 s and alternate in sign with sizes of 0.3 to 1 ``amplitude`` (in); one in four is within 0.1
    of it instead. The last second before ``duration`` (s) is let go. The same generator state gives the same history.
    """
    times, levels, sign, now = [], [], 1.0 if rng.random() < 0.5 else -1.0, start
    while now < duration - 1.0:
        resting, size, length = rng.random() < 0.25, rng.random(), rng.random()
        times.append(now)
        levels.append(amplitude * (0.1 * (2.0 * size - 1.0) if resting else sign * (0.3 + 0.7 * size)))
        sign = sign if resting else -sign
        now += 0.3 + 1.2 * length
    end = max(duration - 1.0, start)
    return SmoothStick((*times, end), (*levels, 0.0), bandwidth)


def _check(times: tuple[float, ...], levels: tuple[float, ...]) -> None:
    if len(times) != len(levels) or not times:
        raise ModelError(f"{len(times)} times and {len(levels)} levels", where="stick", remedy="give as many of one as of the other, at least one")
    if not np.all(np.isfinite(times)) or not np.all(np.isfinite(levels)) or np.any(np.diff(times) <= 0):
        raise ModelError("times do not increase, or a number is not finite", where="stick", remedy="give finite levels at increasing times")
