"""The lateral surrogate flights: aircraft, what the seed determines, hidden effects, maneuvers."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from exam.hidden_terms.anti_alias_filter import AntiAliasFilter
from exam.surrogates.declaration import Causes, Surrogate
from exam.surrogates.flights.drawing import Drawn, dealt, with_term
from exam.surrogates.flights.kinds import AtSize, Kind, curve, event, only, scale, start
from exam.surrogates.flights.maneuvers import KINDS, Table, carried_out
from sim.declaration.effect import Parameter, ParameterSet, Signal
from sim.declaration.model import Model, Noise
from sim.effects.library import find_effect
from sim.maneuvers import Delayed, Maneuver, schroeder_multisine
from sim.maths import G0, cos
from sim.vehicles.factory import linearise, model_from_constants
from sim.vehicles.library import read_parameter_set
from sim.vehicles.uncoupled import LATERAL_CONSTANTS, Lateral

# ---- The aircraft of a lateral surrogate flight

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
    """The lateral equations with a drifting airspeed, the sine of the bank angle, a fin in the
    delayed sidewash, and nonlinear loads.

    V_dot = thrust, beta_dot += ``gravity`` (g/V) cos(theta0) (sin(phi) - phi), Cn += ``wash`` (beta
    - washed) + ``yaw_cube`` beta^3, washed_dot = (beta - washed)/``wash_lag``, CY += ``side_cube``
    beta^3; beta includes the gust. Side wind and thrust are inputs that no record has. With all
    added parameters zero except the lag, the outputs are those of `Lateral` bit for bit.
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


# ---- Pairs of rudder and aileron maneuvers

# An aileron rolls faster than a rudder yaws: shorter steps, smaller deflections.
ROLL_UNIT, ROLL_AMPLITUDE = 0.6, 0.6
SECOND = 0.5  # begin of the second control, as a share of the record
Pair = Callable[[np.random.Generator, float, float, float], tuple[Maneuver, Maneuver]]


def maneuver_pair(
    kind: str,
    rng: np.random.Generator,
    amplitude: float,
    unit: float,
    duration: float,
    surface: float,
) -> dict[str, Table]:
    """Return rudder and aileron behind their servos.

    ``amplitude`` is that of the rudder, rad; ``unit`` is the step of a 3-2-1-1 that suits the Dutch
    roll, s; ``surface`` is the servos' frequency, rad/s.
    """
    rudder, aileron = PAIRS[kind](rng, amplitude, unit, duration)
    return {
        "rudder": carried_out(rudder, surface, duration),
        "aileron": carried_out(aileron, surface, duration),
    }


def _in_turn(first: str, second: str) -> Pair:
    """Rudder and aileron in random order, the second one in the second half."""

    def pair(
        rng: np.random.Generator, amplitude: float, unit: float, duration: float
    ) -> tuple[Maneuver, Maneuver]:
        half = SECOND * duration
        rudder = KINDS[first](rng, amplitude, unit, half)
        aileron = KINDS[second](rng, ROLL_AMPLITUDE * amplitude, ROLL_UNIT * unit, half)
        if rng.random() < 0.5:
            return Delayed(rudder, half), aileron
        return rudder, Delayed(aileron, half)

    return pair


def _multisines(
    rng: np.random.Generator, amplitude: float, unit: float, duration: float
) -> tuple[Maneuver, Maneuver]:
    """Both at once, with different harmonics."""
    period = math.floor(duration) - 3.0
    highest = max(7, round(period * rng.uniform(0.5, 0.8) / unit))
    rudder = schroeder_multisine(0.4 * amplitude, period, range(2, highest, 2), 1.0)
    return rudder, schroeder_multisine(
        0.4 * ROLL_AMPLITUDE * amplitude, period, range(3, highest, 2), 1.0
    )


PAIRS: Mapping[str, Pair] = {
    "3-2-1-1": _in_turn("3-2-1-1", "3-2-1-1"),
    "doublets": _in_turn("two-doublets", "two-doublets"),
    "multisine": _multisines,
    "hand-flown": _in_turn("hand-flown", "hand-flown"),
    "mixed": _in_turn("two-doublets", "3-2-1-1"),
}
USUAL_PAIRS = ("3-2-1-1", "doublets", "hand-flown", "mixed", "multisine")


# ---- What can be hidden in the lateral surrogate flights

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


# ---- What a lateral surrogate flight's seed decides, as `flights.drawing` for the longitudinal

CONDITION = ("airspeed", "air_density", "trim_alpha", "trim_theta", "cross_inertia")
UNITS = (0.3, 1.5)  # s, steps of a 3-2-1-1


