"""Gusts: a single one-minus-cosine gust, vertical or from ahead, and Dryden turbulence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, ClassVar, Self

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import WithoutStates
from sim.maths import clip, cos, once_for_alike

# ---- A single gust of one-minus-cosine shape

SHAPES = ("shape1", "shape2", "shape3")  # further parameters of the refined form
PLAUSIBLE: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"peak": (-20.0, 20.0), "duration": (0.1, 20.0)}
)
DURATIONS = (0.25, 0.5, 1.0, 2.0, 4.0)  # s, trial values


@dataclass(frozen=True)
class SingleGust(WithoutStates):
    """A gust of the speed w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)).

    Outside the gust w = 0. ``peak`` is in m/s; ``start`` and ``duration`` are in s. The refined
    form adds the sum of ``shape1`` ... ``shape3`` (m/s) times sin(k pi x), where x runs from 0 to 1
    over the gust or its rise, minus the values of the shapes at the peak. It describes gusts that
    begin with a kink, rise faster than they fall, or are flat on top.

    Attributes
    ----------
    lasting : whether w keeps its peak after the first half (MIL-F-8785C, 3.7.1.3; the length of
        that gust is V duration/2).
    fine : whether this is the refined form.
    """

    lasting: bool = False
    fine: bool = False

    station: ClassVar[Station] = Station.DISTURBANCE
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("peak", 3.0, "m/s", bounds=(-50.0, 50.0)),
            Parameter("start", 2.0, "s"),
            Parameter("duration", 1.0, "s", bounds=(0.05, 60.0)),
            *(Parameter(name, 0.3, "m/s", bounds=(-50.0, 50.0)) for name in self._shapes),
        )

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(("peak", *self._shapes), 0.0))

    @property
    def _shapes(self) -> tuple[str, ...]:
        return SHAPES if self.fine else ()

    def speed_at(self, time: Any, p: Any) -> Any:
        """Return w at the ``time`` (s), m/s."""
        end = 0.5 if self.lasting else 1.0

        def passed(start: Any, duration: Any) -> Any:
            return clip((time - start) / duration, 0.0, end)

        def course(start: Any, duration: Any) -> Any:
            return 0.5 * (1.0 - cos(2.0 * math.pi * passed(start, duration)))

        def shape(k: int, start: Any, duration: Any) -> Any:
            # The value in the middle of the gust is subtracted, so that ``peak`` is w there.
            middle = 0.0 if self.lasting else (0.0, 1.0, 0.0, -1.0)[k]
            swing = cos(math.pi * (k * passed(start, duration) / end - 0.5))
            return swing - middle * course(start, duration) if middle else swing

        gust = p.peak * once_for_alike(course, p.start, p.duration)
        for k, name in enumerate(self._shapes, start=1):
            gust = gust + getattr(p, name) * once_for_alike(partial(shape, k), p.start, p.duration)
        return gust

    def finer(self) -> Self:
        """Return the refined form, with three more shapes."""
        return replace(self, fine=True)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe the peak of a gust at the begin of the record, for some durations.

        A later start only shifts the response.
        """
        return tuple(
            Probe(
                {**self.absent, "start": context.begin, "duration": duration},
                ("peak",),
                shifts=True,
            )
            for duration in DURATIONS
            if 4.0 * context.interval <= duration <= 0.5 * context.duration
        )


@dataclass(frozen=True)
class GustDiscrete(SingleGust):
    """A single vertical gust: w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)).

    ``peak`` is in m/s, positive upward. w/V adds to the angle of attack in the loads and in the
    vane's reading, but not to the state; V is the declared airspeed. On lateral equations the gust
    comes from the right and w/V adds to the sideslip angle.

    Attributes
    ----------
    lasting, fine : see `SingleGust`.
    speed : name of the constant that is the declared airspeed.
    """

    speed: str = "airspeed"

    name: ClassVar[str] = "gust-discrete"
    needs: ClassVar[tuple[str, ...]] = ("gust",)
    aliases: ClassVar[tuple[str, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        sentences=("a single gust of {peak} comes at {start} and lasts {duration}",),
        plausible=dict(PLAUSIBLE),
        lasts="duration",
        onset="start",
        per_record=True,
    )
    explanation: ClassVar[str] = (
        "A single vertical gust: the vertical speed of the air is w(t) = (peak/2) (1 - cos(2 pi (t "
        "- start)/duration)) from start to start + duration, the usual design gust. The gust adds "
        "w/V to the angle of attack in CL, in Cm and in the reading of the vane. The angle of "
        "attack as a state changes only later, as the aircraft responds. The vane therefore moves "
        "before the pitch rate, which no control input can cause. The length of the gust in the "
        "air is V times its duration. A second form keeps the peak after half the duration: the "
        "aircraft has entered air that keeps rising. A refined form of both has three more shapes, "
        "for gusts that begin with a kink, rise faster than they fall, or are flat on top. On the "
        "lateral model the gust comes from the right and acts through the sideslip angle on side "
        "force, roll and yaw."
    )

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (self.speed,)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"gust": self.speed_at(s.time, p) / getattr(vehicle, self.speed)}


