"""Figures of many runs, of observability, and of flexibility."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ident.statistics.intervals import mean_square_interval
from scenarios.plots.display import axis_label, display_unit, escaped_dollars, symbol
from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    LABEL_SIZE,
    LIGHT,
    ORANGE,
    PURPLE,
    SKY,
    TICK_SIZE,
    TRUE,
    VERMILION,
    ZERO,
    caption,
    finish,
    make_sheet,
    method_style,
    text_width,
)

# ---- Errors of many runs in the sigmas that each run reports

_ROW_HEIGHT = 0.42  # inches, height of a parameter's row
_DOT_SPREAD_SHARE = 0.3  # dots spread by this share of the row, up and down
_GOLDEN_RATIO = 0.618033988749895  # multiples of it, modulo 1, are evenly spread
_CLIPPED_SIGMAS = 5.0  # larger errors are drawn at the edge of the axis
EXPECTED_PERCENT = 95.45  # % of a Gaussian within two standard deviations


@dataclass(frozen=True, eq=False)
class Coverage:
    """Errors of one parameter in N runs, and two-sigma coverage.

    Attributes
    ----------
    name : name of the parameter.
    sigmas : errors in reported sigmas, ``(N,)``.
    within_two : share of the runs within two sigmas, %.
    interval : 95 % confidence interval of this share, %.
    """

    name: str
    sigmas: np.ndarray
    within_two: float
    interval: tuple[float, float]


def figure_campaign(rows: Sequence[Coverage], title: str = "") -> Figure:
    """Plot errors in reported sigmas (left) and two-sigma coverage (right), one row per parameter.

    Dots are runs, the bar is the root mean square. Correct sigmas give a bar from -1 to 1 and a
    coverage on the line. Large errors are drawn at the edge.
    """
    n = len(rows)
    labels = [symbol(row.name) for row in rows]
    left = max([0.75, *(text_width(label) + 0.25 for label in labels)])
    sheet = make_sheet(
        [_ROW_HEIGHT * n + 0.1], (1.9, 1.0), left=left, column_gap=0.3, share_x=False
    )
    errors, share = sheet.panels
    errors.axvspan(-2.0, 2.0, color=LIGHT, alpha=0.55, linewidth=0, label="within ±2σ")
    errors.axvline(0.0, **ZERO)
    share.axvline(
        EXPECTED_PERCENT, label=escaped_dollars(f"{EXPECTED_PERCENT:g} % of a Gaussian"), **TRUE
    )
    size = 5.0 if max(len(row.sigmas) for row in rows) <= 50 else 2.5  # of a dot
    for y, row in zip(range(n - 1, -1, -1), rows, strict=True):
        shares = np.mod(0.5 + _GOLDEN_RATIO * np.arange(len(row.sigmas)), 1.0)
        heights = y + _DOT_SPREAD_SHARE * (2.0 * shares - 1.0)
        errors.plot(
            np.clip(row.sigmas, -_CLIPPED_SIGMAS, _CLIPPED_SIGMAS),
            heights,
            ".",
            color=GREY,
            markersize=size,
            markeredgewidth=0.0,
            label="one run",
        )
        rms = min(float(np.sqrt(np.mean(row.sigmas**2))), _CLIPPED_SIGMAS)
        mean = float(np.clip(np.mean(row.sigmas), -_CLIPPED_SIGMAS, _CLIPPED_SIGMAS))
        errors.plot([-rms, rms], [y, y], "-", color=BLUE, linewidth=2.0, label="± root mean square")
        errors.plot(
            [mean], [y], "|", color=VERMILION, markersize=11.0, markeredgewidth=2.0, label="mean"
        )
        low, high = row.interval
        share.plot(
            [low, high], [y, y], "-", color=BLUE, linewidth=1.2, label="95 % interval of the share"
        )
        share.plot(
            [row.within_two],
            [y],
            "o",
            color=BLACK,
            markersize=4.5,
            label="share of the runs",
            clip_on=False,
        )
    errors.set_yticks(range(n), labels[::-1])
    share.set_yticks(range(n), [""] * n)
    for panel in sheet.panels:
        panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
        panel.set_ylim(-0.55, n - 0.45)
    errors.set_xlim(-1.04 * _CLIPPED_SIGMAS, 1.04 * _CLIPPED_SIGMAS)
    share.set_xlim(min(89.0, *(row.interval[0] - 1.0 for row in rows)), 100.5)
    errors.set_xlabel("error in the run's own standard deviations (σ)", fontsize=LABEL_SIZE)
    share.set_xlabel("within two of them (%)", fontsize=LABEL_SIZE)
    return finish(sheet, title)


# ---- Consistency of reported sigmas over many runs

_COVERAGE_ROW_HEIGHT = 0.3  # inches, height of a parameter's row
MOST_QUANTILE_LINES = 12  # parameters in the plot of quantiles
MOST_QUANTILES = 300  # points of a line in this plot
MOST_ROWS = 40  # parameters of one figure


@dataclass(frozen=True, eq=False)
class CoverageRow:
    """Coverage of one parameter within one, two and three sigmas.

    ``shares`` : for each of the three, the share of the runs and the limits of its confidence
    interval, %.
    """

    name: str
    shares: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True, eq=False)
class SquaresPanel:
    """Normalized squares of N runs: of estimation errors (NEES) or of innovations (NIS).

    Attributes
    ----------
    name : ``"NEES"`` or ``"NIS"``.
    values : squares over their degrees of freedom, ``(N,)``.
    degrees : degrees of freedom, mean over the runs.
    """

    name: str
    values: np.ndarray
    degrees: float


def figure_coverage(
    rows: Sequence[CoverageRow], nominal: Sequence[float], title: str = ""
) -> Figure:
    """Plot the coverage of each parameter with its interval, a panel for each number of sigmas.

    ``nominal`` : coverage of a normal distribution within one, two and three sigmas, %; a line.
    """
    rows = rows[:MOST_ROWS]
    n, labels = len(rows), [symbol(row.name) for row in rows]
    left = max([0.75, *(text_width(label) + 0.25 for label in labels)])
    sheet = make_sheet(
        [_COVERAGE_ROW_HEIGHT * n + 0.15],
        (1.0,) * len(nominal),
        left=left,
        column_gap=0.25,
        share_x=False,
    )
    for i, (panel, expected) in enumerate(zip(sheet.panels, nominal, strict=True)):
        panel.axvline(expected, label="normal distribution", **TRUE)
        for y, row in zip(range(n - 1, -1, -1), rows, strict=True):
            share, low, high = row.shares[i]
            covered = low <= expected <= high
            legend = "95 % interval"
            if not covered:
                legend += " without the normal distribution's share"
            panel.plot(
                [low, high],
                [y, y],
                "-",
                color=BLUE if covered else VERMILION,
                linewidth=1.4,
                label=legend,
            )
            panel.plot(
                [share],
                [y],
                "o",
                color=BLACK,
                markersize=4.0,
                label="share of the runs",
                clip_on=False,
            )
        panel.set_yticks(range(n), labels[::-1] if i == 0 else [""] * n)
        panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
        panel.set_ylim(-0.6, n - 0.4)
        lowest = min(expected, *(row.shares[i][1] for row in rows))
        highest = max(expected, *(row.shares[i][2] for row in rows))
        margin = 0.08 * max(highest - lowest, 1.0)
        panel.set_xlim(max(lowest - margin, -1.0), min(highest + margin, 101.0))
        panel.set_xlabel(escaped_dollars(f"within {i + 1}σ (%)"), fontsize=LABEL_SIZE)
    return finish(sheet, title)


def figure_errors(names: Sequence[str], sigmas: np.ndarray, title: str = "") -> Figure:
    """Plot a histogram of errors, and their quantiles against those of a normal distribution.

    Sigmas that are too small give lines steeper than the diagonal; a bias shifts them.

    ``names`` are those of the n parameters; ``sigmas`` ``(n, N)`` are errors of N runs in reported
    sigmas.
    """
    sheet = make_sheet([2.5], (1.0, 1.15), column_gap=0.75, share_x=False)
    histogram, quantiles = sheet.panels
    _density(histogram, np.clip(sigmas.ravel(), -_CLIPPED_SIGMAS, _CLIPPED_SIGMAS))
    quantiles.plot(
        [-_CLIPPED_SIGMAS, _CLIPPED_SIGMAS],
        [-_CLIPPED_SIGMAS, _CLIPPED_SIGMAS],
        "-",
        color=LIGHT,
        linewidth=5.0,
        zorder=1.0,
        label="correct sigmas",
    )
    count = sigmas.shape[1]
    expected = _normal_quantiles((np.arange(count) + 0.5) / count)
    shown = np.unique(np.round(np.linspace(0, count - 1, MOST_QUANTILES)).astype(int))
    for i, name in enumerate(names[:MOST_QUANTILE_LINES]):
        ordered = np.clip(np.sort(sigmas[i]), -_CLIPPED_SIGMAS, _CLIPPED_SIGMAS)
        quantiles.plot(
            expected[shown], ordered[shown], label=symbol(name), **method_style(i, alone=True)
        )
    quantiles.set_xlim(-3.6, 3.6)
    quantiles.set_ylim(-1.02 * _CLIPPED_SIGMAS, 1.02 * _CLIPPED_SIGMAS)
    quantiles.set_xlabel("quantile of the normal distribution (σ)", fontsize=LABEL_SIZE)
    quantiles.set_ylabel("error in the run's own σ", fontsize=LABEL_SIZE)
    return finish(sheet, title)


def figure_squares(panels: Sequence[SquaresPanel], title: str = "") -> Figure:
    """Plot a histogram of NEES and of NIS over their degrees of freedom, with the density of
    chi-square and its 95 % interval.
    """
    sheet = make_sheet([2.1], (1.0,) * len(panels), column_gap=0.75, share_x=False)
    for panel, squares in zip(sheet.panels, panels, strict=True):
        _draw_squares(panel, squares)
    return finish(sheet, title, head=0.24)


def _draw_squares(panel: Axes, shown: SquaresPanel) -> None:
    from scipy.special import gammaln

    half = 0.5 * shown.degrees
    low, high = mean_square_interval(shown.degrees)
    width = high - low
    # The axis has the interval and nearly all runs, but ends at a multiple of the interval.
    lowest, highest = (float(np.quantile(shown.values, share)) for share in (0.02, 0.98))
    end = max(high + 0.35 * width, min(1.15 * highest, 12.0 * high))
    begin = max(0.0, min(low - 0.35 * width, lowest - 0.1 * width))
    panel.axvspan(low, high, color=LIGHT, alpha=0.55, linewidth=0, label="holds 95 % of chi-square")
    edges = np.linspace(begin, end, 33)
    panel.hist(
        np.clip(shown.values, begin, end),
        edges.tolist(),
        density=True,
        color=BLUE,
        alpha=0.55,
        label="runs",
    )
    x = np.linspace(max(begin, 1e-9), end, 400)
    density = half * np.exp((half - 1.0) * np.log(half * x) - half * x - gammaln(half))
    panel.plot(x, density, label="chi-square", **TRUE)
    mean = float(np.clip(np.mean(shown.values), begin, end))
    panel.axvline(mean, color=VERMILION, linewidth=1.6, label="mean of the runs")
    panel.set_xlim(begin, end)
    panel.set_xlabel(f"{shown.name} over its degrees of freedom (–)", fontsize=LABEL_SIZE)
    panel.set_ylabel("density (–)", fontsize=LABEL_SIZE)
    beyond = int(np.sum(shown.values > end))
    caption(
        panel,
        f"{len(shown.values)} runs, {shown.degrees:.0f} degrees of freedom"
        + (f"; {beyond} beyond the axis" if beyond else ""),
    )


def _density(panel: Axes, errors: np.ndarray) -> None:
    panel.hist(
        errors,
        np.linspace(-_CLIPPED_SIGMAS, _CLIPPED_SIGMAS, 41).tolist(),
        density=True,
        color=GREY,
        alpha=0.6,
        label="errors of all parameters",
    )
    x = np.linspace(-_CLIPPED_SIGMAS, _CLIPPED_SIGMAS, 200)
    panel.plot(x, np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi), label="normal distribution", **TRUE)
    panel.set_xlim(-1.02 * _CLIPPED_SIGMAS, 1.02 * _CLIPPED_SIGMAS)
    panel.set_xlabel("error in the run's own standard deviations (σ)", fontsize=LABEL_SIZE)
    panel.set_ylabel("density (–)", fontsize=LABEL_SIZE)


def _normal_quantiles(share: np.ndarray) -> np.ndarray:
    from scipy.special import ndtri

    return np.asarray(ndtri(share))


# ---- Information of records and of priors

_DETERMINATION_ROW_HEIGHT = 0.235  # inches a parameter
# Ratio of posterior to prior sigma above which a parameter is only counted, not drawn.
UNINFORMED_SHARE = 0.95
_MARKS = ("o", "^", "x", "D")


@dataclass(frozen=True, eq=False)
class DeterminedBy:
    """Information of record and prior with one method, by parameter and by direction (a linear
    combination of parameters).

    Attributes
    ----------
    label : label of the method.
    ratio : posterior over prior sigma, by parameter.
    share : share of the prior in the variance, by parameter.
    strengths : prior sigma over the record's sigma, by direction, largest first.
    unseen : number of directions without effect on the outputs, not in ``strengths``.
    """

    label: str
    ratio: Mapping[str, float]
    share: Mapping[str, float]
    strengths: np.ndarray
    unseen: int


def figure_determination(methods: Sequence[DeterminedBy], title: str = "") -> Figure:
    """Plot the information of record and prior: by direction (above) and by parameter (below).

    Parameters are sorted by ``ratio`` of the first method.
    """
    all_names = sorted(methods[0].ratio, key=lambda name: methods[0].ratio[name])
    names = [
        name
        for name in all_names
        if any(method.ratio.get(name, 1.0) <= UNINFORMED_SHARE for method in methods)
    ]
    if not names:
        names = all_names[:1]
    n, not_drawn = len(names), len(all_names) - len(names)
    left = max(0.75, *(text_width(symbol(name)) + 0.2 for name in names))
    sheet = make_sheet(
        [1.9, n * _DETERMINATION_ROW_HEIGHT + 0.1],
        (1.0, 1.0),
        count=4,
        left=left,
        column_gap=0.3,
        row_gap=0.75,
        share_x=False,
    )
    strengths, determined, ratio, share = sheet.panels
    strengths.set_yscale("log")
    strengths.axhline(1.0, color=BLACK, linewidth=0.8)
    for number, method in enumerate(methods):
        colour, mark = method_style(number)["color"], _MARKS[number % len(_MARKS)]
        style = {"color": colour, "marker": mark, "linestyle": "none", "markersize": 3.5}
        directions = np.arange(1, len(method.strengths) + 1)
        strengths.plot(directions, method.strengths, label=escaped_dollars(method.label), **style)
        squares = method.strengths**2
        determined.plot(directions, np.cumsum(squares / (1.0 + squares)), **method_style(number))
        rows = np.arange(n, dtype=float)
        ratio.plot([method.ratio.get(name, np.nan) for name in names], rows, **style)
        share.plot([100.0 * method.share.get(name, np.nan) for name in names], rows, **style)
    caption(strengths, "σ of the prior over σ by the record alone (–)")
    caption(determined, "directions that the record determines (–), cumulative")
    unseen = sorted({method.unseen for method in methods})
    for panel in (strengths, determined):
        panel.set_xlabel(
            f"direction (–); {' or '.join(map(str, unseen))} more do not change the outputs",
            fontsize=LABEL_SIZE,
        )
    for panel, text in (
        (ratio, "σ over the prior's σ (–)"),
        (share, "variance that the prior gives (%)"),
    ):
        panel.set_ylim(n - 0.4, -0.6)
        panel.set_xlabel(text, fontsize=LABEL_SIZE)
        panel.set_yticks(range(n), [symbol(name) for name in names] if panel is ratio else [""] * n)
        panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
        panel.grid(True, axis="y", color=LIGHT, linewidth=0.4)
    if not_drawn:
        caption(
            ratio, f"{not_drawn} further parameters keep > {UNINFORMED_SHARE:g} of their prior's σ"
        )
    ratio.set_xlim(-0.02, 1.05)
    share.set_xlim(-2.0, 105.0)
    return finish(sheet, title, head=0.24)


# ---- Equivalent derivatives of a flexible aircraft over its degree of flexibility

_ESTIMATES = ((BLUE, "o"), (GREEN, "^"), (SKY, "D"))
_CRITERIA = (GREY, PURPLE, ORANGE)
_LINES = ("-", (0, (3, 2)), "-")
_COLUMNS = 3  # columns of panels


@dataclass(frozen=True)
class Published:
    """A published derivative with its sigma, at the degree of flexibility of its aircraft."""

    degree: float
    value: float
    std: float


@dataclass(frozen=True, eq=False)
class DerivativeCourse:
    """One derivative along a sweep of structures.

    Attributes
    ----------
    name, unit : the derivative and its unit.
    rigid : true value of the rigid aircraft.
    condensed : quasi-static equivalent, for each structure.
    best : value of the rigid model that fits the noise-free response best, for each structure.
    estimates : method -> value and sigma for each structure.
    published : published values.
    """

    name: str
    unit: str
    rigid: float
    condensed: Sequence[float]
    best: Sequence[float]
    estimates: Mapping[str, Sequence[tuple[float, float]]]
    published: Sequence[Published]


@dataclass(frozen=True)
class CriterionCourse:
    """One criterion along a sweep of structures.

    Attributes
    ----------
    axis, label : texts of axis and legend.
    limit : limit of the criterion.
    values : value for each structure.
    degree : degree of flexibility at which the limit is reached, or None.
    window : values outside this range are drawn at its edge.
    """

    axis: str
    label: str
    limit: float
    values: Sequence[float]
    degree: float | None
    window: tuple[float, float] = (-np.inf, np.inf)


def figure_flexibility(
    degrees: Sequence[float],
    courses: Sequence[DerivativeCourse],
    criteria: Sequence[CriterionCourse],
    marks: Mapping[str, float],
    title: str = "",
) -> Figure:
    """Plot derivatives (above) and criteria (below) over the degree of flexibility.

    A vertical line in all panels shows where a criterion fails.

    Parameters
    ----------
    degrees : degree of flexibility of each structure.
    courses, criteria : derivatives and criteria, a panel for each.
    marks : degrees of named structures.
    title : title of the figure.
    """
    rows = math.ceil(len(courses) / _COLUMNS)
    sheet = make_sheet(
        [1.75] * rows + [1.2] * bool(criteria),
        (1.0,) * _COLUMNS,
        count=_COLUMNS * rows + len(criteria),
        row_gap=0.4,
        column_gap=0.6,
        left=0.66,
        share_x=False,
    )
    for course, panel in zip(courses, sheet.panels, strict=False):
        _draw_derivative(panel, degrees, course)
    for number, (criterion, panel) in enumerate(
        zip(criteria, sheet.panels[_COLUMNS * rows :], strict=True)
    ):
        caption(panel, criterion.axis)
        panel.plot(
            degrees,
            np.clip(criterion.values, *criterion.window),
            color=_CRITERIA[number],
            marker=".",
            linewidth=1.2,
        )
        panel.axhline(criterion.limit, color=BLACK, linewidth=0.8, linestyle=":")
        panel.margins(y=0.1)
    for number, panel in enumerate(sheet.panels):
        _finish_panel(panel, degrees, criteria, marks if number < _COLUMNS * rows else {})
    for panel in sheet.panels[-max(len(criteria), 1) :]:
        panel.set_xlabel("degree of flexibility", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.3, bottom=0.5)


def _draw_derivative(panel: Axes, degrees: Sequence[float], course: DerivativeCourse) -> None:
    unit = display_unit(course.unit, course.name)
    caption(panel, axis_label(course.name, unit))
    panel.axhline(unit.factor * course.rigid, label="rigid, true", **TRUE)
    panel.plot(
        degrees,
        unit.factor * np.array(course.condensed),
        color=BLACK,
        linewidth=1.3,
        label="quasi-static equivalent",
    )
    panel.plot(
        degrees,
        unit.factor * np.array(course.best),
        color=BLUE,
        linewidth=0.9,
        linestyle="--",
        label="best rigid model, no noise",
    )
    shift = np.linspace(-0.03, 0.03, len(course.estimates)) if len(course.estimates) > 1 else [0.0]
    for number, (label, result) in enumerate(course.estimates.items()):
        colour, marker = _ESTIMATES[number % len(_ESTIMATES)]
        values, std = (unit.factor * np.array(part) for part in zip(*result, strict=True))
        places = np.array(degrees) * np.exp(shift[number])
        style: dict[str, Any] = {
            "fmt": marker,
            "color": colour,
            "markersize": 3.2,
            "linewidth": 0.9,
            "capsize": 1.5,
        }
        panel.errorbar(
            places, values, yerr=2.0 * std, label=f"{escaped_dollars(label)} ±2σ", **style
        )
    for published in course.published:
        published_style: dict[str, Any] = {
            "fmt": "s",
            "color": VERMILION,
            "markersize": 4.5,
            "linewidth": 1.2,
            "capsize": 2.5,
            "label": "published ±2σ",
        }
        panel.errorbar(
            [published.degree],
            [unit.factor * published.value],
            yerr=[2.0 * unit.factor * published.std],
            zorder=5,
            **published_style,
        )


def _finish_panel(
    panel: Axes,
    degrees: Sequence[float],
    criteria: Sequence[CriterionCourse],
    marks: Mapping[str, float],
) -> None:
    """Set the logarithmic axis, and draw lines where criteria fail and names of structures."""
    panel.set_xscale("log")
    panel.set_xlim(0.8 * min(degrees), 1.3 * max(degrees))
    for number, criterion in enumerate(criteria):
        if criterion.degree is not None:
            panel.axvline(
                criterion.degree,
                color=_CRITERIA[number],
                linewidth=1.4,
                linestyle=_LINES[number],
                label=escaped_dollars(criterion.label),
            )
    for label, degree in marks.items():
        place: dict[str, Any] = {
            "xycoords": ("data", "axes fraction"),
            "ha": "center",
            "va": "bottom",
            "fontsize": TICK_SIZE - 1.0,
            "annotation_clip": False,
        }
        panel.annotate(escaped_dollars(label), (degree, 1.0), **place)
