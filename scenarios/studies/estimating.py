"""Simulate the flight of a scenario, and estimate parameters from one record or many.

An estimate uses only the record, the declaration of the estimation, and constants of the vehicle
(mass, geometry, flight condition, modal frequencies). Every starting value of a derivative comes
from the declaration.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ident.banks.bank import BankEstimate, run_bank
from ident.banks.engines import ENGINES
from ident.estimate import Estimate, Outcome
from ident.filters.ekf import SETTLED_SIGMAS, FilterSettings, run_ekf
from ident.filters.one_record import Exponential, Taylor
from scenarios.files.user_models import inputs_at_rest
from scenarios.studies.declaration import (
    FILTERS,
    Estimation,
    FlightPlan,
    Scenario,
    Start,
    maneuvers_by_input,
    with_common_hold,
)
from scenarios.studies.reading import own_biases, own_declared, refuse_held_start
from sim.declaration.compile import compile_model
from sim.declaration.effect import DynamicsEffect, ParameterSet
from sim.declaration.model import Model, Noise, System
from sim.errors import DeclarationError
from sim.propagation import euler_step, rk4_step
from sim.record import Record
from sim.truth.feedback import fly_with_feedback
from sim.truth.flight import Distance, Truth, fly, remeasure, sample_times
from sim.vehicles.factory import (
    BALLISTIC_CONSTANTS,
    BALLISTIC_DERIVATIVES,
    MODE_CONSTANTS,
    RIGID_CONSTANTS,
    RIGID_DERIVATIVES,
    WHOLE_AXES,
    ballistic_model,
    flexible_model,
    mode_parameter,
    mode_units,
    model_from_constants,
    rigid_model,
    whole_axis_model,
)
from sim.vehicles.flexibility import condense_above, with_frequency_factor
from sim.vehicles.library import VehicleData, read_parameter_set

# ---- Flight of a scenario: record and truth

STEPS = {"rk4": rk4_step, "euler": euler_step}

DISTANCES = {
    "same equations and step": Distance.SAME_EQUATIONS,
    "same equations, finer step": Distance.OTHER_STEP,
    "same equations, other values": Distance.OTHER_VALUES,
    "effect missing": Distance.EFFECT_MISSING,
}


def true_model(flight: FlightPlan) -> Model:
    """Return the model of the true vehicle, with its noise."""
    noise = Noise(flight.noise_std, flight.process_noise)
    if flight.own is not None:
        return flight.own.with_noise(noise)
    model = vehicle_model(flight.vehicle, flight.modes, noise, flight.frequency_factor)
    free = model.parameters.free_names
    for name in flight.derivatives:
        if name not in free:
            raise DeclarationError(
                f"there is no derivative {name!r}",
                where="key flight.derivatives",
                remedy=f"use {', '.join(free)}",
            )
    return model.with_values(flight.derivatives)


def vehicle_model(vehicle: str, modes: int, noise: Noise, frequency_factor: float = 1.0) -> Model:
    """Return a built-in vehicle with ``modes`` elastic modes and scaled modal frequencies."""
    data = with_frequency_factor(read_parameter_set(vehicle), frequency_factor)
    if modes and not data.modes:
        raise DeclarationError(
            f"{modes} elastic modes asked for", where=f"vehicle {data.name}", remedy="it has none"
        )
    if data.equations == "ballistic":
        return ballistic_model(data, noise)
    if data.equations in WHOLE_AXES:
        return whole_axis_model(data, noise)
    return flexible_model(data, modes, noise) if modes else rigid_model(data, noise)


def flown_vehicle(flight: FlightPlan) -> VehicleData:
    """Return the data of the flight's built-in vehicle."""
    return with_frequency_factor(read_parameter_set(flight.vehicle), flight.frequency_factor)


def fly_scenario(scenario: Scenario, seed: int, where: str = "") -> tuple[Record, Truth]:
    """Simulate the truth of a scenario; the same seed gives the same bytes.

    Raises
    ------
    DeclarationError : a maneuver lacks a number or moves an unknown input, or noise is declared for
        an unknown output.
    """
    flight = scenario.flight
    model = true_model(flight)
    place = where or "key flight"
    inputs = {signal.name for signal in model.equations.inputs}
    outputs = [signal.name for signal in model.equations.outputs]
    for name in flight.noise_std:
        if name not in outputs:
            raise DeclarationError(
                f"there is no output {name!r}",
                where=f"{place}.noise",
                remedy=f"its outputs are {', '.join(sorted(outputs))}",
            )
    by_input = maneuvers_by_input(flight.maneuvers, inputs, place, resting(model))
    time = sample_times(flight.rate, flight.duration)
    if flight.own is not None:
        by_input = with_common_hold(by_input, flight.maneuvers, time)
    common: dict[str, Any] = {
        "step": min(flight.step, 1.0 / flight.rate),
        "method": STEPS.get(flight.integration),  # None: adaptive step
        "outputs": [name for name in outputs if name in flight.noise_std],
        "distance": DISTANCES[scenario.distance],
        "name": scenario.name,
    }
    rng = np.random.default_rng(seed)
    if flight.feedback:
        return fly_with_feedback(model, by_input, flight.feedback, time, rng, **common)
    return fly(model, by_input, time, rng, **common)


