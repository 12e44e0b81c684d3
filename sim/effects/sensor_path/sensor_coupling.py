"""A rate gyro that senses the load factor, or the rate about another axis."""

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
        sentences=("the gyro senses the load factor: the pitch rate is read too large by {gain}",),
        short_name="gyro that senses the load factor",
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


@dataclass(frozen=True)
class TurnedGyro:
    """A roll or yaw gyro that is turned towards the other axis: it reads r + share p, or p + share
    r.

    ``share`` without unit, the sine of the angle, of either sign. It acts ahead of all other sensor
    effects.

    Attributes
    ----------
    channel, other : the rate that is recorded, and that it feels as well.
    """

    channel: str
    other: str

    rank: ClassVar[int] = -10
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("share", 0.05, "1"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"share": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "A gyro whose axis is turned by a few degrees towards another axis shows a share of that "
        "rate as well: r_m = r + share p, share the sine of the angle. Rolling is fast where "
        "yawing is slow, so that 3 degrees are soon seen. The derivatives cannot take it in: the "
        "kinematics of the sideslip, and the lateral load factor, know the true yaw rate. A "
        "platform that is turned as a whole has such shares of opposite sign in both gyros."
    )

    @property
    def name(self) -> str:
        return f"sensor-coupling:{self.channel}"

    @property
    def outputs_read(self) -> tuple[str, ...]:
        return (self.other,)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {channel} gyro is turned: it shows {share} times the other rate too",),
            short_name="gyro turned towards another axis",
            plausible={"share": (-0.3, 0.3)},
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"share": 0.0}, ("share",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: y[self.channel] + p.share * y[self.other]}


VARIANTS: tuple[Traceable, ...] = (SensorCoupling(), TurnedGyro("p", "r"), TurnedGyro("r", "p"))
