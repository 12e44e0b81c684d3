"""A whole flight with its maneuvers marked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
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
    """
    record = found.record
    names = [name for name in (*AXES, *SHOWN) if name in record.output_names]
    sheet = make_sheet([0.95] * len(names), row_gap=0.2)
    for name, panel in zip(names, sheet.panels, strict=True):
        unit = display_unit(record[name].unit, name)
        time, low, high = envelope(record.time, unit.factor * record[name].with_gaps())
        time, low, high = _parted(time, low, high)
        panel.fill_between(time, low, high, color=BLUE, linewidth=0.6, step=None)
        y_label(panel, axis_label(name, unit), TICK_SIZE)
        panel.set_xlim(float(record.time[0]), float(record.time[-1]))
        for each in found.maneuvers:
            one = each.found
            if one.axis == "all":
                panel.axvspan(one.start, one.end, color=LIGHT, alpha=0.6, linewidth=0.0, zorder=0.5)
            elif one.channel == name or one.channel not in names:
                panel.axvspan(
                    one.start,
                    one.end,
                    color=COLOURS[one.axis],
                    alpha=0.3,
                    linewidth=0.0,
                    zorder=0.6,
                )
                panel.axvline(one.start, color=COLOURS[one.axis], linewidth=0.7, zorder=0.7)
                middle = (0.5 * (one.start + one.end), 1.0)
                panel.annotate(
                    str(each.number),
                    middle,
                    xycoords=("data", "axes fraction"),
                    ha="center",
                    va="bottom",
                    fontsize=TICK_SIZE - 2.0,
                    color=COLOURS[one.axis],
                )
    data = SIMULATED_DATA if found.simulated else MEASURED_DATA
    time_axis(sheet.panels[-1])
    return finish(
        sheet,
        f"{title}\n{data}; numbers as in the table; grey: trim points" if title else "",
        head=0.2,
        legend=False,
    )


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