def resting(model: Model) -> dict[str, float]:
    """Return the inputs that a user model has at rest, by name; only those that are not zero."""
    names = [signal.name for signal in model.equations.inputs]
    return {name: value for name, value in zip(names, inputs_at_rest(model), strict=True) if value}


def measured_again(
    record: Record, truth: Truth, noise_std: Mapping[str, float], seed: int
) -> Record:
    """Return a flight's record with new measurement noise of the given levels."""
    std = {**truth.noise_std, **noise_std}
    return remeasure(record, replace(truth, noise_std=std), np.random.default_rng(seed))


# ---- Estimate from a record and the declaration of an estimation

FIT_STEP = 0.01  # s, longest integration step of fits of whole records


class _Names(NamedTuple):
    """Names in built-in equations: constants, required and optional derivatives, states."""

    constants: Collection[str]
    needed: Collection[str]
    optional: Collection[str]
    states: Collection[str]


_NAMES = {
    "rigid": _Names(RIGID_CONSTANTS, RIGID_DERIVATIVES, (), ("alpha", "q")),
    "ballistic": _Names(BALLISTIC_CONSTANTS, BALLISTIC_DERIVATIVES, (), ("altitude", "velocity")),
    # Optional derivatives without a value are fixed at zero, which contains nothing of the truth.
    **{
        name: _Names(constants, (), derivatives, tuple(signal.name for signal in equations.states))
        for name, (equations, constants, derivatives) in WHOLE_AXES.items()
    },
}


@dataclass(frozen=True, eq=False)
class Result:
    """An estimation with its record and estimate."""

    estimation: Estimation
    record: Record
    estimate: Estimate


def declared_model(
    estimation: Estimation, constants: Mapping[str, float], noise_std: Mapping[str, float]
) -> Model:
    """Return the model from which an estimator starts.

    The parameters under ``start`` are free with their priors, those under ``held`` are fixed.

    Raises
    ------
    DeclarationError : a derivative is neither under ``start`` nor under ``held``, or a name is
        unknown.
    """
    if estimation.own is not None:
        return own_declared(estimation, noise_std)
    kind = _kind(estimation)
    place = f"estimation {estimation.name}"
    values = {**{name: start.value for name, start in estimation.start.items()}, **estimation.held}
    _only_declared(estimation, kind, values, place)
    # States of effects have no place among the initial states of the equations.
    initial = {
        name: start.value
        for name, start in estimation.initial.items()
        if name in _NAMES[kind].states
    }
    model = model_from_constants(kind, constants, values, modes=estimation.modes, initial=initial)
    free = model.parameters.only_free(estimation.start).with_prior(
        {name: start.std for name, start in estimation.start.items()}
    )
    states = {signal.name: signal for signal in model.equations.states}
    for effect in model.effects:
        if isinstance(effect, DynamicsEffect):
            states |= {signal.name: signal for signal in effect.states}
    for name in estimation.initial:
        if name not in states:
            raise DeclarationError(
                f"there is no state {name!r}",
                where=f"{place}, key initial",
                remedy=f"its states are {', '.join(states)}",
            )
    start = _initial_states(model, estimation.initial, place)
    return replace(
        model,
        parameters=free,
        initial=start,
        noise=Noise(dict(noise_std), dict(estimation.process_noise)),
    )


def declared_for(
    scenario: Scenario, estimation: Estimation, flight: FlightPlan | None = None
) -> Model:
    """Return ``declared_model`` with the constants and noise levels of a scenario.

    ``flight``: flight whose vehicle gives the constants; None: that of the scenario.
    """
    return declared_model(
        estimation,
        flight_constants(flight or scenario.flight, estimation),
        assumed_noise(scenario, estimation),
    )


