"""Figures of a campaign of the tracing loop: verdicts, conclusions, probabilities, parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from exam.scores.rates import NORMAL, Scores, coverage_of, reliability_of, right_share, standings
from exam.scores.scored_flight import ScoredFlight, Standing
from scenarios.plots.drawing import Named
from scenarios.plots.studies import CoverageRow, figure_coverage
from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREY,
    LABEL_SIZE,
    LIGHT,
    ORANGE,
    SKY,
    TICK_SIZE,
    TRUE,
    VERMILION,
    cells,
    finish,
    make_sheet,
    text_width,
)

# ---- Verdicts of many flights whose truth is known

_ROW = 0.19  # height of a row, inches
_COLOURS = (BLUE, SKY, LIGHT, GREY, ORANGE, VERMILION)
_SMALL = 6.5  # size of labels in a crowded figure, points
MOST_ROWS = 60


@dataclass(frozen=True)
class VerdictRow:
    """A row of the figure of verdicts: label, number of flights, shares of the outcomes in per
    cent, and the share of right answers with its interval.
    """

    label: str
    count: int
    shares: tuple[float, ...]
    right: float
    interval: tuple[float, float]


def figure_verdicts(rows: Sequence[VerdictRow], outcomes: Sequence[str], title: str = "") -> Figure:
    """Draw a bar for each row, divided by ``outcomes``, the best first. A dot with its exact
    interval is the share of right answers.
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
    """Draw hidden effects (vertical) against conclusions (horizontal): shares of a row's flights as
    shades, with numbers if there are few columns.
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
    """Sort conclusions: names of rows first, in the order of the rows, then the others by
    frequency.
    """
    counts: dict[str, int] = {}
    for row in table.values():
        for name, count in row.items():
            counts[name] = counts.get(name, 0) + count
    others = sorted(
        (name for name in counts if name not in rows), key=lambda name: (-counts[name], name)
    )
    return [*(name for name in rows if name in counts), *others]


# ---- Probabilities of names beside the share of them that is right


@dataclass(frozen=True)
class ReliabilityBin:
    """Names with a probability from ``low`` to ``high``: mean probability, and share of right names
    with its interval, all in per cent.
    """

    low: float
    high: float
    count: int
    said: float
    right: float
    interval: tuple[float, float]


def figure_reliability(bins: Sequence[ReliabilityBin], title: str = "") -> Figure:
    """Draw the share of right names against their probability, with exact intervals. Correct
    probabilities lie on the diagonal.
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


# ---- What the figures of a campaign of the loop are given

CONFUSED = "What was concluded (along) of what was hidden (up), % of its flights"


def scores_figures(scores: Scores, name: str) -> list[Named]:
    """Return the figures of a campaign with this ``name``.

    They are verdicts, conclusions (if there is more than one label), probabilities, and parameters
    (if there are any).
    """
    of = f"{name}, {len(scores.flights)} flights"
    rows = [_row(label, group) for label, group in scores.groups_and_all.items()]
    drawn: list[Named] = [
        (
            "verdicts",
            partial(
                figure_verdicts,
                rows,
                [each.value for each in Standing],
                f"Verdicts by what was hidden\n{of}",
            ),
        )
    ]
    if len(scores.groups) > 1:
        drawn.append(
            (
                "confusion",
                partial(
                    figure_confusion,
                    scores.confusion,
                    f"{CONFUSED}\n{of}",
                ),
            )
        )
    bins = [item for item in reliability_of(scores.flights) if item.count]
    if bins:
        shown = [
            _bin(item.low, item.high, item.count, item.said, item.right, item.interval)
            for item in bins
        ]
        drawn.append(
            (
                "reliability",
                partial(
                    figure_reliability, shown, f"Probabilities of names, with their number\n{of}"
                ),
            )
        )
    covered = coverage_of(scores)
    if covered:
        shares = [
            CoverageRow(
                label, tuple(_percent(share.count, share.of, share.interval) for share in each)
            )
            for label, each in covered.items()
        ]
        drawn.append(
            (
                "effect_coverage",
                partial(
                    figure_coverage,
                    shares,
                    NORMAL,
                    f"Parameters of effects within their sigmas\n{of}",
                ),
            )
        )
    return drawn


def _row(label: str, flights: Sequence[ScoredFlight]) -> VerdictRow:
    found, right = standings(flights), right_share(flights)
    share, low, high = _percent(right.count, right.of, right.interval)
    return VerdictRow(
        label,
        len(flights),
        tuple(100.0 * found[each].count / len(flights) for each in Standing),
        share,
        (low, high),
    )


def _bin(
    low: float, high: float, count: int, said: float, right: int, interval: tuple[float, float]
) -> ReliabilityBin:
    return ReliabilityBin(
        100.0 * low,
        100.0 * high,
        count,
        100.0 * said,
        100.0 * right / count,
        (100.0 * interval[0], 100.0 * interval[1]),
    )


def _percent(count: int, of: int, interval: tuple[float, float]) -> tuple[float, float, float]:
    return 100.0 * count / of, 100.0 * interval[0], 100.0 * interval[1]
