"""Figures of residuals over time, over frequency with coherence, and of a held-out record; errors
of estimates in their own standard deviations, ours beside published ones; equivalent derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ident.tracing.diagnosis import FittedRecord, Prediction
from scenarios.plots.display import (
    MEASURED_DATA,
    axis_label,
    display_unit,
    escaped_dollars,
    scaled_unit,
    signed,
    symbol,
)
from scenarios.plots.signals import MethodOutputs, context, figure_fit
from scenarios.plots.style import (
    BLACK,
    BLUE,
    LABEL_SIZE,
    LIGHT,
    SKY,
    TICK_SIZE,
    TRUE,
    VERMILION,
    WIDTH,
    ZERO,
    PanelsOverNames,
    caption,
    decades,
    finish,
    folded,
    make_sheet,
    method_style,
    text_width,
    time_axis,
    y_label,
)

CLIPPED_SIGMAS = 8.0  # standard deviations; an error beyond becomes an arrow with its size
_LABEL_WIDTH = 2.0  # inches, where a label is folded
_OWN_OFFSET = 0.17  # offset of our residuals within a row
_PUBLISHED_OFFSET = -0.17  # offset of published ones within a row


@dataclass(frozen=True)
class ComparisonRow:
    """One parameter: true value, estimate, standard deviation and, if there is one, the
    published value with its own.

    All in one unit. ``label`` is shown instead of the name's symbol, e.g. to tell methods apart.
    """

    name: str
    true: float
    estimate: float
    std: float
    published: float | None = None
    published_std: float | None = None
    label: str = ""


@dataclass(frozen=True)
class EquivalentRow:
    """A derivative of a flexible aircraft: rigid, statically condensed and estimated value, in
    ``unit``.
    """

    aircraft: str
    name: str
    unit: str
    rigid: float
    condensed: float
    estimate: float
    std: float
    published: float | None = None
    published_std: float | None = None


@dataclass(frozen=True, eq=False)
class ErrorCloud:
    """Errors of one method on one flight in its own sigmas, ``(n, M)`` by derivative and run, and
    how often each outcome came.
    """

    method: str
    flight: str
    names: tuple[str, ...]
    sigmas: np.ndarray
    outcomes: Mapping[str, int]


def figure_repeated(clouds: Sequence[ErrorCloud], title: str = "") -> Figure:
    """Return the errors of all runs in reported sigmas, one panel per method: of each derivative a
    column of dots for each flight, its root mean square a bar.

    The band of two is shaded; errors beyond ``CLIPPED_SIGMAS`` stand at the edge. Above a panel how
    many runs settled.
    """
    methods, flights = (
        list(dict.fromkeys(each.method for each in clouds)),
        list(dict.fromkeys(each.flight for each in clouds)),
    )
    sheet = make_sheet([1.45] * len(methods), row_gap=0.42)
    for method, panel in zip(methods, sheet.panels, strict=True):
        mine = [each for each in clouds if each.method == method]
        names = mine[0].names
        settled = ", ".join(
            f"{each.flight} {each.outcomes.get('converged', 0)} of {sum(each.outcomes.values())}"
            for each in mine
        )
        caption(panel, f"{method}; settled: {settled}")
        panel.axhspan(-2.0, 2.0, color=LIGHT, alpha=0.55, linewidth=0, label="within ±2σ")
        panel.axhline(0.0, **ZERO)
        for each in mine:
            place = flights.index(each.flight)
            style = {"color": method_style(place)["color"], "label": each.flight}
            offset = (place - 0.5 * (len(flights) - 1)) * 0.8 / len(flights)
            for i, errors in enumerate(each.sigmas):
                spread = np.linspace(-0.06, 0.06, max(len(errors), 1))[: len(errors)]
                shown = np.clip(errors, -CLIPPED_SIGMAS, CLIPPED_SIGMAS)
                panel.plot(
                    i + offset + spread, shown, ".", markersize=2.5, markeredgewidth=0.0, **style
                )
                if len(errors):
                    size = min(float(np.sqrt(np.mean(errors**2))), CLIPPED_SIGMAS)
                    panel.plot(
                        [i + offset] * 2, [-size, size], "-", linewidth=1.4, color=style["color"]
                    )
        panel.set_xticks(range(len(names)), [symbol(name) for name in names])
        panel.tick_params(labelbottom=True)
        panel.set_xlim(-0.6, len(names) - 0.4)
        widest = max(
            (float(np.max(np.abs(each.sigmas), initial=0.0)) for each in mine), default=0.0
        )
        panel.set_ylim(*(np.array([-1.05, 1.05]) * min(max(widest, 3.5), CLIPPED_SIGMAS)))
        panel.grid(False, axis="x")
        y_label(panel, "error (σ)")
    return finish(sheet, title, bottom=0.3, head=0.24)


def figure_comparison(rows: Sequence[ComparisonRow], title: str = "") -> Figure:
    """Return the error of each parameter, estimate minus true, in the standard deviations that its
    method itself states.

    The band of two is shaded. Errors in per cent stand at the right: a method that states a large
    deviation is not near the truth for being within it. A published value without a deviation has
    its per cent only.
    """
    n, has_published = len(rows), any(row.published is not None for row in rows)
    lines = [
        folded(escaped_dollars(row.label), _LABEL_WIDTH) if row.label else [symbol(row.name)]
        for row in rows
    ]
    labels = ["\n".join(some) for some in lines]
    left = max([1.0, *(text_width(line) + 0.2 for some in lines for line in some)])
    tallest = max((len(some) for some in lines), default=1)
    sheet = make_sheet(
        [(0.34 + 0.15 * max(0, tallest - 2)) * n + 0.1],
        count=min(n, 1),
        left=left,
        right=1.85 if has_published else 1.0,
    )
    panel = sheet.panels[0]
    # right edges of the columns of errors
    first, second = (1.0 + inches / (WIDTH - sheet.left - sheet.right) for inches in (0.8, 1.65))
    panel.axvspan(-2.0, 2.0, color=LIGHT, alpha=0.55, linewidth=0, label="within ±2σ")
    panel.axvline(0.0, **ZERO)
    heading = n - 0.35
    for x, text, colour in ((first, "this study", BLUE), (second, "published", VERMILION)):
        if has_published or colour == BLUE:
            panel.text(
                x,
                heading,
                text,
                transform=panel.get_yaxis_transform(),
                ha="right",
                va="bottom",
                fontsize=TICK_SIZE,
                color=colour,
            )
    for place, row in enumerate(rows):
        y = float(n - 1 - place)
        offset = _OWN_OFFSET if has_published else 0.0
        if row.std > 0:
            _point(panel, (row.estimate - row.true) / row.std, y + offset, "o", BLUE, "this study")
        _percent(panel, first, y, row.estimate, row.true, BLUE)
        if row.published is not None:
            if row.published_std is not None and row.published_std > 0:
                _point(
                    panel,
                    (row.published - row.true) / row.published_std,
                    y + _PUBLISHED_OFFSET,
                    "s",
                    VERMILION,
                    "published",
                )
            _percent(panel, second, y, row.published, row.true, VERMILION)
    panel.set_yticks(range(n), labels[::-1])
    panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
    panel.set_ylim(-0.55, n - 0.45)
    panel.set_xlim(-CLIPPED_SIGMAS - 1.0, CLIPPED_SIGMAS + 1.0)
    panel.set_xticks(np.arange(-CLIPPED_SIGMAS, CLIPPED_SIGMAS + 1.0, 2.0))
    panel.set_xlabel("error in its own standard deviations (σ)", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.22)


def figure_equivalents(rows: Sequence[EquivalentRow], title: str = "") -> Figure:
    """Equivalent derivatives, one panel each: rigid value (dashed), condensed, estimated and
    published for each aircraft.

    Bars are two standard deviations; where one is not seen it is smaller than its mark. Aircraft
    (or methods) with names too long for the axis are numbered there and named under the title.
    """
    names, aircraft = (
        list(dict.fromkeys(row.name for row in rows)),
        list(dict.fromkeys(row.aircraft for row in rows)),
    )
    panels = PanelsOverNames.of(len(names), aircraft, "method", title)
    for name, panel in zip(names, panels.sheet.panels, strict=True):
        of_name = [row for row in rows if row.name == name]
        # A power of ten stands in the unit, not above the axis.
        base = display_unit(of_name[0].unit, name)
        unit = scaled_unit(
            base,
            base.factor
            * max(
                abs(value) for row in of_name for value in (row.rigid, row.condensed, row.estimate)
            ),
        )
        caption(panel, axis_label(name, unit), LABEL_SIZE)
        for row in of_name:
            x = float(aircraft.index(row.aircraft))
            panel.plot(
                [x - 0.4, x + 0.4], [unit.factor * row.rigid] * 2, label="rigid, true", **TRUE
            )
            panel.plot(
                [x - 0.2],
                [unit.factor * row.condensed],
                "D",
                color=BLACK,
                markersize=4.5,
                label="condensed",
            )
            _bar(panel, x, row.estimate, row.std, unit.factor, "o", BLUE, "estimated ±2σ")
            if row.published is not None:
                _bar(
                    panel,
                    x + 0.2,
                    row.published,
                    row.published_std,
                    unit.factor,
                    "s",
                    VERMILION,
                    "published ±2σ",
                )
    return panels.finished(head=0.26)


def _point(panel: Axes, error: float, y: float, marker: str, colour: str, label: str) -> None:
    """A mark at the error, or an arrow at the edge with the error's size."""
    if abs(error) <= CLIPPED_SIGMAS:
        panel.plot(
            [error], [y], marker=marker, color=colour, markersize=5.5, linestyle="none", label=label
        )
        return
    side = float(np.sign(error))
    panel.plot(
        [side * (CLIPPED_SIGMAS + 0.6)],
        [y],
        marker=">" if side > 0 else "<",
        color=colour,
        markersize=6.0,
        linestyle="none",
    )
    panel.plot([], [], marker=marker, color=colour, markersize=5.5, linestyle="none", label=label)
    text = f"{signed(error, '.0f' if abs(error) < 1e4 else '.0e')} σ"
    panel.text(
        side * (CLIPPED_SIGMAS + 0.15),
        y,
        text,
        ha="right" if side > 0 else "left",
        va="center",
        fontsize=TICK_SIZE,
        color=colour,
    )


