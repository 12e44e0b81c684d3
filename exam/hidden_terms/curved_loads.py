"""Slightly nonlinear lift and moment, which a linear model of any aircraft neglects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station


@dataclass(frozen=True)
class CurvedLoads:
    """moment += ``moment_square`` alpha^2 + ``moment_cube`` alpha^3, in 1/rad2 and 1/rad3; lift
    likewise. alpha includes the gust.
    """

    name: ClassVar[str] = "own:curved-loads"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment", "lift")
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("moment_square", 0.5, "1/rad2"),
        Parameter("moment_cube", 5.0, "1/rad3"),
        Parameter("lift_square", -2.0, "1/rad2"),
        Parameter("lift_cube", -20.0, "1/rad3"),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType(
        dict.fromkeys(("moment_square", "moment_cube", "lift_square", "lift_cube"), 0.0)
    )
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ("moment-nonlinearity", "lift-nonlinearity")
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "No polar is a straight line: slopes change a little over the range flown, more on one "
        "side than on the other."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        a = s.alpha_air
        square = a * a
        return {
            "moment": square * (p.moment_square + p.moment_cube * a),
            "lift": square * (p.lift_square + p.lift_cube * a),
        }

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = CurvedLoads()
