"""Uncoupled motions of an aircraft: short period, longitudinal motion with airspeed and pitch
attitude, low-order equivalent system of an augmented aircraft, and lateral-directional motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Signal
from sim.maths import G0, cos, plus, sin, times

SHORT_PERIOD_OUTPUTS = (
    Signal("alpha", "rad", "angle of attack at the vane"),
    Signal("q", "rad/s", "pitch rate"),
    Signal("nz", "g", "normal load factor, positive up"),
)
GUST = Signal("gust", "rad", "upward gust over airspeed")
AIRSPEED_CHANGE = Signal("airspeed_change", "m/s", "airspeed above the declared one")


@dataclass(frozen=True)
class ShortPeriod:
    """Equations of the rigid short period; elastic modes and gusts act through the ports.

    States: angle of attack ``alpha`` (rad), pitch rate ``q`` (rad/s). Input: ``elevator`` (rad).
    Outputs: ``alpha`` (vane at the centre of gravity), ``q``, ``nz`` (g). Ports: ``gust`` is an
    upward gust over airspeed (rad), which adds to alpha in the loads and in the vane's reading;
    ``lift`` adds to CL, ``moment`` to Cm.
    """

    explanation = """\
Longitudinal short period of an aircraft, non-dimensional derivatives; constant airspeed unless a
port changes it.

alpha_dot = q - rho V^2 S CL / (2 m V), q_dot = rho V^2 S c Cm / (2 Iy), nz = rho V^2 S CL / (2 m
g0) (eqs. 22-25 of the simulated-flight-data paper). Perturbations about trim; the rates are made
non-dimensional with c / (2 V). Elevator trailing edge down positive, nz positive up."""

    name: str = "rigid"
    states: tuple[Signal, ...] = (
        Signal("alpha", "rad", "angle of attack"),
        Signal("q", "rad/s", "pitch rate"),
    )
    inputs: tuple[Signal, ...] = (Signal("elevator", "rad", "elevator, trailing edge down"),)
    outputs: tuple[Signal, ...] = SHORT_PERIOD_OUTPUTS
    ports: tuple[Signal, ...] = (
        GUST,
        AIRSPEED_CHANGE,
        Signal("density_change", "kg/m3", "air density above the declared one"),
        Signal("lift", "1", "added lift coefficient"),
        Signal("moment", "1", "added moment coefficient"),
    )
    parameter_names: tuple[str, ...] = (
        "mass",
        "wing_area",
        "chord",
        "pitch_inertia",
        "airspeed",
        "air_density",
        "CL_alpha",
        "CL_q",
        "CL_de",
        "Cm_alpha",
        "Cm_q",
        "Cm_de",
    )

    factors: ClassVar[Mapping[str, str]] = MappingProxyType(
        dict.fromkeys(("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"), "1/rad")
    )

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        V = p.airspeed + s.airspeed_change
        pressure_area = 0.5 * plus(p.air_density, s.density_change) * V * V * p.wing_area
        return {
            "V": V,
            "alpha_air": plus(s.alpha, s.gust),
            "q_hat": s.q * p.chord / (2.0 * V),
            "pressure_area": pressure_area,
        }

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        CL = _lift_coefficient(s, p)
        Cm = plus(p.Cm_alpha * s.alpha_air + p.Cm_q * s.q_hat + p.Cm_de * s.elevator, s.moment)
        return s.q - s.pressure_area * CL / (
            p.mass * s.V
        ), s.pressure_area * p.chord * Cm / p.pitch_inertia

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        return s.alpha_air, s.q, s.pressure_area * _lift_coefficient(s, p) / (p.mass * G0)


def _lift_coefficient(s: Any, p: Any) -> Any:
    return plus(p.CL_alpha * s.alpha_air + p.CL_q * s.q_hat + p.CL_de * s.elevator, s.lift)


LONGITUDINAL_CONSTANTS = {
    "mass": "kg",
    "wing_area": "m2",
    "chord": "m",
    "pitch_inertia": "kg m2",
    "air_density": "kg/m3",
    "reference_airspeed": "m/s",
    "thrust_arm": "m",
}
LONGITUDINAL_DERIVATIVES = {
    "CD_0": "1",
    "CD_V": "1",
    "CD_alpha": "1/rad",
    "CL_0": "1",
    "CL_V": "1",
    "CL_alpha": "1/rad",
    "CL_q": "1/rad",
    "CL_de": "1/rad",
    "Cm_0": "1",
    "Cm_V": "1",
    "Cm_alpha": "1/rad",
    "Cm_q": "1/rad",
    "Cm_de": "1/rad",
}


@dataclass(frozen=True)
class Longitudinal:
    """Equations of speed, angle of attack, pitch attitude and pitch rate. All quantities are
    totals, not perturbations.

    States: ``airspeed`` (m/s), ``alpha``, ``theta`` (rad), ``q`` (rad/s). Inputs: ``elevator``
    (rad), ``thrust`` (N). Outputs: ``airspeed``, ``alpha`` (vane at the centre of gravity),
    ``theta``, ``q``, ``nz`` (g, up), ``nx`` (g, forward). Ports: ``gust`` is an upward gust over
    the airspeed (rad) and ``headwind`` a gust from ahead (m/s). Both act on coefficients, vane and
    pitot tube, but not on the states or on the directions of lift and drag. ``drag``, ``lift`` and
    ``moment`` add to CD, CL and Cm.
    """

    explanation = """\
