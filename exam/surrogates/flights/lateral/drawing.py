"""What a lateral surrogate flight's seed decides, as `flights.drawing` for the longitudinal
ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from exam.hidden_terms.anti_alias_filter import AntiAliasFilter
from exam.surrogates.declaration import Causes, Surrogate
from exam.surrogates.flights.drawing import Drawn, dealt, with_term
from exam.surrogates.flights.lateral.aircraft import OWN_PARAMETERS, LateralFlight
from exam.surrogates.flights.lateral.maneuvers import maneuver_pair
from sim.declaration.effect import Parameter, ParameterSet
from sim.declaration.model import Model, Noise
from sim.effects.library import find_effect
from sim.vehicles.factory import linearise, model_from_constants
from sim.vehicles.library import read_parameter_set
from sim.vehicles.uncoupled import LATERAL_CONSTANTS, Lateral

CONDITION = ("airspeed", "air_density", "trim_alpha", "trim_theta", "cross_inertia")
UNITS = (0.3, 1.5)  # s, of a 3-2-1-1


def draw_lateral(surrogate: Surrogate, rng: np.random.Generator) -> Drawn:
    """A lateral flight without what dominates; the same generator state gives the same flight."""
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
    """A named aircraft whose every number is off by up to ``variation``, drawn evenly: constants by
    half of it, but not the flight condition.
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
    """Frequency of the Dutch roll, rad/s: the largest of the oscillating roots."""
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
    """Small causes that stay for the flight; draws are made for those that are off, too, so that
    levels do not move each other's draws.
    """
    v = {item.name: item.value for item in declared.parameters}
    frequency, bent = rng.uniform(20.0, 32.0), rng.uniform(0.3, 1.0, 2)
    own = {
        "gravity": causes.gravity,
        # A fin that sees the sidewash late damps as part of Cn_r does: beta_dot is next to -r.
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
