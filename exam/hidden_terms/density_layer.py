"""A layer of denser or thinner air; not an effect of the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.maths import exp


@dataclass(frozen=True)
class DensityLayer:
    """log density += ``size`` exp(-((altitude - ``middle``)/``depth``)^2), m."""

    name: ClassVar[str] = "own:density-layer"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("log_density",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("size", 0.3, "1"),
        Parameter("middle", 18000.0, "m"),
        Parameter("depth", 2500.0, "m", bounds=(1.0, 1e6)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Between two heights the air is colder than the declared one, and thicker; above and below "
        "it is as declared."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        off = (s.altitude - p.middle) / p.depth
        return {"log_density": p.size * exp(-off * off)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = DensityLayer()
