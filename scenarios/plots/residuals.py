"""Figures of residuals over time and frequency, and of held-out records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ident.tracing.diagnosis import FittedRecord, Prediction
from scenarios.plots.display import MEASURED_DATA, axis_label, display_unit, symbol
from scenarios.plots.signals import MethodOutputs, context, figure_fit
from scenarios.plots.style import (
    BLACK,
    BLUE,
    DOTS,
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
            time = fitted.record.time
            panel.plot(time[valid], values[valid], color=BLUE, label="residual", **DOTS)
            if np.any(set_aside):
                ring: dict[str, Any] = {
                    "marker": "o",
                    "markersize": 5.5,
                    "markerfacecolor": "none",
                    "markeredgewidth": 0.9,
                    "linestyle": "none",
                }
                panel.plot(
                    time[set_aside], values[set_aside], color=VERMILION, label="set aside", **ring
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
