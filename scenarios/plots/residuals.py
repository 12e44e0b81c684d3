"""Figures of residuals: over time, over frequency with coherence, and of a held-out record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    symbol,
)
from scenarios.plots.signals import Response, context, figure_fit
from scenarios.plots.style import (
    BLACK,
    BLUE,
    LABEL_SIZE,
    SKY,
    TICK_SIZE,
    VERMILION,
    ZERO,
    caption,
    decades,
    finish,
    make_sheet,
    method_style,
    time_axis,
    y_label,
)

# ---- Residuals and their spectra before and after, and the held-out record

_BAND = "±2σ of the sensor noise"


def figure_residuals(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Residuals of the fitted record against time, left with the declared model, right with the
    effects, one scale for both.

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
    """The predicted record: its inputs and what no model predicts, such as the airspeed; then its
    samples, called ``data``, predicted with and without the effects, and below what each leaves;
    angles in degrees.

    One prediction where nothing was added.
    """
    same = np.array_equal(prediction.after, prediction.before)
    both = (("predicted after", prediction.after), ("predicted before", prediction.before))
    shown = (("predicted", prediction.before),) if same else both
    responses = [
        Response(label, dict(zip(prediction.channels, values, strict=True)))
        for label, values in shown
    ]
    record = prediction.record
    above = context(record, prediction.channels)
    figure = figure_fit(record, responses, None, title, noise, data, above=above)
    for panel in figure.axes:
        _few_ticks(panel)
    return figure


SEGMENTS = 15  # that overlap by half, of a coherence


def figure_spectra(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Power spectra of the residuals before and after over that of the noise: white noise of the
    right size lies at one. One where nothing was added.

    Periodograms under a Hann window, averaged over neighbouring frequencies; below each its
    coherence with the inputs, with the level that noise alone exceeds once in twenty. Samples
    missing or set aside count as zero, uneven sampling is read as even at its mean interval.
    """
    shown = _measured(fitted)
    inputs = np.array([each.values for each in fitted.record.inputs if np.ptp(each.values) > 0.0])
    coherent = len(inputs) > 0 and len(fitted.record) >= 16 * SEGMENTS
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
    """Frequencies (Hz) and multiple coherence of a residual ``(N,)`` with inputs ``(q, N)``: the
    share of its power that follows the inputs linearly (Bendat and Piersol, *Random Data*, 4th
    edition, 2010, chapter 7).
    """
    length = 2 * residual.size // (SEGMENTS + 1)
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
    """Multiple coherence that noise alone exceeds once in twenty, of ``SEGMENTS`` segments."""
    from scipy.special import betaincinv

    return float(betaincinv(inputs, SEGMENTS - inputs, 0.95))


def spectrum(residual: np.ndarray, interval: float, used: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and power of a series ``(N,)`` of which ``used`` samples are not zero by
    default; white noise of variance s2 gives s2.
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
    """Whether before and after differ by less than a figure can show: nothing was added."""
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
    """Ticks are most of what drawing costs, and a narrow panel has no room for many."""
    for axis, bins in ((panel.xaxis, 5), (panel.yaxis, 3)):
        axis.set_major_locator(MaxNLocator(nbins=bins, steps=[1, 2, 2.5, 5, 10]))
