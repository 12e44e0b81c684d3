"""Sweeps of a scenario over structures from stiff to soft: results, and criteria for when a rigid
model fails.

Two criteria detect the structure in a record; the third compares the error of a rigid model with
the noise.

- whiteness: the residual of the rigid whole-record fit is no longer white (Ljung and Box), at the
  level of all residual tests.
- likelihood: the Bayesian information criterion (Schwarz 1978) prefers the rigid model with one
  elastic mode to the rigid one: 2 (ln L_mode - ln L_rigid) > k ln n. A model with s states, one
  input and the outputs alpha and q has 3 s identifiable numbers, in any parametrization, and s
  initial states. So k = 8 for two more states.
- misfit: the rms error of the best rigid model exceeds the noise (`sim.vehicles.flexibility`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.banks.bank import run_bank
from ident.estimate import Outcome
from ident.statistics.residuals import ResidualTest, tests_of_records
from scenarios.files.writing import csv_text
from scenarios.report.document import PURE, Block, Cell, Column, Number, Prose, table
from scenarios.studies.declaration import (
    Estimation,
    FlightPlan,
    Mark,
    Scenario,
    Start,
    published_values,
)
from scenarios.studies.estimating import (
    compiled,
    condensed_values,
    declared_for,
    estimate_record,
    filter_settings,
    flown_vehicle,
    fly_scenario,
)
from sim.record import Record
from sim.vehicles.flexibility import LARGEST_MISFIT, Flexibility, flexibility

# ---- A scenario's flight with structures from stiff to soft


@dataclass(frozen=True, eq=False)
class SweptMethod:
    """Result of one method on one structure.

    Attributes
    ----------
    estimation : the method.
    names : names of the n parameters.
    values, std : estimates and their sigmas, ``(n,)``, SI.
    outcome, log_likelihood : outcome of the estimation and its log likelihood.
    condensed : expected values by name: those with the elastic modes statically condensed.
    tests : tests of the residual; empty for a filter.
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
        i, expected = self.names.index(name), self.condensed[name]
        error = float(self.values[i]) - expected
        return 100.0 * error / abs(expected), error / float(self.std[i])


@dataclass(frozen=True, eq=False)
class SweepPoint:
    """Results on one structure.

    Attributes
    ----------
    frequency_factor : factor on the elastic frequencies.
    figures : numbers on the flexibility of the structure.
    samples : number of measured samples.
    methods : results of the methods.
    """

    frequency_factor: float
    figures: Flexibility
    samples: int
    methods: tuple[SweptMethod, ...]


@dataclass(frozen=True, eq=False)
class Sweep:
    """Results on structures from stiff to soft.

    Attributes
    ----------
    points : results on each structure.
    rigid : true derivatives of the rigid aircraft.
    units : unit of each parameter.
    marks : named structures with their published values.
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

    All structures have the same measurement noise, so that differences are due to the structure.

    Parameters
    ----------
    scenario : the scenario.
    record : record of the scenario's flight with this ``seed``.
    seed : seed of the noise.
    progress : called with the stage and the share done, 0 to 1.

    Returns
    -------
    The results; None if the scenario has no frequency factors.

    Raises
    ------
    FlightidError : a structure diverges, or its short period does not oscillate.
    """
    plan = scenario.sweep
    if plan is None:
        return None
    progress("flying", 0.0)
    flights = [
        replace(scenario.flight, frequency_factor=factor) for factor in plan.frequency_factors
    ]
    records = [fly_scenario(replace(scenario, flight=flight), seed)[0] for flight in flights]
    by_method = []
    for number, estimation in enumerate(scenario.estimations):
        progress(estimation.label, (1 + number) / (2 + len(scenario.estimations)))
        by_method.append(_results(scenario, estimation, flights, records))
    elevator = record["elevator"].values
    figures = [
        flexibility(
            flown_vehicle(flight), elevator, 1.0 / flight.rate, flight.noise_std, flight.modes
        )
        for flight in flights
    ]
    samples = sum(int(channel.valid.sum()) for channel in record.outputs)
    points = tuple(
        SweepPoint(
            flight.frequency_factor, figures[i], samples, tuple(results[i] for results in by_method)
        )
        for i, flight in enumerate(flights)
    )
    units = {
        item.name: item.unit
        for estimation in scenario.estimations
        for item in declared_for(scenario, estimation, flights[0]).parameters
    }
    values = flown_vehicle(scenario.flight).values
    marks = tuple(
        (mark, published_values(mark.published, units) if mark.published else {})
        for mark in plan.marks
    )
    return Sweep(points, {name: values[name] for name in figures[0].condensed}, units, marks)


