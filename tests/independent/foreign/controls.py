"""Between the hand and the aircraft: a cable that creeps, a bobweight, a trim and an engine that
work by themselves. The record holds the command.
"""

from __future__ import annotations

import numpy as np

from tests.independent.flight import G0, Vehicle
from tests.independent.foreign.simulator import Cause, Now, Term

CREEP = 1.2  # s
FREE_STICK = 0.3  # s: the stick follows the weight on its spring
SURGE = 2.0 * np.pi * 0.55  # rad/s
DEGREE = np.radians(1.0)
SLACK = np.radians(0.2)  # of elevator, which the trim leaves alone


def cable_creep(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    """A cable gives way under the hinge moment: a held deflection loses ``size`` of itself with a
    time constant, at first nothing.
    """

    def rates(now: Now) -> np.ndarray:
        return (size * now.surface - now.own) / CREEP

    return Term(start=(0.0,), rates=rates, surface=lambda now: -float(now.own[0]))


def bobweight(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    """A weight on a stick that is held softly: load pulls the elevator down, a little late, and so
    steadies by ``size`` of Cm_alpha.
    """
    d, per_alpha = (
        vehicle.derivatives,
        vehicle.lift_slope * vehicle.airspeed / G0 * vehicle.derivatives["CL_alpha"],
    )
    per_g = size * d["Cm_alpha"] / (d["Cm_de"] * per_alpha)  # rad of elevator

    def rates(now: Now) -> np.ndarray:
        return (per_g * (now.load - 1.0) - now.own) / FREE_STICK

    return Term(start=(0.0,), rates=rates, surface=lambda now: float(now.own[0]))


def auto_trim(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    """A trim motor takes the load off the elevator: the stabiliser follows a deflection beyond the
    slack by ``size`` of it a second.

    The stabiliser is told by the elevator that does as much; it stays where it was driven.
    """

    def rates(now: Now) -> np.ndarray:
        return np.array([size * (now.surface - float(np.clip(now.surface, -SLACK, SLACK)))])

    return Term(start=(0.0,), rates=rates, surface=lambda now: float(now.own[0]))


def engine_surge(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    """The governor hunts: the thrust, which passes below the c.g., swings all along. ``size`` in
    degrees of elevator.
    """
    phase, per_degree = (
        float(rng.uniform(0.0, 2.0 * np.pi)),
        abs(vehicle.derivatives["Cm_de"]) * DEGREE,
    )
    return Term(
        loads=lambda now: (
            0.0,
            float(size * per_degree * (np.sin(SURGE * now.time + phase) - np.sin(phase))),
        )
    )


CAUSES = (
    Cause(
        "auto-trim",
        "1/s",
        (0.05, 0.15, 0.4),
        auto_trim,
        "unmeasured-input sensor-drift speed-variation",
        "elevator",
    ),
    Cause(
        "bobweight",
        "part of Cm_alpha",
        (0.2, 0.5, 1.0),
        bobweight,
        "actuator-lag elastic-mode",
        "elevator",
    ),
    Cause(
        "cable-creep",
        "part",
        (0.15, 0.35, 0.6),
        cable_creep,
        "actuator-lag actuator-second-order control-nonlinearity",
        "elevator",
    ),
    Cause(
        "engine-surge",
        "deg of elevator",
        (0.04, 0.1, 0.2),
        engine_surge,
        "gust-turbulence unmeasured-input elastic-mode",
        "",
    ),
)
