"""Figures of a diagnosis: derivatives, evidence, residuals and their spectra, values by record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator, NullLocator

from ident.tracing.diagnosis import Candidate, FittedRecord, Prediction, Quantity
from scenarios.plots.display import (
    MEASURED_DATA,
    NamedEffects,
    Replicated,
    axis_label,
    display_unit,
    is_alternative,
    plain,
    reason,
    symbol,
)
from scenarios.plots.signals import Response, figure_fit
from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREY,
    LABEL_SIZE,
    LIGHT,
    SKY,
    TICK_SIZE,
    VERMILION,
    WIDTH,
    ZERO,
    Sheet,
    caption,
    decades,
    finish,
    folded,
    make_sheet,
    method_style,
    text_width,
    time_axis,
    y_label,
)
from scenarios.report.quantities import displayed, value_text

# ---- Derivatives before and after


def figure_derivatives(
    before: Mapping[str, Quantity], after: Mapping[str, Quantity], title: str = ""
) -> Figure:
    """Derivatives with the declared model and with the effects, in per cent of the former; bars are
    two standard deviations.

    Where nothing changed there is one of them. One that was not determined before, by three
    standard deviations, is shown in per cent of these three.
    """
    names = [name for name in before if name in after]
    n = len(names)
    labels = [symbol(name) for name in names]
    left = min(2.0, max([0.7, *(text_width(label) + 0.25 for label in labels)]))
    columns = [
        [
            value_text(side[name].value, side[name].std).replace("+-", "±").replace("-", "−")
            for name in names
        ]
        for side in (before, after)
    ]
    same = columns[0] == columns[1]
    widths = [
        max([0.5, *(text_width(text, TICK_SIZE) for text in texts)]) + 0.12 for texts in columns
    ]
    sheet = make_sheet(
        [0.34 * n + 0.1],
        count=min(n, 1),
        left=left,
        right=(widths[1] if same else sum(widths)) + 0.2,
    )
    panel = sheet.panels[0]
    panel.axvline(0.0, **ZERO)
    inner = WIDTH - sheet.left - sheet.right
    rows, start = n - 1.0 - np.arange(n), np.array([before[name].value for name in names])
    base = np.maximum(np.abs(start), 3.0 * np.array([before[name].std for name in names]))
    base = np.where(base > 0.0, base, 1.0)
    reach, right = 5.0, 0.0
    both = (
        (before, 0.16, "s", VERMILION, "before", columns[0], widths[0]),
        (after, -0.16, "o", BLUE, "after", columns[1], widths[1]),
    )
    alone = ((after, 0.0, "o", BLUE, "estimate", columns[1], widths[1]),)
    for side, offset, marker, colour, label, texts, width in alone if same else both:
        x = 100.0 * (np.array([side[name].value for name in names]) - start) / base
        bars = 200.0 * np.array([side[name].std for name in names]) / base
        panel.errorbar(
            x,
            rows + offset,
            xerr=bars,
            fmt=marker,
            color=colour,
            markersize=4.5,
            linewidth=1.2,
            capsize=2.5,
            label=f"{label} ±2σ",
        )
        reach = max(reach, float(np.max(np.abs(x) + np.minimum(bars, 100.0), initial=0.0)))
        right += width
        look: dict[str, Any] = {
            "transform": panel.get_yaxis_transform(),
            "ha": "right",
            "fontsize": TICK_SIZE,
            "color": colour,
        }
        panel.text(1.0 + right / inner, n - 0.35, label, va="bottom", **look)
        for y, text in zip(rows.tolist(), texts, strict=True):
            panel.text(1.0 + right / inner, y, text, va="center", **look)
    panel.set_yticks(range(n), labels[::-1])
    panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
    panel.set_ylim(-0.55, n - 0.45)
    panel.set_xlim(-1.08 * reach, 1.08 * reach)
    panel.set_xlabel(
        "uncertainty of the derivative (% of its value)"
        if same
        else "change of the derivative (% of its value before)",
        fontsize=LABEL_SIZE,
    )
    vague = [label for label, wide in zip(labels, base > np.abs(start), strict=True) if wide]
    if vague:
        caption(panel, f"{', '.join(vague)}: in % of 3σ, not determined before")
    return finish(sheet, title, head=0.24)


# ---- Why the winner won

ROWS = {1: 12, 2: 8}  # candidates of a round, by the number of rounds; 6 of more
SPARE, PANELS = 4, 3  # candidates of a round after which nothing was needed; rounds
# inches a candidate, inches for a number, size of text
_ROW, _NUMBER, _SMALL = 0.2, 0.56, TICK_SIZE - 0.5
_TITLE_LEFT = 0.15  # inches
NOTHING = NamedEffects()


@dataclass(frozen=True)
class _Round:
    """The candidates of one round that are shown, best first, and how many are not."""

    number: int
    within: tuple[str, ...]
    shown: tuple[Candidate, ...]
    others: int


def figure_evidence(
    candidates: Sequence[Candidate], standing: NamedEffects = NOTHING, title: str = ""
) -> Figure:
    """A panel a round: how far each candidate's log posterior odds lie below the best one's, as
    numbers, and why it was not chosen.

    Filled bars were fitted, open ones are linearised. The rounds are those that led to what stands,
    ``PANELS`` at most.
    """
    rounds = _rounds(candidates, standing)
    if not rounds:
        sheet = make_sheet([1.0])
        sheet.panels[0].set_title("no candidate was tried", fontsize=TICK_SIZE, loc="left")
        return finish(sheet, title, legend=False)
    words = [[reason(c, standing, each.shown) for c in each.shown] for each in rounds]
    left = min(
        1.85,
        max(
            [
                1.0,
                *(text_width(plain(c.name), _SMALL) + 0.25 for each in rounds for c in each.shown),
            ]
        ),
    )
    right = (
        max([0.7, *(text_width(text, _SMALL) for some in words for text in some)]) + 0.1 + _NUMBER
    )
    heights = [_ROW * (len(each.shown) + bool(each.others)) + 0.1 for each in rounds]
    sheet = make_sheet(heights, row_gap=0.42, left=left, right=right, share_x=False)
    scale = WIDTH - left - right
    for panel, each, some in zip(sheet.panels, rounds, words, strict=True):
        _draw_odds(panel, each, standing)
        _head(panel, each, standing, (_TITLE_LEFT - left) / scale)
        _column(
            panel, [_odds(c) for c in each.shown], "ln odds" if panel is sheet.panels[0] else ""
        )
        for y, (c, text) in zip(_places(each), zip(each.shown, some, strict=True), strict=True):
            panel.annotate(
                text,
                (1.0, y),
                **_at(_NUMBER + 0.08, "left"),
                va="center",
                color=BLUE if c.name in standing.claimed else BLACK,
            )
    _labels(sheet, rounds)
    return finish(sheet, title, head=0.3)


def _rounds(candidates: Sequence[Candidate], standing: NamedEffects) -> list[_Round]:
    """The rounds on the way to what stands; without any the first ones."""
    nodes = list(dict.fromkeys((len(c.within), c.within) for c in candidates))
    path = [node for node in nodes if set(node[1]) <= set(standing.named)] or nodes
    kept = sorted(path, key=lambda node: node[0])[:PANELS]
    most = ROWS.get(len(kept), 6)

    def rows(within: tuple[str, ...]) -> int:
        return SPARE if standing.complete(within) else most

    return [
        _round([c for c in candidates if c.within == within], standing, rows(within))
        for _, within in kept
    ]


def _round(group: Sequence[Candidate], standing: NamedEffects, most: int) -> _Round:
    ranked = sorted(group, key=lambda c: (not c.fitted, -c.weight, c.name))
    best = {c.name: c for c in reversed(ranked)}  # as fitted, where it was
    order = sorted(best.values(), key=lambda c: (-c.weight, c.name))
    first = [c for c in order if c.name in standing.named]
    kept = {c.name for c in [*first, *(c for c in order if c not in first)][:most]}
    return _Round(
        group[0].round,
        group[0].within,
        tuple(c for c in order if c.name in kept),
        len(order) - len(kept),
    )


def _places(each: _Round) -> list[float]:
    return [float(len(each.shown) - 1 - place) for place in range(len(each.shown))]


def _colour(c: Candidate, standing: NamedEffects) -> str:
    return (
        BLUE
        if c.name in standing.claimed
        else SKY
        if is_alternative(c, standing) or c.name in standing.hints
        else GREY
    )


def _draw_odds(panel: Axes, each: _Round, standing: NamedEffects) -> None:
    """Bars from the left edge to how far the odds lie below the best, on a scale that is linear up
    to one and logarithmic from there.
    """
    best = max(c.weight for c in each.shown)
    behind = [best - c.weight for c in each.shown]
    edge = -max(2.0 * max(behind), 10.0)
    panel.set_xscale("symlog", linthresh=1.0, linscale=0.6)
    for y, c, below in zip(_places(each), each.shown, behind, strict=True):
        colour = _colour(c, standing)
        what = (
            "claimed"
            if colour == BLUE
            else "alternative or hint"
            if colour == SKY
            else "fitted"
            if c.fitted
            else "linearised"
        )
        panel.barh(
            y,
            -below - edge,
            left=edge,
            height=0.66,
            color=colour if c.fitted else "white",
            edgecolor=colour,
            linewidth=0.9,
            label=what,
        )
    panel.axvline(0.0, **ZERO)
    panel.set_xlim(edge, 0.6)
    powers = [-(10.0**power) for power in range(int(np.log10(-edge)), -1, -1)]
    panel.xaxis.set_major_locator(FixedLocator([*powers[:: 1 if len(powers) < 4 else 2], 0.0]))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_major_formatter(
        FuncFormatter(lambda value, position: f"{value:.0f}".replace("-", "−"))
    )
    panel.set_yticks(_places(each), [plain(c.name) for c in each.shown], fontsize=_SMALL)


def _head(panel: Axes, each: _Round, standing: NamedEffects, x: float) -> None:
    """What the round began from, above the names, and below them how many others there are."""
    beside = f"beside {' + '.join(each.within)}" if each.within else "beside the declared model"
    done = (
        "; nothing more was needed"
        if standing.complete(each.within) and each.within
        else "; nothing was needed"
        if standing.complete(())
        else ""
    )
    panel.set_title(
        plain(f"round {each.number}, {beside}{done}"),
        fontsize=TICK_SIZE,
        loc="left",
        x=x,
        pad=4.5,
        y=1.0,
    )
    if each.others:
        panel.annotate(
            f"{each.others} others below",
            (0.0, -1.0),
            **{**_at(-0.06), "xycoords": ("axes fraction", "data")},
            va="center",
            color=GREY,
        )


def _column(panel: Axes, texts: Sequence[str], heading: str) -> None:
    """Numbers at the right of a panel, one a row from the top, with a heading."""
    for place, text in enumerate(reversed(texts)):
        panel.annotate(text, (1.0, place), **_at(_NUMBER), va="center")
    if any(texts):
        panel.annotate(heading, (1.0, len(texts) - 0.45), **_at(_NUMBER), va="bottom")


def _at(inches: float, side: str = "right") -> dict[str, Any]:
    """A small text in a row of a panel, so many inches right of its edge."""
    place = {
        "xycoords": ("axes fraction", "data"),
        "xytext": (72.0 * inches, 0.0),
        "textcoords": "offset points",
    }
    return {**place, "ha": side, "fontsize": _SMALL, "annotation_clip": False}


def _labels(sheet: Sheet, rounds: Sequence[_Round]) -> None:
    for panel, each in zip(sheet.panels, rounds, strict=True):
        panel.tick_params(axis="y", length=0)
        panel.grid(False, axis="y")
        panel.set_ylim(-1.55 if each.others else -0.55, len(each.shown) - 0.45)
        panel.spines["left"].set_color(LIGHT)
    sheet.panels[-1].set_xlabel("log posterior odds below the best", fontsize=LABEL_SIZE)


def _odds(c: Candidate) -> str:
    return (f"{c.weight:.0f}" if abs(c.weight) >= 99.5 else f"{c.weight:.1f}").replace("-", "−")


# ---- The parameters of effects from each record by itself

PARAMETERS = 4  # of one effect that are drawn


def figure_replication(effects: Sequence[Replicated], title: str = "") -> Figure:
    """A panel for each parameter of each effect: its value from each record with two standard
    deviations, and from all fitted ones as a band.

    Angles in degrees. A record without the parameter has no point.
    """
    shown = [
        (effect, name) for effect in effects for name in list(effect.by_record[0])[:PARAMETERS]
    ]
    sheet = make_sheet([1.2] * len(shown), row_gap=0.32, left=0.8)
    for panel, (effect, name) in zip(sheet.panels, shown, strict=True):
        places = [place for place, each in enumerate(effect.by_record) if name in each]
        values, stds = _shown([effect.by_record[place][name] for place in places], name)
        if name in effect.together:
            (middle,), (std,) = _shown([effect.together[name]], name)
            panel.axhspan(
                middle - 2.0 * std,
                middle + 2.0 * std,
                color=SKY,
                alpha=0.3,
                linewidth=0,
                label="fitted records together ±2σ",
            )
            panel.axhline(middle, color=SKY, linewidth=1.0)
        panel.errorbar(
            places,
            values,
            yerr=2.0 * stds,
            fmt="o",
            color=BLUE,
            markersize=4.5,
            linewidth=1.2,
            capsize=2.5,
            label="one record ±2σ",
        )
        panel.set_xlim(-0.5, len(effect.by_record) - 0.5)
        room = 5.9 / len(effect.by_record)
        panel.set_xticks(
            range(len(effect.by_record)),
            ["\n".join(folded(plain(label), room, TICK_SIZE)) for label in effect.records],
        )
        text = display_unit(effect.by_record[0][name].unit, name).text
        y_label(panel, plain(f"{name.replace('_', ' ')} ({text})"))
        caption(panel, plain(effect.name))
    return finish(sheet, title, head=0.22, bottom=0.45)


def _shown(quantities: Sequence[Quantity], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard deviations in the units of a figure; a sigma that says nothing is as long
    as the value.
    """
    rows = np.array(
        [displayed(quantity, name)[:2] for quantity in quantities], dtype=float
    ).reshape(-1, 2)
    values, stds = rows[:, 0], rows[:, 1]
    return values, np.where(
        np.isfinite(stds) & (stds >= 0.0),
        np.minimum(stds, 1e3 * np.maximum(np.abs(values), 1e-12)),
        np.abs(values),
    )


