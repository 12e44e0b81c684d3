"""Figures of residuals over time and frequency, of held-out records, of errors of estimates, and of
equivalent derivatives.
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
    draw_bar,
    finish,
    folded,
    make_sheet,
    method_style,
    text_width,
    time_axis,
    y_label,
)

CLIPPED_SIGMAS = 8.0  # standard deviations; a larger error is an arrow with its size
_LABEL_WIDTH = 2.0  # inches; a longer label is folded
_OWN_OFFSET = 0.17  # offset of the errors of this study within a row
_PUBLISHED_OFFSET = -0.17  # offset of the errors of published estimates within a row


@dataclass(frozen=True)
class ComparisonRow:
    """A parameter beside its true and its published value, all in the same unit.

    Attributes
    ----------
    name : name of the parameter.
    true : true value.
    estimate, std : estimate and its standard deviation.
    published, published_std : published estimate and its standard deviation, or None.
    label : text in place of the symbol, to tell methods apart; empty for the symbol.
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
    """A derivative of a flexible aircraft, in ``unit``.

    Attributes
    ----------
    aircraft : name of the aircraft or method.
    name, unit : the derivative and its unit.
    rigid : value of the rigid aircraft.
    condensed : value with the elastic modes statically condensed.
    estimate, std : estimate and its standard deviation.
    published, published_std : published estimate and its standard deviation, or None.
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
    """Errors of a method on M repetitions of a flight.

    Attributes
    ----------
    method, flight : labels.
    names : names of the n derivatives.
    sigmas : errors over reported sigmas, shape ``(n, M)``.
    outcomes : outcome code -> number of runs.
    """

    method: str
    flight: str
    names: tuple[str, ...]
    sigmas: np.ndarray
    outcomes: Mapping[str, int]


def figure_repeated(clouds: Sequence[ErrorCloud], title: str = "") -> Figure:
    """Plot the errors of all runs in reported sigmas, a panel for each method.

    Each derivative has a column of dots for each flight, and a bar for their root mean square. The
    band of two sigmas is shaded. Errors beyond ``CLIPPED_SIGMAS`` stand at the edge. The caption of
    a panel has the number of runs that converged.
    """
    methods = list(dict.fromkeys(cloud.method for cloud in clouds))
    flights = list(dict.fromkeys(cloud.flight for cloud in clouds))
    sheet = make_sheet([1.45] * len(methods), row_gap=0.42)
    for method, panel in zip(methods, sheet.panels, strict=True):
        of_method = [cloud for cloud in clouds if cloud.method == method]
        names = of_method[0].names
        converged = ", ".join(
            f"{cloud.flight} {cloud.outcomes.get('converged', 0)} of {sum(cloud.outcomes.values())}"
            for cloud in of_method
        )
        caption(panel, f"{method}; settled: {converged}")
        panel.axhspan(-2.0, 2.0, color=LIGHT, alpha=0.55, linewidth=0, label="within ±2σ")
        panel.axhline(0.0, **ZERO)
        for cloud in of_method:
            number = flights.index(cloud.flight)
            style = {"color": method_style(number)["color"], "label": cloud.flight}
            # The columns of all flights share 0.8 of the distance between derivatives.
            offset = (number - 0.5 * (len(flights) - 1)) * 0.8 / len(flights)
            for i, errors in enumerate(cloud.sigmas):
                spread = np.linspace(-0.06, 0.06, max(len(errors), 1))[: len(errors)]
                shown = np.clip(errors, -CLIPPED_SIGMAS, CLIPPED_SIGMAS)
                panel.plot(
                    i + offset + spread, shown, ".", markersize=2.5, markeredgewidth=0.0, **style
                )
                if len(errors):
                    rms = min(float(np.sqrt(np.mean(errors**2))), CLIPPED_SIGMAS)
                    panel.plot(
                        [i + offset] * 2, [-rms, rms], "-", linewidth=1.4, color=style["color"]
                    )
        panel.set_xticks(range(len(names)), [symbol(name) for name in names])
        panel.tick_params(labelbottom=True)
        panel.set_xlim(-0.6, len(names) - 0.4)
        largest = max(float(np.max(np.abs(cloud.sigmas), initial=0.0)) for cloud in of_method)
        panel.set_ylim(*(np.array([-1.05, 1.05]) * min(max(largest, 3.5), CLIPPED_SIGMAS)))
        panel.grid(False, axis="x")
        y_label(panel, "error (σ)")
    return finish(sheet, title, bottom=0.3, head=0.24)


def figure_comparison(rows: Sequence[ComparisonRow], title: str = "") -> Figure:
    """Plot the error of each parameter, estimate minus true, in its own standard deviations.

    The band of two standard deviations is shaded. Errors in per cent stand at the right: an
    estimate within a large standard deviation may be far from the true value. A published value
    without a standard deviation has only its per cent.
    """
    n, has_published = len(rows), any(row.published is not None for row in rows)
    lines = [
        folded(escaped_dollars(row.label), _LABEL_WIDTH) if row.label else [symbol(row.name)]
        for row in rows
    ]
    labels = ["\n".join(label_lines) for label_lines in lines]
    left = max([1.0, *(text_width(line) + 0.2 for label_lines in lines for line in label_lines)])
    tallest = max((len(label_lines) for label_lines in lines), default=1)
    sheet = make_sheet(
        [(0.34 + 0.15 * max(0, tallest - 2)) * n + 0.1],
        count=min(n, 1),
        left=left,
        right=1.85 if has_published else 1.0,
    )
    panel = sheet.panels[0]
    # Right edges of the columns of errors in per cent, as shares of the panel.
    panel_width = WIDTH - sheet.left - sheet.right
    first, second = 1.0 + 0.8 / panel_width, 1.0 + 1.65 / panel_width
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
    """Plot equivalent derivatives, a panel for each.

    For each aircraft it has the rigid value (dashed) and the condensed, the estimated and the
    published value. Bars are two standard deviations; a bar that is not visible is smaller than its
    mark. Aircraft (or methods) whose names are too long for the axis have numbers there, with the
    names under the title.
    """
    names = list(dict.fromkeys(row.name for row in rows))
    aircraft = list(dict.fromkeys(row.aircraft for row in rows))
    panels = PanelsOverNames.of(len(names), aircraft, "method", title)
    for name, panel in zip(names, panels.sheet.panels, strict=True):
        of_name = [row for row in rows if row.name == name]
        # A power of ten stands in the unit, not above the axis.
        base = display_unit(of_name[0].unit, name)
        values = (value for row in of_name for value in (row.rigid, row.condensed, row.estimate))
        unit = scaled_unit(base, base.factor * max(map(abs, values)))
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
            factor = unit.factor
            estimate, std = factor * row.estimate, factor * row.std
            draw_bar(panel, x, estimate, std, "o", BLUE, "estimated ±2σ")
            if row.published is not None:
                value, std = factor * row.published, factor * (row.published_std or 0.0)
                draw_bar(panel, x + 0.2, value, std, "s", VERMILION, "published ±2σ")
    return panels.finished(head=0.26)


def _point(panel: Axes, error: float, y: float, marker: str, colour: str, label: str) -> None:
    """Draw a mark at an error, or an arrow at the edge with the size of a large error."""
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
    """Write the error of a value in per cent; a dash if the true value is zero."""
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


# ---- Residuals and spectra before and after effects are added, and the held-out record

_BAND = "±2σ of the sensor noise"


def figure_residuals(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Plot the residuals of a fitted record over time.

    Residuals of the declared model are at the left, those with the effects at the right, with the
    same scale. If no effect was added, there is a single column. Samples that were set aside have a
    ring. Angles are in degrees. ``noise``: noise level by channel.
    """
    shown = _measured(fitted)
    count = len(shown)
    if _same(fitted, [row for row, _ in shown]):
        sides = [("residual", fitted.after)]
    else:
        sides = [("before", fitted.before), ("after", fitted.after)]
    sheet = make_sheet([1.25] * count, (1.0,) * len(sides), row_gap=0.3, column_gap=0.42)
    for panels, (row, name) in zip(sheet.axes, shown, strict=True):
        channel = fitted.record[name]
        unit, valid = display_unit(channel.unit), channel.valid
        set_aside = valid & ~fitted.used[row]
        limit = 0.0
        for panel, (model, residuals) in zip(panels, sides, strict=True):
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
            if np.any(set_aside):
                ring: dict[str, Any] = {
                    "marker": "o",
                    "markersize": 5.5,
                    "markerfacecolor": "none",
                    "markeredgewidth": 0.9,
                    "linestyle": "none",
                }
                panel.plot(
                    fitted.record.time[set_aside],
                    values[set_aside],
                    color=VERMILION,
                    label="set aside",
                    **ring,
                )
            limit = max(limit, float(np.abs(values[valid]).max(initial=0.0)))
            used = valid & fitted.used[row]
            rms = float(np.sqrt(np.mean(values[used] ** 2))) if np.any(used) else 0.0
            caption(panel, f"{model}: rms {rms:#.3g} {unit.text}")
        for panel in panels:
            panel.set_ylim(-1.08 * limit or -1.0, 1.08 * limit or 1.0)
        for panel in panels[1:]:
            panel.tick_params(labelleft=False)
        y_label(panels[0], axis_label(name, unit))
    for panel in sheet.axes[-1]:
        time_axis(panel)
    return finish(sheet, title, head=0.24)


