"""Figures of a diagnosis: evidence, parameters, derivatives, residuals, held-out records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ident.tracing.diagnosis import Candidate, FittedRecord, Prediction, Quantity
from scenarios.plots.display import (
    COHERENCE_SEGMENTS,
    MEASURED_DATA,
    NamedEffects,
    Replicated,
    axis_label,
    coherence_level,
    display_unit,
    escaped_dollars,
    input_coherence,
    is_alternative,
    reason,
    spectrum,
    symbol,
)
from scenarios.plots.signals import MethodOutputs, context, figure_fit
from scenarios.plots.style import (
    BLACK,
    BLUE,
    DOTS,
    GREY,
    LABEL_SIZE,
    LIGHT,
    ORANGE,
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
from scenarios.report.quantities import displayed, listed, value_text

# ---- Derivatives before and after

LEAST_SIGMAS = 3.0  # a smaller derivative is shown in per cent of so many of its sigmas


def figure_derivatives(
    before: Mapping[str, Quantity], after: Mapping[str, Quantity], title: str = ""
) -> Figure:
    """Plot derivatives of the declared model and of the model with effects, in % of the former.

    Bars are two standard deviations. A derivative below ``LEAST_SIGMAS`` of its sigmas is shown in
    % of these, which a line above says. Without effects, only the declared model is shown.
    """
    names = [name for name in before if name in after]
    n = len(names)
    labels = [symbol(name) for name in names]
    left = min(2.0, max([0.7, *(text_width(label) + 0.25 for label in labels)]))
    before_texts, after_texts = (
        [
            value_text(model[name].value, model[name].std).replace("+-", "±").replace("-", "−")
            for name in names
        ]
        for model in (before, after)
    )
    same = before_texts == after_texts
    models: list[tuple[Mapping[str, Quantity], float, str, str, str, list[str]]]
    models = [
        (before, 0.16, "s", VERMILION, "before", before_texts),
        (after, -0.16, "o", BLUE, "after", after_texts),
    ]
    if same:
        models = [(after, 0.0, "o", BLUE, "estimate", after_texts)]
    widths = [
        max([0.5, *(text_width(text, TICK_SIZE) for text in texts)]) + 0.12 for *_, texts in models
    ]
    sheet = make_sheet([0.34 * n + 0.1], count=min(n, 1), left=left, right=sum(widths) + 0.2)
    panel = sheet.panels[0]
    panel.axvline(0.0, **ZERO)
    panel_width = WIDTH - sheet.left - sheet.right
    rows, start = n - 1.0 - np.arange(n), np.array([before[name].value for name in names])
    sigmas = np.array([before[name].std for name in names])
    base = np.maximum(np.abs(start), LEAST_SIGMAS * sigmas)
    base = np.where(base > 0.0, base, 1.0)
    largest, right = 5.0, 0.0
    for (model, offset, marker, colour, label, texts), width in zip(models, widths, strict=True):
        x = 100.0 * (np.array([model[name].value for name in names]) - start) / base
        bars = 200.0 * np.array([model[name].std for name in names]) / base
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
        largest = max(largest, float(np.max(np.abs(x) + np.minimum(bars, 100.0), initial=0.0)))
        right += width
        style: dict[str, Any] = {
            "transform": panel.get_yaxis_transform(),
            "ha": "right",
            "fontsize": TICK_SIZE,
            "color": colour,
        }
        panel.text(1.0 + right / panel_width, n - 0.35, label, va="bottom", **style)
        for y, text in zip(rows.tolist(), texts, strict=True):
            panel.text(1.0 + right / panel_width, y, text, va="center", **style)
    panel.set_yticks(range(n), labels[::-1])
    panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
    panel.set_ylim(-0.55, n - 0.45)
    panel.set_xlim(-1.08 * largest, 1.08 * largest)
    x_label = "change of the derivative (% of its value before)"
    if same:
        x_label = "uncertainty of the derivative (% of its value)"
    panel.set_xlabel(x_label, fontsize=LABEL_SIZE)
    uncertain = [label for label, wide in zip(labels, base > np.abs(start), strict=True) if wide]
    lines = folded(_of_sigmas(uncertain, declared=same), panel_width) if uncertain else []
    caption(panel, "\n".join(lines))
    return finish(sheet, title, head=0.24 + 0.16 * max(len(lines) - 1, 0))


def _of_sigmas(names: Sequence[str], *, declared: bool) -> str:
    """Return the sentence on derivatives that are drawn in per cent of three sigmas."""
    several = len(names) > 1
    when = "" if declared else " before"
    are, they, were = ("are", "they", "were") if several else ("is", "it", "was")
    return (
        f"{listed(names)} {are} drawn in per cent of three sigmas, because {they} {were} not "
        f"determined{when}"
    )


# ---- Evidence of the candidates

ROWS = {1: 12, 2: 8}  # number of drawn rounds -> candidates of each round
ROWS_OF_MANY_ROUNDS = 6  # candidates of each round if there are more rounds
CANDIDATES_OF_LAST_ROUND = 4  # candidates of a round that added no effect
MOST_PANELS = 3  # rounds that are drawn
_ROW_HEIGHT = 0.2  # inches, height of a candidate
_NUMBER_WIDTH = 0.56  # inches, width of a number
_SMALL_TEXT_SIZE = TICK_SIZE - 0.5  # points, size of small text
_TITLE_LEFT = 0.15  # inches from the left edge of the figure to the titles
NOTHING = NamedEffects()


@dataclass(frozen=True)
class _Round:
    """Drawn candidates of one round.

    Attributes
    ----------
    number : number of the round.
    within : effects that were already in the model.
    shown : drawn candidates, the best first.
    others : number of candidates that are not drawn.
    """

    number: int
    within: tuple[str, ...]
    shown: tuple[Candidate, ...]
    others: int


def figure_evidence(
    candidates: Sequence[Candidate], standing: NamedEffects = NOTHING, title: str = ""
) -> Figure:
    """Plot the log posterior odds of each candidate, one panel per round, and reasons against it.

    Filled bars are from fits, open bars from linearisation. The heading of a panel names the set
    that its candidates are added to. Up to ``MOST_PANELS`` rounds that led to the accepted effects
    are drawn.
    """
    rounds = _rounds(candidates, standing)
    if not rounds:
        sheet = make_sheet([1.0])
        sheet.panels[0].set_title("no candidate was tried", fontsize=TICK_SIZE, loc="left")
        return finish(sheet, title, legend=False)
    names = [escaped_dollars(item.name) for drawn in rounds for item in drawn.shown]
    reasons = [[reason(item, standing, drawn.shown) for item in drawn.shown] for drawn in rounds]
    name_widths = [text_width(name, _SMALL_TEXT_SIZE) + 0.25 for name in names]
    reason_widths = [text_width(text, _SMALL_TEXT_SIZE) for texts in reasons for text in texts]
    left = min(1.85, max([1.0, *name_widths]))
    right = max([0.7, *reason_widths]) + 0.1 + _NUMBER_WIDTH
    heights = [_ROW_HEIGHT * (len(drawn.shown) + bool(drawn.others)) + 0.1 for drawn in rounds]
    sheet = make_sheet(heights, row_gap=0.42, left=left, right=right, share_x=False)
    panel_width = WIDTH - left - right
    for panel, drawn, texts in zip(sheet.panels, rounds, reasons, strict=True):
        _draw_odds(panel, drawn, standing)
        _write_title(panel, drawn, standing, (_TITLE_LEFT - left) / panel_width)
        heading = "log odds" if panel is sheet.panels[0] else ""
        _write_column(panel, [_odds_text(item) for item in drawn.shown], heading)
        for y, item, text in zip(_places(drawn), drawn.shown, texts, strict=True):
            panel.annotate(
                text,
                (1.0, y),
                **_text_style(_NUMBER_WIDTH + 0.08, "left"),
                va="center",
                color=BLUE if item.name in standing.claimed else BLACK,
            )
    _finish_axes(sheet, rounds)
    return finish(sheet, title, head=0.3)


def _rounds(candidates: Sequence[Candidate], standing: NamedEffects) -> list[_Round]:
    """Return the rounds of the search that led to the accepted effects; without accepted effects,
    the first rounds.
    """
    models = sorted(dict.fromkeys(item.within for item in candidates), key=len)
    path = [within for within in models if set(within) <= set(standing.named)] or models
    chosen = path[:MOST_PANELS]
    rows = ROWS.get(len(chosen), ROWS_OF_MANY_ROUNDS)
    return [
        _round(
            [item for item in candidates if item.within == within],
            standing,
            CANDIDATES_OF_LAST_ROUND if standing.complete(within) else rows,
        )
        for within in chosen
    ]


def _round(group: Sequence[Candidate], standing: NamedEffects, most: int) -> _Round:
    """Return the round of the candidates ``group``: the ``most`` drawn, accepted effects first."""
    ranked = sorted(group, key=lambda item: (not item.fitted, -item.weight, item.name))
    best = {item.name: item for item in reversed(ranked)}  # a fitted form before a linearised one
    ordered = sorted(best.values(), key=lambda item: (-item.weight, item.name))
    by_priority = sorted(ordered, key=lambda item: item.name not in standing.named)
    drawn = {item.name for item in by_priority[:most]}
    return _Round(
        group[0].round,
        group[0].within,
        tuple(item for item in ordered if item.name in drawn),
        len(ordered) - len(drawn),
    )


def _places(drawn: _Round) -> list[float]:
    """Return the ordinates of the candidates; the first is at the top."""
    return [float(len(drawn.shown) - 1 - row) for row in range(len(drawn.shown))]


def _colour_and_label(candidate: Candidate, standing: NamedEffects) -> tuple[str, str]:
    colour, role = GREY, "other"
    if candidate.name in standing.claimed:
        colour, role = BLUE, "claimed"
    elif is_alternative(candidate, standing) or candidate.name in standing.hints:
        colour, role = ORANGE, "alternative or hint"
    return colour, f"{role}, {'fitted' if candidate.fitted else 'linearised'}"


def _draw_odds(panel: Axes, drawn: _Round, standing: NamedEffects) -> None:
    """Draw a bar for the log posterior odds of each candidate; negative odds to the left."""
    odds = [item.weight for item in drawn.shown]
    most, least = max(*odds, 0.0), min(*odds, 0.0)
    # Bars to the left are cut at a quarter of the longest bar to the right.
    low = max(least, -0.25 * most) if most > 0.0 else least
    for y, item, value in zip(_places(drawn), drawn.shown, odds, strict=True):
        colour, label = _colour_and_label(item, standing)
        panel.barh(
            y,
            max(value, low),
            height=0.66,
            color=colour if item.fitted else "white",
            edgecolor=colour,
            linewidth=0.9,
            label=label,
        )
    panel.axvline(0.0, **ZERO)
    span = (most - low) or 1.0
    panel.set_xlim(low - 0.02 * span, most + 0.04 * span)
    panel.xaxis.set_major_locator(MaxNLocator(5))
    names = [escaped_dollars(item.name) for item in drawn.shown]
    panel.set_yticks(_places(drawn), names, fontsize=_SMALL_TEXT_SIZE)


def _write_title(panel: Axes, drawn: _Round, standing: NamedEffects, x: float) -> None:
    """Write the model of a round above the names, and the number of other candidates below.

    ``x`` is the place of the title, share of the panel.
    """
    model = " + ".join(drawn.within) if drawn.within else "the declared model"
    remark = ""
    if drawn.within and standing.complete(drawn.within):
        remark = "; nothing more was needed"
    elif standing.complete(()):
        remark = "; nothing was needed"
    panel.set_title(
        escaped_dollars(f"round {drawn.number}, added to {model}{remark}"),
        fontsize=TICK_SIZE,
        loc="left",
        x=x,
        pad=4.5,
        y=1.0,
    )
    if drawn.others:
        panel.annotate(
            f"{drawn.others} others below",
            (0.0, -1.0),
            **_text_style(-0.06),
            va="center",
            color=GREY,
        )


def _write_column(panel: Axes, texts: Sequence[str], heading: str) -> None:
    """Write a column of texts right of a panel, with a heading."""
    style = _text_style(_NUMBER_WIDTH)
    for y, text in enumerate(reversed(texts)):
        panel.annotate(text, (1.0, y), **style, va="center")
    if any(texts):
        panel.annotate(heading, (1.0, len(texts) - 0.45), **style, va="bottom")


def _text_style(inches: float, side: str = "right") -> dict[str, Any]:
    """Return the style of a small text, ``inches`` right of its point in a panel.

    The point has a share of the panel's width and an ordinate. ``side`` is the alignment.
    """
    place = {
        "xycoords": ("axes fraction", "data"),
        "xytext": (72.0 * inches, 0.0),
        "textcoords": "offset points",
    }
    return {**place, "ha": side, "fontsize": _SMALL_TEXT_SIZE, "annotation_clip": False}


def _finish_axes(sheet: Sheet, rounds: Sequence[_Round]) -> None:
    for panel, drawn in zip(sheet.panels, rounds, strict=True):
        panel.tick_params(axis="y", length=0)
        panel.grid(False, axis="y")
        panel.set_ylim(-1.55 if drawn.others else -0.55, len(drawn.shown) - 0.45)
        panel.spines["left"].set_color(LIGHT)
    x_label = "log posterior odds against the set in the heading"
    sheet.panels[-1].set_xlabel(x_label, fontsize=LABEL_SIZE)


def _odds_text(candidate: Candidate) -> str:
    """Return the log odds with one decimal, or without if there are three digits."""
    decimals = 0 if abs(candidate.weight) >= 99.5 else 1
    return f"{candidate.weight:.{decimals}f}".replace("-", "−")


# ---- Parameters of effects from single records

MOST_DRAWN_PARAMETERS = 4  # drawn parameters of one effect
LARGEST_SIGMA_SHARE = 1e3  # a larger sigma, over the value, is limited
SMALLEST_VALUE = 1e-12  # value from which this limit counts at least


def figure_replication(effects: Sequence[Replicated], title: str = "") -> Figure:
    """Plot the parameters of effects from each record, and from all fitted records as a band.

    Bars and band are two standard deviations. Angles are in degrees. A record without the parameter
    has no point.
    """
    shown = [
        (effect, name)
        for effect in effects
        for name in list(effect.by_record[0])[:MOST_DRAWN_PARAMETERS]
    ]
    sheet = make_sheet([1.2] * len(shown), row_gap=0.32, left=0.8)
    for panel, (effect, name) in zip(sheet.panels, shown, strict=True):
        places = [place for place, parameters in enumerate(effect.by_record) if name in parameters]
        values, stds = _in_display_units([effect.by_record[place][name] for place in places], name)
        if name in effect.together:
            (value,), (std,) = _in_display_units([effect.together[name]], name)
            panel.axhspan(
                value - 2.0 * std,
                value + 2.0 * std,
                color=SKY,
                alpha=0.3,
                linewidth=0,
                label="fitted records together ±2σ",
            )
            panel.axhline(value, color=SKY, linewidth=1.0)
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
        width_per_record = 5.9 / len(effect.by_record)
        panel.set_xticks(
            range(len(effect.by_record)),
            [
                "\n".join(folded(escaped_dollars(label), width_per_record, TICK_SIZE))
                for label in effect.records
            ],
        )
        text = display_unit(effect.by_record[0][name].unit, name).text
        y_label(panel, escaped_dollars(f"{name.replace('_', ' ')} ({text})"))
        caption(panel, escaped_dollars(effect.name))
    return finish(sheet, title, head=0.22, bottom=0.45)


def _in_display_units(quantities: Sequence[Quantity], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return values and sigmas of a parameter in the units of a figure.

    Very large sigmas are limited. An unknown sigma becomes the size of the value.
    """
    rows = np.array(
        [displayed(quantity, name)[:2] for quantity in quantities], dtype=float
    ).reshape(-1, 2)
    values, stds = rows[:, 0], rows[:, 1]
    sizes = np.abs(values)
    limited = np.minimum(stds, LARGEST_SIGMA_SHARE * np.maximum(sizes, SMALLEST_VALUE))
    return values, np.where(np.isfinite(stds) & (stds >= 0.0), limited, sizes)


