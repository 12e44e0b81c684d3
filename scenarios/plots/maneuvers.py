"""A whole flight with its maneuvers marked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ident.maneuver_detection import AXES, PAUSE, Maneuver
from scenarios.plots.display import MEASURED_DATA, SIMULATED_DATA, axis_label, display_unit
from scenarios.plots.style import (
    BLUE,
    GREEN,
    GREY,
    LIGHT,
    ORANGE,
    PURPLE,
    TICK_SIZE,
    VERMILION,
    finish,
    make_sheet,
    time_axis,
    y_label,
)
from sim.record import Record

COLOURS: Mapping[str, str] = {
    "pitch": VERMILION,
    "roll": GREEN,
    "yaw": PURPLE,
    "throttle": ORANGE,
    "all": GREY,
}
SHOWN = ("nz", "phi", "airspeed", "height", "altitude")  # of the motion
LONG_PAUSE = 0.3  # of the recorded time, from which on a pause is cut out
MOST_COLUMNS, NARROWEST = 4, 0.2  # parts of a figure, and the width of the shortest, of the longest
BINS = 1500  # along a panel, more than it has pixels


class Numbered(Protocol):
    """A maneuver with its number."""

    @property
    def number(self) -> int: ...
    @property
    def found(self) -> Maneuver: ...


class Searched(Protocol):
    """A record with its maneuvers."""

    @property
    def record(self) -> Record: ...
    @property
    def maneuvers(self) -> Sequence[Numbered]: ...
    @property
    def simulated(self) -> bool: ...


def figure_flight(found: Searched, title: str = "") -> Figure:
    """Controls and motion of a whole record, each as the band between its least and largest values, maneuvers as coloured spans.

    A maneuver is marked in the panel of its input, with its number above; trim points are grey in all panels. Angles in degrees.
    Long pauses in the rows are cut out: a column of panels for each part, wide as it is long.
    """
    record = found.record
    names = [name for name in (*AXES, *SHOWN) if name in record.output_names]
    parts = _parts(record.time)
    lengths = [last - first for first, last in parts]
    widths = [max(length, NARROWEST * max(lengths)) for length in lengths]
    sheet = make_sheet([0.95] * len(names), widths, row_gap=0.2, column_gap=0.12)
    for name, panels in zip(names, sheet.axes, strict=True):
        unit = display_unit(record[name].unit, name)
        time, low, high = _parted(*envelope(record.time, unit.factor * record[name].with_gaps()))
        marked = [each for each in found.maneuvers if each.found.axis == "all" or each.found.channel == name or each.found.channel not in names]
        for panel, (first, last) in zip(panels, parts, strict=True):
            panel.fill_between(time, low, high, color=BLUE, linewidth=0.6, step=None)
            for each in marked:
                if first <= each.found.start <= last:
                    _mark(panel, each)
            panel.set_xlim(first, last)
        limits = [panel.get_ylim() for panel in panels]
        for panel in panels:
            panel.set_ylim(min(least for least, _ in limits), max(most for _, most in limits))
            panel.tick_params(labelleft=panel is panels[0])
        y_label(panels[0], axis_label(name, unit), TICK_SIZE)
    data = SIMULATED_DATA if found.simulated else MEASURED_DATA
    for panel in sheet.axes[-1]:
        time_axis(panel)
    cut = "; pauses are cut out" if len(parts) > 1 else ""
    return finish(
        sheet,
        f"{title}\n{data}; numbers as in the table; grey: trim points{cut}" if title else "",
        head=0.2,
        legend=False,
    )


def _mark(panel: Axes, each: Numbered) -> None:
    """A maneuver as a span with its number above it; a trim point as a grey span."""
    one = each.found
    if one.axis == "all":
        panel.axvspan(one.start, one.end, color=LIGHT, alpha=0.6, linewidth=0.0, zorder=0.5)
        return
    colour = COLOURS[one.axis]
    panel.axvspan(one.start, one.end, color=colour, alpha=0.3, linewidth=0.0, zorder=0.6)
    panel.axvline(one.start, color=colour, linewidth=0.7, zorder=0.7)
    middle = (0.5 * (one.start + one.end), 1.0)
    panel.annotate(
        str(each.number),
        middle,
        xycoords=("data", "axes fraction"),
        ha="center",
        va="bottom",
        fontsize=TICK_SIZE - 2.0,
        color=colour,
    )


def _parts(time: np.ndarray) -> list[tuple[float, float]]:
    """Begin and end of the parts between long pauses, s; the longest pauses where there are more than a figure has columns for."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if steps.size else 0.0
    pauses = np.flatnonzero(steps > max(PAUSE, 5.0 * usual))
    recorded = float(time[-1] - time[0] - np.sum(steps[pauses]))
    long = pauses[steps[pauses] > LONG_PAUSE * recorded]
    cuts = np.sort(long[np.argsort(steps[long])[::-1][: MOST_COLUMNS - 1]])
    first, last = [time[0], *time[cuts + 1]], [*time[cuts], time[-1]]
    return [(float(begin), float(end)) for begin, end in zip(first, last, strict=True)]


def _parted(time: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, ...]:
    """The band with a hole at each pause in the rows."""
    steps = np.diff(time)
    pauses = np.flatnonzero(steps > max(PAUSE, 5.0 * float(np.median(steps)))) + 1 if steps.size else np.array([], dtype=int)
    return tuple(np.insert(values, pauses, np.nan) for values in (time, low, high))


def envelope(time: np.ndarray, values: np.ndarray, bins: int = BINS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middle, least and largest value of at most ``bins`` successive blocks of samples; blocks without a sample are left out.

    Neighbouring blocks share a sample, so that the band has no holes.
    """
    known = np.isfinite(values)
    time, values = time[known], values[known]
    if values.size <= 2 * bins:
        return time, values, values
    edges = np.linspace(0, values.size, bins + 1).astype(int)
    first = edges[:-1]
    low, high = np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)
    before = values[np.maximum(first - 1, 0)]
    return (
        time[(edges[:-1] + edges[1:] - 1) // 2],
        np.minimum(low, before),
        np.maximum(high, before),
    )
