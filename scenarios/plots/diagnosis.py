"""Figures of a diagnosis: residuals and their spectra before and after, the held-out record, evidence, derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from ident.tracing.diagnosis import Candidate, FittedRecord, Prediction, Quantity
from scenarios.plots.display import axis_label, display_unit, plain, symbol
from scenarios.plots.signals import Response, figure_fit
from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREY,
    LABEL_SIZE,
    SKY,
    TICK_SIZE,
    VERMILION,
    WIDTH,
    ZERO,
    caption,
    finish,
    make_sheet,
    text_width,
    time_axis,
    y_label,
)
from scenarios.terminal.quantities import value_text

BARS, PANELS = 7, 4  # candidates of a round, rounds
LEAST = 0.1  # gain at the left edge of the evidence
_BAND = "±2σ of the noise"


def figure_residuals(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Residuals of the fitted record against time, left with the declared model, right with the effects, one scale for both.

    Where nothing was added there is one column. ``noise`` is the noise's standard deviation by channel. Samples that were
    set aside are ringed; angles in degrees.
    """
    shown = _measured(fitted)
    count, same = len(shown), _same(fitted, [row for row, _ in shown])
    sides = (("residual", fitted.after),) if same else (("before", fitted.before), ("after", fitted.after))
    sheet = make_sheet([1.25] * count, (1.0,) * len(sides), row_gap=0.3, column_gap=0.42)
    for line, (row, name) in zip(sheet.axes, shown, strict=True):
        channel = fitted.record[name]
        unit, valid = display_unit(channel.unit), channel.valid
        aside = valid & ~fitted.used[row]
        limit = 0.0
        for panel, (when, residuals) in zip(line, sides, strict=True):
            values = unit.factor * residuals[row]
            _few_ticks(panel)
            _band(panel, unit.factor * noise.get(name, 0.0))
            panel.plot(
                fitted.record.time[valid],
                values[valid],
                color=BLUE,
                marker=".",
                markersize=2.5,
                markeredgewidth=0.0,
                linestyle="none",
                label="residual",
            )
            if np.any(aside):
                ring: dict[str, Any] = {"marker": "o", "markersize": 5.5, "markerfacecolor": "none", "markeredgewidth": 0.9, "linestyle": "none"}
                panel.plot(fitted.record.time[aside], values[aside], color=VERMILION, label="set aside", **ring)
            limit = max(limit, float(np.abs(values[valid]).max(initial=0.0)))
            rms = float(np.sqrt(np.mean(values[valid & fitted.used[row]] ** 2))) if np.any(valid & fitted.used[row]) else 0.0
            caption(panel, f"{when}: rms {rms:.3g} {unit.text}")
        for panel in line:
            panel.set_ylim(-1.08 * limit or -1.0, 1.08 * limit or 1.0)
        for panel in line[1:]:
            panel.tick_params(labelleft=False)
        y_label(line[0], axis_label(name, unit))
    for panel in sheet.axes[-1]:
        time_axis(panel)
    return finish(sheet, title, head=0.24)


def figure_held_out(prediction: Prediction, noise: Mapping[str, float], title: str = "") -> Figure:
    """The predicted record: measured, predicted with and without the effects, and below what each leaves; angles in degrees.

    One prediction where nothing was added.
    """
    same = np.array_equal(prediction.after, prediction.before)
    both = (("predicted after", prediction.after), ("predicted before", prediction.before))
    shown = (("predicted", prediction.before),) if same else both
    responses = [Response(label, dict(zip(prediction.channels, values, strict=True))) for label, values in shown]
    figure = figure_fit(prediction.record, responses, None, title, noise)
    for panel in figure.axes:
        _few_ticks(panel)
    return figure


