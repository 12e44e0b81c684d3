"""Forces and moments that are no straight line of the angle of attack or of sideslip, one effect
for each axis.
"""

from __future__ import annotations

from dataclasses import replace

from sim.declaration.proposal import Traceable
from sim.effects.loads import LoadCurve

DRAG_EXPLANATION = (
    "The drag bends away from the straight line CD = CD_0 + CD_alpha alpha: a polar is a parabola "
    "of the lift at least. CD += f(alpha), a "
    "smooth curve (natural cubic spline, four shapes) over the range flown that is zero with zero "
    "slope in its middle, so that CD_0 and CD_alpha "
    "are the tangent there. The axial load factor shows it at once, the airspeed over seconds, the "
    "rates hardly."
)
DRAG_NONLINEARITY = LoadCurve(
    "drag",
    "drag-nonlinearity",
    "the drag",
    "curved drag",
    DRAG_EXPLANATION,
    unit="1",
    size=0.01,
    needs_constants=("CD_alpha",),
    total=True,
)


LIFT_EXPLANATION = (
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
    explanation=LIFT_EXPLANATION,
    unit="1",
    size=0.02,
    needs_constants=("CL_alpha", "airspeed"),
)


MOMENT_EXPLANATION = (
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
    MOMENT_EXPLANATION,
    unit="1",
    size=0.01,
    needs_constants=("Cm_alpha", "airspeed"),
)


ROLL_EXPLANATION = (
    "The rolling moment bends away from the straight line Cl = Cl_beta beta: the dihedral effect "
    "grows or fades with sideslip, as of a swept "
    "wing near stall or a wing in the wake of the fuselage. Cl += f(beta), a smooth curve (natural "
    "cubic spline, four shapes) over the range "
    "flown that is zero with zero slope in trim, so that Cl_beta stays the slope there. What is "
    "left in the roll rate depends on sideslip, not "
    "on time; small maneuvers show nothing."
)
ROLL_NONLINEARITY = LoadCurve(
    "roll",
    "roll-nonlinearity",
    "the rolling moment",
    "curved rolling moment",
    ROLL_EXPLANATION,
    unit="1",
    size=0.002,
    needs_constants=("Cl_beta",),
    angle="beta_air",
    flown="beta",
)


SIDE_FORCE_EXPLANATION = (
    "The side force bends away from the straight line CY = CY_beta beta: fin and fuselage at "
    "larger sideslip do not carry in proportion. CY += "
    "f(beta), a smooth curve (natural cubic spline, four shapes) over the range flown that is zero "
    "with zero slope in trim, so that CY_beta "
    "stays the slope there. The lateral load factor shows it at once, sideslip later, the rates "
    "hardly."
)
SIDE_FORCE_NONLINEARITY = LoadCurve(
    "side_force",
    "side-force-nonlinearity",
    "the side force",
    "curved side force",
    SIDE_FORCE_EXPLANATION,
    unit="1",
    size=0.01,
    needs_constants=("CY_beta",),
    angle="beta_air",
    flown="beta",
)


YAW_EXPLANATION = (
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
    YAW_EXPLANATION,
    unit="1",
    size=0.002,
    needs_constants=("Cn_beta",),
    angle="beta_air",
    flown="beta",
)


VARIANTS: tuple[Traceable, ...] = (
    DRAG_NONLINEARITY,
    LIFT_NONLINEARITY,
    replace(
        LIFT_NONLINEARITY, low=-0.04, high=0.04, unit="1/s", size=0.02, needs_constants=("L_alpha",)
    ),
    replace(LIFT_NONLINEARITY, total=True, needs_constants=("CL_alpha", "reference_airspeed")),
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
    ROLL_NONLINEARITY,
    SIDE_FORCE_NONLINEARITY,
    YAW_NONLINEARITY,
)
