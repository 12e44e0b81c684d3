"""Masses that move: fuel, a load that has come loose, the aircraft about its other axes, a store
that flutters.
"""

from __future__ import annotations

import numpy as np

from tests.independent.flight import G0, Vehicle
from tests.independent.foreign.simulator import Cause, Now, Term

# rad/s (a long shallow tank; no structure bends so slowly) and damping ratio
SLOSH, SLOSH_DAMPING = 2.2, 0.03
FRICTION = np.radians(0.7)  # slope at which the load begins to slide
RUN = 1.0 / np.radians(1.0)  # of its way a second, for each radian of slope beyond the friction
DUTCH_ROLL, SPIRAL_SHARE, INERTIAS = 1.8, 0.35, 0.8  # rad/s; yaw rate per roll rate; (Iz - Ix)/Iy
FLUTTER = 2.0 * np.pi * 3.0  # rad/s
# excitation less damping, as a damping ratio, in trim and as much again for every degree of alpha
NEAR = 0.03


def trim_lift(vehicle: Vehicle) -> float:
    """CL that carries the weight at the trim speed."""
    return vehicle.mass * G0 / (0.5 * vehicle.air_density * vehicle.airspeed**2 * vehicle.wing_area)


def fuel_slosh(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    """Fuel in a long tank seeks the level of the apparent gravity: psi'' = omega^2 (alpha - psi) -
    2 zeta omega psi' - q'.

    Lift stands across the path, so that the level lies alpha off the floor. Fuel that has run aft
    pitches up: Cm += size |Cm_alpha| nz psi, ``size`` what the fuel, held at its level, would take
    off the stability.
    """
    d, slope, rate = vehicle.derivatives, vehicle.moment_slope, vehicle.rate_time

    def rates(now: Now) -> np.ndarray:
        level, going = (float(value) for value in now.own)
        q_rate = slope * (
            d["Cm_alpha"] * now.alpha + d["Cm_q"] * rate * now.q + d["Cm_de"] * now.surface
        )
        return np.array(
            [going, SLOSH**2 * (now.alpha - level) - 2.0 * SLOSH_DAMPING * SLOSH * going - q_rate]
        )

    return Term(
        start=(0.0, 0.0),
        rates=rates,
        loads=lambda now: (0.0, size * abs(d["Cm_alpha"]) * now.load * float(now.own[0])),
    )


def payload_slides(
    size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator
) -> Term:
    """A load slides aft when the floor is steeper than its friction, and forward again: x from 0 to
    1, Cm += size CL nz x.
    """
    trim = trim_lift(vehicle)

    def rates(now: Now) -> np.ndarray:
        x = float(now.own[0])
        going = RUN * (now.alpha - float(np.clip(now.alpha, -FRICTION, FRICTION)))
        return np.array(
            [0.0 if (x <= 0.0 and going < 0.0) or (x >= 1.0 and going > 0.0) else going]
        )

    return Term(
        start=(0.0,),
        rates=rates,
        loads=lambda now: (0.0, size * trim * now.load * float(np.clip(now.own[0], 0.0, 1.0))),
    )


def inertia_coupling(
    size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator
) -> Term:
    """A rocking to ``size`` rad of bank and a yawing beside it: q' += (Iz - Ix)/Iy p r, and the
    weight tilts out of the plane.
    """
    phase = float(rng.uniform(0.0, 2.0 * np.pi))

    def bank(time: float) -> float:
        return size * (1.0 - np.exp(-time)) * np.sin(DUTCH_ROLL * time + phase)

    def loads(now: Now) -> tuple[float, float]:
        roll_rate = (
            size * (1.0 - np.exp(-now.time)) * DUTCH_ROLL * np.cos(DUTCH_ROLL * now.time + phase)
        )
        yaw_rate = (
            SPIRAL_SHARE
            * size
            * (1.0 - np.exp(-now.time))
            * DUTCH_ROLL
            * np.sin(DUTCH_ROLL * now.time + phase + 0.6)
        )
        return 0.0, INERTIAS * roll_rate * yaw_rate / vehicle.moment_slope

    return Term(loads=loads, bank=bank)


def store_flutter(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    """A store on its pylon swings near a limit cycle (van der Pol): driven by the flow the more
    alpha is up; ``size`` g in the full cycle.

    eta'' = -omega^2 eta + 2 nu omega (1 - eta^2) eta', nu = NEAR (1 + alpha in degrees); a full
    cycle has an amplitude of 2.
    """
    per_g = trim_lift(vehicle)

    def rates(now: Now) -> np.ndarray:
        eta, going = (float(value) for value in now.own)
        excited = NEAR * (1.0 + np.degrees(now.alpha))
        damped = excited * (1.0 - eta**2) if excited > 0.0 else excited
        return np.array([going, -(FLUTTER**2) * eta + 2.0 * damped * FLUTTER * going])

    def loads(now: Now) -> tuple[float, float]:
        lift = 0.5 * size * per_g * float(now.own[0])
        return lift, -0.1 * lift

    return Term(start=(float(rng.uniform(0.2, 0.6)), 0.0), rates=rates, loads=loads)


CAUSES = (
    Cause(
        "fuel-slosh",
        "part of Cm_alpha",
        (0.01, 0.03, 0.07),
        fuel_slosh,
        "elastic-mode phugoid unmeasured-input",
        "",
    ),
    Cause(
        "inertia-coupling",
        "rad of bank",
        (0.1, 0.2, 0.35),
        inertia_coupling,
        "unmeasured-input gust-turbulence",
        "",
    ),
    Cause(
        "payload-slides",
        "part of mass times chords",
        (0.003, 0.008, 0.02),
        payload_slides,
        "derivative-jump unmeasured-input",
    ),
    # A store that swings on its pylon is a structure that bends; what it is not is an oscillator
    # with damping, and no reader would miss that name.
    Cause(
        "store-flutter",
        "g",
        (0.02, 0.05, 0.12),
        store_flutter,
        "gust-turbulence",
        "nz",
        right="elastic-mode",
    ),
)
