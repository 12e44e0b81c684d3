"""The comparison file: true, estimated and published values as strict JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ident.estimate import Estimate
from ident.flying_qualities.modes import MODAL_UNITS
from ident.statistics.residuals import ResidualTest
from scenarios.files.versions import versions
from scenarios.studies.declaration import Start
from scenarios.studies.departures import choices_content, misprints, other_flight, vehicle_origins
from scenarios.studies.determination.content import determination_content
from scenarios.studies.engines import engine_content
from scenarios.studies.published import published_remark
from scenarios.studies.repeated import Scatter
from scenarios.studies.rows import Row
from scenarios.studies.study import MethodResult, Study
from scenarios.studies.sweep.content import sweep_content
from scenarios.terminal.flying_qualities import levels_content
from scenarios.terminal.quantities import AXES
from sim.vehicles.flexibility import LARGEST_MISFIT, Flexibility

SCHEMA = "flightid/comparison/1"
DERIVED_UNITS = {**MODAL_UNITS, "delay": "s"}


def comparison(study: Study) -> dict[str, Any]:
    """Content of ``comparison.json`` for a scenario: the main method's figures, the others under ``methods``."""
    out: dict[str, Any] = {
        "schema": SCHEMA,
        "scenario": study.scenario.name,
        "title": study.scenario.title,
        "seed": study.seed,
        "distance": study.scenario.distance,
        **method_content(study.main),
        **({"flying_qualities": levels_content(study.main.levels, study.scenario.flown)} if study.scenario.flown is not None else {}),
        "own": choices_content(study.scenario.choices),
        "vehicle_origins": vehicle_origins(study.scenario.flight),
        "misprints": {name: {"flown": flown, "printed": printed} for name, (flown, printed) in misprints(study.scenario.flight).items()},
        "notes": list(study.notes),
        "versions": versions(),
    }
    if study.scenario.files:
        files = study.scenario.files
        out["inputs"] = {"models": [file.name for file in files], "models_sha256": [file.sha256 for file in files]}
    if study.flexibility is not None:
        out["flexibility"] = flexibility_content(study.flexibility)
    if study.sweep is not None:
        out["sweep"] = sweep_content(study.sweep)
    if study.repeated:
        out["repeated"] = [_repeated(each) for each in study.repeated]
    if len(study.methods) > 1:
        out["methods"] = {method.estimation.name: method_content(method) | _departures(study, method) for method in study.methods[1:]}
    return out


def _departures(study: Study, method: MethodResult) -> dict[str, Any]:
    """Choices of a method, and the flight that it alone saw (SI)."""
    estimation, flight = method.estimation, method.estimation.flight
    out: dict[str, Any] = {"own": choices_content(estimation.choices)} if estimation.choices else {}
    if flight is not None:
        changed = {name: value for name, value in other_flight(study.scenario, estimation).items() if name != "maneuvers"}
        out |= {"flight": changed, "distance": estimation.distance or study.scenario.distance}
    return out


def flexibility_content(found: Flexibility) -> dict[str, Any]:
    """The degree of flexibility, its threshold and what it stands on; frequencies in rad/s, derivatives in 1/rad."""
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


def _repeated(each: Scatter) -> dict[str, Any]:
    """One estimator's errors over the runs of one flight; derivatives are left out where no run settled."""
    share, interval = each.within_two
    table = zip(each.names, each.units, each.rms, each.rms_sigmas, strict=True)
    known = {name: {"rms_error": float(rms), "rms_error_sigmas": float(sigmas), "unit": unit} for name, unit, rms, sigmas in table}
    return {
        "flight": each.flight,
        "method": each.estimation.name,
        "outcomes": dict(each.outcomes),
        "within_two_sigma": share,
        "interval": list(interval),
        "parameters": known if each.errors.shape[1] else {},
    }


def method_content(method: MethodResult) -> dict[str, Any]:
    """Parameters, derived quantities, outcome and tests of one method."""
    content = estimate_content(method.result.estimate, method.rows, method.derived, method.fixed, method.tests)
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
    """The parts that a scenario's comparison and an identification share."""
    correlation = estimate.correlation
    return {
        "parameters": {row.name: _row(row) for row in rows},
        "fixed": {name: {"value": value, "unit": unit} for name, (value, unit) in fixed.items()},
        "derived": {name: {"estimate": value, "std": std, "unit": DERIVED_UNITS[name]} for name, (value, std) in derived.items()},
        "outcome": estimate.outcome.code,
        "outcome_sentence": estimate.outcome.value,
        **({"log_likelihood": estimate.log_likelihood} if math.isfinite(estimate.log_likelihood) else {}),
        "noise_std": {name: float(std) for name, std in zip(estimate.output_names, estimate.noise_std, strict=True)},
        "correlation": {a: {b: float(correlation[i, j]) for j, b in enumerate(estimate.names)} for i, a in enumerate(estimate.names)},
        "residual_tests": [_test(test) for test in tests],
        "iterations": estimate.iterations,
    }


def in_unit(row: Row, unit: str) -> Row:
    """The same row in another unit, e.g. beta in lb/ft2."""
    from scenarios.files.units import to_si
    from sim.errors import DeclarationError

    factor = 1.0 / float(to_si(1.0, unit, row.unit, f"key display.{row.name}", DeclarationError))
    published = None if row.published is None else Start(row.published.value * factor, row.published.std * factor)
    return replace(
        row,
        unit=unit,
        estimate=row.estimate * factor,
        std=row.std * factor,
        true=None if row.true is None else row.true * factor,
        condensed=None if row.condensed is None else row.condensed * factor,
        published=published,
    )


def check_display(study: Study) -> None:
    """Refuse a parameter or unit that the scenario wants shown and that cannot be, before anything is written."""
    from sim.errors import DeclarationError

    rows = {row.name: row for method in study.methods for row in method.rows}
    for name, unit in study.scenario.display.items():
        if name not in rows:
            raise DeclarationError(f"no parameter {name!r} is estimated", where=f"key display.{name}", remedy=f"use one of {', '.join(rows)}")
        in_unit(rows[name], unit)


def _row(row: Row) -> dict[str, Any]:
    out: dict[str, Any] = {"estimate": row.estimate, "std": row.std, "unit": row.unit}
    for key, value in (("true", row.true), ("condensed", row.condensed), ("error_percent", row.percent), ("error_sigmas", row.sigmas)):
        if value is not None:
            out[key] = value
    if row.published is not None:
        out["published"] = {"value": row.published.value, "std": row.published.std}
    return out


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
