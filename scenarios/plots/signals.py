"""Records, and measured against estimated responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ident.estimate import Estimate
from scenarios.plots.display import MEASURED_DATA, axis_label, display_unit, plain
from scenarios.plots.style import BLUE, MEASURED, SKY, TICK_SIZE, TRUE, ZERO, caption, finish, make_sheet, method_style, time_axis, y_label
from sim.record import Channel, Hold, Record
from sim.truth.flight import Truth


@dataclass(frozen=True, eq=False)
class Response:
    """What a method says the outputs were: by output name ``(N,)`` at the record's samples, NaN where it says nothing."""

    label: str
    outputs: Mapping[str, np.ndarray]


def response_of(estimate: Estimate, label: str = "", record: int = 0) -> Response:
    """The response that an estimate carries for its record number ``record``.

    Of a filter it is the prediction one sample ahead, NaN where a sample was missing or the filter had broken down.
    """
    values = np.array(estimate.fitted[record], dtype=float)
    shown = label or (estimate.method.upper() if len(estimate.method) <= 3 else estimate.method.replace("-", " "))
    if estimate.history is not None:
        values[~estimate.history.valid] = np.nan
        shown = label or f"{shown}, one sample ahead"
    return Response(shown, dict(zip(estimate.output_names, values, strict=True)))


def units_of(record: Record, names: Sequence[str]) -> list[str]:
    """The units of a record's channels, in the order of ``names``."""
    return [record[name].unit for name in names]


def figure_record(record: Record, title: str = "", data: str = MEASURED_DATA) -> Figure:
    """Inputs and outputs against time: inputs as they are held, outputs as dots, called ``data``; the number of missing samples is stated.

    Angles in degrees.
    """
    sheet = make_sheet([1.0] * len(record.inputs) + [1.3] * len(record.outputs), row_gap=0.3)
    style = "steps-post" if record.hold is Hold.PREVIOUS else "default"
    for channel, panel in zip(record.channels, sheet.panels, strict=True):
        unit = display_unit(channel.unit)
        if channel.name in record.input_names:
            panel.plot(record.time, unit.factor * channel.values, color=BLUE, linewidth=1.2, drawstyle=style)
            caption(panel, "input, held between samples" if record.hold is Hold.PREVIOUS else "input, linear between samples")
        else:
            _dots(panel, record, channel, unit.factor, data)
            lost = int(np.count_nonzero(~channel.valid))
            caption(panel, f"{data}, {lost} of {len(record)} samples missing" if lost else data)
        y_label(panel, axis_label(channel.name, unit))
    time_axis(sheet.panels[-1])
    return finish(sheet, title, head=0.22, legend=False)


def figure_fit(
    record: Record,
    responses: Sequence[Response],
    truth: Truth | None = None,
    title: str = "",
    noise_std: Mapping[str, float] | None = None,
    data: str = MEASURED_DATA,
) -> Figure:
    """The outputs of a record (dots, called ``data``) against the estimated ones, and below each the residual, record minus estimate.

    Parameters
    ----------
    responses : one for each method, drawn over each other; outputs of which none speaks are left out.
    truth : its noise-free outputs are added, dashed.
    noise_std : by output; adds a band of two standard deviations of the measurement noise to the residual.

    Angles in degrees. Raises ModelError when no response speaks of any output.
    """
    shown = [channel for channel in record.outputs if any(channel.name in response.outputs for response in responses)]
    sheet = make_sheet([1.45, 1.0] * len(shown), row_gap=0.18)
    for number, channel in enumerate(shown):
        unit = display_unit(channel.unit)
        above, below = sheet.panels[2 * number], sheet.panels[2 * number + 1]
        _dots(above, record, channel, unit.factor, data)
        if truth is not None and channel.name in truth.outputs:
            above.plot(truth.time, unit.factor * truth.outputs[channel.name], label="true", zorder=5, **TRUE)
        if noise_std is not None and channel.name in noise_std:
            band = 2.0 * unit.factor * noise_std[channel.name]
            below.axhspan(-band, band, color=SKY, alpha=0.25, linewidth=0, label="±2σ of the sensor noise")
        below.axhline(0.0, **ZERO)
        for order, response in enumerate(responses):
            if channel.name not in response.outputs:
                continue
            look, values = method_style(order, alone=len(responses) == 1 and truth is None), unit.factor * response.outputs[channel.name]
            above.plot(record.time, values, label=plain(response.label), **look)
            residual = np.where(channel.valid, unit.factor * channel.values - values, np.nan)
            below.plot(record.time, residual, linestyle="none", marker=".", markersize=2.5, markeredgewidth=0.0, color=look["color"])
        _keep_in_sight(above, below, unit.factor * channel.values[channel.valid])
        y_label(above, axis_label(channel.name, unit))
        y_label(below, f"residual ({unit.text})", TICK_SIZE)
    time_axis(sheet.panels[-1])
    return finish(sheet, title, head=0.16)


def _keep_in_sight(above: Axes, below: Axes, measured: np.ndarray) -> None:
    """A response that runs away may leave the panels: the measurement is not flattened for it."""
    low, high = float(measured.min()), float(measured.max())
    reach = 1.5 * (high - low) or 1.0
    bottom, top = above.get_ylim()
    above.set_ylim(max(bottom, low - reach), min(top, high + reach))
    if bottom < low - reach or top > high + reach:
        caption(above, "a response leaves the panel")
    bottom, top = below.get_ylim()
    below.set_ylim(max(bottom, -reach), min(top, reach))


def _dots(panel: Axes, record: Record, channel: Channel, factor: float, data: str) -> None:
    panel.plot(record.time[channel.valid], factor * channel.values[channel.valid], label=data, **MEASURED)