def _percent(panel: Axes, x: float, y: float, value: float, true: float, colour: str) -> None:
    text = f"{signed(100.0 * (value - true) / abs(true), '.3g')} %" if true else "–"
    panel.text(
        x,
        y,
        text,
        transform=panel.get_yaxis_transform(),
        ha="right",
        va="center",
        fontsize=TICK_SIZE,
        color=colour,
    )


def _bar(
    panel: Axes,
    x: float,
    value: float,
    std: float | None,
    factor: float,
    marker: str,
    colour: str,
    label: str,
) -> None:
    bar = None if std is None else [2.0 * factor * std]
    panel.errorbar(
        [x],
        [factor * value],
        yerr=bar,
        fmt=marker,
        color=colour,
        markersize=4.5,
        linewidth=1.2,
        capsize=2.5,
        label=label,
    )


# ---- Residuals and their spectra before and after, and the held-out record

_BAND = "±2σ of the sensor noise"


def figure_residuals(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Return the residuals of the fitted record against time, left with the declared model, right
    with the effects, one scale for both.

    Where nothing was added there is one column. ``noise`` is the noise's standard deviation by
    channel. Samples that were set aside are ringed; angles in degrees.
    """
    shown = _measured(fitted)
    count, same = len(shown), _same(fitted, [row for row, _ in shown])
    sides = (
        (("residual", fitted.after),)
        if same
        else (("before", fitted.before), ("after", fitted.after))
    )
    sheet = make_sheet([1.25] * count, (1.0,) * len(sides), row_gap=0.3, column_gap=0.42)
    for line, (row, name) in zip(sheet.axes, shown, strict=True):
        channel = fitted.record[name]
        unit, valid = display_unit(channel.unit), channel.valid
        aside = valid & ~fitted.used[row]
        limit = 0.0
        for panel, (when, residuals) in zip(line, sides, strict=True):
            values = unit.factor * residuals[row]
            _few_ticks(panel)
            _band(panel, unit.factor * noise.get(name, 0.0))
            panel.plot(
                fitted.record.time[valid],
                values[valid],
                color=BLUE,
                marker=".",
                markersize=2.5,
                markeredgewidth=0.0,
                linestyle="none",
                label="residual",
            )
            if np.any(aside):
                ring: dict[str, Any] = {
                    "marker": "o",
                    "markersize": 5.5,
                    "markerfacecolor": "none",
                    "markeredgewidth": 0.9,
                    "linestyle": "none",
                }
                panel.plot(
                    fitted.record.time[aside],
                    values[aside],
                    color=VERMILION,
                    label="set aside",
                    **ring,
                )
            limit = max(limit, float(np.abs(values[valid]).max(initial=0.0)))
            rms = (
                float(np.sqrt(np.mean(values[valid & fitted.used[row]] ** 2)))
                if np.any(valid & fitted.used[row])
                else 0.0
            )
            caption(panel, f"{when}: rms {rms:#.3g} {unit.text}")
        for panel in line:
            panel.set_ylim(-1.08 * limit or -1.0, 1.08 * limit or 1.0)
        for panel in line[1:]:
            panel.tick_params(labelleft=False)
        y_label(line[0], axis_label(name, unit))
    for panel in sheet.axes[-1]:
        time_axis(panel)
    return finish(sheet, title, head=0.24)


def figure_held_out(
    prediction: Prediction, noise: Mapping[str, float], title: str = "", data: str = MEASURED_DATA
) -> Figure:
    """Return the predicted record: its inputs and what no model predicts, such as the airspeed;
    then its samples, called ``data``, predicted with and without the effects, and below what each
    leaves; angles in degrees.

    One prediction where nothing was added.
    """
    same = np.array_equal(prediction.after, prediction.before)
    both = (("predicted after", prediction.after), ("predicted before", prediction.before))
    shown = (("predicted", prediction.before),) if same else both
    responses = [
        MethodOutputs(label, dict(zip(prediction.channels, values, strict=True)))
        for label, values in shown
    ]
    record = prediction.record
    above = context(record, prediction.channels)
    figure = figure_fit(record, responses, None, title, noise, data, above=above)
    for panel in figure.axes:
        _few_ticks(panel)
    return figure


COHERENCE_SEGMENTS = 15  # that overlap by half, of a coherence


def figure_spectra(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Return the power spectra of the residuals before and after over that of the noise: white
    noise of the right size lies at one. One where nothing was added.

    Periodograms under a Hann window, averaged over neighbouring frequencies; below each its
    coherence with the inputs, with the level that noise alone exceeds once in twenty. Samples
    missing or set aside count as zero, uneven sampling is read as even at its mean interval.
    """
    shown = _measured(fitted)
    inputs = np.array([each.values for each in fitted.record.inputs if np.ptp(each.values) > 0.0])
    coherent = len(inputs) > 0 and len(fitted.record) >= 16 * COHERENCE_SEGMENTS
    sheet = make_sheet([1.25, *([0.7] if coherent else [])] * len(shown), row_gap=0.3)
    same = _same(fitted, [row for row, _ in shown])
    interval = float(fitted.record.time[-1] - fitted.record.time[0]) / (len(fitted.record) - 1)
    uppers = sheet.panels[:: 2 if coherent else 1]
    for number, (panel, (row, name)) in enumerate(zip(uppers, shown, strict=True)):
        used = fitted.used[row] & fitted.record[name].valid
        panel.axhline(1.0, color=BLACK, linewidth=0.8, linestyle=(0, (4, 2)), label="white noise")
        both = ((fitted.before[row], "before", 1), (fitted.after[row], "after", 0))
        alone = ((fitted.after[row], "residual", 0),)
        lines = alone if same else both
        for residual, label, order in lines:
            hertz, power = spectrum(
                np.where(used, residual, 0.0), interval, int(np.count_nonzero(used))
            )
            panel.plot(
                hertz,
                power / (noise.get(name) or 1.0) ** 2,
                label=label,
                **method_style(order, alone=len(lines) == 1),
            )
            if coherent:
                below = sheet.panels[2 * number + 1]
                at, shares = input_coherence(np.where(used, residual, 0.0), inputs, interval)
                look = method_style(order, alone=len(lines) == 1)
                below.plot(at, shares, **look)
        if coherent:
            level = coherence_level(len(inputs))
            below.axhline(level, color=BLACK, linewidth=0.8, linestyle=(0, (4, 2)))
            below.set_ylim(0.0, 1.05)
            y_label(below, "coherence (–)", TICK_SIZE)
        panel.set_yscale("log")
        panel.set_xscale("log")
        bottom, top = panel.get_ylim()
        panel.set_ylim(max(bottom, 1e-2), min(max(top, 10.0), 1e6))
        decades(panel.xaxis, (1.0, 2.0, 5.0))
        decades(panel.yaxis)
        y_label(panel, f"{symbol(name)}: power / noise (–)")
    sheet.panels[-1].set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.12)


