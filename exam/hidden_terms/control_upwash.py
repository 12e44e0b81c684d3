"""A vane that is affected by the control surface; not an effect of the library."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station


@dataclass(frozen=True)
class ControlUpwash:
    """alpha_m = alpha + ``gain`` d, where d is the elevator (rad) or the pseudo-control (unit of
    the stick).
    """

    name: ClassVar[str] = "own:control-upwash"
    channel: ClassVar[str] = "alpha"
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("gain", 0.1, "1"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"gain": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "The vane sits beside a canard: the flow that the surface turns is read as an angle of "
        "attack."
    )

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"alpha": y["alpha"] + p.gain * (s.delta if hasattr(s, "delta") else s.elevator)}


TERM = ControlUpwash()
