"""Play between the recorded input and the vehicle: backlash (hysteresis) or a dead band
(break-out).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import (
    ABSENT,
    MANY_SIZES,
    SizedOnInput,
    all_labelled,
    for_inputs,
    half_width,
    plausible_half_width,
    played,
    sized,
    tried,
)
from sim.maths import clip, each_column


@dataclass(frozen=True)
class InputBacklash(SizedOnInput):
    """Backlash: the vehicle's input y follows the recorded input u at a distance of ``half_width``.

    It does not move while |u - y| < half_width. ``half_width`` is in the unit of the input, not
    negative. y starts at the first recorded value, in the middle of the play. Backlash is no
    differential equation, so that it has no state form; a filter can use it with a fixed width
    only.
    """

    typical: float = 0.005

    family: ClassVar[str] = "input-backlash"
    typical_share_of_peak: ClassVar[float] = 0.05
    path_order: ClassVar[int] = 30
    absent: ClassVar[Mapping[str, float]] = ABSENT
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "Play in a linkage: the far end y stays put until the near end has gone through the play, "
        "then follows, y = u - half_width on the way up and y = u + half_width on the way down. "
        "Each reversal of the input loses 2 half_width before anything moves, whatever the "
        "position, so that the response is too small and late after a reversal and the vehicle may "
        "rest off its trim after the maneuver. A dead band loses its width about zero only, with "
        "no memory: reversals away from zero tell the two apart."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return ()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return half_width(self.typical, self.unit)

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
            plausible=plausible_half_width(self.typical),
            in_input_unit=("half_width",),
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return tried(context, self.signal)

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Return the input behind the effect; exact for an input that is constant within cells.

        The loop runs over the turns of the input only.
        """
        return each_column(played, u, p.half_width)


@dataclass(frozen=True)
class InputDeadband(SizedOnInput):
    """Dead band: the vehicle's input is sign(u) max(|u| - half_width, 0).

    It is zero in the band, without a step at its edges. ``half_width`` is in the unit of the input,
    not negative. The effect has no memory, so that its state form has no states.
    """

    typical: float = 0.01

    family: ClassVar[str] = "input-deadband"
    typical_share_of_peak: ClassVar[float] = 0.1
    path_order: ClassVar[int] = 20
    absent: ClassVar[Mapping[str, float]] = ABSENT
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    online_states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Near zero the input does nothing: u_vehicle = sign(u) max(|u| - half_width, 0). A "
        "break-out force at the stick, slack in a linkage that is centred by springs, or a "
        "threshold in software do this. Outside the band the vehicle answers with its full slope "
        "but by half_width too little, so that small inputs seem weaker than large ones, and an "
        "input that crosses zero arrives late. Inputs of a single size only see a smaller control "
        "effectiveness; two sizes or more are needed, of which one is not much above the band."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("actuator-saturation", "control-nonlinearity"), self.label)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return half_width(self.typical, self.unit)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {control} {sticks} within +-{half_width} of zero (break-out)",),
            short_name="break-out",
            separating={"control-nonlinearity": MANY_SIZES},
            plausible=plausible_half_width(self.typical),
            in_input_unit=("half_width",),
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return tried(context, self.signal)

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
