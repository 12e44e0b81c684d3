"""Errors of many runs in the sigmas that each run reports, and how often an interval holds what it should."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from scenarios.plots.display import plain, symbol
from scenarios.plots.style import BLACK, BLUE, GREY, LABEL_SIZE, LIGHT, TRUE, VERMILION, ZERO, finish, make_sheet, text_width

_ROW, _SPREAD, _CLIP = 0.42, 0.3, 5.0  # inches a parameter; half the height of its dots, of a row; sigmas, where the axis ends
EXPECTED = 95.45  # % of a Gaussian within two standard deviations


@dataclass(frozen=True, eq=False)
class Coverage:
    """One parameter, or all: errors of every run in its own sigmas ``(N,)``; share within two, and the ends of its interval, in per cent."""

    name: str
    sigmas: np.ndarray
    within_two: float
    interval: tuple[float, float]


def figure_campaign(rows: Sequence[Coverage], title: str = "") -> Figure:
    """A row a parameter: at the left the error of each run, mean and root mean square; at the right the share within two sigmas.

    Sigmas that are right give a bar from -1 to 1 and a share on the line. Errors beyond the axis stand at its edge.
    """
    n = len(rows)
    labels = [symbol(row.name) for row in rows]
    left = max([0.75, *(text_width(label) + 0.25 for label in labels)])
    sheet = make_sheet([_ROW * n + 0.1], (1.9, 1.0), left=left, column_gap=0.3, share_x=False)
    errors, share = sheet.panels
    errors.axvspan(-2.0, 2.0, color=LIGHT, alpha=0.55, linewidth=0, label="within ±2σ")
    errors.axvline(0.0, **ZERO)
    share.axvline(EXPECTED, label=plain(f"{EXPECTED:g} % of a Gaussian"), **TRUE)
    for y, row in zip(range(n - 1, -1, -1), rows, strict=True):
        # Spread over the row by a sequence that fills it evenly, the same for every parameter.
        heights = y + _SPREAD * (2.0 * np.mod(0.5 + 0.618033988749895 * np.arange(len(row.sigmas)), 1.0) - 1.0)
        errors.plot(np.clip(row.sigmas, -_CLIP, _CLIP), heights, ".", color=GREY, markersize=2.5, markeredgewidth=0.0, label="one run")
        size, mean = min(float(np.sqrt(np.mean(row.sigmas**2))), _CLIP), float(np.clip(np.mean(row.sigmas), -_CLIP, _CLIP))
        errors.plot([-size, size], [y, y], "-", color=BLUE, linewidth=2.0, label="± root mean square")
        errors.plot([mean], [y], "|", color=VERMILION, markersize=11.0, markeredgewidth=2.0, label="mean")
        low, high = row.interval
        share.plot([low, high], [y, y], "-", color=BLUE, linewidth=1.2, label="95 % interval of the share")
        share.plot([row.within_two], [y], "o", color=BLACK, markersize=4.5, label="share of the runs")
    errors.set_yticks(range(n), labels[::-1])
    share.set_yticks(range(n), [""] * n)
    for panel in sheet.panels:
        panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
        panel.set_ylim(-0.55, n - 0.45)
    errors.set_xlim(-1.04 * _CLIP, 1.04 * _CLIP)
    share.set_xlim(min(89.0, *(row.interval[0] - 1.0 for row in rows)), 100.5)
    errors.set_xlabel("error in the run's own standard deviations (σ)", fontsize=LABEL_SIZE)
    share.set_xlabel("within two of them (%)", fontsize=LABEL_SIZE)
    return finish(sheet, title)
