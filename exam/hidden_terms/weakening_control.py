"""A control surface whose effect falls at large deflections: another form than the library's
spline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station


@dataclass(frozen=True)
class WeakeningControl:
    """The elevator acts as d - ``cubic`` d^3 (1/rad2), in lift and in moment."""

    name: ClassVar[str] = "own:weakening-control"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment", "lift")
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("cubic", 50.0, "1/rad2"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"cubic": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ("control-nonlinearity",)
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The gap of the elevator opens as it deflects: each further degree turns the flow by less."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        if hasattr(s, "delta"):  # the low-order equivalent has a pseudo-control
            lost = -p.cubic * s.delta**3
            return {"moment": vehicle.M_delta * lost, "lift": vehicle.L_delta * lost}
        lost = -p.cubic * s.elevator**3
        return {"moment": vehicle.Cm_de * lost, "lift": vehicle.CL_de * lost}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = WeakeningControl()
