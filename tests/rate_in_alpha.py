"""A vane ahead of the centre of gravity under another name: an effect, or a guard, that looks like
a late vane and that no effect calls alike.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import Probe, SearchContext, Traits
from sim.effects.sensor_path.sensor_mounting import VaneOffset


@dataclass(frozen=True)
class RateInAlpha:
    """alpha is read too small by ``arm``/V q, ``arm`` in m."""

    guard: bool = False

    channel: ClassVar[str] = "alpha"
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = VaneOffset.parameters
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"arm": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = "A share of the pitch rate stands in alpha."

    @property
    def name(self) -> str:
        return "guard:rate-in-alpha" if self.guard else "own:rate-in-alpha"

    @property
    def traits(self) -> Traits:
        return Traits(guard=self.guard)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return VaneOffset().probes(context)

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return VaneOffset().read(s, y, vehicle, p)
