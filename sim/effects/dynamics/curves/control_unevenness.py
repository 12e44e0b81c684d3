"""Control surface that works more to one side than to the other: a plain form of a control that is
no straight line.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

from sim.declaration.effect import Parameter
from sim.declaration.proposal import SearchContext, Traceable, Traits
from sim.effects.controls import SHARES, PlainControl, of_all_controls
from sim.maths import sqrt

# of the largest deflection: the kink is a curve that narrow, so that there is a slope everywhere
ROUNDED = 0.001


@dataclass(frozen=True)
class ControlUnevenness(PlainControl):
    """The moment of a deflection d is that of d + ``unevenness`` |d|: slopes of 1 + unevenness to
    the positive side, 1 - unevenness to the other.

    The vehicle's derivatives are then the means of both sides. |d| stands for sqrt(d^2 + w^2) - w,
    ``width`` w of the rounded kink in the control's unit.
    """

    width: float = 0.00005

    aliases: ClassVar[tuple[str, ...]] = ()
    bend: ClassVar[Parameter] = Parameter("unevenness", 0.2, "1", bounds=(-1.0, 1.0))
    traits: ClassVar[Traits] = Traits(
        sentences=(
            "the {control} works unequally to both sides, by {unevenness_change} about the mean "
            "(unevenness {unevenness})",
        ),
        short_name="uneven control",
        plausible={"unevenness": (-0.7, 0.7), **SHARES},
    )

    @property
    def explanation(self) -> str:
        moment = self.moment_by.partition("_")[0]
        return (
            f"The surface works more to one side than to the other: {moment} = ... + "
            f"{self.moment_by} (d + unevenness |d|) for a deflection d from "
            "trim, its other coefficients likewise. A tail near its stall, a gap that one side "
            "opens, or an actuator with two gains do this. The "
            "derivative is then the mean of both sides, and a model with one slope errs with the "
            "same sign for up and down: after a doublet it ends "
            "at another attitude than the aircraft. An input to one side alone only shows another "
            "derivative; it takes steps to both."
        )

    def curve(self, d: Any, p: Any) -> Any:
        return p.unevenness * (sqrt(d * d + self.width * self.width) - self.width)

    def fitted_to(self, context: SearchContext) -> ControlUnevenness:
        """The same with a kink as narrow as the deflections of the record ask."""
        widest, middle = self.used(context)
        return replace(self, width=ROUNDED * widest or self.width, middle=middle)


VARIANTS: tuple[Traceable, ...] = of_all_controls(ControlUnevenness, width=0.0005)
