"""Figures of a diagnosis: derivatives, evidence, values by record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ident.tracing.diagnosis import Candidate, Quantity
from scenarios.plots.display import (
    NamedEffects,
    Replicated,
    display_unit,
    escaped_dollars,
    is_alternative,
    reason,
    symbol,
)
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
    finish,
    folded,
    make_sheet,
    text_width,
    y_label,
)
from scenarios.report.quantities import displayed, value_text

# ---- Derivatives before and after


def figure_derivatives(
    before: Mapping[str, Quantity], after: Mapping[str, Quantity], title: str = ""
) -> Figure:
    """Plot derivatives of the declared model and of the model with effects, in % of the former.

    Bars are two standard deviations. A derivative below three of its sigmas is shown in % of three
    sigmas, which a line above says. Without effects, only the declared model is shown.
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
    lines = folded(_of_sigmas(vague, declared=same), inner) if vague else []
    caption(panel, "\n".join(lines))
    return finish(sheet, title, head=0.24 + 0.16 * max(len(lines) - 1, 0))


def _of_sigmas(names: Sequence[str], *, declared: bool) -> str:
    """Return the sentence on derivatives that are drawn in per cent of three sigmas."""
    several = len(names) > 1
    named = f"{', '.join(names[:-1])} and {names[-1]}" if several else names[0]
    when = "" if declared else " before"
    are, they, were = ("are", "they", "were") if several else ("is", "it", "was")
    return (
        f"{named} {are} drawn in per cent of three sigmas, because {they} {were} not determined"
        f"{when}"
    )


# ---- Evidence of the candidates

ROWS = {1: 12, 2: 8}  # number of rounds -> drawn candidates of each round (6 if more rounds)
CANDIDATES_OF_LAST_ROUND = 4  # candidates drawn of a round that added no effect
MOST_PANELS = 3  # rounds at most
_ROW_HEIGHT = 0.2  # inches, height of a candidate
_NUMBER_WIDTH = 0.56  # inches, width of a number
_SMALL_TEXT_SIZE = TICK_SIZE - 0.5  # points, size of small text
_TITLE_LEFT = 0.15  # inches
NOTHING = NamedEffects()


@dataclass(frozen=True)
class _Round:
    """Drawn candidates of one round, the best first; ``others``: number of further ones."""

    number: int
    within: tuple[str, ...]
    shown: tuple[Candidate, ...]
    others: int


