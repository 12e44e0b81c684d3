"""Yawing moment that is no straight line of the angle of sideslip."""

from __future__ import annotations

from sim.declaration.proposal import Traceable
from sim.effects.loads import LoadCurve

EXPLANATION = (
    "The yawing moment bends away from the straight line Cn = Cn_beta beta: at larger sideslip the "
    "fin stalls, or the fuselage takes its air. "
    "Cn += f(beta), a smooth curve (natural cubic spline, four shapes) over the range flown that "
    "is zero with zero slope in trim, so that "
    "Cn_beta stays the slope there. The frequency of the Dutch roll then changes with its size, "
    "and what is left in the yaw rate depends on "
    "sideslip, not on time. Small maneuvers show nothing."
)
YAW_NONLINEARITY = LoadCurve(
    "yaw",
    "yaw-nonlinearity",
    "the yawing moment",
    "curved yawing moment",
    EXPLANATION,
    unit="1",
    size=0.002,
    needs_constants=("Cn_beta",),
    angle="beta_air",
    flown="beta",
)

VARIANTS: tuple[Traceable, ...] = (YAW_NONLINEARITY,)
