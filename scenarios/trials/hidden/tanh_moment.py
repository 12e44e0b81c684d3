"""A pitching moment that saturates like a hyperbolic tangent: another form than the library's
spline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.maths import exp


@dataclass(frozen=True)
class TanhMoment:
    """moment += ``loss`` (alpha - ``width`` tanh(alpha/width)): the slope of Cm grows by ``loss``
    (1/rad) beyond ``width`` (rad).
    """

    name: ClassVar[str] = "own:tanh-moment"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("loss", 0.5, "1/rad"),
        Parameter("width", 0.04, "rad", bounds=(1e-6, 10.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"loss": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    aliases: ClassVar[tuple[str, ...]] = ("moment-nonlinearity",)
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The pitching moment is steep near trim and flattens on both sides, as where a strake's "
        "vortex loses its grip."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        # tanh by the exponential: it has to broadcast and survive a complex step like every
        # equation of the simulation.
        grown = exp(2.0 * s.alpha_air / p.width)
        return {"moment": p.loss * (s.alpha_air - p.width * (grown - 1.0) / (grown + 1.0))}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = TanhMoment()
