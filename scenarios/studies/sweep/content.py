"""A sweep for ``comparison.json``, and as a table with a row for each structure, method and parameter."""

from __future__ import annotations

import csv
import io
import math
from typing import Any

from scenarios.studies.sweep.criteria import criteria_of
from scenarios.studies.sweep.sweep import Sweep, SweepPoint, SweptMethod

HEADINGS = ("frequency_factor", "degree", "method", "parameter", "unit", "rigid", "condensed", "estimate", "std", "error_percent", "error_sigmas")


def sweep_content(sweep: Sweep) -> dict[str, Any]:
    """Points from stiff to soft, criteria with the degree at which each fails a rigid model, and marks; derivatives in SI."""
    criteria = []
    for each in criteria_of(sweep.points):
        told: dict[str, Any] = {"name": each.name, "sentence": each.sentence, "limit": each.limit, "fails_below": each.below}
        told["values"] = [
            {"frequency_factor": p.frequency_factor, "value": v} for p, v in zip(sweep.points, each.values, strict=True) if math.isfinite(v)
        ]
        if each.degree is not None and each.frequency_factor is not None:
            told |= {"degree": each.degree, "frequency_factor": each.frequency_factor}
        criteria.append(told)
    return {
        "rigid": dict(sweep.rigid),
        "points": [_point(point) for point in sweep.points],
        "criteria": criteria,
        "marks": [
            {
                "label": mark.label,
                "frequency_factor": mark.frequency_factor,
                "published": {name: {"value": start.value, "std": start.std} for name, start in printed.items()},
            }
            for mark, printed in sweep.marks
        ],
    }


def sweep_csv(sweep: Sweep) -> str:
    """The estimates of all structures; a cell is empty where there is nothing."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADINGS)
    for point in sweep.points:
        for found in point.methods:
            for at, name in enumerate(found.names):
                if name not in found.condensed:
                    continue
                rigid = repr(sweep.rigid[name]) if name in sweep.rigid else ""
                numbers = (found.condensed[name], float(found.values[at]), float(found.std[at]), *found.errors(name))
                label = [repr(point.frequency_factor), repr(point.figures.degree), found.estimation.name, name, sweep.units[name], rigid]
                writer.writerow([*label, *map(repr, numbers)])
    return text.getvalue()


def _point(point: SweepPoint) -> dict[str, Any]:
    figures = point.figures
    return {
        "frequency_factor": point.frequency_factor,
        "degree": figures.degree,
        "stiffness_loss": figures.stiffness_loss,
        "misfit": figures.misfit,
        "rigid_serves": figures.rigid_serves,
        "condensed": dict(figures.condensed),
        "best_rigid": dict(figures.fitted),
        "methods": {found.estimation.name: _method(found) for found in point.methods},
    }


def _method(found: SweptMethod) -> dict[str, Any]:
    rows = {}
    for at, name in enumerate(found.names):
        if name in found.condensed:
            percent, sigmas = found.errors(name)
            row = {"estimate": float(found.values[at]), "std": float(found.std[at]), "condensed": found.condensed[name]}
            rows[name] = {**row, "error_percent": percent, "error_sigmas": sigmas}
    content: dict[str, Any] = {"outcome": found.outcome.code, "parameters": rows}
    return content | ({"log_likelihood": found.log_likelihood} if math.isfinite(found.log_likelihood) else {})
