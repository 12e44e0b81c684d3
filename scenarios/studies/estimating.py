"""From an estimation's declaration and a record to an estimate.

Only what the declaration says and the record holds is used: constants of the vehicle (mass, geometry, flight
condition, modal frequencies) come from its data file, every derivative from the declaration.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ident.banks.delays import ENGINES
from ident.estimate import Estimate, Outcome
from ident.filters.ekf import SETTLED, FilterSettings, run_ekf
from ident.filters.one_record import Exponential, Taylor
from scenarios.studies.declaration import Estimation, Flight, Scenario, Start
from scenarios.studies.flying import STEPS
from scenarios.studies.scenario_file.own import own_biases, own_declared
from sim.declaration.compile import compile_model
from sim.declaration.effect import DynamicsEffect, ParameterSet
from sim.declaration.model import Model, Noise, System
from sim.errors import DeclarationError
from sim.record import Record
from sim.vehicles.factory import (
    BALLISTIC_CONSTANTS,
    BALLISTIC_DERIVATIVES,
    MODE_CONSTANTS,
    RIGID_CONSTANTS,
    RIGID_DERIVATIVES,
    WHOLE_AXES,
    mode_parameter,
    mode_units,
    model_from_constants,
)
from sim.vehicles.flexibility import with_frequency_factor
from sim.vehicles.library import read_parameter_set

FIT_STEP = 0.01  # longest sub-step of whole-record fits, s


class _Kind(NamedTuple):
    """Names that equations know: their constants, the derivatives that must be declared, those that may be left out, the states."""

    constants: Collection[str]
    needed: Collection[str]
    optional: Collection[str]
    states: Collection[str]


_KINDS = {
    "rigid": _Kind(RIGID_CONSTANTS, RIGID_DERIVATIVES, (), ("alpha", "q")),
    "ballistic": _Kind(BALLISTIC_CONSTANTS, BALLISTIC_DERIVATIVES, (), ("altitude", "velocity")),
    # A whole axis holds at zero what it is not given, which tells no truth.
    **{
        name: _Kind(constants, (), derivatives, tuple(signal.name for signal in equations.states))
        for name, (equations, constants, derivatives) in WHOLE_AXES.items()
    },
}


@dataclass(frozen=True, eq=False)
class Result:
    """An estimation, the record it saw, and what came out."""

    estimation: Estimation
    record: Record
    estimate: Estimate


def declared_model(estimation: Estimation, constants: Mapping[str, float], noise_std: Mapping[str, float]) -> Model:
    """The model an estimator starts from: constants held, ``start`` free with its priors, ``held`` fixed.

    Raises
    ------
    DeclarationError : a derivative that is neither under ``start`` nor under ``held``, or a name that is unknown.
    """
    if estimation.own is not None:
        return own_declared(estimation, noise_std)
    kind = _kind(estimation)
    place = f"estimation {estimation.name}"
    values = {**{name: start.value for name, start in estimation.start.items()}, **estimation.held}
    _only_declared(estimation, kind, values, place)
    initial = {name: start.value for name, start in estimation.initial.items()}
    model = model_from_constants(kind, constants, values, modes=estimation.modes, initial=_base_states(kind, initial))
    free = model.parameters.only_free(estimation.start).with_prior({name: start.std for name, start in estimation.start.items()})
    states = {signal.name: signal for signal in model.equations.states}
    for effect in model.effects:
        states |= {signal.name: signal for signal in effect.states} if isinstance(effect, DynamicsEffect) else {}
    for name in estimation.initial:
        if name not in states:
            raise DeclarationError(f"there is no state {name!r}", where=f"{place}, key initial", remedy=f"its states are {', '.join(states)}")
    start = _initial_states(model, estimation.initial, place)
    return replace(model, parameters=free, initial=start, noise=Noise(dict(noise_std), dict(estimation.process_noise)))


def assumed_noise(scenario: Scenario, estimation: Estimation) -> dict[str, float]:
    """Measurement noise that an estimator is told: the sensors' data sheet unless the estimation says otherwise."""
    return {**scenario.flight.noise_std, **estimation.flown_noise_std, **estimation.noise_std}


def vehicle_constants(estimation: Estimation, vehicle: str, frequency_factor: float = 1.0) -> dict[str, float]:
    """The numbers of a built-in vehicle that an estimator may know: no derivative among them, and none where the model has its own."""
    if estimation.own is not None:
        return {}
    data = with_frequency_factor(read_parameter_set(vehicle), frequency_factor)
    names = list(_KINDS[_kind(estimation)].constants)
    names += [mode_parameter(local, i) for i in range(1, estimation.modes + 1) for local in MODE_CONSTANTS]
    return {name: data[name].value for name in names}


def flight_constants(flight: Flight, estimation: Estimation) -> dict[str, float]:
    """``vehicle_constants`` of what flies."""
    return vehicle_constants(estimation, flight.vehicle, flight.frequency_factor)


def compiled(estimation: Estimation, model: Model) -> System:
    """The System of a model for the estimation's method and outputs."""
    filtering = estimation.method in ("ekf", "ukf")
    if estimation.method in ("output-error", "filter-error"):
        return biased_system(estimation, model)
    return compile_model(model, estimation.outputs, online=filtering)


def biased_system(estimation: Estimation, model: Model) -> System:
    """The System of a model for a whole-record fit: with a free bias of each sensor that can have one."""
    return compile_model(model.with_biases(_biased(estimation, model)), estimation.outputs)


