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
    caption,
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
    """A maneuver with its number in the table."""

    @property
    def number(self) -> int: ...
    @property
    def found(self) -> DetectedManeuver: ...


class Searched(Protocol):
    """A record with the maneuvers that were found in it."""

    @property
    def record(self) -> Record: ...
    @property
    def maneuvers(self) -> Sequence[Numbered]: ...
    @property
    def simulated(self) -> bool: ...


def figure_flight(search: Searched, title: str = "") -> Figure:
    """Plot controls and motion of a whole record, with maneuvers as coloured spans.

    Each channel is drawn as a band between the least and the largest value of short blocks of
    samples (``envelope``). A maneuver is marked in the panel of its input, with its number above;
    trim points are grey in all panels. Angles are in degrees. Long pauses in the record are cut
    out: each part between them has a column of panels, whose width is in proportion to its length.
    """
    record = search.record
    names = [name for name in (*AXES, *SHOWN) if name in record.output_names]
    pauses = _pauses(record.time)
    parts = _parts(record.time, pauses)
    lengths = [last - first for first, last in parts]
    widths = [max(length, NARROWEST_PANEL_SHARE * max(lengths)) for length in lengths]
    sheet = make_sheet([0.95] * len(names), widths, row_gap=0.2, column_gap=0.12)
    for name, panels in zip(names, sheet.axes, strict=True):
        unit = display_unit(record[name].unit, name)
        middles, low, high = envelope(record.time, unit.factor * record[name].with_gaps())
        gaps = _pauses(middles) + 1
        # Only the values have a hole at a pause: a page draws a line only over rising times.
        times = np.insert(middles, gaps, middles[gaps])
        low, high = np.insert(low, gaps, np.nan), np.insert(high, gaps, np.nan)
        marked = [
            maneuver
            for maneuver in search.maneuvers
            if maneuver.found.axis == "all"
            or maneuver.found.channel == name
            or maneuver.found.channel not in names
        ]
        for panel, (first, last) in zip(panels, parts, strict=True):
            if np.any(high > low):
                panel.fill_between(times, low, high, color=BLUE, linewidth=0.6)
            panel.plot(times, 0.5 * (low + high), color=BLUE, linewidth=0.6)
            for maneuver in marked:
                if first <= maneuver.found.start <= last:
                    _mark(panel, maneuver)
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


def _mark(panel: Axes, maneuver: Numbered) -> None:
    """Draw a maneuver as a span with its number above it, a trim point as a grey span."""
    axis, start, end = maneuver.found.axis, maneuver.found.start, maneuver.found.end
    if axis == "all":
        panel.axvspan(start, end, color=LIGHT, alpha=0.6, linewidth=0.0, zorder=0.5)
        return
    colour = COLOURS[axis]
    label = f"{axis} maneuver"
    panel.axvspan(start, end, color=colour, alpha=0.3, linewidth=0.0, zorder=0.6, label=label)
    panel.axvline(start, color=colour, linewidth=0.7, zorder=0.7)
    panel.annotate(
        str(maneuver.number),
        (0.5 * (start + end), 1.0),
        xycoords=("data", "axes fraction"),
        ha="center",
        va="bottom",
        fontsize=TICK_SIZE - 2.0,
        color=colour,
        gid=ORNAMENT,
    )


def _pauses(time: np.ndarray) -> np.ndarray:
    """Return the index of the last sample before each pause in ``time``, ``(N,)``, s."""
    steps = np.diff(time)
    usual = float(np.median(steps)) if steps.size else 0.0
    return np.flatnonzero(steps > max(LONGEST_GAP, 5.0 * usual))


def _parts(time: np.ndarray, pauses: np.ndarray) -> list[tuple[float, float]]:
    """Return start and end of the parts of a record between its long pauses, s.

    Only the longest pauses part the record if there are more than a figure has columns for.
    """
    lengths = np.diff(time)[pauses]
    recorded = float(time[-1] - time[0] - np.sum(lengths))
    longest = np.argsort(lengths)[::-1][: MOST_COLUMNS - 1]
    cuts = np.sort(pauses[longest[lengths[longest] > LONG_PAUSE * recorded]])
    starts, ends = [time[0], *time[cuts + 1]], [*time[cuts], time[-1]]
    return [(float(start), float(end)) for start, end in zip(starts, ends, strict=True)]


