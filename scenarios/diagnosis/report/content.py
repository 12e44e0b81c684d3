"""The content of ``diagnosis.json``: finite numbers only, every standard deviation above zero."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import (
    Candidate,
    Claim,
    Diagnosis,
    ErrorFigures,
    Quantity,
    Requirement,
    Step,
)
from scenarios.diagnosis.report.evidence import warnings_of
from scenarios.diagnosis.report.tables import derived_of, kinematics_content, levels_both
from scenarios.diagnosis.report.text import headline, verdict_advice, wording_of
from scenarios.diagnosis.report.wording import (
    Wording,
    record_labels,
    residual_levels,
    sentence,
    shown_probability,
)
from scenarios.diagnosis.tracing import Tracing
from scenarios.files.sources import versions
from scenarios.files.user_models import channel_units
from scenarios.preparation.recording import record_content

if TYPE_CHECKING:
    from scenarios.maneuver_design.design import DesignResult

# what a number that has run away is written as: it reads back everywhere, and its square is finite
LARGEST = 1e30
SCHEMA = "flightid/diagnosis/2"
DECIDES = "decides.csv"  # the input to be flown, beside the diagnosis


def diagnosis_content(tracing: Tracing, created: str) -> dict[str, Any]:
    """Everything of a diagnosis but its time series. ``created`` is the time stamp, the one entry
    that differs between two runs.

    A standard deviation that is not finite (the data say nothing of the parameter) is written as
    ``LARGEST`` and told in ``warnings``.
    """
    d, wording = tracing.diagnosis, wording_of(tracing)
    derived_before, derived_after = derived_of(d)
    units = channel_units(tracing.model)
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "created": created,
        "model": tracing.vehicle.model,
        "vehicle": tracing.vehicle.name,
        "verdict": d.verdict.value,
        "verdict_sentence": d.verdict.sentence,
        "headline": headline(tracing),
        "effects": [_claim(claim, wording, record_labels(tracing)) for claim in d.effects],
        "parameters": {"before": quantities(d.before), "after": quantities(d.after)},
        "scatter": {name: positive(std) for name, std in d.scatter.items()},
        "growth": {name: bounded(factor) for name, factor in d.inflation.items()},
        "derived": {
            name: {"estimate": entry["value"], **entry}
            for name, entry in quantities(derived_after).items()
        },
        "derived_before": {
            name: {"estimate": entry["value"], **entry}
            for name, entry in quantities(derived_before).items()
        },
        **levels_both(tracing),
        "error": {
            "held_out": d.held_out,
            "unit": {name: units[name] for name in d.error_before.rmse if name in units},
            "before": _errors(d.error_before),
            "after": _errors(d.error_after),
            "noise_floor": _finite_only(d.noise_floor),
            "residual": _finite_only(residual_levels(d)),
        },
        "residual_tests": {
            "before": [test_content(test) for test in d.tests_before],
            "after": [test_content(test) for test in d.tests_after],
        },
        "steps": [_step(step) for step in d.steps],
        "candidates": [_candidate(candidate) for candidate in d.candidates],
        "warnings": [
            *tracing.doubts,
            *tracing.look.set_aside,
            *warnings_of(tracing),
            *_undetermined(d),
        ],
        **({"not_met": [_not_met(requirement) for requirement in d.not_met]} if d.not_met else {}),
        "notes": list(tracing.notes),
        "record": record_content(tracing.look),
        "advice": verdict_advice(tracing),
        "effort": {"name": tracing.effort, "stopped": d.stopped},
        **({"overflows": tracing.overflows} if tracing.overflows else {}),
        "inputs": _inputs(tracing),
        "versions": versions(),
    }
    if tracing.decides is not None:
        content |= {"decides": _decides(tracing.decides)}
    kinematics = tracing.kinematics
    return content | (
        {"compatibility": kinematics_content(kinematics, d.effects, wording)}
        if kinematics is not None
        else {}
    )


def _decides(found: DesignResult) -> dict[str, Any]:
    """The maneuver that would decide, as ``design.json`` has it, and where it stands."""
    from scenarios.maneuver_design.report import maneuver_content

    names = [each.effect.name for each in found.acting]
    best = found.best
    return {
        "tell": names,
        "chance": best.chance,
        "maneuver": maneuver_content(found, best),
        "file": DECIDES,
        "command": found.request.command(),
    }


def quantities(some: Mapping[str, Quantity]) -> dict[str, dict[str, Any]]:
    """Name -> value, std, unit."""
    return {
        name: {"value": bounded(q.value), "std": positive(q.std), "unit": q.unit}
        for name, q in some.items()
    }


def bounded(value: float) -> float:
    """The number, or one of ``LARGEST`` size where it has run away; zero for none at all."""
    if math.isnan(value):
        return 0.0
    return float(min(max(value, -LARGEST), LARGEST))


def positive(std: float) -> float:
    """A standard deviation above zero and finite."""
    return float(min(max(std, 1e-300), LARGEST)) if not math.isnan(std) else LARGEST


def _not_met(requirement: Requirement) -> dict[str, Any]:
    """A requirement on a claim that was not met: what was asked, the number found, the number
    required.
    """
    return {
        "asked": requirement.asked,
        "value": bounded(requirement.value),
        "required": bounded(requirement.bar),
        "at_least": requirement.at_least,
        "unit": requirement.unit,
        "effects": list(requirement.effects),
        "sentence": requirement.sentence,
    }


def _claim(claim: Claim, wording: Wording, records: Sequence[str]) -> dict[str, Any]:
    out: dict[str, Any] = {
        "name": claim.name,
        "alternatives": list(claim.alternatives),
        "parameters": quantities(claim.parameters),
        "sentence": sentence(claim, wording),
    }
    out |= {} if claim.claimed else {"claimed": False}
    out |= {"reasons": list(claim.reasons)} if claim.reasons else {}
    out |= {"probability": shown_probability(claim)} if claim.probability else {}
    out |= {"one_step_gains": list(claim.one_step_gains)} if claim.one_step_gains else {}
    out |= {"records": list(claim.records)} if claim.records else {}
    out |= (
        {
            "derivatives_under": {
                member: quantities(each) for member, each in claim.derivatives_under.items()
            }
        }
        if claim.derivatives_under
        else {}
    )
    out |= {"spread": bounded(claim.spread)} if claim.spread is not None else {}
    out |= (
        {
            "by_record": {
                label: quantities(each)
                for label, each in zip(records, claim.by_record, strict=False)
            }
        }
        if claim.by_record
        else {}
    )
    return out | ({"explanation": claim.explanation} if claim.explanation else {})


def _errors(figures: ErrorFigures) -> dict[str, dict[str, float]]:
    """Root mean squares are there for every channel; the relative figures where they can be
    formed.
    """
    return {
        "rmse": {name: bounded(value) for name, value in figures.rmse.items()},
        "nrmse": _finite_only(figures.nrmse),
        "r2": _finite_only(figures.r2),
        "theil": _finite_only(figures.theil),
    }


def _finite_only(some: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in some.items() if math.isfinite(value)}


def test_content(test: ResidualTest) -> dict[str, Any]:
    """One residual test, its numbers within what JSON can say."""
    return {
        "name": test.name,
        "channel": test.channel,
        "statistic": bounded(test.statistic),
        "p_value": bounded(test.p_value),
        "passed": test.passed,
        "sentence": test.sentence,
    }


def _step(step: Step) -> dict[str, Any]:
    return {
        "effects": list(step.effects),
        "log_evidence": bounded(step.log_evidence),
        "log_likelihood": bounded(step.log_likelihood),
        "sentence": step.sentence,
    }


def _candidate(c: Candidate) -> dict[str, Any]:
    return {
        "round": c.round,
        "within": list(c.within),
        "name": c.name,
        "gain": bounded(c.gain),
        "weight": bounded(c.weight),
        "fitted": c.fitted,
        "parameters": quantities(c.parameters),
        "collinear_with": list(c.collinear_with),
    }


def _undetermined(d: Diagnosis) -> list[str]:
    names = [
        name
        for name, q in {**d.before, **d.after}.items()
        if not (math.isfinite(q.std) and math.isfinite(q.value))
    ]
    return (
        [f"{', '.join(names)}: these data do not determine {'it' if len(names) == 1 else 'them'}"]
        if names
        else []
    )


def _inputs(tracing: Tracing) -> dict[str, Any]:
    inputs = tracing.inputs
    out: dict[str, Any] = {
        "records": [file.name for file in inputs.records],
        "sha256": [file.sha256 for file in inputs.records],
        "validate": [file.name for file in inputs.validation],
        "validate_sha256": [file.sha256 for file in inputs.validation],
        "vehicle": inputs.vehicle.name,
        "vehicle_sha256": inputs.vehicle.sha256,
    }
    if inputs.effects:
        out |= {"effects": inputs.effects[0].name, "effects_sha256": inputs.effects[0].sha256}
    if inputs.model is not None:
        out |= {"model": inputs.model.name, "model_sha256": inputs.model.sha256}
    out |= {"held_out": [record.name for record in tracing.validation]}
    return out | (
        {"held_out_from": tracing.held_out_from} if tracing.held_out_from is not None else {}
    )
