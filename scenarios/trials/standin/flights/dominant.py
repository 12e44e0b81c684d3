"""The effect that dominates a stand-in: drawn by name, of such a size that a given share of the declared model's error is due to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from scenarios.trials.standin.fitting import declared_model, misfit
from scenarios.trials.standin.flights.drawing import SPEED, Dominant, Drawn, hiding, short_period
from scenarios.trials.standin.flights.flying import fly_drawn
from scenarios.trials.standin.flights.sizes import values_at
from sim.effects.library import find_effect
from sim.errors import DeclarationError, ModelError
from sim.maths.splines import shape_names

LEAST = 0.3  # share of the error: below it nothing dominates
SIZED_ON = 2  # records
SIZING_STEP = 0.01  # s
ROUNDS = 4

# Local values at a size of one, the largest that is drawn; the effect vanishes as the size does.
Direction = Mapping[str, float]
AtSize = Callable[[float], Direction]
Kind = Callable[[Drawn, np.random.Generator], AtSize]


def draw_dominant(drawn: Drawn, rng: np.random.Generator) -> Drawn:
    """The flight with as many effects as it declares; names whose largest size is still too small are passed over.

    Raises
    ------
    DeclarationError : a name that cannot be hidden, or too few of the names make a difference on this flight.
    """
    wanted = drawn.standin.hidden
    for name in wanted.names:
        _kind(name)
    chosen: list[Dominant] = []
    if wanted.count:
        seed = int(rng.integers(2**32))
        before = misfit(_records(drawn, seed), declared_model(drawn.declared, drawn.starts))
        for name in rng.permutation(list(wanted.names)):
            if any(group(str(name)) == group(other.name) for other in chosen):
                continue
            if name in wanted.sizes:
                found = of_declared_size(drawn, str(name), before, seed, rng)
            else:
                found = sized(drawn, str(name), rng.uniform(*wanted.reduction), before, seed, rng)
            if found is not None:
                chosen.append(found)
            if len(chosen) == wanted.count:
                return hiding(drawn, tuple(chosen))
        what = f"only {len(chosen)} of {wanted.count} effects make a difference on this flight"
        raise DeclarationError(what, where="key hidden", remedy="name more effects, or ask for a smaller reduction")
    return drawn


def sized(drawn: Drawn, name: str, reduction: float, before: np.ndarray, seed: int, rng: np.random.Generator) -> Dominant | None:
    """An effect for which the error of the declared model, in the channel that shows it most, is that of a flight without it over (1 - reduction).

    ``before`` is the misfit without it, of the same records with the same random numbers. None where its largest size stays below ``LEAST``.
    """
    at = _kind(name)(drawn, rng)
    effect: Any = find_effect(name, drawn.model.equations)
    if hasattr(effect, "low"):
        reach = _peak(drawn) if name.startswith("control") else 0.09
        effect = replace(effect, low=-reach, high=reach)
    count = len(drawn.maneuvers)
    records = (int(rng.integers(count)),) if effect.traits.per_record and name != SPEED else tuple(range(count))
    sizing = tuple(range(SIZED_ON)) if len(records) == 1 else records
    model, wanted = declared_model(drawn.declared, drawn.starts), -math.log(1.0 - reduction)

    def reached(size: float) -> float:
        changed = hiding(drawn, (Dominant(effect, at(size), sizing),))
        try:
            return float(np.max(np.log(misfit(_records(changed, seed), model) / before)))
        except ModelError:
            return math.inf

    # The square of the misfit grows as that of the size; a step is halved where that law leads astray.
    size, low, high = 0.3, 0.0, 1.0
    for _ in range(ROUNDS):
        now = reached(size)
        if abs(now - wanted) < 0.1 * wanted or (now < wanted and size >= 1.0):
            break
        low, high = (size, high) if now < wanted else (low, size)
        step = math.sqrt(math.expm1(2.0 * wanted) / max(math.expm1(2.0 * min(now, 5.0)), 1e-4))
        size = min(size * step, 1.0) if low < size * step < high or (size * step >= 1.0 and high == 1.0) else 0.5 * (low + high)
    else:
        now = reached(size)
    return Dominant(effect, at(size), records) if now > -math.log(1.0 - LEAST) and math.isfinite(now) else None


def of_declared_size(drawn: Drawn, name: str, before: np.ndarray, seed: int, rng: np.random.Generator) -> Dominant | None:
    """An effect of a size drawn from its declared span, evenly among those that stand for ``LEAST`` of the error; None where the largest does not.

    ``before`` and ``seed`` as in ``sized``.
    """
    low, high = drawn.standin.hidden.sizes[name]
    effect, sign = find_effect(name, drawn.model.equations), float(rng.choice([-1.0, 1.0]))
    model, records = declared_model(drawn.declared, drawn.starts), tuple(range(len(drawn.maneuvers)))
    for left in reversed(range(ROUNDS)):
        size = rng.uniform(low, high) if left else high
        found = Dominant(effect, values_at(drawn, name, size, sign), records)
        if float(np.max(misfit(_records(hiding(drawn, (found,)), seed), model) / before)) > 1.0 / (1.0 - LEAST):
            return found
        low = size  # what is larger shows more
    return None


def group(name: str) -> str:
    """What an effect shares its traces with: of one group only one is hidden at a time."""
    kind, _, channel = name.partition(":")
    if name in ("vane-offset", "accelerometer-offset:nz"):
        return "late alpha"
    if kind in ("sensor-lag", "sensor-delay"):
        return f"late {channel}"
    if kind in ("input-delay", "actuator-lag", "actuator-rate-limit"):
        return "late input"
    if kind in ("input-deadband", "actuator-saturation", "control-nonlinearity", "input-backlash"):
        return "control curve"
    return kind


def _records(drawn: Drawn, seed: int) -> list:
    return [flown.record for flown in fly_drawn(drawn, np.random.default_rng(seed), step=SIZING_STEP, count=SIZED_ON)]


def _peak(drawn: Drawn) -> float:
    return max(float(np.max(np.abs(move.values))) for move in drawn.maneuvers)


def _value(drawn: Drawn, name: str) -> float:
    return drawn.declared.parameters[name].value


def _omega(drawn: Drawn) -> float:
    return short_period(drawn.declared)


def _along(most: Direction, absent: float = 0.0) -> AtSize:
    return lambda size: {local: absent + size * (value - absent) for local, value in most.items()}


def _only(local: str, most: Callable[[Drawn], float], absent: float = 0.0) -> Kind:
    return lambda drawn, rng: _along({local: most(drawn)}, absent)


def _limit(local: str, largest: Callable[[Drawn], float]) -> Kind:
    """A limit that comes down from the largest value that the maneuvers reach."""
    return lambda drawn, rng: lambda size: {local: largest(drawn) * (1.0 - 0.85 * size)}


def _fastest(drawn: Drawn) -> float:
    return max(float(np.max(np.abs(np.diff(move.values)))) / move.spacing for move in drawn.maneuvers)


def _late(drawn: Drawn) -> float:
    return min(0.25, 0.7 / _omega(drawn))


def _scale(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    return _along({"scale": float(rng.choice([0.6, 1.6]))}, 1.0)


def _curve(rms: Callable[[Drawn], float]) -> Kind:
    def kind(drawn: Drawn, rng: np.random.Generator) -> AtSize:
        shapes = rng.standard_normal(len(shape_names(False))) / (1.0 + np.arange(len(shape_names(False)))) ** 1.5
        shapes *= rms(drawn) / np.linalg.norm(shapes)
        return _along(dict(zip(shape_names(False), shapes.tolist(), strict=True)))

    return kind


def _control(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    at = _curve(lambda drawn: 0.4 * _peak(drawn))(drawn, rng)
    return lambda size: {**at(size), "lift_share": 1.0}


def _rate(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    return lambda size: {"rate": 1.05 * _fastest(drawn) * (1.0 - 0.97 * math.sqrt(size))}


def _mode(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    frequency, damping = rng.uniform(max(7.0, 2.2 * _omega(drawn)), 20.0), rng.uniform(0.015, 0.05)
    most = {"lift": 1.5 * _value(drawn, "CL_de"), "moment": 0.6 * _value(drawn, "Cm_de"), "gyro": 0.06}
    held = {"frequency": frequency, "damping": damping, "angle_gain": 0.0}
    return lambda size: {**held, **{local: size * value for local, value in most.items()}}


def _speed(drawn: Drawn, rng: np.random.Generator) -> AtSize:
    return _along({"rate": float(rng.choice([-1.0, 1.0])) * 0.35 * _value(drawn, "airspeed") / drawn.standin.flight.duration})


def _event(most: Callable[[Drawn], Direction], held: Callable[[Drawn, np.random.Generator], Direction]) -> Kind:
    def kind(drawn: Drawn, rng: np.random.Generator) -> AtSize:
        sign, fixed, largest = float(rng.choice([-1.0, 1.0])), held(drawn, rng), most(drawn)
        return lambda size: {**fixed, **{local: sign * size * value for local, value in largest.items()}}

    return kind


def _start(drawn: Drawn, rng: np.random.Generator) -> float:
    return float(rng.uniform(0.2, 0.6) * drawn.standin.flight.duration)


def _drift(most: float) -> Kind:
    return _event(lambda drawn: {"slope": most / drawn.standin.flight.duration}, lambda drawn, rng: {})


KINDS: Mapping[str, Kind] = {
    "input-delay": _only("delay", _late),
    "actuator-lag": _only("time_constant", lambda drawn: 1.5 * _late(drawn)),
    "actuator-rate-limit": _rate,
    "actuator-saturation": _limit("limit", _peak),
    "input-deadband": _only("half_width", lambda drawn: 0.5 * _peak(drawn)),
    "input-backlash": _only("half_width", lambda drawn: 0.4 * _peak(drawn)),
    "moment-nonlinearity": _curve(lambda drawn: 0.04 * abs(_value(drawn, "Cm_alpha"))),
    "lift-nonlinearity": _curve(lambda drawn: 0.03 * _value(drawn, "CL_alpha")),
    "control-nonlinearity": _control,
    "elastic-mode": _mode,
    "vane-offset": _only("arm", lambda drawn: 3.5 * _value(drawn, "chord")),
    "accelerometer-offset:nz": _event(lambda drawn: {"arm": 2.0 * _value(drawn, "chord")}, lambda drawn, rng: {}),
    **{f"sensor-scale:{channel}": _scale for channel in ("alpha", "q", "nz")},
    **{f"sensor-lag:{channel}": _only("time_constant", _late) for channel in ("alpha", "q", "nz")},
    **{f"sensor-delay:{channel}": _only("delay", _late) for channel in ("alpha", "q", "nz")},
    SPEED: _speed,
    "gust-turbulence": _only("sigma", lambda drawn: 0.04 * _value(drawn, "airspeed")),
    "derivative-jump": _event(
        lambda drawn: {"Cm_alpha": 0.8 * _value(drawn, "Cm_alpha"), "Cm_de": 0.0, "Cm_q": 0.0, "CL_alpha": 0.0},
        lambda drawn, rng: {"time": float(rng.uniform(0.2, 0.5) * drawn.standin.flight.duration)},
    ),
    "gust-discrete": _event(
        lambda drawn: {"peak": 0.12 * _value(drawn, "airspeed")},
        lambda drawn, rng: {"start": _start(drawn, rng), "duration": float(rng.uniform(0.8, 2.0))},
    ),
    "unmeasured-input": _event(
        lambda drawn: {"moment": 0.05 * abs(_value(drawn, "Cm_de")), "lift": 0.0},
        lambda drawn, rng: {"start": _start(drawn, rng), "duration": float(rng.uniform(0.8, 2.0))},
    ),
    "sensor-drift:alpha": _drift(0.08),
    "sensor-drift:q": _drift(0.08),
    "sensor-drift:nz": _drift(0.6),
}


def _kind(name: str) -> Kind:
    if name not in KINDS:
        raise DeclarationError(f"{name!r} cannot be hidden", where="key hidden.names", remedy=f"use {', '.join(KINDS)}")
    return KINDS[name]
