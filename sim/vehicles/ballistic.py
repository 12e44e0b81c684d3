"""A body falling vertically through an exponential atmosphere.

altitude_ddot = 0.5 rho v^2 / beta - gravity,  rho = rho0 exp(-altitude / H): eqs. 17-20 of the
simulated-flight-data paper with the velocity squared that its eq. 21 lost, and with beta as a mass
per area (kg/m2): the paper's weight per area divided by gravity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Signal
from sim.maths import absolute, exp


@dataclass(frozen=True)
class Ballistic:
    """Equations of the vertical fall; altitude and velocity positive up, drag against the motion.

    States: ``altitude`` (m), ``velocity`` (m/s). No input. Output: ``altitude``. Ports:
    ``log_density`` adds to the logarithm of the air density, ``log_drag`` to that of the drag
    coefficient.
    """

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
