"""A gust of half a sine: another form than the library's one-minus-cosine."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.maths import clip, cos


@dataclass(frozen=True)
class HalfSineGust:
    """w = ``peak`` sin(pi (t - start)/duration) between ``start`` and ``start + duration`` (s), m/s
    up; it begins and ends with a kink.
    """

    name: ClassVar[str] = "own:half-sine-gust"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("gust",)
    needs_constants: ClassVar[tuple[str, ...]] = ("airspeed",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("peak", 3.0, "m/s"),
        Parameter("start", 2.0, "s"),
        Parameter("duration", 1.0, "s", bounds=(0.01, math.inf)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"peak": 0.0})
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ("gust-discrete",)
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "A single gust whose speed follows half a sine: it begins and ends with a kink, as a gust "
        "does behind an obstacle."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        phase = clip((s.time - p.start) / p.duration, 0.0, 1.0)
        return {"gust": p.peak * cos(math.pi * (phase - 0.5)) / vehicle.airspeed}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = HalfSineGust()
