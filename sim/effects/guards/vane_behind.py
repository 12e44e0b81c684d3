"""A vane behind the centre of gravity: the other reading of an accelerometer ahead of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.traits import Traits


@dataclass(frozen=True)
class VaneBehind:
    """alpha_m = alpha + (arm/V) q, ``arm`` in m behind the centre of gravity, not negative.

    The library has no vane there, and an accelerometer as far ahead explains every record alike. It is put beside that one alone: where its
    derivatives lie nearer to the declared ones, the accelerometer is not what is wrong.
    """

    name: ClassVar[str] = "guard:vane-behind"
    channel: ClassVar[str] = "alpha"
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("arm", 5.0, "m", bounds=(0.0, 100.0)),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"arm": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    aliases: ClassVar[tuple[str, ...]] = ("accelerometer-offset:nz",)
    traits: ClassVar[Traits] = Traits(guard=True, twins=("accelerometer-offset:nz",), equivalents=("accelerometer-offset:nz",))
    explanation: ClassVar[str] = (
        "A generic term: the angle of attack is read too early, alpha_m = alpha + (arm/V) q, as a vane behind the centre of gravity or a correction "
        "for a nose boom that is not there would do it. An accelerometer ahead of the centre of gravity gives the same record under other "
        "derivatives. Where the declared derivatives speak for this reading, no cause of the library is named."
    )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"arm": 0.0}, ("arm",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"alpha": y["alpha"] + p.arm / s.V * s.q}


GUARDS: tuple[Traceable, ...] = (VaneBehind(),)
