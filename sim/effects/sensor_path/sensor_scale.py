"""A wrong scale factor of one output channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import further_outputs

_ALIASES: Mapping[str, tuple[str, ...]] = MappingProxyType(
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
        return _ALIASES.get(self.channel, ())

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


VARIANTS: tuple[Traceable, ...] = tuple(
    SensorScale(channel) for channel in ("alpha", "q", "nz", "altitude")
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """One for each output that has none yet."""
    return tuple(SensorScale(signal.name) for signal in further_outputs(equations))
