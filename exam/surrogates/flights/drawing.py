"""The aircraft of a surrogate flight, and what its seed determines."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from exam.aircraft import AIRCRAFT, USUAL
from exam.hidden_terms.anti_alias_filter import AntiAliasFilter
from exam.hidden_terms.curved_loads import CurvedLoads
from exam.surrogates.declaration import AXES, MEASURED, OPTIONAL, Axis, Causes, Surrogate
from exam.surrogates.flights.maneuvers import Table, maneuver
from sim.declaration.effect import Effect, Parameter, ParameterSet, Signal, full_name
from sim.declaration.model import Model, Noise
from sim.effects.dynamics.elastic_mode import ElasticMode
from sim.effects.guards.further_loads import LaggedLoads
from sim.maths import G0, cos
from sim.vehicles.factory import RIGID_CONSTANTS, RIGID_DERIVATIVES, linearise, model_from_constants
from sim.vehicles.library import read_parameter_set
from sim.vehicles.uncoupled import ShortPeriod

# ---- The aircraft of a surrogate flight

BASE = ShortPeriod()


@dataclass(frozen=True)
class LongitudinalFlight:
    """The rigid short period with pitch angle and airspeed as states: gravity bends the path and
    changes the speed.

    theta_dot = q, V_dot = thrust - g sin(theta - alpha), alpha_dot += (g/V) (cos(theta - alpha) -
    1); all are perturbations about level trim. The lift that carries the weight also increases with
    V^2: CL += ``trim_lift`` (1 - (V0/V)^2). Updraft and thrust are inputs that no record has. ax is
    the specific force along the body axis; body and wind axes differ by ``trim_alpha`` + alpha.
    With ``gravity`` and ``trim_lift`` zero, alpha, q and nz are those of `ShortPeriod` bit for bit.
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


# ---- What a surrogate flight's seed decides

ELEVATOR, SPEED = "elevator", "speed-variation"
# that guard's equations are those of the downwash
LATE = LaggedLoads(("1/rad", "1/rad"), (0.0, 0.0), ("Cm_alpha",))
WEAK_MODE = ElasticMode(2)


@dataclass(frozen=True)
class Dominant:
    """A hidden effect with its true local values, and the records (from 0) on which it acts."""

    effect: Effect
    values: Mapping[str, float]
    records: tuple[int, ...]

    @property
    def name(self) -> str:
        return self.effect.name


@dataclass(frozen=True, eq=False)
class Drawn:
    """One flight before it is flown.

    Attributes
    ----------
    declared : the short period with the true constants and derivatives; nothing else. model : with
    all that stays for the flight. maneuvers : of the first input, one a record; others : those of
    further inputs, by name; kinds : what they are. corners : of the filters by channel, Hz, the
    inputs' among them; empty without. channels : recorded outputs. starts : what the loop is told
    of the derivatives. hidden : what dominates.
    """

    surrogate: Surrogate
    vehicle: str
    declared: Model
    model: Model
    kinds: tuple[str, ...]
    maneuvers: tuple[Table, ...]
    rate: float
    channels: tuple[str, ...]
    corners: Mapping[str, float]
    starts: Mapping[str, float]
    hidden: tuple[Dominant, ...] = ()
    others: Mapping[str, tuple[Table, ...]] = field(default_factory=dict)

    @property
    def axis(self) -> Axis:
        """The axis of the flight."""
        return AXES[self.surrogate.flight.axis]

    def moves(self, name: str) -> tuple[Table, ...]:
        """Return the maneuvers of one input, one for each record."""
        return self.maneuvers if name == self.axis.inputs[0] else self.others[name]


def draw(surrogate: Surrogate, rng: np.random.Generator) -> Drawn:
    """Draw a flight without dominant effects; the same generator state gives the same flight."""
    flight = surrogate.flight
    name = str(rng.choice(flight.vehicles))
    declared = drawn_vehicle(name, flight.variation, rng)
    values = {item.name: item.value for item in declared.parameters}
    count = int(rng.integers(flight.records[0], flight.records[1] + 1))
    kinds = dealt(flight.maneuvers, count, rng)
    if flight.once:
        kinds = _with_one(kinds, flight.once, int(rng.integers(count)))
    unit = float(np.clip(1.6 / short_period(declared), 0.2, 1.2))
    moves = tuple(
        maneuver(kind, rng, rng.uniform(*flight.amplitude), unit, flight.duration, flight.surface)
        for kind in kinds
    )
    rate = float(rng.choice(flight.rates))
    chances = rng.random(len(OPTIONAL))
    further = (
        channel
        for channel, chance in zip(OPTIONAL, chances, strict=True)
        if chance < flight.optional
    )
    channels = (*MEASURED, *(channel for channel in further if channel not in flight.unrecorded))
    corners = _corners(surrogate.causes, channels, rng)
    model = _with_causes(declared, surrogate.causes, channels, corners, rng)
    model = model.with_values({"trim_alpha": rng.uniform(*flight.trim_alpha)})
    low, high = surrogate.wrong
    starts = {
        key: values[key] * (1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(low, high))
        for key in RIGID_DERIVATIVES
    }
    return Drawn(surrogate, name, declared, model, kinds, moves, rate, channels, corners, starts)


