"""Control surface that loses or gains power with its deflection, to both sides alike: a plain form
of a control that is no straight line.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

from sim.declaration.effect import Parameter
from sim.declaration.proposal import SearchContext, Traceable, Traits
from sim.effects.controls import SHARES, PlainControl, of_all_controls
from sim.effects.instances import all_labelled


@dataclass(frozen=True)
class ControlWeakening(PlainControl):
    """The moment of a deflection d is that of d - ``loss`` d (d/D)^2, ``widest`` D the largest
    deflection used, in the control's unit.

    There the surface has lost the share ``loss`` of its effect; negative where it has gained. The
    vehicle's derivatives are those at zero.
    """

    widest: float = 0.1

    bend: ClassVar[Parameter] = Parameter("loss", 0.2, "1", bounds=(-3.0, 1.0))
    traits: ClassVar[Traits] = Traits(
        sentences=(
            "the {control} loses the share {loss} of its effect towards its largest deflection",
        ),
        short_name="weakening control",
        plausible={"loss": (-0.7, 0.7), **SHARES},
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("actuator-saturation", "input-deadband"), self.label)

    @property
    def explanation(self) -> str:
        moment = self.moment_by.partition("_")[0]
        return (
            "Each further degree of the surface turns the flow by less, to both sides alike: "
            f"{moment} = ... + {self.moment_by} (d - loss d (d/D)^2) "
            "for a deflection d, D the largest that was used, its other coefficients likewise. A "
            "gap that opens and flow that begins to separate do "
            "this. Under an input of a few fixed levels a surface that reaches its stops looks the "
            "same; a multisine tells."
        )

    def curve(self, d: Any, p: Any) -> Any:
        return -p.loss * d * (d / self.widest) ** 2

    def fitted_to(self, context: SearchContext) -> ControlWeakening:
        """The same with the largest deflection of the record."""
        widest, middle = self.used(context)
        return replace(self, widest=widest or self.widest, middle=middle)


VARIANTS: tuple[Traceable, ...] = of_all_controls(ControlWeakening, widest=1.0)
