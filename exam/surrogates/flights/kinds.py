"""What a longitudinal surrogate flight can hide: local values of each effect by its size, and the
effects whose size may be declared in their own unit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from exam.surrogates.flights.drawing import SPEED, Drawn, short_period
from sim.maths import shape_names

# ---- What can be hidden in the longitudinal surrogate flights

# Local values at a size of one, the largest that is drawn. At a size of zero the effect vanishes.
Direction = Mapping[str, float]
AtSize = Callable[[float], Direction]
Kind = Callable[[Drawn, np.random.Generator], AtSize]


def _value(drawn: Drawn, name: str) -> float:
    return drawn.declared.parameters[name].value


def _peak(drawn: Drawn) -> float:
    return max(float(np.max(np.abs(move.values))) for move in drawn.maneuvers)


def _omega(drawn: Drawn) -> float:
    return short_period(drawn.declared)


def along(most: Direction, absent: float = 0.0) -> AtSize:
    return lambda size: {local: absent + size * (value - absent) for local, value in most.items()}


def only(local: str, most: Callable[[Drawn], float], absent: float = 0.0) -> Kind:
    return lambda drawn, rng: along({local: most(drawn)}, absent)


def _limit(local: str, largest: Callable[[Drawn], float]) -> Kind:
    """A limit that decreases from the largest value that the maneuvers reach."""
    return lambda drawn, rng: lambda size: {local: largest(drawn) * (1.0 - 0.85 * size)}


def _fastest(drawn: Drawn) -> float:
    return max(
        float(np.max(np.abs(np.diff(move.values)))) / move.spacing for move in drawn.maneuvers
    )


def _late(drawn: Drawn) -> float:
    return min(0.25, 0.7 / _omega(drawn))


def scale(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    return along({"scale": float(rng.choice([0.6, 1.6]))}, 1.0)


def curve(rms: Callable[[Drawn], float]) -> Kind:
    def kind(drawn: Drawn, rng: np.random.Generator) -> AtSize:
        shapes = (
            rng.standard_normal(len(shape_names(False)))
            / (1.0 + np.arange(len(shape_names(False)))) ** 1.5
        )
        shapes *= rms(drawn) / np.linalg.norm(shapes)
        return along(dict(zip(shape_names(False), shapes.tolist(), strict=True)))

    return kind


def _control(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    at = curve(lambda drawn: 0.4 * _peak(drawn))(drawn, rng)
    return lambda size: {**at(size), "lift_share": 1.0}


def _rate(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    return lambda size: {"rate": 1.05 * _fastest(drawn) * (1.0 - 0.97 * math.sqrt(size))}


def _mode(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    frequency, damping = rng.uniform(max(7.0, 2.2 * _omega(drawn)), 20.0), rng.uniform(0.015, 0.05)
    most = {
        "lift": 1.5 * _value(drawn, "CL_de"),
        "moment": 0.6 * _value(drawn, "Cm_de"),
        "gyro": 0.06,
    }
    held = {"frequency": frequency, "damping": damping, "angle_gain": 0.0}
    return lambda size: {**held, **{local: size * value for local, value in most.items()}}


def _speed(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    return along(
        {
            "rate": float(rng.choice([-1.0, 1.0]))
            * 0.35
            * _value(drawn, "airspeed")
            / drawn.surrogate.flight.duration
        }
    )


def event(
    most: Callable[[Drawn], Direction], held: Callable[[Drawn, np.random.Generator], Direction]
) -> Kind:
    def kind(drawn: Drawn, rng: np.random.Generator) -> AtSize:
        sign, fixed, largest = float(rng.choice([-1.0, 1.0])), held(drawn, rng), most(drawn)
        return lambda size: {
            **fixed,
            **{local: sign * size * value for local, value in largest.items()},
        }

    return kind


def start(drawn: Drawn, rng: np.random.Generator) -> float:
    return float(rng.uniform(0.2, 0.6) * drawn.surrogate.flight.duration)


def drift(most: float) -> Kind:
    return event(
        lambda drawn: {"slope": most / drawn.surrogate.flight.duration}, lambda drawn, rng: {}
    )


KINDS: Mapping[str, Kind] = {
    "input-delay": only("delay", _late),
    "actuator-lag": only("time_constant", lambda drawn: 1.5 * _late(drawn)),
    "actuator-rate-limit": _rate,
    "actuator-saturation": _limit("limit", _peak),
    "input-deadband": only("half_width", lambda drawn: 0.5 * _peak(drawn)),
    "input-backlash": only("half_width", lambda drawn: 0.4 * _peak(drawn)),
    "moment-nonlinearity": curve(lambda drawn: 0.04 * abs(_value(drawn, "Cm_alpha"))),
    "lift-nonlinearity": curve(lambda drawn: 0.03 * _value(drawn, "CL_alpha")),
    "control-nonlinearity": _control,
    "elastic-mode": _mode,
    "vane-offset": only("arm", lambda drawn: 3.5 * _value(drawn, "chord")),
    "accelerometer-offset:nz": event(
        lambda drawn: {"arm": 2.0 * _value(drawn, "chord")}, lambda drawn, rng: {}
    ),
    **{f"sensor-scale:{channel}": scale for channel in ("alpha", "q", "nz")},
    **{f"sensor-lag:{channel}": only("time_constant", _late) for channel in ("alpha", "q", "nz")},
    **{f"sensor-delay:{channel}": only("delay", _late) for channel in ("alpha", "q", "nz")},
    SPEED: _speed,
    "gust-turbulence": only("sigma", lambda drawn: 0.04 * _value(drawn, "airspeed")),
    "derivative-jump": event(
        lambda drawn: {
            "Cm_alpha": 0.8 * _value(drawn, "Cm_alpha"),
            "Cm_de": 0.0,
            "Cm_q": 0.0,
            "CL_alpha": 0.0,
        },
        lambda drawn, rng: {"time": float(rng.uniform(0.2, 0.5) * drawn.surrogate.flight.duration)},
    ),
    "gust-discrete": event(
        lambda drawn: {"peak": 0.12 * _value(drawn, "airspeed")},
        lambda drawn, rng: {"start": start(drawn, rng), "duration": float(rng.uniform(0.8, 2.0))},
    ),
    "unmeasured-input": event(
        lambda drawn: {"moment": 0.05 * abs(_value(drawn, "Cm_de")), "lift": 0.0},
        lambda drawn, rng: {"start": start(drawn, rng), "duration": float(rng.uniform(0.8, 2.0))},
    ),
    "sensor-drift:alpha": drift(0.08),
    "sensor-drift:q": drift(0.08),
    "sensor-drift:nz": drift(0.6),
}


# ---- Effects whose size a surrogate flight may declare in the effect's own unit, instead of by


@dataclass(frozen=True)
class Size:
    """The meaning of a declared size: ``local`` parameter of the effect, ``unit``, and largest
    allowed size ``most``.

    ``either`` : whether the sign is drawn. ``speed_share`` : whether the size is the share of the
    airspeed that is lost over a record, while the parameter is in m/s2.
    """

    local: str
    unit: str
    most: float
    either: bool = False
    speed_share: bool = False


SIZES: Mapping[str, Size] = {
    "gust-turbulence": Size("sigma", "m/s", 8.0),
    "vane-offset": Size("arm", "m", 40.0),
    "accelerometer-offset:nz": Size("arm", "m", 40.0, either=True),
    SPEED: Size("rate", "1", 0.5, speed_share=True),
}


def values_at(drawn: Drawn, name: str, size: float, sign: float = 1.0) -> dict[str, float]:
    """Return the local values of an effect of this ``size``; ``sign`` is used if the size may have
    either sign.
    """
    what = SIZES[name]
    if what.speed_share:
        return {
            what.local: -size
            * drawn.declared.parameters["airspeed"].value
            / drawn.surrogate.flight.duration
        }
    return {what.local: sign * size if what.either else size}
