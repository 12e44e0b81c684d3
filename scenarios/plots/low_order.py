"""Figures in frequency: low-order equivalents, closed loops, frequency responses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from matplotlib.figure import Figure

from ident.estimate import FilterHistory
from ident.frequency_response.transfer_function import unnoticeable
from scenarios.plots.display import (
    MEASURED_DATA,
    SIMULATED_DATA,
    axis_label,
    course,
    display_unit,
    plain,
    scaled_unit,
    symbol,
)
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
    TRUE,
    VERMILION,
    ZERO,
    caption,
    decades,
    finish,
    folded,
    make_sheet,
    time_axis,
    y_label,
)
from sim.errors import DeclarationError

# ---- Figures of low-order equivalents and of the closed loop behind them

_DEEPEST = 1e4  # of a log-likelihood below its maximum: what lies lower is drawn there
_LABEL = 2.6  # inches
# of the response, where what is exactly equal is drawn; inches, for names beside bars
_LEAST, _WORDS = 1e-16, 2.1


@dataclass(frozen=True)
class Bar:
    """A value with its standard deviation, in ``unit``."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True, eq=False)
class LikelihoodCurve:
    """A bank's delays (s) and log-likelihoods ``(B,)``, and the three delays read from them, s."""

    delays: np.ndarray
    log_likelihood: np.ndarray
    most_likely: float
    weighted_mean: float
    refined: float
    refined_std: float


