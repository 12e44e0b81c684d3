"""The figure with which the page of a stream begins: parameters while the stream arrived."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.report.document import Section, section
from scenarios.report.figure_formats import USUAL
from scenarios.report.folder import figures

STEM = "watched"


def history_section(
    folder: Path, history: str, content: Mapping[str, Any], title: str
) -> tuple[Section, ...]:
    """Draw ``watched`` into ``folder``; the section of a page that shows it.

    ``history``: text of ``history.csv``, with columns ``NAME`` and ``NAME_std``. ``content``: of
    ``comparison.json``, which names the parameters and the reference. Nothing where fewer than two
    lines have an estimate.
    """
    time, courses = courses_of(history, content["parameters"])
    if len(time) < 2 or not courses:
        return ()
    from scenarios.plots.drawing import draw_for_page
    from scenarios.plots.estimates import figure_watched

    reference = {
        each["name"]: (each["reference"], each["reference_std"])
        for each in (content.get("reference") or {}).get("differences", ())
        if each.get("reference") is not None and each.get("reference_std") is not None
    }
    make = partial(figure_watched, time, courses, reference, title)
    figure_files = draw_for_page([(STEM, make)], folder, USUAL)
    return section("While the stream arrived", *figures(figure_files))


def courses_of(
    history: str, parameters: Mapping[str, Mapping[str, Any]]
) -> tuple[np.ndarray, dict[str, tuple[str, np.ndarray, np.ndarray]]]:
    """Times ``(N,)`` and by parameter its unit, values and standard deviations ``(N,)``, NaN where
    a cell is empty; refined estimates where the history has them.
    """
    rows = list(csv.reader(io.StringIO(history)))
    if len(rows) < 2:
        return np.zeros(0), {}
    table = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows[1:]])
    column = {name: table[:, i] for i, name in enumerate(rows[0])}
    courses = {}
    for name, each in parameters.items():
        best = f"refined_{name}" if f"refined_{name}" in column else name
        if best in column and f"{best}_std" in column and np.any(np.isfinite(column[best])):
            courses[name] = str(each["unit"]), column[best], column[f"{best}_std"]
    return column["time"], courses