def figure_evidence(
    candidates: Sequence[Candidate], standing: NamedEffects = NOTHING, title: str = ""
) -> Figure:
    """Plot the log posterior odds of each candidate, one panel per round, and reasons against it.

    Filled bars are from fits, open ones from linearisation; each panel has the set that its
    candidates are added to. Up to ``MOST_PANELS`` rounds that led
    to the accepted effects.
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
                *(
                    text_width(escaped_dollars(c.name), _SMALL_TEXT_SIZE) + 0.25
                    for each in rounds
                    for c in each.shown
                ),
            ]
        ),
    )
    right = (
        max([0.7, *(text_width(text, _SMALL_TEXT_SIZE) for some in words for text in some)])
        + 0.1
        + _NUMBER_WIDTH
    )
    heights = [_ROW_HEIGHT * (len(each.shown) + bool(each.others)) + 0.1 for each in rounds]
    sheet = make_sheet(heights, row_gap=0.42, left=left, right=right, share_x=False)
    scale = WIDTH - left - right
    for panel, each, some in zip(sheet.panels, rounds, words, strict=True):
        _draw_odds(panel, each, standing)
        _head(panel, each, standing, (_TITLE_LEFT - left) / scale)
        _column(
            panel, [_odds(c) for c in each.shown], "log odds" if panel is sheet.panels[0] else ""
        )
        for y, (c, text) in zip(_places(each), zip(each.shown, some, strict=True), strict=True):
            panel.annotate(
                text,
                (1.0, y),
                **_at(_NUMBER_WIDTH + 0.08, "left"),
                va="center",
                color=BLUE if c.name in standing.claimed else BLACK,
            )
    _labels(sheet, rounds)
    return finish(sheet, title, head=0.3)


def _rounds(candidates: Sequence[Candidate], standing: NamedEffects) -> list[_Round]:
    """Rounds of the search that led to the final effects; without any the first ones."""
    nodes = list(dict.fromkeys((len(c.within), c.within) for c in candidates))
    path = [node for node in nodes if set(node[1]) <= set(standing.named)] or nodes
    chosen = sorted(path, key=lambda node: node[0])[:MOST_PANELS]
    most = ROWS.get(len(chosen), 6)

    def rows(within: tuple[str, ...]) -> int:
        return CANDIDATES_OF_LAST_ROUND if standing.complete(within) else most

    return [
        _round([c for c in candidates if c.within == within], standing, rows(within))
        for _, within in chosen
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
    """Draw a bar for the log posterior odds of each candidate; negative odds to the left."""
    odds = [c.weight for c in each.shown]
    most, least = max(*odds, 0.0), min(*odds, 0.0)
    low = max(least, -0.25 * most) if most > 0.0 else least
    for y, c, value in zip(_places(each), each.shown, odds, strict=True):
        colour = _colour(c, standing)
        role = "claimed" if colour == BLUE else "alternative or hint" if colour == SKY else "other"
        what = f"{role}, {'fitted' if c.fitted else 'linearised'}"
        panel.barh(
            y,
            max(value, low),
            height=0.66,
            color=colour if c.fitted else "white",
            edgecolor=colour,
            linewidth=0.9,
            label=what,
        )
    panel.axvline(0.0, **ZERO)
    span = (most - low) or 1.0
    panel.set_xlim(low - 0.02 * span, most + 0.04 * span)
    panel.xaxis.set_major_locator(MaxNLocator(5))
    panel.set_yticks(
        _places(each), [escaped_dollars(c.name) for c in each.shown], fontsize=_SMALL_TEXT_SIZE
    )


def _head(panel: Axes, each: _Round, standing: NamedEffects, x: float) -> None:
    """Write the start of a round above the names, and the number of further candidates below."""
    model = " + ".join(each.within) if each.within else "the declared model"
    done = (
        "; nothing more was needed"
        if standing.complete(each.within) and each.within
        else "; nothing was needed"
        if standing.complete(())
        else ""
    )
    panel.set_title(
        escaped_dollars(f"round {each.number}, added to {model}{done}"),
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
    """Write a column of texts right of a panel, with a heading."""
    for place, text in enumerate(reversed(texts)):
        panel.annotate(text, (1.0, place), **_at(_NUMBER_WIDTH), va="center")
    if any(texts):
        panel.annotate(heading, (1.0, len(texts) - 0.45), **_at(_NUMBER_WIDTH), va="bottom")


def _at(inches: float, side: str = "right") -> dict[str, Any]:
    """Return the style of a small text, ``inches`` right of a panel's edge."""
    place = {
        "xycoords": ("axes fraction", "data"),
        "xytext": (72.0 * inches, 0.0),
        "textcoords": "offset points",
    }
    return {**place, "ha": side, "fontsize": _SMALL_TEXT_SIZE, "annotation_clip": False}


def _labels(sheet: Sheet, rounds: Sequence[_Round]) -> None:
    for panel, each in zip(sheet.panels, rounds, strict=True):
        panel.tick_params(axis="y", length=0)
        panel.grid(False, axis="y")
        panel.set_ylim(-1.55 if each.others else -0.55, len(each.shown) - 0.45)
        panel.spines["left"].set_color(LIGHT)
    odds = "log posterior odds against the set in the heading"
    sheet.panels[-1].set_xlabel(odds, fontsize=LABEL_SIZE)


def _odds(c: Candidate) -> str:
    return (f"{c.weight:.0f}" if abs(c.weight) >= 99.5 else f"{c.weight:.1f}").replace("-", "−")


# ---- Parameters of effects from single records

MOST_DRAWN_PARAMETERS = 4  # drawn parameters of one effect


def figure_replication(effects: Sequence[Replicated], title: str = "") -> Figure:
    """Plot the parameters of effects from each record, and from all fitted records as a band.

    Bars and band are two standard deviations.

    Angles in degrees. A record without the parameter has no point.
    """
    shown = [
        (effect, name)
        for effect in effects
        for name in list(effect.by_record[0])[:MOST_DRAWN_PARAMETERS]
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


def _shown(quantities: Sequence[Quantity], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard deviations in the units of a figure, sigmas limited to the value."""
    rows = np.array(
        [displayed(quantity, name)[:2] for quantity in quantities], dtype=float
    ).reshape(-1, 2)
    values, stds = rows[:, 0], rows[:, 1]
    return values, np.where(
        np.isfinite(stds) & (stds >= 0.0),
        np.minimum(stds, 1e3 * np.maximum(np.abs(values), 1e-12)),
        np.abs(values),
    )
