"""Drag of a falling body that oscillates; not an effect of the library."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.maths import cos


@dataclass(frozen=True)
class DragRhythm:
    """log drag += ``size`` sin(``frequency`` t), frequency in rad/s."""

    name: ClassVar[str] = "own:drag-rhythm"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("log_drag",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("size", 0.25, "1"),
        Parameter("frequency", 1.5, "rad/s"),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The body swings about its axis and shows the air now its nose, now its side."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"log_drag": p.size * cos(p.frequency * s.time - 0.5 * math.pi)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = DragRhythm()
