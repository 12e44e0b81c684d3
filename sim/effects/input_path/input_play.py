"""Play between the recorded input and the vehicle: backlash (hysteresis) or a dead band
(break-out).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from sim.declaration.effect import Signal
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits, shares_of_peak
from sim.effects.instances import (
    MANY_SIZES,
    HalfWidth,
    SizedOnInput,
    all_labelled,
    backlash,
    for_inputs,
    sized,
)
from sim.maths import clip, each_column


class _InputPlay(HalfWidth, SizedOnInput):
    """Base of backlash and dead band of an input."""

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe half widths from a small share of the input's peak to more than half of it."""
        sizes = shares_of_peak(context, self.signal, (0.04, 0.12, 0.3, 0.6))
        return [Probe({"half_width": size}) for size in sizes]


@dataclass(frozen=True)
class InputBacklash(_InputPlay):
    """Backlash: the vehicle's input y follows the recorded input u at a distance of ``half_width``.

    y does not move while |u - y| < half_width. ``half_width`` is in the unit of the input, not
    negative. y starts at the first recorded value, in the middle of the play. Backlash cannot be
    written as a differential equation, so a filter can use it with a fixed width only.
    """

    typical: float = 0.005

    family: ClassVar[str] = "input-backlash"
    typical_share_of_peak: ClassVar[float] = 0.05
    path_order: ClassVar[int] = 30
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "There is play in a linkage. The output y of the linkage rests until the input u has "
        "crossed the play, and then follows: y = u - half_width while u rises and y = u + "
        "half_width while u falls. After each reversal the input moves by 2 half_width before the "
        "output moves, at any deflection. The response is therefore too small and late after a "
        "reversal, and the vehicle may not return to trim after the maneuver. A dead band has no "
        "memory and acts about zero only, so reversals away from zero distinguish the two."
    )

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {control} has a play of +-{half_width} (hysteresis)",),
            short_name="hysteresis",
            separating={
                "input-deadband": (
                    "small slow reversals about a deflected control: a play acts there, a dead "
                    "band about zero does not"
                )
            },
            plausible=self.plausible,
            in_input_unit=("half_width",),
        )

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Return the input behind the effect; exact for an input that is constant within cells."""
        return each_column(backlash, u, p.half_width)


@dataclass(frozen=True)
class InputDeadband(_InputPlay):
    """Dead band: the vehicle's input is sign(u) max(|u| - half_width, 0).

    It is zero in the band, without a step at its edges. ``half_width`` is in the unit of the input,
    not negative. The effect has no memory, so that its state form has no states.
    """

    typical: float = 0.01

    family: ClassVar[str] = "input-deadband"
    typical_share_of_peak: ClassVar[float] = 0.1
    path_order: ClassVar[int] = 20
    online_states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Near zero the input has no effect: u_vehicle = sign(u) max(|u| - half_width, 0). Causes "
        "are a break-out force at the stick, slack in a linkage that is centred by springs, or a "
        "threshold in software. Outside the band the vehicle responds with its full control "
        "effectiveness, but to an input that is too small by half_width. Small inputs therefore "
        "seem weaker than large ones, and an input that crosses zero arrives late. Inputs of a "
        "single size only show a smaller control effectiveness. At least two sizes are needed, one "
        "of them not much above the band."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("actuator-saturation", "control-nonlinearity"), self.label)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {control} {sticks} within +-{half_width} of zero (break-out)",),
            short_name="break-out",
            separating={"control-nonlinearity": MANY_SIZES},
            plausible=self.plausible,
            in_input_unit=("half_width",),
        )

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Return the input behind the effect; exact for an input that is constant within cells."""
        return each_column(lambda row, width: row - clip(row, -width, width), u, p.half_width)

    def rates(self, v: Any, x: Sequence[Any], p: Any) -> Sequence[Any]:
        return ()

    def pass_on(self, v: Any, x: Sequence[Any], p: Any) -> Any:
        return v - clip(v, -p.half_width, p.half_width)


VARIANTS: tuple[Traceable, ...] = (
    InputBacklash(),
    InputBacklash("stick", "1", 0.05),
    InputDeadband(),
    InputDeadband("stick", "1", 0.1),
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return the effects of this file for each input that ``VARIANTS`` does not cover."""
    return for_inputs(equations, sized(InputBacklash, 0.05), sized(InputDeadband, 0.1))
