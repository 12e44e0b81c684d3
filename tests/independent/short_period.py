"""A second simulator: rigid short period with an honest phugoid, written plainly, and what an
engineer may not have declared of it.

Runge-Kutta of the fourth order on the 400 Hz grid. The trim lift carries the weight and follows the
dynamic pressure; drag is a parabolic polar against constant thrust; nothing is linearised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import cont2discrete

from tests.independent.flight import G0, Flight, Vehicle
from tests.independent.maneuvers import Maneuver

STEP = 1.0 / 400.0  # s
ZERO_LIFT_DRAG, INDUCED_DRAG = 0.022, 0.055  # of the polar CD = CD0 + K CL^2, a usual one
FOOT, SLUG = 0.3048, 14.59390293720636
POUND = SLUG * FOOT
# command about trim on the fine grid -> surface about trim
Path = Callable[[np.ndarray], np.ndarray]


def straight(command: np.ndarray) -> np.ndarray:
    return command


@dataclass(frozen=True)
class Hidden:
    """What the declared rigid short period does not know.

    ``exchange`` lets speed and height exchange (phugoid); without it the speed is constant.
    ``climb`` (rad) is the flight path angle at the start. ``surface`` is what the actuator makes of
    the command. ``unequal`` k has the control act with 1 + k trailing edge down and 1 - k up.
    ``deceleration`` (m/s2) is a thrust deficit: the speed falls, while the pilot's trim holds.
    """

    exchange: bool = False
    climb: float = 0.0
    surface: Path = straight
    unequal: float = 0.0
    deceleration: float = 0.0


@dataclass(frozen=True)
class Added:
    """Coefficients of lift and moment beside the rigid ones, the angle (rad) by which rising air
    adds to alpha in the loads, and the bank (rad).
    """

    lift: float = 0.0
    moment: float = 0.0
    upwash: float = 0.0
    bank: float = 0.0


NONE_ADDED = Added()


def second_order(frequency: float, damping: float) -> Path:
    """An actuator of natural ``frequency`` (rad/s) and damping ratio, exact for commands that run
    straight between grid points.
    """
    system = (
        np.array([[0.0, 1.0], [-(frequency**2), -2.0 * damping * frequency]]),
        np.array([[0.0], [frequency**2]]),
        np.eye(2),
        np.zeros((2, 1)),
    )
    a, b, c, d, _ = cont2discrete(system, STEP, method="foh")

    def act(command: np.ndarray) -> np.ndarray:
        # The command is at rest at the start, so the state of the discrete system is zero.
        state, shown = np.zeros(2), np.empty_like(command)
        for k, asked in enumerate(command):
            shown[k] = (c @ state + d[:, 0] * asked)[0]
            state = a @ state + b[:, 0] * asked
        return shown

    return act


def first_order(lag: float) -> Path:
    """An actuator with a time constant ``lag`` (s)."""
    keep = np.exp(-STEP / lag)

    def act(command: np.ndarray) -> np.ndarray:
        shown = np.zeros_like(command)
        for k in range(1, len(command)):
            slope = (command[k] - command[k - 1]) / STEP
            shown[k] = (
                command[k] - lag * slope + (shown[k - 1] - command[k - 1] + lag * slope) * keep
            )
        return shown

    return act


def rates(
    vehicle: Vehicle, hidden: Hidden, state: np.ndarray, surface: float, added: Added = NONE_ADDED
) -> tuple[np.ndarray, float]:
    """Time derivative of (alpha, q, theta, V), perturbations but for V, and the load factor;
    ``surface`` about trim.
    """
    alpha, q, theta, speed = state
    d = vehicle.derivatives
    pressure_area = 0.5 * vehicle.air_density * speed**2 * vehicle.wing_area
    felt = q * vehicle.chord / (2.0 * speed)
    control = surface + hidden.unequal * abs(surface)
    trim = vehicle.mass * G0 / (0.5 * vehicle.air_density * vehicle.airspeed**2 * vehicle.wing_area)
    air = alpha + added.upwash
    lift = trim + d["CL_alpha"] * air + d["CL_q"] * felt + d["CL_de"] * control + added.lift
    moment = d["Cm_alpha"] * air + d["Cm_q"] * felt + d["Cm_de"] * control + added.moment
    load = pressure_area * lift / (vehicle.mass * G0)
    path = theta - alpha
    slower = -hidden.deceleration
    if hidden.exchange:
        drag = pressure_area * (ZERO_LIFT_DRAG + INDUCED_DRAG * lift**2)
        thrust = (
            0.5
            * vehicle.air_density
            * vehicle.airspeed**2
            * vehicle.wing_area
            * (ZERO_LIFT_DRAG + INDUCED_DRAG * trim**2)
        )
        slower += -G0 * np.sin(path) + (thrust - drag) / vehicle.mass
    weight = np.cos(added.bank) * (np.cos(path) if hidden.exchange else 1.0)
    q_rate = pressure_area * vehicle.chord * moment / vehicle.pitch_inertia
    return np.array([q - G0 / speed * (load - weight), q_rate, q, slower]), load


def flown(vehicle: Vehicle, maneuver: Maneuver, size: float, hidden: Hidden = Hidden()) -> Flight:
    """A maneuver of ``size`` rad on the elevator command, which is what the record holds as
    elevator.
    """
    time = STEP * np.arange(round(maneuver.duration / STEP) + 1)
    command = size * maneuver.at(time)
    surface = hidden.surface(command)
    state = np.array([0.0, 0.0, hidden.climb, vehicle.airspeed])
    seen = np.empty((5, len(time)))
    for k in range(len(time)):
        first, load = rates(vehicle, hidden, state, surface[k])
        seen[:4, k], seen[4, k] = state, load
        if k + 1 < len(time):
            middle = 0.5 * (surface[k] + surface[k + 1])
            second, _ = rates(vehicle, hidden, state + 0.5 * STEP * first, middle)
            third, _ = rates(vehicle, hidden, state + 0.5 * STEP * second, middle)
            fourth, _ = rates(vehicle, hidden, state + STEP * third, surface[k + 1])
            state = state + STEP / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    alpha, q, theta, speed = seen[:4]
    return Flight(STEP, command, alpha, q, seen[4], theta, speed, vehicle.airspeed)


def _lumped(
    name: str,
    weight: float,
    area: float,
    chord: float,
    inertia: float,
    speed: float,
    density: float,
    printed: Sequence[float],
) -> Vehicle:
    """A vehicle of printed numbers in feet and pounds; ``printed`` is CL and Cm over alpha,
    alpha_dot, q and elevator.

    The rigid model has no alpha_dot. With s = rho S c/(4m) it is eliminated exactly: alpha_dot
    c/(2V) = q c/(2V) - s CL.
    """
    cl_a, cl_ad, cl_q, cl_de, cm_a, cm_ad, cm_q, cm_de = printed
    mass = weight * POUND / G0
    base = Vehicle(
        name,
        mass,
        area * FOOT**2,
        chord * FOOT,
        inertia * SLUG * FOOT**2,
        speed * FOOT,
        density * SLUG / FOOT**3,
        {},
    )
    share = base.lift_slope * base.rate_time
    lift = np.array([cl_a, cl_q + cl_ad, cl_de]) / (1.0 + share * cl_ad)
    moment = np.array([cm_a, cm_q + cm_ad, cm_de]) - cm_ad * share * lift
    names = [f"{letter}_{symbol}" for letter in ("CL", "Cm") for symbol in ("alpha", "q", "de")]
    return replace(
        base,
        derivatives={
            symbol: float(value) for symbol, value in zip(names, [*lift, *moment], strict=True)
        },
    )


# Jan Roskam, Airplane Flight Dynamics and Automatic Flight Controls, part I, appendix B (weights in
# lb, ft, slug ft2, ft/s, slug/ft3).
BUSINESS_JET = _lumped(
    "Learjet 24, cruise",
    13000.0,
    230.0,
    7.0,
    18800.0,
    677.0,
    0.000588,
    (5.84, 2.2, 4.7, 0.46, -0.64, -6.7, -15.5, -1.24),
)
FIGHTER = _lumped(
    "F-4, subsonic cruise",
    39000.0,
    530.0,
    16.0,
    122200.0,
    876.0,
    0.000739,
    (3.75, 0.86, 1.8, 0.40, -0.40, -1.3, -2.7, -0.58),
)
TRAINER = _lumped(
    "Cessna 182, cruise",
    2650.0,
    174.0,
    4.9,
    1346.0,
    220.1,
    0.00205,
    (4.41, 1.7, 3.9, 0.43, -0.613, -7.27, -12.4, -1.122),
)
VEHICLES = {"jet": BUSINESS_JET, "fighter": FIGHTER, "trainer": TRAINER}
