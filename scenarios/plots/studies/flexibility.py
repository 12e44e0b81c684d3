"""Equivalent derivatives of a flexible aircraft over its degree of flexibility, and when a rigid model no longer serves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scenarios.plots.display import axis_label, display_unit, plain
from scenarios.plots.style import BLACK, BLUE, GREEN, GREY, LABEL_SIZE, ORANGE, PURPLE, SKY, TICK_SIZE, TRUE, VERMILION, caption, finish, make_sheet

_ESTIMATES = ((BLUE, "o"), (GREEN, "^"), (SKY, "D"))
_CRITERIA = (GREY, PURPLE, ORANGE)
_LINES = ("-", (0, (3, 2)), "-")


@dataclass(frozen=True)
class Published:
    """A printed derivative with its deviation, at the degree of flexibility of its aircraft."""

    degree: float
    value: float
    std: float


@dataclass(frozen=True, eq=False)
class DerivativeCourse:
    """One derivative along a sweep, all in ``unit``: ``rigid`` true value, then one number a structure.

    ``condensed``: quasi-static equivalent; ``best``: of the best rigid model of the noise-free response; ``estimates`` with their standard
    deviations by method.
    """

    name: str
    unit: str
    rigid: float
    condensed: Sequence[float]
    best: Sequence[float]
    estimates: Mapping[str, Sequence[tuple[float, float]]]
    published: Sequence[Published]


@dataclass(frozen=True)
class CriterionCourse:
    """One criterion along a sweep: axis label, what it says in the legend, its limit, and the degree where it is passed, None if nowhere.

    What lies outside ``window`` is drawn at its edge: it is as clear.
    """

    axis: str
    label: str
    limit: float
    values: Sequence[float]
    degree: float | None
    window: tuple[float, float] = (-np.inf, np.inf)


def figure_flexibility(
    degrees: Sequence[float], courses: Sequence[DerivativeCourse], criteria: Sequence[CriterionCourse], marks: Mapping[str, float], title: str = ""
) -> Figure:
    """A panel for each derivative over the degree of flexibility and one for each criterion below; where a criterion fails, a line through all.

    ``marks``: degrees of the structures that have a name.
    """
    rows = -(-len(courses) // 3)
    sheet = make_sheet(
        [1.75] * rows + [1.2] * bool(criteria), (1.0,) * 3, count=3 * rows + len(criteria), row_gap=0.4, column_gap=0.6, left=0.66, share_x=False
    )
    for course, panel in zip(courses, sheet.panels, strict=False):
        _draw_derivative(panel, degrees, course)
    for number, (criterion, panel) in enumerate(zip(criteria, sheet.panels[3 * rows :], strict=True)):
        caption(panel, criterion.axis)
        panel.plot(degrees, np.clip(criterion.values, *criterion.window), color=_CRITERIA[number], marker=".", linewidth=1.2)
        panel.axhline(criterion.limit, color=BLACK, linewidth=0.8, linestyle=":")
        panel.margins(y=0.1)
    for number, panel in enumerate(sheet.panels):
        _dress(panel, degrees, criteria, marks if number < 3 * rows else {})
    for panel in sheet.panels[-max(len(criteria), 1) :]:
        panel.set_xlabel("degree of flexibility", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.3, bottom=0.5)


def _draw_derivative(panel: Axes, degrees: Sequence[float], course: DerivativeCourse) -> None:
    unit = display_unit(course.unit, course.name)
    caption(panel, axis_label(course.name, unit))
    panel.axhline(unit.factor * course.rigid, label="rigid, true", **TRUE)
    panel.plot(degrees, unit.factor * np.array(course.condensed), color=BLACK, linewidth=1.3, label="quasi-static equivalent")
    panel.plot(degrees, unit.factor * np.array(course.best), color=BLUE, linewidth=0.9, linestyle="--", label="best rigid model, no noise")
    shift = np.linspace(-0.03, 0.03, len(course.estimates)) if len(course.estimates) > 1 else [0.0]
    for number, (label, found) in enumerate(course.estimates.items()):
        colour, marker = _ESTIMATES[number % len(_ESTIMATES)]
        values, std = (unit.factor * np.array(part) for part in zip(*found, strict=True))
        places = np.array(degrees) * np.exp(shift[number])
        look: dict[str, Any] = {"fmt": marker, "color": colour, "markersize": 3.2, "linewidth": 0.9, "capsize": 1.5}
        panel.errorbar(places, values, yerr=2.0 * std, label=f"{plain(label)} ±2σ", **look)
    for each in course.published:
        printed: dict[str, Any] = {"fmt": "s", "color": VERMILION, "markersize": 4.5, "linewidth": 1.2, "capsize": 2.5, "label": "published ±2σ"}
        panel.errorbar([each.degree], [unit.factor * each.value], yerr=[2.0 * unit.factor * each.std], zorder=5, **printed)


def _dress(panel: Axes, degrees: Sequence[float], criteria: Sequence[CriterionCourse], marks: Mapping[str, float]) -> None:
    """Logarithmic axis, lines where criteria fail, names of structures above the panel."""
    panel.set_xscale("log")
    panel.set_xlim(0.8 * min(degrees), 1.3 * max(degrees))
    for number, criterion in enumerate(criteria):
        if criterion.degree is not None:
            panel.axvline(criterion.degree, color=_CRITERIA[number], linewidth=1.4, linestyle=_LINES[number], label=plain(criterion.label))
    for label, degree in marks.items():
        place: dict[str, Any] = {
            "xycoords": ("data", "axes fraction"),
            "ha": "center",
            "va": "bottom",
            "fontsize": TICK_SIZE - 1.0,
            "annotation_clip": False,
        }
        panel.annotate(plain(label), (degree, 1.0), **place)
