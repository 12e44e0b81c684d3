"""The content of ``design.json``: SI, load factors in g and as totals."""

from __future__ import annotations

import math
from typing import Any

from ident.maneuver_design.rivalry import Acting, Contest
from scenarios.files.sources import versions
from scenarios.maneuver_design.design import Design, Maneuver
from scenarios.maneuver_design.text import notes_of, peaks_of, units_shown, verdict_of

SCHEMA = "flightid/design/1"


def design_content(design: Design) -> dict[str, Any]:
    """Everything of a design but its time series."""
    setting = design.setting
    files = {"vehicle": setting.vehicle.identity, "model": setting.vehicle.own_file}
    return {
        "schema": SCHEMA,
        "model": setting.model.name,
        "vehicle": setting.vehicle.name,
        "verdict": verdict_of(design),
        "best": design.best.kind,
        "chance": design.best.chance,
        "command": design.asked.command(),
        "tell": [_acting(each) for each in design.acting],
        "maneuvers": [maneuver_content(design, each) for each in design.maneuvers],
        "duration": float(setting.room.time[-1]),
        "rate": setting.rate,
        "hold": "previous",
        "noise": dict(setting.noise),
        "trim": dict(setting.rest),
        "limits": {
            "outputs": {name: [value for value in ends if math.isfinite(value)] for name, ends in setting.limits.outputs.items()},
            "amplitude": dict(setting.limits.amplitude),
            "rate": dict(setting.limits.rate),
        },
        "units": dict(units_shown(design)),
        "warnings": [],
        "notes": notes_of(design),
        "inputs": {
            key: value for name, file in files.items() if file is not None for key, value in ((name, file.name), (f"{name}_sha256", file.sha256))
        },
        "versions": versions(),
    }


def maneuver_content(design: Design, maneuver: Maneuver) -> dict[str, Any]:
    """One kind: pace, peaks, expected sigmas (those that are finite), and what it says of the effects."""
    content: dict[str, Any] = {
        "kind": maneuver.kind,
        "pace": maneuver.pace,
        "amplitude": peaks_of(design, maneuver),
        "scale": maneuver.flight.scale,
        "held_by": maneuver.flight.bound_by or "amplitude",
        "extremes": {name: list(ends) for name, ends in maneuver.flight.extremes.items()},
        "mean_sigma": maneuver.criterion,
        "sigmas": {name: std for name, std in maneuver.sigmas.items() if math.isfinite(std)},
    }
    if maneuver.responses is not None:
        found = maneuver.responses
        content["responses"] = {
            "frequency_Hz": found.frequency.tolist(),
            "mean_random_error": found.criterion,
            "pairs": [
                {
                    "output": output,
                    "input": name,
                    "usable": float(found.usable[m, q]),
                    "coherence": found.coherence[m, q].tolist(),
                    "random_error": found.random_error[m, q].tolist(),
                }
                for m, output in enumerate(found.outputs)
                for q, name in enumerate(found.inputs)
            ],
        }
    if maneuver.contests:
        content |= {"chance": maneuver.chance, "log_likelihood": maneuver.log_likelihood, "contests": [_contest(each) for each in maneuver.contests]}
    return content


def _acting(acting: Acting) -> dict[str, Any]:
    units = {item.name: item.unit for item in acting.effect.parameters}
    return {"name": acting.effect.name, "parameters": {name: {"value": value, "unit": units.get(name, "1")} for name, value in acting.values.items()}}


def _contest(contest: Contest) -> dict[str, Any]:
    d = contest.decision
    return {
        "acts": _acting(contest.true),
        "rival": _acting(contest.rival),
        "gain_over_none": contest.found,
        "log_likelihood": d.log_likelihood,
        "std": 0.5 * d.std,
        "price": d.price,
        "found": contest.shown,
        "right": d.right,
        "wrong": d.wrong,
        "chance": contest.chance,
    }
