"""The content of ``survey.json`` and ``derivatives.csv``."""

from __future__ import annotations

import csv
import io
from typing import Any

import numpy as np

from scenarios.files.versions import versions
from scenarios.survey.derivatives import Derivative
from scenarios.survey.growing import SCHEMA
from scenarios.survey.recurring import LIBRARY, Recurring
from scenarios.survey.report.words import belongs_phrase, outstanding, rivals_phrase, state, verdict_of
from scenarios.survey.survey import Survey


def survey_content(survey: Survey, created: str) -> dict[str, Any]:
    """Everything of a survey but its flights' own studies, whose folders it names; SI."""
    grown, (word, rest) = survey.grown, verdict_of(survey)
    return {
        "schema": SCHEMA,
        "created": created,
        "title": survey.flights.title,
        "model": survey.flights.model,
        "verdict": word.lower(),
        "headline": rest,
        "effects": [effect_content(each, survey) for each in survey.recurs],
        "tried": list(survey.tried),
        "candidates": LIBRARY,
        "alone": {name: list(flights) for name, flights in survey.alone.items()},
        "needless": {name: list(flights) for name, flights in survey.needless.items()},
        "unfitted": dict(survey.unfitted),
        "derivatives": {each.name: derivative_content(each, survey) for each in survey.derivatives},
        "stand_out": [{"flight": flight, "derivative": name, "sigmas": off} for flight, name, off in outstanding(survey)],
        "flights": {name: _flight(survey, name) for name in grown.kept},
        "failed": dict(grown.failed),
        "removed": list(grown.removed),
        "computed": list(grown.computed),
        "new": list(grown.new),
        "refitted": survey.refitted,
        "verdicts": dict(survey.verdicts),
        "warnings": list(survey.warnings),
        "notes": list(survey.notes),
        "inputs": {"survey": {"name": survey.flights.path.name, "sha256": survey.flights.sha256}},
        "versions": versions(),
    }


def effect_content(each: Recurring, survey: Survey) -> dict[str, Any]:
    """One effect that recurs."""
    found = each.found
    sigmas = np.sqrt(np.diag(found.covariance))
    common = zip(each.parameters.items(), found.value, sigmas, strict=True)
    return {
        "name": each.name,
        "belongs_to": found.belongs,
        "sentence": belongs_phrase(each, survey),
        "rivals_sentence": rivals_phrase(each),
        "parameters": {local: {"value": float(value), "std": float(sigma), "unit": unit} for (local, unit), value, sigma in common},
        "one_value": found.agrees,
        "scatter": found.scatter,
        "changes": {
            local: {"with": condition, "slope": line.slope, "std": line.slope_sigma, "per": survey.condition_units[condition], "p": line.p_value}
            for (name, local), (condition, line) in survey.effect_trends.items()
            if name == each.name
        },
        "share": found.share,
        "log_likelihood": found.log_likelihood,
        "chance_of_as_much": found.p_value,
        "rivals": dict(each.rivals),
        "named_alone": list(each.named),
        "flights": {
            name: {
                "state": state(each, name),
                "probability": float(p),
                "values": dict(zip(each.parameters, map(float, v), strict=True)),
                "stds": list(s),
            }
            for name, p, v, s in zip(each.flights, found.probability, each.values, each.sigmas, strict=True)
        },
    }


def derivative_content(each: Derivative, survey: Survey) -> dict[str, Any]:
    """One derivative over the flights."""
    common = each.common
    return {
        "unit": each.unit,
        "value": common.value,
        "std": common.sigma,
        "interval": [common.low, common.high],
        "scatter": common.scatter,
        "p_one_value": common.p_same,
        "false_discovery_rate": each.differs,
        "trends": {
            name: {
                "slope": line.slope,
                "std": line.slope_sigma,
                "per": survey.condition_units[name],
                "at": line.middle,
                "value_there": line.at_middle,
                "scatter": line.scatter,
                "p": line.p_value,
                "false_discovery_rate": rate,
            }
            for name, (line, rate) in each.trends.items()
        },
        "flights": {name: {"value": float(v), "std": float(s)} for name, v, s in zip(each.flights, each.values, each.sigmas, strict=True)},
    }


def _flight(survey: Survey, name: str) -> dict[str, Any]:
    flight, kept = survey.grown.flights[name], survey.grown.kept[name]
    return {
        "digest": flight.digest,
        "verdict": kept["verdict"],
        "headline": kept["headline"],
        "date": flight.date,
        "tail": flight.tail,
        "condition": {key: {"value": value, "unit": unit} for key, (value, unit) in flight.condition.items()},
        "claimed": [each["name"] for each in kept["effects"] if each["claimed"]],
        "check": kept["check"],
        "report": f"flights/{name}/report.html",
    }


def derivatives_text(survey: Survey) -> str:
    """``derivatives.csv``: a row a flight and derivative, with the flight's conditions; SI."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["flight", "derivative", "unit", "value", "std", "sigmas_off", "stands_out", *survey.conditions])
    for each in survey.derivatives:
        for name, value, sigma, off, out in zip(each.flights, each.values, each.sigmas, each.off, each.out, strict=True):
            at = [repr(by_flight[name]) if name in by_flight else "" for by_flight in survey.conditions.values()]
            writer.writerow([name, each.name, each.unit, repr(float(value)), repr(float(sigma)), f"{off:.4g}", int(out), *at])
    return text.getvalue()
