"""Sweeps of a scenario over structures from stiff to soft: results, criteria, and both as data.

Criteria for when a rigid model fails. The first two detect the structure in a record; the third
compares the error of a rigid model with the noise.

 - whiteness: the residual of the rigid whole-record fit is no longer white (Ljung and Box), at the
  level of all residual tests.
 - likelihood: the Bayesian information criterion (Schwarz 1978) prefers the rigid model with one
  elastic mode to the rigid one, 2 (ln L_mode - ln L_rigid) > k ln n. A model with s states that
  moves alpha and q from one input shows 3 s numbers, whatever parameters it is written in, and has
  s initial states: k = 8 for two more states.
- misfit: the error of the best rigid model exceeds the noise in rms (`sim.vehicles.flexibility`).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.banks.bank import run_bank
from ident.estimate import Outcome
from ident.statistics.residuals import ResidualTest, tests_of_records
from scenarios.studies.declaration import Estimation, FlightPlan, Mark, Scenario, Start
from scenarios.studies.estimating import (
    assumed_noise,
    compiled,
    declared_model,
    estimate_record,
    filter_settings,
    flight_constants,
    flown_vehicle,
    fly_scenario,
)
from scenarios.studies.published import published_values
from sim.declaration.model import Model
from sim.record import Record
from sim.vehicles.flexibility import LARGEST_MISFIT, Flexibility, condense_above, flexibility

# ---- A scenario's flight with structures from stiff to soft


@dataclass(frozen=True, eq=False)
class SweptMethod:
    """Result of one method on one structure: ``values`` and ``std`` ``(n,)`` of ``names``, in SI.

    ``condensed``: expected values by name. ``tests``: of the residual; empty for a filter.
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
        """Return the error against the condensed value: in per cent, and in standard deviations."""
        at, right = self.names.index(name), self.condensed[name]
        off = float(self.values[at]) - right
        return 100.0 * off / abs(right), off / float(self.std[at])


@dataclass(frozen=True, eq=False)
class SweepPoint:
    """Results on one structure; ``samples``: number of measured samples."""

    frequency_factor: float
    figures: Flexibility
    samples: int
    methods: tuple[SweptMethod, ...]


@dataclass(frozen=True, eq=False)
class Sweep:
    """Structures from stiff to soft.

    ``rigid``: true derivatives of the rigid aircraft; ``units``: by parameter; ``marks``: named
    structures with their published values.
    """

    points: tuple[SweepPoint, ...]
    rigid: Mapping[str, float]
    units: Mapping[str, str]
    marks: tuple[tuple[Mark, Mapping[str, Start]], ...]

    def point(self, frequency_factor: float) -> SweepPoint:
        """Return the structure with this frequency factor."""
        return next(point for point in self.points if point.frequency_factor == frequency_factor)


