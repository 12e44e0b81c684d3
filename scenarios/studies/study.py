"""Runs a scenario: fly, estimate by every method it names, compare with truth, condensation and print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.flying_qualities.levels import ModeLevel, mode_levels
from ident.flying_qualities.modes import characteristics, modal_estimate
from ident.statistics.residuals import ResidualTest, residual_tests
from scenarios.files.own_models import moves_about_rest
from scenarios.studies.declaration import EMPTY, Estimation, Scenario, seen_by
from scenarios.studies.determination.determine import MethodDetermination, determine
from scenarios.studies.estimating import Result, assumed_noise, compiled, declared_model, estimate_record, flight_constants
from scenarios.studies.flying import flown_vehicle, fly_scenario, measured_again, true_model
from scenarios.studies.notes import prior_note, residual_note
from scenarios.studies.published import published_values
from scenarios.studies.repeated import Scatter
from scenarios.studies.rows import Row
from scenarios.studies.sweep.sweep import Sweep
from sim.errors import ModelError
from sim.record import Record
from sim.truth.flight import Truth
from sim.vehicles.flexibility import Flexibility, condense_above, flexibility


@dataclass(frozen=True, eq=False, repr=False)
class MethodResult:
    """What one method found; ``truth`` of the flight it saw, ``determination`` where the scenario asks for it."""

    result: Result
    rows: tuple[Row, ...]
    derived: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, tuple[float, str]]
    tests: tuple[ResidualTest, ...]
    levels: tuple[ModeLevel, ...] = ()
    truth: Truth | None = None
    determination: MethodDetermination | None = None

    def __repr__(self) -> str:
        return f"<MethodResult {self.estimation.name}: {self.result.estimate!r}>"

    @property
    def estimation(self) -> Estimation:
        return self.result.estimation


@dataclass(frozen=True, eq=False, repr=False)
class Study:
    """A scenario that has been run; the main method's result first. ``repeated`` are its repeated flights, ``sweep`` its structures from stiff
    to soft, where they were flown."""

    scenario: Scenario
    seed: int
    record: Record
    truth: Truth
    methods: tuple[MethodResult, ...]
    notes: tuple[str, ...] = ()
    flexibility: Flexibility | None = None
    repeated: tuple[Scatter, ...] = ()
    sweep: Sweep | None = None

    def __repr__(self) -> str:
        return f"<Study {self.scenario.name}, seed {self.seed}: {', '.join(method.estimation.name for method in self.methods)}>"

    @property
    def main(self) -> MethodResult:
        return self.methods[0]


def run_scenario(scenario: Scenario, seed: int | None = None) -> Study:
    """Simulate, estimate and compare; the same seed gives the same numbers.

    Raises
    ------
    FlightidError : the scenario declares something that cannot be flown or estimated.
    """
    chosen = scenario.seed if seed is None else seed
    record, truth = fly_scenario(scenario, chosen)
    methods = []
    for estimation in scenario.estimations:
        flown = seen_by(scenario, estimation)
        seen, actual = (record, truth) if flown is scenario else fly_scenario(flown, chosen, f"method {estimation.name}, key flight")
        seen = measured_again(seen, actual, estimation.flown_noise_std, chosen) if estimation.flown_noise_std else seen
        methods.append(_method(flown, estimation, seen, actual, references(flown, estimation)))
    return Study(scenario, chosen, record, truth, tuple(methods), _notes(scenario, methods), _flexibility(scenario, record))


def references(scenario: Scenario, estimation: Estimation) -> Mapping[str, float]:
    """What an estimation's model should find where the vehicle has more modes than it: condensed coefficients by name, SI."""
    if not scenario.condensed:
        return EMPTY
    values = flown_vehicle(scenario.flight).values
    return condense_above(values, scenario.flight.modes, min(estimation.modes, scenario.flight.modes))


def _flexibility(scenario: Scenario, record: Record) -> Flexibility | None:
    """Of a scenario that is compared with condensed coefficients; None too where the condensed aircraft has no short period."""
    flight = scenario.flight
    if not scenario.condensed or not flight.modes or "elevator" not in record.input_names:
        return None
    try:
        return flexibility(flown_vehicle(flight), record["elevator"].values, 1.0 / flight.rate, flight.noise_std, flight.modes)
    except ModelError:
        return None


def _notes(scenario: Scenario, methods: Sequence[MethodResult]) -> tuple[str, ...]:
    notes = [] if scenario.determination else [prior_note(method.result) for method in methods]
    if scenario.condensed:
        notes += [residual_note(method.result, true_model(seen_by(scenario, method.estimation).flight)) for method in methods]
    return tuple(note for note in notes if note)


def _method(scenario: Scenario, estimation: Estimation, record: Record, truth: Truth, condensed: Mapping[str, float]) -> MethodResult:
    model = declared_model(estimation, flight_constants(scenario.flight, estimation), assumed_noise(scenario, estimation))
    result = estimate_record(estimation, record, model)
    estimate = result.estimate
    units = {name: unit for name, unit in zip(estimate.names, estimate.units, strict=True)}
    published = published_values(estimation.published, units) if estimation.published else {}
    rows = tuple(
        Row(
            name,
            unit,
            float(value),
            float(std),
            truth.parameters[name].value if name in truth.parameters else None,
            condensed.get(name),
            published.get(name),
        )
        for name, unit, value, std in zip(estimate.names, estimate.units, estimate.values, estimate.std, strict=True)
    )
    z, valid = record.output_array(estimate.output_names)
    tests = residual_tests(estimate, np.where(valid, z - estimate.fitted[0], 0.0), valid)
    rests = estimation.model != "ballistic" and moves_about_rest(model)
    own_parameters = estimate.only(model.parameters.names)
    derived = modal_estimate(compiled(estimation, model), own_parameters) if rests else {}
    modes = characteristics(compiled(estimation, model), own_parameters) if scenario.flown is not None else None
    levels = mode_levels(modes, scenario.flown) if modes is not None and scenario.flown is not None else ()
    fixed = {item.name: (item.value, item.unit) for item in model.parameters if not item.free}
    found = determine(estimation, record, model, estimate) if scenario.determination else None
    return MethodResult(result, rows, derived, fixed, tests, levels, truth, found)