Longitudinal motion of an aircraft with airspeed and pitch attitude: short period and phugoid,
totals in wind axes.

V_dot = -qS CD/m + (T/m) cos(alpha) + g sin(alpha - theta), alpha_dot = -qS CL/(m V) + q - T
sin(alpha)/(m V) + (g/V) cos(alpha - theta), theta_dot = q, q_dot = (qS c Cm + T thrust_arm)/Iy, qS
= rho V^2 S/2; with V0 the reference airspeed CD = CD_0 + CD_V V/V0 + CD_alpha alpha, CL = CL_0 +
CL_V V/V0 + CL_alpha alpha + CL_q q c/(2 V0) + CL_de elevator, Cm likewise (Klein and Morelli,
Aircraft System Identification, AIAA 2006, sections 3.3 and 3.6, by wind axes). nz = qS (CL cos
alpha + CD sin alpha)/(m g0), nx = (T + qS (CL sin alpha - CD cos alpha))/(m g0)."""

    name: str = "longitudinal"
    states: tuple[Signal, ...] = (
        Signal("airspeed", "m/s", "speed of the centre of gravity in still air"),
        Signal("alpha", "rad", "angle of attack"),
        Signal("theta", "rad", "pitch attitude"),
        Signal("q", "rad/s", "pitch rate"),
    )
    inputs: tuple[Signal, ...] = (
        Signal("elevator", "rad", "elevator, trailing edge down"),
        Signal("thrust", "N", "thrust along the body"),
    )
    outputs: tuple[Signal, ...] = (
        Signal("airspeed", "m/s", "true airspeed"),
        Signal("alpha", "rad", "angle of attack at the vane"),
        Signal("theta", "rad", "pitch attitude"),
        Signal("q", "rad/s", "pitch rate"),
        Signal("nz", "g", "normal load factor, positive up"),
        Signal("nx", "g", "axial load factor, positive forward"),
    )
    ports: tuple[Signal, ...] = (
        GUST,
        Signal("headwind", "m/s", "gust from ahead"),
        Signal("drag", "1", "added drag coefficient"),
        Signal("lift", "1", "added lift coefficient"),
        Signal("moment", "1", "added moment coefficient"),
    )
    parameter_names: tuple[str, ...] = (*LONGITUDINAL_CONSTANTS, *LONGITUDINAL_DERIVATIVES)

    # Sensors are calibrated and aligned. Without these priors, biases and coefficients of totals
    # compensate each other at nearly constant airspeed.
    bias_priors: ClassVar[Mapping[str, float]] = MappingProxyType(
        {"airspeed": 3.0, "alpha": 0.05, "theta": 0.05, "q": 0.02, "nz": 0.1, "nx": 0.1}
    )
    factors: ClassVar[Mapping[str, str]] = MappingProxyType(
        {name: unit for name, unit in LONGITUDINAL_DERIVATIVES.items() if not name.endswith("_0")}
    )

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        V = plus(s.airspeed, s.headwind)
        return {
            "V": V,
            "alpha_air": plus(s.alpha, s.gust),
            "V_ratio": V / p.reference_airspeed,
            "q_hat": s.q * p.chord / (2.0 * p.reference_airspeed),
            "pressure_area": 0.5 * p.air_density * V * V * p.wing_area,
        }

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        weightless_lift = s.pressure_area * _lift(s, p) + s.thrust * sin(s.alpha)
        path = s.alpha - s.theta
        moment = plus(
            p.Cm_0
            + p.Cm_V * s.V_ratio
            + p.Cm_alpha * s.alpha_air
            + p.Cm_q * s.q_hat
            + p.Cm_de * s.elevator,
            s.moment,
        )
        return (
            (s.thrust * cos(s.alpha) - s.pressure_area * _drag(s, p)) / p.mass + G0 * sin(path),
            s.q - weightless_lift / (p.mass * s.airspeed) + G0 / s.airspeed * cos(path),
            s.q,
            (s.pressure_area * p.chord * moment + s.thrust * p.thrust_arm) / p.pitch_inertia,
        )

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        lift, drag, weight = _lift(s, p), _drag(s, p), p.mass * G0
        cosine, sine = cos(s.alpha), sin(s.alpha)
        nz = s.pressure_area * (lift * cosine + drag * sine) / weight
        nx = (s.thrust + s.pressure_area * (lift * sine - drag * cosine)) / weight
        return s.V, s.alpha_air, s.theta, s.q, nz, nx


def _lift(s: Any, p: Any) -> Any:
    return plus(
        p.CL_0
        + p.CL_V * s.V_ratio
        + p.CL_alpha * s.alpha_air
        + p.CL_q * s.q_hat
        + p.CL_de * s.elevator,
        s.lift,
    )


def _drag(s: Any, p: Any) -> Any:
    return plus(p.CD_0 + p.CD_V * s.V_ratio + p.CD_alpha * s.alpha_air, s.drag)


@dataclass(frozen=True)
class Loes:
    """Equations of the low-order equivalent system; disturbances act through the ports.

    States: ``alpha`` (rad), ``q`` (rad/s), pseudo-control ``delta`` (in the stick's unit). Input:
    ``stick``, any unit, nose up positive. Outputs: ``alpha`` at the vane, ``q``, ``nz`` (g, up).

    Ports: ``gust`` (rad) adds to alpha in the loads and in the vane's reading, but not to the
    state. ``lift`` (1/s) adds to alpha_dot, so that a positive value lowers nz. ``moment`` (1/s2)
    adds to q_dot. ``airspeed_change`` (m/s) scales the derivatives as those of an aircraft with
    constant coefficients: L_alpha, L_delta and M_q with V, M_alpha and M_delta with V^2. It also
    acts on nz and on the correction of the vane's reading. L_q, the lag and the constant terms do
    not depend on it.
    """

    explanation = """\
Low-order equivalent system of an augmented aircraft: dimensional short period after a lag and a
delay.

alpha_dot = L_alpha alpha + L_q q + L_delta delta + L_0, q_dot = M_alpha alpha + M_q q + M_delta
delta + M_0, delta_dot = inv_tau (stick(t - delay) - delta) + delta_0, nz = (V/g) (q - alpha_dot) +
nz_0, alpha_m = alpha - (vane_arm/V) q (eqs. 3 and 5-10 of NASA TM-101722; its eq. 7 lost the
delay). The paper's pseudo-control has the opposite sign: here M_delta > 0 for a nose-up stick. The
delay is an InputDelay on the stick, outside these equations."""

    name: str = "loes"
    states: tuple[Signal, ...] = (
        Signal("alpha", "rad", "angle of attack"),
        Signal("q", "rad/s", "pitch rate"),
        Signal("delta", "1", "pseudo-control, in the unit of the stick"),
    )
    inputs: tuple[Signal, ...] = (
        Signal("stick", "1", "pilot's command, nose up, in the unit of the record"),
    )
    outputs: tuple[Signal, ...] = SHORT_PERIOD_OUTPUTS
    ports: tuple[Signal, ...] = (
        GUST,
        AIRSPEED_CHANGE,
        Signal("lift", "1/s", "added rate of the angle of attack"),
        Signal("moment", "1/s2", "added pitch acceleration"),
    )
    parameter_names: tuple[str, ...] = (
        "airspeed",
        "gravity",
        "vane_arm",
        "L_alpha",
        "M_alpha",
        "L_delta",
        "M_delta",
        "L_q",
        "M_q",
        "inv_tau",
        "L_0",
        "M_0",
        "delta_0",
        "nz_0",
    )

    contains: ClassVar[tuple[str, ...]] = ("input-delay", "actuator-lag")
    factors: ClassVar[Mapping[str, str]] = MappingProxyType(
        {
            "L_alpha": "1/s",
            "M_alpha": "1/s2",
            "L_delta": "1/s",
            "M_delta": "1/s2",
            "L_q": "1",
            "M_q": "1/s",
        }
    )

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        V = p.airspeed + s.airspeed_change
        return {"V": V, "speed_ratio": V / p.airspeed, "alpha_air": plus(s.alpha, s.gust)}

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        r = s.speed_ratio
        q_dot = times(
            r, times(r, p.M_alpha * s.alpha_air + p.M_delta * s.delta) + p.M_q * s.q
        ) + plus(p.M_0, s.moment)
        return _alpha_rate(s, p), q_dot, p.inv_tau * (s.stick - s.delta) + p.delta_0

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        return (
            s.alpha_air - p.vane_arm / s.V * s.q,
            s.q,
            s.V / p.gravity * (s.q - _alpha_rate(s, p)) + p.nz_0,
        )


def _alpha_rate(s: Any, p: Any) -> Any:
    return (
        times(s.speed_ratio, p.L_alpha * s.alpha_air + p.L_delta * s.delta)
        + p.L_q * s.q
        + plus(p.L_0, s.lift)
    )


AXES = ("CY", "Cl", "Cn")
LATERAL_CONSTANTS = {
    "mass": "kg",
    "wing_area": "m2",
    "span": "m",
    "roll_inertia": "kg m2",
    "yaw_inertia": "kg m2",
    "cross_inertia": "kg m2",
    "airspeed": "m/s",
    "air_density": "kg/m3",
    "trim_alpha": "rad",
    "trim_theta": "rad",
}
LATERAL_DERIVATIVES = {
    f"{axis}_{by}": "1/rad" for axis in AXES for by in ("beta", "p", "r", "da", "dr")
}


@dataclass(frozen=True)
class Lateral:
    """Equations of sideslip, roll and yaw.

    States: angle of sideslip ``beta``, roll rate ``p``, yaw rate ``r``, bank angle ``phi`` (rad,
    rad/s). Inputs: ``aileron``, ``rudder`` (rad). Outputs: ``beta`` (vane at the centre of
    gravity), ``p``, ``r``, ``phi``, ``ny`` (g, to the right). Ports: ``gust`` is a side gust from
    the right over airspeed (rad), which adds to beta in the loads and in the vane's reading;
    ``side_force``, ``roll`` and ``yaw`` add to CY, Cl and Cn.
    """

    explanation = """\
Lateral and directional motion of an aircraft, non-dimensional derivatives; constant airspeed
unless a port changes it.

beta_dot = rho V S CY/(2 m) + p sin(alpha0) - r cos(alpha0) + (g/V) cos(theta0) phi, p_dot = (Izz L
+ Ixz N)/G, r_dot = (Ixz L + Ixx N)/G, G = Ixx Izz - Ixz^2, L = rho V^2 S b Cl/2, N = rho V^2 S b
Cn/2, phi_dot = p + tan(theta0) r, CX = CX_beta beta + CX_p p b/(2V) + CX_r r b/(2V) + CX_da aileron
+ CX_dr rudder for X = Y, l, n (Etkin and Reid, Dynamics of Flight, 3rd ed., section 4.9, in body
axes). Perturbations about a trim of alpha0 and theta0, wings level. ny = rho V^2 S CY/(2 m g0),
positive to the right."""

    name: str = "lateral"
    states: tuple[Signal, ...] = (
        Signal("beta", "rad", "angle of sideslip"),
        Signal("p", "rad/s", "roll rate"),
        Signal("r", "rad/s", "yaw rate"),
        Signal("phi", "rad", "bank angle"),
    )
    inputs: tuple[Signal, ...] = (
        Signal("aileron", "rad", "aileron deflection"),
        Signal("rudder", "rad", "rudder deflection"),
    )
    outputs: tuple[Signal, ...] = (
        Signal("beta", "rad", "angle of sideslip at the vane"),
        Signal("p", "rad/s", "roll rate"),
        Signal("r", "rad/s", "yaw rate"),
        Signal("phi", "rad", "bank angle"),
        Signal("ny", "g", "lateral load factor, positive to the right"),
    )
    ports: tuple[Signal, ...] = (
        Signal("gust", "rad", "side gust from the right over airspeed"),
        AIRSPEED_CHANGE,
        Signal("side_force", "1", "added side force coefficient"),
        Signal("roll", "1", "added rolling moment coefficient"),
        Signal("yaw", "1", "added yawing moment coefficient"),
    )
    parameter_names: tuple[str, ...] = (*LATERAL_CONSTANTS, *LATERAL_DERIVATIVES)

    # rad, alignment of a gyro. Without this prior, a steady turn cannot be distinguished from
    # biases of bank angle and rates.
    bias_priors: ClassVar[Mapping[str, float]] = MappingProxyType({"phi": 0.05})
    factors: ClassVar[Mapping[str, str]] = MappingProxyType(LATERAL_DERIVATIVES)

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        V = plus(p.airspeed, s.airspeed_change)
        half = p.span / (2.0 * V)
        return {
            "V": V,
            "beta_air": plus(s.beta, s.gust),
            "p_hat": s.p * half,
            "r_hat": s.r * half,
            "pressure_area": 0.5 * p.air_density * V * V * p.wing_area,
        }

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        Cl = plus(_linear(s, p.Cl_beta, p.Cl_p, p.Cl_r, p.Cl_da, p.Cl_dr), s.roll)
        Cn = plus(_linear(s, p.Cn_beta, p.Cn_p, p.Cn_r, p.Cn_da, p.Cn_dr), s.yaw)
        rolling, yawing = s.pressure_area * p.span * Cl, s.pressure_area * p.span * Cn
        bound = p.roll_inertia * p.yaw_inertia - p.cross_inertia * p.cross_inertia
        turning = (
            s.p * sin(p.trim_alpha) - s.r * cos(p.trim_alpha) + G0 / s.V * cos(p.trim_theta) * s.phi
        )
        return (
            s.pressure_area * _side_force(s, p) / (p.mass * s.V) + turning,
            (p.yaw_inertia * rolling + p.cross_inertia * yawing) / bound,
            (p.cross_inertia * rolling + p.roll_inertia * yawing) / bound,
            s.p + sin(p.trim_theta) / cos(p.trim_theta) * s.r,
        )

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        return s.beta_air, s.p, s.r, s.phi, s.pressure_area * _side_force(s, p) / (p.mass * G0)


def _side_force(s: Any, p: Any) -> Any:
    return plus(_linear(s, p.CY_beta, p.CY_p, p.CY_r, p.CY_da, p.CY_dr), s.side_force)


def _linear(s: Any, beta: Any, p: Any, r: Any, da: Any, dr: Any) -> Any:
    """Return a coefficient from its five derivatives."""
    return beta * s.beta_air + p * s.p_hat + r * s.r_hat + da * s.aileron + dr * s.rudder
