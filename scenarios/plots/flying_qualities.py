"""Figures of frequency responses: fitted models, mismatch, bandwidth, stability margins, charts of
flying qualities with levels, and step responses.

``estimate`` is a `ResponseEstimates` of `scenarios.responses.analysis`, and ``points`` are of the
class `MarginPoint` of `scenarios.watching.loop_margins`. This package must not import these.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ident.flying_qualities.attitude_criteria import PITCH_LEVELS, step_response
from ident.flying_qualities.levels import criteria
from ident.flying_qualities.pilot_in_loop import LARGEST_RESONANCES
from ident.flying_qualities.stability_margins import (
    NORMAL_HALF_WIDTH,
    REQUIRED_GAIN,
    REQUIRED_PHASE,
)
from ident.frequency_response.transfer_function import unnoticeable_envelopes
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
# Lines outside the usable band widen an axis by at most so much: dB, deg.
_REACH_MAGNITUDE, _REACH_PHASE = 60.0, 360.0
_SMALLEST_SIZE = 1e-300  # keeps a logarithm finite
_BAND: dict[str, Any] = {"color": SKY, "alpha": 0.45, "linewidth": 0.0}  # of 95 %


def figure_response(estimate: Any, row: int = 0, column: int = 0) -> Figure:
    """Plot magnitude (dB), phase (deg) with 95 % bands, and coherence of one response.

    Frequencies outside the usable band are grey.
    """
    result = estimate.responses
    output, input_name = estimate.names.outputs[row], estimate.names.inputs[column]
    sheet = make_sheet([1.8, 1.5, 1.1], row_gap=0.14)
    magnitudes, phases, coherences = sheet.panels
    f, response, usable = result.frequency, result.response[row, column], result.usable[row, column]
    magnitude, low, high = _decibels(response, result.half_width()[row, column])
    magnitudes.fill_between(f, low, high, label="95 % band", **_BAND)
    label = "joint" if result.joint else "estimate"
    magnitudes.plot(f, magnitude, color=BLUE, linewidth=1.2, label=label)
    phase = np.degrees(result.phase()[row, column])
    half = np.minimum(np.degrees(result.phase_half_width()[row, column]), _LARGEST_DRAWN_HALF_WIDTH)
    phases.fill_between(f, phase - half, phase + half, **_BAND)
    phases.plot(f, phase, color=BLUE, linewidth=1.2)
    # Phases of other curves are drawn within half a turn of that of the estimate.
    if estimate.direct is not None:
        direct = estimate.direct.response[row, column]
        style: dict[str, Any] = {"color": VERMILION, "linewidth": 0.9, "linestyle": "--"}
        direct_magnitude = 20.0 * np.log10(np.maximum(np.abs(direct), _SMALLEST_SIZE))
        magnitudes.plot(f, direct_magnitude, label="direct", **style)
        phases.plot(f, phase + np.degrees(np.angle(direct / response)), **style)
    fitted = estimate.fits.of(row, column) if estimate.fits is not None else None
    if fitted is not None:
        model = fitted[0].response(2.0 * np.pi * f)
        label = f"fitted: {fitted[0].form.name}"
        style = {"color": BLACK, "linewidth": 1.0, "linestyle": (0, (5, 2))}
        magnitudes.plot(f, 20.0 * np.log10(np.abs(model)), label=label, **style)
        phases.plot(f, phase + np.degrees(np.angle(model / response)), **style)
    modelled = estimate.model.of(row, column) if estimate.model is not None else None
    if modelled is not None:
        hertz, model = modelled[0] / (2.0 * np.pi), modelled[1]
        style = {"color": VERMILION, "linewidth": 1.0, "linestyle": (0, (5, 2))}
        magnitudes.plot(hertz, 20.0 * np.log10(np.abs(model)), label=estimate.model.model, **style)
        model_phase = phase[usable] + np.degrees(np.angle(model / response[usable]))
        phases.plot(hertz, model_phase, **style)
    coherences.plot(f, result.coherence[row], color=BLUE, linewidth=1.2)
    if result.response.shape[1] > 1:
        partial = result.partial_coherence[row, column]
        coherences.plot(f, partial, color=ORANGE, linewidth=1.1, label="partial coherence")
    least = result.spectra.least_coherence
    coherences.axhline(least, color=GREY, linewidth=0.7, linestyle=":")
    coherences.set_ylim(0.0, 1.02)
    for panel in sheet.panels:
        panel.set_xscale("log")
        panel.set_xlim(float(f[0]), float(f[-1]))
        for first, last in _outside(f, usable):
            panel.axvspan(first, last, color=LIGHT, alpha=0.5, linewidth=0.0, zorder=0.4)
    shown = usable if usable.any() else np.ones_like(usable)
    _limits(magnitudes, magnitude[shown], reach=_REACH_MAGNITUDE)
    _limits(phases, phase[shown], 20.0, reach=_REACH_PHASE)
    decades(coherences.xaxis, (1.0, 2.0, 5.0))
    unit = estimate.unit(output, input_name)
    y_label(magnitudes, f"magnitude (dB{f' of {unit}' if unit else ''})")
    y_label(phases, "phase (deg)")
    y_label(coherences, "coherence (–)")
    coherences.set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(sheet, f"{output} / {input_name}\n{data}; grey: outside the usable band")


def figure_mismatch(estimate: Any, row: int = 0, column: int = 0) -> Figure:
    """Plot the ratio of estimated to fitted response (dB, deg) with 95 % bands, and the envelopes
    of maximum unnoticeable added dynamics. Raise DeclarationError without a fit.
    """
    fitted = estimate.fits.of(row, column) if estimate.fits is not None else None
    if fitted is None:
        remedy = "name a form (fit)"
        raise DeclarationError("no transfer function is fitted", where="mismatch", remedy=remedy)
    function, mismatch = fitted
    f = mismatch.frequency
    limits = unnoticeable_envelopes(2.0 * np.pi * f)
    sheet = make_sheet([1.6, 1.6], row_gap=0.14)
    rows = (
        (mismatch.gain, mismatch.gain_error, limits.low_gain, limits.high_gain, "gain (dB)"),
        (mismatch.phase, mismatch.phase_error, limits.low_phase, limits.high_phase, "phase (deg)"),
    )
    for panel, (value, error, low, high, label) in zip(sheet.panels, rows, strict=True):
        error = np.minimum(error, _LARGEST_DRAWN_HALF_WIDTH)
        panel.fill_between(f, value - error, value + error, **_BAND)
        panel.plot(f, value, color=BLUE, linewidth=1.2, label="estimate over fitted")
        for limit, text in ((low, "unnoticeable within"), (high, None)):
            envelope = np.where(mismatch.piloted, limit, np.nan)
            panel.plot(f, envelope, color=VERMILION, linewidth=1.0, linestyle="--", label=text)
        panel.axhline(0.0, color=GREY, linewidth=0.6)
        panel.set_xscale("log")
        panel.set_xlim(float(f[0]), float(f[-1]))
        least_limit = 12.0 if "dB" in label else 60.0
        y_limit = max(1.3 * float(np.max(np.abs(value))) + 1.0, least_limit)
        panel.set_ylim(-y_limit, y_limit)
        y_label(panel, label)
    decades(sheet.panels[-1].xaxis, (1.0, 2.0, 5.0))
    sheet.panels[-1].set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(
        sheet,
        f"{function.name}: mismatch of {function.form.name}\n{data}; cost {function.cost:.3g}",
    )


def figure_bandwidth(estimate: Any, number: int = 0) -> Figure:
    """Plot an attitude response with its bandwidths and phase delay.

    ``number`` counts the responses with a bandwidth. Raise DeclarationError without a bandwidth.
    """
    with_curve = [each for each in estimate.qualities if each.curve is not None]
    if not 0 <= number < len(with_curve):
        remedy = "say what the outputs are (bandwidth), rate or attitude"
        raise DeclarationError("there is no bandwidth to draw", where="bandwidth", remedy=remedy)
    qualities = with_curve[number]
    curve, result = qualities.curve, qualities.bandwidth
    f = curve.omega / math.tau
    sheet = make_sheet([1.6, 1.6], row_gap=0.14)
    gains, phases = sheet.panels
    for panel, value, std in (
        (gains, curve.gain, curve.gain_std),
        (phases, curve.phase, curve.phase_std),
    ):
        half = np.minimum(NORMAL_HALF_WIDTH * std, _LARGEST_DRAWN_HALF_WIDTH)
        panel.fill_between(f, value - half, value + half, **_BAND)
        panel.plot(f, value, color=BLUE, linewidth=1.2, label="attitude")
        panel.set_xscale("log")
        panel.set_xlim(float(f[0]), float(f[-1]))
        _limits(panel, value)
        for quantity, colour, label in (
            (result.phase, VERMILION, "phase bandwidth"),
            (result.gain, ORANGE, "gain bandwidth"),
            (result.neutral, BLACK, "-180 deg"),
        ):
            if quantity is not None:
                panel.axvspan(
                    (quantity.value - NORMAL_HALF_WIDTH * quantity.std) / math.tau,
                    (quantity.value + NORMAL_HALF_WIDTH * quantity.std) / math.tau,
                    color=colour,
                    alpha=0.25,
                    linewidth=0.0,
                )
                panel.axvline(quantity.value / math.tau, color=colour, linewidth=1.0, label=label)
    for level in (-135.0, -180.0):
        phases.axhline(level, color=GREY, linewidth=0.7, linestyle=":")
    if result.delay is not None:
        ends = np.array([1.0, 2.0]) * result.neutral.value
        fall = np.degrees(2.0 * result.delay.value * (ends - ends[0]))
        style: dict[str, Any] = {"color": BLACK, "linewidth": 1.0}
        phases.plot(ends / math.tau, -180.0 - fall, linestyle="--", label="phase delay", **style)
    decades(phases.xaxis, (1.0, 2.0, 5.0))
    y_label(gains, "gain (dB)")
    y_label(phases, "phase (deg)")
    phases.set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(sheet, f"{qualities.name}: bandwidth\n{data}; spans: 95 %")


def figure_margins(estimate: Any) -> Figure:
    """Plot the broken-loop response with its margins: gain, phase about -180 deg, distance from -1.

    Raise DeclarationError without margins.
    """
    loop = estimate.loop
    if loop is None:
        remedy = "say how the loop takes back its output (margins), minus or plus"
        raise DeclarationError("there are no margins to draw", where="loop", remedy=remedy)
    curve, margins = loop.curve, loop.margins
    f = curve.omega / math.tau
    sheet = make_sheet([1.5, 1.5, 1.1], row_gap=0.14)
    rows = (
        (curve.gain, curve.gain_std, "gain (dB)", margins.gains, -1.0),
        (curve.phase, curve.phase_std, "phase + 180 (deg)", margins.phases, 1.0),
        (curve.distance, curve.distance_std, "distance (dB)", (), 0.0),
    )
    for panel, (value, std, label, marks, sign) in zip(sheet.panels, rows, strict=True):
        half = np.minimum(NORMAL_HALF_WIDTH * std, _LARGEST_DRAWN_HALF_WIDTH)
        panel.fill_between(f, value - half, value + half, **_BAND)
        panel.plot(f, value, color=BLUE, linewidth=1.2, label="broken loop")
        panel.axhline(0.0, color=GREY, linewidth=0.7, linestyle=":")
        panel.set_xscale("log")
        panel.set_xlim(float(f[0]), float(f[-1]))
        _limits(panel, value)
        for margin in marks:
            omega, end, zero = margin.frequency.value, sign * margin.size.value, 0.0
            colour, text = ORANGE, "gain margin"
            if sign > 0.0:
                colour, text = VERMILION, "phase margin"
                # A phase margin begins at the multiple of 360 deg from which it ends on the curve.
                shift = value[np.argmin(np.abs(curve.omega - omega))] - end
                zero = 360.0 * round(shift / 360.0)
            x = [omega / math.tau] * 2
            panel.plot(x, [zero, zero + end], color=colour, linewidth=1.4, label=text)
            interval = [zero + sign * margin.low, zero + sign * margin.high]
            panel.plot(x, interval, color=colour, linewidth=5.0, alpha=0.35, solid_capstyle="butt")
        y_label(panel, label)
    if margins.distance is not None:
        least = margins.distance
        level = 20.0 * math.log10(least.size.value)
        style: dict[str, Any] = {"color": BLACK, "linewidth": 1.4}
        x = [least.frequency.value / math.tau] * 2
        sheet.panels[2].plot(x, [0.0, level], label="least distance from −1", **style)
    axis = sheet.panels[-1]
    decades(axis.xaxis, (1.0, 2.0, 5.0))
    axis.set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(sheet, f"{loop.name}: stability margins\n{data}; bands and bars: 95 %")


def _decibels(response: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the magnitude and the limits of its band of half width ``half``, all in dB."""
    size = np.abs(response)
    smallest = 10.0 ** (-_LARGEST_DRAWN_HALF_WIDTH / 20.0) * size
    magnitude = 20.0 * np.log10(np.maximum(size, _SMALLEST_SIZE))
    low = 20.0 * np.log10(np.maximum(size - half, smallest))
    return magnitude, low, 20.0 * np.log10(np.maximum(size + half, _SMALLEST_SIZE))