def draw_lateral(surrogate: Surrogate, rng: np.random.Generator) -> Drawn:
    """Draw a lateral flight without dominant effects; the same generator state gives the same
    flight.
    """
    flight = surrogate.flight
    name = str(rng.choice(flight.vehicles))
    declared = drawn_lateral_vehicle(name, flight.variation, rng)
    kinds = dealt(
        flight.maneuvers, int(rng.integers(flight.records[0], flight.records[1] + 1)), rng
    )
    unit = float(np.clip(1.6 / dutch_roll(declared), *UNITS))
    pairs = [
        maneuver_pair(
            kind, rng, rng.uniform(*flight.amplitude), unit, flight.duration, flight.surface
        )
        for kind in kinds
    ]
    rate = float(rng.choice(flight.rates))
    channels = tuple(signal.name for signal in Lateral().outputs)
    corners = _corners(surrogate.causes, (*channels, "rudder", "aileron"), rng)
    model = _with_causes(declared, surrogate.causes, channels, corners, rng)
    low, high = surrogate.wrong
    free = {item.name: item.value for item in declared.parameters if item.free}
    starts = {
        key: value * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(low, high))
        for key, value in free.items()
    }
    rudder, aileron = (tuple(pair[signal] for pair in pairs) for signal in ("rudder", "aileron"))
    return Drawn(
        surrogate,
        name,
        declared,
        model,
        kinds,
        rudder,
        rate,
        channels,
        corners,
        starts,
        (),
        {"aileron": aileron},
    )


def drawn_lateral_vehicle(name: str, variation: float, rng: np.random.Generator) -> Model:
    """Draw a named aircraft whose derivatives differ by up to ``variation``, drawn uniformly.
    Constants differ by half of it, the flight condition does not.
    """
    known = read_parameter_set(name).values
    constants, derivatives = {}, {}
    for key, value in known.items():
        if key not in LATERAL_CONSTANTS:
            derivatives[key] = value * rng.uniform(1.0 - variation, 1.0 + variation)
        else:
            spread = 0.0 if key in CONDITION else 0.5 * variation
            constants[key] = value * rng.uniform(1.0 - spread, 1.0 + spread)
    return model_from_constants("lateral", constants, derivatives)


def dutch_roll(declared: Model) -> float:
    """Return the frequency of the Dutch roll, rad/s: the largest of the oscillating roots."""
    roots = np.linalg.eigvals(linearise(declared).A)
    oscillating = np.abs(roots[np.abs(roots.imag) > 1e-6])
    return float(max(oscillating, default=1.0))


def _with_causes(
    declared: Model,
    causes: Causes,
    channels: tuple[str, ...],
    corners: Mapping[str, float],
    rng: np.random.Generator,
) -> Model:
    """Return the flight with the small causes that are the same in all records.

    Random numbers are drawn for causes that are off, too, so that levels do not influence each
    other's draws.
    """
    v = {item.name: item.value for item in declared.parameters}
    frequency, bent = rng.uniform(20.0, 32.0), rng.uniform(0.3, 1.0, 2)
    own = {
        "gravity": causes.gravity,
        # A fin in the delayed sidewash damps like a part of Cn_r, because beta_dot is close to -r.
        "wash": -causes.downwash
        * v["Cn_r"]
        * v["span"]
        / (2.0 * v["airspeed"])
        / causes.downwash_lag,
        "wash_lag": causes.downwash_lag,
        "yaw_cube": -causes.moment_curvature * v["Cn_beta"] * bent[0] / 0.01,
        "side_cube": -causes.lift_curvature * v["CY_beta"] * bent[1] / 0.01,
    }
    added = tuple(
        Parameter(key, float(value), OWN_PARAMETERS[key], free=False) for key, value in own.items()
    )
    initial = declared.initial.joined(
        (Parameter("speed", 0.0, "m/s", free=False), Parameter("washed", 0.0, "rad", free=False))
    )
    model = Model(
        LateralFlight(), declared.parameters.joined(added), ParameterSet(tuple(initial)), Noise()
    )
    if causes.elastic:
        fin: Any = find_effect("elastic-mode", Lateral())
        loads = {
            "side_force": causes.elastic * v["CY_dr"],
            "yaw": causes.elastic * v["Cn_dr"],
            "gyro": 0.1 * causes.elastic,
        }
        model = with_term(
            model,
            replace(fin, number=2),
            {"frequency": frequency, "damping": 0.04, "angle_gain": 0.0, **loads},
        )
    for channel in channels if corners else ():
        model = with_term(model, AntiAliasFilter(channel), {"corner": corners[channel]})
    return model


def _corners(
    causes: Causes, channels: tuple[str, ...], rng: np.random.Generator
) -> Mapping[str, float]:
    odd, spread = rng.random() < causes.anti_alias_odd, rng.standard_normal(len(channels))
    share = causes.anti_alias_spread if odd else 0.0
    corners = {
        channel: causes.anti_alias * (1.0 + share * float(off))
        for channel, off in zip(channels, spread, strict=True)
    }
    return corners if causes.anti_alias and math.isfinite(causes.anti_alias) else {}
