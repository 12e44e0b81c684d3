"""Figures of a fleet of flights: which has which effect, values that are shared, derivatives over the flight condition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from scenarios.plots.display import axis_label, display_unit, plain
from scenarios.plots.style import BLACK, BLUE, GREY, LABEL_SIZE, LIGHT, TICK_SIZE, VERMILION, finish, make_sheet, text_width, y_label

_PANEL, _ROW = 1.15, 0.3  # inches
_SHOWN = 5.0  # inner spreads of the values, beyond which an error bar that tells nothing is cut
_FLIGHTS, _LONGEST = 45, 12  # names, and letters in them, that stand at the axis without touching


@dataclass(frozen=True, eq=False)
class Line:
    """A line ``(k,)`` over ``along (k,)`` with its sigma ``(k,)``, and the scatter of flights about it."""

    along: np.ndarray
    middle: np.ndarray
    sigma: np.ndarray
    scatter: float


@dataclass(frozen=True, eq=False)
class OverCondition:
    """A derivative of n flights over a condition: values and sigmas ``(n,)``, which flights stand out, and the pooled line."""

    name: str
    unit: str
    condition: np.ndarray
    values: np.ndarray
    sigmas: np.ndarray
    out: np.ndarray
    line: Line


@dataclass(frozen=True, eq=False)
class Shared:
    """A parameter that flights share: each flight's own value and sigma ``(n,)`` over the condition ``(n,)``, which have it, and the common one."""

    name: str
    unit: str
    condition: np.ndarray
    values: np.ndarray
    sigmas: np.ndarray
    has: np.ndarray
    common: float
    common_sigma: float


def figure_over_condition(rows: Sequence[OverCondition], condition: str, unit: str, title: str = "") -> Figure:
    """A panel a derivative: each flight with two sigmas, the pooled line with its band, and the scatter of the flights about it."""
    sheet = make_sheet([_PANEL] * (-(-len(rows) // 2)), (1.0, 1.0) if len(rows) > 1 else (1.0,), count=len(rows), row_gap=0.16)
    across = display_unit(unit, condition)
    for row, panel in zip(rows, sheet.panels, strict=True):
        shown = display_unit(row.unit, row.name)
        at, along = across.factor * row.condition, across.factor * row.line.along
        middle, sigma = shown.factor * row.line.middle, shown.factor * row.line.sigma
        wide = 2.0 * np.hypot(sigma, shown.factor * row.line.scatter)
        panel.fill_between(along, middle - wide, middle + wide, color=LIGHT, alpha=0.6, linewidth=0, label="flights within ±2σ")
        panel.fill_between(along, middle - 2 * sigma, middle + 2 * sigma, color=BLUE, alpha=0.3, linewidth=0, label="pooled ±2σ")
        panel.plot(along, middle, "-", color=BLUE, linewidth=1.2, label="pooled")
        for chosen, colour, label in ((~row.out, BLACK, "one flight ±2σ"), (row.out, VERMILION, "stands out")):
            if np.any(chosen):
                values, sigmas = shown.factor * row.values[chosen], shown.factor * row.sigmas[chosen]
                panel.errorbar(at[chosen], values, 2 * sigmas, fmt=".", color=colour, markersize=4.5, elinewidth=0.7, label=label)
        _limits(panel, shown.factor * row.values, shown.factor * row.sigmas)
        y_label(panel, axis_label(row.name, shown))
    for panel in sheet.panels[-len(sheet.widths) :]:
        panel.set_xlabel(axis_label(condition, across), fontsize=LABEL_SIZE)
    return finish(sheet, title)


def figure_shared(rows: Sequence[Shared], condition: str, unit: str, title: str = "") -> Figure:
    """A panel an effect: the value of each flight by itself over the condition, and the common one of the flights that have it."""
    sheet = make_sheet([1.35] * len(rows), row_gap=0.2)
    across = display_unit(unit, condition)
    for row, panel in zip(rows, sheet.panels, strict=True):
        shown = display_unit(row.unit, row.name.rpartition(" ")[2])
        low, high = (shown.factor * (row.common + side * 2 * row.common_sigma) for side in (-1, 1))
        panel.axhspan(low, high, color=BLUE, alpha=0.3, linewidth=0, label="common value ±2σ")
        panel.axhline(shown.factor * row.common, color=BLUE, linewidth=1.2)
        for chosen, colour, label in ((row.has, BLACK, "has it, ±2σ"), (~row.has, GREY, "has it not, or not told")):
            if np.any(chosen):
                values, sigmas = shown.factor * row.values[chosen], shown.factor * row.sigmas[chosen]
                panel.errorbar(
                    across.factor * row.condition[chosen], values, 2 * sigmas, fmt=".", color=colour, markersize=4.5, elinewidth=0.7, label=label
                )
        _limits(panel, shown.factor * row.values, shown.factor * row.sigmas)
        y_label(panel, plain(f"{row.name} ({shown.text})"))
    sheet.panels[-1].set_xlabel(axis_label(condition, across), fontsize=LABEL_SIZE)
    return finish(sheet, title)


def figure_effects(flights: Sequence[str], probabilities: Mapping[str, np.ndarray], title: str = "") -> Figure:
    """A row an effect, a column a flight: filled where the flight has it, open where it has it not, half where it does not tell."""
    names = list(probabilities)
    named = len(flights) <= _FLIGHTS and max(map(len, flights)) <= _LONGEST
    sheet = make_sheet([_ROW * len(names) + 0.15], left=max(0.72, *(text_width(plain(name)) + 0.25 for name in names)))
    panel = sheet.panels[0]
    for y, name in zip(range(len(names) - 1, -1, -1), names, strict=True):
        p = probabilities[name]
        x = 1 + np.arange(len(flights))
        for chosen, face, label in ((p > 0.95, BLUE, "has it"), ((p >= 0.05) & (p <= 0.95), LIGHT, "not told"), (p < 0.05, "white", "has it not")):
            if np.any(chosen):
                at = x[chosen]
                panel.plot(at, np.full(len(at), y), "s", color=BLUE, markerfacecolor=face, markersize=5.0, markeredgewidth=0.7, label=label)
    panel.set_yticks(range(len(names)), [plain(name) for name in names[::-1]])
    panel.set_ylim(-0.6, len(names) - 0.4)
    panel.set_xlim(0.2, len(flights) + 0.8)
    panel.tick_params(axis="both", labelsize=TICK_SIZE, length=0)
    if named:
        panel.grid(False)
        panel.set_xticks(1 + np.arange(len(flights)), [plain(flight) for flight in flights], rotation=90)
    else:
        panel.set_xlabel(f"flight, in the order of the file: {plain(flights[0])} to {plain(flights[-1])}", fontsize=LABEL_SIZE)
    return finish(sheet, title, bottom=0.2 + max(text_width(plain(flight), TICK_SIZE) for flight in flights) if named else 0.5)


def _limits(panel: object, values: np.ndarray, sigmas: np.ndarray) -> None:
    """Room for every value; of error bars what is not longer than the spread of the values."""
    reach = 2.0 * float(np.median(sigmas)) + 1e-12
    low, high = float(np.min(values)) - reach, float(np.max(values)) + reach
    panel.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))  # type: ignore[attr-defined]
