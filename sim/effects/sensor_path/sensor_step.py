"""The zero of one output channel jumps at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import STEADY_FLIGHT, further_outputs, has_output_size, large_output
from sim.effects.timing import risen


@dataclass(frozen=True)
class SensorStep:
    """From the time ``at`` on the recorded channel has ``size`` added to it.

    ``at`` in s, ``size`` in the unit of the channel, either sign. Each record has its own. The edge
    rises over ``width`` s, centred on ``at``: one sampling interval in a search, so that the fit
    feels the sample next to it; the time is then known to half an interval at best, however small
    its sigma.

    Attributes
    ----------
    channel, unit : the output it acts on. typical : the starting size; believed up to twenty times
    that, or any where the unit is
        not one whose sizes are known (``sized``). width : of the edge, s.
    """

    channel: str
    unit: str
    typical: float
    width: float = 0.02
    sized: bool = True

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 20
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "The sensor's zero jumps while the record runs and stays there: y_recorded = y + bias + "
        "size from the time at on. A vane that is knocked, a "
        "connector that slips, an amplifier that changes its range and a resynchronised encoder do "
        "this. Before and after, the motion is that of "
        "the model; no other channel takes part, which no force on the aircraft could leave so: a "
        "load that nobody recorded would move all "
        "channels, and over the time of a short period. The step belongs to one record."
    )

    @property
    def name(self) -> str:
        return f"sensor-step:{self.channel}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("at", 3.0, "s"), Parameter("size", self.typical, self.unit))

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the zero of the {channel} jumps by {size} at {at}",),
            separating=dict.fromkeys(("sensor-drift", "unmeasured-input"), STEADY_FLIGHT),
            # Twenty times what is usual: beyond (1 km of altitude, 2 g) a recorder has lost rows,
            # and its channels go on from elsewhere.
            plausible={"size": (-20.0 * self.typical, 20.0 * self.typical)} if self.sized else {},
            onset="at",
            per_record=True,
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """The slope by the size at the record's begin; a later step only shifts it."""
        return [
            Probe(
                {"at": context.begin + 0.5 * self.width, **self.absent},
                ("size",),
                shifts=True,
                sharp=True,
            )
        ]

    def fitted_to(self, context: SearchContext) -> SensorStep:
        """The same with an edge of one sampling interval of that record."""
        return replace(self, width=context.interval if context.interval > 0 else self.width)

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: y[self.channel] + p.size * risen(s.time, p.at, self.width)}


VARIANTS: tuple[Traceable, ...] = (
    SensorStep("alpha", "rad", 0.01),
    SensorStep("q", "rad/s", 0.01),
    SensorStep("nz", "g", 0.1),
    SensorStep("altitude", "m", 50.0),
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """One for each output that has none yet."""
    outputs = further_outputs(equations)
    return tuple(
        SensorStep(
            each.name, each.unit, 0.05 * large_output(each.unit), sized=has_output_size(each.unit)
        )
        for each in outputs
    )
