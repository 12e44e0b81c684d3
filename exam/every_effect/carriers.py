"""Vehicles that carry hidden effects, with the plans of their two records, and the effects that
each model can have.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from exam.clean import FLOWN, WRONG
from exam.random_cases.case import Setting
from exam.random_cases.vehicles import (
    CONTROL,
    RATES,
    as_sampled,
    drawn_flights,
    drawn_vehicle,
    vehicle_file,
)
from exam.random_cases.vehicles import NOISE as OF_PAPERS
from exam.scores.rates import NOTHING, kind_of
from scenarios.studies.declaration import maneuvers_by_input
from scenarios.studies.estimating import resting
from scenarios.trials.planted_declaration import RecordPlan, TraceScenario, true_vehicle
from scenarios.trials.planted_flights import started_file, trace_scenario_of
from sim.declaration.effect import Effect, full_name
from sim.declaration.model import Equations, Model, Noise
from sim.declaration.proposal import Traceable
from sim.effects.library import effects_for
from sim.errors import DeclarationError
from sim.maneuvers import Maneuver
from sim.record import Channel, Record
from sim.truth.flight import fly, sample_times

# ---- What carries a hidden effect

MODELS = ("rigid", "loes", "ballistic", "flexible", "lateral", "longitudinal")
# whose vehicles and maneuvers are drawn; of the others the flight of a tracing scenario
DRAWN = ("rigid", "loes", "ballistic")
STEP = 0.005  # s, integration step; input paths use finer cells


@dataclass(frozen=True, eq=False)
class Plan:
    """One record to be flown: the true model without noise at its start, maneuvers by input, and
    times in s.
    """

    model: Model
    inputs: Mapping[str, Maneuver] | None
    time: np.ndarray

    @property
    def duration(self) -> float:
        return float(self.time[-1] - self.time[0])

    @property
    def interval(self) -> float:
        """Sampling interval, s."""
        return float(self.time[1] - self.time[0])


HiddenEffects = tuple[tuple[Effect, Mapping[str, float]], ...]


@dataclass(frozen=True, eq=False)
class Carrier:
    """A vehicle in two records.

    ``model`` is the name of the model for the loop, ``noise`` the standard deviation of each
    measured output, ``free`` the parameters that the loop estimates, and ``vehicle_file`` the text
    of the vehicle file for the loop.
    """

    vehicle: str
    model: str
    train: Plan
    validate: Plan
    noise: Mapping[str, float]
    free: tuple[str, ...]
    vehicle_file: str

    def flown(
        self, plan: Plan, hidden: HiddenEffects, rng: np.random.Generator, *, step: float = STEP
    ) -> Record:
        """Fly one record without measurement noise; ``rng`` serves random effects."""
        true = plan.model
        for effect, values in hidden:
            true = true.with_effects(effect).with_values(
                {full_name(effect, local): value for local, value in values.items()}
            )
        return fly(
            true,
            plan.inputs,
            plan.time,
            rng,
            step=min(step, plan.interval),
            outputs=tuple(self.noise),
        )[0]

    def measured(self, record: Record, rng: np.random.Generator) -> Record:
        """Return a record with measurement noise."""
        outputs = tuple(
            Channel.of(
                c.name, c.unit, c.values + self.noise[c.name] * rng.standard_normal(len(record))
            )
            for c in record.outputs
        )
        return replace(record, outputs=outputs)


def drawn_carrier(model: str, rng: np.random.Generator) -> Carrier:
    """Draw a vehicle with two records for a model of ``MODELS``."""
    return _drawn(model, rng) if model in DRAWN else _of_scenario(model, rng)


@cache
def equations_of(model: str) -> Equations:
    """Return the equations of a model's vehicles, which all have the same effects."""
    return drawn_carrier(model, np.random.default_rng(0)).train.model.equations


def _drawn(model: str, rng: np.random.Generator) -> Carrier:
    label, true = drawn_vehicle(model, rng)
    rate = float(rng.choice(RATES[model]))
    train, validate = (
        _plan(model, flight.setting, flight.maneuver, rate)
        for flight in drawn_flights(true, rate, rng)
    )
    names = [signal.name for signal in true.equations.outputs]
    noise = {name: OF_PAPERS[name] for name in names if name in OF_PAPERS}
    return Carrier(
        label, model, train, validate, noise, true.parameters.free_names, vehicle_file(true, rng)
    )


