"""The study folder of a check: figures, the page, and the JSON last."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ident.compatibility.trials import CheckResult, FaultQuantity, SensorEstimate, SensorFinding
from scenarios.compatibility.check import Check, equivalent_constant, noise_levels
from scenarios.compatibility.page import check_page
from scenarios.files.folders import study_folder
from scenarios.files.versions import versions
from scenarios.files.writing import write_json
from scenarios.pages.folder import write_page
from scenarios.plots.formats import USUAL, Formats
from scenarios.plots.page.named import Drawn
from scenarios.preparation.record_words import record_content

MAIN = "compatibility.json"
SCHEMA = "flightid/compatibility/1"


def write_check(check: Check, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a check into ``folder``, whole or not at all; returns the folder."""
    with study_folder(folder, MAIN) as scratch:
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.compatibility.figures import check_figures
            from scenarios.plots.page.drawing import drawn_for_page

            drawn = drawn_for_page(check_figures(check.result, check.simulated), scratch, figures)
        write_page(scratch, check_page(check, drawn))
        write_json(scratch / MAIN, check_content(check))
    return Path(folder)


def check_content(check: Check) -> dict[str, Any]:
    """Content of ``compatibility.json``: SI, nz in g; scales as factors."""
    result = check.result
    constants = {"gravity": check.settings.gravity, "vane_arm": check.settings.vane_arm}
    return {
        "schema": SCHEMA,
        "channels": list(result.channels),
        "relations": {name: list(joined) for name, joined in result.relations.items()},
        "constants": constants | ({"airspeed": check.settings.airspeed} if check.settings.airspeed is not None else {}),
        "joint": _result(check, result.joint),
        "single": [_result(check, item) for item in result.single],
        "findings": [_finding(item) for item in result.findings if item.stands],
        "cannot_tell": list(result.cannot_tell),
        "warnings": [*check.look.doubts, *check.look.set_aside, *_equivalents(check)],
        "notes": [*check.notes, *result.notes],
        "record": record_content(check.look),
        "inputs": {
            "records": [item.name for item in check.files],
            "sha256": [item.sha256 for item in check.files],
            **({"vehicle": {"name": check.vehicle.name, "sha256": check.vehicle.sha256}} if check.vehicle is not None else {}),
        },
        "versions": versions(),
    }


def _equivalents(check: Check) -> list[str]:
    """Numbers of the vehicle file that would explain a finding as well."""
    found = [(finding.name, equivalent_constant(check, finding)) for finding in check.result.findings if finding.stands]
    return [f"{name}: {said}" for name, said in found if said]


def _result(check: Check, result: CheckResult) -> dict[str, Any]:
    return {
        "records": list(result.records),
        "estimates": {item.name: _estimate(item) for item in result.estimates},
        "biases": {item.name: _estimate(item) for item in result.biases},
        "tested": [_finding(item) for item in result.findings],
        "noise_std": {name: level for name, level in noise_levels(check, result).items() if level is not None},
    }


def _estimate(item: SensorEstimate) -> dict[str, Any]:
    return {
        "unit": item.unit,
        "output_error": _quantity(item.output_error),
        "smoother": _quantity(item.smoother),
        "difference_in_sigmas": item.difference,
        "agrees": item.agrees,
        "gain": item.gain,
        "p_value": item.p_value,
        "told": item.told,
    }


def _finding(item: SensorFinding) -> dict[str, Any]:
    return {
        "name": item.name,
        "channel": item.channel,
        "kind": item.kind,
        "value": item.value,
        "std": item.std,
        "unit": item.unit,
        "gain": item.gain,
        "stands": item.stands,
        "group": list(item.group),
        "replicates": item.replicates,
        **({"probabilities": dict(item.probabilities)} if len(item.probabilities) > 1 else {}),
        **({"lost": item.lost} if item.lost is not None and math.isfinite(item.lost) else {}),
    }


def _quantity(item: FaultQuantity) -> dict[str, float]:
    return {"value": item.value, "std": item.std}