def _biased(estimation: Estimation, model: Model) -> list[str]:
    """The outputs whose sensors have a free bias."""
    if estimation.own is not None:
        return own_biases(model, estimation.outputs)
    return [name for name in estimation.outputs if not (estimation.model == "ballistic" and name == "altitude")]


def _longest_step(estimation: Estimation) -> float:
    """Largest integration step of a whole-record fit, s; an own model may be a thousand times slower than an aircraft: its scenario's word counts."""
    told = estimation.own is not None and math.isfinite(estimation.max_step)
    return estimation.max_step if told else min(FIT_STEP, estimation.max_step)


def filter_settings(estimation: Estimation) -> FilterSettings:
    """Integration settings of a filter."""
    transition = Taylor(estimation.terms) if estimation.terms else Exponential()
    return FilterSettings(STEPS[estimation.integration], transition, estimation.max_step, estimation.passes)


def estimate_record(estimation: Estimation, record: Record, model: Model) -> Result:
    """Run an estimation on a record with a declared model."""
    system = compiled(estimation, model)
    if estimation.method in ("ekf", "ukf"):
        estimate = _filtered(estimation, record, model)
    elif estimation.method == "output-error":
        from ident.whole_record.layout import FitSettings
        from ident.whole_record.output_error import fit_output_error

        estimate = fit_output_error([record], system, FitSettings(max_step=_longest_step(estimation), use_priors=estimation.use_priors))
    elif estimation.method == "filter-error":
        from ident.process_noise.filter_error import fit_filter_error
        from ident.whole_record.layout import FitSettings

        settings = FitSettings(max_step=_longest_step(estimation), use_priors=estimation.use_priors)
        calm = compiled(estimation, model.with_noise(replace(model.noise, process_density={})))
        estimate = fit_filter_error([record], system, settings, calm=calm)
    else:
        from ident.regression.equation_error import run_equation_error

        estimate = run_equation_error([record], system)
    return Result(estimation, record, estimate)


def narrowed(model: Model, estimate: Estimate, spread: float) -> Model:
    """The model started at an estimate, each free parameter with at most ``spread`` of its standard deviations."""
    std = {name: min(model.parameters[name].prior_std, spread * float(sigma)) for name, sigma in zip(estimate.names, estimate.std, strict=True)}
    return replace(model, parameters=model.parameters.with_values(estimate.as_dict()).with_prior(std))


def _filtered(estimation: Estimation, record: Record, model: Model) -> Estimate:
    """The filter of an estimation, in as many passes as it takes."""
    if estimation.method == "ukf":
        from ident.filters.ukf import run_ukf as run
    else:
        run = partial(run_ekf, by=ENGINES[estimation.engine].one_pass)
    settings = filter_settings(estimation)
    if math.isinf(estimation.spread):
        return run(record, compiled(estimation, model), settings)
    once = replace(settings, passes=1)
    estimate = run(record, compiled(estimation, model), once)
    for done in range(1, estimation.passes):
        if estimate.outcome is not Outcome.CONVERGED:
            break
        again = run(record, compiled(estimation, narrowed(model, estimate, estimation.spread)), once)
        moved = np.max(np.abs(again.values - estimate.values) / estimate.std, initial=0.0)
        estimate = replace(again, iterations=done + 1)
        if moved < SETTLED:
            break
    return estimate


def _kind(estimation: Estimation) -> str:
    return "rigid" if estimation.model == "flexible" else estimation.model


def _only_declared(estimation: Estimation, kind: str, values: Mapping[str, float], place: str) -> None:
    """Refuse a derivative without a declared value: a default would be the truth's."""
    needed = _KINDS[kind].needed
    modal = [name for name, _, must in mode_units(estimation.modes) if must and not name.startswith(tuple(MODE_CONSTANTS))]
    known = {*needed, *_KINDS[kind].optional, *modal, *(name for name, _, _ in mode_units(estimation.modes))}
    for name in (*needed, *modal):
        if name not in values:
            raise DeclarationError(f"{name} has no starting value", where=f"{place}, key start", remedy="give it under start, or under held")
    for name in values:
        if name not in known:
            raise DeclarationError(f"there is no parameter {name!r}", where=f"{place}, key start", remedy=f"use {', '.join(sorted(known))}")
    for name in estimation.held:
        if name in estimation.start:
            raise DeclarationError(f"{name} is under start and under held", where=f"{place}, key held", remedy="keep one of the two")
    for name in estimation.process_noise:
        if name not in (*estimation.start, *estimation.initial):
            remedy = f"use {', '.join((*estimation.initial, *estimation.start))}"
            raise DeclarationError(f"{name!r} is no state and no free parameter", where=f"{place}, key process_noise", remedy=remedy)


def _base_states(kind: str, initial: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in initial.items() if name in _KINDS[kind].states}


def _initial_states(model: Model, initial: Mapping[str, Start], place: str) -> ParameterSet:
    for signal in model.equations.states:
        if signal.name not in initial:
            raise DeclarationError(f"state {signal.name} has no starting value", where=f"{place}, key initial", remedy="give its value and std")
    known = {item.name: item for item in model.initial}
    items = []
    for effect in model.effects:
        for signal in effect.states if isinstance(effect, DynamicsEffect) else ():
            if signal.name in initial:
                known[signal.name] = replace(model.initial.items[0], name=signal.name, unit=signal.unit, source="declared")
    for name, item in known.items():
        items.append(replace(item, value=initial[name].value, prior_std=initial[name].std, free=True))
    return ParameterSet(tuple(items))
