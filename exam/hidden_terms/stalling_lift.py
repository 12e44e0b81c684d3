"""Lift that levels off: another form than the library's spline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station


@dataclass(frozen=True)
class StallingLift:
    """lift -= ``loss`` alpha (alpha/``width``)^2 / (1 + (alpha/``width``)^2).

    Far beyond ``width`` (rad) the slope of CL is smaller by ``loss`` (1/rad).
    """

    name: ClassVar[str] = "own:stalling-lift"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("lift",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("loss", 2.0, "1/rad"),
        Parameter("width", 0.06, "rad", bounds=(1e-6, 10.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"loss": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ("lift-nonlinearity",)
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The flow leaves the wing little by little: lift grows ever slower on both sides of trim."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        share = (s.alpha_air / p.width) ** 2
        return {"lift": -p.loss * s.alpha_air * share / (1.0 + share)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = StallingLift()
