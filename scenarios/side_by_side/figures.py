"""Which figures a comparison of studies gets: estimates, errors where some truth is known, outputs over time."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from scenarios.plots.files import Named
from scenarios.plots.studies.side_by_side import (
    ParameterColumn,
    StudyResponse,
    figure_studies_errors,
    figure_studies_estimates,
    figure_studies_responses,
)
from scenarios.side_by_side.comparison import SideBySide
from scenarios.side_by_side.responses import Responses
from scenarios.side_by_side.value import Value

TITLE = "studies side by side"


def compared_figures(compared: SideBySide) -> Iterator[Named]:
    """The figures of a comparison: the stem of each file, and what draws it."""
    labels = [column.label for column in compared.columns]
    names = (*compared.names, *compared.derived)
    rows = {name: [_drawn(compared.value(name, column)) for column in compared.columns] for name in names}
    units = {name: compared.unit(name) for name in names}
    yield "compared_estimates", partial(figure_studies_estimates, rows, units, labels, TITLE)
    known = {name: row for name, row in rows.items() if any(each is not None and each.reference is not None for each in row)}
    if known:
        yield "compared_errors", partial(figure_studies_errors, known, labels, TITLE)
    flown = [_response(column.label, column.responses) for column in compared.columns if column.responses is not None]
    shared = [name for name in dict.fromkeys(name for each in flown for name in each.measured) if sum(name in each.measured for each in flown) > 1]
    if shared:
        yield "compared_responses", partial(figure_studies_responses, flown, shared, TITLE)


def _drawn(value: Value | None) -> ParameterColumn | None:
    return None if value is None else ParameterColumn(value.estimate, value.std, value.true, value.condensed, value.published)


def _response(label: str, found: Responses) -> StudyResponse:
    return StudyResponse(label, found.time, found.inputs, found.measured, found.predicted, found.units, found.simulated)
