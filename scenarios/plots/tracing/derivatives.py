"""Derivatives before and after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ident.tracing.diagnosis import Quantity
from scenarios.plots.display import symbol
from scenarios.plots.style import BLUE, LABEL_SIZE, TICK_SIZE, VERMILION, WIDTH, ZERO, caption, finish, make_sheet, text_width
from scenarios.terminal.quantities import value_text


def figure_derivatives(before: Mapping[str, Quantity], after: Mapping[str, Quantity], title: str = "") -> Figure:
    """Derivatives with the declared model and with the effects, in per cent of the former; bars are two standard deviations.

    Where nothing changed there is one of them. One that was not determined before, by three standard deviations, is shown in per cent of these three.
    """
    names = [name for name in before if name in after]
    n = len(names)
    labels = [symbol(name) for name in names]
    left = min(2.0, max([0.7, *(text_width(label) + 0.25 for label in labels)]))
    columns = [[value_text(side[name].value, side[name].std).replace("+-", "±").replace("-", "−") for name in names] for side in (before, after)]
    same = columns[0] == columns[1]
    widths = [max([0.5, *(text_width(text, TICK_SIZE) for text in texts)]) + 0.12 for texts in columns]
    sheet = make_sheet([0.34 * n + 0.1], count=min(n, 1), left=left, right=(widths[1] if same else sum(widths)) + 0.2)
    panel = sheet.panels[0]
    panel.axvline(0.0, **ZERO)
    inner = WIDTH - sheet.left - sheet.right
    rows, start = n - 1.0 - np.arange(n), np.array([before[name].value for name in names])
    base = np.maximum(np.abs(start), 3.0 * np.array([before[name].std for name in names]))
    base = np.where(base > 0.0, base, 1.0)
    reach, right = 5.0, 0.0
    both = (
        (before, 0.16, "s", VERMILION, "before", columns[0], widths[0]),
        (after, -0.16, "o", BLUE, "after", columns[1], widths[1]),
    )
    alone = ((after, 0.0, "o", BLUE, "estimate", columns[1], widths[1]),)
    for side, offset, marker, colour, label, texts, width in alone if same else both:
        x = 100.0 * (np.array([side[name].value for name in names]) - start) / base
        bars = 200.0 * np.array([side[name].std for name in names]) / base
        panel.errorbar(x, rows + offset, xerr=bars, fmt=marker, color=colour, markersize=4.5, linewidth=1.2, capsize=2.5, label=f"{label} ±2σ")
        reach = max(reach, float(np.max(np.abs(x) + np.minimum(bars, 100.0), initial=0.0)))
        right += width
        look: dict[str, Any] = {"transform": panel.get_yaxis_transform(), "ha": "right", "fontsize": TICK_SIZE, "color": colour}
        panel.text(1.0 + right / inner, n - 0.35, label, va="bottom", **look)
        for y, text in zip(rows.tolist(), texts, strict=True):
            panel.text(1.0 + right / inner, y, text, va="center", **look)
    panel.set_yticks(range(n), labels[::-1])
    panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
    panel.set_ylim(-0.55, n - 0.45)
    panel.set_xlim(-1.08 * reach, 1.08 * reach)
    panel.set_xlabel(
        "uncertainty of the derivative (% of its value)" if same else "change of the derivative (% of its value before)", fontsize=LABEL_SIZE
    )
    vague = [label for label, wide in zip(labels, base > np.abs(start), strict=True) if wide]
    if vague:
        caption(panel, f"{', '.join(vague)}: in % of 3σ, not determined before")
    return finish(sheet, title, head=0.24)
