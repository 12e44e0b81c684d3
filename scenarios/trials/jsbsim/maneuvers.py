"""Commands of a flight: the maneuver of each control one after another, or multisines on all at once, as a hand makes them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from scenarios.trials.jsbsim.declaration import CONTROLS, JsbsimFlight
from sim.maneuvers import Maneuver, Sum, doublet, orthogonal_multisines, three_two_one_one

HAND = 0.15  # s that a hand takes from one level to the next
QUIET = 2.0  # s before anything moves
HIGHEST = 2.2  # of a multisine, over the frequency of the mode
CREST = 0.5  # rms of a multisine over its peak
LEVER = 5.0  # s that a throttle is held
# When a control first moves and when again, in parts of the record.
SLOTS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "rigid": {"elevator": (0.0, 0.55)},
    "longitudinal": {"elevator": (0.0, 0.72), "throttle": (0.3, 0.52)},
    "lateral": {"rudder": (0.0, 0.55), "aileron": (0.3, 0.8)},
    "both": {"elevator": (0.0, 0.55), "rudder": (0.2, 0.7), "aileron": (0.38, 0.86)},
}


def commands(flight: JsbsimFlight, sizes: Mapping[str, float], units: Mapping[str, float], time: np.ndarray) -> dict[str, np.ndarray]:
    """By control what is added to its trim at each frame: rad, of the throttle parts of full travel.

    ``sizes`` : peak by control; ``units`` : by control the step of a 3-2-1-1 that suits the mode it excites, s.
    """
    moves = _multisines(flight, sizes, units) if flight.maneuver == "multisine" else {}
    for control in CONTROLS[flight.axis]:
        if control not in moves:
            moves[control] = _steps(flight, control, sizes[control], units[control])
    return {control: by_hand(move(time), time) for control, move in moves.items()}


def by_hand(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """The mean of a command over the last ``HAND`` seconds: steps become ramps."""
    width = max(1, round(HAND / float(time[1] - time[0])))
    whole = np.concatenate([np.zeros(width), np.cumsum(values)])
    return np.asarray((whole[width:] - whole[:-width]) / width)


def rehearsal(control: str, size: float, unit: float, time: np.ndarray) -> dict[str, np.ndarray]:
    """One control alone: its 3-2-1-1 soon after the start."""
    return {control: by_hand(three_two_one_one(size, unit, 0.5)(time), time)}


def _steps(flight: JsbsimFlight, control: str, size: float, unit: float) -> Maneuver:
    first, again = (QUIET + share * (flight.duration - QUIET) for share in SLOTS[flight.axis][control])
    if control == "throttle":
        # In proportion where the record is short.
        held = min(LEVER, 0.1 * flight.duration)
        return Sum((doublet(size, held, first), doublet(-0.7 * size, 0.6 * held, again)))
    if flight.maneuver == "doublet":
        return Sum((doublet(size, 1.7 * unit, first), doublet(-0.8 * size, unit, again)))
    return Sum((three_two_one_one(size, unit, first), doublet(-0.8 * size, 1.5 * unit, again)))


def _multisines(flight: JsbsimFlight, sizes: Mapping[str, float], units: Mapping[str, float]) -> dict[str, Maneuver]:
    """Mutually orthogonal multisines on the surfaces, up to somewhat above the fastest mode (unit = 1.6/frequency)."""
    moved = [control for control in CONTROLS[flight.axis] if control != "throttle"]
    period = flight.duration - QUIET - 1.0
    highest = max(3 * len(moved), round(period * HIGHEST * 1.6 / min(units[control] for control in moved) / (2.0 * np.pi)))
    made = orthogonal_multisines([CREST * sizes[control] for control in moved], period, 2, highest, QUIET)
    return dict(zip(moved, made, strict=True))