def sweep_flexibility(
    scenario: Scenario,
    record: Record,
    seed: int,
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> Sweep | None:
    """Simulate a scenario with each of its frequency factors, and apply all its methods.

    None without factors. ``record`` is that of the scenario's flight with this ``seed``. All
    structures have the same measurement noise, so that differences are due to the structure.

    Raises
    ------
    FlightidError : a structure that diverges, or whose short period does not oscillate.
    """
    plan = scenario.sweep
    if plan is None:
        return None
    progress("flying", 0.0)
    flights = [
        replace(scenario.flight, frequency_factor=factor) for factor in plan.frequency_factors
    ]
    records = [fly_scenario(replace(scenario, flight=flight), seed)[0] for flight in flights]
    methods = []
    for number, estimation in enumerate(scenario.estimations):
        progress(estimation.label, (1 + number) / (2 + len(scenario.estimations)))
        methods.append(_estimated(scenario, estimation, flights, records))
    figures = [
        flexibility(flown_vehicle(f), record["elevator"].values, 1.0 / f.rate, f.noise_std, f.modes)
        for f in flights
    ]
    count = sum(int(channel.valid.sum()) for channel in record.outputs)
    points = tuple(
        SweepPoint(f.frequency_factor, figures[i], count, tuple(found[i] for found in methods))
        for i, f in enumerate(flights)
    )
    units = {
        item.name: item.unit
        for estimation in scenario.estimations
        for item in _model(scenario, estimation, flights[0]).parameters
    }
    values = flown_vehicle(scenario.flight).values
    marks = tuple(
        (mark, published_values(mark.published, units) if mark.published else {})
        for mark in plan.marks
    )
    return Sweep(points, {name: values[name] for name in figures[0].condensed}, units, marks)


def _model(scenario: Scenario, estimation: Estimation, flight: FlightPlan) -> Model:
    return declared_model(
        estimation, flight_constants(flight, estimation), assumed_noise(scenario, estimation)
    )


def _estimated(
    scenario: Scenario,
    estimation: Estimation,
    flights: Sequence[FlightPlan],
    records: Sequence[Record],
) -> list[SweptMethod]:
    """Return the results of one method on all structures; filters run on all records at once."""
    condensed = [
        condense_above(flown_vehicle(f).values, f.modes, min(estimation.modes, f.modes))
        for f in flights
    ]
    model = _model(scenario, estimation, flights[0])
    if estimation.method == "ekf" and not estimation.modes and math.isinf(estimation.spread):
        system = compiled(estimation, model)
        z = np.stack([record.output_array(system.output_names)[0] for record in records], axis=2)
        bank = run_bank(records[0], system, filter_settings(estimation), z=z)
        first = len(system.states)
        outcomes = [Outcome.CONVERGED if sound else Outcome.DIVERGED for sound in bank.sound]
        columns = zip(
            bank.mean[first:].T,
            bank.std[first:].T,
            outcomes,
            bank.log_likelihood.tolist(),
            condensed,
            strict=True,
        )
        return [SweptMethod(estimation, bank.names[first:], *column) for column in columns]
    found = []
    for flight, record, right in zip(flights, records, condensed, strict=True):
        own = replace(estimation, engine="batched")
        estimate = estimate_record(own, record, _model(scenario, estimation, flight)).estimate
        tests = tests_of_records(estimate, [record])
        numbers = (
            estimate.names,
            estimate.values,
            estimate.std,
            estimate.outcome,
            estimate.log_likelihood,
        )
        found.append(SweptMethod(estimation, *numbers, right, tests))
    return found


# ---- From which degree of flexibility on a rigid model no longer serves

# As in `ident.statistics.residuals`.
WHITENESS_P_VALUE = 1e-3
# Coefficients per state: one in the denominator, one in each of two numerators, an initial state.
NUMBERS_PER_STATE = 3 + 1
FIT = "output-error"


@dataclass(frozen=True)
class Criterion:
    """One criterion along a sweep.

    ``values``: one per point, NaN if unknown. A rigid model fails if the value is above ``limit``,
    or below it if ``below``. ``degree``, ``frequency_factor``: start of the failure, interpolated;
    None if there is none within the sweep.
    """

    name: str
    sentence: str
    limit: float
    below: bool
    values: tuple[float, ...]
    degree: float | None
    frequency_factor: float | None


def criteria_of(points: Sequence[SweepPoint]) -> tuple[Criterion, ...]:
    """Return the criteria that the scenario's methods allow, in the usual order of failure."""
    found = [
        _criterion(
            "likelihood",
            "a model with one elastic mode is likelier (BIC)",
            0.0,
            False,
            points,
            _preference,
        ),
        _criterion(
            "whiteness",
            "the residual of the rigid fit is no longer white",
            math.log10(WHITENESS_P_VALUE),
            True,
            points,
            _whiteness,
        ),
        _criterion(
            "misfit",
            "what no rigid model explains exceeds the noise",
            math.log10(LARGEST_MISFIT),
            False,
            points,
            lambda p: math.log10(p.figures.misfit),
        ),
    ]
    return tuple(each for each in found if any(map(math.isfinite, each.values)))


def _criterion(
    name: str,
    sentence: str,
    limit: float,
    below: bool,
    points: Sequence[SweepPoint],
    value: Callable[[SweepPoint], float],
) -> Criterion:
    values = tuple(float(value(point)) for point in points)
    degree = _begins([math.log(point.figures.degree) for point in points], values, limit, below)
    factor = _begins([math.log(point.frequency_factor) for point in points], values, limit, below)
    return Criterion(
        name,
        sentence,
        limit,
        below,
        values,
        None if degree is None else math.exp(degree),
        None if factor is None else math.exp(factor),
    )


def _begins(
    places: Sequence[float], values: Sequence[float], limit: float, below: bool
) -> float | None:
    """Return the interpolated place after which a series stays beyond its limit.

    None if it never does, or is beyond from the first point on.
    """
    beyond = [
        (value < limit) is below and value != limit and math.isfinite(value) for value in values
    ]
    first = next((i for i in range(len(beyond)) if all(beyond[i:])), 0)
    if first == 0:
        return None
    share = (limit - values[first - 1]) / (values[first] - values[first - 1])
    return places[first - 1] + float(np.clip(share, 0.0, 1.0)) * (places[first] - places[first - 1])


def _fit(point: SweepPoint, elastic: bool) -> SweptMethod | None:
    """Return the whole-record fit of the rigid model, or of the one with the fewest modes."""
    fits = [
        each
        for each in point.methods
        if each.estimation.method == FIT and bool(each.estimation.modes) is elastic
    ]
    return min(fits, key=lambda each: each.estimation.modes, default=None)


def _whiteness(point: SweepPoint) -> float:
    """Return log10 of the smallest p value of the channels, with Bonferroni's correction."""
    fit = _fit(point, False)
    tests = (
        [test.p_value for test in fit.tests if test.name == "ljung-box"] if fit is not None else []
    )
    return math.log10(max(min(1.0, len(tests) * min(tests)), 1e-300)) if tests else math.nan


def _preference(point: SweepPoint) -> float:
    """Return the gain in the information criterion of the model with modes over the rigid one."""
    rigid, elastic = _fit(point, False), _fit(point, True)
    if rigid is None or elastic is None:
        return math.nan
    states = 2 * (elastic.estimation.modes - rigid.estimation.modes)
    return 2.0 * (
        elastic.log_likelihood - rigid.log_likelihood
    ) - NUMBERS_PER_STATE * states * math.log(point.samples)


# ---- A sweep for comparison.json

HEADINGS = (
    "frequency_factor",
    "degree",
    "method",
    "parameter",
    "unit",
    "rigid",
    "condensed",
    "estimate",
    "std",
    "error_percent",
    "error_sigmas",
)


def sweep_content(sweep: Sweep) -> dict[str, Any]:
    """Return points from stiff to soft, criteria and named structures; derivatives in SI."""
    criteria = []
    for each in criteria_of(sweep.points):
        told: dict[str, Any] = {
            "name": each.name,
            "sentence": each.sentence,
            "limit": each.limit,
            "fails_below": each.below,
        }
        told["values"] = [
            {"frequency_factor": p.frequency_factor, "value": v}
            for p, v in zip(sweep.points, each.values, strict=True)
            if math.isfinite(v)
        ]
        if each.degree is not None and each.frequency_factor is not None:
            told |= {"degree": each.degree, "frequency_factor": each.frequency_factor}
        criteria.append(told)
    return {
        "rigid": dict(sweep.rigid),
        "points": [_point(point) for point in sweep.points],
        "criteria": criteria,
        "marks": [
            {
                "label": mark.label,
                "frequency_factor": mark.frequency_factor,
                "published": {
                    name: {"value": start.value, "std": start.std}
                    for name, start in printed.items()
                },
            }
            for mark, printed in sweep.marks
        ],
    }


def sweep_csv(sweep: Sweep) -> str:
    """Return the estimates of all structures as CSV; missing values are empty."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADINGS)
    for point in sweep.points:
        for found in point.methods:
            for at, name in enumerate(found.names):
                if name not in found.condensed:
                    continue
                rigid = repr(sweep.rigid[name]) if name in sweep.rigid else ""
                numbers = (
                    found.condensed[name],
                    float(found.values[at]),
                    float(found.std[at]),
                    *found.errors(name),
                )
                label = [
                    repr(point.frequency_factor),
                    repr(point.figures.degree),
                    found.estimation.name,
                    name,
                    sweep.units[name],
                    rigid,
                ]
                writer.writerow([*label, *map(repr, numbers)])
    return text.getvalue()


def _point(point: SweepPoint) -> dict[str, Any]:
    figures = point.figures
    return {
        "frequency_factor": point.frequency_factor,
        "degree": figures.degree,
        "stiffness_loss": figures.stiffness_loss,
        "misfit": figures.misfit,
        "rigid_serves": figures.rigid_serves,
        "condensed": dict(figures.condensed),
        "best_rigid": dict(figures.fitted),
        "methods": {found.estimation.name: _method(found) for found in point.methods},
    }


def _method(found: SweptMethod) -> dict[str, Any]:
    rows = {}
    for at, name in enumerate(found.names):
        if name in found.condensed:
            percent, sigmas = found.errors(name)
            row = {
                "estimate": float(found.values[at]),
                "std": float(found.std[at]),
                "condensed": found.condensed[name],
            }
            rows[name] = {**row, "error_percent": percent, "error_sigmas": sigmas}
    content: dict[str, Any] = {"outcome": found.outcome.code, "parameters": rows}
    return content | (
        {"log_likelihood": found.log_likelihood} if math.isfinite(found.log_likelihood) else {}
    )
