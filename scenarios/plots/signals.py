"""Figures of signals: measured and estimated responses, falling bodies, reconstructed channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ident.compatibility.kinematics import UNITS
from ident.compatibility.trials import Reconstruction
from ident.estimate import Estimate, FilterHistory
from scenarios.plots.display import (
    KILOMETRES,
    MEASURED_DATA,
    METRES_PER_SECOND,
    POUNDS_PER_SQUARE_FOOT,
    SIMULATED_DATA,
    DisplayUnit,
    StateHistory,
    axis_label,
    course,
    display_unit,
    escaped_dollars,
    signed,
    symbol,
)
from scenarios.plots.style import (
    BLUE,
    DOTS,
    GREEN,
    MEASURED,
    SKY,
    TICK_SIZE,
    TRUE,
    VERMILION,
    WIDTH,
    ZERO,
    Sheet,
    caption,
    draw_estimate,
    finish,
    folded,
    make_sheet,
    method_style,
    time_axis,
    y_label,
)
from sim.record import Channel, Hold, Record
from sim.truth.flight import Truth

# ---- Records, and measured against estimated responses


@dataclass(frozen=True, eq=False)
class MethodOutputs:
    """Outputs of a method for a record.

    Attributes
    ----------
    label : label of the method.
    outputs : values by output at the samples of the record, shape ``(N,)``; NaN if missing.
    """

    label: str
    outputs: Mapping[str, np.ndarray]


def response_of(estimate: Estimate, label: str = "", record: int = 0) -> MethodOutputs:
    """Return the outputs of an estimate for one of its records.

    The outputs of a filter are one-step predictions. They are NaN if a sample was missing or the
    filter had diverged.

    Parameters
    ----------
    label : label of the method; empty: the name of the method.
    record : number of the record, from 0.
    """
    values = np.array(estimate.fitted[record], dtype=float)
    method = estimate.method
    name = method.upper() if len(method) <= 3 else method.replace("-", " ")
    if estimate.history is not None:
        values[~estimate.history.valid] = np.nan
        name = f"{name}, one sample ahead"
    return MethodOutputs(label or name, dict(zip(estimate.output_names, values, strict=True)))


def units_of(record: Record, names: Sequence[str]) -> list[str]:
    """Return the units of a record's channels, in the order of ``names``."""
    return [record[name].unit for name in names]


def figure_record(record: Record, title: str = "", data: str = MEASURED_DATA) -> Figure:
    """Plot inputs (lines) and outputs (dots) over time, with the number of missing samples.

    ``data``: legend label of the samples. Angles in degrees.
    """
    sheet = make_sheet([1.0] * len(record.inputs) + [1.3] * len(record.outputs), row_gap=0.3)
    style = "steps-post" if record.hold is Hold.PREVIOUS else "default"
    for channel, panel in zip(record.channels, sheet.panels, strict=True):
        unit = display_unit(channel.unit)
        if channel.name in record.input_names:
            panel.plot(
                record.time,
                unit.factor * channel.values,
                color=BLUE,
                linewidth=1.2,
                drawstyle=style,
            )
            caption(
                panel,
                "input, held between samples"
                if record.hold is Hold.PREVIOUS
                else "input, linear between samples",
            )
        else:
            _dots(panel, record, channel, unit.factor, data)
            lost = int(np.count_nonzero(~channel.valid))
            caption(panel, f"{data}, {lost} of {len(record)} samples missing" if lost else data)
        y_label(panel, axis_label(channel.name, unit))
    time_axis(sheet.panels[-1])
    return finish(sheet, title, head=0.22, legend=False)


