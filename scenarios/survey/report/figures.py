"""What the figures of a survey are given."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from scenarios.files.writing import file_stems
from scenarios.plots.files import Named
from scenarios.plots.studies.fleet import Line, OverCondition, Shared, figure_effects, figure_over_condition, figure_shared
from scenarios.survey.derivatives import Derivative
from scenarios.survey.survey import Survey

USUAL = ("airspeed", "reference_airspeed", "mach", "Mach", "mass", "altitude")  # what arms are drawn over, the first that varies


def survey_figures(survey: Survey) -> Iterator[Named]:
    """Effects by flight; shared values over the condition; derivatives over the condition with which they change."""
    title = survey.flights.title
    if survey.recurs:
        flights = survey.recurs[0].flights
        probabilities = {each.name: each.found.probability for each in survey.recurs}
        yield "effects", partial(figure_effects, flights, probabilities, f"{title}: which flight has which effect")
    condition = next((name for name in (*USUAL, *survey.conditions) if name in survey.conditions), None)
    if condition is None:
        return
    at, unit = survey.conditions[condition], survey.condition_units[condition]
    rows = []
    for each in survey.recurs:
        here = [number for number, name in enumerate(each.flights) if name in at]
        has = np.array([each.flights[number] in each.has for number in here])
        where = np.array([at[each.flights[number]] for number in here])
        sigma = float(np.sqrt(each.found.covariance[0, 0]))
        (local, own), *_ = each.parameters.items()
        rows.append(Shared(f"{each.name} {local}", own, where, each.values[here, 0], each.sigmas[here, 0], has, float(each.found.value[0]), sigma))
    if rows:
        yield "shared", partial(figure_shared, rows, condition, unit, f"{title}: each flight by itself, and the common value")
    stems = file_stems(list(survey.conditions))
    for name in dict.fromkeys(_condition(each, condition) for each in survey.derivatives):
        mine = [_drawn(each, survey, name) for each in survey.derivatives if _condition(each, condition) == name]
        yield f"over_{stems[name]}", partial(figure_over_condition, mine, name, survey.condition_units[name], f"{title}: derivatives over {name}")


def _condition(each: Derivative, usual: str) -> str:
    """The condition that a derivative is drawn over: that with which it changes."""
    return each.drifts[0] if each.drifts is not None else usual


def _drawn(each: Derivative, survey: Survey, condition: str) -> OverCondition:
    at = survey.conditions[condition]
    here = [number for number, name in enumerate(each.flights) if name in at]
    where = np.array([at[each.flights[number]] for number in here])
    along = np.linspace(where.min(), where.max(), 60) if len(where) else np.zeros(0)
    drift = each.drifts
    if drift is not None:
        middle, sigma = drift[1].band(along)
        between = drift[1].scatter
    else:
        middle, sigma, between = np.full_like(along, each.common.value), np.full_like(along, each.common.sigma), each.common.scatter
    return OverCondition(each.name, each.unit, where, each.values[here], each.sigmas[here], each.out[here], Line(along, middle, sigma, between))
