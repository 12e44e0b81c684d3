"""Lift and moment that no curve over alpha or elevator holds: air that remembers or shakes, and
products of two motions.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import cont2discrete, lfilter

from tests.independent.flight import G0, Vehicle
from tests.independent.foreign.simulator import STEP, Cause, Now, Term, along

# R. T. Jones's two exponentials for Wagner's function: 1 - sum of A exp(-b s), s in half chords
# travelled.
DEFICIT, DECAY = np.array([0.165, 0.335]), np.array([0.0455, 0.3])
MEMORY = 2.0  # rad of the short period: time constant of the wake at the tail
BEND = np.radians(1.0)  # of alpha, over which the flow changes sides
BUFFET, WIDTH = 2.0 * np.pi * 4.0, 0.25  # rad/s and damping ratio of the band that shakes
FULL = np.radians(4.0)  # alpha above trim at which the stated level is reached
# rad/s at which the quadratic part of the damping is the stated part of the linear one
RATE = np.radians(5.0)
TAIL_LENGTH = 2.5  # chords from the c.g. to the tail


def wagner_lag(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    """The wing's lift follows alpha by Wagner's function, ``size`` times slower than a thin
    aerofoil does; it acts at the c.g.
    """

    def rates(now: Now) -> np.ndarray:
        return DECAY * 2.0 * now.airspeed / (vehicle.chord * size) * (now.alpha - now.own)

    def loads(now: Now) -> tuple[float, float]:
        return -vehicle.derivatives["CL_alpha"] * float(DEFICIT @ (now.alpha - now.own)), 0.0

    return Term(start=(0.0, 0.0), rates=rates, loads=loads)


def wake_memory(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    """The downwash at the tail builds up slowly: at first the tail steadies by ``size`` of Cm_alpha
    more than it does in the end.
    """
    slope, pace = abs(vehicle.derivatives["Cm_alpha"]), vehicle.short_period()[0] / MEMORY

    def loads(now: Now) -> tuple[float, float]:
        moment = -size * slope * (now.alpha - float(now.own[0]))
        return -moment / TAIL_LENGTH, moment

    return Term(
        start=(0.0,), rates=lambda now: np.array([pace * (now.alpha - now.own[0])]), loads=loads
    )


def lift_hysteresis(
    size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator
) -> Term:
    """Lift that differs between rising and falling alpha, whatever the pace (Duhem): z' = alpha' -
    |alpha'| z/BEND, CL -= size CL_alpha z.
    """

    def rates(now: Now) -> np.ndarray:
        return now.alpha_rate - abs(now.alpha_rate) * now.own / BEND

    return Term(
        start=(0.0,),
        rates=rates,
        loads=lambda now: (-size * vehicle.derivatives["CL_alpha"] * float(now.own[0]), 0.0),
    )


def shaking(duration: float, rng: np.random.Generator) -> np.ndarray:
    """Noise of unit standard deviation in the band of the buffet, on the grid."""
    system = (np.array([BUFFET**2]), np.array([1.0, 2.0 * WIDTH * BUFFET, BUFFET**2]))
    b, a, _ = cont2discrete(system, STEP, method="zoh")
    ahead = round(4.0 / STEP)  # the filter forgets its start in these
    noise = lfilter(b.ravel(), a, rng.standard_normal(ahead + round(duration / STEP) + 2))[ahead:]
    return np.asarray(noise / np.std(noise))


def buffet(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    """Separated flow shakes wing and tail above trim: ``size`` g rms at 4 degrees, in proportion
    below, none below trim.
    """
    noise = along(shaking(duration, rng))
    per_g = (
        vehicle.mass * G0 / (0.5 * vehicle.air_density * vehicle.airspeed**2 * vehicle.wing_area)
    )

    def loads(now: Now) -> tuple[float, float]:
        lift = size * per_g * max(now.alpha, 0.0) / FULL * noise(now.time)
        return lift, -0.3 * lift

    return Term(loads=loads)


def quadratic_damping(
    size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator
) -> Term:
    """Damping that grows with the pitch rate: Cm += Cm_q (c/2V) size |q| q/RATE, of a tail whose
    flow separates.
    """

    def loads(now: Now) -> tuple[float, float]:
        return 0.0, vehicle.derivatives["Cm_q"] * vehicle.chord / (2.0 * now.airspeed) * size * abs(
            now.q
        ) * now.q / RATE

    return Term(loads=loads)


def control_in_wake(
    size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator
) -> Term:
    """The elevator dips into the wing's wake: its power falls by ``size`` at 4 degrees above trim
    and grows as much below.
    """
    d = vehicle.derivatives

    def loads(now: Now) -> tuple[float, float]:
        less = -size * now.alpha / FULL * now.surface
        return d["CL_de"] * less, d["Cm_de"] * less

    return Term(loads=loads)


CAUSES = (
    Cause(
        "buffet",
        "g rms at 4 deg",
        (0.03, 0.1, 0.25),
        buffet,
        "gust-turbulence elastic-mode",
        "nz q",
    ),
    Cause(
        "control-in-wake",
        "part at 4 deg",
        (0.2, 0.4, 0.8),
        control_in_wake,
        "control-nonlinearity moment-nonlinearity",
        "elevator",
    ),
    Cause(
        "lift-hysteresis",
        "part of CL_alpha",
        (0.15, 0.4, 0.8),
        lift_hysteresis,
        "lift-nonlinearity sensor-lag:nz",
        "nz",
    ),
    Cause(
        "quadratic-damping",
        "part at 5 deg/s",
        (0.5, 2.0, 6.0),
        quadratic_damping,
        "moment-nonlinearity control-nonlinearity",
        "q",
    ),
    Cause(
        "wagner-lag",
        "times the aerofoil's",
        (3.0, 10.0, 30.0),
        wagner_lag,
        "sensor-delay:nz actuator-lag",
        "nz",
    ),
    Cause(
        "wake-memory",
        "part of Cm_alpha",
        (0.3, 0.7, 1.5),
        wake_memory,
        "moment-nonlinearity derivative-jump",
        "",
    ),
)
