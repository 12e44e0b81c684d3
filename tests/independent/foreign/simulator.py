"""The second simulator with something in it that no library of effects names: a term with states of
its own beside the rigid short period.

Runge-Kutta of the fourth order on a 200 Hz grid: the fastest cause swings at 20 rad/s, of which a
step is a tenth of a radian.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.independent.flight import Flight, Vehicle
from tests.independent.injected import Fault, nothing
from tests.independent.maneuvers import Maneuver
from tests.independent.short_period import Added, Hidden, rates

STEP = 1.0 / 200.0  # s
NOT_MOVING = np.zeros(0)
DECLARED = Hidden()


@dataclass(frozen=True, eq=False)
class Now:
    """The aircraft at one time: perturbations from trim but for ``airspeed`` (m/s) and ``load``
    (g), and the term's ``own`` states.

    ``load`` and ``alpha_rate`` are those of the rigid aircraft in this state, ``surface`` is the
    command.
    """

    vehicle: Vehicle
    time: float
    alpha: float
    q: float
    theta: float
    airspeed: float
    surface: float
    own: np.ndarray
    load: float = 1.0
    alpha_rate: float = 0.0


def _none(now: Now) -> float:
    return 0.0


def _still(time: float) -> float:
    return 0.0


def _no_loads(now: Now) -> tuple[float, float]:
    return 0.0, 0.0


def _no_rates(now: Now) -> np.ndarray:
    return NOT_MOVING


@dataclass(frozen=True)
class Term:
    """What is added to the rigid aircraft.

    ``start`` of its own states and their ``rates``; ``surface`` (rad) is added to the command
    without being recorded; ``loads`` are added coefficients of lift and moment; ``upwash`` (m/s, of
    time) meets wing and vane; ``bank`` (rad, of time) tilts the weight; ``climb`` is the flight
    path angle at the start; ``read`` is what the sensors make of it all.
    """

    start: tuple[float, ...] = ()
    rates: Callable[[Now], np.ndarray] = _no_rates
    surface: Callable[[Now], float] = _none
    loads: Callable[[Now], tuple[float, float]] = _no_loads
    upwash: Callable[[float], float] = _still
    bank: Callable[[float], float] = _still
    climb: float = 0.0
    read: Fault = nothing


Make = Callable[[float, Vehicle, float, np.random.Generator], Term]
"""A term from its size, the vehicle, the duration of the record (s), and a generator for what differs between records."""  # noqa: E501


@dataclass(frozen=True)
class Cause:
    """One physical cause outside the library.

    ``sizes`` are small, medium and large in ``unit``. ``like`` names the library's effects that it
    half resembles and is not. ``right`` are names that are accepted, since no record could tell
    them from it; ``channels`` are words by which a warning can name it.
    """

    name: str
    unit: str
    sizes: tuple[float, float, float]
    make: Make
    like: str
    channels: str = ""
    right: str = ""


def along(values: np.ndarray, step: float = STEP) -> Callable[[float], float]:
    """Straight lines between ``values`` of a grid of ``step`` from time zero; the last value
    lasts.
    """
    last = len(values) - 1

    def at(time: float) -> float:
        place = min(max(time / step, 0.0), float(last))
        before = min(int(place), last - 1)
        return float(values[before] + (place - before) * (values[before + 1] - values[before]))

    return at


def _motion(
    vehicle: Vehicle, hidden: Hidden, term: Term, time: float, state: np.ndarray, command: float
) -> tuple[np.ndarray, float]:
    """Rates of (alpha, q, theta, V, own states), and the load factor with all that is added."""
    alpha, q, theta, speed = (float(value) for value in state[:4])
    upwash, bank = term.upwash(time) / speed, term.bank(time)
    now = Now(vehicle, time, alpha + upwash, q, theta, speed, command, state[4:])
    surface = command + term.surface(now)
    rigid, load = rates(vehicle, hidden, state[:4], surface, Added(upwash=upwash, bank=bank))
    now = Now(
        vehicle, time, alpha + upwash, q, theta, speed, command, state[4:], load, float(rigid[0])
    )
    lift, moment = term.loads(now)
    whole, load = rates(vehicle, hidden, state[:4], surface, Added(lift, moment, upwash, bank))
    return np.concatenate([whole, term.rates(now)]), load


def flown_with(
    vehicle: Vehicle,
    maneuver: Maneuver,
    size: float,
    term: Term,
    hidden: Hidden = DECLARED,
    step: float = STEP,
) -> Flight:
    """A maneuver of ``size`` rad on the recorded elevator, with a term that is not declared."""
    time = step * np.arange(round(maneuver.duration / step) + 1)
    command, middle = size * maneuver.at(time), size * maneuver.at(time + 0.5 * step)
    state = np.array([0.0, 0.0, term.climb, vehicle.airspeed, *term.start])
    seen = np.empty((5, len(time)))
    for k, t in enumerate(time):
        first, load = _motion(vehicle, hidden, term, t, state, command[k])
        seen[:4, k], seen[4, k] = state[:4], load
        seen[0, k] += term.upwash(t) / state[3]
        if k + 1 < len(time):
            second, _ = _motion(
                vehicle, hidden, term, t + 0.5 * step, state + 0.5 * step * first, middle[k]
            )
            third, _ = _motion(
                vehicle, hidden, term, t + 0.5 * step, state + 0.5 * step * second, middle[k]
            )
            fourth, _ = _motion(
                vehicle, hidden, term, t + step, state + step * third, command[k + 1]
            )
            state = state + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    alpha, q, theta, speed = seen[:4]
    return term.read(Flight(step, command, alpha, q, seen[4], theta, speed, vehicle.airspeed))
