"""Calibration of one output channel: a wrong scale factor, a bent curve, and a zero that drifts,
steadily or settling, or jumps at one time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import (
    STEADY_FLIGHT,
    for_outputs,
    further_outputs,
    has_output_size,
    large_output,
    per,
    per_square,
)
from sim.effects.loads import risen
from sim.maths import absolute, exp, real, where

_ALIASES_OF_SCALE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "alpha": ("time-base", "sensor-scale:q", "sensor-lag:nz", "sensor-delay:nz"),
        "q": ("sensor-scale:alpha",),
        "nz": (),
        "altitude": ("density-scale-height",),
    }
)

SLOW_AND_QUICK = (
    "slow pull-ups beside quick doublets, small and large: a scale is the same in all of them"
)
WITH_LOAD_FACTOR = (
    "a record with the load factor as well: kinematics then tie the channels together"
)


@dataclass(frozen=True)
class SensorScale:
    """The recorded channel is ``scale`` times the true one, before the bias is added.

    ``scale`` without unit, positive; 1 where the sensor is right. Of the altitude only a large one
    shows: another start and beta make nearly the same fall (of three percent a seventh of the noise
    is left).
    """

    channel: str

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 10
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("scale", 1.05, "1", bounds=(0.01, 100.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"scale": 1.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    explanation: ClassVar[str] = (
        "The sensor's calibration factor is wrong: y_recorded = scale y + bias. A vane in the "
        "upwash of the fuselage reads too much, a gyro with a "
        "wrong range setting any amount. One scaled channel contradicts the others: the kinematics "
        "alpha_dot = q - (g/V)(nz - 1) join the three "
        "without any aerodynamics, so that with alpha, q and nz at hand a single scale shows. With "
        "two channels it only changes the derivatives: "
        "the lift slope for alpha, all moment derivatives for q, and the record cannot say which "
        "is at fault. An altitude scaled together with the "
        "density's scale height and with beta gives the same fall but for gravity: only where it "
        "is large does it show."
    )

    @property
    def name(self) -> str:
        return f"sensor-scale:{self.channel}"

    @property
    def aliases(self) -> tuple[str, ...]:
        return _ALIASES_OF_SCALE.get(self.channel, ())

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {channel} is read {scale_percent} {scale_direction}",),
            separating={
                **dict.fromkeys(
                    ("sensor-lag", "sensor-delay", "lift-nonlinearity"), SLOW_AND_QUICK
                ),
                "sensor-scale": WITH_LOAD_FACTOR,
            },
            equivalents=("time-base",) if self.channel == "alpha" else (),
            plausible={"scale": (0.5, 2.0)},
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"scale": 1.0}, ("scale",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: p.scale * y[self.channel]}


_ALIASES_OF_CURVE = {
    **{
        "alpha": ("lift-nonlinearity",),
        "nz": ("lift-nonlinearity",),
        "q": ("moment-nonlinearity",),
    },
    **{
        "p": ("roll-nonlinearity",),
        "r": ("yaw-nonlinearity",),
        "ny": ("side-force-nonlinearity",),
        "nx": ("drag-nonlinearity",),
    },
}
# rad, rad/s, g about trim: what a record without a known range is taken to fly
LARGEST = {"alpha": 0.15, "q": 0.3, "nz": 3.0}
POWERS: Mapping[str, int] = MappingProxyType({"curvature": 2, "cubic": 3})
BOTH = tuple(POWERS)
AT_HALF = 2.0  # a cube starts where it is as large as the square at half of the range
WITH_OTHERS = (
    "a record with the other two of alpha, q and nz: a bent load moves all three by the "
    "kinematics, a bent reading one"
)


@dataclass(frozen=True)
class SensorCurve:
    """The recorded channel is y + curvature y^2 + cubic y^3, y the true value about trim, before
    the bias is added.

    ``curvature`` in 1 over the unit of the channel, ``cubic`` in 1 over its square, of either sign;
    a plain curve has one of the two.

    Attributes
    ----------
    channel, unit : the output it acts on. typical : starting curvature.
    middle : of the readings, from where y counts; zero where they are perturbations. is_state :
    whether the channel
        is a state, whose range is known without its bias.
    bends : which of the two it has.
    low, high : flown range about trim, in the unit of the channel: believed is what leaves the
    reading rising all over it,
        1 + 2 curvature y + 3 cubic y^2 > 0 where either stands alone, and at its ends no more than
        twice what it should be.
    """

    channel: str
    unit: str
    typical: float
    low: float
    high: float
    middle: float = 0.0
    is_state: bool = False
    bends: tuple[str, ...] = ("curvature",)

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 5
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    explanation: ClassVar[str] = (
        "The sensor's calibration is not straight: y_recorded = y + curvature y^2 + bias, y "
        "counted from trim, where the slope is one. A vane near "
        "a fuselage whose upwash changes with the angle, a potentiometer loaded at one end and a "
        "filter of pressures do this. Pull-ups and "
        "push-overs of one size then read unlike. A sensor that errs alike to both sides has cubic "
        "y^3 in the place of the square, and a freer form "
        "has both. The kinematics alpha_dot = q - (g/V) nz show it in the one channel that is "
        "bent; lift or moment "
        "that bend over the angle of attack change the motion itself and obey the kinematics. With "
        "one channel alone the two look much the same."
    )

    @property
    def name(self) -> str:
        return f"sensor-curve:{self.channel}"

    @property
    def aliases(self) -> tuple[str, ...]:
        return _ALIASES_OF_CURVE.get(self.channel, ())

    @property
    def absent(self) -> Mapping[str, float]:
        return dict.fromkeys(self.bends, 0.0)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        reach = max(self.high, -self.low, 1e-6)
        both = {
            "curvature": Parameter("curvature", self.typical, per(self.unit)),
            "cubic": Parameter("cubic", AT_HALF * self.typical / reach, per_square(self.unit)),
        }
        return tuple(both[name] for name in self.bends)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                "the reading of the {channel} is bent: it has {curvature} times its square and "
                "{cubic} times its cube too much",
                "the reading of the {channel} is bent: it has {curvature} times its square too "
                "much",
                "the reading of the {channel} is bent: it has {cubic} times its cube too much",
            ),
            separating=dict.fromkeys(("lift-nonlinearity", "moment-nonlinearity"), WITH_OTHERS),
            plausible={
                name: range_ for name, range_ in self._believed().items() if name in self.bends
            },
        )

    def _believed(self) -> Mapping[str, tuple[float, float]]:
        up, down = max(self.high, 1e-6), min(self.low, -1e-6)
        reach = max(up, -down)
        return {
            "curvature": (-0.5 / up, -0.5 / down),
            "cubic": (-1.0 / (3.0 * reach**2), 1.0 / reach**2),
        }

    def finer(self) -> SensorCurve:
        """The same with square and cube."""
        return replace(self, bends=BOTH)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe(self.absent, self.bends)]

    def fitted_to(self, context: SearchContext) -> SensorCurve:
        """The same over the range that the record flew, its bias taken off."""
        recorded_range = context.flown_range(self.channel)
        if recorded_range is None:
            return self
        # The range of a state is that of the motion, without the bias of its reading.
        bias = 0.0 if self.is_state else context.values.get(f"bias_{self.channel}", 0.0)
        low, high = recorded_range[0] - bias, recorded_range[1] - bias
        if max(low, -high) > high - low:
            # A total that never comes near zero: about there a square is next to a scale.
            middle = 0.5 * (low + high)
            return replace(self, low=low - middle, high=high - middle, middle=middle)
        return replace(self, low=min(low, 0.0), high=max(high, 0.0))

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        true = y[self.channel]
        off = true - self.middle if self.middle else true
        bent = sum(
            getattr(p, name) * off**power for name, power in POWERS.items() if name in self.bends
        )
        return {self.channel: true + bent}


_PLAIN = (
    SensorCurve("alpha", "rad", 3.0, -LARGEST["alpha"], LARGEST["alpha"], is_state=True),
    SensorCurve("q", "rad/s", 0.8, -LARGEST["q"], LARGEST["q"], is_state=True),
    SensorCurve("nz", "g", 0.1, -LARGEST["nz"], LARGEST["nz"]),
)


def _square_or_cube(curves: Sequence[SensorCurve]) -> tuple[Traceable, ...]:
    return tuple(replace(each, bends=(name,)) for each in curves for name in BOTH)


SCALE_VARIANTS: tuple[Traceable, ...] = (
    *(SensorScale(channel) for channel in ("alpha", "q", "nz", "altitude")),
    *_square_or_cube(_PLAIN),
)


def scale_made_for(equations: Equations) -> tuple[Traceable, ...]:
    """A scale, a square and a cube for each output that has none yet."""
    states = {signal.name for signal in equations.states}
    further = further_outputs(equations)
    sized = ((each, large_output(each.unit)) for each in further)
    curves = [
        SensorCurve(each.name, each.unit, 0.2 / large, -large, large, is_state=each.name in states)
        for each, large in sized
    ]
    return (*(SensorScale(each.name) for each in further), *_square_or_cube(curves))


FASTEST = 2.0  # 1/s, of settling: what settles faster is a jump at the record's begin
SERIES_BELOW = 1e-3


@dataclass(frozen=True)
class SensorDrift:
    """The recorded channel has slope (t - begin) added to it, or slope (1 - exp(-settling (t -
    begin))) / settling.

    ``slope`` in the unit of the channel per second, either sign; ``settling`` in 1/s, zero where
    the drift goes on. Each record has its own.

    Attributes
    ----------
    channel, unit : the output it acts on. typical : starting slope; believed up to twenty times
    that, or any where the
        unit is not one whose sizes are known (``sized``). settles : whether it has ``settling``.
    begin : s, the record's first time. Where the channel has a bias it only keeps the two apart.
    """

    channel: str
    unit: str
    typical: float
    begin: float = 0.0
    sized: bool = True
    settles: bool = False

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 20
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"slope": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "The sensor's zero wanders while the record runs: y_recorded = y + bias + slope (t - "
        "begin). Warming electronics and gyros do this, and "
        "settle: a freer form has slope (1 - exp(-settling (t - begin))) / settling. The deviation "
        "grows steadily whatever the maneuver, in one "
        "channel alone and against the kinematics. A trim or a speed that changes slowly moves all "
        "channels together instead. The slope belongs to "
        "one record; on another it has another value, so that another record cannot confirm it, "
        "and on measured data slow disturbances easily "
        "pass for it. On a falling body a drift of the altitude stands for anything that adds a "
        "constant to the measured velocity, a horizontal "
        "motion seen by the radar among them."
    )

    @property
    def name(self) -> str:
        return f"sensor-drift:{self.channel}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        slope = Parameter("slope", self.typical, f"{self.unit}/s")
        return (
            (slope, Parameter("settling", 0.2, "1/s", bounds=(0.0, FASTEST)))
            if self.settles
            else (slope,)
        )

    @property
    def most(self) -> float:
        """The largest slope that is believed: of an altitude less, since a fall that is modelled
        wrong asks for any.
        """
        return (8.0 if self.channel == "altitude" else 20.0) * self.typical

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                "the reading of the {channel} drifts by {slope} at first, and settles at a rate of "
                "{settling}",
                "the reading of the {channel} drifts by {slope}",
            ),
            separating=dict.fromkeys(
                ("sensor-drift", "drag-mach", "density-scale-height"), STEADY_FLIGHT
            ),
            never_beside=(f"sensor-step:{self.channel}",),
            plausible={"slope": (-self.most, self.most)} if self.sized else {},
            per_record=True,
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        gone = {item.name: item.value for item in self.parameters} | {"slope": 0.0}
        return [Probe(gone, ("slope",))]

    def finer(self) -> SensorDrift:
        """The same that dies out."""
        return replace(self, settles=True)

    def fitted_to(self, context: SearchContext) -> SensorDrift:
        """The drift that counts from this record's begin."""
        return replace(self, begin=context.begin)

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        elapsed = s.time - self.begin
        return {
            self.channel: y[self.channel]
            + p.slope * (settled(elapsed, p.settling) if self.settles else elapsed)
        }


