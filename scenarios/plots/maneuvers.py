"""Figures of flights: maneuvers marked, maneuvers compared, fleets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ident.maneuver_detection import AXES, LONGEST_GAP, DetectedManeuver
from scenarios.plots.display import (
    MEASURED_DATA,
    SIMULATED_DATA,
    axis_label,
    display_unit,
    escaped_dollars,
)
from scenarios.plots.drawing import ORNAMENT
from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    LABEL_SIZE,
    LIGHT,
    ORANGE,
    PURPLE,
    TICK_SIZE,
    VERMILION,
    decades,
    finish,
    make_sheet,
    method_style,
    text_width,
    time_axis,
    y_label,
)
from sim.record import Record

# ---- A whole flight with its maneuvers marked

COLOURS: Mapping[str, str] = {
    "pitch": VERMILION,
    "roll": GREEN,
    "yaw": PURPLE,
    "throttle": ORANGE,
    "all": GREY,
}
SHOWN = ("nz", "phi", "airspeed", "height", "altitude")  # motion channels that are drawn
LONG_PAUSE = 0.3  # share of the recorded time; longer pauses are cut out
MOST_COLUMNS = 4  # columns of panels in a figure
NARROWEST_PANEL_SHARE = 0.2  # width of the narrowest panel, share of the widest
ENVELOPE_BINS = 1500  # along a panel, more than it has pixels


class Numbered(Protocol):
    """A maneuver with its number."""

    @property
    def number(self) -> int: ...
    @property
    def found(self) -> DetectedManeuver: ...


class Searched(Protocol):
    """A record with its maneuvers."""

    @property
    def record(self) -> Record: ...
    @property
    def maneuvers(self) -> Sequence[Numbered]: ...
    @property
    def simulated(self) -> bool: ...


def figure_flight(search: Searched, title: str = "") -> Figure:
    """Controls and motion of a whole record, each as the band between its least and largest values,
    maneuvers as coloured spans.

    A maneuver is marked in the panel of its input, with its number above; trim points are grey in
    all panels. Angles in degrees. Long pauses in the rows are cut out: a column of panels for each
    part, wide as it is long.
    """
    record = search.record
    names = [name for name in (*AXES, *SHOWN) if name in record.output_names]
    parts = _parts(record.time)
    lengths = [last - first for first, last in parts]
    widths = [max(length, NARROWEST_PANEL_SHARE * max(lengths)) for length in lengths]
    sheet = make_sheet([0.95] * len(names), widths, row_gap=0.2, column_gap=0.12)
    for name, panels in zip(names, sheet.axes, strict=True):
        unit = display_unit(record[name].unit, name)
        time, low, high = _parted(*envelope(record.time, unit.factor * record[name].with_gaps()))
        marked = [
            each
            for each in search.maneuvers
            if each.found.axis == "all"
            or each.found.channel == name
            or each.found.channel not in names
        ]
        for panel, (first, last) in zip(panels, parts, strict=True):
            if np.any(high > low):
                panel.fill_between(time, low, high, color=BLUE, linewidth=0.6, step=None)
            panel.plot(_filled(time), 0.5 * (low + high), color=BLUE, linewidth=0.6)
            for each in marked:
                if first <= each.found.start <= last:
                    _mark(panel, each)
            panel.set_xlim(first, last)
        limits = [panel.get_ylim() for panel in panels]
        for panel in panels:
            panel.set_ylim(min(least for least, _ in limits), max(most for _, most in limits))
            panel.tick_params(labelleft=panel is panels[0])
        y_label(panels[0], axis_label(name, unit), TICK_SIZE)
    data = SIMULATED_DATA if search.simulated else MEASURED_DATA
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
    panel.axvspan(
        *(one.start, one.end),
        color=colour,
        alpha=0.3,
        linewidth=0.0,
        zorder=0.6,
        label=f"{one.axis} maneuver",
    )
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
        gid=ORNAMENT,
    )


def _parts(time: np.ndarray) -> list[tuple[float, float]]:
    """Begin and end of the parts between long pauses, s; the longest pauses where there are more
    than a figure has columns for.
    """
    steps = np.diff(time)
    usual = float(np.median(steps)) if steps.size else 0.0
    pauses = np.flatnonzero(steps > max(LONGEST_GAP, 5.0 * usual))
    recorded = float(time[-1] - time[0] - np.sum(steps[pauses]))
    long = pauses[steps[pauses] > LONG_PAUSE * recorded]
    cuts = np.sort(long[np.argsort(steps[long])[::-1][: MOST_COLUMNS - 1]])
    first, last = [time[0], *time[cuts + 1]], [*time[cuts], time[-1]]
    return [(float(begin), float(end)) for begin, end in zip(first, last, strict=True)]


def _parted(time: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the band with a hole at each pause in the rows."""
    steps = np.diff(time)
    pauses = (
        np.flatnonzero(steps > max(LONGEST_GAP, 5.0 * float(np.median(steps)))) + 1
        if steps.size
        else np.array([], dtype=int)
    )
    return tuple(np.insert(values, pauses, np.nan) for values in (time, low, high))


