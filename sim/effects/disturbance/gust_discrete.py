"""A single vertical gust of one-minus-cosine shape."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Signal, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.traits import Traits
from sim.maths.elementary import clip, cos, once_for_alike

DURATIONS = (0.25, 0.5, 1.0, 2.0, 4.0)  # s, gusts that a search tries


@dataclass(frozen=True)
class GustDiscrete:
    """The aircraft crosses one gust w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)).

    ``peak`` in m/s, positive upward; ``start`` and ``duration`` in s. Outside the gust w = 0. w/V adds to the
    angle of attack in the loads and in the vane's reading, not to the state; V is the declared airspeed.

    Attributes
    ----------
    lasting : the first half only, and w stays at its peak after it (MIL-F-8785C, 3.7.1.3; its length is V duration/2).
    fine : w + the sum of ``shape1`` ... ``shape3`` (m/s) times sin(k pi x), x from 0 to 1 over the gust, or over its rise, less what would
        change the peak: gusts that begin with a kink, rise faster than they fall, or are flat on top.
    speed : the constant that is the declared airspeed. port : ``gust``, w/V from below, or from the right on lateral equations; ``headwind``, w
        from ahead (`gust-horizontal`).
    """

    lasting: bool = False
    fine: bool = False
    speed: str = "airspeed"
    port: str = "gust"

    station: ClassVar[Station] = Station.DISTURBANCE
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        sentences=("a single gust of {peak} comes at {start} and lasts {duration}",),
        plausible={"peak": (-20.0, 20.0), "duration": (0.1, 20.0)},
        lasts="duration",
        onset="start",
        per_record=True,
    )
    explanation: ClassVar[str] = (
        "Rising air meets the aircraft once: w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)) between start and start + duration, the usual "
        "design gust. The air then comes from below by w/V more than the motion tells, in CL, in Cm and in the vane's reading, while the angle of "
        "attack as a state only follows. The vane jumps ahead of the pitch rate, which no control input can do. The length of the gust in the air "
        "is V times its duration. A second form keeps the peak after half the duration: the aircraft has flown into air that rises for good. "
        "Either has a freer form, with three shapes more: gusts that begin with a kink, rise faster than they fall, or are flat on top."
    )

    @property
    def name(self) -> str:
        return "gust-discrete" if self.port == "gust" else "gust-horizontal"

    @property
    def needs(self) -> tuple[str, ...]:
        return (self.port,)

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (self.speed,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        shapes = tuple(Parameter(name, 0.3, "m/s", bounds=(-50.0, 50.0)) for name in self._shapes)
        return (
            Parameter("peak", 3.0, "m/s", bounds=(-50.0, 50.0)),
            Parameter("start", 2.0, "s"),
            Parameter("duration", 1.0, "s", bounds=(0.05, 60.0)),
            *shapes,
        )

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(("peak", *self._shapes), 0.0))

    @property
    def _shapes(self) -> tuple[str, ...]:
        return ("shape1", "shape2", "shape3") if self.fine else ()

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        end = 0.5 if self.lasting else 1.0

        def course(start: Any, duration: Any) -> Any:
            return 0.5 * (1.0 - cos(2.0 * math.pi * clip((s.time - start) / duration, 0.0, end)))

        usual = once_for_alike(course, p.start, p.duration)
        gust = p.peak * usual
        for k, name in enumerate(self._shapes, start=1):
            # Less what it has in the middle of a gust that passes: the peak stays the speed there.
            middle = 0.0 if self.lasting else (0.0, 1.0, 0.0, -1.0)[k]
            phase = clip((s.time - p.start) / p.duration, 0.0, end)
            gust = gust + getattr(p, name) * (cos(math.pi * (k * phase / end - 0.5)) - middle * usual)
        return {self.port: gust / getattr(vehicle, self.speed) if self.port == "gust" else gust}

    def finer(self) -> GustDiscrete:
        """The same with a freer course."""
        return replace(self, fine=True)

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slope by the peak of a gust at the record's begin, for some durations; a later start only shifts it."""
        durations = [duration for duration in DURATIONS if 4.0 * context.interval <= duration <= 0.5 * context.duration]
        return tuple(Probe({**self.absent, "start": context.begin, "duration": duration}, ("peak",), shifts=True) for duration in durations)


VARIANTS: tuple[Traceable, ...] = (
    GustDiscrete(),
    GustDiscrete(lasting=True),
    *(GustDiscrete(lasting, speed="reference_airspeed", port=port) for port in ("gust", "headwind") for lasting in (False, True)),
)
