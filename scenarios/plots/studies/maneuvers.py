"""Maneuvers that are compared: inputs and responses over time, with limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from matplotlib.figure import Figure

from scenarios.plots.display import axis_label, display_unit, plain
from scenarios.plots.style import (
    BLACK,
    GREY,
    LABEL_SIZE,
    decades,
    finish,
    make_sheet,
    method_style,
    time_axis,
    y_label,
)

_LIMIT: dict[str, Any] = {"color": BLACK, "linestyle": (0, (4, 2)), "linewidth": 0.8}
_IN_SIGHT = 1.6  # of what is flown: limits farther off are left out of the panel


@dataclass(frozen=True, eq=False)
class Course:
    """One maneuver: inputs and outputs by name, ``(N,)`` each, load factors as totals."""

    label: str
    inputs: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]


def figure_maneuvers(
    time: np.ndarray, courses: Sequence[Course], limits: Mapping[str, tuple[float, float]], units: Mapping[str, str], title: str = ""
) -> Figure:
    """A column a maneuver, the first the best; a row an input, held between samples, and an output; angles in degrees.

    ``limits``: lowest and highest by name, drawn where they are near what is flown.
    """
    names = [*courses[0].inputs, *courses[0].outputs]
    count = len(courses)
    sheet = make_sheet([1.0] * len(names), (1.0,) * count, column_gap=0.25, row_gap=0.12)
    for row, name in enumerate(names):
        unit = display_unit(units.get(name, ""), name)
        flown = [unit.factor * {**course.inputs, **course.outputs}[name] for course in courses]
        low, high = min(float(each.min()) for each in flown), max(float(each.max()) for each in flown)
        near = [unit.factor * end for end in limits.get(name, ()) if np.isfinite(end)]
        reach = _IN_SIGHT * (max(abs(low), abs(high)) or 1.0)
        shown = [end for end in near if abs(end) <= reach]
        low, high = min([low, *shown]), max([high, *shown])
        margin = 0.06 * (high - low) or 1.0
        for column, (course, values) in enumerate(zip(courses, flown, strict=True)):
            panel = sheet.axes[row][column]
            style: dict[str, Any] = {"drawstyle": "steps-post"} if name in course.inputs else {}
            look = method_style(column, alone=True)
            panel.plot(time, values, label=plain(course.label), color=look["color"], linewidth=1.0, **style)
            for end in shown:
                panel.axhline(end, **_LIMIT)
            panel.set_ylim(low - margin, high + margin)
            if column:
                panel.tick_params(labelleft=False)
        y_label(sheet.axes[row][0], axis_label(name, unit))
    for panel in sheet.axes[-1]:
        time_axis(panel)
    return finish(sheet, title, head=0.12)


class Expected(Protocol):
    """Frequency responses that are expected of one flight."""

    @property
    def frequency(self) -> np.ndarray: ...
    @property
    def inputs(self) -> Sequence[str]: ...
    @property
    def outputs(self) -> Sequence[str]: ...
    @property
    def coherence(self) -> np.ndarray: ...


def figure_coherence(kinds: Sequence[tuple[str, Any]], title: str = "") -> Figure:
    """Expected coherence over frequency: a row an output, a column an input, a line a maneuver.

    ``kinds`` : name of the maneuver and its ``Expected`` responses.
    """
    first: Expected = kinds[0][1]
    sheet = make_sheet([1.0] * len(first.outputs), (1.0,) * len(first.inputs), column_gap=0.25, row_gap=0.12)
    for m, output in enumerate(first.outputs):
        for q, name in enumerate(first.inputs):
            panel = sheet.axes[m][q]
            for number, (kind, found) in enumerate(kinds):
                look = method_style(number, alone=True)
                panel.plot(found.frequency, found.coherence[m, q], label=plain(kind), color=look["color"], linewidth=1.2)
            panel.axhline(0.6, color=GREY, linewidth=0.7, linestyle=":")
            panel.set_xscale("log")
            panel.set_xlim(float(first.frequency[0]), float(first.frequency[-1]))
            panel.set_ylim(0.0, 1.02)
            decades(panel.xaxis, (1.0, 2.0, 5.0))
            if q:
                panel.tick_params(labelleft=False)
            if m == len(first.outputs) - 1:
                panel.set_xlabel(f"frequency (Hz), {plain(name)}", fontsize=LABEL_SIZE)
        y_label(sheet.axes[m][0], f"{plain(output)} (–)")
    return finish(sheet, title, head=0.12)