def _filled(time: np.ndarray) -> np.ndarray:
    """Return the times with the holes at the moment after them, so that a line over them is rising
    and its values alone have holes.
    """
    holes = np.flatnonzero(np.isnan(time))
    filled = time.copy()
    filled[holes] = time[holes + 1]
    return filled


def envelope(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middle, least and largest value of at most ``ENVELOPE_BINS`` successive blocks of samples;
    blocks without a sample are left out.

    Neighbouring blocks share a sample, so that the band has no holes.
    """
    finite = np.isfinite(values)
    time, values = time[finite], values[finite]
    if values.size <= 2 * ENVELOPE_BINS:
        return time, values, values
    edges = np.linspace(0, values.size, ENVELOPE_BINS + 1).astype(int)
    first = edges[:-1]
    low, high = np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)
    before = values[np.maximum(first - 1, 0)]
    return (
        time[(edges[:-1] + edges[1:] - 1) // 2],
        np.minimum(low, before),
        np.maximum(high, before),
    )


# ---- Maneuvers that are compared: inputs and responses over time, with limits

_LIMIT: dict[str, Any] = {"color": BLACK, "linestyle": (0, (4, 2)), "linewidth": 0.8}
_IN_SIGHT = 1.6  # limits beyond this multiple of the motion are not drawn


@dataclass(frozen=True, eq=False)
class ManeuverCourse:
    """A maneuver: inputs and outputs by name, ``(N,)`` each, load factors as totals."""

    label: str
    inputs: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]


def figure_maneuvers(
    time: np.ndarray,
    courses: Sequence[ManeuverCourse],
    limits: Mapping[str, tuple[float, float]],
    units: Mapping[str, str],
    title: str = "",
) -> Figure:
    """Return one column per maneuver, the first the best; one row per input, held between samples,
    and an
    output; angles in degrees.

    ``limits``: lowest and highest by name, drawn where they are near what is flown.
    """
    names = [*courses[0].inputs, *courses[0].outputs]
    count = len(courses)
    sheet = make_sheet([1.0] * len(names), (1.0,) * count, column_gap=0.25, row_gap=0.12)
    for row, name in enumerate(names):
        unit = display_unit(units.get(name, ""), name)
        flown = [unit.factor * {**course.inputs, **course.outputs}[name] for course in courses]
        low, high = (
            min(float(each.min()) for each in flown),
            max(float(each.max()) for each in flown),
        )
        near = [unit.factor * end for end in limits.get(name, ()) if np.isfinite(end)]
        reach = _IN_SIGHT * (max(abs(low), abs(high)) or 1.0)
        shown = [end for end in near if abs(end) <= reach]
        low, high = min([low, *shown]), max([high, *shown])
        margin = 0.06 * (high - low) or 1.0
        for column, (course, values) in enumerate(zip(courses, flown, strict=True)):
            panel = sheet.axes[row][column]
            style: dict[str, Any] = {"drawstyle": "steps-post"} if name in course.inputs else {}
            look = method_style(column, alone=True)
            panel.plot(
                time,
                values,
                label=escaped_dollars(course.label),
                color=look["color"],
                linewidth=1.0,
                **style,
            )
            for end in shown:
                panel.axhline(end, **_LIMIT)
            panel.set_ylim(low - margin, high + margin)
            if column:
                panel.tick_params(labelleft=False)
        y_label(sheet.axes[row][0], axis_label(name, unit))
    for panel in sheet.axes[-1]:
        time_axis(panel)
    return finish(sheet, title, head=0.12)


class Expected(Protocol):
    """Frequency responses that are expected of one flight."""

    @property
    def frequency(self) -> np.ndarray: ...
    @property
    def inputs(self) -> Sequence[str]: ...
    @property
    def outputs(self) -> Sequence[str]: ...
    @property
    def coherence(self) -> np.ndarray: ...


def figure_coherence(kinds: Sequence[tuple[str, Any]], title: str = "") -> Figure:
    """Expected coherence over frequency: one row per output, one column per input, a line a
    maneuver.

    ``kinds`` : name of the maneuver and its ``Expected`` responses.
    """
    first: Expected = kinds[0][1]
    sheet = make_sheet(
        [1.0] * len(first.outputs), (1.0,) * len(first.inputs), column_gap=0.25, row_gap=0.12
    )
    for m, output in enumerate(first.outputs):
        for q, name in enumerate(first.inputs):
            panel = sheet.axes[m][q]
            for number, (kind, result) in enumerate(kinds):
                look = method_style(number, alone=True)
                panel.plot(
                    result.frequency,
                    result.coherence[m, q],
                    label=escaped_dollars(kind),
                    color=look["color"],
                    linewidth=1.2,
                )
            panel.axhline(0.6, color=GREY, linewidth=0.7, linestyle=":")
            panel.set_xscale("log")
            panel.set_xlim(float(first.frequency[0]), float(first.frequency[-1]))
            panel.set_ylim(0.0, 1.02)
            decades(panel.xaxis, (1.0, 2.0, 5.0))
            if q:
                panel.tick_params(labelleft=False)
            if m == len(first.outputs) - 1:
                panel.set_xlabel(f"frequency (Hz), {escaped_dollars(name)}", fontsize=LABEL_SIZE)
        y_label(sheet.axes[m][0], f"coherence of {escaped_dollars(output)} (–)")
    return finish(sheet, title, head=0.12)


# ---- Figures of a fleet of flights

_PANEL_HEIGHT = 1.15  # inches, height of a panel
_ROW_HEIGHT = 0.3  # inches, height of a row
# inner spreads of the values, beyond which an error bar that tells nothing is cut
_LARGEST_DRAWN_SPREADS = 5.0
_MOST_FLIGHT_NAMES = 45  # most names at an axis without overlap
_LONGEST_AXIS_NAME = 12  # letters of a name at an axis


@dataclass(frozen=True, eq=False)
class Line:
    """A line ``(k,)`` over ``along (k,)`` with its sigma ``(k,)``, and the scatter of flights about
    it.
    """

    along: np.ndarray
    middle: np.ndarray
    sigma: np.ndarray
    scatter: float


@dataclass(frozen=True, eq=False)
class OverCondition:
    """A derivative of n flights over a condition: values and sigmas ``(n,)``, outlying flights, and
    the pooled line.
    """

    name: str
    unit: str
    condition: np.ndarray
    values: np.ndarray
    sigmas: np.ndarray
    out: np.ndarray
    line: Line


@dataclass(frozen=True, eq=False)
class Shared:
    """A parameter that flights share: each flight's own value and sigma ``(n,)`` over the condition
    ``(n,)``, which have it, and the common one.
    """

    name: str
    unit: str
    condition: np.ndarray
    values: np.ndarray
    sigmas: np.ndarray
    has: np.ndarray
    common: float
    common_sigma: float


def figure_over_condition(
    rows: Sequence[OverCondition], condition: str, unit: str, title: str = ""
) -> Figure:
    """Return one panel per derivative: each flight with two sigmas, the pooled line with its band,
    and
    the scatter of the flights about it.
    """
    sheet = make_sheet(
        [_PANEL_HEIGHT] * (-(-len(rows) // 2)),
        (1.0, 1.0) if len(rows) > 1 else (1.0,),
        count=len(rows),
        row_gap=0.16,
    )
    across = display_unit(unit, condition)
    for row, panel in zip(rows, sheet.panels, strict=True):
        shown = display_unit(row.unit, row.name)
        at, along = across.factor * row.condition, across.factor * row.line.along
        middle, sigma = shown.factor * row.line.middle, shown.factor * row.line.sigma
        wide = 2.0 * np.hypot(sigma, shown.factor * row.line.scatter)
        panel.fill_between(
            along,
            middle - wide,
            middle + wide,
            color=LIGHT,
            alpha=0.6,
            linewidth=0,
            label="flights within ±2σ",
        )
        panel.fill_between(
            along,
            middle - 2 * sigma,
            middle + 2 * sigma,
            color=BLUE,
            alpha=0.3,
            linewidth=0,
            label="pooled ±2σ",
        )
        panel.plot(along, middle, "-", color=BLUE, linewidth=1.2, label="pooled")
        for chosen, colour, label in (
            (~row.out, BLACK, "one flight ±2σ"),
            (row.out, VERMILION, "stands out"),
        ):
            if np.any(chosen):
                values, sigmas = (
                    shown.factor * row.values[chosen],
                    shown.factor * row.sigmas[chosen],
                )
                panel.errorbar(
                    at[chosen],
                    values,
                    2 * sigmas,
                    fmt=".",
                    color=colour,
                    markersize=4.5,
                    elinewidth=0.7,
                    label=label,
                )
        _limits(panel, shown.factor * row.values, shown.factor * row.sigmas)
        y_label(panel, axis_label(row.name, shown))
    for panel in sheet.panels[-len(sheet.widths) :]:
        panel.set_xlabel(axis_label(condition, across), fontsize=LABEL_SIZE)
    return finish(sheet, title)


def figure_shared(rows: Sequence[Shared], condition: str, unit: str, title: str = "") -> Figure:
    """Return one panel per effect: the value of each flight by itself over the condition, and the
    common one of the flights that have it.
    """
    sheet = make_sheet([1.35] * len(rows), row_gap=0.2)
    across = display_unit(unit, condition)
    for row, panel in zip(rows, sheet.panels, strict=True):
        shown = display_unit(row.unit, row.name.rpartition(" ")[2])
        low, high = (shown.factor * (row.common + side * 2 * row.common_sigma) for side in (-1, 1))
        panel.axhspan(low, high, color=BLUE, alpha=0.3, linewidth=0, label="common value ±2σ")
        panel.axhline(shown.factor * row.common, color=BLUE, linewidth=1.2)
        for chosen, colour, label in (
            (row.has, BLACK, "has it, ±2σ"),
            (~row.has, GREY, "does not have it, or undecided"),
        ):
            if np.any(chosen):
                values, sigmas = (
                    shown.factor * row.values[chosen],
                    shown.factor * row.sigmas[chosen],
                )
                panel.errorbar(
                    across.factor * row.condition[chosen],
                    values,
                    2 * sigmas,
                    fmt=".",
                    color=colour,
                    markersize=4.5,
                    elinewidth=0.7,
                    label=label,
                )
        _limits(panel, shown.factor * row.values, shown.factor * row.sigmas)
        y_label(panel, escaped_dollars(f"{row.name} ({shown.text})"))
    sheet.panels[-1].set_xlabel(axis_label(condition, across), fontsize=LABEL_SIZE)
    return finish(sheet, title)


def figure_effects(
    flights: Sequence[str], probabilities: Mapping[str, np.ndarray], title: str = ""
) -> Figure:
    """Plot a row for each effect and a column for each flight: filled if present, open if absent,
    half if undecided.
    """
    names = list(probabilities)
    named = len(flights) <= _MOST_FLIGHT_NAMES and max(map(len, flights)) <= _LONGEST_AXIS_NAME
    sheet = make_sheet(
        [_ROW_HEIGHT * len(names) + 0.15],
        left=max(0.72, *(text_width(escaped_dollars(name)) + 0.25 for name in names)),
    )
    panel = sheet.panels[0]
    for y, name in zip(range(len(names) - 1, -1, -1), names, strict=True):
        p = probabilities[name]
        x = 1 + np.arange(len(flights))
        for chosen, face, label in (
            (p > 0.95, BLUE, "has it"),
            ((p >= 0.05) & (p <= 0.95), LIGHT, "undecided"),
            (p < 0.05, "white", "does not have it"),
        ):
            if np.any(chosen):
                at = x[chosen]
                panel.plot(
                    at,
                    np.full(len(at), y),
                    "s",
                    color=BLUE,
                    markerfacecolor=face,
                    markersize=5.0,
                    markeredgewidth=0.7,
                    label=label,
                )
    panel.set_yticks(range(len(names)), [escaped_dollars(name) for name in names[::-1]])
    panel.set_ylim(-0.6, len(names) - 0.4)
    panel.set_xlim(0.2, len(flights) + 0.8)
    panel.tick_params(axis="both", labelsize=TICK_SIZE, length=0)
    if named:
        panel.grid(False)
        panel.set_xticks(
            1 + np.arange(len(flights)),
            [escaped_dollars(flight) for flight in flights],
            rotation=90,
        )
    else:
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        panel.set_xlabel(
            f"number of the flight (1: {escaped_dollars(flights[0])}, "
            f"{len(flights)}: {escaped_dollars(flights[-1])})",
            fontsize=LABEL_SIZE,
        )
    return finish(
        sheet,
        title,
        bottom=0.2 + max(text_width(escaped_dollars(flight), TICK_SIZE) for flight in flights)
        if named
        else 0.5,
    )


def _limits(panel: object, values: np.ndarray, sigmas: np.ndarray) -> None:
    """Set axis limits for all values, and for error bars up to the spread of the values."""
    reach = 2.0 * float(np.median(sigmas)) + 1e-12
    low, high = float(np.min(values)) - reach, float(np.max(values)) + reach
    panel.set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))  # type: ignore[attr-defined]
