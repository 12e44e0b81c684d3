"""The content of ``diagnosis.json``: everything of a diagnosis but its time series."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ident.statistics.residuals import ErrorFigures, ResidualTest
from ident.tracing.diagnosis import (
    Candidate,
    Claim,
    Diagnosis,
    Quantity,
    Requirement,
    Step,
)
from scenarios.diagnosis.report.evidence import warnings_of
from scenarios.diagnosis.report.tables import (
    derived_of,
    kinematics_content,
    levels_both,
)
from scenarios.diagnosis.report.wording import (
    Wording,
    record_labels,
    residual_levels,
    sentence,
    shown_probability,
)
from scenarios.files.sources import versions
from scenarios.files.user_models import channel_units
from scenarios.preparation.recording import record_content

if TYPE_CHECKING:
    from scenarios.diagnosis.diagnose import Tracing
    from scenarios.maneuver_design.design import DesignResult
from scenarios.diagnosis.report.text import headline, verdict_advice, wording_of

LARGEST = 1e30  # written in place of an infinite number; its square is finite
SMALLEST_STD = 1e-300  # written in place of a standard deviation of zero
SCHEMA = "flightid/diagnosis/2"
DECIDES = "decides.csv"  # the designed input, in the folder of the diagnosis


def diagnosis_content(tracing: Tracing, created: str) -> dict[str, Any]:
    """Return the content of ``diagnosis.json``: everything of a diagnosis but its time series.

    ``created`` is the time stamp, the only entry that differs between two runs. A parameter that
    the data do not determine has the standard deviation ``LARGEST`` and an entry in ``warnings``.
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
            **(
                {
                    "one_step": {
                        "before": _errors(d.one_step.before),
                        "after": _errors(d.one_step.after),
                        "gains": [bounded(gain) for gain in d.one_step.gains],
                    }
                }
                if d.one_step is not None
                else {}
            ),
        },
        "residual_tests": {
            "before": [test_content(test) for test in d.tests_before],
            "after": [test_content(test) for test in d.tests_after],
        },
        "steps": [_step(step) for step in d.steps],
        "candidates": [_candidate(candidate) for candidate in d.candidates],
        "sets": [asdict(each) for each in d.sets],
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
    if tracing.kinematics is not None:
        compatibility = kinematics_content(tracing.kinematics, d.effects, wording)
        content |= {"compatibility": compatibility}
    return content


def _decides(result: DesignResult) -> dict[str, Any]:
    """Return the deciding maneuver, as in ``design.json``, and its file."""
    from scenarios.maneuver_design.report import maneuver_content

    return {
        "tell": [acting.effect.name for acting in result.acting],
        "chance": result.best.chance,
        "maneuver": maneuver_content(result, result.best),
        "file": DECIDES,
        "command": result.request.command(),
    }


def quantities(values: Mapping[str, Quantity]) -> dict[str, dict[str, Any]]:
    """Return value, standard deviation and unit of each quantity, by name."""
    return {
        name: {
            "value": bounded(quantity.value),
            "std": positive(quantity.std),
            "unit": quantity.unit,
        }
        for name, quantity in values.items()
    }


def bounded(value: float) -> float:
    """Return the value limited to +-``LARGEST``; 0 for NaN."""
    if math.isnan(value):
        return 0.0
    return float(min(max(value, -LARGEST), LARGEST))


def positive(std: float) -> float:
    """Return a standard deviation limited to positive finite numbers; ``LARGEST`` for NaN."""
    return float(min(max(std, SMALLEST_STD), LARGEST)) if not math.isnan(std) else LARGEST


def _not_met(requirement: Requirement) -> dict[str, Any]:
    """Return an unmet requirement on a claim: its text, the value and the required value."""
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
    """Return the entry of a claim; ``records`` are the labels of the fitted records."""
    content: dict[str, Any] = {
        "name": claim.name,
        "alternatives": list(claim.alternatives),
        "parameters": quantities(claim.parameters),
        "sentence": sentence(claim, wording),
    }
    if not claim.claimed:
        content["claimed"] = False
    if claim.reasons:
        content["reasons"] = list(claim.reasons)
    if claim.probability:
        content["probability"] = shown_probability(claim)
    if claim.one_step_gains:
        content["one_step_gains"] = [bounded(gain) for gain in claim.one_step_gains]
    if claim.records:
        content["records"] = list(claim.records)
    if claim.derivatives_under:
        content["derivatives_under"] = {
            member: quantities(values) for member, values in claim.derivatives_under.items()
        }
    if claim.spread is not None:
        content["spread"] = bounded(claim.spread)
    if claim.by_record:
        content["by_record"] = {
            label: quantities(values)
            for label, values in zip(records, claim.by_record, strict=False)
        }
    if claim.explanation:
        content["explanation"] = claim.explanation
    return content


def _errors(figures: ErrorFigures) -> dict[str, dict[str, float]]:
    """Return the root mean square of every channel, and the relative figures that are finite."""
    return {
        "rmse": {name: bounded(value) for name, value in figures.rmse.items()},
        "nrmse": _finite_only(figures.nrmse),
        "r2": _finite_only(figures.r2),
        "theil": _finite_only(figures.theil),
    }


def _finite_only(values: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items() if math.isfinite(value)}


def test_content(test: ResidualTest) -> dict[str, Any]:
    """Return the entry of a residual test, with finite numbers."""
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
    """Return a warning on the parameters that the data do not determine."""
    names = [
        name
        for name, quantity in {**d.before, **d.after}.items()
        if not (math.isfinite(quantity.std) and math.isfinite(quantity.value))
    ]
    if not names:
        return []
    pronoun = "it" if len(names) == 1 else "them"
    return [f"{', '.join(names)}: these data do not determine {pronoun}"]


def _inputs(tracing: Tracing) -> dict[str, Any]:
    inputs = tracing.inputs
    content: dict[str, Any] = {
        "records": [file.name for file in inputs.records],
        "sha256": [file.sha256 for file in inputs.records],
        "validate": [file.name for file in inputs.validation],
        "validate_sha256": [file.sha256 for file in inputs.validation],
        "vehicle": inputs.vehicle.name,
        "vehicle_sha256": inputs.vehicle.sha256,
    }
    if inputs.effects:
        content |= {"effects": inputs.effects[0].name, "effects_sha256": inputs.effects[0].sha256}
    if inputs.model is not None:
        content |= {"model": inputs.model.name, "model_sha256": inputs.model.sha256}
    content["held_out"] = [record.name for record in tracing.validation]
    if tracing.held_out_from is not None:
        content["held_out_from"] = tracing.held_out_from
    return content
