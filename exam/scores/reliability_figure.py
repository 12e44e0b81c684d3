"""Probabilities of names beside the share of them that is right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from scenarios.plots.style import (
    BLACK,
    BLUE,
    LABEL_SIZE,
    LIGHT,
    TICK_SIZE,
    TRUE,
    VERMILION,
    finish,
    make_sheet,
)


@dataclass(frozen=True)
class ReliabilityBin:
    """Names given a probability from ``low`` to ``high``, the mean of it, the share of them that is
    right with its interval: all in per cent.
    """

    low: float
    high: float
    count: int
    said: float
    right: float
    interval: tuple[float, float]


def figure_reliability(bins: Sequence[ReliabilityBin], title: str = "") -> Figure:
    """The share that is right against the probability that was said, with exact intervals; on the
    diagonal where probabilities are right.
    """
    sheet = make_sheet([3.0], left=0.72, right=2.4, share_x=False)
    (panel,) = sheet.panels
    panel.plot([0.0, 100.0], [0.0, 100.0], label="probabilities that hold", **TRUE)
    for item in bins:
        if not item.count:
            continue
        panel.axvspan(item.low, item.high, ymin=0.0, ymax=0.025, color=LIGHT, linewidth=0.0)
        held = item.interval[0] <= item.said <= item.interval[1]
        said = "95 % interval" if held else "95 % interval without the probability said"
        panel.plot(
            [item.said, item.said],
            item.interval,
            "-",
            color=BLUE if held else VERMILION,
            linewidth=1.6,
            label=said,
        )
        panel.plot(
            [item.said], [item.right], "o", color=BLACK, markersize=4.5, label="share that is right"
        )
        panel.annotate(
            str(item.count),
            (item.said, item.interval[0]),
            (0.0, -9.0),
            textcoords="offset points",
            ha="center",
            fontsize=TICK_SIZE,
        )
    panel.set_xlim(-2.0, 102.0)
    panel.set_ylim(-9.0, 103.0)
    panel.set_xlabel("probability said (%)", fontsize=LABEL_SIZE)
    panel.set_ylabel("names that are right (%)", fontsize=LABEL_SIZE)
    return finish(sheet, title)
