"""A limit of the travel between the recorded input and the vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits, shares_of_peak
from sim.effects.instances import (
    MANY_SIZES,
    all_labelled,
    further_inputs,
    has_size,
    labelled,
    large_input,
)
from sim.maths import clip, each_column

UNLIMITED = 1e9


@dataclass(frozen=True)
class ActuatorSaturation:
    """The vehicle feels max(-limit, min(u, limit)): the same limit on both sides of trim.

    ``limit`` in the unit of the input; at ``UNLIMITED`` it is taken as absent. Without memory: the
    state form has no states.

    Attributes
    ----------
    signal, unit : the input it acts on. typical : the starting value, unless not ``sized``. label :
    of the name, where there are several inputs.
    """

    signal: str = "elevator"
    unit: str = "rad"
    typical: float = 0.05
    label: str = ""
    sized: bool = True

    station: ClassVar[Station] = Station.INPUT_PATH
    rank: ClassVar[int] = 60
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"limit": UNLIMITED})
    regularity: ClassVar[Regularity] = Regularity.INACTIVE
    online_states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The surface stops at a limit although the command goes on: u_vehicle = max(-limit, min(u, "
        "limit)). Below the limit nothing is different, "
        "above it more command brings no more response. It is invisible in a record that stays "
        "below the limit, and where all inputs are of one "
        "size it only looks like a smaller control effectiveness: it takes inputs of several "
        "sizes, on both sides of the limit. The limit counts "
        "from where the recorded input does: from trim where that is a perturbation, from its zero "
        "where it is a total."
    )

    @property
    def name(self) -> str:
        return labelled("actuator-saturation", self.label)

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("input-deadband", "control-nonlinearity"), self.label)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("limit", self.typical, self.unit, bounds=(0.0, UNLIMITED)),)

    @property
    def traits(self) -> Traits:
        """Believed from a tenth to ten times the typical value: for an elevator from a third of a
        degree to half a right angle.
        """
        return Traits(
            sentences=("the actuator stops at +-{limit}",),
            short_name="actuator stop",
            separating={"input-deadband": MANY_SIZES, "control-nonlinearity": MANY_SIZES},
            plausible={"limit": (0.1 * self.typical, 10.0 * self.typical)},
            in_input_unit=("limit",),
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [
            Probe({"limit": size})
            for size in shares_of_peak(context, self.signal, (0.95, 0.85, 0.7, 0.5))
        ]

    def fitted_to(self, context: SearchContext) -> ActuatorSaturation:
        """The same; where nothing is known of the input's unit, of a size that its record asks
        for.
        """
        peak = context.input_peak.get(self.signal, 0.0)
        return self if self.sized or not peak > 0.0 else replace(self, typical=0.5 * peak)

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        """Exact for an input that is constant within cells."""
        return each_column(lambda row, limit: clip(row, -limit, limit), u, p.limit)

    def rates(self, v: Any, x: Sequence[Any], p: Any) -> Sequence[Any]:
        return ()

    def pass_on(self, v: Any, x: Sequence[Any], p: Any) -> Any:
        return clip(v, -p.limit, p.limit)


VARIANTS: tuple[Traceable, ...] = (ActuatorSaturation(), ActuatorSaturation("stick", "1", 0.5))


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """One for each input that has none yet."""
    return tuple(
        ActuatorSaturation(
            signal.name, signal.unit, 0.5 * large_input(signal.unit), label, has_size(signal.unit)
        )
        for signal, label in further_inputs(equations)
    )