def figure_held_out(
    prediction: Prediction, noise: Mapping[str, float], title: str = "", data: str = MEASURED_DATA
) -> Figure:
    """Plot a predicted record.

    The upper panels have its inputs and outputs without a prediction, such as the airspeed. Below
    are the samples with the predictions with and without the effects, and the residual of each. If
    no effect was added, there is a single prediction. Angles are in degrees.

    Parameters
    ----------
    noise : noise level by channel.
    data : legend label of the samples.
    """
    predictions = [("predicted after", prediction.after), ("predicted before", prediction.before)]
    if np.array_equal(prediction.after, prediction.before):
        predictions = [("predicted", prediction.before)]
    responses = [
        MethodOutputs(label, dict(zip(prediction.channels, values, strict=True)))
        for label, values in predictions
    ]
    record = prediction.record
    upper_channels = context(record, prediction.channels)
    figure = figure_fit(record, responses, None, title, noise, data, above=upper_channels)
    for panel in figure.axes:
        _few_ticks(panel)
    return figure


COHERENCE_SEGMENTS = 15  # segments of a record for a coherence; they overlap by half
FEWEST_SEGMENT_SAMPLES = 16  # samples of a record for each segment, else no coherence is drawn
EXCEEDED_SHARE = 0.05  # probability that the coherence of noise exceeds the drawn level
INPUT_REGULARIZATION = 1e-9  # share of the inputs' power, for inputs that depend on each other
SMALLEST_POWER = 1e-300  # keeps the matrix of inputs without power regular
FEWEST_SMOOTHED_SAMPLES = 100  # spectra of shorter series are not smoothed
SMOOTHED_FREQUENCIES = 5  # neighbouring frequencies in a mean
VISIBLE_CHANGE = 5e-3  # share of the largest residual that a figure can show


