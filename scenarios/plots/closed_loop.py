"""Figures of the sampled closed loop: flown against linear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from scenarios.plots.display import axis_label, display_unit, symbol
from scenarios.plots.style import BLACK, BLUE, GREEN, LABEL_SIZE, TRUE, VERMILION, finish, make_sheet, time_axis, y_label

_LEAST = 1e-16  # of the response; what is exactly equal is drawn here


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