def figure_side_by_side(
    first: Mapping[str, Bar],
    second: Mapping[str, Bar],
    first_label: str,
    second_label: str,
    title: str = "",
    printed: Sequence[Mapping[str, float]] = (),
) -> Figure:
    """Two estimates with bounds of two standard deviations, one small panel for each quantity (fig.
    8 of NASA TM-101722).

    ``printed`` : of both, what a paper prints, in the same units; drawn beside them.
    """
    names = [name for name in first if name in second]
    columns = 4
    rows = -(-len(names) // columns)
    sheet = make_sheet(
        [1.3] * rows,
        (1.0,) * columns,
        count=len(names),
        share_x=False,
        row_gap=0.36,
        column_gap=0.5,
        left=0.55,
    )
    for name, panel in zip(names, sheet.panels, strict=True):
        base = display_unit(first[name].unit, name)
        largest = max(
            abs(first[name].value), abs(second[name].value), first[name].std, second[name].std
        )
        unit = scaled_unit(base, base.factor * largest)
        caption(panel, axis_label(name, unit), LABEL_SIZE)
        for x, bar, colour, marker, label in (
            (0.0, first[name], BLUE, "o", first_label),
            (1.0, second[name], VERMILION, "s", second_label),
        ):
            yerr = [2.0 * unit.factor * bar.std]
            panel.errorbar(
                [x],
                [unit.factor * bar.value],
                yerr=yerr,
                fmt=marker,
                color=colour,
                markersize=4.5,
                capsize=3,
                linewidth=1.2,
                label=plain(f"{label} ±2σ"),
            )
        for x, cells in zip((0.25, 1.25), printed, strict=False):
            if name in cells:
                value = [unit.factor * cells[name]]
                panel.plot(
                    [x],
                    value,
                    color=BLACK,
                    linestyle="none",
                    marker="D",
                    markersize=4.0,
                    fillstyle="none",
                    label="published",
                )
        panel.set_xlim(-0.6, 1.6)
        panel.set_xticks([])
        panel.margins(y=0.2)
    return finish(sheet, title, bottom=0.15, head=0.24)


def figure_states(
    history: FilterHistory, names: Sequence[str], units: Sequence[str], title: str = ""
) -> Figure:
    """States of a filter over time with bounds of two standard deviations, one wide panel each,
    whole range.
    """
    sheet = make_sheet([1.1] * len(names), row_gap=0.2)
    for name, unit, panel in zip(names, units, sheet.panels, strict=True):
        shown = display_unit(unit)
        path = course(history, name, shown.factor)
        panel.fill_between(
            path.time,
            path.mean - 2.0 * path.std,
            path.mean + 2.0 * path.std,
            color=SKY,
            alpha=0.5,
            linewidth=0,
            label="±2σ",
        )
        panel.plot(path.time, path.mean, color=BLUE, linewidth=1.0, label="estimate")
        y_label(panel, axis_label(name, shown))
    time_axis(sheet.panels[-1])
    return finish(sheet, title)


def figure_delays(curve: LikelihoodCurve, title: str = "") -> Figure:
    """How far each delay's log-likelihood lies below the largest (logarithmic), with the most
    likely, the weighted and the refined delay.
    """
    sheet = make_sheet([2.0], right=0.3)
    panel = sheet.panels[0]
    below = np.clip(np.max(curve.log_likelihood) - curve.log_likelihood, 0.0, _DEEPEST)
    panel.plot(
        1e3 * curve.delays,
        below,
        color=BLUE,
        marker="o",
        markersize=4.0,
        linewidth=1.0,
        label="bank of filters, one pass",
    )
    panel.axvline(
        1e3 * curve.most_likely, color=BLUE, linewidth=2.4, alpha=0.5, label="most likely"
    )
    panel.axvline(
        1e3 * curve.weighted_mean,
        color=GREEN,
        linewidth=1.3,
        linestyle="--",
        label="likelihood-weighted sum",
    )
    panel.axvline(
        1e3 * curve.refined,
        color=VERMILION,
        linewidth=1.2,
        label="refined" + (" ±2σ" if curve.refined_std > 0 else ""),
    )
    if curve.refined_std > 0:
        half = 2e3 * curve.refined_std
        panel.axvspan(
            1e3 * curve.refined - half,
            1e3 * curve.refined + half,
            color=SKY,
            alpha=0.4,
            linewidth=0,
        )
    panel.set_yscale("symlog", linthresh=10.0)
    panel.set_ylim(1.6 * max(float(below.max()), 10.0), -3.0)
    panel.set_xlabel("delay (ms)", fontsize=LABEL_SIZE)
    y_label(panel, "log-likelihood below the best")
    return finish(sheet, title)


def figure_peaks(rows: Sequence[tuple[str, float]], words: str, title: str = "") -> Figure:
    """One number for each variant as a horizontal bar; ``words`` says what it is. Signs are shown
    where one is negative.
    """
    n, sign = len(rows), "+" if any(round(value, 2) < 0 for _, value in rows) else ""
    sheet = make_sheet([0.38 * n + 0.1], left=_LABEL + 0.2, right=0.5)
    panel = sheet.panels[0]
    places = np.arange(n)[::-1]
    panel.barh(
        places, [value for _, value in rows], height=0.5, color=[VERMILION] + [BLUE] * (n - 1)
    )
    panel.axvline(0.0, **ZERO)
    for place, (_, value) in zip(places, rows, strict=True):
        # What rounds to nothing has no sign.
        text = f"{round(value, 2) + 0.0:{sign if round(value, 2) else ''}.2f}".replace("-", "−")
        panel.annotate(
            text,
            (value, place),
            xytext=(4 if value >= 0 else -4, 0),
            textcoords="offset points",
            ha="left" if value >= 0 else "right",
            va="center",
            fontsize=TICK_SIZE,
            color=BLACK,
        )
    panel.set_yticks(
        places, ["\n".join(folded(plain(label), _LABEL, TICK_SIZE)) for label, _ in rows]
    )
    panel.margins(x=0.18)
    panel.grid(False, axis="y")
    panel.set_xlabel(words, fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.12)


def figure_linear(
    time: np.ndarray,
    flown: np.ndarray,
    linear: np.ndarray,
    names: Sequence[str],
    units: Sequence[str],
    sticks: Sequence[float],
    curves: Mapping[str, Sequence[float]],
    title: str = "",
) -> Figure:
    """Flown ``(m, F)`` and linear responses over time (s), and the misfit of q over the size of the
    stick (in), both logarithmic.
    """
    sheet = make_sheet([1.05] * (len(names) + 1) + [1.9], row_gap=0.45, share_x=False)
    for name, unit, one, other, panel in zip(
        names, units, flown, linear, sheet.panels, strict=False
    ):
        shown = display_unit(unit)
        panel.plot(time, shown.factor * one, color=BLUE, linewidth=2.4, label="flown, noise-free")
        panel.plot(time, shown.factor * other, label="linear, python-control", **TRUE)
        y_label(panel, axis_label(name, shown))
        panel.set_xlim(time[0], time[-1])
    shown, row = display_unit(units[names.index("q")]), names.index("q")
    panel = sheet.panels[len(names)]
    panel.plot(
        time,
        shown.factor * (flown[row] - linear[row]),
        color=VERMILION,
        linewidth=1.0,
        label="flown less linear",
    )
    panel.axhline(0.0, **ZERO)
    panel.set_xlim(time[0], time[-1])
    y_label(panel, f"difference in {symbol('q')} ({shown.text})")
    time_axis(panel)
    panel = sheet.panels[-1]
    for (label, values), colour, marker in zip(
        curves.items(), (BLUE, GREEN, BLACK), ("o", "s", "^"), strict=True
    ):
        panel.plot(
            sticks,
            np.maximum(values, _LEAST),
            color=colour,
            marker=marker,
            markersize=4.5,
            linewidth=1.0,
            label=label,
        )
    panel.set_xscale("log")
    panel.set_yscale("log")
    panel.set_ylim(_LEAST / 3.0, 30.0)
    panel.set_xticks(list(sticks), [f"{size:g}" for size in sticks])
    panel.minorticks_off()
    panel.set_xlabel("largest stick (in)", fontsize=LABEL_SIZE)
    y_label(panel, f"misfit of {symbol('q')} (–)")
    return finish(sheet, title)


def figure_open_margins(
    clouds: Sequence[tuple[str, np.ndarray, np.ndarray]],
    declared: Sequence[tuple[str, float, float]],
    effects: Sequence[tuple[str, float]],
    title: str = "",
) -> Figure:
    """Phase margins of flight over those of simulation (deg), and what each open value does to
    their difference.

    ``clouds`` and ``declared`` : a label with margins of simulation and flight. ``effects`` : a
    label with degrees, drawn where there are any.
    """
    heights = [3.4, 0.3 * len(effects) + 0.1] if effects else [3.4]
    sheet = make_sheet(heights, share_x=False, row_gap=0.62, left=_WORDS if effects else 0.72)
    panel = sheet.panels[0]
    for (label, simulation, flight), colour, marker in zip(
        clouds, (BLUE, VERMILION), ("o", "x"), strict=True
    ):
        panel.plot(
            simulation,
            flight,
            color=colour,
            marker=marker,
            markersize=4.5,
            linestyle="none",
            label=label,
        )
    every = np.concatenate(
        [np.concatenate([simulation, flight]) for _, simulation, flight in clouds]
        + [np.array(d[1:]) for d in declared]
    )
    ends = np.array([every.min() - 2.0, every.max() + 2.0])
    panel.plot(ends, ends, label="equal: above it the paper's sign", **TRUE)
    for (label, x, y), marker in zip(declared, ("D", "*"), strict=False):
        panel.plot(
            [x], [y], color=BLACK, marker=marker, markersize=8.0, linestyle="none", label=label
        )
    panel.set_xlim(*ends)
    panel.set_ylim(*ends)
    panel.set_xlabel("phase margin of the simulation (deg)", fontsize=LABEL_SIZE)
    y_label(panel, "phase margin of the flight (deg)")
    if effects:
        panel, places = sheet.panels[1], np.arange(len(effects))[::-1]
        panel.barh(places, [value for _, value in effects], height=0.55, color=BLUE)
        panel.axvline(0.0, **ZERO)
        panel.set_yticks(
            places, ["\n".join(folded(label, _WORDS - 0.3, TICK_SIZE)) for label, _ in effects]
        )
        panel.grid(False, axis="y")
        panel.set_xlabel(
            "flight less simulation, from the middle to the high end of the range (deg)",
            fontsize=LABEL_SIZE,
        )
    return finish(sheet, title)


# ---- A frequency response: magnitude, phase and coherence over frequency

_MOST = 60.0  # dB and degrees of a band's half that is drawn


class Signals(Protocol):
    """Names of signals."""

    @property
    def inputs(self) -> Sequence[str]: ...
    @property
    def outputs(self) -> Sequence[str]: ...


class EstimatedResponses(Protocol):
    """Frequency responses of records."""

    @property
    def names(self) -> Signals: ...
    @property
    def found(self) -> Any: ...
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
    """Magnitude in dB, phase in degrees, each with its 95 % band, and coherence of one response.

    The usable band is white, what is outside it grey.
    """
    found = estimate.found
    output, one = estimate.names.outputs[row], estimate.names.inputs[column]
    sheet = make_sheet([1.8, 1.5, 1.1], row_gap=0.14)
    size, angle, likeness = sheet.panels
    f, response, usable = found.frequency, found.response[row, column], found.usable[row, column]
    decibel, low, high = _decibels(response, found.half_width()[row, column])
    size.fill_between(f, low, high, color=SKY, alpha=0.45, linewidth=0.0, label="95 % band")
    size.plot(f, decibel, color=BLUE, linewidth=1.2, label="joint" if found.joint else "estimate")
    phase = np.degrees(found.phase()[row, column])
    turn = np.minimum(np.degrees(found.phase_half_width()[row, column]), _MOST)
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
    several = found.response.shape[1] > 1
    likeness.plot(f, found.coherence[row], color=BLUE, linewidth=1.2)
    if several:
        partial = found.partial_coherence[row, column]
        likeness.plot(f, partial, color=ORANGE, linewidth=1.1, label="partial coherence")
    least = found.spectra.least_coherence
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
    """The estimated response over the fitted one, in dB and degrees, with 95 % bands, between the
    envelopes of maximum unnoticeable added dynamics. Raises DeclarationError where none is fitted.
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
        error = np.minimum(error, _MOST)
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
    """The attitude response of one entry of the flying qualities, with its bandwidths and the phase
    delay marked. Raises DeclarationError where no bandwidth was asked for."""
    curves = [each for each in estimate.qualities if each.curve is not None]
    if not 0 <= number < len(curves):
        remedy = "say what the outputs are (bandwidth), rate or attitude"
        raise DeclarationError("there is no bandwidth to draw", where="bandwidth", remedy=remedy)
    one = curves[number]
    curve, found = one.curve, one.bandwidth
    sheet = make_sheet([1.6, 1.6], row_gap=0.14)
    size, angle = sheet.panels
    for panel, value, std in (
        (size, curve.gain, curve.gain_std),
        (angle, curve.phase, curve.phase_std),
    ):
        half = np.minimum(1.96 * std, _MOST)
        panel.fill_between(
            curve.omega, value - half, value + half, color=SKY, alpha=0.45, linewidth=0
        )
        panel.plot(curve.omega, value, color=BLUE, linewidth=1.2, label="attitude")
        panel.set_xscale("log")
        panel.set_xlim(float(curve.omega[0]), float(curve.omega[-1]))
        _limits(panel, value)
        for each, colour, label in (
            (found.phase, VERMILION, "phase bandwidth"),
            (found.gain, ORANGE, "gain bandwidth"),
            (found.neutral, BLACK, "-180 deg"),
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
    if found.delay is not None:
        ends = np.array([1.0, 2.0]) * found.neutral.value
        fall = np.degrees(2.0 * found.delay.value * (ends - ends[0]))
        line: dict[str, Any] = {"color": BLACK, "linewidth": 1.0}
        angle.plot(ends, -180.0 - fall, linestyle="--", label="phase delay", **line)
    decades(angle.xaxis, (1.0, 2.0, 5.0))
    y_label(size, "gain (dB)")
    y_label(angle, "phase (deg)")
    angle.set_xlabel("frequency (rad/s)", fontsize=LABEL_SIZE)
    data = SIMULATED_DATA if estimate.simulated else MEASURED_DATA
    return finish(sheet, f"{one.name}: bandwidth\n{data}; spans: 95 %")


class EstimatedLoop(Protocol):
    """A loop with its margins; ``simulated``: a program made its record."""

    @property
    def loop(self) -> Any: ...
    @property
    def simulated(self) -> bool: ...


def figure_margins(estimate: EstimatedLoop) -> Figure:
    """The broken-loop response: gain, phase about -180 deg and distance from -1, with the margins
    marked. Raises DeclarationError where no margins were asked for."""
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
        half = np.minimum(1.96 * std, _MOST)
        panel.fill_between(
            curve.omega, value - half, value + half, color=SKY, alpha=0.45, linewidth=0
        )
        panel.plot(curve.omega, value, color=BLUE, linewidth=1.2, label="broken loop")
        panel.axhline(0.0, color=GREY, linewidth=0.7, linestyle=":")
        panel.set_xscale("log")
        panel.set_xlim(float(curve.omega[0]), float(curve.omega[-1]))
        _limits(panel, value)
        for margin in marks:
            # Of a phase whole turns are added until the end lies on the curve.
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
    low = 20.0 * np.log10(np.maximum(size - half, 10.0 ** (-_MOST / 20.0) * size))
    return decibel, low, 20.0 * np.log10(np.maximum(size + half, 1e-300))


def _outside(frequency: np.ndarray, usable: np.ndarray) -> list[tuple[float, float]]:
    there = np.flatnonzero(usable)
    if not there.size:
        return [(float(frequency[0]), float(frequency[-1]))]
    ends = [(frequency[0], frequency[there[0]]), (frequency[there[-1]], frequency[-1])]
    return [(float(a), float(b)) for a, b in ends if b > a]


def _limits(panel: Any, values: np.ndarray, least: float = 3.0) -> None:
    """Limits that show the line and a margin, whatever a wide band does."""
    low, high = float(np.min(values)), float(np.max(values))
    margin = max(0.15 * (high - low), least)
    if math.isfinite(low + high):
        panel.set_ylim(low - margin, high + margin)
