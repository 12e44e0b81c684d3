"""The study folder of a tracing scenario: what the loop was given, what it said, what was true."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from scenarios.diagnosis.report.content import bounded, positive, test_content
from scenarios.files.versions import versions
from scenarios.plots.formats import USUAL, Formats
from scenarios.trials.folder import write_trial
from scenarios.trials.planted.flights import write_flown
from scenarios.trials.planted.page import scored_page
from scenarios.trials.planted.study import Scored, TraceStudy


def write_trace(study: TraceStudy, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write records, vehicle file, diagnosis, truth and ``comparison.json`` (last); returns the folder."""
    given, dressed = partial(write_flown, study.flown), partial(scored_page, study)
    return write_trial(study.tracing, given, truth_content(study), trace_comparison(study), folder, figures=figures, dressed=dressed)


def truth_content(study: TraceStudy) -> dict[str, Any]:
    """Derivatives, hidden terms, noise and distance."""
    flown = study.flown
    return {
        "schema": "flightid/truth/1",
        "parameters": {row.name: {"value": row.true, "unit": row.unit} for row in study.derivatives},
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
    before = {row.name: {"estimate": row.before.value, "std": positive(row.before.std), **_common(row)} for row in study.derivatives if row.before}
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
        "residual_tests": [test_content(test) for test in d.tests_after],
        "methods": {"declared-model": {"parameters": before, "derived": derived["before"]}},
        "versions": versions(),
    }


def _after(row: Scored) -> dict[str, Any]:
    return {"estimate": bounded(row.after.value), "std": positive(row.after.std), **_common(row), "error_sigmas": bounded(row.sigmas)}


def _common(row: Scored) -> dict[str, Any]:
    return {"true": row.true, "unit": row.unit}
