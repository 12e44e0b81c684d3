"""Figures of estimates: parameters over time, correlations, innovations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ident.estimate import FilterHistory
from ident.statistics.residual_spectrum import autocovariance
from scenarios.plots.display import (
    DisplayUnit,
    StateHistory,
    axis_label,
    course,
    display_unit,
    scaled_unit,
    settled_limits,
    sound_samples,
    symbol,
)
from scenarios.plots.style import (
    BLACK,
    BLUE,
    DPI,
    GREEN,
    GREY,
    LABEL_SIZE,
    ORANGE,
    SKY,
    TICK_SIZE,
    TRUE,
    VERMILION,
    WIDTH,
    ZERO,
    Sheet,
    caption,
    cells,
    draw_estimate,
    draw_title,
    finish,
    make_sheet,
    text_width,
    time_axis,
    title_space,
    y_label,
)
from sim.errors import ModelError

# ---- Parameter estimates over time

ValueAndStd = tuple[float, float | None]


def figure_parameter_histories(
    history: FilterHistory,
    names: Sequence[str],
    units: Sequence[str],
    true: Mapping[str, float] | None = None,
    published: Mapping[str, ValueAndStd] | None = None,
    prior: Mapping[str, ValueAndStd] | None = None,
    title: str = "",
    true_label: str = "true",
) -> Figure:
    """Plot estimates with bands of two standard deviations over time, a panel for each parameter.

    The limits of the axes follow from the converged part; a wide early band may be cut off. If the
    filter diverges, the curve ends, and the panels say when.

    Parameters
    ----------
    history : history of the filter.
    names, units : parameters or states of the history, and their units.
    true : true values, drawn as dashed lines with the label ``true_label``.
    published : published values, drawn as a square after the last sample, with two standard
        deviations if they are known. A value far outside the panel becomes an arrow with its
        number.
    prior : the same for priors, drawn as a diamond before the first sample.
    """
    true, published, prior = true or {}, published or {}, prior or {}
    sheet = _parameter_sheet(len(names))
    sound = sound_samples(history)
    diverged = sound < len(history.time)
    for name, unit, panel in zip(names, units, sheet.panels, strict=True):
        shown = _unit(history, name, unit, true.get(name, 0.0))
        ending = f", ends at {history.time[sound - 1]:.3g} s" if diverged and sound else ""
        caption(panel, axis_label(name, shown) + ending, LABEL_SIZE)
        if sound == 0:
            caption(panel, f"{axis_label(name, shown)}: no sound sample", LABEL_SIZE)
            continue
        path = course(history, name, shown.factor)
        _panel(
            panel,
            path,
            history,
            shown,
            published.get(name),
            prior.get(name),
            true.get(name),
            true_label,
        )
    for panel in sheet.panels[-len(sheet.widths) :]:
        time_axis(panel)
    return finish(sheet, title, head=0.24)


def figure_watched(
    time: np.ndarray,
    courses: Mapping[str, tuple[str, np.ndarray, np.ndarray]],
    reference: Mapping[str, ValueAndStd] = MappingProxyType({}),
    title: str = "",
) -> Figure:
    """Plot estimates of a stream with bands of two standard deviations over time.

    Each parameter has a panel. The limits of its axes follow from the converged part; a wide early
    band may be cut off.

    Parameters
    ----------
    time : shape ``(N,)``, s.
    courses : by parameter its unit, values and standard deviations, ``(N,)`` each.
    reference : reference value and its standard deviation by parameter, drawn as a band of two
        standard deviations.
    """
    sheet = _parameter_sheet(len(courses))
    for panel, (name, (si_unit, values, std)) in zip(sheet.panels, courses.items(), strict=True):
        unit = display_unit(si_unit, name)
        mean, sigma = unit.factor * values, unit.factor * std
        caption(panel, axis_label(name, unit), LABEL_SIZE)
        draw_estimate(panel, time, mean, sigma)
        later = slice(len(time) // 2, None)
        ends = [
            float(np.nanmin((mean - 3.0 * sigma)[later])),
            float(np.nanmax((mean + 3.0 * sigma)[later])),
        ]
        if name in reference and reference[name][1] is not None:
            value, reference_std = (unit.factor * float(part or 0.0) for part in reference[name])
            panel.axhspan(
                value - 2.0 * reference_std,
                value + 2.0 * reference_std,
                color=ORANGE,
                alpha=0.2,
                linewidth=0,
                label="reference ±2σ",
            )
            ends += [value - 2.5 * reference_std, value + 2.5 * reference_std]
        if np.all(np.isfinite(ends)) and max(ends) > min(ends):
            panel.set_ylim(min(ends), max(ends))
    for panel in sheet.panels[-len(sheet.widths) :]:
        time_axis(panel)
    return finish(sheet, title, head=0.24)


def figure_poles(poles: np.ndarray, draws: np.ndarray, title: str = "") -> Figure:
    """Plot the poles of an identified model in the upper half of the complex plane.

    Poles at the right of the imaginary axis are unstable. The distance of a pole from the origin is
    the natural frequency. The cosine of its angle to the negative real axis is the damping ratio.

    Parameters
    ----------
    poles : poles at the estimate, complex, shape ``(n,)``, 1/s.
    draws : poles at parameters drawn from the covariance of the estimate, shape ``(N, n)``.
    """
    sheet = make_sheet([2.1], left=0.75)
    panel = sheet.panels[0]
    drawn, estimated = (roots[roots.imag >= -1e-9] for roots in (np.ravel(draws), np.ravel(poles)))
    panel.axvline(0.0, **ZERO)
    panel.axhline(0.0, **ZERO)
    for roots, colour, marker, size, edge, label in (
        (drawn, SKY, ".", 3.5, 0.0, "drawn from the covariance"),
        (estimated, BLUE, "x", 7.0, 1.6, "estimate"),
    ):
        panel.plot(
            roots.real,
            roots.imag,
            linestyle="none",
            marker=marker,
            markersize=size,
            markeredgewidth=edge,
            color=colour,
            label=label,
        )
    panel.set_xlabel("real part (1/s)", fontsize=LABEL_SIZE)
    y_label(panel, "imaginary part (rad/s)")
    reach = max(float(np.abs(estimated).max(initial=0.0)), 1e-3)
    low, high = float(estimated.real.min(initial=0.0)), float(estimated.real.max(initial=0.0))
    panel.set_xlim(low - 0.25 * reach, high + 0.1 * reach)
    panel.set_ylim(-0.1 * reach, 1.3 * float(estimated.imag.max(initial=0.0)) + 0.1 * reach)
    return finish(sheet, title, head=0.2)


def _parameter_sheet(count: int) -> Sheet:
    columns = 2 if count <= 4 else 3
    rows = -(-count // columns)
    return make_sheet(
        [1.15] * rows, (1.0,) * columns, count=count, row_gap=0.36, column_gap=0.58, left=0.6
    )


def _unit(history: FilterHistory, name: str, unit: str, true: float) -> DisplayUnit:
    """Return the display unit, with a power of a thousand that suits the true value and the second
    half of the estimates.
    """
    base, path = display_unit(unit, name), course(history, name)
    later = slice(len(history.time) // 2, None)
    upper_edge = np.abs(path.mean[later]) + 2.0 * path.std[later]
    return scaled_unit(base, base.factor * max(abs(true), float(upper_edge.max(initial=0.0))))


def _panel(
    panel: Axes,
    path: StateHistory,
    history: FilterHistory,
    unit: DisplayUnit,
    published: ValueAndStd | None,
    prior: ValueAndStd | None,
    true: float | None,
    true_label: str,
) -> None:
    draw_estimate(panel, path.time, path.mean, path.std)
    low, high = path.mean - 2.0 * path.std, path.mean + 2.0 * path.std
    shown_values = [] if true is None else [unit.factor * true]
    if true is not None:
        panel.axhline(unit.factor * true, label=true_label, zorder=3, **TRUE)
    bottom, top = settled_limits(low, path.mean, high, shown_values)
    first, last = float(history.time[0]), float(history.time[-1])
    pad = 0.05 * (last - first)
    span = top - bottom
    for mark in (published, prior):
        if mark is None:
            continue
        # A near mark widens the axis. A far mark does not: it would compress the curve.
        value = unit.factor * mark[0]
        if bottom - 0.6 * span <= value <= top + 0.6 * span:
            bottom, top = min(bottom, value - 0.05 * span), max(top, value + 0.05 * span)
    panel.set_ylim(bottom, top)
    panel.set_xlim(first - pad, last + pad)
    _mark(panel, last + 0.5 * pad, published, unit, "s", VERMILION, "published ±2σ")
    _mark(panel, first - 0.5 * pad, prior, unit, "D", GREEN, "prior ±2σ")


def _mark(
    panel: Axes,
    x: float,
    mark: ValueAndStd | None,
    unit: DisplayUnit,
    marker: str,
    colour: str,
    label: str,
) -> None:
    """Draw a value with a bar of two standard deviations; an arrow if it is outside the panel."""
    if mark is None:
        return
    value = unit.factor * mark[0]
    bar = None if mark[1] is None else [2.0 * unit.factor * mark[1]]
    bottom, top = panel.get_ylim()
    inside = bottom <= value <= top
    panel.errorbar(
        [x], [value], yerr=bar, fmt=marker, color=colour, markersize=4.0, linewidth=1.2, label=label
    )
    if not inside:
        edge, arrow = (top, "^") if value > top else (bottom, "v")
        panel.plot([x], [edge], marker=arrow, color=colour, markersize=5.0, clip_on=False, zorder=5)
        first, last = panel.get_xlim()
        side = "right" if x > first + 0.5 * (last - first) else "left"
        panel.annotate(
            f"{value:.4g}".replace("-", "−"),
            (x, edge),
            xytext=(-6 if side == "right" else 6, -2 if value > top else 2),
            textcoords="offset points",
            ha=side,
            va="top" if value > top else "bottom",
            fontsize=TICK_SIZE - 1,
            color=colour,
            zorder=6,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8},
        )


# ---- Correlations of estimated parameters as a map

FRAMED_CORRELATION = 0.9  # a larger absolute correlation has a frame
_PRINTED_CORRELATION = 0.5  # from this absolute correlation on, the number is printed
_DARK_CORRELATION = 0.65  # a larger absolute correlation has a dark colour, and its number is white
_COLOUR_SCALE_WIDTH = 1.0  # inches
_COUNT_LINE_HEIGHT = 0.28  # inches; height of the line with the number of framed pairs


def _square(column: int, row: int, side: float, **style: Any) -> Rectangle:
    """Return a square about the middle of a cell of a heat map."""
    return Rectangle((column - side / 2.0, row - side / 2.0), side, side, **style)


def figure_correlation(names: Sequence[str], correlation: np.ndarray, title: str = "") -> Figure:
    """Plot the lower triangle of a correlation matrix, ``(n, n)``, as a heat map.

    Large correlations have a number (``_PRINTED_CORRELATION``) and a frame
    (``FRAMED_CORRELATION``). A cell of a parameter without variance is grey. Raises ModelError for
    fewer than two parameters.
    """
    n = len(names)
    if n < 2:
        raise ModelError(
            f"{n} parameter(s)",
            where="figure of correlations",
            remedy="draw it for two parameters or more",
        )
    matrix = np.array(correlation, dtype=float)
    # The first row and the last column of the triangle are empty: they are not drawn.
    matrix, n = matrix[1:, :-1], n - 1
    below = np.tril(np.ones((n, n), dtype=bool))
    shown = np.ma.masked_where(~below | ~np.isfinite(matrix), matrix)
    labels = [symbol(name) for name in names]
    size = LABEL_SIZE if n <= 20 else TICK_SIZE - 2.0
    left, bottom = (
        max([0.6, *(text_width(label, size) + 0.2 for label in axis_labels)])
        for axis_labels in (labels[1:], labels[:-1])
    )
    cell = min(max(0.42, min(0.8, 2.0 / n)), (WIDTH - left - _COLOUR_SCALE_WIDTH) / n)
    width = max(n * cell + left + _COLOUR_SCALE_WIDTH, 5.0)
    head = title_space(title, width)
    height = max(n * cell, 1.2) + head + _COUNT_LINE_HEIGHT + bottom
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    panel = figure.add_axes((left / width, bottom / height, n * cell / width, n * cell / height))
    image = cells(panel, shown, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    number_size = min(TICK_SIZE, 27.0 * cell)
    for row, column in np.argwhere(below):
        value = matrix[row, column]
        if not np.isfinite(value):
            panel.add_patch(_square(column, row, 1.0, facecolor=GREY, lw=0, antialiased=False))
        elif abs(value) >= _PRINTED_CORRELATION:
            if abs(value) > FRAMED_CORRELATION:
                panel.add_patch(_square(column, row, 0.92, fill=False, edgecolor=BLACK, lw=1.3))
            colour = "white" if abs(value) > _DARK_CORRELATION else BLACK
            panel.text(
                column,
                row,
                f"{value:.2f}".replace("-", "−").replace("0.", "."),  # such as ".87"
                ha="center",
                va="center",
                fontsize=number_size,
                color=colour,
            )
    panel.set_xticks(range(n), labels[:-1], rotation=90, fontsize=size)
    panel.set_yticks(range(n), labels[1:], fontsize=size)
    panel.tick_params(length=0)
    for spine in panel.spines.values():
        spine.set_visible(False)
    bar = figure.colorbar(
        image,
        cax=figure.add_axes(
            ((left + n * cell + 0.25) / width, bottom / height, 0.14 / width, n * cell / height)
        ),
    )
    if bar.solids is not None:  # avoids an embedded image, which pages do not load
        bar.solids.set_rasterized(False)
    bar.set_ticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    bar.set_label("correlation (–)", fontsize=LABEL_SIZE)
    bar.ax.tick_params(labelsize=TICK_SIZE)
    pairs = int(np.count_nonzero(below & (np.abs(np.nan_to_num(matrix)) > FRAMED_CORRELATION)))
    counted = f"{pairs} of {n * (n + 1) // 2} pairs above {FRAMED_CORRELATION:g} in size (framed)"
    draw_title(figure, title, width, height)
    figure.text(0.15 / width, 1.0 - (head + 0.04) / height, counted, fontsize=TICK_SIZE, va="top")
    return figure


# ---- Innovations of a filter with their bounds, and their autocorrelation

EXPECTED_OUTSIDE = math.erfc(math.sqrt(2.0))  # probability of a Gaussian outside two sigmas
# Bounds wider than this multiple of their 90th percentile come from a wide prior.
PRIOR_BOUND_RATIO = 5.0
_FEWEST_SAMPLES = 8  # with fewer samples no autocorrelation is drawn


def figure_innovations(
    history: FilterHistory,
    output_names: Sequence[str],
    units: Sequence[str],
    title: str = "",
    lags: int = 50,
) -> Figure:
    """Plot innovations with two-sigma bounds and their autocorrelation with a 95 % band.

    The bounds are 2 sqrt((H P H' + R)_ii) (eq. 23 of NASA TM-101722). The band is that of white
    noise. A caption has the share of samples outside the bounds. Missing samples and samples after
    a divergence are left out. Angles are in degrees.

    Parameters
    ----------
    output_names, units : names and units of the m outputs.
    lags : largest lag of the autocorrelation, samples.
    """
    sound = sound_samples(history)
    rows = [row for row in range(len(output_names)) if np.any(history.valid[row])]
    sheet = make_sheet([1.5] * max(len(rows), 1), (1.7, 1.0), row_gap=0.36, column_gap=0.78)
    if not rows:
        for panel in sheet.panels:
            caption(panel, "no sample was used")
    for row, (left, right) in zip(rows, sheet.axes, strict=False):
        valid, base = history.valid[row], display_unit(units[row])
        # The power of ten is part of the unit: above the axis it would overlap the caption.
        innovation, std = history.innovation[row, valid], history.innovation_std[row, valid]
        unit = scaled_unit(base, base.factor * _limit(innovation, std))
        _innovations(left, history.time[valid], unit.factor * innovation, unit.factor * std)
        left.set_xlim(history.time[0], history.time[-1])
        y_label(left, axis_label(output_names[row], unit))
        normalised = np.where(valid, history.innovation[row] / history.innovation_std[row], 0.0)
        _autocorrelation(right, normalised, valid, lags)
        ending = f"; ends at {history.time[sound - 1]:.3g} s" if sound < len(valid) else ""
        outside = float(np.mean(np.abs(normalised[valid]) > 2.0))
        caption(
            left,
            f"{symbol(output_names[row])}: {100 * outside:.1f} % outside ±2σ "
            f"({100 * EXPECTED_OUTSIDE:.1f} % expected){ending}",
        )
    if len(sheet.axes[-1]) == 2:
        time_axis(sheet.axes[-1][0])
        sheet.axes[-1][1].set_xlabel("lag (samples)", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.24)


def _innovations(panel: Axes, time: np.ndarray, innovation: np.ndarray, std: np.ndarray) -> None:
    """Draw innovations with two-sigma bounds, and marks for innovations beyond the axis."""
    panel.axhline(0.0, **ZERO)
    panel.plot(
        time,
        innovation,
        color=BLUE,
        linestyle="none",
        marker=".",
        markersize=3.0,
        markeredgewidth=0.0,
        label="innovation",
    )
    panel.plot(time, 2.0 * std, color=VERMILION, linewidth=1.1, label="±2σ bounds")
    panel.plot(time, -2.0 * std, color=VERMILION, linewidth=1.1)
    limit = _limit(innovation, std)
    beyond = np.abs(innovation) > limit
    if beyond.any():
        edge = 0.97 * limit * np.sign(innovation[beyond])
        panel.plot(
            time[beyond],
            edge,
            color=BLACK,
            linestyle="none",
            marker="d",
            markersize=5.0,
            markeredgewidth=0.0,
            label="innovation beyond the axis",
        )
    panel.set_ylim(-limit, limit)


def _limit(innovation: np.ndarray, std: np.ndarray) -> float:
    """Return the limit of the axis; wide early bounds, which come from the prior, do not count."""
    usual = float(np.quantile(std, 0.9))
    of_prior = std > PRIOR_BOUND_RATIO * usual
    return 1.15 * max(float(np.abs(innovation[~of_prior]).max()), 2.0 * usual)


def _autocorrelation(panel: Axes, normalised: np.ndarray, valid: np.ndarray, lags: int) -> None:
    """Draw the autocorrelation of normalized innovations with the 95 % band of white noise.

    The band depends on the number of pairs of samples at each lag. ``normalised``: ``(N,)``, zero
    at missing samples.
    """
    # Imported here, since the module of the margins loads slowly.
    from ident.flying_qualities.stability_margins import NORMAL_HALF_WIDTH

    n, used = len(normalised), int(np.count_nonzero(valid))
    last = min(lags, used // 4)
    power = float(np.sum(normalised**2))
    if used < _FEWEST_SAMPLES or power == 0.0:
        caption(panel, "too few samples")
        return
    lag = np.arange(1, last + 1)
    r = autocovariance(normalised, last)[1:] * n / power
    pairs = np.maximum(autocovariance(valid.astype(float), last)[1:] * n, 0.0)
    band = NORMAL_HALF_WIDTH * np.sqrt(pairs) / used
    panel.fill_between(
        lag, -band, band, color=SKY, alpha=0.35, linewidth=0, label="95 % band of white noise"
    )
    panel.axhline(0.0, **ZERO)
    panel.vlines(lag, 0.0, r, color=BLACK, linewidth=1.0)
    limit = min(1.05, 1.25 * max(float(np.abs(r).max()), 2.0 * float(band.max())))
    panel.set_ylim(-limit, limit)
    panel.set_xlim(0, last + 1)
    y_label(panel, "autocorrelation")
    caption(panel, f"{int(np.count_nonzero(np.abs(r) > band))} of {last} lags outside")