@dataclass(frozen=True)
class GustHorizontal(SingleGust):
    """A single gust from ahead: w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)).

    ``peak`` is in m/s, positive from ahead. w adds to the airspeed in the loads and in the reading
    of the pitot tube, but not to the state.

    Attributes
    ----------
    lasting, fine : see `SingleGust`.
    """

    name: ClassVar[str] = "gust-horizontal"
    needs: ClassVar[tuple[str, ...]] = ("headwind",)
    aliases: ClassVar[tuple[str, ...]] = ("unmeasured-input",)
    traits: ClassVar[Traits] = Traits(
        sentences=("a single gust of {peak} from ahead comes at {start} and lasts {duration}",),
        plausible=dict(PLAUSIBLE),
        lasts="duration",
        onset="start",
        per_record=True,
    )
    explanation: ClassVar[str] = (
        "The headwind increases once. The wind speed is w(t) = (peak/2) (1 - cos(2 pi (t - "
        "start)/duration)) from start to start + duration. The pitot tube reads V + w at once, and "
        "lift and drag are proportional to (V + w)^2. The speed of the aircraft itself changes "
        "only slowly. The gust is recognised by an airspeed that jumps without a preceding axial "
        "load factor, and a load factor that follows. A second form keeps the peak after half the "
        "duration: the wind stays changed, as in a wind shear. A refined form of both has three "
        "more shapes."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"headwind": self.speed_at(s.time, p)}


# ---- Continuous turbulence

ROOT3 = math.sqrt(3.0)


@dataclass(frozen=True)
class GustTurbulence:
    """Vertical turbulence of Dryden's form (MIL-F-8785C, 3.7.1.2), with the standard deviation
    ``sigma`` (m/s) and the scale length ``length`` (m).

    The one-sided spectrum over the spatial frequency W is sigma^2 (L/pi) (1 + 3 (L W)^2) / (1 + (L
    W)^2)^2, with the integral sigma^2. The gust speed w is white noise of unit density through the
    filter sigma sqrt(T) (1 + sqrt(3) T s) / (1 + T s)^2, T = length/V. The filter has two states in
    m/s: gust_1_dot = -gust_1/T + noise of density sigma^2/T, gust_2_dot = (gust_1 - gust_2)/T, w =
    sqrt(3) gust_1 + (1 - sqrt(3)) gust_2.

    w/V adds to alpha in the loads and in the vane's reading; V is the declared airspeed. Without
    noise the states stay at zero, and a simulation is that of calm air. On lateral equations the
    gusts come from the right.

    Attributes
    ----------
    speed : name of the constant that is the declared airspeed.
    """

    speed: str = "airspeed"

    name: ClassVar[str] = "gust-turbulence"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("gust",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("sigma", 1.0, "m/s", bounds=(0.0, 30.0)),
        Parameter("length", 300.0, "m", bounds=(5.0, 10000.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"sigma": 0.0})
    regularity: ClassVar[Regularity] = Regularity.PROCESS_NOISE
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = (
        Signal("gust_1", "m/s", "filtered noise"),
        Signal("gust_2", "m/s", "the same, filtered twice"),
    )
    traits: ClassVar[Traits] = Traits(
        sentences=("the air is turbulent: gusts of {sigma}, length scale {length}",),
        # A sigma below a fifth of light turbulence, a few cm/s, represents another small error.
        plausible={"sigma": (0.1, 8.0), "length": (40.0, 2000.0)},
        # Turbulence contains single gusts.
        never_beside=("gust-discrete",),
    )
    explanation: ClassVar[str] = (
        "Vertical turbulence. The vertical speed w of the air is random throughout the record, "
        "with the standard deviation sigma and the scale length L, which the aircraft crosses in "
        "L/V seconds. Its spectrum is that of Dryden, S(W) = sigma^2 (L/pi) (1 + 3 (L W)^2)/(1 + "
        "(L W)^2)^2 over the spatial frequency W. w/V adds to alpha in the loads and in the "
        "reading of the vane. A simulation from the recorded inputs cannot follow such a record. "
        "The model is therefore assessed by its one-step predictions, whose errors stay correlated "
        "until the gust is estimated together with the motion. If turbulence is neglected, the "
        "sigmas of all derivatives are too small. A record determines sigma^2/L, the level at high "
        "frequency. If it spans only a few scale lengths, the estimates of sigma and L are both "
        "too low, and so are their sigmas. On the lateral model the gusts come from the right and "
        "act through the sideslip angle."
    )

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (self.speed,)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {
            "gust": (ROOT3 * s.gust_1 + (1.0 - ROOT3) * s.gust_2) / getattr(vehicle, self.speed)
        }

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        rate = getattr(vehicle, self.speed) / p.length
        return -rate * s.gust_1, rate * (s.gust_1 - s.gust_2)

    def density(self, vehicle: Any, p: Any) -> Sequence[Any]:
        """Return the spectral density of the noise on each state's rate, (m/s)^2/s."""
        density = p.sigma * p.sigma * getattr(vehicle, self.speed) / p.length
        return density, 0.0 * density

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe scale lengths of which the record spans several."""
        longest = max(50.0, context.airspeed * context.duration / 6.0)
        lengths = [length for length in (100.0, 300.0, 900.0) if length <= longest] or [longest]
        return tuple(Probe({"sigma": 1.0, "length": length}) for length in lengths)


VARIANTS: tuple[Traceable, ...] = (
    *(
        GustDiscrete(lasting, speed=speed)
        for speed in ("airspeed", "reference_airspeed")
        for lasting in (False, True)
    ),
    GustHorizontal(),
    GustHorizontal(lasting=True),
    GustTurbulence(),
    GustTurbulence("reference_airspeed"),
)
