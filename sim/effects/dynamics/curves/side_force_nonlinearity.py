"""Side force that is no straight line of the angle of sideslip."""

from __future__ import annotations

from sim.declaration.proposal import Traceable
from sim.effects.loads import LoadCurve

EXPLANATION = (
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
    EXPLANATION,
    unit="1",
    size=0.01,
    needs_constants=("CY_beta",),
    angle="beta_air",
    flown="beta",
)

VARIANTS: tuple[Traceable, ...] = (SIDE_FORCE_NONLINEARITY,)
