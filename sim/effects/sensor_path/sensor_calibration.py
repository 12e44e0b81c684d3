"""Calibration errors of one output channel: scale factor, nonlinear curve, drift and step of zero.

In every effect y is the true value of the channel, in the unit of the channel, before the constant
bias is added.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import (
    STEADY_FLIGHT,
    OfChannel,
    for_outputs,
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

SLOW_AND_QUICK = (
    "slow maneuvers beside quick doublets, small and large: a scale is the same in all of them"
)
WITH_LOAD_FACTOR = (
    "a record with the load factor as well: kinematics then tie the channels together"
)


@dataclass(frozen=True)
class SensorScale(OfChannel):
    """Scale factor error: y_recorded = scale y + bias.

    ``scale`` is positive and has no unit; 1 for a correct sensor. A scale of the altitude is
    observable only if it is large: another initial state and ballistic coefficient ``beta`` give
    nearly the same fall (a scale of 1.03 leaves a residual of a seventh of the noise).

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
        "The sensor's calibration factor is wrong: y_recorded = scale y + bias. A vane in the "
        "upwash of the fuselage reads too much, a gyro with a wrong range setting any amount. One "
        "scaled channel contradicts the others: the kinematics alpha_dot = q - (g/V)(nz - 1) join "
        "the three without any aerodynamics, so that with alpha, q and nz at hand a single scale "
        "shows. With two channels it only changes the derivatives: the lift slope for alpha, all "
        "moment derivatives for q, and the record cannot say which is at fault. An altitude scaled "
        "together with the density's scale height and with beta gives the same fall but for "
        "gravity: only where it is large does it show."
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

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"scale": 1.0}, ("scale",))]

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
# rad, rad/s, g: range about trim that is assumed where that of the record is not known
LARGEST = {"alpha": 0.15, "q": 0.3, "nz": 3.0}
POWERS: Mapping[str, int] = MappingProxyType({"curvature": 2, "cubic": 3})
BOTH = tuple(POWERS)
AT_HALF = 2.0  # The starting cubic term equals the starting quadratic term at half of the range.
WITH_OTHERS = (
    "a record with the other two of alpha, q and nz: a bent load moves all three by the "
    "kinematics, a bent reading one"
)


@dataclass(frozen=True)
class SensorCurve(OfChannel):
    """Nonlinear calibration: y_recorded = y + curvature y^2 + cubic y^3 + bias.

    y is the true value less ``middle``. ``curvature`` is in 1/unit of the channel and ``cubic`` in
    1/unit^2, of either sign. The base form has one of the two, the refined form both. Values are
    plausible if the reading rises over the whole range, 1 + 2 curvature y + 3 cubic y^2 > 0 for
    each parameter alone, and is at most twice the true value at its ends.

    Attributes
    ----------
    channel, unit : name and unit of the output that it acts on.
    typical : starting value of ``curvature``, 1/unit.
    low, high : range of the recorded values about ``middle``, in the unit of the channel.
    middle : value of the channel where y is zero; 0 if readings are perturbations from trim.
    is_state : whether the channel is a state, whose range is known without its bias.
    bends : names of the parameters of this form.
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
        "The sensor's calibration is not straight: y_recorded = y + curvature y^2 + bias, y "
        "counted from trim, where the slope is one. A vane near a fuselage whose upwash changes "
        "with the angle, a potentiometer loaded at one end and a filter of pressures do this. "
        "Pull-ups and push-overs of one size then read unlike. A sensor that errs alike to both "
        "sides has cubic y^3 in the place of the square, and a freer form has both. The kinematics "
        "alpha_dot = q - (g/V) nz tell the channel whose reading is bent; lift or moment that bend "
        "over the angle of attack change the motion itself and obey the kinematics. With one "
        "channel alone the two look much the same."
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
                name: limits
                for name, limits in self._plausible_ranges().items()
                if name in self.bends
            },
        )

    def _plausible_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Return the plausible range of each parameter, see the class."""
        up, down = max(self.high, 1e-6), min(self.low, -1e-6)
        reach = max(up, -down)
        return {
            "curvature": (-0.5 / up, -0.5 / down),
            "cubic": (-1.0 / (3.0 * reach**2), 1.0 / reach**2),
        }

    def finer(self) -> SensorCurve:
        """Return the refined form, with both parameters."""
        return replace(self, bends=BOTH)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe(self.absent, self.bends)]

    def fitted_to(self, context: SearchContext) -> SensorCurve:
        """Return the effect with the range of the record, less the bias of the channel."""
        recorded_range = context.flown_range(self.channel)
        if recorded_range is None:
            return self
        # The range of a state does not contain the bias of its sensor.
        bias = 0.0 if self.is_state else context.values.get(f"bias_{self.channel}", 0.0)
        low, high = recorded_range[0] - bias, recorded_range[1] - bias
        if max(low, -high) > high - low:
            # Values far from zero: there a square could not be distinguished from a scale.
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
    SensorCurve("alpha", "rad", 3.0, -LARGEST["alpha"], LARGEST["alpha"], is_state=True),
    SensorCurve("q", "rad/s", 0.8, -LARGEST["q"], LARGEST["q"], is_state=True),
    SensorCurve("nz", "g", 0.1, -LARGEST["nz"], LARGEST["nz"]),
)


