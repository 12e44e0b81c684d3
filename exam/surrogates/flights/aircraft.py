"""The aircraft of a surrogate flight: the short period with the slow motion that it leaves out, and
with all channels of a flight-test recorder.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

from sim.declaration.effect import Signal
from sim.maths import cos
from sim.vehicles.uncoupled import ShortPeriod

BASE = ShortPeriod()


@dataclass(frozen=True)
class LongitudinalFlight:
    """The rigid short period with pitch angle and airspeed as states: gravity bends the path and
    changes the speed.

    theta_dot = q, V_dot = thrust - g sin(theta - alpha), alpha_dot += (g/V) (cos(theta - alpha) -
    1); all perturbations about level trim. The lift that carries the weight grows with V^2, too: CL
    += ``trim_lift`` (1 - (V0/V)^2). Updraft and thrust are inputs that no record holds. ax is the
    specific force along the body axis, for body and wind axes ``trim_alpha`` + alpha apart. With
    ``gravity`` and ``trim_lift`` zero, nothing but `ShortPeriod` is left in alpha, q and nz, bit
    for bit.
    """

    name: str = "rigid"
    states: tuple[Signal, ...] = (
        *BASE.states,
        Signal("theta", "rad", "pitch angle above trim"),
        Signal("speed", "m/s", "airspeed above the start"),
    )
    inputs: tuple[Signal, ...] = (
        *BASE.inputs,
        Signal("updraft", "m/s", "gust, up"),
        Signal("thrust", "m/s2", "thrust above drag over mass"),
    )
    outputs: tuple[Signal, ...] = (
        *BASE.outputs,
        Signal("theta", "rad", "pitch angle"),
        Signal("airspeed", "m/s", "airspeed"),
        Signal("dynamic_pressure", "Pa", "dynamic pressure"),
        Signal("ax", "m/s2", "specific force along the body, forward"),
    )
    no_controls: tuple[str, ...] = ("updraft", "thrust")
    ports: tuple[Signal, ...] = BASE.ports
    parameter_names: tuple[str, ...] = (*BASE.parameter_names, "gravity", "trim_lift", "trim_alpha")

    def flow(self, s: Any, p: Any) -> Mapping[str, Any]:
        moved = {
            "airspeed_change": s.airspeed_change + s.speed,
            "gust": s.gust + s.updraft / p.airspeed,
        }
        found = BASE.flow(SimpleNamespace(**{**vars(s), **moved}), p)
        return {
            **found,
            **moved,
            "lift": s.lift + p.trim_lift * (1.0 - (p.airspeed / found["V"]) ** 2),
        }

    def derivatives(self, s: Any, p: Any) -> Sequence[Any]:
        alpha_rate, pitch_rate = BASE.derivatives(s, p)
        climb = s.theta - s.alpha
        return (
            alpha_rate + p.gravity / s.V * (cos(climb) - 1.0),
            pitch_rate,
            s.q,
            s.thrust - p.gravity * _sine(climb),
        )

    def measurements(self, s: Any, p: Any) -> Sequence[Any]:
        alpha_rate, _, _, acceleration = self.derivatives(s, p)
        angle, pitch = p.trim_alpha + s.alpha, p.trim_alpha + s.theta
        along = (
            acceleration * cos(angle)
            + s.V * (s.q - alpha_rate) * _sine(angle)
            + p.gravity * _sine(pitch)
        )
        return *BASE.measurements(s, p), pitch, s.V, 0.5 * p.air_density * s.V * s.V, along


def _sine(angle: Any) -> Any:
    return cos(angle - 0.5 * math.pi)