def _results(
    scenario: Scenario,
    estimation: Estimation,
    flights: Sequence[FlightPlan],
    records: Sequence[Record],
) -> list[SweptMethod]:
    all_condensed = [condensed_values(flight, estimation) for flight in flights]
    model = declared_for(scenario, estimation, flights[0])
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
            all_condensed,
            strict=True,
        )
        return [SweptMethod(estimation, bank.names[first:], *column) for column in columns]
    with_batch_engine = replace(estimation, engine="batched")
    results = []
    for flight, record, condensed in zip(flights, records, all_condensed, strict=True):
        model = declared_for(scenario, estimation, flight)
        estimate = estimate_record(with_batch_engine, record, model).estimate
        tests = tests_of_records(estimate, [record])
        results.append(
            SweptMethod(
                estimation,
                estimate.names,
                estimate.values,
                estimate.std,
                estimate.outcome,
                estimate.log_likelihood,
                condensed,
                tests,
            )
        )
    return results


# ---- Criteria: the degree of flexibility from which a rigid model fails

WHITENESS_P_VALUE = 1e-3  # as in `ident.statistics.residuals`
# Numbers of each state: a coefficient of the denominator, one of each of two numerators, and the
# initial value.
NUMBERS_PER_STATE = 3 + 1
SMALLEST_P_VALUE = 1e-300  # keeps the logarithm finite
FIT = "output-error"  # method of whole-record fits


@dataclass(frozen=True)
class Criterion:
    """One criterion along a sweep.

    Attributes
    ----------
    name, sentence : name and description.
    limit : limit of the criterion.
    below : whether a rigid model fails below the limit; else it fails above.
    values : value on each structure, NaN if unknown.
    degree, frequency_factor : degree of flexibility and frequency factor from which a rigid model
        fails, interpolated; None if there is no such structure within the sweep.
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
    criteria = [
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
            lambda point: math.log10(point.figures.misfit),
        ),
    ]
    return tuple(criterion for criterion in criteria if any(map(math.isfinite, criterion.values)))


def _criterion(
    name: str,
    sentence: str,
    limit: float,
    below: bool,
    points: Sequence[SweepPoint],
    value: Callable[[SweepPoint], float],
) -> Criterion:
    values = tuple(float(value(point)) for point in points)
    log_degrees = [math.log(point.figures.degree) for point in points]
    log_factors = [math.log(point.frequency_factor) for point in points]
    degree = _failure_place(log_degrees, values, limit, below)
    factor = _failure_place(log_factors, values, limit, below)
    return Criterion(
        name,
        sentence,
        limit,
        below,
        values,
        None if degree is None else math.exp(degree),
        None if factor is None else math.exp(factor),
    )


def _failure_place(
    places: Sequence[float], values: Sequence[float], limit: float, below: bool
) -> float | None:
    """Return the interpolated place after which all values are beyond the limit.

    None if there is no such place, or if all values are beyond it.
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
    """Return the whole-record fit of the rigid model or, if ``elastic``, of the model with the
    fewest elastic modes; None if there is none.
    """
    fits = [
        method
        for method in point.methods
        if method.estimation.method == FIT and bool(method.estimation.modes) is elastic
    ]
    return min(fits, key=lambda method: method.estimation.modes, default=None)