def figure_evidence(candidates: Sequence[Candidate], claimed: Sequence[str] = (), title: str = "") -> Figure:
    """The best candidates of each round by their gain of the log likelihood, on a logarithmic scale.

    Full fits are filled, projected scores of the screening are open; what the verdict claims is blue. A round that looked at
    several sets has a panel for each; the first ``PANELS`` are drawn.
    """
    nodes = list(dict.fromkeys((c.round, c.within) for c in candidates))[:PANELS]
    groups = [_best([c for c in candidates if (c.round, c.within) == node]) for node in nodes]
    labels = [plain(c.name) for group in groups for c in group]
    left = min(2.6, max([1.0, *(text_width(label, TICK_SIZE) + 0.25 for label in labels)]))
    sheet = make_sheet([0.21 * len(group) + 0.12 for group in groups] or [1.0], row_gap=0.34, left=left, right=0.6)
    largest = max((c.gain for c in candidates), default=1.0)
    for panel, node, group in zip(sheet.panels, nodes, groups, strict=False):
        panel.set_xscale("log")
        for place, c in enumerate(reversed(group)):
            colour = BLUE if c.name in claimed else GREY
            length = max(c.gain, LEAST)
            panel.barh(place, length - LEAST, left=LEAST, height=0.68, color=colour if c.fitted else "white", edgecolor=colour, linewidth=0.9)
            remarks = (*(() if c.plausible else ("implausible",)), *(() if c.fitted else ("screened",)))
            text = f"{c.gain:.0f}" if c.gain >= 99.5 else f"{c.gain:.3g}"
            text += f" {', '.join(remarks)}" if remarks else ""
            panel.annotate(text, (length, place), xytext=(3, 0), textcoords="offset points", va="center", fontsize=TICK_SIZE - 1)
        panel.set_yticks(range(len(group)), [plain(c.name) for c in reversed(group)])
        panel.tick_params(axis="y", length=0)
        panel.grid(False, axis="y")
        panel.set_ylim(-0.55, len(group) - 0.45)
        panel.set_xlim(LEAST, 4.0 * max(largest, 10.0 * LEAST))
        _decades(panel.xaxis)
        within = f", beside {' + '.join(node[1])}" if node[1] else ", beside the declared model"
        caption(panel, plain(f"round {node[0]}{within}"))
    if groups:
        sheet.panels[-1].set_xlabel("gain of the log likelihood", fontsize=LABEL_SIZE)
    else:
        caption(sheet.panels[0], "no candidate was tried")
    return finish(sheet, title, head=0.22, legend=False)


def figure_derivatives(before: Mapping[str, Quantity], after: Mapping[str, Quantity], title: str = "") -> Figure:
    """Derivatives with the declared model and with the effects, in per cent of the former; bars are two standard deviations.

    One that was not determined before, by three standard deviations, is shown in per cent of these three.
    """
    names = [name for name in before if name in after]
    n = len(names)
    labels = [symbol(name) for name in names]
    left = min(2.0, max([0.7, *(text_width(label) + 0.25 for label in labels)]))
    columns = [[value_text(side[name].value, side[name].std).replace("+-", "±").replace("-", "−") for name in names] for side in (before, after)]
    widths = [max([0.5, *(text_width(text, TICK_SIZE) for text in texts)]) + 0.12 for texts in columns]
    sheet = make_sheet([0.34 * n + 0.1], count=min(n, 1), left=left, right=sum(widths) + 0.2)
    panel = sheet.panels[0]
    panel.axvline(0.0, **ZERO)
    inner = WIDTH - sheet.left - sheet.right
    rows, start = n - 1.0 - np.arange(n), np.array([before[name].value for name in names])
    base = np.maximum(np.abs(start), 3.0 * np.array([before[name].std for name in names]))
    base = np.where(base > 0.0, base, 1.0)
    reach, right = 5.0, 0.0
    for side, offset, marker, colour, label, texts, width in (
        (before, 0.16, "s", VERMILION, "before", columns[0], widths[0]),
        (after, -0.16, "o", BLUE, "after", columns[1], widths[1]),
    ):
        x = 100.0 * (np.array([side[name].value for name in names]) - start) / base
        bars = 200.0 * np.array([side[name].std for name in names]) / base
        panel.errorbar(x, rows + offset, xerr=bars, fmt=marker, color=colour, markersize=4.5, linewidth=1.2, capsize=2.5, label=f"{label} ±2σ")
        reach = max(reach, float(np.max(np.abs(x) + np.minimum(bars, 100.0), initial=0.0)))
        right += width
        look: dict[str, Any] = {"transform": panel.get_yaxis_transform(), "ha": "right", "fontsize": TICK_SIZE, "color": colour}
        panel.text(1.0 + right / inner, n - 0.35, label, va="bottom", **look)
        for y, text in zip(rows.tolist(), texts, strict=True):
            panel.text(1.0 + right / inner, y, text, va="center", **look)
    panel.set_yticks(range(n), labels[::-1])
    panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
    panel.set_ylim(-0.55, n - 0.45)
    panel.set_xlim(-1.08 * reach, 1.08 * reach)
    panel.set_xlabel("change of the derivative (% of its value before)", fontsize=LABEL_SIZE)
    vague = [label for label, wide in zip(labels, base > np.abs(start), strict=True) if wide]
    if vague:
        caption(panel, f"{', '.join(vague)}: % of 3σ")
    return finish(sheet, title, head=0.24)


