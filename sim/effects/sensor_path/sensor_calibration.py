"""Calibration errors of one output channel: scale factor, nonlinear curve, drift and step of zero.

In all effects y is the true value of the channel, in its unit, before the constant bias is added.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import (
    STEADY_FLIGHT,
    OfChannel,
    ProbedAtAbsence,
    further_outputs,
    has_typical_output_size,
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

# Advice on how to distinguish a scale or a curve from other effects.
SLOW_AND_QUICK = (
    "slow maneuvers beside quick doublets, small and large: a scale is the same in all of them"
)
WITH_LOAD_FACTOR = (
    "a record with the load factor as well: kinematics then tie the channels together"
)


@dataclass(frozen=True)
class SensorScale(OfChannel, ProbedAtAbsence):
    """Scale factor error: y_recorded = scale y + bias.

    ``scale`` is positive and has no unit; it is 1 for a correct sensor. A scale of the altitude is
    observable only if it is large. Another initial state and ballistic coefficient ``beta`` give
    nearly the same fall: a scale of 1.03 leaves a residual of a seventh of the noise.

    Attributes
    ----------
    channel : name of the output that it acts on.
    """

    channel: str

    family: ClassVar[str] = "sensor-scale"
    path_order: ClassVar[int] = 10
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("scale", 1.05, "1", bounds=(0.01, 100.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"scale": 1.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    explanation: ClassVar[str] = (
        "Wrong calibration factor: y_recorded = scale y + bias. Causes are a vane in the upwash of "
        "the fuselage, which reads too much, or a gyro with a wrong range setting. A scaled "
        "channel contradicts the others, because the kinematics alpha_dot = q - (g/V)(nz - 1) "
        "relate the three without any aerodynamics. With alpha, q and nz recorded, a single scale "
        "is observable. With two channels it only changes the derivatives: the lift slope for "
        "alpha, all moment derivatives for q. The record then cannot show which channel is wrong. "
        "A scaled altitude together with a changed density scale height and beta gives the same "
        "fall except for gravity, so only a large scale of the altitude is observable."
    )

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

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: p.scale * y[self.channel]}


_ALIASES_OF_CURVE = {
    "alpha": ("lift-nonlinearity",),
    "nz": ("lift-nonlinearity",),
    "q": ("moment-nonlinearity",),
    "p": ("roll-nonlinearity",),
    "r": ("yaw-nonlinearity",),
    "ny": ("side-force-nonlinearity",),
    "nx": ("drag-nonlinearity",),
}
# Range about trim that is assumed if that of the record is unknown; rad, rad/s, g.
USUAL_RANGE = {"alpha": 0.15, "q": 0.3, "nz": 3.0}
POWERS: Mapping[str, int] = MappingProxyType({"curvature": 2, "cubic": 3})
# The starting cubic term equals the starting quadratic term at half of the range.
CUBIC_PER_CURVATURE = 2.0
WITH_OTHER_CHANNELS = (
    "a record with the other two of alpha, q and nz: a bent load moves all three by the "
    "kinematics, a bent reading one"
)


@dataclass(frozen=True)
class SensorCurve(OfChannel, ProbedAtAbsence):
    """Nonlinear calibration: y_recorded = y + curvature y^2 + cubic y^3 + bias.

    Here y is the true value minus ``middle``. ``curvature`` is in 1/unit of the channel and
    ``cubic`` in 1/unit^2, of either sign. The base form has one of the two parameters, the refined
    form both. The value of a parameter is plausible if, with this parameter alone, the reading
    increases with y over the whole range (1 + 2 curvature y + 3 cubic y^2 > 0) and is at most twice
    the true value at the ends.

    Attributes
    ----------
    channel, unit : name and unit of the output that it acts on.
    typical : starting value of ``curvature``, 1/unit.
    low, high : range of the recorded values, counted from ``middle``, in the unit of the channel.
    middle : value of the channel where y is zero; 0 if readings are perturbations about trim.
    is_state : whether the channel is a state. The recorded range of a state does not contain the
        bias.
    bends : names of the parameters that this form has.
    """

    channel: str
    unit: str
    typical: float
    low: float
    high: float
    middle: float = 0.0
    is_state: bool = False
    bends: tuple[str, ...] = ("curvature",)

    family: ClassVar[str] = "sensor-curve"
    path_order: ClassVar[int] = 5
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    explanation: ClassVar[str] = (
        "Nonlinear calibration: y_recorded = y + curvature y^2 + bias, where y counts from trim "
        "and the slope there is one. Causes are a vane near a fuselage whose upwash changes with "
        "the angle, a potentiometer that is loaded at one end, or a pressure filter. Pull-ups and "
        "push-overs of one size then give readings of different sizes. A sensor with equal errors "
        "on both sides has cubic y^3 instead of the square; the refined form has both. The "
        "kinematics alpha_dot = q - (g/V) nz show which channel has the curved reading. In "
        "contrast, a lift or moment that is nonlinear in the angle of attack changes the motion "
        "itself, which obeys the kinematics. With one channel alone the two look much the same."
    )

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
            "cubic": Parameter(
                "cubic", CUBIC_PER_CURVATURE * self.typical / reach, per_square(self.unit)
            ),
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
            separating=dict.fromkeys(
                ("lift-nonlinearity", "moment-nonlinearity"), WITH_OTHER_CHANNELS
            ),
            plausible={
                name: limits
                for name, limits in self._plausible_ranges().items()
                if name in self.bends
            },
        )

    def _plausible_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Return the plausible range of each parameter, as the class defines it."""
        up, down = max(self.high, 1e-6), min(self.low, -1e-6)
        reach = max(up, -down)
        return {
            "curvature": (-0.5 / up, -0.5 / down),
            "cubic": (-1.0 / (3.0 * reach**2), 1.0 / reach**2),
        }

    def finer(self) -> SensorCurve:
        """Return the refined form, with both parameters."""
        return replace(self, bends=tuple(POWERS))

    def fitted_to(self, context: SearchContext) -> SensorCurve:
        """Return the effect with the range of the record, less the bias of the channel."""
        recorded_range = context.flown_range(self.channel)
        if recorded_range is None:
            return self
        # The range of a state does not contain the bias of its sensor.
        bias = 0.0 if self.is_state else context.values.get(f"bias_{self.channel}", 0.0)
        low, high = recorded_range[0] - bias, recorded_range[1] - bias
        if max(low, -high) > high - low:
            # At values far from zero, a square could not be distinguished from a scale.
            middle = 0.5 * (low + high)
            return replace(self, low=low - middle, high=high - middle, middle=middle)
        return replace(self, low=min(low, 0.0), high=max(high, 0.0))

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        true = y[self.channel]
        y_trim = true - self.middle if self.middle else true
        bent = sum(
            getattr(p, name) * y_trim**power for name, power in POWERS.items() if name in self.bends
        )
        return {self.channel: true + bent}


