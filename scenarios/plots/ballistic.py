"""The falling body: trajectory, ballistic coefficient and its error."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ident.estimate import FilterHistory
from scenarios.plots.display import (
    KILOMETRES,
    MEASURED_DATA,
    METRES_PER_SECOND,
    POUNDS_PER_SQUARE_FOOT,
    SIMULATED_DATA,
    DisplayUnit,
    plain,
    signed,
    symbol,
)
from scenarios.plots.histories import Course, course
from scenarios.plots.style import (
    BLUE,
    MEASURED,
    SKY,
    TICK_SIZE,
    TRUE,
    VERMILION,
    WIDTH,
    ZERO,
    Sheet,
    caption,
    finish,
    folded,
    make_sheet,
    method_style,
    time_axis,
    y_label,
)
from sim.record import Record
from sim.truth.flight import Truth


def figure_trajectory(record: Record, histories: Mapping[str, FilterHistory], truth: Truth | None = None, title: str = "") -> Figure:
    """Altitude and velocity against time, measured, true and estimated by each method (name: history).

    With the truth the errors of both, estimate minus true, stand beside them with bounds of two standard deviations.
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
    for row, (name, unit, fine) in enumerate((("altitude", KILOMETRES, metres), ("velocity", METRES_PER_SECOND, METRES_PER_SECOND))):
        panel = sheet.axes[row][0]
        y_label(panel, f"{name} ({unit.text})")
        for number, (label, history) in enumerate(histories.items()):
            path = course(history, name, unit.factor)
            panel.plot(path.time, path.mean, label=plain(label), **method_style(number))
        if truth is not None:
            actual = truth.states[name]
            panel.plot(truth.time, unit.factor * actual, label="true", zorder=5, **TRUE)
            _errors(sheet.axes[row][1], name, fine, histories, actual)
    for panel in sheet.axes[-1]:
        time_axis(panel)
    return finish(sheet, title, head=0.24 if errors else 0.08)


def figure_ballistic_coefficient(
    histories: Mapping[str, FilterHistory], true: float | np.ndarray | None = None, unit: DisplayUnit = POUNDS_PER_SQUARE_FOOT, title: str = ""
) -> Figure:
    """The ballistic coefficient over time by each method, two side by side, and with the truth its error below.

    ``true`` is in kg/m2, like the histories' ``beta``, one number or ``(N,)`` if it drifted; ``unit`` is what the figure
    shows. Bands and bounds are two standard deviations. The axis of the error is that of the later half of the flight:
    the first errors may lie outside.
    """
    count, per_row = len(histories), 1 if true is None else 2
    blocks = -(-count // 2)
    sheet = make_sheet(
        [1.9 if blocks == 1 else 1.4] * per_row * blocks, (1.0,) * min(count, 2), row_gap=0.36 if blocks == 1 else 0.62, column_gap=0.6
    )
    room = (WIDTH - sheet.left - sheet.right - sheet.column_gap) / 2
    paths = {label: course(history, "beta", unit.factor) for label, history in histories.items()}
    errors: list[np.ndarray] = []
    lowest: list[Axes] = []
    for number, (label, path) in enumerate(paths.items()):
        row, column = per_row * (number // 2), number % 2
        panel = sheet.axes[row][column]
        lowest = [*lowest[-1:], sheet.axes[row + per_row - 1][column]]
        lowest[-1].tick_params(labelbottom=True)
        caption(panel, "\n".join(folded(plain(label) if path.time.size else f"{plain(label)}: no sound sample", room, TICK_SIZE)))
        if column == 0:
            y_label(panel, f"{symbol('beta')} ({unit.text})")
            if true is not None:
                y_label(sheet.axes[row + 1][0], f"error in {symbol('beta')} ({unit.text})")
        panel.fill_between(path.time, path.mean - 2.0 * path.std, path.mean + 2.0 * path.std, color=SKY, alpha=0.35, linewidth=0, label="±2σ")
        panel.plot(path.time, path.mean, color=BLUE, linewidth=1.2, label="estimate")
        if true is not None:
            actual = unit.factor * np.broadcast_to(true, len(histories[label].time))[: path.time.size]
            panel.plot(path.time, actual, label="true", zorder=5, **TRUE)
            errors.append(path.mean - actual)
            _error(sheet.axes[row + 1][column], path, errors[-1])
    for row in range(per_row * blocks) if count % 2 and blocks > 1 else ():
        if row >= per_row * (blocks - 1):
            sheet.axes[row][1].set_visible(False)
    _share_limits(
        sheet, 0, per_row, *_range([array for path in paths.values() for array in (path.mean - 2.0 * path.std, path.mean + 2.0 * path.std)])
    )
    if true is not None:
        limit = max(_late_limit(error, path.std) for error, path in zip(errors, paths.values(), strict=True))
        _share_limits(sheet, 1, per_row, -limit, limit)
    for panel in lowest:
        time_axis(panel)
    return finish(sheet, title, head=0.24 if blocks == 1 else 0.38)


def _error(panel: Axes, path: Course, error: np.ndarray) -> None:
    panel.axhline(0.0, **ZERO)
    panel.plot(path.time, error, color=BLUE, linewidth=1.2)
    for sign in (-2.0, 2.0):
        panel.plot(path.time, sign * path.std, color=VERMILION, linewidth=1.0, label="±2σ bounds of the error")
    if path.time.size and path.std[-1] > 0:
        caption(panel, f"at the end {signed(error[-1], '.3g')} ({signed(error[-1] / path.std[-1], '.1f')} σ)")


def _errors(panel: Axes, name: str, unit: DisplayUnit, histories: Mapping[str, FilterHistory], actual: np.ndarray) -> None:
    panel.axhline(0.0, **ZERO)
    limit = 0.0
    for number, (_, history) in enumerate(histories.items()):
        path, look = course(history, name, unit.factor), method_style(number)
        error = path.mean - unit.factor * actual[: path.time.size]
        panel.plot(path.time, error, **look)
        for sign in (-2.0, 2.0):
            panel.plot(
                path.time, sign * path.std, color=look["color"], linewidth=0.5 * look["linewidth"], linestyle=look["linestyle"], zorder=look["zorder"]
            )
        limit = max(limit, _late_limit(error, path.std, 0.1))
    panel.set_ylim(-limit or -1.0, limit or 1.0)
    y_label(panel, f"error ({unit.text})")
    caption(panel, f"{name}: estimate − true, thin: ±2σ")


def _late_limit(error: np.ndarray, std: np.ndarray, after: float = 0.5) -> float:
    """A limit for what an error and its bounds do after this share of the samples."""
    if error.size == 0:
        return 1.0
    start = int(after * error.size)
    return 1.15 * max(float(np.abs(error[start:]).max()), 2.0 * float(np.median(std[start:]))) or 1.0


def _range(arrays: list[np.ndarray]) -> tuple[float, float]:
    filled = [array for array in arrays if array.size]
    if not filled:
        return 0.0, 1.0
    low, high = min(float(array.min()) for array in filled), max(float(array.max()) for array in filled)
    margin = 0.05 * (high - low) or 1.0
    return low - margin, high + margin


def _share_limits(sheet: Sheet, first: int, every: int, low: float, high: float) -> None:
    for row in sheet.axes[first::every]:
        for panel in row:
            panel.set_ylim(low, high)
