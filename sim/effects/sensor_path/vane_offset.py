"""An angle-of-attack vane ahead of the centre of gravity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.airflow import at_arm

TURNING = {"q": "pitch", "r": "yaw"}
ANOTHER_SPEED = (
    "the same maneuver at another airspeed: the error of a vane goes with q/V, a lag or a delay "
    "stays"
)
OF_PITCH = (
    "A vane ahead of the centre of gravity goes up with the nose while the aircraft pitches, so "
    "that the air meets it from further above: "
    "alpha_m = alpha - (arm/V) q, arm >= 0 in m ahead of the centre of gravity. In the short "
    "period q runs ahead of alpha, and taking some of "
    "it off makes the reading late: a lag or a delay of the vane by arm/V looks much the same, and "
    "only fast reversals, where q and alpha_dot "
    "differ by the lift, tell them apart. An accelerometer as far behind reads the same record "
    "under other derivatives, see "
    "accelerometer-offset:nz. A vane behind the centre of gravity would look like a late q; it is "
    "not built, so its arm is not "
    "allowed."
)
OF_YAW = (
    "A vane of sideslip ahead of the centre of gravity swings with the nose: beta_m = beta + "
    "(arm/V) r, arm >= 0 in m ahead of the centre of "
    "gravity, since a nose that yaws to the right carries the vane to the right. In the Dutch roll "
    "that makes the reading late: a lag or a delay of "
    "the vane by arm/V looks much the same, and only fast rudder reversals tell them apart. A "
    "lateral accelerometer as far behind reads the same "
    "record under other derivatives, see accelerometer-offset:ny. A vane behind the centre of "
    "gravity is not built, so its arm is not allowed."
)


@dataclass(frozen=True)
class VaneOffset:
    """The vane sits ``arm`` metres ahead of the centre of gravity: alpha_m = alpha - (arm/V) q.

    ``arm`` in m, not negative; it adds to an arm that the vehicle's equations already have. V is
    the airspeed at the time. A vane of sideslip reads beta + (arm/V) r.

    Attributes
    ----------
    channel, rate : what the vane reads, and the rate of the nose in its plane. sign : of the rate's
    share. speed : the constant that is the
        declared airspeed, for equations without an airspeed of the time.
    """

    channel: str = "alpha"
    rate: str = "q"
    sign: float = -1.0
    speed: str = "airspeed"

    name: ClassVar[str] = "vane-offset"
    unit: ClassVar[str] = "rad"
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("arm", 5.0, "m", bounds=(0.0, 100.0)),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"arm": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY

    @property
    def explanation(self) -> str:
        return OF_PITCH if self.channel == "alpha" else OF_YAW

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (self.speed,)

    @property
    def states_read(self) -> tuple[str, ...]:
        return (self.rate,)

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"sensor-lag:{self.channel}", f"sensor-delay:{self.channel}", self._accelerometer)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                f"the vane sits {{arm}} ahead of the centre of gravity and feels the "
                f"{TURNING[self.rate]} rate",
            ),
            short_name="vane ahead",
            separating=dict.fromkeys(("sensor-lag", "sensor-delay"), ANOTHER_SPEED),
            twins=(self._accelerometer,),
            equivalents=(self._accelerometer,),
            plausible={"arm": (0.0, 40.0)},
            usual={"arm": 10.0},  # m: nose booms
        )

    @property
    def _accelerometer(self) -> str:
        return f"accelerometer-offset:{'nz' if self.channel == 'alpha' else 'ny'}"

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"arm": 0.0}, ("arm",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {
            self.channel: y[self.channel]
            + at_arm(s, vehicle, self.sign * p.arm, self.rate, self.speed)
        }


VARIANTS: tuple[Traceable, ...] = (
    VaneOffset(),
    VaneOffset("beta", "r", 1.0),
    VaneOffset(speed="reference_airspeed"),
)
