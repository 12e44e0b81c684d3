"""Longitudinal short period of an aircraft, non-dimensional derivatives; constant airspeed unless a
port changes it.

alpha_dot = q - rho V^2 S CL / (2 m V), q_dot = rho V^2 S c Cm / (2 Iy), nz = rho V^2 S CL / (2 m
g0) (eqs. 22-25 of the simulated-flight-data paper). Perturbations about trim; the rates are made
non-dimensional with c / (2 V). Elevator trailing edge down positive, nz positive up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Signal
from sim.maths import G0, plus
from sim.vehicles.signals import AIRSPEED_CHANGE, GUST, SHORT_PERIOD_OUTPUTS


@dataclass(frozen=True)
class ShortPeriod:
    """Equations of the rigid short period; elastic modes and gusts come in through the ports.

    States: angle of attack ``alpha`` (rad), pitch rate ``q`` (rad/s). Input: ``elevator`` (rad).
    Outputs: ``alpha`` (vane at the centre of gravity), ``q``, ``nz`` (g). Ports: ``gust`` is an
    upward gust over airspeed (rad), seen by the loads and the vane; ``lift`` adds to CL, ``moment``
    to Cm.
    """

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
