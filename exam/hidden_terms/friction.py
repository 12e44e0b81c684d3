"""A moment of constant size that opposes the motion; not an effect of the library."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.maths import sqrt


@dataclass(frozen=True)
class Friction:
    """moment -= ``size`` q/sqrt(q^2 + ``width``^2), width in rad/s. The moment does not depend on
    the size of a rate much larger than the width.
    """

    name: ClassVar[str] = "own:friction"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("size", 0.005, "1"),
        Parameter("width", 0.01, "rad/s", bounds=(1e-5, 10.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Something rubs, as the bearing of a model on its sting does: the moment opposes the "
        "motion whatever its speed."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"moment": -p.size * s.q / sqrt(s.q * s.q + p.width * p.width)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = Friction()
