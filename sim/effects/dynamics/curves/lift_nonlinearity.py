"""Lift that is no straight line of the angle of attack."""

from __future__ import annotations

from dataclasses import replace

from sim.declaration.proposal import Traceable
from sim.effects.loads import LoadCurve

EXPLANATION = (
    "The lift bends away from the straight line CL = CL_alpha alpha: near separation it falls "
    "short, with vortices it grows faster. CL += "
    "f(alpha), a smooth curve (natural cubic spline, four shapes) over the range flown that is "
    "zero with zero slope in trim, so that CL_alpha "
    "stays the slope there. The load factor shows it at once, the path later, the pitch rate "
    "hardly: what is left over in nz depends on alpha "
    "alone. Without nz it must be told from the damping of the short period, and a record rarely "
    "can."
)
LIFT_NONLINEARITY = LoadCurve(
    port="lift",
    name="lift-nonlinearity",
    load="the lift",
    short_name="curved lift",
    explanation=EXPLANATION,
    unit="1",
    size=0.02,
    needs_constants=("CL_alpha", "airspeed"),
)

VARIANTS: tuple[Traceable, ...] = (
    LIFT_NONLINEARITY,
    replace(
        LIFT_NONLINEARITY, low=-0.04, high=0.04, unit="1/s", size=0.02, needs_constants=("L_alpha",)
    ),
    replace(LIFT_NONLINEARITY, total=True, needs_constants=("CL_alpha", "reference_airspeed")),
)
