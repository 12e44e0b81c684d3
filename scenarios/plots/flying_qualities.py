"""Figures of flying qualities from frequency responses: margins over time, charts with levels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib.figure import Figure

from ident.flying_qualities.attitude_criteria import LEVELS as RESONANCES
from ident.flying_qualities.attitude_criteria import PITCH_LEVELS, step_response
from ident.flying_qualities.levels import criteria
from scenarios.plots.display import MEASURED_DATA, SIMULATED_DATA
from scenarios.plots.style import (
    BLUE,
    GREEN,
    GREY,
    LABEL_SIZE,
    ORANGE,
    SKY,
    TICK_SIZE,
    VERMILION,
    caption,
    decades,
    finish,
    make_sheet,
    time_axis,
    y_label,
)
from sim.errors import DeclarationError

# ---- Stability margins of a stream over time


class TimedMargins(Protocol):
    """Margins at a time, s."""

    @property
    def time(self) -> float: ...
    @property
    def margins(self) -> Any: ...


_ROWS = (
    ("gain_increase", "gain increase (dB)", 6.0),
    ("gain_decrease", "gain decrease (dB)", -6.0),
    ("phase_margin", "phase margin (deg)", 45.0),
    ("distance", "distance from -1 (–)", None),
)


def figure_margin_history(points: Sequence[TimedMargins], name: str = "") -> Figure:
    """The margins of a loop after each second of a stream, with their 95 % intervals.

    The dashed lines are the margins of MIL-F-9490D. A margin that is nowhere known has no panel.
    """
    known = [each.margins.named if each.margins is not None else {} for each in points]
    rows = [row for row in _ROWS if any(row[0] in each for each in known)]
    sheet = make_sheet([1.15] * max(len(rows), 1), row_gap=0.16)
    time = np.array([each.time for each in points])
    for panel, (key, label, required) in zip(sheet.panels, rows, strict=False):
        found = [each.get(key) for each in known]
        value, low, high = (
            np.array([np.nan if each is None else pick(each) for each in found])
            for pick in (
                lambda each: each.size.value,
                lambda each: each.low,
                lambda each: each.high,
            )
        )
        panel.fill_between(time, low, high, color=SKY, alpha=0.45, linewidth=0.0, label="95 %")
        panel.plot(
            time, value, color=BLUE, linewidth=1.2, marker=".", markersize=3.0, label="margin"
        )
        # The later two thirds set the scale: the first intervals are wide.
        late = value[np.isfinite(value)]
        late = late[late.size // 3 :]
        spread = max(float(np.ptp(late)), 0.25 * abs(float(np.median(late))))
        ends = [float(np.min(late)), float(np.max(late))]
        if required is not None:
            panel.axhline(
                required, color=VERMILION, linewidth=0.9, linestyle="--", label="MIL-F-9490D"
            )
            ends = [min(ends[0], required), max(ends[1], required)]
        panel.set_ylim(ends[0] - 0.4 * spread, ends[1] + 0.4 * spread)
        panel.set_xlim(float(time[0]), float(time[-1]))
        y_label(panel, label)
    time_axis(sheet.panels[-1])
    return finish(sheet, f"{name}: stability margins while the stream arrived" if name else "")


# ---- Flying qualities on the charts of their criteria, with levels

_REGION = 2.4477  # deviations of the ellipse that holds 95 % of two normal errors
_LEVEL_COLOURS = (GREEN, ORANGE)


def figure_qualities(estimate: Any, number: int = 0) -> Figure:
    """Flying qualities of one response, each on the chart of its criterion with the 95 % region.

    Damping and CAP; bandwidth and phase delay; Neal and Smith's pilot; dropback and overshoot of a
    fitted pitch rate. Where no printed limit is at hand the chart says so. Raises DeclarationError
    where no chart has its numbers.
    """
    with_charts = [each for each in estimate.qualities if charts_of(each)]
    if not 0 <= number < len(with_charts):
        remedy = "fit pitch with --airspeed and --levels, or name --bandwidth or --pilot"
        raise DeclarationError("there is no chart to draw", where="qualities", remedy=remedy)
    one = with_charts[number]
    drawn = charts_of(one)
    columns = min(len(drawn), 2)
    rows = -(-len(drawn) // columns)
    sheet = make_sheet(
        [2.3] * rows, [1.0] * columns, count=len(drawn), share_x=False, row_gap=0.72, left=0.8
    )
    for panel, draw in zip(sheet.panels, drawn, strict=True):
        draw(panel, one)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(sheet, f"{one.name}: flying qualities\n{data}; ellipses: 95 %", legend=False)


def charts_of(one: Any) -> list[Callable[[Any, Any], None]]:
    """The charts that the qualities of a response have numbers for."""
    known = one.numbers
    out: list[Callable[[Any, Any], None]] = []
    if {"damping_ratio", "control_anticipation"} <= set(known):
        out.append(_anticipation)
    if {"bandwidth", "phase_delay"} <= set(known):
        out.append(_bandwidth)
    if {"pilot_resonance", "pilot_compensation"} <= set(known):
        out.append(_pilot)
    if {"dropback", "pitch_rate_overshoot"} <= set(known):
        out.append(_dropback)
    return out


def _anticipation(panel: Any, one: Any) -> None:
    damping, cap = (one.numbers[name][0] for name in ("damping_ratio", "control_anticipation"))
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_xlim(0.1, 5.0)
    panel.set_ylim(0.01, 20.0)
    words = "no category named (--levels)"
    if one.flown is not None:
        limits = {
            each.quantity: each
            for each in criteria(one.flown[0])
            if each.category == one.flown[1]
            and each.quantity in ("damping_ratio", "control_anticipation")
        }
        for level in (1, 0):
            (left, right), (low, high) = (
                limits[name].levels[level] for name in ("damping_ratio", "control_anticipation")
            )
            x = [left, min(right, 5.0), min(right, 5.0), left, left]
            y = [low, low, min(high, 20.0), min(high, 20.0), low]
            _limit(panel, x, y, level)
        words = f"MIL-STD-1797A, category {one.flown[1]}"
    _mark(panel, (damping.value, damping.std), (cap.value, cap.std))
    decades(panel.xaxis, (1.0, 2.0, 5.0))
    decades(panel.yaxis)
    _named(panel, "damping (–)", "CAP (1/(g s²))", words)


def _bandwidth(panel: Any, one: Any) -> None:
    band, delay = (one.numbers[name][0] for name in ("bandwidth", "phase_delay"))
    ends = max(12.0, 1.25 * band.value), max(0.2, 1.4 * delay.value)
    for level, points in enumerate(PITCH_LEVELS):
        x, y = (list(each) for each in zip(*points, strict=True))
        _limit(panel, x, y, level)
        beyond = {"color": _LEVEL_COLOURS[level], "linewidth": 1.0, "linestyle": (0, (4, 3))}
        panel.plot([x[-1], ends[0]], [y[-1], y[-1]], **beyond)
    panel.set_xlim(0.0, ends[0])
    panel.set_ylim(0.0, ends[1])
    _mark(panel, (band.value, band.std), (delay.value, delay.std))
    words = "pitch: MIL-STD-1797A, category A (not verified)"
    _named(panel, "bandwidth (rad/s)", "phase delay (s)", words)


def _pilot(panel: Any, one: Any) -> None:
    found = one.pilot
    turn, peak = found.compensation, found.resonance
    width = max(60.0, 1.3 * abs(turn.value))
    for level, limit in enumerate(RESONANCES):
        _limit(panel, [-width, width], [limit, limit], level)
    panel.set_xlim(-width, width)
    panel.set_ylim(min(-2.0, peak.value - 3.0), max(12.0, peak.value + 3.0))
    _mark(panel, (turn.value, turn.std), (peak.value, peak.std), found.correlation)
    words = f"MIL-STD-1797A; {found.demand.bandwidth:g} rad/s, {found.demand.delay:g} s"
    _named(panel, "phase of the pilot (deg)", "resonance (dB)", words)


def _dropback(panel: Any, one: Any) -> None:
    fall, over = (one.numbers[name][0] for name in ("dropback", "pitch_rate_overshoot"))
    panel.axvline(0.0, color=GREY, linewidth=0.9, linestyle=":")
    reach = max(0.6, 1.4 * abs(fall.value) + 2.5 * fall.std)
    panel.set_xlim(-reach, reach)
    panel.set_ylim(0.8, max(3.5, 1.3 * over.value))
    _mark(panel, (fall.value, fall.std), (over.value, over.std))
    words = "no printed limit at hand; left: overshoot"
    _named(panel, "dropback / steady rate (s)", "largest / steady rate (–)", words)


def _limit(panel: Any, x: Sequence[float], y: Sequence[float], level: int) -> None:
    panel.plot(x, y, color=_LEVEL_COLOURS[level], linewidth=1.2)
    panel.annotate(
        f"limit of level {level + 1}",
        (x[0], y[0]),
        xytext=(3, 3),
        textcoords="offset points",
        color=_LEVEL_COLOURS[level],
        fontsize=TICK_SIZE - 1.0,
        clip_on=True,
    )


def _mark(
    panel: Any, x: tuple[float, float], y: tuple[float, float], correlation: float = 0.0
) -> None:
    """A point with the ellipse that holds both quantities with 95 %."""
    turn = np.linspace(0.0, 2.0 * np.pi, 101)
    across = x[0] + _REGION * x[1] * np.cos(turn)
    mixed = correlation * np.cos(turn) + np.sqrt(max(1.0 - correlation**2, 0.0)) * np.sin(turn)
    panel.fill(across, y[0] + _REGION * y[1] * mixed, color=SKY, alpha=0.5, linewidth=0.0)
    panel.plot([x[0]], [y[0]], color=BLUE, marker="o", markersize=4.5)


def _named(panel: Any, across: str, up: str, words: str) -> None:
    panel.set_xlabel(across, fontsize=LABEL_SIZE)
    y_label(panel, up)
    caption(panel, words)


def figure_steps(estimate: Any, row: int = 0, column: int = 0) -> Figure:
    """The step of one fitted response over its steady value, with its 95 % band: of C* as well as
    of a rate. Raises DeclarationError where none is fitted or none is steady."""
    fitted = estimate.fits.of(row, column) if estimate.fits is not None else None
    step = step_response(fitted[0]) if fitted is not None else None
    if fitted is None or step is None:
        what = "no response is fitted that becomes steady"
        raise DeclarationError(what, where="step", remedy="name a form (fit)")
    sheet = make_sheet([2.4])
    panel = sheet.panels[0]
    half = 1.96 * step.std
    panel.fill_between(
        step.time,
        step.value - half,
        step.value + half,
        color=SKY,
        alpha=0.45,
        linewidth=0.0,
        label="95 %",
    )
    panel.plot(step.time, step.value, color=BLUE, linewidth=1.3, label="step over steady value")
    panel.axhline(1.0, color=GREY, linewidth=0.7, linestyle=":")
    panel.set_xlim(0.0, float(step.time[-1]))
    y_label(panel, "response (–)")
    time_axis(panel)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(
        sheet, f"{fitted[0].name}: step response of the fitted {fitted[0].form.name}\n{data}"
    )
