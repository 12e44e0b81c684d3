"""Shared parts of effects of the air: the course of a gust, and the reading of a displaced vane."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

from sim.declaration.effect import Parameter
from sim.declaration.proposal import Probe, SearchContext
from sim.maths import clip, cos, once_for_alike

# ---- A single gust of one-minus-cosine shape

SHAPES = ("shape1", "shape2", "shape3")
PLAUSIBLE: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"peak": (-20.0, 20.0), "duration": (0.1, 20.0)}
)
DURATIONS = (0.25, 0.5, 1.0, 2.0, 4.0)  # s, gusts that a search tries


def gust_parameters(fine: bool) -> tuple[Parameter, ...]:
    """``peak`` and three shapes where ``fine``, m/s; ``start`` and ``duration``, s."""
    shapes = tuple(
        Parameter(name, 0.3, "m/s", bounds=(-50.0, 50.0)) for name in (SHAPES if fine else ())
    )
    return (
        Parameter("peak", 3.0, "m/s", bounds=(-50.0, 50.0)),
        Parameter("start", 2.0, "s"),
        Parameter("duration", 1.0, "s", bounds=(0.05, 60.0)),
        *shapes,
    )


def calm_air(fine: bool) -> Mapping[str, float]:
    """Values at which there is no gust."""
    return MappingProxyType(dict.fromkeys(("peak", *(SHAPES if fine else ())), 0.0))


def gust_speed(time: Any, p: Any, lasting: bool, fine: bool) -> Any:
    """w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)), m/s, zero outside the gust; with
    ``lasting`` the first half, and then the peak.

    With ``fine`` + the sum of ``shape1`` ... ``shape3`` times sin(k pi x), x from 0 to 1 over the
    gust, or over its rise, less what would change the peak. ``time`` in s; ``p`` has the parameters
    of ``gust_parameters``.
    """
    end = 0.5 if lasting else 1.0

    def passed(start: Any, duration: Any) -> Any:
        return clip((time - start) / duration, 0.0, end)

    def course(start: Any, duration: Any) -> Any:
        return 0.5 * (1.0 - cos(2.0 * math.pi * passed(start, duration)))

    def shape(k: int, start: Any, duration: Any) -> Any:
        # Less what it has in the middle of a gust that passes: the peak stays the speed there.
        middle = 0.0 if lasting else (0.0, 1.0, 0.0, -1.0)[k]
        swing = cos(math.pi * (k * passed(start, duration) / end - 0.5))
        return swing - middle * course(start, duration) if middle else swing

    gust = p.peak * once_for_alike(course, p.start, p.duration)
    for k, name in enumerate(SHAPES if fine else (), start=1):
        gust = gust + getattr(p, name) * once_for_alike(partial(shape, k), p.start, p.duration)
    return gust


def gust_probes(context: SearchContext, fine: bool) -> Sequence[Probe]:
    """Slope by the peak of a gust at the record's begin, for some durations; a later start only
    shifts it.
    """
    durations = [
        duration
        for duration in DURATIONS
        if 4.0 * context.interval <= duration <= 0.5 * context.duration
    ]
    return tuple(
        Probe(
            {**calm_air(fine), "start": context.begin, "duration": duration}, ("peak",), shifts=True
        )
        for duration in durations
    )


# ---- What a vane away from the centre of gravity reads of the turning of the aircraft


def at_arm(s: Any, vehicle: Any, arm: Any, rate: str, speed: str) -> Any:
    """(arm/V) rate, rad: V the airspeed at the time, or the declared one of equations without;
    ``arm`` in m, ``rate`` and ``speed`` by name.
    """
    V = s.V if hasattr(s, "V") else getattr(vehicle, speed)
    return arm / V * getattr(s, rate)
