"""Pitching moment that is no straight line of the angle of attack."""

from __future__ import annotations

from dataclasses import replace

from sim.declaration.proposal import Traceable
from sim.effects.loads import LoadCurve

EXPLANATION = (
    "The pitching moment bends away from the straight line Cm = Cm_alpha alpha: at larger angles "
    "the aircraft grows stiffer, loses stability "
    "or pitches up. Cm += f(alpha), a smooth curve (natural cubic spline, four shapes) over the "
    "range flown that is zero with zero slope in "
    "trim, so that Cm_alpha stays the slope there. Small maneuvers show nothing; the frequency of "
    "the short period changes with the size of "
    "the motion, and the residual of the pitch rate depends on alpha, not on time."
)
MOMENT_NONLINEARITY = LoadCurve(
    "moment",
    "moment-nonlinearity",
    "the pitching moment",
    "curved pitching moment",
    EXPLANATION,
    unit="1",
    size=0.01,
    needs_constants=("Cm_alpha", "airspeed"),
)

VARIANTS: tuple[Traceable, ...] = (
    MOMENT_NONLINEARITY,
    replace(
        MOMENT_NONLINEARITY,
        low=-0.04,
        high=0.04,
        unit="1/s2",
        size=0.1,
        needs_constants=("M_alpha",),
    ),
    replace(MOMENT_NONLINEARITY, total=True, needs_constants=("Cm_alpha", "reference_airspeed")),
)