def figure_fit(
    record: Record,
    responses: Sequence[MethodOutputs],
    truth: Truth | None = None,
    title: str = "",
    noise_std: Mapping[str, float] | None = None,
    data: str = MEASURED_DATA,
    above: Sequence[Channel] = (),
) -> Figure:
    """Plot recorded (dots) and estimated outputs, with the residual (record minus estimate) lower.

    Parameters
    ----------
    record : the record.
    responses : outputs of each method; an output that no method has is left out.
    truth : adds its outputs without noise, dashed.
    noise_std : noise level by output; adds a band of two noise levels to the residual.
    data : legend label of the samples.
    above : channels that are drawn above the outputs, such as inputs and airspeed.

    Angles are in degrees. Raises ModelError if there is no output to draw.
    """
    shown = [
        channel
        for channel in record.outputs
        if any(channel.name in response.outputs for response in responses)
    ]
    sheet = make_sheet(
        [*[0.9] * (len(above) if shown else 0), *[1.45, 1.0] * len(shown)], row_gap=0.18
    )
    _draw_channels(sheet.panels, record, above)
    for number, channel in enumerate(shown):
        unit = display_unit(channel.unit)
        upper, lower = sheet.panels[len(above) + 2 * number :][:2]
        _dots(upper, record, channel, unit.factor, data)
        if truth is not None and channel.name in truth.outputs:
            upper.plot(
                truth.time,
                unit.factor * truth.outputs[channel.name],
                label="true",
                zorder=5,
                **TRUE,
            )
        if noise_std is not None and channel.name in noise_std:
            band = 2.0 * unit.factor * noise_std[channel.name]
            lower.axhspan(
                -band, band, color=SKY, alpha=0.25, linewidth=0, label="±2σ of the sensor noise"
            )
        lower.axhline(0.0, **ZERO)
        for order, response in enumerate(responses):
            if channel.name not in response.outputs:
                continue
            line_style = method_style(order, alone=len(responses) == 1 and truth is None)
            values = unit.factor * response.outputs[channel.name]
            upper.plot(record.time, values, label=escaped_dollars(response.label), **line_style)
            residual = np.where(channel.valid, unit.factor * channel.values - values, np.nan)
            lower.plot(record.time, residual, color=line_style["color"], **DOTS)
        _limit_to_measured(upper, lower, unit.factor * channel.values[channel.valid])
        y_label(upper, axis_label(channel.name, unit))
        y_label(lower, f"residual ({unit.text})", TICK_SIZE)
    time_axis(sheet.panels[-1])
    return finish(sheet, title, head=0.16)


def context(record: Record, shown: Sequence[str]) -> list[Channel]:
    """Return the channels to draw above the outputs ``shown``: inputs and all other outputs."""
    return [*record.inputs, *(channel for channel in record.outputs if channel.name not in shown)]


def _draw_channels(panels: Sequence[Axes], record: Record, channels: Sequence[Channel]) -> None:
    is_held = record.hold is Hold.PREVIOUS
    for panel, channel in zip(panels, channels, strict=False):
        unit = display_unit(channel.unit)
        values = np.where(channel.valid, unit.factor * channel.values, np.nan)
        steps = is_held and channel.name in record.input_names
        style = "steps-post" if steps else "default"
        panel.plot(record.time, values, color=GREEN, linewidth=1.2, drawstyle=style)
        panel.yaxis.set_major_locator(MaxNLocator(3))
        y_label(panel, axis_label(channel.name, unit))


def _limit_to_measured(upper: Axes, lower: Axes, measured: np.ndarray) -> None:
    """Limit a panel and the panel of its residual to a range about the measured values, ``(N,)``.

    A diverging response is cut off, and a caption says so.
    """
    low, high = float(measured.min()), float(measured.max())
    margin = 1.5 * (high - low) or 1.0
    bottom, top = upper.get_ylim()
    upper.set_ylim(max(bottom, low - margin), min(top, high + margin))
    if bottom < low - margin or top > high + margin:
        caption(upper, "a response leaves the panel")
    bottom, top = lower.get_ylim()
    lower.set_ylim(max(bottom, -margin), min(top, margin))


def _dots(panel: Axes, record: Record, channel: Channel, factor: float, data: str) -> None:
    """Draw the samples of a channel, times ``factor``, as dots with the label ``data``."""
    panel.plot(
        record.time[channel.valid], factor * channel.values[channel.valid], label=data, **MEASURED
    )


# ---- Falling body: trajectory, ballistic coefficient and its error


