"""Loads that grow with angle of attack times control: outside the library of effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station


@dataclass(frozen=True)
class AlphaControlProduct:
    """moment += ``moment`` alpha elevator, lift += ``lift`` alpha elevator, 1/rad2 both: an
    elevator that loses power in the wing's wake.
    """

    name: ClassVar[str] = "own:alpha-control-product"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment", "lift")
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("moment", 6.0, "1/rad2"),
        Parameter("lift", -2.0, "1/rad2"),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"moment": 0.0, "lift": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The tail works in the wake of the wing: the power of the elevator changes with the angle "
        "of attack."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        product = s.alpha_air * (s.delta if hasattr(s, "delta") else s.elevator)
        return {"moment": p.moment * product, "lift": p.lift * product}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = AlphaControlProduct()