def _outside(frequency: np.ndarray, usable: np.ndarray) -> list[tuple[float, float]]:
    """Return the frequency bands below and above the usable band, Hz."""
    inside = np.flatnonzero(usable)
    if not inside.size:
        return [(float(frequency[0]), float(frequency[-1]))]
    ends = [(frequency[0], frequency[inside[0]]), (frequency[inside[-1]], frequency[-1])]
    return [(float(low), float(high)) for low, high in ends if high > low]


def _limits(panel: Any, values: np.ndarray, least: float = 3.0, reach: float = 0.0) -> None:
    """Limit an axis to the line, not to its wide band; the margin is at least ``least``.

    All lines of the panel are inside, as far as they are within ``reach`` of the line's range.
    """
    low, high = float(np.min(values)), float(np.max(values))
    if reach:
        drawn = np.concatenate([np.asarray(line.get_ydata(), float) for line in panel.lines])
        drawn = drawn[np.isfinite(drawn)]
        low, high = (
            max(min(low, float(drawn.min())), low - reach),
            min(max(high, float(drawn.max())), high + reach),
        )
    margin = max(0.15 * (high - low), least)
    if math.isfinite(low + high):
        panel.set_ylim(low - margin, high + margin)


# ---- Stability margins of a stream over time


_MARGINS = (  # margin, label, requirement of MIL-F-9490D
    ("gain_increase", "gain increase (dB)", REQUIRED_GAIN),
    ("gain_decrease", "gain decrease (dB)", -REQUIRED_GAIN),
    ("phase_margin", "phase margin (deg)", REQUIRED_PHASE),
    ("distance", "distance from −1 (–)", None),
)