def figure_trajectory(
    record: Record,
    histories: Mapping[str, FilterHistory],
    truth: Truth | None = None,
    title: str = "",
) -> Figure:
    """Plot altitude and velocity over time: measured, true, and estimated by each method.

    If the truth is known, panels on the right show the errors with two-sigma bounds.
    """
    errors = truth is not None
    sheet = make_sheet([1.9, 1.9], (1.0, 1.0) if errors else (1.0,), row_gap=0.36, column_gap=0.8)
    altitude = record["altitude"]
    top = sheet.axes[0][0]
    top.plot(
        record.time[altitude.valid],
        KILOMETRES.factor * altitude.values[altitude.valid],
        label=SIMULATED_DATA if truth is not None else MEASURED_DATA,
        **MEASURED,
    )
    metres = DisplayUnit("m")
    for row, (name, unit, error_unit) in enumerate(
        (("altitude", KILOMETRES, metres), ("velocity", METRES_PER_SECOND, METRES_PER_SECOND))
    ):
        panel = sheet.axes[row][0]
        y_label(panel, f"{name} ({unit.text})")
        for number, (label, history) in enumerate(histories.items()):
            path = course(history, name, unit.factor)
            panel.plot(path.time, path.mean, label=escaped_dollars(label), **method_style(number))
        if truth is not None:
            actual = truth.states[name]
            panel.plot(truth.time, unit.factor * actual, label="true", zorder=5, **TRUE)
            _draw_errors(sheet.axes[row][1], name, error_unit, histories, actual)
    for panel in sheet.axes[-1]:
        time_axis(panel)
    return finish(sheet, title, head=0.24 if errors else 0.08)


