"""Figures of the sampled closed loop: flown against linear, margins of flight against those of simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from scenarios.plots.display import axis_label, display_unit, symbol
from scenarios.plots.style import BLACK, BLUE, GREEN, LABEL_SIZE, TICK_SIZE, TRUE, VERMILION, ZERO, finish, folded, make_sheet, time_axis, y_label

_LEAST = 1e-16  # of the response; what is exactly equal is drawn here
_WORDS = 2.1  # inches, for names beside bars


def figure_linear(
    time: np.ndarray,
    flown: np.ndarray,
    linear: np.ndarray,
    names: Sequence[str],
    units: Sequence[str],
    sticks: Sequence[float],
    curves: Mapping[str, Sequence[float]],
    title: str = "",
) -> Figure:
    """Flown ``(m, F)`` and linear responses over time (s), and the misfit of q over the size of the stick (in), both logarithmic."""
    sheet = make_sheet([1.05] * (len(names) + 1) + [1.9], row_gap=0.45, share_x=False)
    for name, unit, one, other, panel in zip(names, units, flown, linear, sheet.panels, strict=False):
        shown = display_unit(unit)
        panel.plot(time, shown.factor * one, color=BLUE, linewidth=1.2, label="flown, noise-free")
        panel.plot(time, shown.factor * other, label="linear, python-control", **TRUE)
        y_label(panel, axis_label(name, shown))
        panel.set_xlim(time[0], time[-1])
    shown, row = display_unit(units[names.index("q")]), names.index("q")
    panel = sheet.panels[len(names)]
    panel.plot(time, shown.factor * (flown[row] - linear[row]), color=VERMILION, linewidth=1.0, label="flown less linear")
    panel.set_xlim(time[0], time[-1])
    y_label(panel, axis_label("q", shown))
    time_axis(panel)
    panel = sheet.panels[-1]
    for (label, values), colour, marker in zip(curves.items(), (BLUE, GREEN, BLACK), ("o", "s", "^"), strict=True):
        panel.plot(sticks, np.maximum(values, _LEAST), color=colour, marker=marker, markersize=4.5, linewidth=1.0, label=label)
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_ylim(_LEAST / 3.0, 30.0)
    panel.set_xticks(list(sticks), [f"{size:g}" for size in sticks])
    panel.minorticks_off()
    panel.set_xlabel("largest stick (in)", fontsize=LABEL_SIZE)
    y_label(panel, f"misfit of {symbol('q')}, share")
    return finish(sheet, title)


def figure_open_margins(
    clouds: Sequence[tuple[str, np.ndarray, np.ndarray]],
    declared: Sequence[tuple[str, float, float]],
    effects: Sequence[tuple[str, float]],
    title: str = "",
) -> Figure:
    """Phase margins of flight over those of simulation (deg), and what each open value does to their difference.

    ``clouds`` and ``declared`` : a label with margins of simulation and flight. ``effects`` : a label with degrees, drawn where there are any.
    """
    heights = [3.4, 0.3 * len(effects) + 0.1] if effects else [3.4]
    sheet = make_sheet(heights, share_x=False, row_gap=0.62, left=_WORDS if effects else 0.72)
    panel = sheet.panels[0]
    for (label, simulation, flight), colour, marker in zip(clouds, (BLUE, VERMILION), ("o", "x"), strict=True):
        panel.plot(simulation, flight, color=colour, marker=marker, markersize=4.5, linestyle="none", label=label)
    every = np.concatenate([np.concatenate([simulation, flight]) for _, simulation, flight in clouds] + [np.array(d[1:]) for d in declared])
    ends = np.array([every.min() - 2.0, every.max() + 2.0])
    panel.plot(ends, ends, label="equal: above it the paper's sign", **TRUE)
    for (label, x, y), marker in zip(declared, ("D", "*"), strict=False):
        panel.plot([x], [y], color=BLACK, marker=marker, markersize=8.0, linestyle="none", label=label)
    panel.set_xlim(*ends)
    panel.set_ylim(*ends)
    panel.set_xlabel("phase margin of the simulation (deg)", fontsize=LABEL_SIZE)
    y_label(panel, "of the flight (deg)")
    if effects:
        panel, places = sheet.panels[1], np.arange(len(effects))[::-1]
        panel.barh(places, [value for _, value in effects], height=0.55, color=BLUE)
        panel.axvline(0.0, **ZERO)
        panel.set_yticks(places, ["\n".join(folded(label, _WORDS - 0.3, TICK_SIZE)) for label, _ in effects])
        panel.grid(False, axis="y")
        panel.set_xlabel("flight less simulation, from the middle to the high end of the range (deg)", fontsize=LABEL_SIZE)
    return finish(sheet, title)
