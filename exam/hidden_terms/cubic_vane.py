"""A vane with a cubic calibration error; not an effect of the library."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station


@dataclass(frozen=True)
class CubicVane:
    """alpha_m = alpha + ``cubic`` alpha^3 (1/rad2); the curve of the library has the square."""

    name: ClassVar[str] = "own:cubic-vane"
    channel: ClassVar[str] = "alpha"
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("cubic", 50.0, "1/rad2"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"cubic": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ("sensor-curve:alpha",)
    explanation: ClassVar[str] = (
        "The vane turns a potentiometer that is not quite linear, to both sides alike."
    )

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"alpha": y["alpha"] + p.cubic * y["alpha"] ** 3}


TERM = CubicVane()
