"""Figures that only the labs need: functions that take results and return figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from scenarios.plots.display import display_unit, spectrum, symbol
from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    LABEL_SIZE,
    SKY,
    VERMILION,
    ZERO,
    caption,
    finish,
    make_sheet,
    method_style,
    time_axis,
    y_label,
)

if TYPE_CHECKING:
    from ident.structure.selection import SelectionStep

_PADDING = 16  # length of the padded input over that of the input, for a finely drawn spectrum
_LAGS = 50  # most lags of an autocorrelation
_HIGHEST_DRAWN = 15.0  # rad/s, of a spectrum


def figure_input_spectrum(
    time: np.ndarray, values: np.ndarray, frequency: float, label: str
) -> Figure:
    """Return a figure of an elevator input over time and of the magnitude of its spectrum.

    Parameters
    ----------
    time : ``(N,)``, s, in equal intervals.
    values : ``(N,)``, rad; the figure shows degrees.
    frequency : rad/s, natural frequency of a mode, which a line marks in the spectrum.
    label : label of that line.
    """
    sheet = make_sheet([1.7], (1.0, 1.0), share_x=False, column_gap=0.8)
    left, right = sheet.panels
    shown = display_unit("rad")
    left.step(time, shown.factor * values, where="post", color=BLUE, linewidth=1.2)
    y_label(left, "elevator (deg)")
    time_axis(left)
    interval = float(time[1] - time[0])
    omega = 2.0 * np.pi * np.fft.rfftfreq(_PADDING * len(values), interval)
    magnitude = interval * np.abs(np.fft.rfft(shown.factor * values, _PADDING * len(values)))
    drawn = omega < _HIGHEST_DRAWN
    right.plot(omega[drawn], magnitude[drawn], color=BLUE, linewidth=1.2)
    right.axvline(frequency, color=VERMILION, linewidth=1.2, linestyle="--", label=label)
    right.set_xlabel("frequency (rad/s)", fontsize=LABEL_SIZE)
    y_label(right, "|spectrum| (deg s)")
    return finish(sheet)


def figure_residual(
    time: np.ndarray,
    residual: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    noise: Mapping[str, float],
    marks: Sequence[float] = (),
) -> Figure:
    """Return a figure of residuals, with a row for each channel.

    A row has the residual over time with the band of two noise sigmas, its power spectrum over
    that of the noise, and its autocorrelation with the 95 % band of white noise.

    Parameters
    ----------
    time : ``(N,)``, s, in equal intervals.
    residual : channel -> ``(N,)`` residual in its SI unit.
    units : channel -> SI unit.
    noise : channel -> noise sigma in its SI unit.
    marks : natural frequencies of elastic modes, rad/s, marked in the spectra.
    """
    sheet = make_sheet(
        [1.35] * len(residual), (1.35, 1.0, 0.8), share_x=True, row_gap=0.35, column_gap=0.72
    )
    for row, (name, values) in zip(sheet.axes, residual.items(), strict=True):
        unit = display_unit(units[name])
        row[0].plot(time, unit.factor * values, color=BLUE, linewidth=0.6)
        row[0].axhspan(
            -2 * unit.factor * noise[name],
            2 * unit.factor * noise[name],
            color=SKY,
            alpha=0.3,
            linewidth=0,
            label="±2σ of the noise",
        )
        row[0].xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        y_label(row[0], f"{symbol(name)} ({unit.text})")
        _draw_power(row[1], time, values, noise[name], marks)
        rho = autocorrelation(values, _LAGS)
        row[2].vlines(np.arange(1, _LAGS + 1), 0.0, rho, color=BLUE, linewidth=1.0)
        row[2].axhspan(
            -1.96 / np.sqrt(len(values)),
            1.96 / np.sqrt(len(values)),
            color=GREY,
            alpha=0.3,
            linewidth=0,
            label="95 % of white noise",
        )
        row[2].axhline(0.0, **ZERO)
        row[2].set_ylim(min(-0.3, 1.1 * rho.min()), max(0.3, 1.1 * rho.max()))
    for panel, text in zip(
        sheet.axes[0], ("residual", "power / noise", "autocorrelation"), strict=True
    ):
        caption(panel, text)
    time_axis(sheet.axes[-1][0])
    sheet.axes[-1][1].set_xlabel("rad/s", fontsize=LABEL_SIZE)
    sheet.axes[-1][2].set_xlabel("lag (samples)", fontsize=LABEL_SIZE)
    return finish(sheet, head=0.25)


def _draw_power(  # type: ignore[no-untyped-def]
    panel, time: np.ndarray, values: np.ndarray, noise: float, marks: Sequence[float]
) -> None:
    """Draw the power spectrum of a residual over that of its noise; see `figure_residual`."""
    hertz, power = spectrum(values, float(time[1] - time[0]), len(values))
    panel.axhline(1.0, color=BLACK, linewidth=0.8, linestyle=(0, (4, 2)))
    panel.plot(2.0 * np.pi * hertz, power / noise**2, color=BLUE, linewidth=1.0)
    for number, mark in enumerate(marks):
        panel.axvline(
            mark,
            color=VERMILION,
            linewidth=1.0,
            linestyle=":",
            label="" if number else "elastic modes",
        )
    panel.set_xscale("log")
    panel.set_yscale("log")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(LogLocator())
        axis.set_minor_formatter(NullFormatter())
    if panel.get_ylim()[0] > 0.05:
        panel.set_ylim(bottom=0.05)


def autocorrelation(values: np.ndarray, lags: int) -> np.ndarray:
    """Return the autocorrelation ``(lags,)`` of a series ``(N,)`` minus its mean, from lag 1."""
    e = values - values.mean()
    return np.array([float(e[k:] @ e[:-k]) for k in range(1, lags + 1)]) / float(e @ e)


def figure_scatter(errors: Mapping[str, np.ndarray]) -> Figure:
    """Return histograms of the errors of many runs, with the standard normal density.

    ``errors`` has, for each parameter, the errors of the N runs over their reported sigmas,
    ``(N,)``.
    """
    columns = min(3, len(errors))
    sheet = make_sheet(
        [1.2] * -(-len(errors) // columns),
        (1.0,) * columns,
        count=len(errors),
        row_gap=0.6,
        column_gap=0.4,
        left=0.45,
        share_x=False,
    )
    for panel, (name, values) in zip(sheet.panels, errors.items(), strict=True):
        reach = max(4.0, min(30.0, 1.1 * float(np.max(np.abs(values)))))
        grid = np.linspace(-reach, reach, 301)
        panel.hist(values, bins=31, range=(-reach, reach), density=True, color=SKY, label="runs")
        panel.plot(
            grid,
            np.exp(-0.5 * grid**2) / np.sqrt(2.0 * np.pi),
            color=GREEN,
            linewidth=1.2,
            label="standard normal density",
        )
        panel.set_yticks([])
        caption(panel, symbol(name))
    for panel in sheet.panels[-columns:]:
        panel.set_xlabel("error (reported sigmas)", fontsize=LABEL_SIZE)
    return finish(sheet, head=0.25)


def figure_structure(
    steps: Sequence[SelectionStep],
    spread: float,
    shown: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
    axis: str,
) -> Figure:
    """Return a figure of the unexplained variance after each step of a stepwise regression, and of
    the coefficient as measured and as modelled.

    Parameters
    ----------
    steps : steps of the regression of the coefficient ``axis``.
    spread : variance of the measured coefficient; the predicted squared error (PSE) is divided by
        it.
    shown : caption of a panel -> time (s), measured and modelled coefficient, each ``(M,)``.
    axis : name of the coefficient, such as ``Cm``.
    """
    sheet = make_sheet([1.7], (1.1, *(1.0,) * len(shown)), share_x=False, column_gap=0.65)
    left, *rest = sheet.panels
    n = np.arange(1, len(steps) + 1)
    rows = {
        "fitted: 1 - R²": [1.0 - step.r2 for step in steps],
        "left out: 1 - R²": [1.0 - step.held_out for step in steps],
        "PSE / variance": [step.pse / spread for step in steps],
    }
    for number, (label, values) in enumerate(rows.items()):
        if np.all(np.isfinite(values)) and len(values):
            left.plot(n, values, marker="o", markersize=3, label=label, **method_style(number))
    left.set_yscale("log")
    left.xaxis.set_major_locator(MaxNLocator(integer=True))
    left.set_xlabel("step", fontsize=LABEL_SIZE)
    y_label(left, "share of the variance")
    for panel, (text, (time, measured, modelled)) in zip(rest, shown.items(), strict=True):
        panel.plot(time, measured, color=GREY, lw=2.2, label="measured")
        panel.plot(time, modelled, color=BLUE, lw=1.1, label="modelled")
        caption(panel, text)
        time_axis(panel)
        y_label(panel, symbol(axis))
    return finish(sheet, head=0.25)


def figure_bode(omega: np.ndarray, responses: Mapping[str, np.ndarray], unit: str) -> Figure:
    """Return the Bode plot of frequency responses: magnitude in dB and phase in degrees.

    Parameters
    ----------
    omega : ``(n,)``, rad/s.
    responses : label -> complex response ``(n,)``, in ``unit``.
    unit : unit of the responses.
    """
    sheet = make_sheet([1.5, 1.5], row_gap=0.25)
    for number, (label, response) in enumerate(responses.items()):
        style = method_style(number)
        sheet.panels[0].plot(omega, 20.0 * np.log10(np.abs(response)), label=label, **style)
        sheet.panels[1].plot(omega, np.degrees(np.unwrap(np.angle(response))), **style)
    for panel, text in zip(sheet.panels, (f"magnitude (dB of {unit})", "phase (deg)"), strict=True):
        panel.set_xscale("log")
        y_label(panel, text)
    sheet.panels[1].set_xlabel("frequency (rad/s)", fontsize=LABEL_SIZE)
    return finish(sheet)
