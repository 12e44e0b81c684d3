"""The zero of one output channel drifts, steadily or settling, or jumps at one time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import STEADY_FLIGHT, for_outputs, has_output_size, large_output
from sim.effects.timing import risen
from sim.maths import absolute, exp, real, where

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


VARIANTS: tuple[Traceable, ...] = (
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
