"""The parameters of effects from each record by itself: a cause comes out alike, chance and colour do not."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ident.tracing.diagnosis import Quantity
from scenarios.plots.display import display_unit, plain
from scenarios.plots.style import BLUE, SKY, TICK_SIZE, caption, finish, folded, make_sheet, y_label
from scenarios.plots.tracing.pictured import Replicated
from scenarios.terminal.quantities import displayed

PARAMETERS = 4  # of one effect that are drawn


def figure_replication(effects: Sequence[Replicated], title: str = "") -> Figure:
    """A panel for each parameter of each effect: its value from each record with two standard deviations, and from all fitted ones as a band.

    Angles in degrees. A record without the parameter has no point.
    """
    shown = [(effect, name) for effect in effects for name in list(effect.by_record[0])[:PARAMETERS]]
    sheet = make_sheet([1.2] * len(shown), row_gap=0.32, left=0.8)
    for panel, (effect, name) in zip(sheet.panels, shown, strict=True):
        places = [place for place, each in enumerate(effect.by_record) if name in each]
        values, stds = _shown([effect.by_record[place][name] for place in places], name)
        if name in effect.together:
            (middle,), (std,) = _shown([effect.together[name]], name)
            panel.axhspan(middle - 2.0 * std, middle + 2.0 * std, color=SKY, alpha=0.3, linewidth=0, label="fitted records together ±2σ")
            panel.axhline(middle, color=SKY, linewidth=1.0)
        panel.errorbar(places, values, yerr=2.0 * stds, fmt="o", color=BLUE, markersize=4.5, linewidth=1.2, capsize=2.5, label="one record ±2σ")
        panel.set_xlim(-0.5, len(effect.by_record) - 0.5)
        room = 5.9 / len(effect.by_record)
        panel.set_xticks(range(len(effect.by_record)), ["\n".join(folded(plain(label), room, TICK_SIZE)) for label in effect.records])
        text = display_unit(effect.by_record[0][name].unit, name).text
        y_label(panel, plain(f"{name.replace('_', ' ')} ({text})"))
        caption(panel, plain(effect.name))
    return finish(sheet, title, head=0.22, bottom=0.45)


def _shown(quantities: Sequence[Quantity], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard deviations in the units of a figure; a sigma that says nothing is as long as the value."""
    rows = np.array([displayed(quantity, name)[:2] for quantity in quantities], dtype=float).reshape(-1, 2)
    values, stds = rows[:, 0], rows[:, 1]
    return values, np.where(np.isfinite(stds) & (stds >= 0.0), np.minimum(stds, 1e3 * np.maximum(np.abs(values), 1e-12)), np.abs(values))