def assumed_noise(scenario: Scenario, estimation: Estimation) -> dict[str, float]:
    """Return the noise levels that an estimation assumes: its own, else those of the sensors."""
    return {**scenario.flight.noise_std, **estimation.flown_noise_std, **estimation.noise_std}


def condensed_values(flight: FlightPlan, estimation: Estimation) -> Mapping[str, float]:
    """Return the coefficients that a model with fewer elastic modes should find, SI, by name.

    They include the quasi-static part of the modes that the model lacks.
    """
    values = flown_vehicle(flight).values
    return condense_above(values, flight.modes, min(estimation.modes, flight.modes))


def vehicle_constants(
    estimation: Estimation, vehicle: str, frequency_factor: float = 1.0
) -> dict[str, float]:
    """Return the constants of a built-in vehicle that an estimator may use, without derivatives.

    Empty for a user model, which declares its constants itself.
    """
    if estimation.own is not None:
        return {}
    data = with_frequency_factor(read_parameter_set(vehicle), frequency_factor)
    names = list(_NAMES[_kind(estimation)].constants)
    names += [
        mode_parameter(local, i) for i in range(1, estimation.modes + 1) for local in MODE_CONSTANTS
    ]
    return {name: data[name].value for name in names}


def flight_constants(flight: FlightPlan, estimation: Estimation) -> dict[str, float]:
    """Return ``vehicle_constants`` of the flight's vehicle."""
    return vehicle_constants(estimation, flight.vehicle, flight.frequency_factor)


def compiled(estimation: Estimation, model: Model) -> System:
    """Return the System of a model for the estimation's method and outputs."""
    if estimation.method in ("output-error", "filter-error"):
        return biased_system(estimation, model)
    return compile_model(model, estimation.outputs, online=estimation.method in FILTERS)


def biased_system(estimation: Estimation, model: Model) -> System:
    """Return the System of a model for a whole-record fit, with free sensor biases."""
    if estimation.own is not None:
        biased = own_biases(model, estimation.outputs)
    else:
        is_ballistic = estimation.model == "ballistic"
        biased = [name for name in estimation.outputs if not (is_ballistic and name == "altitude")]
    return compile_model(model.with_biases(biased), estimation.outputs)


def _longest_step(estimation: Estimation) -> float:
    """Return the longest integration step of a fit of whole records, s.

    The step of a user model, which may be much slower than an aircraft, is ``max_step``.
    """
    declared = estimation.own is not None and math.isfinite(estimation.max_step)
    return estimation.max_step if declared else min(FIT_STEP, estimation.max_step)


def filter_settings(estimation: Estimation) -> FilterSettings:
    """Return the integration settings and passes of a filter."""
    transition = Taylor(estimation.terms) if estimation.terms else Exponential()
    return FilterSettings(
        STEPS[estimation.integration], transition, estimation.max_step, estimation.passes
    )


def estimate_record(estimation: Estimation, record: Record, model: Model) -> Result:
    """Run an estimation on a record with a declared model."""
    system = compiled(estimation, model)
    if estimation.method in FILTERS:
        estimate = _filtered(estimation, record, model)
    elif estimation.method == "output-error":
        from ident.whole_record.layout import FitSettings
        from ident.whole_record.output_error import fit_output_error

        estimate = fit_output_error(
            [record],
            system,
            FitSettings(max_step=_longest_step(estimation), use_priors=estimation.use_priors),
        )
    elif estimation.method == "filter-error":
        from ident.process_noise.filter_error import fit_filter_error
        from ident.whole_record.layout import FitSettings

        settings = FitSettings(max_step=_longest_step(estimation), use_priors=estimation.use_priors)
        without_noise = model.with_noise(replace(model.noise, process_density={}))
        calm = compiled(estimation, without_noise)
        estimate = fit_filter_error([record], system, settings, calm=calm)
    else:
        from ident.regression.equation_error import run_equation_error

        estimate = run_equation_error([record], system)
    return Result(estimation, record, estimate)


def narrowed(model: Model, estimate: Estimate, spread: float) -> Model:
    """Return the model started at an estimate, with priors of at most ``spread`` of its sigmas."""
    std = {
        name: min(model.parameters[name].prior_std, spread * float(sigma))
        for name, sigma in zip(estimate.names, estimate.std, strict=True)
    }
    return replace(
        model, parameters=model.parameters.with_values(estimate.as_dict()).with_prior(std)
    )