def input_coherence(
    residual: np.ndarray, inputs: np.ndarray, interval: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the frequencies (Hz) and multiple coherence of a residual ``(N,)`` with inputs ``(q,
    N)``: the share of its power that follows the inputs linearly (Bendat and Piersol, *Random
    Data*, 4th edition, 2010, chapter 7).
    """
    length = 2 * residual.size // (COHERENCE_SEGMENTS + 1)
    starts = range(0, residual.size - length + 1, max(length // 2, 1))
    # SciPy's signal package takes longer to load than this to compute.
    rows = np.array([[row[at : at + length] for at in starts] for row in (*inputs, residual)])
    rows = np.fft.rfft((rows - rows.mean(axis=2, keepdims=True)) * np.hanning(length), axis=2)
    matrix = np.einsum("asf,bsf->fab", rows.conj(), rows) / len(starts)
    own, cross, power = matrix[:, :-1, :-1], matrix[:, :-1, -1], matrix[:, -1, -1].real
    own = own + 1e-9 * np.trace(own, axis1=1, axis2=2).real[:, None, None] * np.eye(len(inputs))
    solved = np.linalg.solve(own + 1e-300 * np.eye(len(inputs)), cross[..., None])[..., 0]
    share = np.sum(cross.conj() * solved, axis=1).real / np.where(power > 0.0, power, np.inf)
    hertz = np.fft.rfftfreq(length, interval)
    return hertz[1:], np.clip(share, 0.0, 1.0)[1:]


def coherence_level(inputs: int) -> float:
    """Multiple coherence that noise alone exceeds once in twenty, of ``COHERENCE_SEGMENTS``
    segments.
    """
    from scipy.special import betaincinv

    return float(betaincinv(inputs, COHERENCE_SEGMENTS - inputs, 0.95))


def spectrum(residual: np.ndarray, interval: float, used: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the frequencies (Hz) and power of a series ``(N,)`` of which ``used`` samples are not
    zero by default; white noise of variance s2 gives s2.
    """
    n = len(residual)
    window = np.hanning(n)
    share = float(np.sum(window**2)) * max(used, 1) / n
    power = np.abs(np.fft.rfft(residual * window)) ** 2 / share
    hertz = np.fft.rfftfreq(n, interval)
    width = 1 if n < 100 else 5
    smooth = np.convolve(power[1:], np.ones(width) / width, mode="valid")
    return hertz[1 + width // 2 : 1 + width // 2 + len(smooth)], smooth


def _same(fitted: FittedRecord, rows: Sequence[int]) -> bool:
    """Return whether before and after differ by less than a figure can show."""
    change, size = (
        np.abs(fitted.before - fitted.after)[rows].max(axis=1, initial=0.0),
        np.abs(fitted.after)[rows].max(axis=1, initial=0.0),
    )
    return bool(np.all(change <= 5e-3 * size))


def _measured(fitted: FittedRecord) -> list[tuple[int, str]]:
    """Row and name of the channels that this record has; others of the fit may lack it."""
    return [
        (row, name)
        for row, name in enumerate(fitted.channels)
        if name in fitted.record.output_names
    ]


def _band(panel: Axes, sigma: float) -> None:
    if sigma > 0.0:
        panel.axhspan(-2.0 * sigma, 2.0 * sigma, color=SKY, alpha=0.25, linewidth=0, label=_BAND)
    panel.axhline(0.0, **ZERO)


def _few_ticks(panel: Axes) -> None:
    """Use few ticks, which take most of the drawing time."""
    for axis, bins in ((panel.xaxis, 5), (panel.yaxis, 3)):
        axis.set_major_locator(MaxNLocator(nbins=bins, steps=[1, 2, 2.5, 5, 10]))
