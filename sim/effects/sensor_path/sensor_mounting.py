"""Mounting of sensors: an accelerometer or a flow vane away from the centre of gravity; a rate gyro
that senses the load factor, or that is turned towards another axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import OfChannel
from sim.effects.loads import at_arm
from sim.maths import G0

MEASURE_IT = (
    "no maneuver helps while forces and moments are linear: measure where the instruments "
    "are mounted, or check under which effect the force by the control surface{ (CL_de, L_delta, "
    "CY_dr, CY_da)} is plausible: it differs most"
)
# Accelerometers that have a vane in their plane, with the same effect on the kinematics.
_WITH_VANE = ("nz", "ny")
_TURNING = {"q": "pitch", "r": "yaw"}
_PLACES = {"nz": "{arm_side}", "ny": "{arm_side}", "nx": "{arm} below"}
ACCELEROMETER_IN_PITCH = (
    "An accelerometer ahead of the centre of gravity is lifted when the nose accelerates upward: "
    "nz_m = nz + (arm/g0) q_dot, arm in m, positive ahead, negative behind. The pitch acceleration "
    "answers the elevator at once, so the reading jumps when the elevator does, down first for one "
    "that is ahead. To the kinematics alpha_dot = q - (g/V) nz an accelerometer at arm is the same "
    "as a vane at -arm, and the short period keeps its form with alpha - (arm/V) q in the place of "
    "alpha: CL_de, CL_q, CL_alpha and Cm_q take other values and every sample is the same. No "
    "maneuver tells the two apart while lift and moment are linear; only where the instruments sit "
    "does, or a CL_de that no tail could make. The library has no vane behind the centre of "
    "gravity: where the declared derivatives speak for one, an accelerometer ahead is not claimed."
)
ACCELEROMETER_IN_YAW = (
    "A lateral accelerometer ahead of the centre of gravity is pushed to the right when the nose "
    "accelerates to the right: ny_m = ny + (arm/g0) r_dot, arm in m, positive ahead, negative "
    "behind. The yaw acceleration answers the rudder at once, so the reading jumps when the rudder "
    "does. To the kinematics of sideslip an accelerometer at arm is the same as a vane at -arm; "
    "side-force derivatives that are free take other values and every sample is the same, so that "
    "only the declared derivatives, or those held at zero, tell the two apart."
)
BELOW = (
    "An axial accelerometer below the centre of gravity is carried forward when the nose "
    "accelerates upward: nx_m = nx + (arm/g0) q_dot, arm in m below the centre of gravity. The "
    "pitch acceleration answers the elevator at once, and the reading jumps with it. The axial "
    "force hardly changes. The residual of nx therefore has the shape of the pitch acceleration, "
    "and no other channel has it."
)
_EXPLANATIONS = {"nz": ACCELEROMETER_IN_PITCH, "ny": ACCELEROMETER_IN_YAW, "nx": BELOW}


@dataclass(frozen=True)
class AccelerometerOffset(OfChannel):
    """The accelerometer is ``arm`` metres ahead of the centre of gravity: nz_m = nz + (arm/g0)
    q_dot.

    ``arm`` is in m, positive ahead. q_dot includes the contributions of elastic modes, gusts and
    other effects; if a held input jumps, so does q_dot. A lateral accelerometer reads ny + (arm/g0)
    r_dot. An axial one reads nx + (arm/g0) q_dot, where ``arm`` is its distance below the centre of
    gravity.

    Attributes
    ----------
    channel : name of the output.
    rate : angular rate whose derivative the accelerometer senses.
    """

    channel: str = "nz"
    rate: str = "q"

    unit: ClassVar[str] = "g"
    family: ClassVar[str] = "accelerometer-offset"
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("arm", 3.0, "m", bounds=(-100.0, 100.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"arm": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR

    @property
    def explanation(self) -> str:
        return _EXPLANATIONS[self.channel]

    @property
    def rates_read(self) -> tuple[str, ...]:
        return (self.rate,)

    @property
    def aliases(self) -> tuple[str, ...]:
        return ("vane-offset",) if self.channel in _WITH_VANE else ()

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                f"the accelerometer sits {_PLACES[self.channel]} the centre of gravity and senses "
                f"the {_TURNING[self.rate]} acceleration",
            ),
            short_name="accelerometer away from the centre of gravity",
            separating={"vane-offset": MEASURE_IT},
            twins=self.aliases,
            equivalents=(*self.aliases, "guard:vane-behind") if self.aliases else (),
            usual={"arm": 1.0},  # m: it is mounted near the center of gravity
            plausible={"arm": (-40.0, 40.0) if self.aliases else (-5.0, 5.0)},
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"arm": 0.0}, ("arm",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: y[self.channel] + p.arm / G0 * getattr(s, f"{self.rate}_dot")}


TURNING = {"q": "pitch", "r": "yaw"}
ANOTHER_SPEED = (
    "the same maneuver at another airspeed: the error of a vane is its arm times the rate "
    "over the airspeed, a lag or a delay stays"
)
VANE_IN_PITCH = (
    "A vane ahead of the centre of gravity goes up with the nose while the aircraft pitches, so "
    "that the air meets it from further above: alpha_m = alpha - (arm/V) q, arm >= 0 in m ahead of "
    "the centre of gravity. In the short period q runs ahead of alpha, and taking some of it off "
    "makes the reading late: a lag or a delay of the vane by arm/V looks much the same, and only "
    "fast reversals, where q and alpha_dot differ by the lift, tell them apart. An accelerometer "
    "as far behind reads the same record under other derivatives, see accelerometer-offset:nz. A "
    "vane behind the centre of gravity would look like a late q; it is not built, so its arm is "
    "not allowed."
)
VANE_IN_YAW = (
    "A vane of sideslip ahead of the centre of gravity swings with the nose: beta_m = beta + "
    "(arm/V) r, arm >= 0 in m ahead of the centre of gravity, since a nose that yaws to the right "
    "carries the vane to the right. In the Dutch roll that makes the reading late: a lag or a "
    "delay of the vane by arm/V looks much the same, and only fast rudder reversals tell them "
    "apart. A lateral accelerometer as far behind reads the same record under other derivatives, "
    "see accelerometer-offset:ny. A vane behind the centre of gravity is not built, so its arm is "
    "not allowed."
)


@dataclass(frozen=True)
class VaneOffset:
    """The vane is ``arm`` metres ahead of the centre of gravity: alpha_m = alpha - (arm/V) q.

    ``arm`` is in m, not negative; it adds to an arm in the vehicle's equations. V is the airspeed.
    A vane of sideslip reads beta + (arm/V) r.

    Attributes
    ----------
    channel, rate : name of the output, and angular rate in the plane of the vane.
    sign : sign of the contribution of the rate.
    speed : name of the constant that is the airspeed, for equations without a varying airspeed.
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
        return VANE_IN_PITCH if self.channel == "alpha" else VANE_IN_YAW

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
                f"the vane sits {{arm}} ahead of the centre of gravity and senses the "
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