def _filtered(estimation: Estimation, record: Record, model: Model) -> Estimate:
    """Return the estimate of a filter after all its passes."""
    if estimation.method == "ukf":
        from ident.filters.ukf import run_ukf as run
    else:
        run = partial(run_ekf, by=ENGINES[estimation.engine].one_pass)
    settings = filter_settings(estimation)
    if math.isinf(estimation.spread):
        return run(record, compiled(estimation, model), settings)
    one_pass = replace(settings, passes=1)
    estimate = run(record, compiled(estimation, model), one_pass)
    for done in range(1, estimation.passes):
        if estimate.outcome is not Outcome.CONVERGED:
            break
        restarted = narrowed(model, estimate, estimation.spread)
        next_estimate = run(record, compiled(estimation, restarted), one_pass)
        change = np.abs(next_estimate.values - estimate.values) / estimate.std
        estimate = replace(next_estimate, iterations=done + 1)
        if np.max(change, initial=0.0) < SETTLED_SIGMAS:
            break
    return estimate


def _kind(estimation: Estimation) -> str:
    """Return the name of an estimation's equations; a flexible aircraft has the rigid ones."""
    return "rigid" if estimation.model == "flexible" else estimation.model


def _only_declared(
    estimation: Estimation, kind: str, values: Mapping[str, float], place: str
) -> None:
    """Raise DeclarationError unless ``values`` has every derivative and no unknown name.

    No default replaces a missing value, since it would be the true one.
    """
    needed = _NAMES[kind].needed
    of_modes = mode_units(estimation.modes)
    modal = [
        name
        for name, _, required in of_modes
        if required and not name.startswith(tuple(MODE_CONSTANTS))
    ]
    known = {*needed, *_NAMES[kind].optional, *(name for name, _, _ in of_modes)}
    for name in (*needed, *modal):
        if name not in values:
            raise DeclarationError(
                f"{name} has no starting value",
                where=f"{place}, key start",
                remedy="give it under start, or under held",
            )
    for name in values:
        if name not in known:
            raise DeclarationError(
                f"there is no parameter {name!r}",
                where=f"{place}, key start",
                remedy=f"use {', '.join(sorted(known))}",
            )
    refuse_held_start(estimation)
    for name in estimation.process_noise:
        if name not in (*estimation.start, *estimation.initial):
            remedy = f"use {', '.join((*estimation.initial, *estimation.start))}"
            raise DeclarationError(
                f"{name!r} is no state and no free parameter",
                where=f"{place}, key process_noise",
                remedy=remedy,
            )


def _initial_states(model: Model, initial: Mapping[str, Start], place: str) -> ParameterSet:
    """Return the initial states of equations and effects with their priors, all free."""
    for signal in model.equations.states:
        if signal.name not in initial:
            raise DeclarationError(
                f"state {signal.name} has no starting value",
                where=f"{place}, key initial",
                remedy="give its value and std",
            )
    states = {item.name: item for item in model.initial}
    items = []
    for effect in model.effects:
        for signal in effect.states if isinstance(effect, DynamicsEffect) else ():
            if signal.name in initial:
                states[signal.name] = replace(
                    model.initial.items[0], name=signal.name, unit=signal.unit, source="declared"
                )
    for name, item in states.items():
        items.append(
            replace(item, value=initial[name].value, prior_std=initial[name].std, free=True)
        )
    return ParameterSet(tuple(items))


# ---- Estimates from many records of one flight

# Batch sizes are multiples of this, so that linear algebra always sums in the same order.
BATCH_MULTIPLE = 8


@dataclass(frozen=True, eq=False)
class Estimates:
    """Estimates of k runs.

    Attributes
    ----------
    names : names of the n parameters.
    values : shape ``(n, k)``.
    covariance : shape ``(k, n, n)``.
    outcomes : outcome code of each run.
    nis : sum of the normalized innovations squared, shape ``(k,)``; zero without a filter.
    degrees : degrees of freedom of ``nis``, shape ``(k,)``; zero without a filter.
    outputs : names of the m outputs.
    noise_std : noise level of each output, assumed or estimated, shape ``(m, k)``.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    outcomes: tuple[str, ...]
    nis: np.ndarray
    degrees: np.ndarray
    outputs: tuple[str, ...]
    noise_std: np.ndarray

    @property
    def std(self) -> np.ndarray:
        """Reported standard deviations, shape ``(n, k)``."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2).T, 0.0))


def is_batched(estimation: Estimation, feedback: bool) -> bool:
    """Return whether runs are estimated as one batch.

    A batch needs the same inputs in all runs; with feedback they differ.
    """
    return estimation.method == "ekf" and not feedback


