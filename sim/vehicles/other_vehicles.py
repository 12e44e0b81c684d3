"""A body falling through the atmosphere, and a multirotor about hover."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Effect, Signal
from sim.effects.input_path.actuator import ActuatorLag
from sim.effects.input_path.input_delay import InputDelay
from sim.maths import absolute, exp, plus


@dataclass(frozen=True)
class Ballistic:
    """Equations of the vertical fall; altitude and velocity are positive up.

    States: ``altitude`` (m), ``velocity`` (m/s). No input. Output: ``altitude``. Ports:
    ``log_density`` adds to the logarithm of the air density, ``log_drag`` to that of the drag
    coefficient.
    """

    explanation = """\
A body falling vertically through an exponential atmosphere.

altitude_ddot = 0.5 rho v^2 / beta - gravity,  rho = rho0 exp(-altitude / H): eqs. 17-20 of the
simulated-flight-data paper with the velocity squared that its eq. 21 lost, and with beta as a mass
per area (kg/m2): the paper's weight per area divided by gravity."""

    name: str = "ballistic"
    states: tuple[Signal, ...] = (
        Signal("altitude", "m", "height above the reference"),
        Signal("velocity", "m/s", "vertical speed, positive up"),
    )
    inputs: tuple[Signal, ...] = ()
    outputs: tuple[Signal, ...] = (Signal("altitude", "m", "height above the reference"),)
    ports: tuple[Signal, ...] = (
        Signal("log_density", "1", "added logarithm of the air density"),
        Signal("log_drag", "1", "added logarithm of the drag coefficient"),
    )
    parameter_names: tuple[str, ...] = (
        "air_density_reference",
        "density_scale_height",
        "gravity",
        "beta",
    )

    factors: ClassVar[Mapping[str, str]] = MappingProxyType({"beta": "kg/m2"})

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        return {
            "air_density": p.air_density_reference
            * exp(s.log_density - s.altitude / p.density_scale_height)
        }

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        pressure = -0.5 * s.air_density * s.velocity * absolute(s.velocity)
        return s.velocity, pressure * exp(s.log_drag) / p.beta - p.gravity

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        return (s.altitude,)


COMMANDS = ("roll_command", "pitch_command", "yaw_command", "thrust_command")
LAG, DELAY = "motor_time_constant", "delay"
_FACTORS = {
    "L_p": "1/s",
    "L_lat": "rad/s2",
    "M_q": "1/s",
    "M_lon": "rad/s2",
    "N_r": "1/s",
    "N_ped": "rad/s2",
    "Z_col": "m/s2",
}
_CONSTANT_TERMS = {"L_0": "rad/s2", "M_0": "rad/s2", "N_0": "rad/s2", "Z_0": "m/s2"}
_INERTIAL_COUPLING = {"L_qr": "1", "M_pr": "1", "N_pq": "1"}
MULTIROTOR_TERMS = {**_FACTORS, **_CONSTANT_TERMS, **_INERTIAL_COUPLING}
MULTIROTOR_DERIVATIVES = {**MULTIROTOR_TERMS, LAG: "s", DELAY: "s"}


@dataclass(frozen=True)
class Multirotor:
    """Equations of a multirotor's angular rates.

    States: ``p``, ``q``, ``r`` (rad/s). Inputs: ``roll_command``, ``pitch_command``,
    ``yaw_command``, ``thrust_command``, in any one unit, as the controller sends them to the motors
    or the mixer. Outputs: ``p``, ``q``, ``r`` and ``az`` (m/s2, specific force, body axes, z down).
    Ports: ``roll``, ``pitch``, ``yaw`` (rad/s2) and ``heave`` (m/s2) add to the three rates and to
    az. Sensors have no free biases: the constant terms include them.
    """

    explanation = """\
Angular rates and vertical specific force of a multirotor about hover, from its recorded roll,
pitch, yaw and thrust commands.

p_dot = L_0 + L_p p + L_lat u_lat + L_qr q r,  q_dot = M_0 + M_q q + M_lon u_lon + M_pr p r,
r_dot = N_0 + N_r r + N_ped u_ped + N_pq p q,  az = Z_0 + Z_col u_col,
each u the command after a first-order lag of the motors and a delay (Tischler and Remple, Aircraft
and Rotorcraft System Identification, 2nd ed., hover models; Wei, Cohen and Tischler, System
Identification and Controller Optimization of a Quadrotor UAV, AHS Forum 71, 2015). L_0, M_0, N_0
are the moments that a steady command balances. L_qr = (Iyy - Izz)/Ixx, M_pr = (Izz - Ixx)/Iyy, N_pq
= (Ixx - Iyy)/Izz."""

    name: str = "multirotor"
    states: tuple[Signal, ...] = (
        Signal("p", "rad/s", "roll rate"),
        Signal("q", "rad/s", "pitch rate"),
        Signal("r", "rad/s", "yaw rate"),
    )
    inputs: tuple[Signal, ...] = (
        Signal("roll_command", "1", "roll command to the motors"),
        Signal("pitch_command", "1", "pitch command to the motors"),
        Signal("yaw_command", "1", "yaw command to the motors"),
        Signal("thrust_command", "1", "collective command to the motors"),
    )
    outputs: tuple[Signal, ...] = (
        Signal("p", "rad/s", "roll rate"),
        Signal("q", "rad/s", "pitch rate"),
        Signal("r", "rad/s", "yaw rate"),
        Signal("az", "m/s2", "vertical specific force, down"),
    )
    ports: tuple[Signal, ...] = (
        Signal("roll", "rad/s2", "added roll acceleration"),
        Signal("pitch", "rad/s2", "added pitch acceleration"),
        Signal("yaw", "rad/s2", "added yaw acceleration"),
        Signal("heave", "m/s2", "added vertical specific force"),
    )
    parameter_names: tuple[str, ...] = tuple(MULTIROTOR_TERMS)

    biased_outputs: ClassVar[tuple[str, ...]] = ()
    totals: ClassVar[bool] = True
    factors: ClassVar[Mapping[str, str]] = MappingProxyType(_FACTORS)

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        return {}

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        return (
            plus(p.L_0 + p.L_p * s.p + p.L_lat * s.roll_command + p.L_qr * s.q * s.r, s.roll),
            plus(p.M_0 + p.M_q * s.q + p.M_lon * s.pitch_command + p.M_pr * s.p * s.r, s.pitch),
            plus(p.N_0 + p.N_r * s.r + p.N_ped * s.yaw_command + p.N_pq * s.p * s.q, s.yaw),
        )

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        return s.p, s.q, s.r, plus(p.Z_0 + p.Z_col * s.thrust_command, s.heave)


def motor_path(*, lag: bool, delay: bool) -> tuple[Effect, ...]:
    """Return the effects between commands and motors.

    All commands have the same lag and the same delay, with the parameters ``motor_time_constant``
    and ``delay``.
    """
    lags = tuple(ActuatorLag(name, "1", name, LAG) for name in COMMANDS) if lag else ()
    delays = tuple(InputDelay(name, in_vehicle_model=True, label=name) for name in COMMANDS)
    return (*lags, *delays) if delay else lags
