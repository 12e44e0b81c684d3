"""A moment that swings with time whatever the aircraft does: outside the library of effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.maths import cos


@dataclass(frozen=True)
class PeriodicMoment:
    """moment += ``size`` sin(``frequency`` t), frequency in rad/s: sloshing fuel, or a vortex that
    is shed at its own rhythm.
    """

    name: ClassVar[str] = "own:periodic-moment"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("size", 0.003, "1"),
        Parameter("frequency", 5.0, "rad/s"),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Something aboard swings at its own rhythm and pushes the nose up and down, whatever the "
        "controls do."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"moment": p.size * cos(p.frequency * s.time - 0.5 * math.pi)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = PeriodicMoment()
