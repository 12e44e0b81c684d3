"""The study folder of a surrogate flight: what the loop was given, what it said, what was true."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from exam.surrogates.flights.flight import Flight, write_flight
from exam.surrogates.page import scored_page
from exam.surrogates.study import SurrogateStudy
from scenarios.diagnosis.text import bounded, positive
from scenarios.files.sources import versions
from scenarios.report.figure_formats import USUAL, Formats
from scenarios.trials.planted_report import write_trial


def write_surrogate(study: SurrogateStudy, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write records, vehicle file, diagnosis, truth and ``comparison.json`` (last); returns the
    folder.
    """
    given, dressed = partial(write_flight, study.flight), partial(scored_page, study)
    return write_trial(
        study.tracing,
        given,
        truth_content(study.flight),
        comparison(study),
        folder,
        figures=figures,
        dressed=dressed,
    )


def truth_content(flight: Flight) -> dict[str, Any]:
    """Nominal derivatives, what dominates, levels of the small causes, and what was true of each
    record alone.
    """
    drawn = flight.drawn
    return {
        "schema": "flightid/truth/1",
        "vehicle": drawn.vehicle,
        "parameters": {
            name: {
                "value": drawn.declared.parameters[name].value,
                "unit": drawn.declared.parameters[name].unit,
            }
            for name in drawn.starts
        },
        "effects": [item.name for item in drawn.hidden],
        "hidden": {item.name: dict(item.values) for item in drawn.hidden},
        "hidden_records": {
            item.name: [number + 1 for number in item.records] for item in drawn.hidden
        },
        "records": {
            flown.record.name: {"maneuver": kind, **flown.constants}
            for flown, kind in zip(flight.flown, drawn.kinds, strict=True)
        },
        "filters": dict(drawn.corners),
        "causes": asdict(drawn.surrogate.causes),
        "distance": "effect missing" if drawn.hidden else "small causes missing",
        "step": drawn.surrogate.flight.step,
    }


def comparison(study: SurrogateStudy) -> dict[str, Any]:
    """Content of ``comparison.json``; ``true`` are the nominal derivatives, which small causes
    move, too.
    """
    d = study.tracing.diagnosis
    rows = study.derivatives

    def entry(nominal: float, value: float, std: float, unit: str) -> dict[str, Any]:
        return {"true": nominal, "estimate": bounded(value), "std": positive(std), "unit": unit}

    return {
        "schema": "flightid/comparison/1",
        "scenario": study.surrogate.name,
        "title": study.surrogate.title,
        "seed": study.seed,
        "parameters": {
            row.name: entry(row.nominal, row.after.value, row.after.std, row.after.unit)
            for row in rows
        },
        "fixed": {
            item.name: {"value": item.value, "unit": item.unit}
            for item in study.tracing.model.parameters
            if not item.free
        },
        "derived": {},
        "outcome": d.verdict.value,
        "outcome_sentence": d.verdict.sentence,
        "named": {name: how.name.lower().replace("_", "-") for name, how in study.named},
        "false_claims": list(study.false),
        "small_claims": list(study.small),
        "held_out_ratio": study.held_out_ratio,
        "residual_tests": [],
        "methods": {
            "declared-model": {
                "parameters": {
                    row.name: entry(row.nominal, row.before.value, row.before.std, row.before.unit)
                    for row in rows
                }
            }
        },
        "versions": versions(),
    }