POSITION_VARIANTS: tuple[Traceable, ...] = (
    AccelerometerOffset(),
    AccelerometerOffset("ny", "r"),
    AccelerometerOffset("nx"),
    VaneOffset(),
    VaneOffset("beta", "r", 1.0),
    VaneOffset(speed="reference_airspeed"),
)


JUMPS = (
    "sharp steps of the control, recorded fast: the load factor jumps with the surface, and a gyro "
    "that feels it jumps along"
)


@dataclass(frozen=True)
class SensorCoupling:
    """The gyro reads q + gain nz, where nz is the true load factor at the centre of gravity.

    ``gain`` is in rad/s per g, of either sign. The constant part of nz becomes part of the bias of
    q. The effect acts before all other sensor effects.
    """

    name: ClassVar[str] = "sensor-coupling:q"
    channel: ClassVar[str] = "q"
    outputs_read: ClassVar[tuple[str, ...]] = ("nz",)
    path_order: ClassVar[int] = -10
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
        "gain nz, gain in rad/s per g. To the kinematics alpha_dot = q - (g/V) nz it is the same "
        "as a load factor read by 1/(1 + gain V/g) of its size; what tells the two apart is only "
        "that nz jumps with the control surface (CL_de) while a pitch rate cannot. Where CL_de is "
        "small the record cannot tell them apart, and the derivatives differ."
    )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"gain": 0.0}, ("gain",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"q": y["q"] + p.gain * y["nz"]}


@dataclass(frozen=True)
class TurnedGyro(OfChannel):
    """A roll or yaw gyro that is turned towards the other axis: it reads r + share p, or p + share
    r.

    ``share`` is the sine of the angle, of either sign, without unit. The effect acts before all
    other sensor effects.

    Attributes
    ----------
    channel : the recorded rate.
    other : the rate that the gyro senses in addition.
    """

    channel: str
    other: str

    path_order: ClassVar[int] = -10
    family: ClassVar[str] = "sensor-coupling"
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
    def outputs_read(self) -> tuple[str, ...]:
        return (self.other,)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                f"the {{channel}} gyro is turned: it also reads {{share}} times {self.other}",
            ),
            short_name="gyro turned towards another axis",
            plausible={"share": (-0.3, 0.3)},
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"share": 0.0}, ("share",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: y[self.channel] + p.share * y[self.other]}


COUPLING_VARIANTS: tuple[Traceable, ...] = (
    SensorCoupling(),
    TurnedGyro("p", "r"),
    TurnedGyro("r", "p"),
)


VARIANTS: tuple[Traceable, ...] = (
    *POSITION_VARIANTS,
    *COUPLING_VARIANTS,
)