# ---- Residuals and their spectra before and after, and the held-out record

_BAND = "±2σ of the sensor noise"


def figure_residuals(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Residuals of the fitted record against time, left with the declared model, right with the
    effects, one scale for both.

    Where nothing was added there is one column. ``noise`` is the noise's standard deviation by
    channel. Samples that were set aside are ringed; angles in degrees.
    """
    shown = _measured(fitted)
    count, same = len(shown), _same(fitted, [row for row, _ in shown])
    sides = (
        (("residual", fitted.after),)
        if same
        else (("before", fitted.before), ("after", fitted.after))
    )
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
                ring: dict[str, Any] = {
                    "marker": "o",
                    "markersize": 5.5,
                    "markerfacecolor": "none",
                    "markeredgewidth": 0.9,
                    "linestyle": "none",
                }
                panel.plot(
                    fitted.record.time[aside],
                    values[aside],
                    color=VERMILION,
                    label="set aside",
                    **ring,
                )
            limit = max(limit, float(np.abs(values[valid]).max(initial=0.0)))
            rms = (
                float(np.sqrt(np.mean(values[valid & fitted.used[row]] ** 2)))
                if np.any(valid & fitted.used[row])
                else 0.0
            )
            caption(panel, f"{when}: rms {rms:#.3g} {unit.text}")
        for panel in line:
            panel.set_ylim(-1.08 * limit or -1.0, 1.08 * limit or 1.0)
        for panel in line[1:]:
            panel.tick_params(labelleft=False)
        y_label(line[0], axis_label(name, unit))
    for panel in sheet.axes[-1]:
        time_axis(panel)
    return finish(sheet, title, head=0.24)


def figure_held_out(
    prediction: Prediction, noise: Mapping[str, float], title: str = "", data: str = MEASURED_DATA
) -> Figure:
    """The predicted record: its inputs and airspeed, its other samples, called ``data``, predicted
    with and without the effects, and below what each leaves; angles in degrees.

    One prediction where nothing was added.
    """
    same = np.array_equal(prediction.after, prediction.before)
    both = (("predicted after", prediction.after), ("predicted before", prediction.before))
    shown = (("predicted", prediction.before),) if same else both
    responses = [
        Response(label, dict(zip(prediction.channels, values, strict=True)))
        for label, values in shown
    ]
    record = prediction.record
    speed = [
        c for c in record.outputs if c.name == "airspeed" and c.name not in prediction.channels
    ]
    figure = figure_fit(record, responses, None, title, noise, data, above=[*record.inputs, *speed])
    for panel in figure.axes:
        _few_ticks(panel)
    return figure


def figure_spectra(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Power spectra of the residuals before and after over that of the noise: white noise of the
    right size lies at one. One where nothing was added.

    Periodograms under a Hann window, averaged over neighbouring frequencies. Samples missing or set
    aside count as zero, uneven sampling is read as even at its mean interval.
    """
    shown = _measured(fitted)
    sheet = make_sheet([1.25] * len(shown), row_gap=0.3)
    same = _same(fitted, [row for row, _ in shown])
    interval = float(fitted.record.time[-1] - fitted.record.time[0]) / (len(fitted.record) - 1)
    for panel, (row, name) in zip(sheet.panels, shown, strict=True):
        used = fitted.used[row] & fitted.record[name].valid
        panel.axhline(1.0, color=BLACK, linewidth=0.8, linestyle=(0, (4, 2)), label="white noise")
        both = ((fitted.before[row], "before", 1), (fitted.after[row], "after", 0))
        alone = ((fitted.after[row], "residual", 0),)
        lines = alone if same else both
        for residual, label, order in lines:
            hertz, power = spectrum(
                np.where(used, residual, 0.0), interval, int(np.count_nonzero(used))
            )
            panel.plot(
                hertz,
                power / (noise.get(name) or 1.0) ** 2,
                label=label,
                **method_style(order, alone=len(lines) == 1),
            )
        panel.set_yscale("log")
        panel.set_xscale("log")
        bottom, top = panel.get_ylim()
        panel.set_ylim(max(bottom, 1e-2), min(max(top, 10.0), 1e6))
        decades(panel.xaxis, (1.0, 2.0, 5.0))
        decades(panel.yaxis)
        y_label(panel, f"{symbol(name)}: power / noise (–)")
    sheet.panels[-1].set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.12)


