"""Terms that only a truth has: no model is ever fitted with them.

They are written like the effects of `sim/effects` but never offered to the loop. To add one that a
scenario hides, write an effect named `own:NAME` and put it into ``TERMS``. Those that no scenario
hides are in `exam/hidden_terms`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Effect, Parameter, Regularity, Signal, Station
from sim.maths import clip, cos, exp


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


PRODUCT = AlphaControlProduct()


@dataclass(frozen=True)
class DragBucket:
    """drag += ``depth`` x^2 / (1 + x^2), x = (alpha - ``middle``)/``width``.

    Zero in the middle of the bucket (rad), ``depth`` (1) far outside of its ``width`` (rad); the
    gust included.
    """

    name: ClassVar[str] = "own:drag-bucket"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("drag",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("depth", 0.03, "1"),
        Parameter("middle", 0.0, "rad"),
        Parameter("width", 0.05, "rad", bounds=(1e-6, 10.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"depth": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    aliases: ClassVar[tuple[str, ...]] = ("drag-nonlinearity",)
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Within a narrow range of lift the flow stays laminar and the drag is low; outside it "
        "rises and levels off."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        square = ((s.alpha_air - p.middle) / p.width) ** 2
        return {"drag": p.depth * square / (1.0 + square)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


BUCKET = DragBucket()


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


HALF_SINE = HalfSineGust()


@dataclass(frozen=True)
class PeriodicMoment:
    """moment += ``size`` sin(``frequency`` t), frequency in rad/s: sloshing fuel, or a vortex that
    is shed at its own rhythm.
    """

    name: ClassVar[str] = "own:periodic-moment"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("size", 0.003, "1"),
        Parameter("frequency", 5.0, "rad/s"),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Something aboard swings at its own rhythm and pushes the nose up and down, whatever the "
        "controls do."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"moment": p.size * cos(p.frequency * s.time - 0.5 * math.pi)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


PERIODIC = PeriodicMoment()


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


TANH = TanhMoment()


TERMS: tuple[Effect, ...] = (PRODUCT, BUCKET, HALF_SINE, PERIODIC, TANH)