# ---- Residuals over time and frequency, and held-out records

FEWEST_SEGMENT_SAMPLES = 16  # samples of a record for each segment, else no coherence is drawn
VISIBLE_CHANGE = 5e-3  # share of the largest residual that a figure can show
_BAND = "±2σ of the sensor noise"
_RING: Mapping[str, Any] = {
    "color": VERMILION,
    "marker": "o",
    "markersize": 5.5,
    "markerfacecolor": "none",
    "markeredgewidth": 0.9,
    "linestyle": "none",
}


def figure_residuals(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Plot the residuals of a fitted record over time.

    Residuals of the declared model are at the left, those with the effects at the right, with the
    same scale. If no effect was added, there is a single column. Samples that were set aside have a
    ring. Angles are in degrees. ``noise``: noise level by channel.
    """
    shown = _measured(fitted)
    count = len(shown)
    sides = [("before", fitted.before), ("after", fitted.after)]
    if _same(fitted, [row for row, _ in shown]):
        sides = [("residual", fitted.after)]
    sheet = make_sheet([1.25] * count, (1.0,) * len(sides), row_gap=0.3, column_gap=0.42)
    for panels, (row, name) in zip(sheet.axes, shown, strict=True):
        channel = fitted.record[name]
        unit, valid = display_unit(channel.unit), channel.valid
        set_aside = valid & ~fitted.used[row]
        limit = 0.0
        for panel, (model, residuals) in zip(panels, sides, strict=True):
            values = unit.factor * residuals[row]
            _few_ticks(panel)
            _band(panel, unit.factor * noise.get(name, 0.0))
            time = fitted.record.time
            panel.plot(time[valid], values[valid], color=BLUE, label="residual", **DOTS)
            if np.any(set_aside):
                panel.plot(time[set_aside], values[set_aside], label="set aside", **_RING)
            limit = max(limit, float(np.abs(values[valid]).max(initial=0.0)))
            used = valid & fitted.used[row]
            rms = float(np.sqrt(np.mean(values[used] ** 2))) if np.any(used) else 0.0
            caption(panel, f"{model}: rms {rms:#.3g} {unit.text}")
        for panel in panels:
            panel.set_ylim(-1.08 * limit or -1.0, 1.08 * limit or 1.0)
        for panel in panels[1:]:
            panel.tick_params(labelleft=False)
        y_label(panels[0], axis_label(name, unit))
    for panel in sheet.axes[-1]:
        time_axis(panel)
    return finish(sheet, title, head=0.24)


def figure_held_out(
    prediction: Prediction, noise: Mapping[str, float], title: str = "", data: str = MEASURED_DATA
) -> Figure:
    """Plot a predicted record.

    The upper panels have its inputs and outputs without a prediction, such as the airspeed. Below
    are the samples with the predictions with and without the effects, and the residual of each. If
    no effect was added, there is a single prediction. Angles are in degrees.

    Parameters
    ----------
    noise : noise level by channel.
    data : legend label of the samples.
    """
    predictions = [("predicted after", prediction.after), ("predicted before", prediction.before)]
    if np.array_equal(prediction.after, prediction.before):
        predictions = [("predicted", prediction.before)]
    responses = [
        MethodOutputs(label, dict(zip(prediction.channels, values, strict=True)))
        for label, values in predictions
    ]
    record = prediction.record
    upper_channels = context(record, prediction.channels)
    figure = figure_fit(record, responses, None, title, noise, data, above=upper_channels)
    for panel in figure.axes:
        _few_ticks(panel)
    return figure


def figure_spectra(fitted: FittedRecord, noise: Mapping[str, float], title: str = "") -> Figure:
    """Plot power spectra of the residuals, before and after, over that of the noise.

    White noise of the right level is at one. If no effect was added, there is a single spectrum.
    Spectra are periodograms under a Hann window, averaged over neighbouring frequencies. Below each
    is the coherence with the inputs, with the level that noise alone exceeds once in twenty.
    Samples that are missing or set aside count as zero. Uneven sampling counts as even at its mean
    interval.
    """
    shown = _measured(fitted)
    moving = [channel for channel in fitted.record.inputs if np.ptp(channel.values) > 0.0]
    inputs = np.array([channel.values for channel in moving])
    fewest_samples = FEWEST_SEGMENT_SAMPLES * COHERENCE_SEGMENTS
    with_coherence = len(inputs) > 0 and len(fitted.record) >= fewest_samples
    heights = [1.25, 0.7] if with_coherence else [1.25]
    sheet = make_sheet(heights * len(shown), row_gap=0.3)
    same = _same(fitted, [row for row, _ in shown])
    interval = float(fitted.record.time[-1] - fitted.record.time[0]) / (len(fitted.record) - 1)
    spectrum_panels = sheet.panels[:: len(heights)]
    for number, (panel, (row, name)) in enumerate(zip(spectrum_panels, shown, strict=True)):
        used = fitted.used[row] & fitted.record[name].valid
        panel.axhline(1.0, color=BLACK, linewidth=0.8, linestyle=(0, (4, 2)), label="white noise")
        both = ((fitted.before[row], "before", 1), (fitted.after[row], "after", 0))
        single = ((fitted.after[row], "residual", 0),)
        lines = single if same else both
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
            if with_coherence:
                below = sheet.panels[2 * number + 1]
                hertz, coherence = input_coherence(np.where(used, residual, 0.0), inputs, interval)
                below.plot(hertz, coherence, **method_style(order, alone=len(lines) == 1))
        if with_coherence:
            level = coherence_level(len(inputs))
            below.axhline(level, color=BLACK, linewidth=0.8, linestyle=(0, (4, 2)))
            below.set_ylim(0.0, 1.05)
            y_label(below, "coherence (–)", TICK_SIZE)
        panel.set_yscale("log")
        panel.set_xscale("log")
        bottom, top = panel.get_ylim()
        panel.set_ylim(max(bottom, 1e-2), min(max(top, 10.0), 1e6))
        decades(panel.xaxis, (1.0, 2.0, 5.0))
        decades(panel.yaxis)
        y_label(panel, f"{symbol(name)}: power / noise (–)")
    sheet.panels[-1].set_xlabel("frequency (Hz)", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.12)


def _same(fitted: FittedRecord, rows: Sequence[int]) -> bool:
    """Return whether before and after differ by less than a figure can show."""
    change = np.abs(fitted.before - fitted.after)[rows].max(axis=1, initial=0.0)
    size = np.abs(fitted.after)[rows].max(axis=1, initial=0.0)
    return bool(np.all(change <= VISIBLE_CHANGE * size))


def _measured(fitted: FittedRecord) -> list[tuple[int, str]]:
    """Return row and name of the fitted channels that the record measures."""
    return [
        (row, name)
        for row, name in enumerate(fitted.channels)
        if name in fitted.record.output_names
    ]


def _band(panel: Axes, sigma: float) -> None:
    """Draw the zero line, and the band of two sigmas of the noise if it is known."""
    if sigma > 0.0:
        panel.axhspan(-2.0 * sigma, 2.0 * sigma, color=SKY, alpha=0.25, linewidth=0, label=_BAND)
    panel.axhline(0.0, **ZERO)


def _few_ticks(panel: Axes) -> None:
    """Use few ticks; they take most of the time of drawing."""
    for axis, bins in ((panel.xaxis, 5), (panel.yaxis, 3)):
        axis.set_major_locator(MaxNLocator(nbins=bins, steps=[1, 2, 2.5, 5, 10]))
