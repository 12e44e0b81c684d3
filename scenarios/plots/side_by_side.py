"""Figures that compare studies: estimates of each parameter, their errors, and outputs over
time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

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
    finish,
    make_sheet,
    method_style,
    text_width,
    time_axis,
    y_label,
)

# larger errors, in sigmas, become arrows
CLIPPED_SIGMAS = 8.0
CLIPPED_PERCENT = 40.0  # the same for errors in per cent
_LINE_HEIGHT = 0.14  # inches, one mark with its number


@dataclass(frozen=True)
class ParameterColumn:
    """A parameter in one study; unknown standard deviations are 0."""

    estimate: float
    std: float
    true: float | None = None
    condensed: float | None = None
    published: tuple[float, float] | None = None

    @property
    def reference(self) -> float | None:
        """Reference value of the error."""
        return self.true if self.condensed is None else self.condensed


@dataclass(frozen=True, eq=False)
class StudyResponse:
    """Measured and predicted outputs and inputs of one study at ``time (N,)``, SI, by name;
    ``units`` by channel.

    ``simulated``: a program made the record.
    """

    label: str
    time: np.ndarray
    inputs: Mapping[str, np.ndarray]
    measured: Mapping[str, np.ndarray]
    predicted: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    simulated: bool = False


Rows = Mapping[str, Sequence[ParameterColumn | None]]


def figure_studies_estimates(
    rows: Rows, units: Mapping[str, str], labels: Sequence[str], title: str = ""
) -> Figure:
    """Plot estimates, published, true and condensed values by study, one panel per parameter.

    Bars are two standard deviations. ``rows``: entries of all studies by parameter, None if a study
    has none. Studies with long names are numbered and listed under the title.
    """
    panels = PanelsOverNames.of(len(rows), labels, "study", title)
    for (name, row), panel in zip(rows.items(), panels.sheet.panels, strict=True):
        sizes = [
            max(
                abs(each.estimate),
                *(abs(x) for x in (each.true, each.condensed) if x is not None),
                0.0,
            )
            for each in row
            if each is not None
        ]
        base_unit = display_unit(units[name], name)
        unit = scaled_unit(base_unit, base_unit.factor * max(sizes))
        label = axis_label(name, unit)
        caption(panel, label if "$" in label else label.replace("_", " "))
        for x, each in enumerate(row):
            if each is not None:
                _draw_estimate(panel, float(x), each, unit.factor)
    return panels.finished(head=0.24)


def figure_studies_errors(rows: Rows, labels: Sequence[str], title: str = "") -> Figure:
    """Plot errors of each parameter by study, in % (left) and in reported sigmas (right).

    Reference is the condensed value if there is one, else the true value. Published values are
    open squares.
    """
    n, studies = len(rows), len(labels)
    printed = any(
        each is not None and each.published is not None for row in rows.values() for each in row
    )
    lines = studies * (2 if printed else 1)
    left = max(0.75, *(text_width(symbol(name)) + 0.25 for name in rows))
    sheet = make_sheet(
        [n * (lines + 0.8) * _LINE_HEIGHT], (1.0, 1.0), left=left, column_gap=0.3, share_x=False
    )
    percent, sigmas = sheet.panels
    sigmas.axvspan(-2.0, 2.0, color=LIGHT, alpha=0.55, linewidth=0, label="within ±2σ")
    step = 1.0 / (lines + 0.8)
    for place, row in enumerate(rows.values()):
        for number, each in enumerate(row):
            if each is None or each.reference is None:
                continue
            y = n - 1 - place + 0.5 - step * (0.9 + number * lines / studies)
            look = {
                "color": method_style(number)["color"],
                "marker": "o",
                "label": escaped_dollars(labels[number]),
            }
            _draw_errors(percent, sigmas, each, y, look)
            if each.published is not None:
                theirs = replace(each, estimate=each.published[0], std=each.published[1])
                _draw_errors(
                    percent,
                    sigmas,
                    theirs,
                    y - step,
                    {**look, "marker": "s", "markerfacecolor": "white", "label": ""},
                )
        for panel in sheet.panels if place else ():
            panel.axhline(n - place - 0.5, color=LIGHT, linewidth=0.6)
    if printed:
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
    studies: Sequence[StudyResponse], outputs: Sequence[str], title: str = ""
) -> Figure:
    """Plot recorded (dots) and predicted outputs (lines) of several studies over time.

    The inputs common to all studies are above. Angles in degrees.
    """
    inputs = [name for name in studies[0].inputs if all(name in each.inputs for each in studies)]
    sheet = make_sheet([1.15] * len(inputs) + [1.9] * len(outputs), row_gap=0.16)
    for name, panel in zip((*inputs, *outputs), sheet.panels, strict=True):
        unit = display_unit(
            next(
                each.units.get(name, "")
                for each in studies
                if name in each.inputs or name in each.measured
            )
        )
        for number, each in enumerate(studies):
            look = method_style(number)
            if name in inputs:
                panel.plot(
                    each.time, unit.factor * each.inputs[name], drawstyle="steps-post", **look
                )
            elif name in each.measured:
                panel.plot(
                    each.time,
                    unit.factor * each.measured[name],
                    ".",
                    color=look["color"],
                    markersize=3.0,
                    markeredgewidth=0.0,
                    alpha=0.5,
                )
                panel.plot(
                    each.time,
                    unit.factor * each.predicted[name],
                    label=escaped_dollars(each.label),
                    **look,
                )
        y_label(panel, axis_label(name, unit))
    kinds = sorted({SIMULATED_DATA if each.simulated else MEASURED_DATA for each in studies})
    sheet.panels[-1].plot(
        [], [], ".", color=BLACK, markersize=5.0, alpha=0.5, label=" or ".join(kinds)
    )
    time_axis(sheet.panels[-1])
    return finish(
        sheet,
        f"{title}\nlines: predicted, by a filter one sample ahead; dots: {' or '.join(kinds)}",
        head=0.1,
    )


def _draw_estimate(panel: Axes, x: float, each: ParameterColumn, factor: float) -> None:
    if each.true is not None:
        panel.plot([x - 0.4, x + 0.4], [factor * each.true] * 2, label="true", **TRUE)
    if each.condensed is not None:
        panel.plot(
            [x - 0.22],
            [factor * each.condensed],
            "D",
            color=BLACK,
            markersize=4.5,
            label="condensed",
        )
    _bar(panel, x, (each.estimate, each.std), factor, "o", BLUE, "estimated ±2σ")
    if each.published is not None:
        _bar(panel, x + 0.22, each.published, factor, "s", VERMILION, "published ±2σ")


def _bar(
    panel: Axes,
    x: float,
    value: tuple[float, float],
    factor: float,
    marker: str,
    colour: str,
    label: str,
) -> None:
    bar = [2.0 * factor * value[1]] if value[1] > 0.0 else None
    panel.errorbar(
        [x],
        [factor * value[0]],
        yerr=bar,
        fmt=marker,
        color=colour,
        markersize=4.5,
        linewidth=1.2,
        capsize=2.5,
        label=label,
    )


def _draw_errors(
    percent: Axes, sigmas: Axes, each: ParameterColumn, y: float, look: Mapping
) -> None:
    """Draw the error of one value in both panels."""
    if each.reference:
        _mark(
            percent,
            100.0 * (each.estimate - each.reference) / abs(each.reference),
            CLIPPED_PERCENT,
            y,
            look,
            "%",
        )
    if each.std > 0.0 and each.reference is not None:
        _mark(sigmas, (each.estimate - each.reference) / each.std, CLIPPED_SIGMAS, y, look, "σ")


def _mark(panel: Axes, error: float, limit: float, y: float, look: Mapping, unit: str) -> None:
    """A mark at the error, or an arrow at the edge with the error's size."""
    if abs(error) <= limit:
        panel.plot([error], [y], linestyle="none", markersize=5.0, **look)
        return
    side = float(np.sign(error))
    panel.plot(
        [side * 1.06 * limit],
        [y],
        linestyle="none",
        markersize=5.0,
        **{**look, "marker": ">" if side > 0 else "<"},
    )
    text = f"{signed(error, '.0f' if abs(error) < 1e4 else '.0e')} {unit}"
    place = {
        "ha": "right" if side > 0 else "left",
        "va": "center",
        "fontsize": TICK_SIZE,
        "color": look["color"],
    }
    panel.text(side * 1.01 * limit, y, text, **place)
