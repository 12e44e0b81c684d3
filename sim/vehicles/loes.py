"""Low-order equivalent system of an augmented aircraft: dimensional short period behind a lag and a
delay.

alpha_dot = L_alpha alpha + L_q q + L_delta delta + L_0, q_dot = M_alpha alpha + M_q q + M_delta
delta + M_0, delta_dot = inv_tau (stick(t - delay) - delta) + delta_0, nz = (V/g) (q - alpha_dot) +
nz_0, alpha_m = alpha - (vane_arm/V) q (eqs. 3 and 5-10 of NASA TM-101722; its eq. 7 lost the
delay). The paper's pseudo-control has the opposite sign: here M_delta > 0 for a nose-up stick. The
delay is an InputDelay on the stick, outside these equations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Signal
from sim.maths import plus, times
from sim.vehicles.signals import AIRSPEED_CHANGE, GUST, SHORT_PERIOD_OUTPUTS


@dataclass(frozen=True)
class Loes:
    """Equations of the low-order equivalent system, disturbances through the ports.

    States: ``alpha`` (rad), ``q`` (rad/s), pseudo-control ``delta`` (in the stick's unit). Input:
    ``stick``, any unit, nose up positive. Outputs: ``alpha`` at the vane, ``q``, ``nz`` (g, up).
    Ports: ``gust`` (rad) adds to alpha in L_alpha, M_alpha and the vane's reading, not to the
    state; ``lift`` (1/s) adds to alpha_dot, so a positive one lowers nz; ``moment`` (1/s2) adds to
    q_dot; ``airspeed_change`` (m/s) scales the derivatives as those of an aircraft at constant
    coefficients, L_alpha, L_delta and M_q with V, M_alpha and M_delta with V^2, and stands in nz
    and the vane's correction; L_q, the lag and the constant terms stay.
    """

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
