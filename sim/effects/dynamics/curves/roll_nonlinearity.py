"""Rolling moment that is no straight line of the angle of sideslip."""

from __future__ import annotations

from sim.declaration.proposal import Traceable
from sim.effects.loads import LoadCurve

EXPLANATION = (
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
    EXPLANATION,
    unit="1",
    size=0.002,
    needs_constants=("Cl_beta",),
    angle="beta_air",
    flown="beta",
)

VARIANTS: tuple[Traceable, ...] = (ROLL_NONLINEARITY,)
