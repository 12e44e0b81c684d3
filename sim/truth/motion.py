"""The motion of a true aircraft to a tolerance: exact where it is linear, by LSODA where it is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.declaration.system import System
from sim.maneuvers.steps import Maneuver, Sum
from sim.propagation.linear import exact_motion
from sim.propagation.lsoda import InputsAt, smooth_motion
from sim.record import Hold

EXACT, SMOOTH = "exact, linear", "LSODA"
TOLERANCE = 1e-9  # of the motion's size, at the end of a flight


@dataclass(frozen=True, eq=False)
class Motion:
    """States ``(N,)`` each, and by which method they were found: ``EXACT`` or ``SMOOTH``."""

    states: list[np.ndarray]
    method: str


def by_tolerance(system: System, p: Sequence[float], by_input: tuple[Maneuver, ...], time: np.ndarray) -> Motion | None:
    """Motion at ``time`` (s, ``(N,)``) within ``TOLERANCE``, inputs as the maneuvers give them; None where no method keeps it.

    None too for effects on the input path: they act on means over cells, and so do not leave inputs that are functions of time.
    """
    if system.input_stages:
        return None
    breaks = Sum(by_input).breakpoints
    x0 = system.initial.values().tolist()
    states = exact_motion(system, p, x0, lambda t: [maneuver(t) for maneuver in by_input], breaks, time)
    if states is not None:
        return Motion(list(states), EXACT)
    states = smooth_motion(system, p, x0, lambda begin, end: _between(by_input, begin, end), breaks, time)
    return None if states is None else Motion(list(states), SMOOTH)


def _between(by_input: tuple[Maneuver, ...], begin: float, end: float) -> InputsAt:
    """Inputs from one break to the next: a held one by its level, others up to the break and not beyond it."""
    if all(maneuver.hold is Hold.PREVIOUS for maneuver in by_input):
        held = [float(maneuver(0.5 * (begin + end))) for maneuver in by_input]
        return lambda t: held
    last = [float(maneuver.before(end)) for maneuver in by_input]
    return lambda t: [float(maneuver(t)) for maneuver in by_input] if t < end - 1e-9 else last
