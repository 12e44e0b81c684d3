"""Drag of a falling body that changes steadily during the fall; not an effect of the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station


@dataclass(frozen=True)
class DragDecay:
    """log drag += ``rate`` t, 1/s."""

    name: ClassVar[str] = "own:drag-decay"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("log_drag",)
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("rate", 0.02, "1/s"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"rate": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The nose burns off and grows blunt: the drag changes steadily with time."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"log_drag": p.rate * s.time}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = DragDecay()
