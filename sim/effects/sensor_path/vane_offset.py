"""An angle-of-attack vane ahead of the centre of gravity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.traits import Traits

ANOTHER_SPEED = "the same maneuver at another airspeed: the error of a vane goes with q/V, a lag or a delay stays"


@dataclass(frozen=True)
class VaneOffset:
    """The vane sits ``arm`` metres ahead of the centre of gravity: alpha_m = alpha - (arm/V) q.

    ``arm`` in m, not negative; it adds to an arm that the vehicle's equations already have. V is the airspeed at the time.
    """

    name: ClassVar[str] = "vane-offset"
    channel: ClassVar[str] = "alpha"
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("arm", 5.0, "m", bounds=(0.0, 100.0)),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"arm": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    aliases: ClassVar[tuple[str, ...]] = ("sensor-lag:alpha", "sensor-delay:alpha", "accelerometer-offset:nz")
    traits: ClassVar[Traits] = Traits(
        sentences=("the vane sits {arm} ahead of the centre of gravity and feels the pitch rate",),
        short_name="vane ahead",
        separating=dict.fromkeys(("sensor-lag", "sensor-delay"), ANOTHER_SPEED),
        twins=("accelerometer-offset:nz",),
        equivalents=("accelerometer-offset:nz",),
        plausible={"arm": (0.0, 40.0)},
    )
    explanation: ClassVar[str] = (
        "A vane ahead of the centre of gravity goes up with the nose while the aircraft pitches, so that the air meets it from further above: "
        "alpha_m = alpha - (arm/V) q, arm >= 0 in m ahead of the centre of gravity. In the short period q runs ahead of alpha, and taking some of "
        "it off makes the reading late: a lag or a delay of the vane by arm/V looks much the same, and only fast reversals, where q and alpha_dot "
        "differ by the lift, tell them apart. An accelerometer as far behind reads the same record under other derivatives, see "
        "accelerometer-offset:nz. A vane behind the centre of gravity would look like a late q; it is not built, so its arm is not "
        "allowed."
    )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"arm": 0.0}, ("arm",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"alpha": y["alpha"] - p.arm / s.V * s.q}


VARIANTS: tuple[Traceable, ...] = (VaneOffset(),)