def figure_margin_history(points: Sequence[Any], name: str = "") -> Figure:
    """Plot the margins of a loop over the time of a stream, with 95 % intervals.

    Dashed lines are the requirements of MIL-F-9490D. A margin that is never known has no panel.
    """
    by_point = [point.margins.named if point.margins is not None else {} for point in points]
    rows = [row for row in _MARGINS if any(row[0] in named for named in by_point)]
    sheet = make_sheet([1.15] * max(len(rows), 1), row_gap=0.16)
    time = np.array([point.time for point in points])
    for panel, (name_of_margin, label, required) in zip(sheet.panels, rows, strict=False):
        margins = [named.get(name_of_margin) for named in by_point]
        value, low, high = np.array(
            [
                (np.nan,) * 3 if margin is None else (margin.size.value, margin.low, margin.high)
                for margin in margins
            ]
        ).T
        panel.fill_between(time, low, high, label="95 %", **_BAND)
        panel.plot(
            time, value, color=BLUE, linewidth=1.2, marker=".", markersize=3.0, label="margin"
        )
        # The last two thirds set the scale, because the first values are uncertain.
        known = value[np.isfinite(value)]
        late = known[known.size // 3 :]
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

_REGION_SIGMAS = 2.4477  # semi-axes of the 95 % ellipse of two normal errors
_LEVEL_COLOURS = (GREEN, ORANGE)


def figure_qualities(estimate: Any, number: int = 0) -> Figure:
    """Plot flying qualities of one response with 95 % regions, on the chart of each criterion.

    The charts are damping and CAP; bandwidth and phase delay; Neal-Smith criterion; dropback and
    overshoot of a fitted pitch rate. A chart without published limits says so. Raise
    DeclarationError without any chart.
    """
    with_charts = [each for each in estimate.qualities if charts_of(each)]
    if not 0 <= number < len(with_charts):
        remedy = "fit pitch with --airspeed and --levels, or name --bandwidth or --pilot"
        raise DeclarationError("there is no chart to draw", where="qualities", remedy=remedy)
    qualities = with_charts[number]
    charts = charts_of(qualities)
    columns = min(len(charts), 2)
    rows = math.ceil(len(charts) / columns)
    sheet = make_sheet(
        [2.3] * rows, [1.0] * columns, count=len(charts), share_x=False, row_gap=0.72, left=0.8
    )
    for panel, draw in zip(sheet.panels, charts, strict=True):
        draw(panel, qualities)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    title = f"{qualities.name}: flying qualities\n{data}; ellipses: 95 %"
    return finish(sheet, title, legend=False)


def charts_of(qualities: Any) -> list[Callable[[Any, Any], None]]:
    """Return the drawing functions of the charts for which a response has numbers."""
    charts: tuple[tuple[Callable[[Any, Any], None], set[str]], ...] = (
        (_draw_anticipation, {"damping_ratio", "control_anticipation"}),
        (_draw_bandwidth, {"bandwidth", "phase_delay"}),
        (_draw_pilot, {"pilot_resonance", "pilot_compensation"}),
        (_draw_dropback, {"dropback", "pitch_rate_overshoot"}),
    )
    return [draw for draw, needed in charts if needed <= set(qualities.numbers)]


def _draw_anticipation(panel: Any, qualities: Any) -> None:
    names = ("damping_ratio", "control_anticipation")
    damping, cap = (qualities.numbers[name][0] for name in names)
    largest_damping, largest_cap = 5.0, 20.0
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_xlim(0.1, largest_damping)
    panel.set_ylim(0.01, largest_cap)
    words = "no category named (--levels)"
    if qualities.flown is not None:
        aircraft_class, category = qualities.flown
        limits = {
            criterion.quantity: criterion.levels
            for criterion in criteria(aircraft_class)
            if criterion.category == category and criterion.quantity in names
        }
        for level in (1, 0):
            (left, right), (low, high) = (limits[name][level] for name in names)
            right, high = min(right, largest_damping), min(high, largest_cap)
            _draw_limit(panel, [left, right, right, left, left], [low, low, high, high, low], level)
        words = f"MIL-STD-1797A, category {category}"
    _draw_point(panel, (damping.value, damping.std), (cap.value, cap.std))
    decades(panel.xaxis, (1.0, 2.0, 5.0))
    decades(panel.yaxis)
    _name_axes(panel, "damping (–)", "CAP (1/(g s²))", words)


def _draw_bandwidth(panel: Any, qualities: Any) -> None:
    band, delay = (qualities.numbers[name][0] for name in ("bandwidth", "phase_delay"))
    largest_band, largest_delay = max(12.0, 1.25 * band.value), max(0.2, 1.4 * delay.value)
    for level, points in enumerate(() if qualities.of_pitch is False else PITCH_LEVELS):
        x, y = (list(values) for values in zip(*points, strict=True))
        _draw_limit(panel, x, y, level)
        # Beyond the end of the published limit, the same delay is drawn dashed.
        style = {"color": _LEVEL_COLOURS[level], "linewidth": 1.0, "linestyle": (0, (4, 3))}
        panel.plot([x[-1], largest_band], [y[-1], y[-1]], **style)
    panel.set_xlim(0.0, largest_band)
    panel.set_ylim(0.0, largest_delay)
    _draw_point(panel, (band.value, band.std), (delay.value, delay.std))
    words = _limits_of_pitch(qualities, "pitch: MIL-STD-1797A, category A (not verified)")
    _name_axes(panel, "bandwidth (rad/s)", "phase delay (s)", words)


def _limits_of_pitch(qualities: Any, words: str) -> str:
    """Return ``words`` on the source of the limits, or a remark if the response is not in pitch."""
    if qualities.of_pitch is False:
        return "no limits drawn: known ones are for pitch"
    return words if qualities.of_pitch else f"{words}; if this is pitch"


def _draw_pilot(panel: Any, qualities: Any) -> None:
    result = qualities.pilot
    phase, resonance = result.compensation, result.resonance
    width = max(60.0, 1.3 * abs(phase.value))
    for level, limit in enumerate(() if qualities.of_pitch is False else LARGEST_RESONANCES):
        _draw_limit(panel, [-width, width], [limit, limit], level)
    panel.set_xlim(-width, width)
    panel.set_ylim(min(-2.0, resonance.value - 3.0), max(12.0, resonance.value + 3.0))
    _draw_point(
        panel, (phase.value, phase.std), (resonance.value, resonance.std), result.correlation
    )
    task = f"{result.demand.bandwidth:g} rad/s, {result.demand.delay:g} s"
    words = _limits_of_pitch(qualities, f"MIL-STD-1797A; {task}")
    _name_axes(panel, "phase of the pilot (deg)", "resonance (dB)", words)


def _draw_dropback(panel: Any, qualities: Any) -> None:
    names = ("dropback", "pitch_rate_overshoot")
    dropback, overshoot = (qualities.numbers[name][0] for name in names)
    panel.axvline(0.0, color=GREY, linewidth=0.9, linestyle=":")
    width = max(0.6, 1.4 * abs(dropback.value) + 2.5 * dropback.std)
    panel.set_xlim(-width, width)
    panel.set_ylim(0.8, max(3.5, 1.3 * overshoot.value))
    _draw_point(panel, (dropback.value, dropback.std), (overshoot.value, overshoot.std))
    words = "no printed limit at hand; left: overshoot"
    _name_axes(panel, "dropback / steady rate (s)", "largest / steady rate (–)", words)


def _draw_limit(panel: Any, x: Sequence[float], y: Sequence[float], level: int) -> None:
    """Draw the limit of a level with its name; ``level``: 0 for level 1, 1 for level 2."""
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


def _draw_point(
    panel: Any, x: tuple[float, float], y: tuple[float, float], correlation: float = 0.0
) -> None:
    """Plot a point with its 95 % ellipse; ``x`` and ``y`` are value and sigma."""
    angle = np.linspace(0.0, 2.0 * np.pi, 101)
    along_x = np.cos(angle)
    along_y = correlation * np.cos(angle) + np.sqrt(max(1.0 - correlation**2, 0.0)) * np.sin(angle)
    panel.fill(
        x[0] + _REGION_SIGMAS * x[1] * along_x,
        y[0] + _REGION_SIGMAS * y[1] * along_y,
        color=SKY,
        alpha=0.5,
        linewidth=0.0,
    )
    panel.plot([x[0]], [y[0]], color=BLUE, marker="o", markersize=4.5)


def _name_axes(panel: Any, x_label: str, y_label_text: str, words: str) -> None:
    """Label the axes of a chart, and write the source of its limits above it."""
    panel.set_xlabel(x_label, fontsize=LABEL_SIZE)
    y_label(panel, y_label_text)
    caption(panel, words)


def figure_steps(estimate: Any, row: int = 0, column: int = 0) -> Figure:
    """Plot the step response of a fitted response over its steady value, with its 95 % band.

    Raise DeclarationError without a fit or without a steady value.
    """
    fitted = estimate.fits.of(row, column) if estimate.fits is not None else None
    step = step_response(fitted[0]) if fitted is not None else None
    if fitted is None or step is None:
        what = "no response is fitted that becomes steady"
        raise DeclarationError(what, where="step", remedy="name a form (fit)")
    sheet = make_sheet([2.4])
    panel = sheet.panels[0]
    half = NORMAL_HALF_WIDTH * step.std
    panel.fill_between(step.time, step.value - half, step.value + half, label="95 %", **_BAND)
    panel.plot(step.time, step.value, color=BLUE, linewidth=1.3, label="step over steady value")
    panel.axhline(1.0, color=GREY, linewidth=0.7, linestyle=":")
    panel.set_xlim(0.0, float(step.time[-1]))
    y_label(panel, "response (–)")
    time_axis(panel)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(
        sheet, f"{fitted[0].name}: step response of the fitted {fitted[0].form.name}\n{data}"
    )
