"""Drag that is no straight line of the angle of attack."""

from __future__ import annotations

from sim.declaration.proposal import Traceable
from sim.effects.loads import LoadCurve

EXPLANATION = (
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
    EXPLANATION,
    unit="1",
    size=0.01,
    needs_constants=("CD_alpha",),
    total=True,
)

VARIANTS: tuple[Traceable, ...] = (DRAG_NONLINEARITY,)