def spectrum(residual: np.ndarray, interval: float, used: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (Hz) and power of a series ``(N,)`` of which ``used`` samples are not zero by
    default; white noise of variance s2 gives s2.
    """
    n = len(residual)
    window = np.hanning(n)
    share = float(np.sum(window**2)) * max(used, 1) / n
    power = np.abs(np.fft.rfft(residual * window)) ** 2 / share
    hertz = np.fft.rfftfreq(n, interval)
    width = 1 if n < 100 else 5
    smooth = np.convolve(power[1:], np.ones(width) / width, mode="valid")
    return hertz[1 + width // 2 : 1 + width // 2 + len(smooth)], smooth


def _same(fitted: FittedRecord, rows: Sequence[int]) -> bool:
    """Whether before and after differ by less than a figure can show: nothing was added."""
    change, size = (
        np.abs(fitted.before - fitted.after)[rows].max(axis=1, initial=0.0),
        np.abs(fitted.after)[rows].max(axis=1, initial=0.0),
    )
    return bool(np.all(change <= 5e-3 * size))


def _measured(fitted: FittedRecord) -> list[tuple[int, str]]:
    """Row and name of the channels that this record has; others of the fit may lack it."""
    return [
        (row, name)
        for row, name in enumerate(fitted.channels)
        if name in fitted.record.output_names
    ]


def _band(panel: Axes, sigma: float) -> None:
    if sigma > 0.0:
        panel.axhspan(-2.0 * sigma, 2.0 * sigma, color=SKY, alpha=0.25, linewidth=0, label=_BAND)
    panel.axhline(0.0, **ZERO)


def _few_ticks(panel: Axes) -> None:
    """Ticks are most of what drawing costs, and a narrow panel has no room for many."""
    for axis, bins in ((panel.xaxis, 5), (panel.yaxis, 3)):
        axis.set_major_locator(MaxNLocator(nbins=bins, steps=[1, 2, 2.5, 5, 10]))
