"""Drag of the deflected elevator, which the equations of the whole longitudinal axis do not
have.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits


@dataclass(frozen=True)
class ControlDrag:
    """drag += ``drag`` elevator, the deflection as a total: CD_de, per radian.

    An axial accelerometer above or below the centre of gravity reads the pitch acceleration, which
    answers the elevator at once, and so does nx where the elevator drags: without this guard the
    second is told as the first.
    """

    name: ClassVar[str] = "guard:control-drag"
    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    needs: ClassVar[tuple[str, ...]] = ("drag",)
    needs_constants: ClassVar[tuple[str, ...]] = ("Cm_de", "reference_airspeed")
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("drag", 0.1, "1/rad"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"drag": 0.0})
    traits: ClassVar[Traits] = Traits(guard=True)
    explanation: ClassVar[str] = (
        "A generic term: drag grows with the elevator. No cause of the library stands behind it. "
        "Where it explains a record better than every "
        "effect does, the cause is none of them: the longitudinal equations have no drag of the "
        "controls."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"drag": p.drag * s.elevator}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """The slope where there is none."""
        return (Probe(self.absent, ("drag",)),)


GUARDS: tuple[Traceable, ...] = (ControlDrag(),)