def _square_or_cube(curves: Sequence[SensorCurve]) -> tuple[Traceable, ...]:
    """Return each curve twice: with the square only, and with the cube only."""
    return tuple(replace(each, bends=(name,)) for each in curves for name in BOTH)


SCALE_VARIANTS: tuple[Traceable, ...] = (
    *(SensorScale(channel) for channel in ("alpha", "q", "nz", "altitude")),
    *_square_or_cube(_LONGITUDINAL_CURVES),
)


def scale_made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return a scale, a square and a cube for each output that ``SCALE_VARIANTS`` lacks."""
    states = {signal.name for signal in equations.states}
    further = further_outputs(equations)
    sized = ((each, large_output(each.unit)) for each in further)
    curves = [
        SensorCurve(each.name, each.unit, 0.2 / large, -large, large, is_state=each.name in states)
        for each, large in sized
    ]
    return (*(SensorScale(each.name) for each in further), *_square_or_cube(curves))


HIGHEST_DRIFT_RATE = 2.0  # 1/s: a drift that settles faster is a step at the begin of the record
SERIES_BELOW = 1e-3  # of rate times elapsed time: the series is then exact to rounding


@dataclass(frozen=True)
class SensorDrift(OfChannel):
    """Drift of zero: y_recorded = y + bias + slope (t - begin).

    The refined form settles: slope (1 - exp(-settling (t - begin))) / settling. ``slope`` is in
    unit/s, of either sign, ``settling`` in 1/s; each record has its own values.

    Attributes
    ----------
    channel, unit : name and unit of the output that it acts on.
    typical : starting slope, unit/s.
    begin : first time of the record, s. It decorrelates the drift from the bias of the channel.
    sized : whether usual sizes are known for the unit; then slopes up to twenty times ``typical``
        are plausible, otherwise any.
    settles : whether the form has ``settling``.
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
        "The sensor's zero wanders while the record runs: y_recorded = y + bias + slope (t - "
        "begin). Warming electronics and gyros do this, and settle: a freer form has slope (1 - "
        "exp(-settling (t - begin))) / settling. The deviation grows steadily whatever the "
        "maneuver, in one channel alone and against the kinematics. A trim or a speed that changes "
        "slowly moves all channels together instead. The slope belongs to one record; on another "
        "it has another value, so that another record cannot confirm it, and on measured data slow "
        "disturbances easily pass for it. On a falling body a drift of the altitude stands for "
        "anything that adds a constant to the measured velocity, a horizontal motion seen by the "
        "radar among them."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        slope = Parameter("slope", self.typical, f"{self.unit}/s")
        return (
            (slope, Parameter("settling", 0.2, "1/s", bounds=(0.0, HIGHEST_DRIFT_RATE)))
            if self.settles
            else (slope,)
        )

    @property
    def largest_slope(self) -> float:
        """Largest plausible slope, unit/s; smaller for an altitude, because a drift would otherwise
        stand for any error of the model of a fall.
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

    ``at`` is in s, ``size`` in the unit of the channel, of either sign; each record has its own
    values. The step rises over ``width``, centred on ``at``. A search uses one sampling interval,
    so that the cost depends smoothly on ``at``; the time is then known to half an interval at
    best, however small its sigma.

    Attributes
    ----------
    channel, unit : name and unit of the output that it acts on.
    typical : starting size, in the unit of the channel.
    width : rise time of the step, s.
    sized : whether usual sizes are known for the unit; then sizes up to twenty times ``typical``
        are plausible, otherwise any.
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
        "The sensor's zero jumps while the record runs and stays there: y_recorded = y + bias + "
        "size from the time at on. A vane that is knocked, a connector that slips, an amplifier "
        "that changes its range and a resynchronised encoder do this. Before and after, the motion "
        "is that of the model; no other channel takes part, which no force on the aircraft could "
        "leave so: a load that nobody recorded would move all channels, and over the time of a "
        "short period. The step belongs to one record."
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
    """Return a drift and a step for each output that ``ZERO_VARIANTS`` lacks."""
    return for_outputs(
        equations,
        lambda s: SensorDrift(
            s.name, s.unit, 0.0025 * large_output(s.unit), sized=has_typical_output_size(s.unit)
        ),
        lambda s: SensorStep(
            s.name, s.unit, 0.05 * large_output(s.unit), sized=has_typical_output_size(s.unit)
        ),
    )


VARIANTS: tuple[Traceable, ...] = (*SCALE_VARIANTS, *ZERO_VARIANTS)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return the effects of this file for outputs that ``VARIANTS`` lacks."""
    return (*scale_made_for(equations), *zero_made_for(equations))
