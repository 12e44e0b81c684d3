"""Drag of a falling body that changes steadily with time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits


@dataclass(frozen=True)
class DragDrift:
    """log drag += ``rate`` (t - begin), ``rate`` in 1/s, ``begin`` the time at which beta holds,
    s.
    """

    begin: float = 0.0

    name: ClassVar[str] = "guard:drag-drift"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("log_drag",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("rate", 0.03, "1/s", bounds=(-1.0, 1.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"rate": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ("density-scale-height", "drag-mach")
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits(guard=True)
    explanation: ClassVar[str] = (
        "A generic term: the drag of a falling body grows or shrinks steadily with time, drag = "
        "exp(rate (t - begin)) * 0.5 rho v^2 / beta. "
        "No cause of the library stands behind it. Where it explains a record better than every "
        "effect does, the cause is none of them."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"log_drag": p.rate * (s.time - self.begin)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def fitted_to(self, context: SearchContext) -> DragDrift:
        """The same with the declared beta at that record's begin."""
        return replace(self, begin=context.begin)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """The slope where there is none."""
        return (Probe(self.absent, ("rate",)),)


GUARDS: tuple[Traceable, ...] = (DragDrift(),)
