"""A vane behind the centre of gravity: the other reading of an accelerometer ahead of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.airflow import at_arm


@dataclass(frozen=True)
class VaneBehind:
    """alpha_m = alpha + (arm/V) q, ``arm`` in m behind the centre of gravity, not negative; of
    sideslip beta_m = beta - (arm/V) r.

    The library has no vane there, and an accelerometer as far ahead explains every record alike. It
    is put beside that one alone: where its derivatives lie nearer to the declared ones, the
    accelerometer is not what is wrong.

    Attributes
    ----------
    channel, rate : what the vane reads, and the rate of the nose in its plane. sign : of the rate's
    share. accelerometer : the channel of the
        one that reads alike. speed : the constant that is the declared airspeed, for equations
        without an airspeed of the time.
    """

    channel: str = "alpha"
    rate: str = "q"
    sign: float = 1.0
    accelerometer: str = "nz"
    speed: str = "airspeed"

    name: ClassVar[str] = "guard:vane-behind"
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("arm", 5.0, "m", bounds=(0.0, 100.0)),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"arm": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "A generic term: the angle of attack is read too early, alpha_m = alpha + (arm/V) q, as a "
        "vane behind the centre of gravity or a correction "
        "for a nose boom that is not there would do it. An accelerometer ahead of the centre of "
        "gravity gives the same record under other "
        "derivatives. Where the declared derivatives speak for this reading, no cause of the "
        "library is named."
    )

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (self.speed,)

    @property
    def states_read(self) -> tuple[str, ...]:
        return (self.rate,)

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"accelerometer-offset:{self.accelerometer}",)

    @property
    def traits(self) -> Traits:
        return Traits(guard=True, twins=self.aliases, equivalents=self.aliases)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"arm": 0.0}, ("arm",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {
            self.channel: y[self.channel]
            + at_arm(s, vehicle, self.sign * p.arm, self.rate, self.speed)
        }


GUARDS: tuple[Traceable, ...] = (
    VaneBehind(),
    VaneBehind("beta", "r", -1.0, "ny"),
    VaneBehind(speed="reference_airspeed"),
)
