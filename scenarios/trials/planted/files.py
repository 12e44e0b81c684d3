"""The study folder of a tracing scenario: what the loop was given, what it said, what was true."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from scenarios.diagnosis.report.content import bounded, positive, test_content
from scenarios.diagnosis.report.files import write_diagnosis, write_prediction
from scenarios.diagnosis.tracing import Tracing
from scenarios.files.sources import versions
from scenarios.files.user_models import channel_units
from scenarios.files.writing import study_folder, write_json, write_record
from scenarios.pages.model import Page
from scenarios.plots.formats import USUAL, Formats
from scenarios.trials.planted.flights import write_flown
from scenarios.trials.planted.page import scored_page
from scenarios.trials.planted.study import Scored, TraceStudy

MAIN = "comparison.json"


def write_trace(study: TraceStudy, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write records, vehicle file, diagnosis, truth and ``comparison.json`` (last); returns the folder."""
    dressed = partial(scored_page, study)
    given = partial(_write_records, study)
    return write_trial(study.tracing, given, truth_content(study), trace_comparison(study), folder, figures=figures, dressed=dressed)


def write_trial(
    tracing: Tracing,
    given: Callable[[Path], object],
    truth: dict[str, Any],
    comparison: dict[str, Any],
    folder: str | Path,
    *,
    figures: Formats,
    dressed: Callable[[Page], Page],
) -> Path:
    """Write the diagnosis with what ``dressed`` adds to its page, what was ``given`` to the loop (records and vehicle file), the truth and
    ``comparison.json`` (last); returns the folder."""
    write_diagnosis(tracing, folder, figures=figures, dressed=dressed)
    with study_folder(folder, MAIN) as scratch:
        given(scratch)
        write_json(scratch / "truth.json", truth)
        write_json(scratch / MAIN, comparison)
    return Path(folder)


def _write_records(study: TraceStudy, folder: Path) -> None:
    """All three records, the vehicle file, and the prediction of the third record, ``before_CHANNEL`` and ``after_CHANNEL``."""
    write_flown(study.flown, folder)
    write_record(folder, study.flown.test, "test", simulated=True)
    write_prediction(folder / "test_prediction.csv", study.test.predictions[0])


def truth_content(study: TraceStudy) -> dict[str, Any]:
    """Derivatives, hidden terms, noise and distance."""
    flown = study.flown
    return {
        "schema": "flightid/truth/1",
        "parameters": {row.name: {"value": row.true, "unit": row.unit} for row in study.derivatives},
        "modes": {row.name: {"value": row.true, "unit": row.unit} for row in study.modes if row.true is not None},
        "effects": list(flown.hidden),
        "hidden": {name: dict(values) for name, values in flown.hidden.items()},
        "noise_std": dict(flown.noise_std),
        "distance": study.scenario.distance,
        "step": flown.step,
    }


def trace_comparison(study: TraceStudy) -> dict[str, Any]:
    """Content of ``comparison.json``: the fit with what was found, and under ``methods`` the declared model's."""
    d = study.tracing.diagnosis
    derived = {
        when: {name: {"estimate": bounded(q.value), "std": positive(q.std), "unit": q.unit} for name, q in some.items()}
        for when, some in (("before", d.derived_before), ("after", d.derived_after))
    }
    for when, some in (("before", d.before), ("after", d.after)):
        if "delay" in some:
            derived[when]["delay"] = {"estimate": bounded(some["delay"].value), "std": positive(some["delay"].std), "unit": "s"}
    for row in study.modes:
        of_mode = derived["after"].setdefault(row.name, {"estimate": row.after.value, "std": positive(row.after.std), "unit": row.unit})
        of_mode |= {**_common(row), "error_sigmas": bounded(row.sigmas)}
    before = {
        row.name: {"estimate": row.before.value, "std": positive(row.before.std), **_common(row), "comparable": bounded(row.comparable_before)}
        for row in study.derivatives
        if row.before and row.comparable_before is not None
    }
    return {
        "schema": "flightid/comparison/1",
        "scenario": study.scenario.name,
        "title": study.scenario.title,
        "seed": study.seed,
        "distance": study.scenario.distance,
        "parameters": {row.name: _after(row) for row in (*study.derivatives, *study.effects)},
        "fixed": {item.name: {"value": item.value, "unit": item.unit} for item in study.tracing.model.parameters if not item.free},
        "derived": derived["after"],
        "outcome": d.verdict.value,
        "outcome_sentence": d.verdict.sentence,
        "expected": {"verdicts": list(study.scenario.expect.verdicts), "effects": [list(names) for names in study.scenario.expect.effects]},
        "grade": study.grade.name.lower(),
        "comparable": {"basis": study.basis, "reasons": list(study.reasons)},
        "third_record": _third(study),
        "residual_tests": [test_content(test) for test in d.tests_after],
        "methods": {"declared-model": {"parameters": before, "derived": derived["before"]}},
        "versions": versions(),
    }


def _third(study: TraceStudy) -> dict[str, Any]:
    """Errors before and after on the record that took no part in fitting or in choosing effects, in the channels' units."""
    found, units = study.test, channel_units(study.tracing.model)
    return {
        "record": "test.csv",
        "used_in_fit": False,
        "used_to_choose": False,
        "unit": {name: units.get(name, "") for name in found.predictions[0].channels},
        "before": {"rmse": dict(found.before.rmse)},
        "after": {"rmse": {name: bounded(value) for name, value in found.after.rmse.items()}},
        "noise_std": {name: value for name, value in study.flown.noise_std.items() if name in found.predictions[0].channels},
        "finite": found.finite,
    }


def _after(row: Scored) -> dict[str, Any]:
    return {"estimate": bounded(row.after.value), "std": positive(row.after.std), **_common(row), "error_sigmas": bounded(row.sigmas)}


def _common(row: Scored) -> dict[str, Any]:
    return {
        **({"true": row.true} if row.true is not None else {}),
        "comparable": bounded(row.comparable),
        **({"condensed": row.condensed} if row.condensed is not None else {}),
        **({"open": True} if row.open else {}),
        "unit": row.unit,
    }
