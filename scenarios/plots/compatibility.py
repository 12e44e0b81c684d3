"""Reconstructed against measured: what the kinematics make of the other channels."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ident.compatibility.kinematics import UNITS
from ident.compatibility.trials import Reconstruction
from scenarios.plots.display import MEASURED_DATA, axis_label, display_unit
from scenarios.plots.style import MEASURED, TICK_SIZE, ZERO, finish, make_sheet, method_style, time_axis, y_label


def figure_reconstruction(item: Reconstruction, title: str = "", data: str = MEASURED_DATA) -> Figure:
    """Each output as recorded (dots, called ``data``), integrated from the measured inputs and smoothed with the output itself,
    and below what each leaves.

    What is integrated drifts off with the inputs' noise, as it must. Angles in degrees.
    """
    names = list(item.measured)
    sheet = make_sheet([1.45, 1.0] * len(names), row_gap=0.18)
    corrected = any(not np.array_equal(item.recorded[name], item.integrated[name]) for name in names)
    for number, name in enumerate(names):
        unit = display_unit(UNITS[name])
        above, below = sheet.panels[2 * number], sheet.panels[2 * number + 1]
        measured, used = unit.factor * item.measured[name], item.used[name]
        above.plot(item.time[used], measured[used], label=data, **MEASURED)
        below.axhline(0.0, **ZERO)
        shown = [(item.recorded[name], "integrated from the other channels")]
        if corrected:
            shown.append((item.integrated[name], "with the faults that stand"))
        shown.append((item.smoothed[name], "smoothed"))
        for order, (values, label) in enumerate(shown):
            look = method_style(order)
            above.plot(item.time, unit.factor * values, label=label, **look)
            residual = np.where(used, measured - unit.factor * values, np.nan)
            below.plot(item.time, residual, linestyle="none", marker=".", markersize=2.5, color=look["color"], markeredgewidth=0.0)
        y_label(above, axis_label(name, unit))
        y_label(below, f"residual ({unit.text})", TICK_SIZE)
    time_axis(sheet.panels[-1])
    return finish(sheet, title, head=0.16)
