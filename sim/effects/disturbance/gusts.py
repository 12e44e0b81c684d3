"""Gusts: a single one-minus-cosine gust, vertical or from ahead, and Dryden turbulence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.loads import PLAUSIBLE, calm_air, gust_parameters, gust_probes, gust_speed


@dataclass(frozen=True)
class GustDiscrete:
    """A single vertical gust: w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)).

    ``peak`` is in m/s, positive upward; ``start`` and ``duration`` are in s. Outside the gust w =
    0. w/V adds to the angle of attack in the loads and in the vane's reading, and not to the state;
    V is the declared airspeed. On lateral equations the gust comes from the right, and adds to
    sideslip.

    Attributes
    ----------
    lasting : whether w keeps its peak after the first half (MIL-F-8785C, 3.7.1.3; the length of
        that gust is V duration/2).
    fine : add the sum of ``shape1`` ... ``shape3`` (m/s) times sin(k pi x), where x runs from 0 to
        1 over the gust or its rise, minus their contribution at the peak: for gusts that begin with
        a kink, rise faster than they fall, or are flat on top.
    speed : name of the constant that is the declared airspeed.
    """

    lasting: bool = False
    fine: bool = False
    speed: str = "airspeed"

    name: ClassVar[str] = "gust-discrete"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("gust",)
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        sentences=("a single gust of {peak} comes at {start} and lasts {duration}",),
        plausible=dict(PLAUSIBLE),
        lasts="duration",
        onset="start",
        per_record=True,
    )
    explanation: ClassVar[str] = (
        "Rising air meets the aircraft once: w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)) "
        "between start and start + duration, the usual design gust. The air then comes from below "
        "by w/V more than the motion tells, in CL, in Cm and in the vane's reading, while the "
        "angle of attack as a state only follows. The vane jumps ahead of the pitch rate, which no "
        "control input can do. The length of the gust in the air is V times its duration. A second "
        "form keeps the peak after half the duration: the aircraft has flown into air that rises "
        "for good. Either has a freer form, with three shapes more: gusts that begin with a kink, "
        "rise faster than they fall, or are flat on top. On the lateral model the air comes from "
        "the right: sideslip, side force, roll and yaw stand where angle of attack, lift and pitch "
        "do here."
    )

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (self.speed,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return gust_parameters(self.fine)

    @property
    def absent(self) -> Mapping[str, float]:
        return calm_air(self.fine)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {
            "gust": gust_speed(s.time, p, self.lasting, self.fine) / getattr(vehicle, self.speed)
        }

    def finer(self) -> GustDiscrete:
        """Return the refined form, with a more general course."""
        return replace(self, fine=True)

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return gust_probes(context, self.fine)


DISCRETE_VARIANTS: tuple[Traceable, ...] = tuple(
    GustDiscrete(lasting, speed=speed)
    for speed in ("airspeed", "reference_airspeed")
    for lasting in (False, True)
)


@dataclass(frozen=True)
class GustHorizontal:
    """A single gust from ahead: w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)).

    ``peak`` is in m/s, positive from ahead; ``start`` and ``duration`` are in s. w adds to the
    airspeed in the loads and in the reading of the pitot tube, and not to the state.

    Attributes
    ----------
    lasting, fine : as of `GustDiscrete`.
    """

    lasting: bool = False
    fine: bool = False

    name: ClassVar[str] = "gust-horizontal"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("headwind",)
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ("unmeasured-input",)
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        sentences=("a single gust of {peak} from ahead comes at {start} and lasts {duration}",),
        plausible=dict(PLAUSIBLE),
        lasts="duration",
        onset="start",
        per_record=True,
    )
    explanation: ClassVar[str] = (
        "The wind from ahead freshens once: w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)) "
        "between start and start + duration. The air then meets the aircraft faster by w than it "
        "moves: the pitot tube shows V + w at once, lift and drag grow with (V + w)^2, and the "
        "aircraft itself gains and loses speed only slowly. An airspeed that jumps without any "
        "axial load factor before it, and a load factor that follows it, are its mark. A second "
        "form keeps the peak after half the duration: the wind has changed for good, as in a "
        "shear. Either has a freer form with three shapes more."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return gust_parameters(self.fine)

    @property
    def absent(self) -> Mapping[str, float]:
        return calm_air(self.fine)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"headwind": gust_speed(s.time, p, self.lasting, self.fine)}

    def finer(self) -> GustHorizontal:
        """Return the refined form, with a more general course."""
        return replace(self, fine=True)

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return gust_probes(context, self.fine)


ROOT3 = math.sqrt(3.0)


@dataclass(frozen=True)
class GustTurbulence:
    """Vertical turbulence of Dryden's form (MIL-F-8785C, 3.7.1.2), with the standard deviation
    ``sigma`` (m/s) and the scale length ``length`` (m).

    One-sided spectrum over the spatial frequency W: sigma^2 (L/pi) (1 + 3 (L W)^2) / (1 + (L
    W)^2)^2, whose integral is sigma^2. White noise of unit density through sigma sqrt(T) (1 +
    sqrt(3) T s) / (1 + T s)^2, T = length/V, with two states in m/s: gust_1_dot = -gust_1/T + noise
    of density sigma^2/T, gust_2_dot = (gust_1 - gust_2)/T, w = sqrt(3) gust_1 + (1 - sqrt(3))
    gust_2. w/V adds to alpha in the loads and the vane's reading; V is the declared airspeed.
    Without noise the states stay at zero and a simulation is that of calm air. On lateral equations
    the gusts come from the right.

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
        "The air is rough all along the record. Its vertical speed w is random, with standard "
        "deviation sigma and a correlation length L that the aircraft crosses in L/V seconds; its "
        "spectrum is Dryden's, S(W) = sigma^2 (L/pi) (1 + 3 (L W)^2)/(1 + (L W)^2)^2 over the "
        "spatial frequency W. alpha as the loads and the vane feel it is alpha + w/V. No "
        "simulation can follow such a record: one judges the model's predictions one step ahead, "
        "whose errors stay correlated until the gust is estimated along with the motion. Left out, "
        "it makes every derivative look better known than it is. A record tells sigma^2/L, the "
        "level at high frequency; where it holds few lengths, sigma and L both come out low and "
        "surer than they are. On the lateral model w comes from the right and sideslip takes the "
        "place of alpha."
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
        """Probe scale lengths of which a record contains several."""
        far = max(50.0, context.airspeed * context.duration / 6.0)
        return tuple(
            Probe({"sigma": 1.0, "length": length})
            for length in (100.0, 300.0, 900.0)
            if length <= far
        ) or (Probe({"sigma": 1.0, "length": far}),)


VARIANTS: tuple[Traceable, ...] = (
    *DISCRETE_VARIANTS,
    GustHorizontal(),
    GustHorizontal(lasting=True),
    GustTurbulence(),
    GustTurbulence("reference_airspeed"),
)
