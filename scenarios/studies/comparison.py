"""The file ``comparison.json`` of a study: true, estimated and published values.

Also the explanations that accompany the numbers of a study.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from ident.banks.engines import ENGINES, FilterpyDifferences
from ident.estimate import Estimate, FilterHistory
from ident.flying_qualities.modes import MODAL_UNITS
from ident.statistics.residuals import ResidualTest
from scenarios.files.sources import versions
from scenarios.files.writing import csv_text
from scenarios.report.quantities import AXES
from scenarios.report.summary import levels_content
from scenarios.studies.declaration import (
    Choice,
    Estimation,
    FlightPlan,
    Row,
    Scenario,
    Start,
    published_remark,
)
from scenarios.studies.study import MethodDetermination, MethodResult, Scatter, StudyResult
from scenarios.studies.sweep import sweep_content
from sim.vehicles.flexibility import LARGEST_MISFIT, Flexibility
from sim.vehicles.library import Origin, VehicleData, read_parameter_set

# ---- Explanations that accompany the numbers of a study

HEADING = "chosen for this study [own], not published or published otherwise:"
SEE_PAPERS = (
    "published: estimates and sigmas that the source of this study prints, with the error of each "
    "in its own sigmas; docs/papers.md compares them with the estimates above"
)
CONDENSED = (
    "condensed: the value that the derivative has in the fitted model if all modes that the model "
    "lacks follow their loads at once; errors are against this value"
)
DISTANCES = {  # values of the scenario's key ``distance``
    "same equations and step": "same equations, computed with the same steps",
    "same equations, finer step": (
        "same equations; the motion of the flight is computed more exactly than that of the model"
    ),
    "same equations, other values": "same equations with other values of the parameters",
    "effect missing": "the model lacks an effect that acts in flight",
    "nothing missing": "the model lacks nothing",
}
# Origins of numbers of a published aircraft that need a note.
STATED_ORIGINS = (Origin.OWN, Origin.REMEMBERED, Origin.CONVERTED)
_MODAL = re.compile(
    r"(?:omega|zeta|generalized_mass|CL_eta|CL_etadot|Cm_eta|Cm_etadot|Ceta)(\d+)(?:_|$)"
)


def reference_lines(rows: Sequence[Row], estimation: Estimation) -> list[str]:
    """Return explanations of condensed and of published values, if a table has them."""
    explanations = []
    if any(row.condensed is not None for row in rows):
        explanations.append(CONDENSED)
    if estimation.published is not None:
        explanations.append(SEE_PAPERS)
    return explanations


def distance_text(distance: str) -> str:
    """Return the difference between the flight and the model that is fitted, in words."""
    return DISTANCES.get(distance, distance)


def choice_lines(choices: Sequence[Choice]) -> list[str]:
    """Return a line for each choice, with key, value and reason."""
    return [f"{choice.key} = {choice.value}: {choice.reason}" for choice in choices]


def choices_content(choices: Sequence[Choice]) -> dict[str, dict[str, str]]:
    """Return the choices for a JSON file, by key."""
    return {choice.key: {"value": choice.value, "reason": choice.reason} for choice in choices}


def vehicle_origins(flight: FlightPlan) -> dict[str, list[str]]:
    """Return the numbers of a built-in vehicle that its source does not print, by origin.

    Numbers of elastic modes are only counted.
    """
    if flight.own is not None:
        return {}
    data = read_parameter_set(flight.vehicle)
    return {
        origin.words: names for origin in STATED_ORIGINS if (names := _names(data, origin, flight))
    }


def _names(data: VehicleData, origin: Origin, flight: FlightPlan) -> list[str]:
    """Return the numbers of an origin: rigid-body names, and counts as ``"11 of mode 2"``."""
    rigid, modal = [], Counter[int]()
    for number in data.numbers:
        mode = _MODAL.match(number.name)
        if number.origin is origin and mode is None:
            rigid.append(number.name)
        elif number.origin is origin and mode is not None and int(mode[1]) <= flight.modes:
            modal[int(mode[1])] += 1
    return [name for name in rigid if name not in flight.derivatives] + [
        f"{count} of mode {mode}" for mode, count in sorted(modal.items())
    ]


def vehicle_line(flight: FlightPlan) -> str:
    """Return a line on numbers of the vehicle that its source does not print as they are flown.

    Empty if there are none.
    """
    texts = [f"{', '.join(names)} ({words})" for words, names in vehicle_origins(flight).items()]
    texts += [
        f"{name} flies with {flies}, printed {printed}"
        for name, (flies, printed) in misprints(flight).items()
    ]
    if not texts:
        return ""
    return f"numbers of {flight.vehicle} that its source does not give as flown: {'; '.join(texts)}"


def misprints(flight: FlightPlan) -> dict[str, tuple[str, str]]:
    """Return, for each number that differs from the paper, the value that flies and the printed
    value.
    """
    if flight.own is not None:
        return {}
    modes = [
        (number, _MODAL.match(number.name))
        for number in read_parameter_set(flight.vehicle).numbers
        if number.printed_by_paper
    ]
    return {
        number.name: (number.printed, number.printed_by_paper)
        for number, mode in modes
        if mode is None or int(mode[1]) <= flight.modes
    }


def other_flight(scenario: Scenario, estimation: Estimation) -> Mapping[str, Any]:
    """Return the values by which an estimation's flight differs from the scenario's, SI, by key.

    Empty if the estimation uses the flight of the scenario.
    """
    if estimation.flight is None:
        return {}
    pairs = (
        (item.name, getattr(scenario.flight, item.name), getattr(estimation.flight, item.name))
        for item in fields(FlightPlan)
    )
    return {name: changed for name, declared, changed in pairs if changed != declared}


def other_flight_line(scenario: Scenario, estimation: Estimation) -> str:
    """Return a line on the own flight of an estimation; empty if it has none."""
    if estimation.flight is None:
        return ""
    changed = "; ".join(
        f"{name} {_worded(name, value)}"
        for name, value in other_flight(scenario, estimation).items()
    )
    distance = distance_text(estimation.distance or scenario.distance)
    return f"its own flight: {changed}; flight and model: {distance}"


def _worded(name: str, value: Any) -> str:
    """Return a value of a flight with its unit; ``name``: its key."""
    unit = {"duration": " s", "step": " s", "rate": " Hz"}.get(name, "")
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {entry:.4g}" for key, entry in value.items()) + " (SI)"
    if isinstance(value, tuple):
        return ", ".join(f"{plan.kind} of {plan.input}" for plan in value)
    return f"{value:g}{unit}" if isinstance(value, float) else str(value)


# ---- What records and priors determine

HEADINGS = (
    "method",
    "parameter",
    "prior_std",
    "std",
    "std_over_prior",
    "share_from_prior",
    "claimed_std",
)
MOST_WRITTEN_PARTS = 6  # largest parts of a direction, which are written


def determination_content(method: MethodDetermination) -> dict[str, Any]:
    """Return what record and priors determine, as content of a JSON file.

    A direction is a combination of parameters that the record determines by itself, with its
    strength.
    """
    found = method.found
    return {
        "parameters_estimated": len(found.names),
        "numbers_determined": found.effective,
        "directions_determined": found.determined,
        "directions_unseen": found.unseen,
        "strengths": found.strengths.tolist(),
        "directions": [
            {
                "strength": float(found.strengths[at]),
                "parts": dict(found.composition(at, MOST_WRITTEN_PARTS)),
            }
            for at in range(len(found.names) - found.unseen)
        ],
        "parameters": {
            name: {
                "prior_std": float(prior),
                "std": float(std),
                "share_from_prior": float(share),
                "claimed_std": float(claimed),
            }
            for name, prior, std, share, claimed in _rows(method)
        },
        "overclaimed": list(method.overclaimed),
    }


def history_csv(history: FilterHistory, outputs: Sequence[str]) -> str:
    """Return states and parameters with sigmas, and innovations, of each sample as CSV."""
    columns: dict[str, np.ndarray] = {"time": history.time}
    for name, mean, std in zip(history.names, history.mean, history.std, strict=True):
        columns |= {name: mean, f"std_{name}": std}
    for name, value, std in zip(outputs, history.innovation, history.innovation_std, strict=True):
        columns |= {f"innovation_{name}": value, f"std_innovation_{name}": std}
    return columns_csv(columns)


def columns_csv(columns: Mapping[str, np.ndarray]) -> str:
    """Return named columns as CSV, with nine significant digits."""
    rows = np.array(list(columns.values())).T.tolist()
    return csv_text(columns, ([f"{value:.9g}" for value in row] for row in rows))


def determination_csv(methods: Sequence[MethodDetermination]) -> str:
    """Return the determination of all methods as CSV, one row per parameter."""
    rows = (
        [method.estimation.name, name, *map(repr, map(float, (prior, std, std / prior, *shares)))]
        for method in methods
        for name, prior, std, *shares in _rows(method)
    )
    return csv_text(HEADINGS, rows)


def _rows(
    method: MethodDetermination,
) -> list[tuple[str, np.float64, np.float64, np.float64, np.float64]]:
    """Return name, prior and posterior sigma, prior share and claimed sigma by parameter."""
    found = method.found
    return list(
        zip(
            found.names,
            found.prior_std,
            found.posterior_std,
            found.prior_share,
            method.claimed,
            strict=True,
        )
    )


# ---- The engine of a study's filters

UNSCENTED = "filterpy UnscentedKalmanFilter"


def engine_label(estimation: Estimation) -> str:
    """Return the engine of a filter in words; empty for other methods."""
    if estimation.method == "ukf":
        return UNSCENTED
    return ENGINES[estimation.engine].label if estimation.method == "ekf" else ""


def engine_line(estimations: Sequence[Estimation]) -> str:
    """Return a line such as ``engine: filterpy ExtendedKalmanFilter``; empty without a filter.

    If there are several engines, each has its methods.
    """
    methods: dict[str, list[str]] = {}
    for estimation in estimations:
        if label := engine_label(estimation):
            methods.setdefault(label, []).append(estimation.name)
    if len(methods) > 1:
        texts = [f"{label} ({', '.join(names)})" for label, names in methods.items()]
    else:
        texts = list(methods)
    return f"engine: {'; '.join(texts)}" if texts else ""


def engine_content(estimation: Estimation) -> dict[str, Any]:
    """Return the key ``engine`` of a filter with its content; empty for other methods."""
    label = engine_label(estimation)
    name = "filterpy" if estimation.method == "ukf" else estimation.engine
    return {"engine": {"name": name, "sentence": label}} if label else {}


def bank_line(name: str, second: FilterpyDifferences | None) -> str:
    """Return the line on the engine of a bank of delays, with its difference from filterpy."""
    return f"engine: {bank_sentence(name, second)}"


def bank_sentence(name: str, second: FilterpyDifferences | None) -> str:
    """Return the text after ``engine:`` for a bank of delays."""
    label = ENGINES[name].label
    if second is None:
        return label if name == "filterpy" else f"{label}; no sound filter to compare with filterpy"
    return (
        f"{label}; equals filterpy to {second.sigmas:.0e} sigma on the filter at "
        f"{second.delay:.4g} s"
    )


def bank_content(name: str, second: FilterpyDifferences | None) -> dict[str, Any]:
    """Return the content of the key ``engine`` for a bank of delays.

    Differences of means and standard deviations from filterpy are in sigmas.
    """
    content: dict[str, Any] = {"name": name, "sentence": bank_sentence(name, second)}
    if second is not None:
        content["against_filterpy"] = {
            "delay": second.delay,
            "largest_sigmas": second.sigmas,
            "mean_sigmas": second.mean,
            "std_sigmas": second.std,
            "log_likelihood_share": second.log_likelihood,
        }
    return content


# ---- Content of the file

SCHEMA = "flightid/comparison/1"
DERIVED_UNITS = {**MODAL_UNITS, "delay": "s"}


def comparison(study: StudyResult) -> dict[str, Any]:
    """Return the content of ``comparison.json`` for a scenario.

    The numbers of the main method stand at the top, those of other methods under ``methods``.
    """
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "scenario": study.scenario.name,
        "title": study.scenario.title,
        "seed": study.seed,
        "distance": study.scenario.distance,
        **method_content(study.main),
        **(
            {"flying_qualities": levels_content(study.main.levels, study.scenario.flown)}
            if study.scenario.flown is not None
            else {}
        ),
        "own": choices_content(study.scenario.choices),
        "vehicle_origins": vehicle_origins(study.scenario.flight),
        "misprints": {
            name: {"flown": flown, "printed": printed}
            for name, (flown, printed) in misprints(study.scenario.flight).items()
        },
        "notes": list(study.notes),
        "versions": versions(),
    }
    if study.scenario.files:
        files = study.scenario.files
        content["inputs"] = {
            "models": [file.name for file in files],
            "models_sha256": [file.sha256 for file in files],
        }
    if study.flexibility is not None:
        content["flexibility"] = flexibility_content(study.flexibility)
    if study.sweep is not None:
        content["sweep"] = sweep_content(study.sweep)
    if study.repeated:
        content["repeated"] = [_repeated(scatter) for scatter in study.repeated]
    if len(study.methods) > 1:
        content["methods"] = {
            method.estimation.name: method_content(method) | _differences(study, method)
            for method in study.methods[1:]
        }
    return content


def _differences(study: StudyResult, method: MethodResult) -> dict[str, Any]:
    """Return the choices of a method, and its own flight if it has one, SI."""
    estimation, flight = method.estimation, method.estimation.flight
    differences: dict[str, Any] = {}
    if estimation.choices:
        differences["own"] = choices_content(estimation.choices)
    if flight is not None:
        changed = {
            name: value
            for name, value in other_flight(study.scenario, estimation).items()
            if name != "maneuvers"
        }
        differences["flight"] = changed
        differences["distance"] = estimation.distance or study.scenario.distance
    return differences


def flexibility_content(found: Flexibility) -> dict[str, Any]:
    """Return the degree of flexibility, its threshold and the numbers behind it.

    Frequencies are in rad/s, derivatives in 1/rad.
    """
    content: dict[str, Any] = {
        "degree": found.degree,
        "short_period": found.short_period,
        "stiffness_loss": found.stiffness_loss,
        "distance": found.distance,
        "misfit": found.misfit,
        "largest_misfit": LARGEST_MISFIT,
        "detectable_misfit": found.detectable,
        "rigid_serves": found.rigid_serves,
        "condensed": dict(found.condensed),
        "best_rigid": dict(found.fitted),
    }
    return content | ({"separation": found.separation} if math.isfinite(found.separation) else {})


def _repeated(scatter: Scatter) -> dict[str, Any]:
    """Return the errors of an estimator over repeated runs; no derivatives if no run converged."""
    share, interval = scatter.within_two
    table = zip(scatter.names, scatter.units, scatter.rms, scatter.rms_sigmas, strict=True)
    parameters = {
        name: {"rms_error": float(rms), "rms_error_sigmas": float(sigmas), "unit": unit}
        for name, unit, rms, sigmas in table
    }
    return {
        "flight": scatter.flight,
        "method": scatter.estimation.name,
        "outcomes": dict(scatter.outcomes),
        "within_two_sigma": share,
        "interval": list(interval),
        "parameters": parameters if scatter.errors.shape[1] else {},
    }


def method_content(method: MethodResult) -> dict[str, Any]:
    """Return the parameters, derived quantities, outcome and tests of one method."""
    content = estimate_content(
        method.result.estimate, method.rows, method.derived, method.fixed, method.tests
    )
    content["method"] = method.estimation.method
    content |= engine_content(method.estimation)
    if method.determination is not None:
        content["determination"] = determination_content(method.determination)
    if method.estimation.explanation:
        content["explanation"] = method.estimation.explanation
    remark = published_remark(method.estimation.published)
    return content | ({"published_remark": remark} if remark else {})


def estimate_content(
    estimate: Estimate,
    rows: tuple[Row, ...],
    derived: Mapping[str, tuple[float, float]],
    fixed: Mapping[str, tuple[float, str]],
    tests: tuple[ResidualTest, ...],
) -> dict[str, Any]:
    """Return the content common to comparisons of scenarios and to identifications."""
    correlation = estimate.correlation
    return {
        "parameters": {row.name: _row(row) for row in rows},
        "fixed": {name: {"value": value, "unit": unit} for name, (value, unit) in fixed.items()},
        "derived": {
            name: {"estimate": value, "std": std, "unit": DERIVED_UNITS[name]}
            for name, (value, std) in derived.items()
        },
        "outcome": estimate.outcome.code,
        "outcome_sentence": estimate.outcome.value,
        **(
            {"log_likelihood": estimate.log_likelihood}
            if math.isfinite(estimate.log_likelihood)
            else {}
        ),
        "noise_std": {
            name: float(std)
            for name, std in zip(estimate.output_names, estimate.noise_std, strict=True)
        },
        "correlation": {
            a: {b: float(correlation[i, j]) for j, b in enumerate(estimate.names)}
            for i, a in enumerate(estimate.names)
        },
        "residual_tests": [_test(test) for test in tests],
        "iterations": estimate.iterations,
    }


def in_unit(row: Row, unit: str) -> Row:
    """Return a row in another unit, such as beta in lb/ft2."""
    from scenarios.files.units import to_si
    from sim.errors import DeclarationError

    factor = 1.0 / float(to_si(1.0, unit, row.unit, f"key display.{row.name}", DeclarationError))
    published = (
        None
        if row.published is None
        else Start(row.published.value * factor, row.published.std * factor)
    )
    return replace(
        row,
        unit=unit,
        estimate=row.estimate * factor,
        std=row.std * factor,
        true=None if row.true is None else row.true * factor,
        condensed=None if row.condensed is None else row.condensed * factor,
        published=published,
    )


def check_display(study: StudyResult) -> None:
    """Raise DeclarationError for an impossible unit under ``display``, before files are written."""
    from sim.errors import DeclarationError

    rows = {row.name: row for method in study.methods for row in method.rows}
    for name, unit in study.scenario.display.items():
        if name not in rows:
            raise DeclarationError(
                f"no parameter {name!r} is estimated",
                where=f"key display.{name}",
                remedy=f"use one of {', '.join(rows)}",
            )
        in_unit(rows[name], unit)


def _row(row: Row) -> dict[str, Any]:
    content: dict[str, Any] = {"estimate": row.estimate, "std": row.std, "unit": row.unit}
    for key, value in (
        ("true", row.true),
        ("condensed", row.condensed),
        ("error_percent", row.percent),
        ("error_sigmas", row.sigmas),
    ):
        if value is not None:
            content[key] = value
    if row.published is not None:
        content["published"] = {"value": row.published.value, "std": row.published.std}
    return content


def _test(test: ResidualTest) -> dict[str, Any]:
    return {
        "name": test.name,
        "channel": test.channel,
        **({"axis": AXES[test.channel]} if test.channel in AXES else {}),
        "statistic": test.statistic,
        "p_value": test.p_value,
        "passed": test.passed,
        "sentence": test.sentence,
    }