def _plan(model: str, setting: Setting, maneuver: Maneuver | None, rate: float) -> Plan:
    time = sample_times(rate, setting.duration)
    inputs = (
        None if maneuver is None else {CONTROL[model]: as_sampled(maneuver, time, setting.interval)}
    )
    return Plan(setting.model.with_noise(Noise()), inputs, time)


def _of_scenario(model: str, rng: np.random.Generator) -> Carrier:
    scenario = _scenario(model)
    flight, true = scenario.flight, true_vehicle(scenario.flight).with_noise(Noise())
    inputs = {signal.name for signal in true.equations.inputs}

    def planned(plan: RecordPlan, name: str) -> Plan:
        moved = maneuvers_by_input(plan.maneuvers, inputs, f"key flight.{name}", resting(true))
        return Plan(true, moved, sample_times(flight.rate, plan.duration))

    train, validate = planned(flight.train, "train"), planned(flight.validate, "validate")
    free = {item.name: item.value for item in true.parameters if item.free}
    start = {
        name: value * (1.0 + float(rng.uniform(-WRONG, WRONG)))
        for name, value in free.items()
        if value != 0.0
    }
    text = started_file(replace(scenario, start=start), true)
    return Carrier(flight.vehicle, model, train, validate, flight.noise_std, tuple(free), text)


@cache
def _scenario(model: str) -> TraceScenario:
    from scenarios.studies.catalogue import load_document

    return trace_scenario_of(*load_document(FLOWN[model]))


# ---- What is hidden

# in a fall no more than another start; no search proposes them
UNSEEN = ("sensor-delay:altitude", "sensor-lag:altitude")


@dataclass(frozen=True)
class Instance:
    """An effect with its full name on the vehicles of one model; with an empty name, no effect."""

    model: str
    name: str


def effect_of(instance: Instance) -> Traceable:
    """Return the effect of an instance from the library, in its first form if it has several."""
    return _offered(instance.model)[instance.name]


@cache
def _offered(model: str) -> Mapping[str, Traceable]:
    """Return the effects that may be hidden on a model's vehicles, by name.

    General forms and modes that a vehicle declares are not among them.
    """
    offered = [
        effect
        for effect in effects_for(equations_of(model))
        if isinstance(effect, Traceable) and not effect.traits.general
    ]
    return {effect.name: effect for effect in reversed(offered) if effect.name not in UNSEEN}


@cache
def library_kinds() -> Mapping[str, tuple[Instance, ...]]:
    """Return the instances of each kind, ``NOTHING`` first.

    Models and channels are mixed, so that few flights include several of them.
    """
    kinds: dict[str, dict[Instance, None]] = {
        NOTHING: dict.fromkeys(Instance(model, "") for model in MODELS)
    }
    for model in MODELS:
        for name in reversed(list(_offered(model))):
            kinds.setdefault(kind_of(name), {})[Instance(model, name)] = None
    return {name: _mixed(tuple(found)) for name, found in kinds.items()}


def _mixed(instances: tuple[Instance, ...]) -> tuple[Instance, ...]:
    """Return a permutation that depends on the number of items only."""
    return tuple(
        instances[at] for at in np.random.default_rng(len(instances)).permutation(len(instances))
    )


def chosen(asked: Sequence[str] | None) -> Mapping[str, tuple[Instance, ...]]:
    """Return the kinds that are asked for: ``nothing``, a kind, or an effect by its full name; None
    for all.

    Raises
    ------
    DeclarationError : a name that the library lacks, or one twice.
    """
    kinds = library_kinds()
    if asked is None:
        return kinds
    found: dict[str, tuple[Instance, ...]] = {}
    for name in asked:
        of_name = kinds.get(name) or tuple(
            instance for instance in kinds.get(kind_of(name), ()) if instance.name == name
        )
        if not of_name:
            near = difflib.get_close_matches(name, kinds, n=1, cutoff=0.4)
            remedy = f"did you mean {near[0]!r}?" if near else f"use {', '.join(kinds)}"
            raise DeclarationError(f"there is no effect {name!r}", where="--effects", remedy=remedy)
        if name in found:
            raise DeclarationError(
                f"{name} is named twice", where="--effects", remedy="name each once"
            )
        found[name] = of_name
    if not found:
        raise DeclarationError(
            "no effect is named", where="--effects", remedy="name some, or leave it out for all"
        )
    return found