def figure_spectra(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Power spectra of the residuals before and after over that of the noise: white noise of the right size lies at one. One where nothing was added.

    Periodograms under a Hann window, averaged over neighbouring frequencies. Samples missing or set aside count as zero, uneven
    sampling is read as even at its mean interval.
    """
    shown = _measured(fitted)
    sheet = make_sheet([1.25] * len(shown), row_gap=0.3)
    interval = float(fitted.record.time[-1] - fitted.record.time[0]) / (len(fitted.record) - 1)
    for panel, (row, name) in zip(sheet.panels, shown, strict=True):
        used = fitted.used[row] & fitted.record[name].valid
        panel.axhline(1.0, color=BLACK, linewidth=0.8, linestyle=(0, (4, 2)), label="white noise")
        both = ((fitted.before[row], VERMILION, "--", "before"), (fitted.after[row], BLUE, "-", "after"))
        alone = ((fitted.before[row], BLUE, "-", "residual"),)
        for residual, colour, style, label in alone if np.array_equal(fitted.before, fitted.after) else both:
            hertz, power = spectrum(np.where(used, residual, 0.0), interval, int(np.count_nonzero(used)))
            panel.plot(hertz, power / (noise.get(name) or 1.0) ** 2, color=colour, linestyle=style, linewidth=1.2, label=label)
        panel.set_yscale("log")
        panel.set_xscale("log")
        bottom, top = panel.get_ylim()
        panel.set_ylim(max(bottom, 1e-2), min(max(top, 10.0), 1e6))
        _decades(panel.xaxis, (1.0, 2.0, 5.0))
        _decades(panel.yaxis)
        y_label(panel, f"{symbol(name)} power / noise")
    sheet.panels[-1].set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.12)


def spectrum(residual: np.ndarray, interval: float, used: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and power of a series ``(N,)`` of which ``used`` samples are not zero by default; white noise of variance s2 gives s2."""
    n = len(residual)
    window = np.hanning(n)
    share = float(np.sum(window**2)) * max(used, 1) / n
    power = np.abs(np.fft.rfft(residual * window)) ** 2 / share
    hertz = np.fft.rfftfreq(n, interval)
    width = 1 if n < 100 else 5
    smooth = np.convolve(power[1:], np.ones(width) / width, mode="valid")
    return hertz[1 + width // 2 : 1 + width // 2 + len(smooth)], smooth


def _best(group: Sequence[Candidate]) -> list[Candidate]:
    """The candidates of a round that gain most, each name once."""
    ranked = sorted(group, key=lambda c: (-c.gain, c.name))
    first = {c.name: c for c in reversed(ranked)}
    return [c for c in ranked if first[c.name] is c][:BARS]


def _same(fitted: FittedRecord, rows: Sequence[int]) -> bool:
    """Whether before and after differ by less than a figure can show: nothing was added."""
    change, size = np.abs(fitted.before - fitted.after)[rows].max(axis=1, initial=0.0), np.abs(fitted.after)[rows].max(axis=1, initial=0.0)
    return bool(np.all(change <= 5e-3 * size))


def _measured(fitted: FittedRecord) -> list[tuple[int, str]]:
    """Row and name of the channels that this record has; others of the fit may lack it."""
    return [(row, name) for row, name in enumerate(fitted.channels) if name in fitted.record.output_names]


def _band(panel: Axes, sigma: float) -> None:
    if sigma > 0.0:
        panel.axhspan(-2.0 * sigma, 2.0 * sigma, color=SKY, alpha=0.25, linewidth=0, label=_BAND)
    panel.axhline(0.0, **ZERO)


def _few_ticks(panel: Axes) -> None:
    """Ticks are most of what drawing costs, and a narrow panel has no room for many."""
    for axis, bins in ((panel.xaxis, 5), (panel.yaxis, 3)):
        axis.set_major_locator(MaxNLocator(nbins=bins, steps=[1, 2, 2.5, 5, 10]))


def _decades(axis: Axis, multiples: Sequence[float] = (1.0,)) -> None:
    """Plain numbers at multiples of the powers of ten, nothing between."""
    axis.set_major_locator(LogLocator(subs=multiples, numticks=9))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, position: f"{value:g}"))
