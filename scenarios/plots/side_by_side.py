"""Figures that compare studies: estimates of parameters, their errors, and outputs over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scenarios.plots.display import (
    MEASURED_DATA,
    SIMULATED_DATA,
    axis_label,
    display_unit,
    escaped_dollars,
    scaled_unit,
    signed,
    symbol,
)
from scenarios.plots.residuals import CLIPPED_SIGMAS
from scenarios.plots.style import (
    BLACK,
    BLUE,
    LABEL_SIZE,
    LIGHT,
    TICK_SIZE,
    TRUE,
    VERMILION,
    ZERO,
    PanelsOverNames,
    caption,
    draw_bar,
    finish,
    make_sheet,
    method_style,
    text_width,
    time_axis,
    y_label,
)

CLIPPED_PERCENT = 40.0  # larger errors are drawn as arrows
_LINE_HEIGHT = 0.14  # inches, height of a mark
_PANEL_GAP_LINES = 0.8  # space between parameters, in lines


class StudyValue(Protocol):
    """Estimate of a parameter in one study, with errors from its reference value.

    The reference value is the value with the elastic modes statically condensed if the study has
    it, else the true value.
    """

    @property
    def estimate(self) -> float: ...
    @property
    def std(self) -> float: ...
    @property
    def true(self) -> float | None: ...
    @property
    def condensed(self) -> float | None: ...
    @property
    def reference(self) -> float | None: ...
    @property
    def percent(self) -> float | None: ...
    @property
    def sigmas(self) -> float | None: ...
    @property
    def published_value(self) -> StudyValue | None: ...


class StudyOutputs(Protocol):
    """Signals of one study in SI units, ``(N,)`` each, by name, over ``time`` in s."""

    @property
    def time(self) -> np.ndarray: ...
    @property
    def inputs(self) -> Mapping[str, np.ndarray]: ...
    @property
    def measured(self) -> Mapping[str, np.ndarray]: ...
    @property
    def predicted(self) -> Mapping[str, np.ndarray]: ...
    @property
    def units(self) -> Mapping[str, str]: ...
    @property
    def simulated(self) -> bool: ...


# Parameter -> its value in each study; None if a study does not have it.
Rows = Mapping[str, Sequence[StudyValue | None]]


def figure_studies_estimates(
    rows: Rows, units: Mapping[str, str], labels: Sequence[str], title: str = ""
) -> Figure:
    """Plot estimates, published, true and condensed values by study, one panel per parameter.

    Bars are two standard deviations. Studies with long names are numbered and listed under the
    title.
    """
    panels = PanelsOverNames.of(len(rows), labels, "study", title)
    for (name, row), panel in zip(rows.items(), panels.sheet.panels, strict=True):
        numbers = [
            number
            for value in row
            if value is not None
            for number in (value.estimate, value.true, value.condensed)
            if number is not None
        ]
        base_unit = display_unit(units[name], name)
        unit = scaled_unit(base_unit, base_unit.factor * max(map(abs, numbers)))
        label = axis_label(name, unit)
        caption(panel, label if "$" in label else label.replace("_", " "))
        for place, value in enumerate(row):
            if value is not None:
                _draw_estimate(panel, float(place), value, unit.factor)
    return panels.finished(head=0.24)


def figure_studies_errors(rows: Rows, labels: Sequence[str], title: str = "") -> Figure:
    """Plot errors of each parameter by study, in % (left) and in reported sigmas (right).

    Published values are open squares.
    """
    n, studies = len(rows), len(labels)
    has_published = any(
        value is not None and value.published_value is not None
        for row in rows.values()
        for value in row
    )
    lines = studies * (2 if has_published else 1)
    height = lines + _PANEL_GAP_LINES  # of a parameter, in lines
    left = max(0.75, *(text_width(symbol(name)) + 0.25 for name in rows))
    sheet = make_sheet(
        [n * height * _LINE_HEIGHT], (1.0, 1.0), left=left, column_gap=0.3, share_x=False
    )
    percent, sigmas = sheet.panels
    sigmas.axvspan(-2.0, 2.0, color=LIGHT, alpha=0.55, linewidth=0, label="within ±2σ")
    step = 1.0 / height
    for place, row in enumerate(rows.values()):
        for number, value in enumerate(row):
            if value is None:
                continue
            y = n - 1 - place + 0.5 - step * (0.9 + number * lines / studies)
            style = {
                "color": method_style(number)["color"],
                "marker": "o",
                "label": escaped_dollars(labels[number]),
            }
            _draw_errors(percent, sigmas, value, y, style)
            if value.published_value is not None:
                open_square = {"marker": "s", "markerfacecolor": "white", "label": ""}
                published_style = {**style, **open_square}
                _draw_errors(percent, sigmas, value.published_value, y - step, published_style)
        if place:
            for panel in sheet.panels:
                panel.axhline(n - place - 0.5, color=LIGHT, linewidth=0.6)
    if has_published:
        sigmas.plot(
            [], [], "s", color=BLACK, markerfacecolor="white", markersize=5.0, label="published"
        )
    for panel, limit, text in (
        (percent, CLIPPED_PERCENT, "error (%)"),
        (sigmas, CLIPPED_SIGMAS, "error in own standard deviations (σ)"),
    ):
        panel.axvline(0.0, **ZERO)
        panel.set_xlim(-1.12 * limit, 1.12 * limit)
        panel.set_xticks(np.linspace(-limit, limit, 9 if panel is sigmas else 5))
        panel.set_ylim(-0.5, n - 0.5)
        panel.set_xlabel(text, fontsize=LABEL_SIZE)
        panel.grid(False, axis="y")
        panel.set_yticks(
            range(n), [symbol(name) for name in rows][::-1] if panel is percent else [""] * n
        )
        panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
    return finish(sheet, title, head=0.08)


def figure_studies_responses(
    studies: Mapping[str, StudyOutputs], outputs: Sequence[str], title: str = ""
) -> Figure:
    """Plot recorded (dots) and predicted outputs (lines) of several studies over time.

    The inputs common to all studies are above. Angles are in degrees. ``studies``: by label.
    """
    signals = list(studies.values())
    inputs = [name for name in signals[0].inputs if all(name in study.inputs for study in signals)]
    sheet = make_sheet([1.15] * len(inputs) + [1.9] * len(outputs), row_gap=0.16)
    for name, panel in zip((*inputs, *outputs), sheet.panels, strict=True):
        unit = display_unit(
            next(
                study.units.get(name, "")
                for study in signals
                if name in study.inputs or name in study.measured
            )
        )
        for number, (label, study) in enumerate(studies.items()):
            style = method_style(number)
            if name in inputs:
                panel.plot(
                    study.time, unit.factor * study.inputs[name], drawstyle="steps-post", **style
                )
            elif name in study.measured:
                panel.plot(
                    study.time,
                    unit.factor * study.measured[name],
                    ".",
                    color=style["color"],
                    markersize=3.0,
                    markeredgewidth=0.0,
                    alpha=0.5,
                )
                panel.plot(
                    study.time,
                    unit.factor * study.predicted[name],
                    label=escaped_dollars(label),
                    **style,
                )
        y_label(panel, axis_label(name, unit))
    kinds = sorted({SIMULATED_DATA if study.simulated else MEASURED_DATA for study in signals})
    sheet.panels[-1].plot(
        [], [], ".", color=BLACK, markersize=5.0, alpha=0.5, label=" or ".join(kinds)
    )
    time_axis(sheet.panels[-1])
    return finish(
        sheet,
        f"{title}\nlines: predicted, by a filter one sample ahead; dots: {' or '.join(kinds)}",
        head=0.1,
    )


def _draw_estimate(panel: Axes, x: float, value: StudyValue, factor: float) -> None:
    if value.true is not None:
        panel.plot([x - 0.4, x + 0.4], [factor * value.true] * 2, label="true", **TRUE)
    if value.condensed is not None:
        panel.plot(
            [x - 0.22],
            [factor * value.condensed],
            "D",
            color=BLACK,
            markersize=4.5,
            label="condensed",
        )
    published = value.published_value
    for place, shown, marker, colour, label in (
        (x, value, "o", BLUE, "estimated ±2σ"),
        (x + 0.22, published, "s", VERMILION, "published ±2σ"),
    ):
        if shown is not None:
            number, std = factor * shown.estimate, factor * shown.std
            draw_bar(panel, place, number, std, marker, colour, label)


def _draw_errors(
    percent: Axes, sigmas: Axes, value: StudyValue, y: float, style: Mapping[str, Any]
) -> None:
    if value.percent is not None:
        _mark(percent, value.percent, CLIPPED_PERCENT, y, style, "%")
    if value.sigmas is not None:
        _mark(sigmas, value.sigmas, CLIPPED_SIGMAS, y, style, "σ")


def _mark(panel: Axes, error: float, limit: float, y: float, style: Mapping, unit: str) -> None:
    """Draw a mark at the error; for a large error, an arrow at the edge with its size."""
    if abs(error) <= limit:
        panel.plot([error], [y], linestyle="none", markersize=5.0, **style)
        return
    side = float(np.sign(error))
    panel.plot(
        [side * 1.06 * limit],
        [y],
        linestyle="none",
        markersize=5.0,
        **{**style, "marker": ">" if side > 0 else "<"},
    )
    text = f"{signed(error, '.0f' if abs(error) < 1e4 else '.0e')} {unit}"
    place = {
        "ha": "right" if side > 0 else "left",
        "va": "center",
        "fontsize": TICK_SIZE,
        "color": style["color"],
    }
    panel.text(side * 1.01 * limit, y, text, **place)
