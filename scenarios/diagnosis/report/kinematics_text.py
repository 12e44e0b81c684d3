"""What the kinematics say beside a diagnosis, in words and for the JSON file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ident.compatibility.kinematics import ARMS
from ident.compatibility.six_degrees.kinematics import LEVEL
from ident.compatibility.trials import SensorFinding
from ident.tracing.diagnosis import Claim, Quantity
from scenarios.diagnosis.kinematics import (
    BIAS,
    PARAMETERS,
    Kinematics,
    _finite,
    agreements,
    unnamed,
)
from scenarios.diagnosis.report.wording import Wording, group_sentence
from scenarios.report.quantities import with_sigma

FREE = "the fits of a diagnosis leave a bias of each channel free"


def kinematics_lines(
    kinematics: Kinematics, claims: Sequence[Claim], wording: Wording
) -> list[str]:
    """All of it in sentences, one a line."""
    if kinematics.result is None:
        return [kinematics.why]
    lines = [each.sentence for each in agreements(kinematics, claims)]
    lines += [
        f"kinematics alone say: {finding_sentence(finding, wording)}; "
        f"{FREE if finding.kind == BIAS else 'the diagnosis does not name it'}"
        for finding in unnamed(kinematics, claims)
    ]
    lines = lines or ["kinematics alone find no sensor fault, as the diagnosis does"]
    # The declared equations say as much themselves.
    return [*lines, *(f"kinematics: {note}" for note in kinematics.result.notes if note != LEVEL)]


def finding_sentence(finding: SensorFinding, wording: Wording) -> str:
    """One finding: name, value and sigma, and what that is in the words of its effect and group."""
    quantity = Quantity(finding.value, finding.std, finding.unit)
    if wording.traits(finding.name).sentences:
        words = group_sentence(
            Claim(finding.name, {_parameter(finding): quantity}, finding.group), wording
        )
        return f"{finding.name} {with_sigma(quantity)}, {words}"
    # What is no effect of the library, a bias or the place of all accelerometers together, has the
    # words of a check.
    from scenarios.compatibility.report import fault_text

    group = f" ({' or '.join(finding.group)} would do as well)" if finding.group else ""
    return f"{finding.name}, {fault_text(finding)}{group}"


def _parameter(finding: SensorFinding) -> str:
    """The effect's parameter that is the size of a finding."""
    return "arm" if finding.kind in ARMS else PARAMETERS.get(finding.kind, finding.kind)


def kinematics_content(
    kinematics: Kinematics, claims: Sequence[Claim], wording: Wording
) -> dict[str, Any]:
    """The entry ``compatibility`` of a study; numbers that are not finite are left out."""
    lines = kinematics_lines(kinematics, claims, wording)
    if kinematics.result is None:
        return {"records": list(kinematics.records), "checked": False, "sentences": lines}
    findings = [
        finding
        for finding in kinematics.result.findings
        if finding.stands and _finite(finding.value, finding.std, finding.gain)
    ]
    return {
        "records": list(kinematics.records),
        "checked": True,
        "findings": [
            {
                "name": finding.name,
                "channel": finding.channel,
                "parameters": {
                    _parameter(finding): _number(Quantity(finding.value, finding.std, finding.unit))
                },
                "alternatives": list(finding.group),
                "gain": finding.gain,
                "replicates": finding.replicates,
                "sentence": finding_sentence(finding, wording),
            }
            for finding in findings
        ],
        "agreement": [
            {
                "effect": each.effect,
                "says": each.says,
                "sentence": each.sentence,
                **({"found": _number(each.found)} if each.found else {}),
            }
            for each in agreements(kinematics, claims)
        ],
        "cannot_tell": list(kinematics.result.cannot_tell),
        "notes": list(kinematics.result.notes),
        "sentences": lines,
    }


def _number(quantity: Quantity) -> dict[str, Any]:
    return {"value": quantity.value, "std": max(quantity.std, 1e-300), "unit": quantity.unit}
