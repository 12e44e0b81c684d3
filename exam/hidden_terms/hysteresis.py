"""A moment with hysteresis in the pitch rate; not an effect of the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.maths import absolute


@dataclass(frozen=True)
class Hysteresis:
    """moment += ``size`` z, z_dot = (q - |q| z)/``width``.

    z tends to the sign of q over a rotation by ``width``, rad, and is constant at rest.
    """

    name: ClassVar[str] = "own:hysteresis"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("size", 0.01, "1"),
        Parameter("width", 0.03, "rad", bounds=(1e-4, 10.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = (
        Signal("memory", "1", "which way the nose went last, -1 to 1"),
    )
    explanation: ClassVar[str] = (
        "The flow attaches later than it left: going up the moment is another than going down."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"moment": p.size * s.memory}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ((s.q - absolute(s.q) * s.memory) / p.width,)


TERM = Hysteresis()
