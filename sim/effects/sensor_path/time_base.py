"""A recorder whose clock runs fast or slow."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits


@dataclass(frozen=True)
class TimeBase:
    """Recorded time = ``factor`` x true time, for all channels alike: the rates of all states are
    1/factor of the true ones.

    ``factor`` without unit, positive; 1 where the clock is right, above it where it runs fast.
    Times of events, and those of delays and lags on the input and sensor paths, stay in the
    record's time. Written for equations with a given airspeed: a fall on another time is one under
    another gravity.
    """

    name: ClassVar[str] = "time-base"
    station: ClassVar[Station] = Station.SENSOR_PATH
    needs_constants: ClassVar[tuple[str, ...]] = ("airspeed",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("factor", 1.05, "1", bounds=(0.5, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"factor": 1.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ("sensor-scale:alpha", "sensor-scale:q", "sensor-scale:nz")
    traits: ClassVar[Traits] = Traits(
        sentences=("the times of the record are {factor_percent} {factor_direction}",),
        short_name="clock of the record",
        separating={
            "sensor-scale": (
                "the pitch attitude recorded as well, or the record's time held against another "
                "clock"
            )
        },
        twins=("sensor-scale:alpha", "sensor-scale:q", "sensor-scale:nz"),
        equivalents=("sensor-scale:alpha",),
        plausible={"factor": (0.8, 1.25)},
    )
    explanation: ClassVar[str] = (
        "The clock of the recorder is wrong: recorded time = factor x true time, from a wrong "
        "sampling rate or a file resampled by mistake. Every "
        "motion then seems slower than it is, and a rate that is measured no longer is the slope "
        "of what it is the rate of. The kinematics say "
        "alpha_dot = (q - (g/V) nz) / factor: with alpha, q and nz that is word for word an angle "
        "of attack read too small by the factor, with "
        "other derivatives, and as rare as such clocks are that is what is named. It is a scale of "
        "q and one of nz alike, the latter as good as an "
        "airspeed that is wrong in the vehicle file. Without nz it only changes the derivatives "
        "and leaves no trace. A pitch attitude in the record, "
        "or another clock, tells."
    )

    def pace(self, p: Any) -> Any:
        return p.factor

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return (Probe(self.absent, ("factor",)),)


VARIANTS: tuple[Traceable, ...] = (TimeBase(),)