def _whiteness(point: SweepPoint) -> float:
    """Return log10 of the smallest p value of the channels, with Bonferroni's correction."""
    fit = _fit(point, False)
    tests = fit.tests if fit is not None else ()
    p_values = [test.p_value for test in tests if test.name == "ljung-box"]
    if not p_values:
        return math.nan
    return math.log10(max(min(1.0, len(p_values) * min(p_values)), SMALLEST_P_VALUE))


def _preference(point: SweepPoint) -> float:
    """Return the advantage of the elastic over the rigid model in the information criterion."""
    rigid, elastic = _fit(point, False), _fit(point, True)
    if rigid is None or elastic is None:
        return math.nan
    states = 2 * (elastic.estimation.modes - rigid.estimation.modes)
    gain = 2.0 * (elastic.log_likelihood - rigid.log_likelihood)
    return gain - NUMBERS_PER_STATE * states * math.log(point.samples)


# ---- Content of comparison.json and of the CSV file

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
    return {
        "rigid": dict(sweep.rigid),
        "points": [_point_content(point) for point in sweep.points],
        "criteria": [
            _criterion_content(criterion, sweep) for criterion in criteria_of(sweep.points)
        ],
        "marks": [
            {
                "label": mark.label,
                "frequency_factor": mark.frequency_factor,
                "published": {
                    name: {"value": start.value, "std": start.std}
                    for name, start in published.items()
                },
            }
            for mark, published in sweep.marks
        ],
    }


def _criterion_content(criterion: Criterion, sweep: Sweep) -> dict[str, Any]:
    content: dict[str, Any] = {
        "name": criterion.name,
        "sentence": criterion.sentence,
        "limit": criterion.limit,
        "fails_below": criterion.below,
        "values": [
            {"frequency_factor": point.frequency_factor, "value": value}
            for point, value in zip(sweep.points, criterion.values, strict=True)
            if math.isfinite(value)
        ],
    }
    if criterion.degree is not None and criterion.frequency_factor is not None:
        content |= {"degree": criterion.degree, "frequency_factor": criterion.frequency_factor}
    return content


def sweep_csv(sweep: Sweep) -> str:
    """Return the estimates of all structures as CSV; missing values are empty."""
    rows = []
    for point in sweep.points:
        for method in point.methods:
            for i, name in enumerate(method.names):
                if name not in method.condensed:
                    continue
                rigid = repr(sweep.rigid[name]) if name in sweep.rigid else ""
                numbers = (
                    method.condensed[name],
                    float(method.values[i]),
                    float(method.std[i]),
                    *method.errors(name),
                )
                labels = [
                    repr(point.frequency_factor),
                    repr(point.figures.degree),
                    method.estimation.name,
                    name,
                    sweep.units[name],
                    rigid,
                ]
                rows.append([*labels, *map(repr, numbers)])
    return csv_text(HEADINGS, rows)


def _point_content(point: SweepPoint) -> dict[str, Any]:
    figures = point.figures
    return {
        "frequency_factor": point.frequency_factor,
        "degree": figures.degree,
        "stiffness_loss": figures.stiffness_loss,
        "misfit": figures.misfit,
        "rigid_serves": figures.rigid_serves,
        "condensed": dict(figures.condensed),
        "best_rigid": dict(figures.fitted),
        "methods": {method.estimation.name: _method_content(method) for method in point.methods},
    }


def _method_content(method: SweptMethod) -> dict[str, Any]:
    parameters = {}
    for i, name in enumerate(method.names):
        if name in method.condensed:
            percent, sigmas = method.errors(name)
            parameters[name] = {
                "estimate": float(method.values[i]),
                "std": float(method.std[i]),
                "condensed": method.condensed[name],
                "error_percent": percent,
                "error_sigmas": sigmas,
            }
    content: dict[str, Any] = {"outcome": method.outcome.code, "parameters": parameters}
    if math.isfinite(method.log_likelihood):
        content["log_likelihood"] = method.log_likelihood
    return content


# ---- A sweep in tables and sentences

LEAST_LOG_PROBABILITY = -20  # decimal logarithm of the smallest probability that is printed
# Criterion -> heading of its column; empty for none.
CRITERION_HEADINGS = {"likelihood": "BIC gain of a mode", "whiteness": "p(white)", "misfit": ""}