def one_by_one(estimation: Estimation, records: Sequence[Record], model: Model) -> Estimates:
    """Return the estimates of a method that takes one record at a time."""
    with_batch_engine = replace(estimation, engine="batched")
    estimates = [estimate_record(with_batch_engine, record, model).estimate for record in records]
    histories = [estimate.history for estimate in estimates]
    return Estimates(
        estimates[0].names,
        np.array([estimate.values for estimate in estimates]).T,
        np.array([estimate.covariance for estimate in estimates]),
        tuple(estimate.outcome.code for estimate in estimates),
        np.array([0.0 if history is None else float(history.nis.sum()) for history in histories]),
        np.array([0 if history is None else int(history.degrees.sum()) for history in histories]),
        estimates[0].output_names,
        np.array([estimate.noise_std for estimate in estimates]).T,
    )


def batched(estimation: Estimation, records: Sequence[Record], model: Model) -> Estimates:
    """Return the estimates of many filters as one batch.

    Copies of the first record fill the batch, so that results do not depend on the number of runs.
    """
    count = len(records)
    filled = [*records, *[records[0]] * (-count % BATCH_MULTIPLE)]
    system, settings = compiled(estimation, model), filter_settings(estimation)
    z = np.stack([record.output_array(system.output_names)[0] for record in filled], axis=2)
    degrees = int(records[0].output_array(system.output_names)[1].sum())
    n_x = len(system.states)
    if math.isinf(estimation.spread):
        bank = run_bank(records[0], system, settings, z=z)
        mean, covariance, sound = bank.mean, bank.covariance, bank.sound
        nis = bank.nis.sum(axis=0)
    else:
        bank = run_bank(records[0], system, replace(settings, passes=1), z=z)
        mean, covariance, sound, nis = _narrowed_passes(estimation, records[0], system, bank, z)
    assumed = [[model.noise.measurement_std[name]] * count for name in system.output_names]
    return Estimates(
        bank.names[n_x:],
        mean[n_x:, :count],
        covariance[:count, n_x:, n_x:],
        tuple("converged" if is_sound else "diverged" for is_sound in sound[:count]),
        nis[:count],
        np.full(count, degrees, dtype=int),
        system.output_names,
        np.array(assumed),
    )


def _narrowed_passes(
    estimation: Estimation, record: Record, system: System, bank: BankEstimate, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Repeat the filters of a batch, each from its own estimate with narrowed priors.

    ``bank``: result of the first pass. ``z``: measurements, shape ``(m, N, k)``.

    Returns
    -------
    Means ``(n, k)``, covariances ``(k, n, n)``, success ``(k,)`` and NIS ``(k,)`` of the last pass.
    """
    settings, n_x = replace(filter_settings(estimation), passes=1), len(system.states)
    declared = np.array(
        [
            *(item.prior_std for item in system.initial),
            *(system.parameters[name].prior_std for name in bank.names[n_x:]),
        ]
    )
    first = np.array(system.initial.values())
    mean, covariance = bank.mean.copy(), bank.covariance.copy()
    sound, nis = bank.sound.copy(), bank.nis.sum(axis=0)
    active = np.flatnonzero(sound)
    for _ in range(1, estimation.passes):
        if active.size == 0:
            break
        batch = np.concatenate([active, np.full(-active.size % BATCH_MULTIPLE, active[0])])
        std = np.sqrt(np.maximum(np.diagonal(covariance[batch], axis1=1, axis2=2).T[n_x:], 0.0))
        prior = np.repeat(declared[:, None], batch.size, axis=1)
        prior[n_x:] = np.minimum(prior[n_x:], estimation.spread * std)
        start = np.concatenate([np.repeat(first[:, None], batch.size, axis=1), mean[n_x:, batch]])
        next_bank = run_bank(
            record,
            system,
            settings,
            z=z[:, :, batch],
            start=start,
            covariance=prior.T[:, :, None] ** 2 * np.eye(len(declared)),
        )
        without_filling = slice(0, active.size)
        changes = np.abs(next_bank.mean[n_x:] - mean[n_x:, batch]) / std
        moved = np.max(changes, axis=0, initial=0.0)[without_filling]
        mean[:, active], covariance[active] = (
            next_bank.mean[:, without_filling],
            next_bank.covariance[without_filling],
        )
        sound[active], nis[active] = (
            next_bank.sound[without_filling],
            next_bank.nis.sum(axis=0)[without_filling],
        )
        active = active[next_bank.sound[without_filling] & (moved >= SETTLED_SIGMAS)]
    return mean, covariance, sound, nis