_LONGITUDINAL_CURVES = (
    SensorCurve("alpha", "rad", 3.0, -USUAL_RANGE["alpha"], USUAL_RANGE["alpha"], is_state=True),
    SensorCurve("q", "rad/s", 0.8, -USUAL_RANGE["q"], USUAL_RANGE["q"], is_state=True),
    SensorCurve("nz", "g", 0.1, -USUAL_RANGE["nz"], USUAL_RANGE["nz"]),
)


def _square_or_cube(curves: Iterable[SensorCurve]) -> tuple[Traceable, ...]:
    """Return each curve twice: with the square only, and with the cube only."""
    return tuple(replace(each, bends=(name,)) for each in curves for name in POWERS)


# 1/s; a drift that settles faster is a step at the begin of the record.
HIGHEST_SETTLING_RATE = 2.0
# Product of rate and elapsed time below which the series of `settled` is exact to rounding.
SERIES_BELOW = 1e-3


@dataclass(frozen=True)
class SensorDrift(OfChannel):
    """Drift of zero: y_recorded = y + bias + slope (t - begin).

    In the refined form the drift settles: y_recorded = y + bias + slope (1 - exp(-settling (t -
    begin))) / settling. ``slope`` is in unit/s, of either sign, and ``settling`` in 1/s. Each
    record has its own values.

    Attributes
    ----------
    channel, unit : name and unit of the output that it acts on.
    typical : starting slope, unit/s.
    begin : first time of the record, s. Counting from it decorrelates the drift from the bias.
    sized : whether usual sizes are known for the unit. If so, slopes up to twenty times ``typical``
        are plausible, otherwise any slope.
    settles : whether this is the refined form, with ``settling``.
    """

    channel: str
    unit: str
    typical: float
    begin: float = 0.0
    sized: bool = True
    settles: bool = False

    family: ClassVar[str] = "sensor-drift"
    path_order: ClassVar[int] = 20
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"slope": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "The zero of the sensor drifts: y_recorded = y + bias + slope (t - begin). Electronics and "
        "gyros that warm up do this and then settle. The refined form is therefore slope (1 - "
        "exp(-settling (t - begin))) / settling. The deviation grows steadily whatever the "
        "maneuver, in one channel only and against the kinematics. In contrast, a slow change of "
        "trim or airspeed changes all channels together. Each record has its own slope, so another "
        "record cannot confirm it, and in measured data slow disturbances are easily mistaken for "
        "a drift. On a falling body a drift of the altitude also represents anything that adds a "
        "constant to the measured velocity, such as a horizontal motion seen by the radar."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        slope = Parameter("slope", self.typical, f"{self.unit}/s")
        return (
            (slope, Parameter("settling", 0.2, "1/s", bounds=(0.0, HIGHEST_SETTLING_RATE)))
            if self.settles
            else (slope,)
        )

    @property
    def largest_slope(self) -> float:
        """Largest plausible slope, unit/s.

        It is smaller for an altitude, because a large drift could represent any error of the model
        of a fall.
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
            plausible={"slope": (-self.largest_slope, self.largest_slope)} if self.sized else {},
            per_record=True,
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        absent = {item.name: item.value for item in self.parameters} | {"slope": 0.0}
        return [Probe(absent, ("slope",))]

    def finer(self) -> SensorDrift:
        """Return the refined form, whose drift settles."""
        return replace(self, settles=True)

    def fitted_to(self, context: SearchContext) -> SensorDrift:
        """Return the effect with the begin of this record."""
        return replace(self, begin=context.begin)

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        elapsed = s.time - self.begin
        return {
            self.channel: y[self.channel]
            + p.slope * (settled(elapsed, p.settling) if self.settles else elapsed)
        }


def settled(elapsed: Any, rate: Any) -> Any:
    """Return (1 - exp(-rate elapsed)) / rate, s, for ``elapsed`` in s and ``rate`` in 1/s.

    At a rate of zero that is ``elapsed``; small products are evaluated by their series.
    """
    x = rate * elapsed
    slow = real(absolute(x)) < SERIES_BELOW
    series = elapsed * (1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0)))
    return where(slow, series, elapsed * (1.0 - exp(-x)) / where(slow, 1.0, x))


@dataclass(frozen=True)
class SensorStep(OfChannel):
    """Step of zero: y_recorded = y + bias + size from the time ``at`` on.

    ``at`` is in s, ``size`` in the unit of the channel, of either sign. Each record has its own
    values. The step rises over ``width``, centred on ``at``. A search uses a width of one sampling
    interval, so that the cost depends smoothly on ``at``. The time is then known to half an
    interval at best, however small its sigma.

    Attributes
    ----------
    channel, unit : name and unit of the output that it acts on.
    typical : starting size, in the unit of the channel.
    width : rise time of the step, s.
    sized : whether usual sizes are known for the unit. If so, steps up to twenty times ``typical``
        are plausible, otherwise any step.
    """

    channel: str
    unit: str
    typical: float
    width: float = 0.02
    sized: bool = True

    family: ClassVar[str] = "sensor-step"
    path_order: ClassVar[int] = 20
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "The zero of the sensor jumps: y_recorded = y + bias + size from the time at on. Causes "
        "are a vane that is knocked, a connector that slips, an amplifier that changes its range, "
        "or an encoder that resynchronises. Before and after the step the motion is that of the "
        "model, and no other channel changes. A force on the aircraft cannot do this: an "
        "unmeasured load would move all channels, over the time of a short period. Each record has "
        "its own step."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("at", 3.0, "s"), Parameter("size", self.typical, self.unit))

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the zero of the {channel} jumps by {size} at {at}",),
            separating=dict.fromkeys(("sensor-drift", "unmeasured-input"), STEADY_FLIGHT),
            # A larger step (1 km of altitude, 2 g) means lost rows, not a shift of zero.
            plausible={"size": (-20.0 * self.typical, 20.0 * self.typical)} if self.sized else {},
            onset="at",
            per_record=True,
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe the size at the begin of the record; a later step only shifts the response."""
        return [
            Probe(
                {"at": context.begin + 0.5 * self.width, **self.absent},
                ("size",),
                shifts=True,
                sharp=True,
            )
        ]

    def fitted_to(self, context: SearchContext) -> SensorStep:
        """Return the effect with a rise time of one sampling interval of the record."""
        return replace(self, width=context.interval if context.interval > 0 else self.width)

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: y[self.channel] + p.size * risen(s.time, p.at, self.width)}


