"""Pitch damping that increases with the rate; not an effect of the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.maths import absolute


@dataclass(frozen=True)
class RateDamping:
    """moment += ``size`` q |q|, ``size`` in the unit of the moment per (rad/s)2; a negative size
    damps.
    """

    name: ClassVar[str] = "own:rate-damping"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("size", -0.5, "s2/rad2"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The tail leaves its straight range in fast pitching: damping grows with the rate itself."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"moment": p.size * s.q * absolute(s.q)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = RateDamping()
