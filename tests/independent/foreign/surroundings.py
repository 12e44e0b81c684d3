"""From outside: the ground that is left behind, and the wake of another aircraft."""

from __future__ import annotations

import numpy as np

from tests.independent.flight import G0, Vehicle
from tests.independent.foreign.simulator import Cause, Now, Term

# rad and s: the aircraft leaves the ground effect at this angle, within this time
CLIMB, FADING = 0.02, 10.0
# s of flight: the two vortices apart, their cores, the distance at which they pass
APART, CORE, MISSED = 1.0, 0.12, 0.15
DEGREE = np.radians(1.0)


def ground_effect(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    """Trimmed beside the ground and climbing away from it: with f = exp(-height/scale), lift and
    stability are larger by ``size`` f.

    CL += size (CL_alpha alpha f + 0.2 CL_trim (f - 1)), Cm -= size (|Cm_alpha| alpha f + 0.02 (f -
    1)); height is the one own state.
    """
    d, scale = vehicle.derivatives, vehicle.airspeed * CLIMB * FADING
    trim = vehicle.mass * G0 / (0.5 * vehicle.air_density * vehicle.airspeed**2 * vehicle.wing_area)

    def loads(now: Now) -> tuple[float, float]:
        near = float(np.exp(-max(now.own[0], 0.0) / scale))
        lift = d["CL_alpha"] * now.alpha * near + 0.2 * trim * (near - 1.0)
        return size * lift, -size * (abs(d["Cm_alpha"]) * now.alpha * near + 0.02 * (near - 1.0))

    def rates(now: Now) -> np.ndarray:
        return np.array([now.airspeed * np.sin(now.theta - now.alpha)])

    return Term(start=(0.0,), rates=rates, loads=loads, climb=CLIMB)


def pair(since: float | np.ndarray) -> float | np.ndarray:
    """Vertical speed across two vortices of opposite sense with smooth cores, about one at its
    largest; ``since`` the middle, in s.
    """
    first, second = since + 0.5 * APART, since - 0.5 * APART
    room = MISSED**2 + CORE**2
    return 2.0 * np.sqrt(room) * (second / (second**2 + room) - first / (first**2 + room))


def vortex_wake(size: float, vehicle: Vehicle, duration: float, rng: np.random.Generator) -> Term:
    """The aircraft crosses the wake of another at a slant: up, down between the vortices, up.
    ``size`` in degrees of alpha.
    """
    crossed = float(rng.uniform(0.3, 0.7)) * duration

    def upwash(time: float) -> float:
        return float(size * DEGREE * vehicle.airspeed * pair(time - crossed))

    return Term(upwash=upwash)


CAUSES = (
    Cause(
        "ground-effect",
        "part",
        (0.08, 0.2, 0.5),
        ground_effect,
        "derivative-jump unmeasured-input sensor-drift",
        "",
    ),
    Cause(
        "vortex-wake",
        "deg of alpha",
        (0.2, 0.5, 1.2),
        vortex_wake,
        "gust-discrete gust-turbulence unmeasured-input",
        "",
    ),
)
