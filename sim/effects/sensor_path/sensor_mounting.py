"""Mounting of sensors: an accelerometer or a flow vane away from the centre of gravity; a rate gyro
that senses the load factor, or that is turned towards another axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import Traceable, Traits
from sim.effects.instances import OfChannel, ProbedAtAbsence
from sim.effects.loads import DisplacedVane
from sim.maths import G0

MEASURE_IT = (
    "no maneuver helps while forces and moments are linear: measure where the instruments "
    "are mounted, or check under which effect the force by the control surface{ (CL_de, L_delta, "
    "CY_dr, CY_da)} is plausible: it differs most"
)
TURNING = {"q": "pitch", "r": "yaw"}  # names of the axes of rates
# Accelerometers with a vane in their plane, which the kinematics cannot distinguish from them.
_WITH_VANE = ("nz", "ny")
# Position relative to the centre of gravity, as the begin of a sentence.
_PLACES = {"nz": "{arm_side}", "ny": "{arm_side}", "nx": "{arm} below"}
ACCELEROMETER_IN_PITCH = (
    "Displaced accelerometer: ahead of the centre of gravity it senses the pitch acceleration, "
    "nz_m = nz + (arm/g0) q_dot, with arm in m, positive ahead and negative behind. The pitch "
    "acceleration follows the elevator at once, so the reading jumps when the elevator does. In "
    "the kinematics alpha_dot = q - (g/V) nz, an accelerometer at arm is the same as a vane at "
    "-arm. The short period keeps its form if alpha is replaced by alpha - (arm/V) q: with other "
    "values of CL_de, CL_q, CL_alpha and Cm_q every sample is the same. While lift and moment are "
    "linear, no maneuver distinguishes the two. Only the mounting position does, or a CL_de that "
    "no tail could have. The library has no vane behind the centre of gravity. If the declared "
    "derivatives indicate such a vane, an accelerometer ahead is not claimed."
)
ACCELEROMETER_IN_YAW = (
    "Displaced lateral accelerometer: ahead of the centre of gravity it senses the yaw "
    "acceleration, ny_m = ny + (arm/g0) r_dot, with arm in m, positive ahead and negative behind. "
    "The yaw acceleration follows the rudder at once, so the reading jumps when the rudder does. "
    "In the kinematics of sideslip, an accelerometer at arm is the same as a vane at -arm. With "
    "other values of the estimated side-force derivatives every sample is the same. Only the "
    "declared derivatives, or those held at zero, distinguish the two."
)
ACCELEROMETER_BELOW = (
    "Displaced axial accelerometer: below the centre of gravity it senses the pitch acceleration, "
    "nx_m = nx + (arm/g0) q_dot, with arm in m below the centre of gravity. The pitch acceleration "
    "follows the elevator at once, and the reading jumps with it, while the axial force hardly "
    "changes. The residual of nx therefore has the shape of the pitch acceleration, and no other "
    "channel has this residual."
)
_EXPLANATIONS = {
    "nz": ACCELEROMETER_IN_PITCH,
    "ny": ACCELEROMETER_IN_YAW,
    "nx": ACCELEROMETER_BELOW,
}


@dataclass(frozen=True)
class AccelerometerOffset(OfChannel, ProbedAtAbsence):
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
                f"the {TURNING[self.rate]} acceleration",
            ),
            short_name="accelerometer away from the centre of gravity",
            separating={"vane-offset": MEASURE_IT},
            twins=self.aliases,
            equivalents=(*self.aliases, "guard:vane-behind") if self.aliases else (),
            usual={"arm": 1.0},  # m; it is mounted near the centre of gravity
            plausible={"arm": (-40.0, 40.0) if self.aliases else (-5.0, 5.0)},
        )

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: y[self.channel] + p.arm / G0 * getattr(s, f"{self.rate}_dot")}


ANOTHER_SPEED = (
    "the same maneuver at another airspeed: the error of a vane is its arm times the rate "
    "over the airspeed, a lag or a delay stays"
)
VANE_IN_PITCH = (
    "Displaced vane: ahead of the centre of gravity it senses the pitch rate, alpha_m = alpha - "
    "(arm/V) q, with arm >= 0 in m ahead of the centre of gravity. The vane moves up with the nose "
    "while the aircraft pitches up, so the air meets it from further above. In the short period q "
    "leads alpha, so the reading is late. A lag or a delay of the vane by arm/V therefore looks "
    "much the same. Only fast reversals, where q and alpha_dot differ by the lift, distinguish "
    "them. An accelerometer as far behind gives the same record with other derivatives, see "
    "accelerometer-offset:nz. A vane behind the centre of gravity would make the reading early. "
    "Such vanes are not built, so a negative arm is not allowed."
)
VANE_IN_YAW = (
    "Displaced vane of sideslip: ahead of the centre of gravity it senses the yaw rate, beta_m = "
    "beta + (arm/V) r, with arm >= 0 in m ahead of the centre of gravity. A nose that yaws to the "
    "right moves the vane to the right. In the Dutch roll this makes the reading late. A lag or a "
    "delay of the vane by arm/V therefore looks much the same, and only fast rudder reversals "
    "distinguish them. A lateral accelerometer as far behind gives the same record with other "
    "derivatives, see accelerometer-offset:ny. Vanes behind the centre of gravity are not built, "
    "so a negative arm is not allowed."
)


@dataclass(frozen=True)
class VaneOffset(DisplacedVane):
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

    @property
    def explanation(self) -> str:
        return VANE_IN_PITCH if self.channel == "alpha" else VANE_IN_YAW

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
            usual={"arm": 10.0},  # m; nose booms
        )

    @property
    def _accelerometer(self) -> str:
        return f"accelerometer-offset:{'nz' if self.channel == 'alpha' else 'ny'}"


GYRO_JUMPS_TOO = (
    "sharp steps of the control, recorded fast: the load factor jumps with the surface, and a gyro "
    "that feels it jumps along"
)


@dataclass(frozen=True)
class SensorCoupling(ProbedAtAbsence):
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
        separating={"sensor-scale": GYRO_JUMPS_TOO},
        plausible={"gain": (-0.2, 0.2)},
    )
    explanation: ClassVar[str] = (
        "A gyro senses the load factor: because its gimbal or beam is not balanced, it reads q_m = "
        "q + gain nz, with gain in rad/s per g. In the kinematics alpha_dot = q - (g/V) nz this is "
        "the same as a load factor that is read with the factor 1/(1 + gain V/g). Only the jumps "
        "of nz with the control surface (CL_de) distinguish the two, because a pitch rate cannot "
        "jump. If CL_de is small, the record cannot distinguish them, and their derivatives "
        "differ."
    )

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"q": y["q"] + p.gain * y["nz"]}


@dataclass(frozen=True)
class TurnedGyro(OfChannel, ProbedAtAbsence):
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
        "A gyro is turned towards an axis: it also reads a share of the rate about that axis, r_m "
        "= r + share p, where share is the sine of the angle. Roll rates are large where yaw rates "
        "are small, so an angle of 3 degrees is easily observable. The derivatives cannot "
        "compensate the effect, because the kinematics of sideslip and the lateral load factor "
        "depend on the true yaw rate. If the whole platform is turned, both gyros have such "
        "shares, of opposite sign."
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

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: y[self.channel] + p.share * y[self.other]}


VARIANTS: tuple[Traceable, ...] = (
    AccelerometerOffset(),
    AccelerometerOffset("ny", "r"),
    AccelerometerOffset("nx"),
    VaneOffset(),
    VaneOffset("beta", "r", 1.0),
    VaneOffset(speed="reference_airspeed"),
    SensorCoupling(),
    TurnedGyro("p", "r"),
    TurnedGyro("r", "p"),
)
