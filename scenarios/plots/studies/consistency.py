"""Whether sigmas of many runs are right: coverage of intervals, errors beside the normal distribution, NEES and NIS beside chi-square."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ident.statistics.intervals import mean_square_interval
from scenarios.plots.display import plain, symbol
from scenarios.plots.style import BLACK, BLUE, GREY, LABEL_SIZE, LIGHT, TRUE, VERMILION, caption, finish, make_sheet, method_style, text_width

_ROW = 0.3  # inches a parameter
_CLIP = 5.0  # sigmas, where the axes end
MOST = 12  # parameters with a line of their own among the quantiles
MOST_ROWS = 40  # parameters of one figure


@dataclass(frozen=True, eq=False)
class CoverageRow:
    """One parameter: share, low and high end in per cent within one, two and three sigmas."""

    name: str
    shares: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True, eq=False)
class SquaresPanel:
    """Sums over their degrees of freedom of each run ``(N,)``, the degrees (the runs' mean), what they are called."""

    name: str
    values: np.ndarray
    degrees: float


def figure_coverage(rows: Sequence[CoverageRow], nominal: Sequence[float], title: str = "") -> Figure:
    """A row a parameter, a panel for one, two and three sigmas: share of the runs with its interval, the normal distribution's as a line."""
    rows = rows[:MOST_ROWS]
    n, labels = len(rows), [symbol(row.name) for row in rows]
    left = max([0.75, *(text_width(label) + 0.25 for label in labels)])
    sheet = make_sheet([_ROW * n + 0.15], (1.0,) * len(nominal), left=left, column_gap=0.25, share_x=False)
    for at, (panel, expected) in enumerate(zip(sheet.panels, nominal, strict=True)):
        panel.axvline(expected, label="normal distribution", **TRUE)
        for y, row in zip(range(n - 1, -1, -1), rows, strict=True):
            share, low, high = row.shares[at]
            held = low <= expected <= high
            said = "95 % interval" if held else "95 % interval without the normal distribution's share"
            panel.plot([low, high], [y, y], "-", color=BLUE if held else VERMILION, linewidth=1.4, label=said)
            panel.plot([share], [y], "o", color=BLACK, markersize=4.0, label="share of the runs")
        panel.set_yticks(range(n), labels[::-1] if at == 0 else [""] * n)
        panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
        panel.set_ylim(-0.6, n - 0.4)
        lowest, highest = min(expected, *(row.shares[at][1] for row in rows)), max(expected, *(row.shares[at][2] for row in rows))
        room = 0.08 * max(highest - lowest, 1.0)
        panel.set_xlim(max(lowest - room, -1.0), min(highest + room, 101.0))
        panel.set_xlabel(plain(f"within {at + 1}σ (%)"), fontsize=LABEL_SIZE)
    return finish(sheet, title)


def figure_errors(names: Sequence[str], sigmas: np.ndarray, title: str = "") -> Figure:
    """Errors ``(n, N)`` in the runs' own sigmas: at the left all of them beside the normal density, at the right quantiles beside its own.

    Sigmas that are too small make the lines steeper than the diagonal, a bias moves them.
    """
    sheet = make_sheet([2.5], (1.0, 1.15), column_gap=0.75, share_x=False)
    histogram, quantiles = sheet.panels
    _density(histogram, np.clip(sigmas.ravel(), -_CLIP, _CLIP))
    quantiles.plot([-_CLIP, _CLIP], [-_CLIP, _CLIP], "-", color=LIGHT, linewidth=5.0, zorder=1.0, label="right sigmas")
    count = sigmas.shape[1]
    expected = _normal_quantiles((np.arange(count) + 0.5) / count)
    shown = np.unique(np.round(np.linspace(0, count - 1, 300)).astype(int))
    for at, name in enumerate(names[:MOST]):
        ordered = np.clip(np.sort(sigmas[at]), -_CLIP, _CLIP)
        quantiles.plot(expected[shown], ordered[shown], label=symbol(name), **method_style(at, alone=True))
    quantiles.set_xlim(-3.6, 3.6)
    quantiles.set_ylim(-1.02 * _CLIP, 1.02 * _CLIP)
    quantiles.set_xlabel("quantile of the normal distribution (σ)", fontsize=LABEL_SIZE)
    quantiles.set_ylabel("error in the run's own σ", fontsize=LABEL_SIZE)
    return finish(sheet, title)


def figure_squares(panels: Sequence[SquaresPanel], title: str = "") -> Figure:
    """NEES, NIS: each run's sum over its degrees of freedom, beside chi-square and the interval that holds 95 % of it."""
    sheet = make_sheet([2.1], (1.0,) * len(panels), column_gap=0.75, share_x=False)
    for panel, shown in zip(sheet.panels, panels, strict=True):
        _squares(panel, shown)
    return finish(sheet, title, head=0.24)


def _squares(panel: Axes, shown: SquaresPanel) -> None:
    from scipy.special import gammaln

    half = 0.5 * shown.degrees
    low, high = mean_square_interval(shown.degrees)
    usual = float(np.quantile(shown.values, 0.98))
    end = max(high + 0.35 * (high - low), min(1.15 * usual, 12.0 * high))
    begin = max(0.0, min(low - 0.35 * (high - low), float(np.quantile(shown.values, 0.02)) - 0.1 * (high - low)))
    panel.axvspan(low, high, color=LIGHT, alpha=0.55, linewidth=0, label="holds 95 % of chi-square")
    edges = np.linspace(begin, end, 33)
    panel.hist(np.clip(shown.values, begin, end), edges.tolist(), density=True, color=BLUE, alpha=0.55, label="runs")
    x = np.linspace(max(begin, 1e-9), end, 400)
    density = half * np.exp((half - 1.0) * np.log(half * x) - half * x - gammaln(half))
    panel.plot(x, density, label="chi-square", **TRUE)
    mean = float(np.clip(np.mean(shown.values), begin, end))
    panel.axvline(mean, color=VERMILION, linewidth=1.6, label="mean of the runs")
    panel.set_xlim(begin, end)
    panel.set_xlabel(f"{shown.name} over its degrees of freedom (–)", fontsize=LABEL_SIZE)
    panel.set_ylabel("density (–)", fontsize=LABEL_SIZE)
    beyond = int(np.sum(shown.values > end))
    caption(panel, f"{len(shown.values)} runs, {shown.degrees:.0f} degrees of freedom" + (f"; {beyond} beyond the axis" if beyond else ""))


def _density(panel: Axes, errors: np.ndarray) -> None:
    panel.hist(errors, np.linspace(-_CLIP, _CLIP, 41).tolist(), density=True, color=GREY, alpha=0.6, label="errors of all parameters")
    x = np.linspace(-_CLIP, _CLIP, 200)
    panel.plot(x, np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi), label="normal distribution", **TRUE)
    panel.set_xlim(-1.02 * _CLIP, 1.02 * _CLIP)
    panel.set_xlabel("error in the run's own standard deviations (σ)", fontsize=LABEL_SIZE)
    panel.set_ylabel("density (–)", fontsize=LABEL_SIZE)


def _normal_quantiles(share: np.ndarray) -> np.ndarray:
    from scipy.special import ndtri

    return np.asarray(ndtri(share))
