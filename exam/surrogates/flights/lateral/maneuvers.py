"""Pairs of rudder and aileron maneuvers: one after the other as in flight tests of the Dutch roll,
or both at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from exam.surrogates.flights.maneuvers import KINDS, Table, carried_out
from sim.maneuvers import Delayed, Maneuver, schroeder_multisine

# An aileron rolls faster than a rudder yaws: shorter steps, smaller deflections.
ROLL_UNIT, ROLL_AMPLITUDE = 0.6, 0.6
SECOND = 0.5  # of the record, when the second control begins
Pair = Callable[[np.random.Generator, float, float, float], tuple[Maneuver, Maneuver]]


def maneuver_pair(
    kind: str,
    rng: np.random.Generator,
    amplitude: float,
    unit: float,
    duration: float,
    surface: float,
) -> dict[str, Table]:
    """Rudder and aileron as their servos carry them out.

    ``amplitude`` of the rudder, rad; ``unit`` the step of a 3-2-1-1 that suits the Dutch roll, s;
    ``surface`` the servos' frequency, rad/s.
    """
    rudder, aileron = PAIRS[kind](rng, amplitude, unit, duration)
    return {
        "rudder": carried_out(rudder, surface, duration),
        "aileron": carried_out(aileron, surface, duration),
    }


def _in_turn(first: str, second: str) -> Pair:
    """Rudder and aileron in either order, the second in the second half."""

    def pair(
        rng: np.random.Generator, amplitude: float, unit: float, duration: float
    ) -> tuple[Maneuver, Maneuver]:
        half = SECOND * duration
        rudder = KINDS[first](rng, amplitude, unit, half)
        aileron = KINDS[second](rng, ROLL_AMPLITUDE * amplitude, ROLL_UNIT * unit, half)
        if rng.random() < 0.5:
            return Delayed(rudder, half), aileron
        return rudder, Delayed(aileron, half)

    return pair


def _multisines(
    rng: np.random.Generator, amplitude: float, unit: float, duration: float
) -> tuple[Maneuver, Maneuver]:
    """Both at once, with harmonics of their own."""
    period = math.floor(duration) - 3.0
    highest = max(7, round(period * rng.uniform(0.5, 0.8) / unit))
    rudder = schroeder_multisine(0.4 * amplitude, period, range(2, highest, 2), 1.0)
    return rudder, schroeder_multisine(
        0.4 * ROLL_AMPLITUDE * amplitude, period, range(3, highest, 2), 1.0
    )


PAIRS: Mapping[str, Pair] = {
    "3-2-1-1": _in_turn("3-2-1-1", "3-2-1-1"),
    "doublets": _in_turn("two-doublets", "two-doublets"),
    "multisine": _multisines,
    "hand-flown": _in_turn("hand-flown", "hand-flown"),
    "mixed": _in_turn("two-doublets", "3-2-1-1"),
}
USUAL_PAIRS = ("3-2-1-1", "doublets", "hand-flown", "mixed", "multisine")