def figure_ballistic_coefficient(
    histories: Mapping[str, FilterHistory], true: float | np.ndarray | None = None, title: str = ""
) -> Figure:
    """Plot the ballistic coefficient over time by each method, and its error if the truth is known.

    Bands are two standard deviations. The second half of the flight sets the limits of the axes of
    errors.

    Parameters
    ----------
    histories : history of each method; its ``beta`` is in kg/m2, the figure in lb/ft2.
    true : true ballistic coefficient, kg/m2, a number or ``(N,)``.
    """
    unit = POUNDS_PER_SQUARE_FOOT
    # A block has two methods: a row of estimates and, if the truth is known, a row of errors.
    count, block_rows = len(histories), 1 if true is None else 2
    blocks = -(-count // 2)
    sheet = make_sheet(
        [1.9 if blocks == 1 else 1.4] * block_rows * blocks,
        (1.0,) * min(count, 2),
        row_gap=0.36 if blocks == 1 else 0.62,
        column_gap=0.6,
    )
    available_width = (WIDTH - sheet.left - sheet.right - sheet.column_gap) / 2
    paths = {label: course(history, "beta", unit.factor) for label, history in histories.items()}
    errors: list[np.ndarray] = []
    lowest: list[Axes] = []
    for number, (label, path) in enumerate(paths.items()):
        row, column = block_rows * (number // 2), number % 2
        panel = sheet.axes[row][column]
        lowest = [*lowest[-1:], sheet.axes[row + block_rows - 1][column]]
        lowest[-1].tick_params(labelbottom=True)
        heading = escaped_dollars(label)
        if not path.time.size:
            heading = f"{heading}: no sound sample"
        caption(panel, "\n".join(folded(heading, available_width, TICK_SIZE)))
        if column == 0:
            y_label(panel, f"{symbol('beta')} ({unit.text})")
            if true is not None:
                y_label(sheet.axes[row + 1][0], f"error in {symbol('beta')} ({unit.text})")
        draw_estimate(panel, path.time, path.mean, path.std)
        if true is not None:
            count = len(histories[label].time)
            actual = unit.factor * np.broadcast_to(true, count)[: path.time.size]
            panel.plot(path.time, actual, label="true", zorder=5, **TRUE)
            errors.append(path.mean - actual)
            _draw_error(sheet.axes[row + 1][column], path, errors[-1])
    if count % 2 and blocks > 1:  # the last block has no second method
        for row in range(block_rows * (blocks - 1), block_rows * blocks):
            sheet.axes[row][1].set_visible(False)
    bands = [
        edge
        for path in paths.values()
        for edge in (path.mean - 2.0 * path.std, path.mean + 2.0 * path.std)
    ]
    _share_limits(sheet, 0, block_rows, *_range(bands))
    if true is not None:
        limit = max(
            _settled_limit(error, path.std)
            for error, path in zip(errors, paths.values(), strict=True)
        )
        _share_limits(sheet, 1, block_rows, -limit, limit)
    for panel in lowest:
        time_axis(panel)
    return finish(sheet, title, head=0.24 if blocks == 1 else 0.38)


def _draw_error(panel: Axes, path: StateHistory, error: np.ndarray) -> None:
    """Draw an error, ``(N,)``, with two-sigma bounds; the caption has its last value."""
    panel.axhline(0.0, **ZERO)
    panel.plot(path.time, error, color=BLUE, linewidth=1.2)
    for sign in (-2.0, 2.0):
        panel.plot(
            path.time,
            sign * path.std,
            color=VERMILION,
            linewidth=1.0,
            label="±2σ bounds of the error",
        )
    if path.time.size and path.std[-1] > 0:
        caption(
            panel,
            f"at the end {signed(error[-1], '.3g')} ({signed(error[-1] / path.std[-1], '.1f')} σ)",
        )


def _draw_errors(
    panel: Axes,
    name: str,
    unit: DisplayUnit,
    histories: Mapping[str, FilterHistory],
    actual: np.ndarray,
) -> None:
    """Draw the errors of all methods with two-sigma bounds; ``actual``: true values, ``(N,)``."""
    panel.axhline(0.0, **ZERO)
    limit = 0.0
    for number, history in enumerate(histories.values()):
        path, line_style = course(history, name, unit.factor), method_style(number)
        error = path.mean - unit.factor * actual[: path.time.size]
        panel.plot(path.time, error, **line_style)
        for sign in (-2.0, 2.0):
            panel.plot(
                path.time,
                sign * path.std,
                color=line_style["color"],
                linewidth=0.5 * line_style["linewidth"],
                linestyle=line_style["linestyle"],
                zorder=line_style["zorder"],
            )
        limit = max(limit, _settled_limit(error, path.std, 0.1))
    panel.set_ylim(-limit or -1.0, limit or 1.0)
    y_label(panel, f"error ({unit.text})")
    caption(panel, f"{name}: estimate − true, thin: ±2σ")


def _settled_limit(error: np.ndarray, std: np.ndarray, after: float = 0.5) -> float:
    """Return an axis limit that contains an error and its bounds.

    The first samples, a share of ``after``, do not count.
    """
    if error.size == 0:
        return 1.0
    start = int(after * error.size)
    largest_error = float(np.abs(error[start:]).max())
    return 1.15 * max(largest_error, 2.0 * float(np.median(std[start:]))) or 1.0


def _range(arrays: list[np.ndarray]) -> tuple[float, float]:
    filled = [array for array in arrays if array.size]
    if not filled:
        return 0.0, 1.0
    low = min(float(array.min()) for array in filled)
    high = max(float(array.max()) for array in filled)
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _share_limits(sheet: Sheet, first: int, step: int, low: float, high: float) -> None:
    """Set the same limits in the rows ``first``, ``first + step`` ... of a sheet."""
    for row in sheet.axes[first::step]:
        for panel in row:
            panel.set_ylim(low, high)


# ---- Kinematic reconstruction against measurement


def figure_reconstruction(
    reconstruction: Reconstruction, title: str = "", data: str = MEASURED_DATA
) -> Figure:
    """Plot each output: recorded (dots), integrated from the other channels, and smoothed.

    Residuals are below. The integrated curve drifts because of the noise of these channels. Angles
    are in degrees. ``data``: legend label of the samples.
    """
    names = list(reconstruction.measured)
    sheet = make_sheet([1.45, 1.0] * len(names), row_gap=0.18)
    corrected = any(
        not np.array_equal(reconstruction.recorded[name], reconstruction.integrated[name])
        for name in names
    )
    for number, name in enumerate(names):
        unit = display_unit(UNITS[name])
        upper, lower = sheet.panels[2 * number : 2 * number + 2]
        measured, used = unit.factor * reconstruction.measured[name], reconstruction.used[name]
        upper.plot(reconstruction.time[used], measured[used], label=data, **MEASURED)
        lower.axhline(0.0, **ZERO)
        shown = [(reconstruction.recorded[name], "integrated from the other channels")]
        if corrected:
            shown.append((reconstruction.integrated[name], "with the faults found"))
        shown.append((reconstruction.smoothed[name], "smoothed"))
        for order, (values, label) in enumerate(shown):
            line_style = method_style(order)
            upper.plot(reconstruction.time, unit.factor * values, label=label, **line_style)
            residual = np.where(used, measured - unit.factor * values, np.nan)
            lower.plot(reconstruction.time, residual, color=line_style["color"], **DOTS)
        y_label(upper, axis_label(name, unit))
        y_label(lower, f"residual ({unit.text})", TICK_SIZE)
    time_axis(sheet.panels[-1])
    return finish(sheet, title, head=0.16)
