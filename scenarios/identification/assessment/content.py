"""What stands beside an estimate, for ``comparison.json``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ident.statistics.intervals import LEVEL, ProfileInterval
from scenarios.files.constraints import Constraints
from scenarios.identification.assessment.bounds import AtBound
from scenarios.identification.assessment.prediction import RecordFit
from scenarios.studies.rows import Row


def constraints_content(constraints: Constraints, tied: Sequence[Row], at_bounds: Sequence[AtBound]) -> dict[str, Any]:
    """What the vehicle file lays down and what came of it; empty where nothing is."""
    out: dict[str, Any] = {}
    if constraints.fixed:
        out["held"] = list(constraints.fixed)
    if constraints.bounds:
        out["bounds"] = {name: _pair(low, high) for name, (low, high) in constraints.bounds.items()}
    if constraints.ties:
        rows = {row.name: row for row in tied}
        out["tied"] = {
            tie.name: {"estimate": rows[tie.name].estimate, "std": rows[tie.name].std, "unit": rows[tie.name].unit, "tie": tie.words}
            for tie in constraints.ties
            if tie.name in rows
        }
    if at_bounds:
        out["at_bound"] = {each.name: {"value": each.value, "unit": each.unit, "bound": each.side} for each in at_bounds}
    return {"constraints": out} if out else {}


def intervals_content(intervals: Sequence[ProfileInterval]) -> dict[str, Any]:
    """Profile-likelihood intervals by parameter; an end that is left out is open."""
    if not intervals:
        return {}
    return {"intervals": {"level": LEVEL, "parameters": {each.name: _interval(each) for each in intervals}}}


def fits_content(fits: Sequence[RecordFit]) -> dict[str, Any]:
    """Errors of the free simulations, record by record."""
    return {"records_fitted": [_fit(each) for each in fits]} if fits else {}


def _pair(low: float, high: float) -> dict[str, float]:
    return {key: value for key, value in (("low", low), ("high", high)) if abs(value) != float("inf")}


def _interval(each: ProfileInterval) -> dict[str, Any]:
    ends = {key: value for key, value in (("low", each.low), ("high", each.high)) if value is not None}
    bounds = [key for key, at in (("low", each.low_bound), ("high", each.high_bound)) if at]
    return {**ends, **({"at_bound": bounds} if bounds else {}), "agrees_with_sigma": each.agrees}


def _fit(each: RecordFit) -> dict[str, Any]:
    content: dict[str, Any] = {"record": each.record.name, "held_out": each.held_out}
    if each.figures is not None:
        figures = each.figures
        content["channels"] = {
            name: {"rms_error": figures.rmse[name], "fit_percent": each.fit_percent(name), "r2": figures.r2[name], "theil": figures.theil[name]}
            for name in figures.rmse
        }
    return content
