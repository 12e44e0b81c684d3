"""Errors of estimates in their own standard deviations, ours beside published ones; equivalent
derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scenarios.plots.display import axis_label, display_unit, plain, scaled_unit, signed, symbol
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
    caption,
    finish,
    folded,
    make_sheet,
    method_style,
    text_width,
    y_label,
)

CLIP = 8.0  # standard deviations; an error beyond becomes an arrow with its size
_LABEL = 2.0  # inches, where a label is folded
_OURS, _PUBLISHED = 0.17, -0.17  # offsets within a row


@dataclass(frozen=True)
class ComparisonRow:
    """One parameter: true value, estimate, standard deviation and, where there is one, the
    published value with its own.

    All in one unit. ``label`` is shown instead of the name's symbol, e.g. to tell methods apart.
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
    """One derivative of one flexible aircraft: rigid, statically condensed and estimated value, all
    in ``unit``.
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
    """Errors of one method on one flight in its own sigmas, ``(n, M)`` by derivative and run, and
    how often each outcome came.
    """

    method: str
    flight: str
    names: tuple[str, ...]
    sigmas: np.ndarray
    outcomes: Mapping[str, int]


def figure_repeated(clouds: Sequence[ErrorCloud], title: str = "") -> Figure:
    """Errors of all runs in reported sigmas, a panel a method: of each derivative a column of dots
    for each flight, its root mean square a bar.

    The band of two is shaded; errors beyond ``CLIP`` stand at the edge. Above a panel how many runs
    settled.
    """
    methods, flights = (
        list(dict.fromkeys(each.method for each in clouds)),
        list(dict.fromkeys(each.flight for each in clouds)),
    )
    sheet = make_sheet([1.45] * len(methods), row_gap=0.42)
    for method, panel in zip(methods, sheet.panels, strict=True):
        mine = [each for each in clouds if each.method == method]
        names = mine[0].names
        settled = ", ".join(
            f"{each.flight} {each.outcomes.get('converged', 0)} of {sum(each.outcomes.values())}"
            for each in mine
        )
        caption(panel, f"{method}; settled: {settled}")
        panel.axhspan(-2.0, 2.0, color=LIGHT, alpha=0.55, linewidth=0, label="within ±2σ")
        panel.axhline(0.0, **ZERO)
        for each in mine:
            place = flights.index(each.flight)
            style = {"color": method_style(place)["color"], "label": each.flight}
            offset = (place - 0.5 * (len(flights) - 1)) * 0.8 / len(flights)
            for i, errors in enumerate(each.sigmas):
                spread = np.linspace(-0.06, 0.06, max(len(errors), 1))[: len(errors)]
                shown = np.clip(errors, -CLIP, CLIP)
                panel.plot(
                    i + offset + spread, shown, ".", markersize=2.5, markeredgewidth=0.0, **style
                )
                if len(errors):
                    size = min(float(np.sqrt(np.mean(errors**2))), CLIP)
                    panel.plot(
                        [i + offset] * 2, [-size, size], "-", linewidth=1.4, color=style["color"]
                    )
        panel.set_xticks(range(len(names)), [symbol(name) for name in names])
        panel.tick_params(labelbottom=True)
        panel.set_xlim(-0.6, len(names) - 0.4)
        widest = max(
            (float(np.max(np.abs(each.sigmas), initial=0.0)) for each in mine), default=0.0
        )
        panel.set_ylim(*(np.array([-1.05, 1.05]) * min(max(widest, 3.5), CLIP)))
        panel.grid(False, axis="x")
        y_label(panel, "error (σ)")
    return finish(sheet, title, bottom=0.3, head=0.24)


def figure_comparison(rows: Sequence[ComparisonRow], title: str = "") -> Figure:
    """The error of each parameter, estimate minus true, in the standard deviations that its method
    itself states.

    The band of two is shaded. Errors in per cent stand at the right: a method that states a large
    deviation is not near the truth for being within it. A published value without a deviation has
    its per cent only.
    """
    n, has_published = len(rows), any(row.published is not None for row in rows)
    lines = [folded(plain(row.label), _LABEL) if row.label else [symbol(row.name)] for row in rows]
    labels = ["\n".join(some) for some in lines]
    left = max([1.0, *(text_width(line) + 0.2 for some in lines for line in some)])
    tallest = max((len(some) for some in lines), default=1)
    sheet = make_sheet(
        [(0.34 + 0.15 * max(0, tallest - 2)) * n + 0.1],
        count=min(n, 1),
        left=left,
        right=1.85 if has_published else 1.0,
    )
    panel = sheet.panels[0]
    # right edges of the columns of errors
    first, second = (1.0 + inches / (WIDTH - sheet.left - sheet.right) for inches in (0.8, 1.65))
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
        offset = _OURS if has_published else 0.0
        if row.std > 0:
            _point(panel, (row.estimate - row.true) / row.std, y + offset, "o", BLUE, "this study")
        _percent(panel, first, y, row.estimate, row.true, BLUE)
        if row.published is not None:
            if row.published_std is not None and row.published_std > 0:
                _point(
                    panel,
                    (row.published - row.true) / row.published_std,
                    y + _PUBLISHED,
                    "s",
                    VERMILION,
                    "published",
                )
            _percent(panel, second, y, row.published, row.true, VERMILION)
    panel.set_yticks(range(n), labels[::-1])
    panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
    panel.set_ylim(-0.55, n - 0.45)
    panel.set_xlim(-CLIP - 1.0, CLIP + 1.0)
    panel.set_xticks(np.arange(-CLIP, CLIP + 1.0, 2.0))
    panel.set_xlabel("error in its own standard deviations (σ)", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.22)


def figure_equivalents(rows: Sequence[EquivalentRow], title: str = "") -> Figure:
    """Equivalent derivatives, one panel each: rigid value (dashed), condensed, estimated and
    published for each aircraft.

    Bars are two standard deviations; where one is not seen it is smaller than its mark. Aircraft
    (or methods) with names too long for the axis are numbered there and named under the title.
    """
    names, aircraft = (
        list(dict.fromkeys(row.name for row in rows)),
        list(dict.fromkeys(row.aircraft for row in rows)),
    )
    columns = min(3, max(len(names), 1))
    sheet = make_sheet(
        [1.45] * -(-len(names) // columns),
        (1.0,) * columns,
        count=len(names),
        row_gap=0.42,
        column_gap=0.62,
        left=0.66,
    )
    room = (
        (WIDTH - sheet.left - sheet.right - sheet.column_gap * (columns - 1))
        / columns
        / max(len(aircraft), 1)
    )
    numbered = any(text_width(name, TICK_SIZE) > room for name in aircraft)
    if numbered:
        title = "\n".join(
            [title, *(f"{number}: {name}" for number, name in enumerate(aircraft, start=1))]
        )
    for name, panel in zip(names, sheet.panels, strict=True):
        of_name = [row for row in rows if row.name == name]
        # A power of ten stands in the unit, not above the axis.
        base = display_unit(of_name[0].unit, name)
        unit = scaled_unit(
            base,
            base.factor
            * max(
                abs(value) for row in of_name for value in (row.rigid, row.condensed, row.estimate)
            ),
        )
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
            _bar(panel, x, row.estimate, row.std, unit.factor, "o", BLUE, "estimated ±2σ")
            if row.published is not None:
                _bar(
                    panel,
                    x + 0.2,
                    row.published,
                    row.published_std,
                    unit.factor,
                    "s",
                    VERMILION,
                    "published ±2σ",
                )
        panel.set_xticks(
            range(len(aircraft)),
            [str(i + 1) if numbered else plain(name) for i, name in enumerate(aircraft)],
        )
        panel.tick_params(labelbottom=True)
        panel.set_xlim(-0.6, len(aircraft) - 0.4)
        panel.grid(False, axis="x")
        panel.margins(y=0.12)
    for panel in sheet.panels[-columns:] if numbered else ():
        panel.set_xlabel("method, as numbered above", fontsize=TICK_SIZE)
    return finish(sheet, title, bottom=0.5 if numbered else 0.3, head=0.26)


def _point(panel: Axes, error: float, y: float, marker: str, colour: str, label: str) -> None:
    """A mark at the error, or an arrow at the edge with the error's size."""
    if abs(error) <= CLIP:
        panel.plot(
            [error], [y], marker=marker, color=colour, markersize=5.5, linestyle="none", label=label
        )
        return
    side = float(np.sign(error))
    panel.plot(
        [side * (CLIP + 0.6)],
        [y],
        marker=">" if side > 0 else "<",
        color=colour,
        markersize=6.0,
        linestyle="none",
    )
    panel.plot([], [], marker=marker, color=colour, markersize=5.5, linestyle="none", label=label)
    text = f"{signed(error, '.0f' if abs(error) < 1e4 else '.0e')} σ"
    panel.text(
        side * (CLIP + 0.15),
        y,
        text,
        ha="right" if side > 0 else "left",
        va="center",
        fontsize=TICK_SIZE,
        color=colour,
    )


def _percent(panel: Axes, x: float, y: float, value: float, true: float, colour: str) -> None:
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


def _bar(
    panel: Axes,
    x: float,
    value: float,
    std: float | None,
    factor: float,
    marker: str,
    colour: str,
    label: str,
) -> None:
    bar = None if std is None else [2.0 * factor * std]
    panel.errorbar(
        [x],
        [factor * value],
        yerr=bar,
        fmt=marker,
        color=colour,
        markersize=4.5,
        linewidth=1.2,
        capsize=2.5,
        label=label,
    )
