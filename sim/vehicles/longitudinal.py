"""Longitudinal motion of an aircraft with airspeed and pitch attitude: short period and phugoid,
totals in wind axes.

V_dot = -qS CD/m + (T/m) cos(alpha) + g sin(alpha - theta), alpha_dot = -qS CL/(m V) + q - T
sin(alpha)/(m V) + (g/V) cos(alpha - theta), theta_dot = q, q_dot = (qS c Cm + T thrust_arm)/Iy, qS
= rho V^2 S/2; with V0 the reference airspeed CD = CD_0 + CD_V V/V0 + CD_alpha alpha, CL = CL_0 +
CL_V V/V0 + CL_alpha alpha + CL_q q c/(2 V0) + CL_de elevator, Cm likewise (Klein and Morelli,
Aircraft System Identification, AIAA 2006, sections 3.3 and 3.6, by wind axes). nz = qS (CL cos
alpha + CD sin alpha)/(m g0), nx = (T + qS (CL sin alpha - CD cos alpha))/(m g0).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Signal
from sim.maths import G0, cos, plus, sin
from sim.vehicles.signals import GUST

LONGITUDINAL_CONSTANTS = {
    **{
        "mass": "kg",
        "wing_area": "m2",
        "chord": "m",
        "pitch_inertia": "kg m2",
        "air_density": "kg/m3",
    },
    **{"reference_airspeed": "m/s", "thrust_arm": "m"},
}
LONGITUDINAL_DERIVATIVES = {
    **{
        "CD_0": "1",
        "CD_V": "1",
        "CD_alpha": "1/rad",
        "CL_0": "1",
        "CL_V": "1",
        "CL_alpha": "1/rad",
        "CL_q": "1/rad",
        "CL_de": "1/rad",
    },
    **{"Cm_0": "1", "Cm_V": "1", "Cm_alpha": "1/rad", "Cm_q": "1/rad", "Cm_de": "1/rad"},
}


@dataclass(frozen=True)
class Longitudinal:
    """Equations of speed, angle of attack, pitch attitude and pitch rate; all quantities are
    totals, not perturbations.

    States: ``airspeed`` (m/s), ``alpha``, ``theta`` (rad), ``q`` (rad/s). Inputs: ``elevator``
    (rad), ``thrust`` (N). Outputs: ``airspeed``, ``alpha`` (vane at the centre of gravity),
    ``theta``, ``q``, ``nz`` (g, up), ``nx`` (g, forward). Ports: ``gust`` is an upward gust over
    the airspeed (rad), ``headwind`` (m/s) one from ahead: coefficients, vane and pitot tube feel
    them, not the states, and lift and drag keep their directions. ``drag``, ``lift`` and ``moment``
    add to CD, CL and Cm.
    """

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