def settled(elapsed: Any, rate: Any) -> Any:
    """(1 - exp(-rate elapsed)) / rate, in s: the time itself at a rate of zero; by its series where
    the difference would round.
    """
    x = rate * elapsed
    slow = real(absolute(x)) < SERIES_BELOW
    series = elapsed * (1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0)))
    return where(slow, series, elapsed * (1.0 - exp(-x)) / where(slow, 1.0, x))


@dataclass(frozen=True)
class SensorStep:
    """From the time ``at`` on the recorded channel has ``size`` added to it.

    ``at`` in s, ``size`` in the unit of the channel, either sign. Each record has its own. The edge
    rises over ``width`` s, centred on ``at``: one sampling interval in a search, so that the fit
    feels the sample next to it; the time is then known to half an interval at best, however small
    its sigma.

    Attributes
    ----------
    channel, unit : the output it acts on. typical : the starting size; believed up to twenty times
    that, or any where the unit is
        not one whose sizes are known (``sized``). width : of the edge, s.
    """

    channel: str
    unit: str
    typical: float
    width: float = 0.02
    sized: bool = True

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 20
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "The sensor's zero jumps while the record runs and stays there: y_recorded = y + bias + "
        "size from the time at on. A vane that is knocked, a "
        "connector that slips, an amplifier that changes its range and a resynchronised encoder do "
        "this. Before and after, the motion is that of "
        "the model; no other channel takes part, which no force on the aircraft could leave so: a "
        "load that nobody recorded would move all "
        "channels, and over the time of a short period. The step belongs to one record."
    )

    @property
    def name(self) -> str:
        return f"sensor-step:{self.channel}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("at", 3.0, "s"), Parameter("size", self.typical, self.unit))

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the zero of the {channel} jumps by {size} at {at}",),
            separating=dict.fromkeys(("sensor-drift", "unmeasured-input"), STEADY_FLIGHT),
            # Twenty times what is usual: beyond (1 km of altitude, 2 g) a recorder has lost rows,
            # and its channels go on from elsewhere.
            plausible={"size": (-20.0 * self.typical, 20.0 * self.typical)} if self.sized else {},
            onset="at",
            per_record=True,
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """The slope by the size at the record's begin; a later step only shifts it."""
        return [
            Probe(
                {"at": context.begin + 0.5 * self.width, **self.absent},
                ("size",),
                shifts=True,
                sharp=True,
            )
        ]

    def fitted_to(self, context: SearchContext) -> SensorStep:
        """The same with an edge of one sampling interval of that record."""
        return replace(self, width=context.interval if context.interval > 0 else self.width)

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: y[self.channel] + p.size * risen(s.time, p.at, self.width)}


ZERO_VARIANTS: tuple[Traceable, ...] = (
    SensorDrift("alpha", "rad", 5e-4),
    SensorDrift("q", "rad/s", 5e-4),
    SensorDrift("nz", "g", 5e-3),
    SensorDrift("altitude", "m", 5.0),
    SensorStep("alpha", "rad", 0.01),
    SensorStep("q", "rad/s", 0.01),
    SensorStep("nz", "g", 0.1),
    SensorStep("altitude", "m", 50.0),
)


def zero_made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Both for each output that has none yet."""
    return for_outputs(
        equations,
        lambda s: SensorDrift(
            s.name, s.unit, 0.0025 * large_output(s.unit), sized=has_output_size(s.unit)
        ),
        lambda s: SensorStep(
            s.name, s.unit, 0.05 * large_output(s.unit), sized=has_output_size(s.unit)
        ),
    )


VARIANTS: tuple[Traceable, ...] = (
    *SCALE_VARIANTS,
    *ZERO_VARIANTS,
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """The instances of every effect in this file that none of ``VARIANTS`` is for."""
    return (
        *scale_made_for(equations),
        *zero_made_for(equations),
    )
