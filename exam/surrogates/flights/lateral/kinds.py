"""What can be hidden in the lateral surrogate flights: each effect's local values by size, the
largest that is drawn at one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from exam.surrogates.flights.drawing import Drawn
from exam.surrogates.flights.kinds import AtSize, Kind, curve, event, only, scale, start
from exam.surrogates.flights.lateral.drawing import dutch_roll

SENSORS = ("beta", "p", "r", "phi", "ny")
SCALED = ("beta", "p", "r", "ny")


def _value(drawn: Drawn, name: str) -> float:
    return drawn.declared.parameters[name].value


def _late(drawn: Drawn) -> float:
    return min(0.3, 0.7 / dutch_roll(drawn.declared))


def _peak(signal: str, share: float) -> Callable[[Drawn], float]:
    return lambda drawn: (
        share * max(float(np.max(np.abs(move.values))) for move in drawn.moves(signal))
    )


def _control(signal: str) -> Kind:
    def kind(drawn: Drawn, rng: np.random.Generator) -> AtSize:
        at = curve(_peak(signal, 0.4))(drawn, rng)
        return lambda size: {**at(size), "lift_share": 1.0}

    return kind


def _fin(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    """A mode of the rear fuselage and the fin, driven by the rudder."""
    held = {
        "frequency": rng.uniform(7.0, 20.0),
        "damping": rng.uniform(0.015, 0.05),
        "angle_gain": 0.0,
    }
    most = {
        "side_force": 1.5 * _value(drawn, "CY_dr"),
        "yaw": 0.6 * _value(drawn, "Cn_dr"),
        "gyro": 0.06,
    }
    return lambda size: {**held, **{local: size * value for local, value in most.items()}}


def _gust(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    begin = {"start": start(drawn, rng), "duration": float(rng.uniform(0.8, 2.0))}
    return event(
        lambda drawn: {"peak": 0.12 * _value(drawn, "airspeed")}, lambda drawn, rng: begin
    )(drawn, rng)


def _arm(share: float) -> Kind:
    return event(lambda drawn: {"arm": share * _value(drawn, "span")}, lambda drawn, rng: {})


LATERAL_KINDS: Mapping[str, Kind] = {
    **{f"input-delay:{signal}": only("delay", _late) for signal in ("rudder", "aileron")},
    **{
        f"actuator-lag:{signal}": only("time_constant", lambda drawn: 1.5 * _late(drawn))
        for signal in ("rudder", "aileron")
    },
    **{
        f"input-backlash:{signal}": only("half_width", _peak(signal, 0.4))
        for signal in ("rudder", "aileron")
    },
    **{
        f"input-deadband:{signal}": only("half_width", _peak(signal, 0.5))
        for signal in ("rudder", "aileron")
    },
    **{f"control-nonlinearity:{signal}": _control(signal) for signal in ("rudder", "aileron")},
    "yaw-nonlinearity": curve(lambda drawn: 0.04 * abs(_value(drawn, "Cn_beta"))),
    "elastic-mode": _fin,
    "vane-offset": only("arm", lambda drawn: 1.2 * _value(drawn, "span")),
    "accelerometer-offset:ny": _arm(0.8),
    **{f"sensor-scale:{channel}": scale for channel in SCALED},
    **{f"sensor-lag:{channel}": only("time_constant", _late) for channel in SENSORS},
    **{f"sensor-delay:{channel}": only("delay", _late) for channel in SENSORS},
    "gust-discrete": _gust,
    "gust-turbulence": only("sigma", lambda drawn: 0.04 * _value(drawn, "airspeed")),
}