def sweep_blocks(sweep: Sweep) -> list[Block]:
    """Return the tables of criteria and of errors by structure, and sentences on the criteria."""
    criteria, points = criteria_of(sweep.points), sweep.points
    names = {mark.frequency_factor: mark.label for mark, _ in sweep.marks}
    factors: list[Cell] = []
    for point in points:
        factor = point.frequency_factor
        factors.append(Number(factor, shown=f"{factor:g} {names.get(factor, '')}".strip()))
    factor_column = (Column("frequencies", PURE, left=True), factors)
    properties = [point.figures for point in points]
    blocks: list[Block] = [
        table(
            "structures from stiff to soft",
            factor_column,
            (Column("degree", PURE), [Number(item.degree, digits=4) for item in properties]),
            (
                Column("stiffness lost", "%"),
                [Number(100 * item.stiffness_loss, digits=1) for item in properties],
            ),
            (Column("misfit/noise", PURE), [Number(item.misfit, digits=2) for item in properties]),
            *(
                (
                    Column(CRITERION_HEADINGS[criterion.name], PURE),
                    [_criterion_cell(criterion.name, value) for value in criterion.values],
                )
                for criterion in criteria
                if CRITERION_HEADINGS[criterion.name]
            ),
        )
    ]
    for number, method in enumerate(points[0].methods):
        title = (
            f"{method.estimation.label}: error against the condensed derivatives in % (in standard "
            "deviations)"
        )
        columns = [
            (
                Column(name, "%", printed=name),
                [_error_cell(point, number, name) for point in points],
            )
            for name in sweep.rigid
            if name in method.names
        ]
        blocks.append(table(title, factor_column, *columns))
    return [*blocks, *(Prose(criterion_sentence(criterion, sweep)) for criterion in criteria)]


def sweep_phrase(sweep: Sweep) -> str:
    """Return the degree of flexibility from which a rigid model fails each criterion."""
    texts = []
    for criterion in criteria_of(sweep.points):
        if criterion.degree is not None:
            where = f"from {criterion.degree:.3g} on"
        elif _fails_first(criterion):
            where = "on every structure"
        else:
            where = "on none"
        texts.append(f"{criterion.name} {where}")
    return f"degree of flexibility from which a rigid model fails: {', '.join(texts)}"


def _fails_first(criterion: Criterion) -> bool:
    """Return whether a rigid model fails the criterion on the stiffest structure."""
    if criterion.below:
        return criterion.values[0] < criterion.limit
    return criterion.values[0] > criterion.limit


def criterion_sentence(criterion: Criterion, sweep: Sweep) -> str:
    """Return a sentence on the structure from which a rigid model fails the criterion."""
    if criterion.degree is None or criterion.frequency_factor is None:
        where = "on none of the sweep, or not from one on"
        if _fails_first(criterion):
            where = "on every structure of the sweep"
        return f"{criterion.sentence}: {where}"
    first, last = sweep.points[0].figures.degree, sweep.points[-1].figures.degree
    where = (
        f"from a degree of flexibility of {criterion.degree:.3g} on (frequencies by "
        f"{criterion.frequency_factor:.3g})"
    )
    return f"{criterion.sentence} {where}; the sweep goes from {first:.2g} to {last:.2g}"


def _criterion_cell(name: str, value: float) -> Cell:
    """Return the value of a criterion; that of whiteness is the logarithm of a probability."""
    if name != "whiteness":
        return Number(value, digits=0)
    probability = 10.0**value
    text = f"{probability:.2g}" if value > LEAST_LOG_PROBABILITY else f"< 1e{LEAST_LOG_PROBABILITY}"
    return Number(probability, shown=text)


def _error_cell(point: SweepPoint, method: int, name: str) -> Cell:
    percent, sigmas = point.methods[method].errors(name)
    return Number(percent, shown=f"{percent:+.1f} ({sigmas:+.1f})")
