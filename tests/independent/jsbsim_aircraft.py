"""The aircraft that JSBSim flies here, each in two conditions in which its own trim finds level
flight that stays level and the tables of lift and moment are nearly straight: a kink within the
maneuver would be a true nonlinearity that nobody put in."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Condition:
    """Pressure altitude (ft) and calibrated airspeed (knots), the units in which JSBSim takes
    them.
    """

    altitude: float
    speed: float


@dataclass(frozen=True)
class Aircraft:
    """A model of the JSBSim package.

    ``surface`` is the property that its pitching moment reads, times ``surface_scale`` in radians.
    ``needs`` are properties of another program that its files read and that must exist, at zero.
    ``propeller`` has a pilot hold the wings level (aileron alone).
    """

    name: str
    conditions: tuple[Condition, Condition]
    surface: str = "fcs/elevator-pos-rad"
    surface_scale: float = 1.0
    needs: tuple[str, ...] = ()
    propeller: bool = False


def at(*both: tuple[float, float]) -> tuple[Condition, Condition]:
    first, second = (Condition(*one) for one in both)
    return first, second


PUSHBACK = tuple(
    f"/sim/model/pushback/{name}"
    for name in ("position-norm", "kp", "ki", "kd", "force", "target-speed-fps")
)

_ALL = (
    Aircraft("A320", at((20000, 290), (30000, 280))),
    Aircraft("MD11", at((20000, 300), (33000, 280))),
    Aircraft("fokker100", at((15000, 210), (25000, 200)), needs=("/gear/gear/wow", *PUSHBACK)),
    Aircraft("F4N", at((15000, 350), (30000, 300))),
    # The stabilator of the T-38 is given in parts of its travel, 17 degrees leading edge down.
    Aircraft(
        "T38", at((15000, 300), (30000, 280)), surface="fcs/elevator-pos-norm", surface_scale=0.297
    ),
    Aircraft("f104", at((20000, 400), (30000, 350)), needs=("systems/radar/range",)),
    Aircraft("OV10", at((5000, 200), (10000, 190)), propeller=True),
    Aircraft("t6texan2", at((8000, 200), (18000, 180)), propeller=True),
    Aircraft("Concorde", at((20000, 380), (30000, 350))),
)

AIRCRAFT = {one.name: one for one in _ALL}
