"""Verdicts of many flights whose truth is known: shares by what was hidden, and what was named in
place of what.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREY,
    LABEL_SIZE,
    LIGHT,
    ORANGE,
    SKY,
    TICK_SIZE,
    VERMILION,
    cells,
    finish,
    make_sheet,
    text_width,
)

_ROW = 0.19  # inches a row
_COLOURS = (BLUE, SKY, LIGHT, GREY, ORANGE, VERMILION)
_SMALL = 6.5  # points, of labels of a crowded figure
MOST_ROWS = 60


@dataclass(frozen=True)
class VerdictRow:
    """What was hidden, in how many flights; shares of the outcomes in per cent, in one order; that
    of right answers with its interval.
    """

    label: str
    count: int
    shares: tuple[float, ...]
    right: float
    interval: tuple[float, float]


def figure_verdicts(rows: Sequence[VerdictRow], outcomes: Sequence[str], title: str = "") -> Figure:
    """A bar a row, its parts the ``outcomes``, the best first; the share of right answers as a dot
    with its exact interval.
    """
    rows = rows[:MOST_ROWS]
    n = len(rows)
    labels = [f"{row.label} ({row.count})" for row in rows]
    size = TICK_SIZE if n < 12 else _SMALL
    left = max([0.75, *(text_width(label, size) + 0.2 for label in labels)])
    sheet = make_sheet([_ROW * n + 0.15], left=left, share_x=False)
    (panel,) = sheet.panels
    places = np.arange(n - 1, -1, -1)
    begin = np.zeros(n)
    for at, outcome in enumerate(outcomes):
        widths = np.array([row.shares[at] for row in rows])
        if np.any(widths > 0.0):
            panel.barh(
                places,
                widths,
                left=begin,
                height=0.74,
                color=_COLOURS[at % len(_COLOURS)],
                linewidth=0.0,
                label=outcome,
            )
        begin = begin + widths
    for y, row in zip(places, rows, strict=True):
        panel.plot(row.interval, [y, y], "-", color="white", linewidth=2.8)
        panel.plot(
            row.interval,
            [y, y],
            "-",
            color=BLACK,
            linewidth=1.2,
            label="95 % interval of right answers",
        )
        panel.plot([row.right], [y], "o", color=BLACK, markersize=3.2, label="right answers")
    panel.set_yticks(list(places), labels)
    panel.tick_params(axis="y", labelsize=size, length=0)
    panel.grid(False, axis="y")
    panel.set_ylim(-0.6, n - 0.4)
    panel.set_xlim(0.0, 101.5)
    panel.set_xlabel("share of the flights (%)", fontsize=LABEL_SIZE)
    return finish(sheet, title)


def figure_confusion(table: Mapping[str, Mapping[str, int]], title: str = "") -> Figure:
    """What was hidden up the side, what was concluded along: the share of a row's flights as shade,
    and in figures where there are few columns.
    """
    rows = [*table][:MOST_ROWS]
    columns = _in_order(rows, table)
    shares = np.array(
        [
            [
                100.0 * table[row].get(column, 0) / max(sum(table[row].values()), 1)
                for column in columns
            ]
            for row in rows
        ]
    )
    size = TICK_SIZE if len(columns) < 14 else 5.0
    left = max([0.75, *(text_width(row, size) + 0.2 for row in rows)])
    below = max(0.5, *(text_width(column, size) + 0.35 for column in columns))
    sheet = make_sheet(
        [max(0.6, min(0.24, 5.0 / max(len(rows), 1)) * len(rows))], left=left, share_x=False
    )
    (panel,) = sheet.panels
    panel.grid(False)
    cells(panel, shares, cmap="Blues", vmin=0.0, vmax=100.0)
    panel.set_xticks(range(len(columns)), columns, rotation=90, fontsize=size)
    panel.set_yticks(range(len(rows)), rows, fontsize=size)
    panel.tick_params(length=0, labelsize=size)
    figures = 5.0 if len(columns) > 20 else size
    for y, x in zip(*np.nonzero(shares), strict=True):
        colour = "white" if shares[y, x] > 55.0 else BLACK
        panel.text(
            x, y, f"{shares[y, x]:.0f}", ha="center", va="center", fontsize=figures, color=colour
        )
    return finish(sheet, title, bottom=below)


def _in_order(rows: Sequence[str], table: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Conclusions: those that are names of rows in the order of these, then the others, the
    commonest first.
    """
    counts: dict[str, int] = {}
    for row in table.values():
        for name, count in row.items():
            counts[name] = counts.get(name, 0) + count
    others = sorted(
        (name for name in counts if name not in rows), key=lambda name: (-counts[name], name)
    )
    return [*(name for name in rows if name in counts), *others]
