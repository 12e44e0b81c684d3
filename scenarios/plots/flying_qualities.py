"""Figures of frequency responses: fitted models, mismatch, bandwidth, stability margins, charts
with levels of flying qualities, step responses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib.figure import Figure

from ident.flying_qualities.attitude_criteria import LEVELS as RESONANCES
from ident.flying_qualities.attitude_criteria import PITCH_LEVELS, step_response
from ident.flying_qualities.levels import criteria
from ident.frequency_response.transfer_function import unnoticeable
from scenarios.plots.display import MEASURED_DATA, SIMULATED_DATA
from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    LABEL_SIZE,
    LIGHT,
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

_LARGEST_DRAWN_HALF_WIDTH = 60.0  # dB or deg; wider half-bands are clipped


class SignalNames(Protocol):
    """Names of signals."""

    @property
    def inputs(self) -> Sequence[str]: ...
    @property
    def outputs(self) -> Sequence[str]: ...


class EstimatedResponses(Protocol):
    """Frequency responses of records."""

    @property
    def names(self) -> SignalNames: ...
    @property
    def responses(self) -> Any: ...
    @property
    def direct(self) -> Any: ...
    @property
    def simulated(self) -> bool: ...
    @property
    def fits(self) -> Any: ...
    @property
    def qualities(self) -> Any: ...
    @property
    def loop(self) -> Any: ...
    @property
    def model(self) -> Any: ...
    def unit(self, output: str, one: str) -> str: ...


def figure_response(estimate: EstimatedResponses, row: int = 0, column: int = 0) -> Figure:
    """Plot magnitude (dB), phase (deg) with 95 % bands, and coherence of one response.

    Frequencies outside the usable band are grey.
    """
    result = estimate.responses
    output, one = estimate.names.outputs[row], estimate.names.inputs[column]
    sheet = make_sheet([1.8, 1.5, 1.1], row_gap=0.14)
    size, angle, likeness = sheet.panels
    f, response, usable = result.frequency, result.response[row, column], result.usable[row, column]
    decibel, low, high = _decibels(response, result.half_width()[row, column])
    size.fill_between(f, low, high, color=SKY, alpha=0.45, linewidth=0.0, label="95 % band")
    size.plot(f, decibel, color=BLUE, linewidth=1.2, label="joint" if result.joint else "estimate")
    phase = np.degrees(result.phase()[row, column])
    turn = np.minimum(np.degrees(result.phase_half_width()[row, column]), _LARGEST_DRAWN_HALF_WIDTH)
    angle.fill_between(f, phase - turn, phase + turn, color=SKY, alpha=0.45, linewidth=0.0)
    angle.plot(f, phase, color=BLUE, linewidth=1.2)
    if estimate.direct is not None:
        other = estimate.direct.response[row, column]
        near = phase + np.degrees(np.angle(other / response))
        style: dict[str, Any] = {"color": VERMILION, "linewidth": 0.9, "linestyle": "--"}
        size.plot(f, 20.0 * np.log10(np.maximum(np.abs(other), 1e-300)), label="direct", **style)
        angle.plot(f, near, **style)
    fitted = estimate.fits.of(row, column) if estimate.fits is not None else None
    if fitted is not None:
        model = fitted[0].response(2.0 * np.pi * f)
        line: dict[str, Any] = {"color": BLACK, "linewidth": 1.0, "linestyle": (0, (5, 2))}
        size.plot(f, 20.0 * np.log10(np.abs(model)), label=f"fitted: {fitted[0].form.name}", **line)
        angle.plot(f, phase + np.degrees(np.angle(model / response)), **line)
    modelled = estimate.model.of(row, column) if estimate.model is not None else None
    if modelled is not None:
        at, model = modelled[0] / (2.0 * np.pi), modelled[1]
        line = {"color": VERMILION, "linewidth": 1.0, "linestyle": (0, (5, 2))}
        size.plot(at, 20.0 * np.log10(np.abs(model)), label=estimate.model.model, **line)
        near = phase[usable] + np.degrees(np.angle(model / response[usable]))
        angle.plot(at, near, **line)
    several = result.response.shape[1] > 1
    likeness.plot(f, result.coherence[row], color=BLUE, linewidth=1.2)
    if several:
        partial = result.partial_coherence[row, column]
        likeness.plot(f, partial, color=ORANGE, linewidth=1.1, label="partial coherence")
    least = result.spectra.least_coherence
    likeness.axhline(least, color=GREY, linewidth=0.7, linestyle=":")
    likeness.set_ylim(0.0, 1.02)
    for panel in sheet.panels:
        panel.set_xscale("log")
        panel.set_xlim(float(f[0]), float(f[-1]))
        for first, last in _outside(f, usable):
            panel.axvspan(first, last, color=LIGHT, alpha=0.5, linewidth=0.0, zorder=0.4)
    shown = usable if usable.any() else np.ones_like(usable)
    _limits(size, decibel[shown])
    _limits(angle, phase[shown], 20.0)
    decades(likeness.xaxis, (1.0, 2.0, 5.0))
    unit = estimate.unit(output, one)
    y_label(size, f"magnitude (dB{f' of {unit}' if unit else ''})")
    y_label(angle, "phase (deg)")
    y_label(likeness, "coherence (–)")
    likeness.set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(sheet, f"{output} / {one}\n{data}; grey: outside the usable band")


def figure_mismatch(estimate: EstimatedResponses, row: int = 0, column: int = 0) -> Figure:
    """Plot the ratio of estimated to fitted response (dB, deg) with 95 % bands.

    Also shown: the envelopes of maximum unnoticeable added dynamics. Raises DeclarationError
    without a fit.
    """
    fitted = estimate.fits.of(row, column) if estimate.fits is not None else None
    if fitted is None:
        remedy = "name a form (fit)"
        raise DeclarationError("no transfer function is fitted", where="mismatch", remedy=remedy)
    function, mismatch = fitted
    f = mismatch.frequency
    limits = unnoticeable(2.0 * np.pi * f)
    sheet = make_sheet([1.6, 1.6], row_gap=0.14)
    rows = (
        (mismatch.gain, mismatch.gain_error, limits.low_gain, limits.high_gain, "gain (dB)"),
        (mismatch.phase, mismatch.phase_error, limits.low_phase, limits.high_phase, "phase (deg)"),
    )
    for panel, (value, error, low, high, label) in zip(sheet.panels, rows, strict=True):
        error = np.minimum(error, _LARGEST_DRAWN_HALF_WIDTH)
        panel.fill_between(f, value - error, value + error, color=SKY, alpha=0.45, linewidth=0.0)
        panel.plot(f, value, color=BLUE, linewidth=1.2, label="estimate over fitted")
        for n, limit in enumerate((low, high)):
            there = np.where(mismatch.piloted, limit, np.nan)
            text = "unnoticeable within" if not n else None
            panel.plot(f, there, color=VERMILION, linewidth=1.0, linestyle="--", label=text)
        panel.axhline(0.0, color=GREY, linewidth=0.6)
        panel.set_xscale("log")
        panel.set_xlim(float(f[0]), float(f[-1]))
        spread = 1.3 * float(np.max(np.abs(value))) + 1.0
        near = 12.0 if "dB" in label else 60.0
        panel.set_ylim(-max(spread, near), max(spread, near))
        y_label(panel, label)
    decades(sheet.panels[-1].xaxis, (1.0, 2.0, 5.0))
    sheet.panels[-1].set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(
        sheet,
        f"{function.name}: mismatch of {function.form.name}\n{data}; cost {function.cost:.3g}",
    )


def figure_bandwidth(estimate: EstimatedResponses, number: int = 0) -> Figure:
    """Plot an attitude response with its bandwidths and phase delay.

    Raises DeclarationError if no bandwidth was requested.
    """
    curves = [each for each in estimate.qualities if each.curve is not None]
    if not 0 <= number < len(curves):
        remedy = "say what the outputs are (bandwidth), rate or attitude"
        raise DeclarationError("there is no bandwidth to draw", where="bandwidth", remedy=remedy)
    one = curves[number]
    curve, result = one.curve, one.bandwidth
    sheet = make_sheet([1.6, 1.6], row_gap=0.14)
    size, angle = sheet.panels
    for panel, value, std in (
        (size, curve.gain, curve.gain_std),
        (angle, curve.phase, curve.phase_std),
    ):
        half = np.minimum(1.96 * std, _LARGEST_DRAWN_HALF_WIDTH)
        panel.fill_between(
            curve.omega, value - half, value + half, color=SKY, alpha=0.45, linewidth=0
        )
        panel.plot(curve.omega, value, color=BLUE, linewidth=1.2, label="attitude")
        panel.set_xscale("log")
        panel.set_xlim(float(curve.omega[0]), float(curve.omega[-1]))
        _limits(panel, value)
        for each, colour, label in (
            (result.phase, VERMILION, "phase bandwidth"),
            (result.gain, ORANGE, "gain bandwidth"),
            (result.neutral, BLACK, "-180 deg"),
        ):
            if each is not None:
                panel.axvspan(
                    each.value - 1.96 * each.std,
                    each.value + 1.96 * each.std,
                    color=colour,
                    alpha=0.25,
                    linewidth=0.0,
                )
                panel.axvline(each.value, color=colour, linewidth=1.0, label=label)
    for level in (-135.0, -180.0):
        angle.axhline(level, color=GREY, linewidth=0.7, linestyle=":")
    if result.delay is not None:
        ends = np.array([1.0, 2.0]) * result.neutral.value
        fall = np.degrees(2.0 * result.delay.value * (ends - ends[0]))
        line: dict[str, Any] = {"color": BLACK, "linewidth": 1.0}
        angle.plot(ends, -180.0 - fall, linestyle="--", label="phase delay", **line)
    decades(angle.xaxis, (1.0, 2.0, 5.0))
    y_label(size, "gain (dB)")
    y_label(angle, "phase (deg)")
    angle.set_xlabel("frequency (rad/s)", fontsize=LABEL_SIZE)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(sheet, f"{one.name}: bandwidth\n{data}; spans: 95 %")


class EstimatedLoop(Protocol):
    """A loop with its margins; ``simulated``: from a simulated record."""

    @property
    def loop(self) -> Any: ...
    @property
    def simulated(self) -> bool: ...


def figure_margins(estimate: EstimatedLoop) -> Figure:
    """Plot the broken-loop response with its margins: gain, phase about -180 deg, distance from -1.

    Raises DeclarationError if no margins were requested.
    """
    loop = estimate.loop
    if loop is None:
        remedy = "say how the loop takes back its output (margins), minus or plus"
        raise DeclarationError("there are no margins to draw", where="loop", remedy=remedy)
    curve, margins = loop.curve, loop.margins
    sheet = make_sheet([1.5, 1.5, 1.1], row_gap=0.14)
    rows = (
        (curve.gain, curve.gain_std, "gain (dB)", margins.gains, -1.0),
        (curve.phase, curve.phase_std, "phase + 180 (deg)", margins.phases, 1.0),
        (curve.distance, curve.distance_std, "distance (dB)", (), 0.0),
    )
    for panel, (value, std, label, marks, sign) in zip(sheet.panels, rows, strict=True):
        half = np.minimum(1.96 * std, _LARGEST_DRAWN_HALF_WIDTH)
        panel.fill_between(
            curve.omega, value - half, value + half, color=SKY, alpha=0.45, linewidth=0
        )
        panel.plot(curve.omega, value, color=BLUE, linewidth=1.2, label="broken loop")
        panel.axhline(0.0, color=GREY, linewidth=0.7, linestyle=":")
        panel.set_xscale("log")
        panel.set_xlim(float(curve.omega[0]), float(curve.omega[-1]))
        _limits(panel, value)
        for margin in marks:
            # Add whole turns to the phase until the end lies on the curve.
            at, end = margin.frequency.value, sign * margin.size.value
            shift = value[np.argmin(np.abs(curve.omega - at))] - end
            zero = 360.0 * round(shift / 360.0) if sign > 0.0 else 0.0
            colour = VERMILION if sign > 0.0 else ORANGE
            text = "phase margin" if sign > 0.0 else "gain margin"
            panel.plot([at, at], [zero, zero + end], color=colour, linewidth=1.4, label=text)
            span = [zero + sign * margin.low, zero + sign * margin.high]
            panel.plot(
                [at, at], span, color=colour, linewidth=5.0, alpha=0.35, solid_capstyle="butt"
            )
        y_label(panel, label)
    if margins.distance is not None:
        least = margins.distance
        level = 20.0 * math.log10(least.size.value)
        line: dict[str, Any] = {"color": BLACK, "linewidth": 1.4, "label": "least distance from -1"}
        sheet.panels[2].plot([least.frequency.value] * 2, [0.0, level], **line)
    axis = sheet.panels[-1]
    decades(axis.xaxis, (1.0, 2.0, 5.0))
    axis.set_xlabel("frequency (rad/s)", fontsize=LABEL_SIZE)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(sheet, f"{loop.name}: stability margins\n{data}; bands and bars: 95 %")


def _decibels(response: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    size = np.abs(response)
    decibel = 20.0 * np.log10(np.maximum(size, 1e-300))
    low = 20.0 * np.log10(
        np.maximum(size - half, 10.0 ** (-_LARGEST_DRAWN_HALF_WIDTH / 20.0) * size)
    )
    return decibel, low, 20.0 * np.log10(np.maximum(size + half, 1e-300))


def _outside(frequency: np.ndarray, usable: np.ndarray) -> list[tuple[float, float]]:
    there = np.flatnonzero(usable)
    if not there.size:
        return [(float(frequency[0]), float(frequency[-1]))]
    ends = [(frequency[0], frequency[there[0]]), (frequency[there[-1]], frequency[-1])]
    return [(float(a), float(b)) for a, b in ends if b > a]


def _limits(panel: Any, values: np.ndarray, least: float = 3.0) -> None:
    """Set axis limits by the line, not by a wide band."""
    low, high = float(np.min(values)), float(np.max(values))
    margin = max(0.15 * (high - low), least)
    if math.isfinite(low + high):
        panel.set_ylim(low - margin, high + margin)


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
    """Plot the margins of a loop over the time of a stream, with 95 % intervals.

    Dashed lines: MIL-F-9490D. A margin that is never known has no panel.
    """
    known = [each.margins.named if each.margins is not None else {} for each in points]
    rows = [row for row in _ROWS if any(row[0] in each for each in known)]
    sheet = make_sheet([1.15] * max(len(rows), 1), row_gap=0.16)
    time = np.array([each.time for each in points])
    for panel, (key, label, required) in zip(sheet.panels, rows, strict=False):
        result = [each.get(key) for each in known]
        value, low, high = (
            np.array([np.nan if each is None else pick(each) for each in result])
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
        # The last two thirds set the scale, since the first intervals are wide.
        settled = value[np.isfinite(value)]
        settled = settled[settled.size // 3 :]
        spread = max(float(np.ptp(settled)), 0.25 * abs(float(np.median(settled))))
        ends = [float(np.min(settled)), float(np.max(settled))]
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

_REGION_SIGMAS = 2.4477  # semi-axes of the 95 % ellipse of two normal errors
_LEVEL_COLOURS = (GREEN, ORANGE)


def figure_qualities(estimate: Any, number: int = 0) -> Figure:
    """Plot flying qualities of one response with 95 % regions, on the chart of each criterion.

    Damping and CAP; bandwidth and phase delay; Neal-Smith pilot; dropback and overshoot of a
    fitted pitch rate. A chart without published limits says so. Raises DeclarationError without
    any chart.
    """
    with_charts = [each for each in estimate.qualities if charts_of(each)]
    if not 0 <= number < len(with_charts):
        remedy = "fit pitch with --airspeed and --levels, or name --bandwidth or --pilot"
        raise DeclarationError("there is no chart to draw", where="qualities", remedy=remedy)
    one = with_charts[number]
    charts = charts_of(one)
    columns = min(len(charts), 2)
    rows = -(-len(charts) // columns)
    sheet = make_sheet(
        [2.3] * rows, [1.0] * columns, count=len(charts), share_x=False, row_gap=0.72, left=0.8
    )
    for panel, draw in zip(sheet.panels, charts, strict=True):
        draw(panel, one)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(sheet, f"{one.name}: flying qualities\n{data}; ellipses: 95 %", legend=False)


def charts_of(one: Any) -> list[Callable[[Any, Any], None]]:
    """Return the drawing functions of the charts for which a response has numbers."""
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
    for level, points in enumerate(() if one.of_pitch is False else PITCH_LEVELS):
        x, y = (list(each) for each in zip(*points, strict=True))
        _limit(panel, x, y, level)
        beyond = {"color": _LEVEL_COLOURS[level], "linewidth": 1.0, "linestyle": (0, (4, 3))}
        panel.plot([x[-1], ends[0]], [y[-1], y[-1]], **beyond)
    panel.set_xlim(0.0, ends[0])
    panel.set_ylim(0.0, ends[1])
    _mark(panel, (band.value, band.std), (delay.value, delay.std))
    words = _limits_of_pitch(one, "pitch: MIL-STD-1797A, category A (not verified)")
    _named(panel, "bandwidth (rad/s)", "phase delay (s)", words)


def _limits_of_pitch(one: Any, words: str) -> str:
    """Return the source of limits, or that there are none of a response that is not in pitch."""
    if one.of_pitch is False:
        return "no limits drawn: known ones are for pitch"
    return words if one.of_pitch else f"{words}; if this is pitch"


def _pilot(panel: Any, one: Any) -> None:
    result = one.pilot
    turn, peak = result.compensation, result.resonance
    width = max(60.0, 1.3 * abs(turn.value))
    for level, limit in enumerate(() if one.of_pitch is False else RESONANCES):
        _limit(panel, [-width, width], [limit, limit], level)
    panel.set_xlim(-width, width)
    panel.set_ylim(min(-2.0, peak.value - 3.0), max(12.0, peak.value + 3.0))
    _mark(panel, (turn.value, turn.std), (peak.value, peak.std), result.correlation)
    task = f"{result.demand.bandwidth:g} rad/s, {result.demand.delay:g} s"
    words = _limits_of_pitch(one, f"MIL-STD-1797A; {task}")
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
    """Plot a point with its 95 % ellipse."""
    turn = np.linspace(0.0, 2.0 * np.pi, 101)
    across = x[0] + _REGION_SIGMAS * x[1] * np.cos(turn)
    mixed = correlation * np.cos(turn) + np.sqrt(max(1.0 - correlation**2, 0.0)) * np.sin(turn)
    panel.fill(across, y[0] + _REGION_SIGMAS * y[1] * mixed, color=SKY, alpha=0.5, linewidth=0.0)
    panel.plot([x[0]], [y[0]], color=BLUE, marker="o", markersize=4.5)


def _named(panel: Any, across: str, up: str, words: str) -> None:
    panel.set_xlabel(across, fontsize=LABEL_SIZE)
    y_label(panel, up)
    caption(panel, words)


def figure_steps(estimate: Any, row: int = 0, column: int = 0) -> Figure:
    """Plot step responses of a fitted response over their steady value, with 95 % bands.

    Raises DeclarationError without a fit or without a steady value.
    """
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
