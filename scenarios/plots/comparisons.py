"""Figures that compare estimates with true and published values: of one study, over repeated
flights, and of several studies side by side, with their outputs over time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scenarios.plots.display import (
    MEASURED_DATA,
    SIMULATED_DATA,
    StudyResponses,
    StudyValue,
    axis_label,
    display_unit,
    escaped_dollars,
    scaled_unit,
    signed,
    symbol,
)
from scenarios.plots.style import (
    BLACK,
    BLUE,
    LABEL_SIZE,
    LIGHT,
    TICK_SIZE,
    TRUE,
    VERMILION,
    WIDTH,
    ZERO,
    PanelsOverNames,
    caption,
    draw_bar,
    finish,
    folded,
    make_sheet,
    method_style,
    text_width,
    time_axis,
    y_label,
)

CLIPPED_SIGMAS = 8.0  # standard deviations; a larger error is an arrow with its size
_LABEL_WIDTH = 2.0  # inches; a longer label is folded
_OWN_OFFSET = 0.17  # offset of the errors of this study within a row
_PUBLISHED_OFFSET = -0.17  # offset of the errors of published estimates within a row


@dataclass(frozen=True)
class ComparisonRow:
    """A parameter beside its true and its published value, all in the same unit.

    Attributes
    ----------
    name : name of the parameter.
    true : true value.
    estimate, std : estimate and its standard deviation.
    published, published_std : published estimate and its standard deviation, or None.
    label : text in place of the symbol, to tell methods apart; empty for the symbol.
    """

    name: str
    true: float
    estimate: float
    std: float
    published: float | None = None
    published_std: float | None = None
    label: str = ""


@dataclass(frozen=True)
class EquivalentRow:
    """A derivative of a flexible aircraft, in ``unit``.

    Attributes
    ----------
    aircraft : name of the aircraft or method.
    name, unit : the derivative and its unit.
    rigid : value of the rigid aircraft.
    condensed : value with the elastic modes statically condensed.
    estimate, std : estimate and its standard deviation.
    published, published_std : published estimate and its standard deviation, or None.
    """

    aircraft: str
    name: str
    unit: str
    rigid: float
    condensed: float
    estimate: float
    std: float
    published: float | None = None
    published_std: float | None = None


@dataclass(frozen=True, eq=False)
class ErrorCloud:
    """Errors of a method on M repetitions of a flight.

    Attributes
    ----------
    method, flight : labels.
    names : names of the n derivatives.
    sigmas : errors over reported sigmas, shape ``(n, M)``.
    outcomes : outcome code -> number of runs.
    """

    method: str
    flight: str
    names: tuple[str, ...]
    sigmas: np.ndarray
    outcomes: Mapping[str, int]


def figure_repeated(clouds: Sequence[ErrorCloud], title: str = "") -> Figure:
    """Plot the errors of all runs in reported sigmas, a panel for each method.

    Each derivative has a column of dots for each flight, and a bar for their root mean square. The
    band of two sigmas is shaded. Errors beyond ``CLIPPED_SIGMAS`` stand at the edge. The caption of
    a panel has the number of runs that converged.
    """
    methods = list(dict.fromkeys(cloud.method for cloud in clouds))
    flights = list(dict.fromkeys(cloud.flight for cloud in clouds))
    sheet = make_sheet([1.45] * len(methods), row_gap=0.42)
    for method, panel in zip(methods, sheet.panels, strict=True):
        of_method = [cloud for cloud in clouds if cloud.method == method]
        names = of_method[0].names
        converged = ", ".join(
            f"{cloud.flight} {cloud.outcomes.get('converged', 0)} of {sum(cloud.outcomes.values())}"
            for cloud in of_method
        )
        caption(panel, f"{method}; settled: {converged}")
        panel.axhspan(-2.0, 2.0, color=LIGHT, alpha=0.55, linewidth=0, label="within ±2σ")
        panel.axhline(0.0, **ZERO)
        for cloud in of_method:
            number = flights.index(cloud.flight)
            style = {"color": method_style(number)["color"], "label": cloud.flight}
            # The columns of all flights share 0.8 of the distance between derivatives.
            offset = (number - 0.5 * (len(flights) - 1)) * 0.8 / len(flights)
            for i, errors in enumerate(cloud.sigmas):
                spread = np.linspace(-0.06, 0.06, max(len(errors), 1))[: len(errors)]
                shown = np.clip(errors, -CLIPPED_SIGMAS, CLIPPED_SIGMAS)
                panel.plot(
                    i + offset + spread, shown, ".", markersize=2.5, markeredgewidth=0.0, **style
                )
                if len(errors):
                    rms = min(float(np.sqrt(np.mean(errors**2))), CLIPPED_SIGMAS)
                    panel.plot(
                        [i + offset] * 2, [-rms, rms], "-", linewidth=1.4, color=style["color"]
                    )
        panel.set_xticks(range(len(names)), [symbol(name) for name in names])
        panel.tick_params(labelbottom=True)
        panel.set_xlim(-0.6, len(names) - 0.4)
        largest = max(float(np.max(np.abs(cloud.sigmas), initial=0.0)) for cloud in of_method)
        panel.set_ylim(*(np.array([-1.05, 1.05]) * min(max(largest, 3.5), CLIPPED_SIGMAS)))
        panel.grid(False, axis="x")
        y_label(panel, "error (σ)")
    return finish(sheet, title, bottom=0.3, head=0.24)


def figure_comparison(rows: Sequence[ComparisonRow], title: str = "") -> Figure:
    """Plot the error of each parameter, estimate minus true, in its own standard deviations.

    The band of two standard deviations is shaded. Errors in per cent stand at the right: an
    estimate within a large standard deviation may be far from the true value. A published value
    without a standard deviation has only its per cent.
    """
    n, has_published = len(rows), any(row.published is not None for row in rows)
    lines = [
        folded(escaped_dollars(row.label), _LABEL_WIDTH) if row.label else [symbol(row.name)]
        for row in rows
    ]
    labels = ["\n".join(label_lines) for label_lines in lines]
    left = max([1.0, *(text_width(line) + 0.2 for label_lines in lines for line in label_lines)])
    tallest = max((len(label_lines) for label_lines in lines), default=1)
    sheet = make_sheet(
        [(0.34 + 0.15 * max(0, tallest - 2)) * n + 0.1],
        count=min(n, 1),
        left=left,
        right=1.85 if has_published else 1.0,
    )
    panel = sheet.panels[0]
    # Right edges of the columns of errors in per cent, as shares of the panel.
    panel_width = WIDTH - sheet.left - sheet.right
    first, second = 1.0 + 0.8 / panel_width, 1.0 + 1.65 / panel_width
    panel.axvspan(-2.0, 2.0, color=LIGHT, alpha=0.55, linewidth=0, label="within ±2σ")
    panel.axvline(0.0, **ZERO)
    heading = n - 0.35
    for x, text, colour in ((first, "this study", BLUE), (second, "published", VERMILION)):
        if has_published or colour == BLUE:
            panel.text(
                x,
                heading,
                text,
                transform=panel.get_yaxis_transform(),
                ha="right",
                va="bottom",
                fontsize=TICK_SIZE,
                color=colour,
            )
    for place, row in enumerate(rows):
        y = float(n - 1 - place)
        offset = _OWN_OFFSET if has_published else 0.0
        if row.std > 0:
            _point(panel, (row.estimate - row.true) / row.std, y + offset, "o", BLUE, "this study")
        _percent(panel, first, y, row.estimate, row.true, BLUE)
        if row.published is not None:
            if row.published_std is not None and row.published_std > 0:
                _point(
                    panel,
                    (row.published - row.true) / row.published_std,
                    y + _PUBLISHED_OFFSET,
                    "s",
                    VERMILION,
                    "published",
                )
            _percent(panel, second, y, row.published, row.true, VERMILION)
    panel.set_yticks(range(n), labels[::-1])
    panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
    panel.set_ylim(-0.55, n - 0.45)
    panel.set_xlim(-CLIPPED_SIGMAS - 1.0, CLIPPED_SIGMAS + 1.0)
    panel.set_xticks(np.arange(-CLIPPED_SIGMAS, CLIPPED_SIGMAS + 1.0, 2.0))
    panel.set_xlabel("error in its own standard deviations (σ)", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.22)


def figure_equivalents(rows: Sequence[EquivalentRow], title: str = "") -> Figure:
    """Plot equivalent derivatives, a panel for each.

    For each aircraft it has the rigid value (dashed) and the condensed, the estimated and the
    published value. Bars are two standard deviations; a bar that is not visible is smaller than its
    mark. Aircraft (or methods) whose names are too long for the axis have numbers there, with the
    names under the title.
    """
    names = list(dict.fromkeys(row.name for row in rows))
    aircraft = list(dict.fromkeys(row.aircraft for row in rows))
    panels = PanelsOverNames.of(len(names), aircraft, "method", title)
    for name, panel in zip(names, panels.sheet.panels, strict=True):
        of_name = [row for row in rows if row.name == name]
        # A power of ten stands in the unit, not above the axis.
        base = display_unit(of_name[0].unit, name)
        values = (value for row in of_name for value in (row.rigid, row.condensed, row.estimate))
        unit = scaled_unit(base, base.factor * max(map(abs, values)))
        caption(panel, axis_label(name, unit), LABEL_SIZE)
        for row in of_name:
            x = float(aircraft.index(row.aircraft))
            panel.plot(
                [x - 0.4, x + 0.4], [unit.factor * row.rigid] * 2, label="rigid, true", **TRUE
            )
            panel.plot(
                [x - 0.2],
                [unit.factor * row.condensed],
                "D",
                color=BLACK,
                markersize=4.5,
                label="condensed",
            )
            factor = unit.factor
            estimate, std = factor * row.estimate, factor * row.std
            draw_bar(panel, x, estimate, std, "o", BLUE, "estimated ±2σ")
            if row.published is not None:
                value, std = factor * row.published, factor * (row.published_std or 0.0)
                draw_bar(panel, x + 0.2, value, std, "s", VERMILION, "published ±2σ")
    return panels.finished(head=0.26)


def _point(panel: Axes, error: float, y: float, marker: str, colour: str, label: str) -> None:
    """Draw a mark at an error, or an arrow at the edge with the size of a large error."""
    if abs(error) <= CLIPPED_SIGMAS:
        panel.plot(
            [error], [y], marker=marker, color=colour, markersize=5.5, linestyle="none", label=label
        )
        return
    side = float(np.sign(error))
    panel.plot(
        [side * (CLIPPED_SIGMAS + 0.6)],
        [y],
        marker=">" if side > 0 else "<",
        color=colour,
        markersize=6.0,
        linestyle="none",
    )
    panel.plot([], [], marker=marker, color=colour, markersize=5.5, linestyle="none", label=label)
    text = f"{signed(error, '.0f' if abs(error) < 1e4 else '.0e')} σ"
    panel.text(
        side * (CLIPPED_SIGMAS + 0.15),
        y,
        text,
        ha="right" if side > 0 else "left",
        va="center",
        fontsize=TICK_SIZE,
        color=colour,
    )


def _percent(panel: Axes, x: float, y: float, value: float, true: float, colour: str) -> None:
    """Write the error of a value in per cent; a dash if the true value is zero."""
    text = f"{signed(100.0 * (value - true) / abs(true), '.3g')} %" if true else "–"
    panel.text(
        x,
        y,
        text,
        transform=panel.get_yaxis_transform(),
        ha="right",
        va="center",
        fontsize=TICK_SIZE,
        color=colour,
    )


# ---- Several studies side by side

CLIPPED_PERCENT = 40.0  # larger errors are drawn as arrows
_LINE_HEIGHT = 0.14  # inches, height of a mark
_PANEL_GAP_LINES = 0.8  # space between parameters, in lines


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
    studies: Mapping[str, StudyResponses], outputs: Sequence[str], title: str = ""
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
