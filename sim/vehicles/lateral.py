"""Lateral and directional motion of an aircraft, non-dimensional derivatives; constant airspeed
unless a port changes it.

beta_dot = rho V S CY/(2 m) + p sin(alpha0) - r cos(alpha0) + (g/V) cos(theta0) phi, p_dot = (Izz L
+ Ixz N)/G, r_dot = (Ixz L + Ixx N)/G, G = Ixx Izz - Ixz^2, L = rho V^2 S b Cl/2, N = rho V^2 S b
Cn/2, phi_dot = p + tan(theta0) r, CX = CX_beta beta + CX_p p b/(2V) + CX_r r b/(2V) + CX_da aileron
+ CX_dr rudder for X = Y, l, n (Etkin and Reid, Dynamics of Flight, 3rd ed., section 4.9, in body
axes). Perturbations about a trim of alpha0 and theta0, wings level. ny = rho V^2 S CY/(2 m g0),
positive to the right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Signal
from sim.maths import G0, cos, plus, sin
from sim.vehicles.longitudinal import AIRSPEED_CHANGE

AXES = ("CY", "Cl", "Cn")
LATERAL_CONSTANTS = {
    **{
        "mass": "kg",
        "wing_area": "m2",
        "span": "m",
        "roll_inertia": "kg m2",
        "yaw_inertia": "kg m2",
        "cross_inertia": "kg m2",
    },
    **{"airspeed": "m/s", "air_density": "kg/m3", "trim_alpha": "rad", "trim_theta": "rad"},
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
    the right over airspeed (rad), which the loads and the vane feel; ``side_force``, ``roll`` and
    ``yaw`` add to CY, Cl and Cn.
    """

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

    # rad: a gyro's alignment. A steady turn is next to a bank that is read wrong, with rates that
    # are.
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
        rolling = (
            s.pressure_area
            * p.span
            * plus(_linear(s, p.Cl_beta, p.Cl_p, p.Cl_r, p.Cl_da, p.Cl_dr), s.roll)
        )
        yawing = (
            s.pressure_area
            * p.span
            * plus(_linear(s, p.Cn_beta, p.Cn_p, p.Cn_r, p.Cn_da, p.Cn_dr), s.yaw)
        )
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
    return beta * s.beta_air + p * s.p_hat + r * s.r_hat + da * s.aileron + dr * s.rudder