VARIANTS: tuple[Traceable, ...] = (
    *(SensorScale(channel) for channel in ("alpha", "q", "nz", "altitude")),
    *_square_or_cube(_LONGITUDINAL_CURVES),
    SensorDrift("alpha", "rad", 5e-4),
    SensorDrift("q", "rad/s", 5e-4),
    SensorDrift("nz", "g", 5e-3),
    SensorDrift("altitude", "m", 5.0),
    SensorStep("alpha", "rad", 0.01),
    SensorStep("q", "rad/s", 0.01),
    SensorStep("nz", "g", 0.1),
    SensorStep("altitude", "m", 50.0),
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return a scale, a square, a cube, a drift and a step for each output that ``VARIANTS`` does
    not cover.
    """
    states = {signal.name for signal in equations.states}
    made: list[Traceable] = []
    for name, unit in ((signal.name, signal.unit) for signal in further_outputs(equations)):
        large, sized = large_output(unit), has_typical_output_size(unit)
        curve = SensorCurve(name, unit, 0.2 / large, -large, large, is_state=name in states)
        made += [
            SensorScale(name),
            *_square_or_cube([curve]),
            SensorDrift(name, unit, 0.0025 * large, sized=sized),
            SensorStep(name, unit, 0.05 * large, sized=sized),
        ]
    return tuple(made)
