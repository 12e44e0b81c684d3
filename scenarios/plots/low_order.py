"""Figures of low-order equivalent systems: estimates, states, delays, linear responses, margins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from ident.estimate import FilterHistory
from scenarios.plots.display import (
    axis_label,
    course,
    display_unit,
    escaped_dollars,
    scaled_unit,
    symbol,
)
from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREEN,
    LABEL_SIZE,
    SKY,
    TICK_SIZE,
    TRUE,
    VERMILION,
    ZERO,
    caption,
    draw_estimate,
    finish,
    folded,
    make_sheet,
    time_axis,
    y_label,
)

_LARGEST_DRAWN_DIFFERENCE = 1e4  # largest drawn difference of a log-likelihood from the maximum
_LABEL_WIDTH = 2.6  # inches, of the labels of bars
_VALUE_LABEL_WIDTH = 2.1  # inches, of the labels of unpublished values
_LEAST_MISFIT = 1e-16  # a smaller misfit is drawn at this value, since the axis is logarithmic


@dataclass(frozen=True)
class Bar:
    """A value with its standard deviation, in ``unit``."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True, eq=False)
class LikelihoodCurve:
    """Log-likelihood of a bank of B filters over their delays, and three estimates of the delay.

    Attributes
    ----------
    delays : delays of the filters, s, ``(B,)``.
    log_likelihood : log-likelihood of each delay, ``(B,)``.
    most_likely, weighted_mean, refined : estimates of the delay, s.
    refined_std : standard deviation of ``refined``, s; 0 if it has none.
    """

    delays: np.ndarray
    log_likelihood: np.ndarray
    most_likely: float
    weighted_mean: float
    refined: float
    refined_std: float


