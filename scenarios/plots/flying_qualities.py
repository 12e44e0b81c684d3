"""Figures of flying qualities from frequency responses: margins over time, charts with levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib.figure import Figure

from scenarios.plots.style import (
    BLUE,
    SKY,
    VERMILION,
    finish,
    make_sheet,
    time_axis,
    y_label,
)

# ---- Stability margins of a stream over time


class TimedMargins(Protocol):
    """Margins at a time, s."""

    @property
    def time(self) -> float: ...
    @property
    def margins(self) -> Any: ...


_ROWS = (
    ("gain_increase", "gain increase (dB)", 6.0),
    ("gain_decrease", "gain decrease (dB)", -6.0),
    ("phase_margin", "phase margin (deg)", 45.0),
    ("distance", "distance from -1 (–)", None),
)


def figure_margin_history(points: Sequence[TimedMargins], name: str = "") -> Figure:
    """The margins of a loop after each second of a stream, with their 95 % intervals.

    The dashed lines are the margins of MIL-F-9490D. A margin that is nowhere known has no panel.
    """
    known = [each.margins.named if each.margins is not None else {} for each in points]
    rows = [row for row in _ROWS if any(row[0] in each for each in known)]
    sheet = make_sheet([1.15] * max(len(rows), 1), row_gap=0.16)
    time = np.array([each.time for each in points])
    for panel, (key, label, required) in zip(sheet.panels, rows, strict=False):
        found = [each.get(key) for each in known]
        value, low, high = (
            np.array([np.nan if each is None else pick(each) for each in found])
            for pick in (
                lambda each: each.size.value,
                lambda each: each.low,
                lambda each: each.high,
            )
        )
        panel.fill_between(time, low, high, color=SKY, alpha=0.45, linewidth=0.0, label="95 %")
        panel.plot(
            time, value, color=BLUE, linewidth=1.2, marker=".", markersize=3.0, label="margin"
        )
        # The later two thirds set the scale: the first intervals are wide.
        late = value[np.isfinite(value)]
        late = late[late.size // 3 :]
        spread = max(float(np.ptp(late)), 0.25 * abs(float(np.median(late))))
        ends = [float(np.min(late)), float(np.max(late))]
        if required is not None:
            panel.axhline(
                required, color=VERMILION, linewidth=0.9, linestyle="--", label="MIL-F-9490D"
            )
            ends = [min(ends[0], required), max(ends[1], required)]
        panel.set_ylim(ends[0] - 0.4 * spread, ends[1] + 0.4 * spread)
        panel.set_xlim(float(time[0]), float(time[-1]))
        y_label(panel, label)
    time_axis(sheet.panels[-1])
    return finish(sheet, f"{name}: stability margins while the stream arrived" if name else "")
