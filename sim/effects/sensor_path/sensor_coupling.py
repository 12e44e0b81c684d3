"""A rate gyro that feels the load factor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits

JUMPS = (
    "sharp steps of the control, recorded fast: the load factor jumps with the surface, and a gyro "
    "that feels it jumps along"
)


@dataclass(frozen=True)
class SensorCoupling:
    """The gyro reads q + gain nz, nz the true load factor at the centre of gravity.

    ``gain`` in rad/s per g, either sign. The constant part of nz goes into the bias of q. It acts
    ahead of all other sensor effects.
    """

    name: ClassVar[str] = "sensor-coupling:q"
    channel: ClassVar[str] = "q"
    outputs_read: ClassVar[tuple[str, ...]] = ("nz",)
    rank: ClassVar[int] = -10
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("gain", 0.02, "rad/s/g"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"gain": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ("sensor-scale:nz",)
    traits: ClassVar[Traits] = Traits(
        sentences=("the gyro feels the load factor: the pitch rate is read too large by {gain}",),
        short_name="gyro that feels the load factor",
        separating={"sensor-scale": JUMPS},
        plausible={"gain": (-0.2, 0.2)},
    )
    explanation: ClassVar[str] = (
        "A gyro whose gimbal or beam is not balanced answers to acceleration as well: q_m = q + "
        "gain nz, gain in rad/s per g. To the kinematics "
        "alpha_dot = q - (g/V) nz it is the same as a load factor read by 1/(1 + gain V/g) of its "
        "size; what tells the two apart is only that nz "
        "jumps with the control surface (CL_de) while a pitch rate cannot. Where CL_de is small "
        "the record cannot tell them apart, and the "
        "derivatives differ."
    )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"gain": 0.0}, ("gain",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"q": y["q"] + p.gain * y["nz"]}


VARIANTS: tuple[Traceable, ...] = (SensorCoupling(),)