def figure_side_by_side(
    first: Mapping[str, Bar],
    second: Mapping[str, Bar],
    first_label: str,
    second_label: str,
    title: str = "",
    printed: Sequence[Mapping[str, float]] = (),
) -> Figure:
    """Plot two estimates with bars of two standard deviations, a panel for each common quantity.

    The layout is that of fig. 8 of NASA TM-101722.

    Parameters
    ----------
    first, second : the two estimates by quantity.
    first_label, second_label : their labels in the legend.
    printed : published values of both in the same units, drawn beside the estimates.
    """
    names = [name for name in first if name in second]
    columns = 4
    rows = -(-len(names) // columns)
    sheet = make_sheet(
        [1.3] * rows,
        (1.0,) * columns,
        count=len(names),
        share_x=False,
        row_gap=0.36,
        column_gap=0.5,
        left=0.55,
    )
    for name, panel in zip(names, sheet.panels, strict=True):
        base = display_unit(first[name].unit, name)
        largest = max(
            abs(first[name].value), abs(second[name].value), first[name].std, second[name].std
        )
        unit = scaled_unit(base, base.factor * largest)
        caption(panel, axis_label(name, unit), LABEL_SIZE)
        for x, bar, colour, marker, label in (
            (0.0, first[name], BLUE, "o", first_label),
            (1.0, second[name], VERMILION, "s", second_label),
        ):
            panel.errorbar(
                [x],
                [unit.factor * bar.value],
                yerr=[2.0 * unit.factor * bar.std],
                fmt=marker,
                color=colour,
                markersize=4.5,
                capsize=3,
                linewidth=1.2,
                label=escaped_dollars(f"{label} ±2σ"),
            )
        for x, published in zip((0.25, 1.25), printed, strict=False):
            if name in published:
                panel.plot(
                    [x],
                    [unit.factor * published[name]],
                    color=BLACK,
                    linestyle="none",
                    marker="D",
                    markersize=4.0,
                    fillstyle="none",
                    label="published",
                )
        panel.set_xlim(-0.6, 1.6)
        panel.set_xticks([])
        panel.margins(y=0.2)
    return finish(sheet, title, bottom=0.15, head=0.24)


def figure_states(
    history: FilterHistory, names: Sequence[str], units: Sequence[str], title: str = ""
) -> Figure:
    """Plot the states of a filter over time with two standard deviations, a panel each."""
    sheet = make_sheet([1.1] * len(names), row_gap=0.2)
    for name, unit, panel in zip(names, units, sheet.panels, strict=True):
        shown = display_unit(unit)
        path = course(history, name, shown.factor)
        draw_estimate(panel, path.time, path.mean, path.std)
        y_label(panel, axis_label(name, shown))
    time_axis(sheet.panels[-1])
    return finish(sheet, title)


def figure_delays(curve: LikelihoodCurve, title: str = "") -> Figure:
    """Plot how far the log-likelihood of each delay is below the largest one.

    Lines mark the most likely, the likelihood-weighted and the refined delay. The axis is
    logarithmic.
    """
    sheet = make_sheet([2.0], right=0.3)
    panel = sheet.panels[0]
    below = np.clip(
        np.max(curve.log_likelihood) - curve.log_likelihood, 0.0, _LARGEST_DRAWN_DIFFERENCE
    )
    panel.plot(
        1e3 * curve.delays,
        below,
        color=BLUE,
        marker="o",
        markersize=4.0,
        linewidth=1.0,
        label="bank of filters, one pass",
    )
    panel.axvline(
        1e3 * curve.most_likely, color=BLUE, linewidth=2.4, alpha=0.5, label="most likely"
    )
    panel.axvline(
        1e3 * curve.weighted_mean,
        color=GREEN,
        linewidth=1.3,
        linestyle="--",
        label="likelihood-weighted sum",
    )
    panel.axvline(
        1e3 * curve.refined,
        color=VERMILION,
        linewidth=1.2,
        label="refined" + (" ±2σ" if curve.refined_std > 0 else ""),
    )
    if curve.refined_std > 0:
        low, high = (1e3 * (curve.refined + sign * curve.refined_std) for sign in (-2.0, 2.0))
        panel.axvspan(low, high, color=SKY, alpha=0.4, linewidth=0)
    panel.set_yscale("symlog", linthresh=10.0)
    panel.set_ylim(1.6 * max(float(below.max()), 10.0), -3.0)
    panel.set_xlabel("delay (ms)", fontsize=LABEL_SIZE)
    y_label(panel, "log-likelihood below the best")
    return finish(sheet, title)


def figure_peaks(rows: Sequence[tuple[str, float]], words: str, title: str = "") -> Figure:
    """Plot one number for each variant as a horizontal bar; the first bar is red.

    Parameters
    ----------
    rows : label and value of each variant. All values have signs if one is negative.
    words : label of the axis.
    """
    n, sign = len(rows), "+" if any(round(value, 2) < 0 for _, value in rows) else ""
    sheet = make_sheet([0.38 * n + 0.1], left=_LABEL_WIDTH + 0.2, right=0.5)
    panel = sheet.panels[0]
    places = np.arange(n)[::-1]
    panel.barh(
        places, [value for _, value in rows], height=0.5, color=[VERMILION] + [BLUE] * (n - 1)
    )
    panel.axvline(0.0, **ZERO)
    for place, (_, value) in zip(places, rows, strict=True):
        # A value that rounds to zero has no sign.
        text = f"{round(value, 2) + 0.0:{sign if round(value, 2) else ''}.2f}".replace("-", "−")
        panel.annotate(
            text,
            (value, place),
            xytext=(4 if value >= 0 else -4, 0),
            textcoords="offset points",
            ha="left" if value >= 0 else "right",
            va="center",
            fontsize=TICK_SIZE,
            color=BLACK,
        )
    panel.set_yticks(
        places,
        ["\n".join(folded(escaped_dollars(label), _LABEL_WIDTH, TICK_SIZE)) for label, _ in rows],
    )
    panel.margins(x=0.18)
    panel.grid(False, axis="y")
    panel.set_xlabel(words, fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.12)


def figure_linear(
    time: np.ndarray,
    simulated: np.ndarray,
    linear: np.ndarray,
    names: Sequence[str],
    units: Sequence[str],
    sticks: Sequence[float],
    curves: Mapping[str, Sequence[float]],
    title: str = "",
) -> Figure:
    """Plot nonlinear and linear responses over time, and the misfit of q over the stick amplitude.

    Parameters
    ----------
    time : shape ``(F,)``, s.
    simulated, linear : responses of the outputs ``names``, which include q, ``(m, F)``, SI.
    sticks : stick amplitudes, inches.
    curves : relative misfit of q at each amplitude, by label.
    """
    sheet = make_sheet([1.05] * (len(names) + 1) + [1.9], row_gap=0.45, share_x=False)
    for name, unit, flown, predicted, panel in zip(
        names, units, simulated, linear, sheet.panels, strict=False
    ):
        shown = display_unit(unit)
        panel.plot(time, shown.factor * flown, color=BLUE, linewidth=2.4, label="flown, noise-free")
        panel.plot(time, shown.factor * predicted, label="linear, python-control", **TRUE)
        y_label(panel, axis_label(name, shown))
        panel.set_xlim(time[0], time[-1])
    row = names.index("q")
    shown = display_unit(units[row])
    panel = sheet.panels[len(names)]
    panel.plot(
        time,
        shown.factor * (simulated[row] - linear[row]),
        color=VERMILION,
        linewidth=1.0,
        label="flown less linear",
    )
    panel.axhline(0.0, **ZERO)
    panel.set_xlim(time[0], time[-1])
    y_label(panel, f"difference in {symbol('q')} ({shown.text})")
    time_axis(panel)
    panel = sheet.panels[-1]
    for (label, values), colour, marker in zip(
        curves.items(), (BLUE, GREEN, BLACK), ("o", "s", "^"), strict=True
    ):
        panel.plot(
            sticks,
            np.maximum(values, _LEAST_MISFIT),
            color=colour,
            marker=marker,
            markersize=4.5,
            linewidth=1.0,
            label=label,
        )
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_ylim(_LEAST_MISFIT / 3.0, 30.0)
    panel.set_xticks(list(sticks), [f"{size:g}" for size in sticks])
    panel.minorticks_off()
    panel.set_xlabel("largest stick (in)", fontsize=LABEL_SIZE)
    y_label(panel, f"misfit of {symbol('q')} (–)")
    return finish(sheet, title)


def figure_open_margins(
    clouds: Sequence[tuple[str, np.ndarray, np.ndarray]],
    declared: Sequence[tuple[str, float, float]],
    effects: Sequence[tuple[str, float]],
    title: str = "",
) -> Figure:
    """Plot phase margins of the flight over those of the simulation.

    A second panel has the effect of each unpublished value on their difference.

    Parameters
    ----------
    clouds : two sets, each with a label and the margins of simulation and flight, ``(N,)``, deg.
    declared : single points, each with a label and the margins of simulation and flight, deg.
    effects : label of each unpublished value, and the change of the difference that it makes, deg.
    """
    heights = [3.4, 0.3 * len(effects) + 0.1] if effects else [3.4]
    sheet = make_sheet(
        heights, share_x=False, row_gap=0.62, left=_VALUE_LABEL_WIDTH if effects else 0.72
    )
    panel = sheet.panels[0]
    for (label, simulation, flight), colour, marker in zip(
        clouds, (BLUE, VERMILION), ("o", "x"), strict=True
    ):
        panel.plot(
            simulation,
            flight,
            color=colour,
            marker=marker,
            markersize=4.5,
            linestyle="none",
            label=label,
        )
    margins = np.concatenate(
        [np.ravel([simulation, flight]) for _, simulation, flight in (*clouds, *declared)]
    )
    ends = np.array([margins.min() - 2.0, margins.max() + 2.0])
    panel.plot(ends, ends, label="equal: above it the paper's sign", **TRUE)
    for (label, x, y), marker in zip(declared, ("D", "*"), strict=False):
        panel.plot(
            [x], [y], color=BLACK, marker=marker, markersize=8.0, linestyle="none", label=label
        )
    panel.set_xlim(*ends)
    panel.set_ylim(*ends)
    panel.set_xlabel("phase margin of the simulation (deg)", fontsize=LABEL_SIZE)
    y_label(panel, "phase margin of the flight (deg)")
    if effects:
        panel, places = sheet.panels[1], np.arange(len(effects))[::-1]
        panel.barh(places, [value for _, value in effects], height=0.55, color=BLUE)
        panel.axvline(0.0, **ZERO)
        panel.set_yticks(
            places,
            ["\n".join(folded(label, _VALUE_LABEL_WIDTH - 0.3, TICK_SIZE)) for label, _ in effects],
        )
        panel.grid(False, axis="y")
        panel.set_xlabel(
            "flight less simulation, from the middle to the high end of the range (deg)",
            fontsize=LABEL_SIZE,
        )
    return finish(sheet, title)
