"""Parameter estimates over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ident.estimate import FilterHistory
from scenarios.plots.display import DisplayUnit, axis_label, display_unit, scaled_unit
from scenarios.plots.histories import Course, course, settled_limits, sound_samples
from scenarios.plots.style import BLUE, GREEN, LABEL_SIZE, SKY, TICK_SIZE, TRUE, VERMILION, caption, finish, make_sheet, time_axis

ValueAndStd = tuple[float, float | None]


def figure_parameter_histories(
    history: FilterHistory,
    names: Sequence[str],
    units: Sequence[str],
    true: Mapping[str, float] | None = None,
    published: Mapping[str, ValueAndStd] | None = None,
    prior: Mapping[str, ValueAndStd] | None = None,
    title: str = "",
    true_label: str = "true",
) -> Figure:
    """Estimate and band of two standard deviations over time, one small panel for each parameter.

    Parameters
    ----------
    names, units : parameters (or states) to show, in the history; the axes show where they settle, so a wide band may
        begin outside.
    true : dashed lines, named ``true_label``. published : a square after the last sample, prior : a diamond before the first, each with two
        standard deviations where these are known. One far outside the panel becomes an arrow with its value.

    After a breakdown the course ends, and its panels say when.
    """
    true, published, prior = true or {}, published or {}, prior or {}
    columns = 2 if len(names) <= 4 else 3
    rows = -(-len(names) // columns)
    sheet = make_sheet([1.15] * rows, (1.0,) * columns, count=len(names), row_gap=0.36, column_gap=0.58, left=0.6)
    sound = sound_samples(history)
    broke = sound < len(history.time)
    for name, unit, panel in zip(names, units, sheet.panels, strict=True):
        shown = _unit(history, name, unit, true.get(name, 0.0))
        late = f", ends at {history.time[sound - 1]:.3g} s" if broke and sound else ""
        caption(panel, axis_label(name, shown) + late, LABEL_SIZE)
        if sound == 0:
            caption(panel, f"{axis_label(name, shown)}: no sound sample", LABEL_SIZE)
            continue
        path = course(history, name, shown.factor)
        _panel(panel, path, history, shown, published.get(name), prior.get(name), true.get(name), true_label)
    for panel in sheet.panels[-columns:]:
        time_axis(panel)
    return finish(sheet, title, head=0.24)


def _unit(history: FilterHistory, name: str, unit: str, true: float) -> DisplayUnit:
    """The unit with the power of a thousand that suits the largest of truth, later estimates and their bands."""
    base, path = display_unit(unit, name), course(history, name)
    later = slice(len(history.time) // 2, None)
    reached = np.abs(path.mean[later]) + 2.0 * path.std[later]
    return scaled_unit(base, base.factor * max(abs(true), float(reached.max(initial=0.0))))


def _panel(
    panel: Axes,
    path: Course,
    history: FilterHistory,
    unit: DisplayUnit,
    published: ValueAndStd | None,
    prior: ValueAndStd | None,
    true: float | None,
    true_label: str,
) -> None:
    low, high = path.mean - 2.0 * path.std, path.mean + 2.0 * path.std
    panel.fill_between(path.time, low, high, color=SKY, alpha=0.35, linewidth=0, label="±2σ")
    panel.plot(path.time, path.mean, color=BLUE, linewidth=1.2, label="estimate")
    marks = [] if true is None else [unit.factor * true]
    if true is not None:
        panel.axhline(marks[0], label=true_label, zorder=3, **TRUE)
    bottom, top = settled_limits(low, path.mean, high, marks)
    first, last = float(history.time[0]), float(history.time[-1])
    pad = 0.05 * (last - first)
    span = top - bottom
    for entry in (published, prior):
        # A mark that lies not far outside widens the panel, one far away may not squeeze the course.
        if entry is not None and bottom - 0.6 * span <= unit.factor * entry[0] <= top + 0.6 * span:
            bottom, top = min(bottom, unit.factor * entry[0] - 0.05 * span), max(top, unit.factor * entry[0] + 0.05 * span)
    panel.set_ylim(bottom, top)
    panel.set_xlim(first - pad, last + pad)
    _mark(panel, last + 0.5 * pad, published, unit, "s", VERMILION, "published ±2σ")
    _mark(panel, first - 0.5 * pad, prior, unit, "D", GREEN, "prior ±2σ")


def _mark(panel: Axes, x: float, entry: ValueAndStd | None, unit: DisplayUnit, marker: str, colour: str, label: str) -> None:
    if entry is None:
        return
    value, std = unit.factor * entry[0], None if entry[1] is None else 2.0 * unit.factor * entry[1]
    bottom, top = panel.get_ylim()
    inside = bottom <= value <= top
    panel.errorbar([x], [value], yerr=None if std is None else [std], fmt=marker, color=colour, markersize=4.0, linewidth=1.2, label=label)
    if not inside:
        edge, end = (top, "^") if value > top else (bottom, "v")
        panel.plot([x], [edge], marker=end, color=colour, markersize=5.0, clip_on=False, zorder=5)
        side = "right" if x > panel.get_xlim()[0] + 0.5 * (panel.get_xlim()[1] - panel.get_xlim()[0]) else "left"
        panel.annotate(
            f"{value:.4g}".replace("-", "−"),
            (x, edge),
            xytext=(-6 if side == "right" else 6, -2 if value > top else 2),
            textcoords="offset points",
            ha=side,
            va="top" if value > top else "bottom",
            fontsize=TICK_SIZE - 1,
            color=colour,
            zorder=6,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8},
        )