def envelope(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return middle time, least and largest value of successive blocks of samples.

    There are at most ``ENVELOPE_BINS`` blocks. Samples without a value, NaN, are left out.
    Neighbouring blocks share a sample, so that the band has no holes. A signal with few samples is
    returned as it is.
    """
    finite = np.isfinite(values)
    time, values = time[finite], values[finite]
    if values.size <= 2 * ENVELOPE_BINS:
        return time, values, values
    edges = np.linspace(0, values.size, ENVELOPE_BINS + 1).astype(int)
    first = edges[:-1]
    low, high = np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)
    before = values[np.maximum(first - 1, 0)]
    return (time[(first + edges[1:] - 1) // 2], np.minimum(low, before), np.maximum(high, before))


# ---- Designed maneuvers in comparison: inputs and responses over time, with limits

_LIMIT: dict[str, Any] = {"color": BLACK, "linestyle": (0, (4, 2)), "linewidth": 0.8}
_IN_SIGHT = 1.6  # limits beyond this multiple of the largest value are not drawn


@dataclass(frozen=True, eq=False)
class ManeuverCourse:
    """Inputs and outputs of a maneuver by name, ``(N,)`` each, SI; load factors are totals."""

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
    """Plot maneuvers, a column for each (the best first) and a row for each input and output.

    Inputs are held between samples. Angles are in degrees.

    Parameters
    ----------
    time : shape ``(N,)``, s.
    limits : lowest and highest permitted value by name, SI, drawn if the maneuvers come near them.
    units : SI unit by name.
    """
    names = [*courses[0].inputs, *courses[0].outputs]
    count = len(courses)
    sheet = make_sheet([1.0] * len(names), (1.0,) * count, column_gap=0.25, row_gap=0.12)
    kinds = [course.label.partition(",")[0] for course in courses]  # the legend has the rest
    distinct = len(set(kinds)) == count
    for panel, kind, course in zip(sheet.axes[0], kinds, courses, strict=True):
        caption(panel, escaped_dollars(kind if distinct else course.label))
    for row, name in enumerate(names):
        unit = display_unit(units.get(name, ""), name)
        signals = [unit.factor * {**course.inputs, **course.outputs}[name] for course in courses]
        low = min(float(values.min()) for values in signals)
        high = max(float(values.max()) for values in signals)
        reach = _IN_SIGHT * (max(abs(low), abs(high)) or 1.0)
        shown = [
            unit.factor * limit
            for limit in limits.get(name, ())
            if abs(unit.factor * limit) <= reach
        ]
        low, high = min([low, *shown]), max([high, *shown])
        margin = 0.06 * (high - low) or 1.0
        for column, (course, values) in enumerate(zip(courses, signals, strict=True)):
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
            for limit in shown:
                panel.axhline(limit, **_LIMIT)
            panel.set_ylim(low - margin, high + margin)
            if column:
                panel.tick_params(labelleft=False)
        y_label(sheet.axes[row][0], axis_label(name, unit))
    for panel in sheet.axes[-1]:
        time_axis(panel)
    return finish(sheet, title, head=0.3)


def figure_coherence(kinds: Sequence[tuple[str, Any]], title: str = "") -> Figure:
    """Plot expected coherence over frequency, a line for each maneuver.

    Each output has a row of panels, each input a column.

    Parameters
    ----------
    kinds : name of each maneuver and its responses: ``frequency`` in Hz, ``(F,)``, names of
        ``inputs`` and ``outputs``, and ``coherence``, ``(outputs, inputs, F)``.
    """
    first = kinds[0][1]
    sheet = make_sheet(
        [1.0] * len(first.outputs), (1.0,) * len(first.inputs), column_gap=0.25, row_gap=0.12
    )
    for row, output in enumerate(first.outputs):
        for column, name in enumerate(first.inputs):
            panel = sheet.axes[row][column]
            for number, (kind, result) in enumerate(kinds):
                look = method_style(number, alone=True)
                panel.plot(
                    result.frequency,
                    result.coherence[row, column],
                    label=escaped_dollars(kind),
                    color=look["color"],
                    linewidth=1.2,
                )
            panel.axhline(0.6, color=GREY, linewidth=0.7, linestyle=":")
            panel.set_xscale("log")
            panel.set_xlim(float(first.frequency[0]), float(first.frequency[-1]))
            panel.set_ylim(0.0, 1.02)
            decades(panel.xaxis, (1.0, 2.0, 5.0))
            if column:
                panel.tick_params(labelleft=False)
            if row == len(first.outputs) - 1:
                panel.set_xlabel(f"frequency (Hz), {escaped_dollars(name)}", fontsize=LABEL_SIZE)
        y_label(sheet.axes[row][0], f"coherence of {escaped_dollars(output)} (–)")
    return finish(sheet, title, head=0.12)


# ---- Figures of a fleet of flights

_PANEL_HEIGHT = 1.15  # inches, height of a panel
_ROW_HEIGHT = 0.3  # inches, height of a row
_MOST_FLIGHT_NAMES = 45  # with more flights, the axis has their numbers
_FLAT_NAMES = 5.0  # inches that names side by side may take; else they stand upright
_LONGEST_AXIS_NAME = 20  # letters; with a longer name, the axis has the numbers of the flights


@dataclass(frozen=True, eq=False)
class Line:
    """Pooled line of a derivative over a condition, SI.

    Attributes
    ----------
    along : values of the condition, ``(k,)``.
    middle, sigma : values of the line and their standard deviations, ``(k,)``.
    scatter : standard deviation of the flights about the line.
    """

    along: np.ndarray
    middle: np.ndarray
    sigma: np.ndarray
    scatter: float


@dataclass(frozen=True, eq=False)
class OverCondition:
    """A derivative of n flights over a condition, SI.

    Attributes
    ----------
    name, unit : the derivative and its unit.
    condition : value of the condition in each flight, ``(n,)``.
    values, sigmas : estimate of each flight and its standard deviation, ``(n,)``.
    out : whether each flight is an outlier, ``(n,)``.
    line : the pooled line.
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
    """A parameter of an effect that several of n flights have, SI.

    Attributes
    ----------
    name, unit : effect and parameter, and its unit.
    condition : value of the condition in each flight, ``(n,)``.
    values, sigmas : estimate of each flight and its standard deviation, ``(n,)``.
    has : whether each flight has the effect, ``(n,)``.
    common, common_sigma : common estimate of the flights with the effect.
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
    """Plot each derivative over a condition, such as airspeed, a panel for each.

    Flights have bars of two standard deviations. The pooled line has its band, and a wider band
    that includes the scatter of the flights.

    Parameters
    ----------
    condition, unit : name of the condition and its SI unit.
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
        total = np.hypot(sigma, shown.factor * row.line.scatter)
        for std, colour, alpha, label in (
            (total, LIGHT, 0.6, "flights within ±2σ"),
            (sigma, BLUE, 0.3, "pooled ±2σ"),
        ):
            low, high = middle - 2.0 * std, middle + 2.0 * std
            panel.fill_between(
                along, low, high, color=colour, alpha=alpha, linewidth=0, label=label
            )
        panel.plot(along, middle, "-", color=BLUE, linewidth=1.2, label="pooled")
        values, sigmas = shown.factor * row.values, shown.factor * row.sigmas
        _draw_flights(panel, at, values, sigmas, ~row.out, BLACK, "one flight ±2σ")
        _draw_flights(panel, at, values, sigmas, row.out, VERMILION, "stands out")
        _limits(panel, values, sigmas)
        y_label(panel, axis_label(row.name, shown))
    for panel in sheet.panels[-len(sheet.widths) :]:
        panel.set_xlabel(axis_label(condition, across), fontsize=LABEL_SIZE)
    return finish(sheet, title)


def figure_shared(rows: Sequence[Shared], condition: str, unit: str, title: str = "") -> Figure:
    """Plot each parameter of a shared effect over a condition, a panel for each.

    Each flight has its own estimate with a bar of two standard deviations. The line and its band
    are the common estimate of the flights with the effect.
    """
    sheet = make_sheet([1.35] * len(rows), row_gap=0.2)
    across = display_unit(unit, condition)
    for row, panel in zip(rows, sheet.panels, strict=True):
        shown = display_unit(row.unit, row.name.rpartition(" ")[2])
        low, high = (shown.factor * (row.common + side * 2 * row.common_sigma) for side in (-1, 1))
        panel.axhspan(low, high, color=BLUE, alpha=0.3, linewidth=0, label="common value ±2σ")
        panel.axhline(shown.factor * row.common, color=BLUE, linewidth=1.2)
        at = across.factor * row.condition
        values, sigmas = shown.factor * row.values, shown.factor * row.sigmas
        _draw_flights(panel, at, values, sigmas, row.has, BLACK, "has it, ±2σ")
        _draw_flights(panel, at, values, sigmas, ~row.has, GREY, "does not have it, or undecided")
        _limits(panel, values, sigmas)
        y_label(panel, escaped_dollars(f"{row.name} ({shown.text})"))
    sheet.panels[-1].set_xlabel(axis_label(condition, across), fontsize=LABEL_SIZE)
    return finish(sheet, title)


def figure_effects(
    flights: Sequence[str], probabilities: Mapping[str, np.ndarray], title: str = ""
) -> Figure:
    """Plot which flights have which effect, a row for each effect and a column for each flight.

    A mark is filled if the flight has the effect (probability above 0.95), open if it does not
    (below 0.05), and grey if that is undecided.

    Parameters
    ----------
    flights : names of the n flights.
    probabilities : probability of each effect in each flight, ``(n,)``.
    """
    names = list(probabilities)
    flight_labels = [escaped_dollars(flight) for flight in flights]
    numbers = 1 + np.arange(len(flights))
    named = len(flights) <= _MOST_FLIGHT_NAMES and max(map(len, flights)) <= _LONGEST_AXIS_NAME
    sheet = make_sheet(
        [_ROW_HEIGHT * len(names) + 0.15],
        left=max(0.72, *(text_width(escaped_dollars(name)) + 0.25 for name in names)),
    )
    panel = sheet.panels[0]
    for y, name in zip(range(len(names) - 1, -1, -1), names, strict=True):
        probability = probabilities[name]
        for chosen, face, label in (
            (probability > 0.95, BLUE, "has it"),
            ((probability >= 0.05) & (probability <= 0.95), LIGHT, "undecided"),
            (probability < 0.05, "white", "does not have it"),
        ):
            if np.any(chosen):
                panel.plot(
                    numbers[chosen],
                    np.full(np.count_nonzero(chosen), y),
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
        longest = max(text_width(label, TICK_SIZE) for label in flight_labels)
        upright = (longest + 0.2) * len(flights) > _FLAT_NAMES
        panel.set_xticks(numbers, flight_labels, rotation=90 if upright else 0)
        bottom = 0.2 + (longest if upright else 0.15)
    else:
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        panel.set_xlabel(
            f"number of the flight (1: {flight_labels[0]}, {len(flights)}: {flight_labels[-1]})",
            fontsize=LABEL_SIZE,
        )
        bottom = 0.5
    return finish(sheet, title, bottom=bottom)


def _draw_flights(
    panel: Axes,
    condition: np.ndarray,
    values: np.ndarray,
    sigmas: np.ndarray,
    chosen: np.ndarray,
    colour: str,
    label: str,
) -> None:
    """Draw the ``chosen`` flights, ``(n,)``, with bars of two standard deviations."""
    if np.any(chosen):
        panel.errorbar(
            condition[chosen],
            values[chosen],
            2.0 * sigmas[chosen],
            fmt=".",
            color=colour,
            markersize=4.5,
            elinewidth=0.7,
            label=label,
        )


def _limits(panel: Axes, values: np.ndarray, sigmas: np.ndarray) -> None:
    """Limit the y axis to all values and twice their median sigma; longer bars are cut off."""
    reach = 2.0 * float(np.median(sigmas)) + 1e-12
    low, high = float(np.min(values)) - reach, float(np.max(values)) + reach
    margin = 0.05 * (high - low)
    panel.set_ylim(low - margin, high + margin)
