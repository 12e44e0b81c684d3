"""A scenario's flight with structures from stiff to soft: what each method finds, over the degree of flexibility."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import run_bank
from ident.estimate import Outcome
from ident.statistics.residuals import ResidualTest, residual_tests
from scenarios.studies.declaration import Estimation, Flight, Mark, Scenario, Start
from scenarios.studies.estimating import assumed_noise, compiled, declared_model, estimate_record, filter_settings, flight_constants
from scenarios.studies.flying import flown_vehicle, fly_scenario
from scenarios.studies.published import published_values
from sim.declaration.model import Model
from sim.record import Record
from sim.vehicles.flexibility import Flexibility, condense_above, flexibility


@dataclass(frozen=True, eq=False)
class SweptMethod:
    """What one method found on one structure: ``values`` and ``std`` ``(n,)`` of ``names``, in SI.

    ``condensed``: what its model should find, by name. ``tests`` of its residual: none of a filter, whose estimate alone is kept.
    """

    estimation: Estimation
    names: tuple[str, ...]
    values: np.ndarray
    std: np.ndarray
    outcome: Outcome
    log_likelihood: float
    condensed: Mapping[str, float]
    tests: tuple[ResidualTest, ...] = ()

    def errors(self, name: str) -> tuple[float, float]:
        """Estimate minus condensed value of a parameter, in per cent of the latter and in its own standard deviations."""
        at, right = self.names.index(name), self.condensed[name]
        off = float(self.values[at]) - right
        return 100.0 * off / abs(right), off / float(self.std[at])


@dataclass(frozen=True, eq=False)
class SweepPoint:
    """One structure: the factor on its modal frequencies, its figures of flexibility, samples measured, and every method."""

    frequency_factor: float
    figures: Flexibility
    samples: int
    methods: tuple[SweptMethod, ...]


@dataclass(frozen=True, eq=False)
class Sweep:
    """Structures from stiff to soft.

    ``rigid``: true derivatives of the aircraft without its structure; ``units`` of all parameters; ``marks`` with what is printed of them.
    """

    points: tuple[SweepPoint, ...]
    rigid: Mapping[str, float]
    units: Mapping[str, str]
    marks: tuple[tuple[Mark, Mapping[str, Start]], ...]

    def point(self, frequency_factor: float) -> SweepPoint:
        """The structure of a factor that is in the sweep."""
        return next(point for point in self.points if point.frequency_factor == frequency_factor)


def sweep_flexibility(
    scenario: Scenario, record: Record, seed: int, progress: Callable[[str, float], None] = lambda stage, share: None
) -> Sweep | None:
    """Fly a scenario's flight with each of its frequency factors and estimate it by each of its methods; None where it asks for none.

    ``record`` is that of its own flight with this ``seed``: every structure is measured with the same noise, so that what differs along the
    sweep is the structure's doing.

    Raises
    ------
    FlightidError : a structure that diverges, or whose short period does not oscillate.
    """
    plan = scenario.sweep
    if plan is None:
        return None
    progress("flying", 0.0)
    flights = [replace(scenario.flight, frequency_factor=factor) for factor in plan.frequency_factors]
    records = [fly_scenario(replace(scenario, flight=flight), seed)[0] for flight in flights]
    methods = []
    for number, estimation in enumerate(scenario.estimations):
        progress(estimation.label, (1 + number) / (2 + len(scenario.estimations)))
        methods.append(_estimated(scenario, estimation, flights, records))
    figures = [flexibility(flown_vehicle(f), record["elevator"].values, 1.0 / f.rate, f.noise_std, f.modes) for f in flights]
    count = sum(int(channel.valid.sum()) for channel in record.outputs)
    points = tuple(SweepPoint(f.frequency_factor, figures[i], count, tuple(found[i] for found in methods)) for i, f in enumerate(flights))
    units = {item.name: item.unit for estimation in scenario.estimations for item in _model(scenario, estimation, flights[0]).parameters}
    values = flown_vehicle(scenario.flight).values
    marks = tuple((mark, published_values(mark.published, units) if mark.published else {}) for mark in plan.marks)
    return Sweep(points, {name: values[name] for name in figures[0].condensed}, units, marks)


def _model(scenario: Scenario, estimation: Estimation, flight: Flight) -> Model:
    return declared_model(estimation, flight_constants(flight, estimation), assumed_noise(scenario, estimation))


def _estimated(scenario: Scenario, estimation: Estimation, flights: Sequence[Flight], records: Sequence[Record]) -> list[SweptMethod]:
    """One method on all structures; a filter of a model that they share runs on all records at once."""
    condensed = [condense_above(flown_vehicle(f).values, f.modes, min(estimation.modes, f.modes)) for f in flights]
    model = _model(scenario, estimation, flights[0])
    if estimation.method == "ekf" and not estimation.modes and math.isinf(estimation.spread):
        system = compiled(estimation, model)
        z = np.stack([record.output_array(system.output_names)[0] for record in records], axis=2)
        bank = run_bank(records[0], system, filter_settings(estimation), z=z)
        first, outcomes = len(system.states), [Outcome.CONVERGED if sound else Outcome.DIVERGED for sound in bank.sound]
        columns = zip(bank.mean[first:].T, bank.std[first:].T, outcomes, bank.log_likelihood.tolist(), condensed, strict=True)
        return [SweptMethod(estimation, bank.names[first:], *column) for column in columns]
    found = []
    for flight, record, right in zip(flights, records, condensed, strict=True):
        own = replace(estimation, engine="batched")
        estimate = estimate_record(own, record, _model(scenario, estimation, flight)).estimate
        z, valid = record.output_array(estimate.output_names)
        tests = residual_tests(estimate, np.where(valid, z - estimate.fitted[0], 0.0), valid)
        numbers = (estimate.names, estimate.values, estimate.std, estimate.outcome, estimate.log_likelihood)
        found.append(SweptMethod(estimation, *numbers, right, tests))
    return found
