"""The aircraft of a lateral surrogate flight: sideslip, roll and yaw with the small causes that no
model of it has.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from sim.declaration.effect import Signal
from sim.maths import G0, cos
from sim.vehicles.uncoupled import Lateral

BASE = Lateral()
OWN_PARAMETERS: Mapping[str, str] = {
    "gravity": "1",
    "wash": "1/rad",
    "wash_lag": "s",
    "yaw_cube": "1/rad3",
    "side_cube": "1/rad3",
}


@dataclass(frozen=True)
class LateralFlight:
    """The lateral equations with an airspeed that drifts, the sine of the bank, a fin that feels
    the sidewash late, and curved loads.

    V_dot = thrust, beta_dot += ``gravity`` (g/V) cos(theta0) (sin(phi) - phi), Cn += ``wash`` (beta
    - washed) + ``yaw_cube`` beta^3, washed_dot = (beta - washed)/``wash_lag``, CY += ``side_cube``
    beta^3; beta that of the air. Side wind and thrust are inputs that no record holds. With all of
    the own parameters zero but the lag, nothing but `Lateral` is left in its outputs, bit for bit.
    """

    name: str = "lateral"
    states: tuple[Signal, ...] = (
        *BASE.states,
        Signal("speed", "m/s", "airspeed above the start"),
        Signal("washed", "rad", "sideslip that the fin feels"),
    )
    inputs: tuple[Signal, ...] = (
        *BASE.inputs,
        Signal("sidewind", "m/s", "gust from the right"),
        Signal("thrust", "m/s2", "thrust above drag over mass"),
    )
    outputs: tuple[Signal, ...] = BASE.outputs
    no_controls: tuple[str, ...] = ("sidewind", "thrust")
    ports: tuple[Signal, ...] = BASE.ports
    parameter_names: tuple[str, ...] = (*BASE.parameter_names, *OWN_PARAMETERS)

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        moved = {
            "airspeed_change": s.airspeed_change + s.speed,
            "gust": s.gust + s.sidewind / p.airspeed,
        }
        found = BASE.flow(SimpleNamespace(**{**vars(s), **moved}), p)
        beta = found["beta_air"]
        loads = {
            "yaw": s.yaw + p.wash * (beta - s.washed) + p.yaw_cube * beta**3,
            "side_force": s.side_force + p.side_cube * beta**3,
        }
        return {**found, **moved, **loads}

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        beta_rate, *others = BASE.derivatives(s, p)
        bent = p.gravity * G0 / s.V * cos(p.trim_theta) * (_sine(s.phi) - s.phi)
        return beta_rate + bent, *others, s.thrust, (s.beta_air - s.washed) / p.wash_lag

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        return BASE.measurements(s, p)


def _sine(angle: Any) -> Any:
    return cos(angle - 0.5 * math.pi)