def drawn_vehicle(name: str, variation: float, rng: np.random.Generator) -> Model:
    """Draw a named aircraft whose derivatives differ by up to ``variation``, drawn uniformly.
    Constants differ by half of it, the flight condition does not.
    """
    if name in AIRCRAFT:
        constants, derivatives = AIRCRAFT[name], USUAL
    else:
        known = read_parameter_set(name).values
        constants, derivatives = (
            {key: known[key] for key in RIGID_CONSTANTS},
            {key: known[key] for key in RIGID_DERIVATIVES},
        )
    changed = {
        key: value * rng.uniform(1.0 - variation, 1.0 + variation)
        for key, value in derivatives.items()
    }
    body = {
        key: value * rng.uniform(1.0 - 0.5 * variation, 1.0 + 0.5 * variation)
        for key, value in constants.items()
    }
    return model_from_constants(
        "rigid",
        {**body, "airspeed": constants["airspeed"], "air_density": constants["air_density"]},
        changed,
    )


def short_period(declared: Model) -> float:
    """Return the frequency of the short period, rad/s: the square root of the product of its
    roots.
    """
    return math.sqrt(max(0.05, float(np.linalg.det(linearise(declared).A))))


def complete(declared: Model, causes: Causes) -> Model:
    """Return the short period with speed, pitch angle and the further channels, at the levels of
    gravity and trim lift.
    """
    v = {item.name: item.value for item in declared.parameters}
    trim_lift = (
        causes.trim_lift
        * 2.0
        * v["mass"]
        * G0
        / (v["air_density"] * v["airspeed"] ** 2 * v["wing_area"])
    )
    added = (
        Parameter("gravity", causes.gravity * G0, "m/s2", free=False),
        Parameter("trim_lift", trim_lift, "1", free=False),
        Parameter("trim_alpha", 0.0, "rad", free=False),
    )
    initial = declared.initial.joined(
        (Parameter("theta", 0.0, "rad", free=False), Parameter("speed", 0.0, "m/s", free=False))
    )
    return Model(
        LongitudinalFlight(),
        declared.parameters.joined(added),
        ParameterSet(tuple(initial)),
        Noise(),
    )


def with_term(model: Model, effect: Effect, values: Mapping[str, float]) -> Model:
    """Return the model with one more term at these local values."""
    return model.with_effects(effect).with_values(
        {full_name(effect, local): value for local, value in values.items()}
    )


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
    model = complete(declared, causes)
    frequency, bent = rng.uniform(20.0, 32.0), rng.uniform(0.3, 1.0, 4) * rng.choice([-1.0, 1.0], 4)
    if causes.downwash:
        moment = (
            causes.downwash * v["Cm_q"] * v["chord"] / (2.0 * v["airspeed"]) / causes.downwash_lag
        )
        model = with_term(model, LATE, {"lag": causes.downwash_lag, "moment": moment, "lift": 0.0})
    if causes.elastic:
        loads = {
            "lift": causes.elastic * v["CL_de"],
            "moment": causes.elastic * v["Cm_de"],
            "gyro": 0.1 * causes.elastic,
        }
        model = with_term(
            model, WEAK_MODE, {"frequency": frequency, "damping": 0.04, "angle_gain": 0.0, **loads}
        )
    if causes.moment_curvature or causes.lift_curvature:
        moment, lift = (
            causes.moment_curvature * v["Cm_alpha"],
            causes.lift_curvature * v["CL_alpha"],
        )
        squares, cubes = bent[:2] / 0.1, -np.abs(bent[2:]) / 0.01
        shares = {"moment_square": moment * squares[0], "moment_cube": moment * cubes[0]}
        model = with_term(
            model,
            CurvedLoads(),
            {**shares, "lift_square": lift * squares[1], "lift_cube": lift * cubes[1]},
        )
    for channel in channels if corners else ():
        model = with_term(model, AntiAliasFilter(channel), {"corner": corners[channel]})
    return model


def _corners(
    causes: Causes, channels: tuple[str, ...], rng: np.random.Generator
) -> Mapping[str, float]:
    odd, spread = (
        rng.random() < causes.anti_alias_odd,
        rng.standard_normal(1 + len(MEASURED) + len(OPTIONAL)),
    )
    if not causes.anti_alias:
        return {}
    share = causes.anti_alias_spread if odd else 0.0
    return {
        channel: causes.anti_alias * (1.0 + share * float(off))
        for channel, off in zip((ELEVATOR, *MEASURED, *OPTIONAL), spread, strict=True)
        if channel == ELEVATOR or channel in channels
    }


def dealt(kinds: tuple[str, ...], count: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Assign kinds in random order; none occurs twice before all have occurred."""
    dealt: list[str] = []
    while len(dealt) < count:
        dealt += [str(kind) for kind in rng.permutation(list(kinds))]
    return tuple(dealt[:count])


def _with_one(kinds: tuple[str, ...], kind: str, place: int) -> tuple[str, ...]:
    """Return the kinds with one replaced."""
    return (*kinds[:place], kind, *kinds[place + 1 :])


def hiding(drawn: Drawn, hidden: tuple[Dominant, ...]) -> Drawn:
    """Return the same flight with these hidden effects."""
    return replace(drawn, hidden=hidden)