def figure_spectra(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Plot power spectra of the residuals, before and after, over that of the noise.

    White noise of the right level is at one. If no effect was added, there is a single spectrum.
    Spectra are periodograms under a Hann window, averaged over neighbouring frequencies. Below each
    is the coherence with the inputs, with the level that noise alone exceeds once in twenty.
    Samples that are missing or set aside count as zero. Uneven sampling counts as even at its mean
    interval.
    """
    shown = _measured(fitted)
    moving = [channel for channel in fitted.record.inputs if np.ptp(channel.values) > 0.0]
    inputs = np.array([channel.values for channel in moving])
    fewest_samples = FEWEST_SEGMENT_SAMPLES * COHERENCE_SEGMENTS
    with_coherence = len(inputs) > 0 and len(fitted.record) >= fewest_samples
    heights = [1.25, 0.7] if with_coherence else [1.25]
    sheet = make_sheet(heights * len(shown), row_gap=0.3)
    same = _same(fitted, [row for row, _ in shown])
    interval = float(fitted.record.time[-1] - fitted.record.time[0]) / (len(fitted.record) - 1)
    spectrum_panels = sheet.panels[:: len(heights)]
    for number, (panel, (row, name)) in enumerate(zip(spectrum_panels, shown, strict=True)):
        used = fitted.used[row] & fitted.record[name].valid
        panel.axhline(1.0, color=BLACK, linewidth=0.8, linestyle=(0, (4, 2)), label="white noise")
        both = ((fitted.before[row], "before", 1), (fitted.after[row], "after", 0))
        single = ((fitted.after[row], "residual", 0),)
        lines = single if same else both
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
            if with_coherence:
                below = sheet.panels[2 * number + 1]
                hertz, coherence = input_coherence(np.where(used, residual, 0.0), inputs, interval)
                below.plot(hertz, coherence, **method_style(order, alone=len(lines) == 1))
        if with_coherence:
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
    """Return frequencies, Hz, and the multiple coherence of a residual with the inputs at each.

    The coherence is the share of the residual's power that follows the inputs linearly (Bendat and
    Piersol, *Random Data*, 4th edition, 2010, chapter 7).

    Parameters
    ----------
    residual : samples ``(N,)``.
    inputs : samples ``(q, N)``.
    interval : sampling interval, s.
    """
    length = 2 * residual.size // (COHERENCE_SEGMENTS + 1)
    starts = range(0, residual.size - length + 1, max(length // 2, 1))
    # SciPy's signal package is not used: it takes longer to load than this to compute.
    segments = np.array(
        [[row[start : start + length] for start in starts] for row in (*inputs, residual)]
    )
    segments = segments - segments.mean(axis=2, keepdims=True)
    transforms = np.fft.rfft(segments * np.hanning(length), axis=2)
    matrix = np.einsum("asf,bsf->fab", transforms.conj(), transforms) / len(starts)
    # Cross spectra of the inputs, of inputs and residual, and the spectrum of the residual.
    of_inputs, cross, power = matrix[:, :-1, :-1], matrix[:, :-1, -1], matrix[:, -1, -1].real
    unit = np.eye(len(inputs))
    trace = np.trace(of_inputs, axis1=1, axis2=2).real[:, None, None]
    of_inputs = of_inputs + INPUT_REGULARIZATION * trace * unit
    solved = np.linalg.solve(of_inputs + SMALLEST_POWER * unit, cross[..., None])[..., 0]
    share = np.sum(cross.conj() * solved, axis=1).real / np.where(power > 0.0, power, np.inf)
    hertz = np.fft.rfftfreq(length, interval)
    return hertz[1:], np.clip(share, 0.0, 1.0)[1:]


def coherence_level(inputs: int) -> float:
    """Return the multiple coherence that noise alone exceeds with ``EXCEEDED_SHARE``.

    ``inputs`` is the number of inputs. There are ``COHERENCE_SEGMENTS`` segments.
    """
    from scipy.special import betaincinv

    return float(betaincinv(inputs, COHERENCE_SEGMENTS - inputs, 1.0 - EXCEEDED_SHARE))


def spectrum(residual: np.ndarray, interval: float, used: int) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies, Hz, and the power of a series at each; that of white noise is its
    variance.

    Parameters
    ----------
    residual : samples ``(N,)``, zero where they are missing.
    interval : sampling interval, s.
    used : number of samples that are not missing.
    """
    count = len(residual)
    window = np.hanning(count)
    scale = float(np.sum(window**2)) * max(used, 1) / count
    power = np.abs(np.fft.rfft(residual * window)) ** 2 / scale
    hertz = np.fft.rfftfreq(count, interval)
    width = 1 if count < FEWEST_SMOOTHED_SAMPLES else SMOOTHED_FREQUENCIES
    smooth = np.convolve(power[1:], np.ones(width) / width, mode="valid")
    return hertz[1 + width // 2 : 1 + width // 2 + len(smooth)], smooth


def _same(fitted: FittedRecord, rows: Sequence[int]) -> bool:
    """Return whether before and after differ by less than a figure can show."""
    change = np.abs(fitted.before - fitted.after)[rows].max(axis=1, initial=0.0)
    size = np.abs(fitted.after)[rows].max(axis=1, initial=0.0)
    return bool(np.all(change <= VISIBLE_CHANGE * size))


def _measured(fitted: FittedRecord) -> list[tuple[int, str]]:
    """Return row and name of the fitted channels that the record measures."""
    return [
        (row, name)
        for row, name in enumerate(fitted.channels)
        if name in fitted.record.output_names
    ]


def _band(panel: Axes, sigma: float) -> None:
    """Draw the zero line, and the band of two sigmas of the noise if it is known."""
    if sigma > 0.0:
        panel.axhspan(-2.0 * sigma, 2.0 * sigma, color=SKY, alpha=0.25, linewidth=0, label=_BAND)
    panel.axhline(0.0, **ZERO)


def _few_ticks(panel: Axes) -> None:
    """Use few ticks; they take most of the time of drawing."""
    for axis, bins in ((panel.xaxis, 5), (panel.yaxis, 3)):
        axis.set_major_locator(MaxNLocator(nbins=bins, steps=[1, 2, 2.5, 5, 10]))
