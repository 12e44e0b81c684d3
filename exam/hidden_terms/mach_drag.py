"""Drag of a falling body with a step over the Mach number: another form than in the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.maths import absolute, sqrt


@dataclass(frozen=True)
class MachDrag:
    """log drag += ``size`` z/sqrt(1 + z^2), z = (M - ``middle``)/``width``, M = speed/300 m/s.

    The library has the speed of sound of the standard atmosphere, and a spline as the curve.
    """

    name: ClassVar[str] = "own:mach-drag"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("log_drag",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("size", 0.3, "1"),
        Parameter("middle", 3.5, "1"),
        Parameter("width", 0.8, "1", bounds=(1e-3, 100.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ("drag-mach",)
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "A shock wave leaves the shoulder of the body at one Mach number: below it the drag is "
        "another than above."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        z = (absolute(s.velocity) / 300.0 - p.middle) / p.width
        return {"log_drag": p.size * z / sqrt(1.0 + z * z)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = MachDrag()
