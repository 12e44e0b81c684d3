"""Pitch damping that depends on the angle of attack; not an effect of the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station


@dataclass(frozen=True)
class AlphaRateProduct:
    """moment += ``moment`` alpha q, in the unit of the moment per rad2/s."""

    name: ClassVar[str] = "own:alpha-rate-product"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("moment", 3.0, "s/rad2"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"moment": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The tail comes into the wake of the wing as the nose rises: it damps less there, or more."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"moment": p.moment * s.alpha_air * s.q}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = AlphaRateProduct()
