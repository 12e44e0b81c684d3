"""Exchange of speed and height by the energy of flight: another form than the library's phugoid."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.maths import G0, cos, sqrt


@dataclass(frozen=True)
class EnergyExchange:
    """V^2/2 + g h = V0^2/2 + e, without linearisation of speed or path and without a state of
    speed.

    h_dot = V sin(gamma), e_dot = V (thrust - drag)/m, theta_dot = q, gamma = ``path`` + theta -
    alpha, rad, up. The lift m g0 of level flight at V0 is proportional to V^2: V gamma_dot = L/m -
    g0 cos(gamma), and nz is L/(m g0) - 1. Thrust is constant, drag = thrust (1 - ``induced``)
    (V/V0)^2 + thrust ``induced`` (CL/CL0)^2 (V/V0)^2, thrust = ``weight_share`` m g0. ``gravity``
    (1 or 0) switches the effect on or off.
    """

    name: ClassVar[str] = "own:energy-exchange"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("airspeed_change", "lift")
    needs_constants: ClassVar[tuple[str, ...]] = ("mass", "CL_alpha")
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("gravity", 1.0, "1"),
        Parameter("path", 0.05, "rad"),
        Parameter("weight_share", 0.08, "1"),
        Parameter("induced", 0.4, "1"),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"gravity": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ("phugoid", "speed-variation")
    states: ClassVar[tuple[Signal, ...]] = (
        Signal("climbed", "m", "height above that at the record's begin"),
        Signal("gained", "m2/s2", "energy of flight above that at the record's begin, by mass"),
        Signal("turned", "rad", "pitch attitude above that at the record's begin"),
    )
    explanation: ClassVar[str] = (
        "The aircraft climbs and grows slow, sinks and grows fast: the sum of both energies "
        "changes by thrust and drag alone."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        V = _speed(s, vehicle)
        pressure = 0.5 * vehicle.air_density * vehicle.wing_area
        weight = p.gravity * vehicle.mass * G0 / pressure
        # What the weight leaves of the lift of level flight: it turns the path.
        return {
            "airspeed_change": V - vehicle.airspeed,
            "lift": weight * (1.0 / vehicle.airspeed**2 - cos(_path(s, p)) / (V * V)),
        }

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        V = _speed(s, vehicle)
        ratio = (V / vehicle.airspeed) ** 2
        level = (
            vehicle.mass
            * G0
            / (0.5 * vehicle.air_density * vehicle.wing_area * vehicle.airspeed**2)
        )
        loading = 1.0 + (vehicle.CL_alpha * s.alpha_air + vehicle.CL_de * s.elevator) / level
        surplus = p.weight_share * (1.0 - ratio * (1.0 - p.induced + p.induced * loading * loading))
        return p.gravity * V * cos(_path(s, p) - 0.5 * math.pi), p.gravity * G0 * V * surplus, s.q

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        # The port's lift turns the path by cos(gamma) of the weight; what an accelerometer reads
        # lacks the weight itself.
        return {"nz": y["nz"] + p.gravity * (cos(_path(s, p)) - 1.0)}


def _speed(s: Any, vehicle: Any) -> Any:
    return sqrt(vehicle.airspeed**2 + 2.0 * (s.gained - G0 * s.climbed))


def _path(s: Any, p: Any) -> Any:
    return p.path + s.turned - s.alpha


TERM = EnergyExchange()
