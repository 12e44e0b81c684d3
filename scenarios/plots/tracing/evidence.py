"""Why the winner won: gain and held-out change of the candidates of each round, and in words what spoke against the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from ident.tracing import thresholds
from ident.tracing.diagnosis import Candidate
from scenarios.plots.display import plain, signed
from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREY,
    LABEL_SIZE,
    LIGHT,
    SKY,
    TICK_SIZE,
    TRUE,
    VERMILION,
    WIDTH,
    ZERO,
    Sheet,
    finish,
    make_sheet,
    text_width,
)
from scenarios.plots.tracing.reasons import STANDS, Standing, is_alternative, reason

ROWS = {1: 12, 2: 8}  # candidates of a round, by the number of rounds; 6 of more
SPARE, PANELS = 4, 3  # candidates of a round after which nothing was needed; rounds
_ROW, _NUMBER, _SMALL = 0.2, 0.56, TICK_SIZE - 0.5  # inches a candidate, inches for a number, size of text
_WIDEST = 60.0  # %, growth of the held-out error that is drawn to scale
_TITLE_LEFT = 0.15  # inches
NOTHING = Standing()


@dataclass(frozen=True)
class _Round:
    """The candidates of one round that are shown, best first, and how many are not."""

    number: int
    within: tuple[str, ...]
    shown: tuple[Candidate, ...]
    others: int


def figure_evidence(candidates: Sequence[Candidate], standing: Standing = NOTHING, title: str = "") -> Figure:
    """A panel a round: how far each candidate's gain of the log likelihood lies below the best one's, its change of the held-out error with two
    standard deviations, both as numbers, and why it was not chosen.

    Filled bars were fitted in full, open ones are scores of the screening. The rounds are those that led to what stands, ``PANELS`` at most.
    """
    rounds = _rounds(candidates, standing)
    if not rounds:
        sheet = make_sheet([1.0])
        sheet.panels[0].set_title("no candidate was tried", fontsize=TICK_SIZE, loc="left")
        return finish(sheet, title, legend=False)
    held = any(c.held_out_change is not None for each in rounds for c in each.shown)
    words = [[reason(c, standing, each.shown) for c in each.shown] for each in rounds]
    left = min(1.85, max([1.0, *(text_width(plain(c.name), _SMALL) + 0.25 for each in rounds for c in each.shown)]))
    right = max([0.7, *(text_width(text, _SMALL) for some in words for text in some)]) + 0.1 + _NUMBER
    # The axis of held-out changes may end above the last round, whose heading its label must not meet.
    gap = 0.62 if held and all(c.held_out_change is None for c in rounds[-1].shown) else 0.42
    heights = [_ROW * (len(each.shown) + bool(each.others)) + 0.1 for each in rounds]
    sheet = make_sheet(heights, (1.25, 1.0) if held else (1.0,), row_gap=gap, column_gap=_NUMBER + 0.12, left=left, right=right, share_x=False)
    inner = WIDTH - left - right - (sheet.column_gap if held else 0.0)
    scale = inner * 1.25 / 2.25 if held else inner
    for line, each, some in zip(sheet.axes, rounds, words, strict=True):
        _draw_gains(line[0], each, standing)
        _head(line[0], each, standing, (_TITLE_LEFT - left) / scale)
        first = line is sheet.axes[0]
        _column(line[0], [_gain(c) for c in each.shown], "gain" if first else "")
        if held:
            _draw_held_out(line[1], each, standing)
            _column(line[1], ["" if c.held_out_change is None else _percent(c.held_out_change) for c in each.shown], "held out" if first else "")
        for y, (c, text) in zip(_places(each), zip(each.shown, some, strict=True), strict=True):
            line[-1].annotate(text, (1.0, y), **_at(_NUMBER + 0.08, "left"), va="center", color=BLUE if c.name in standing.claimed else BLACK)
    _labels(sheet, rounds, held)
    return finish(sheet, title, head=0.3)


def _rounds(candidates: Sequence[Candidate], standing: Standing) -> list[_Round]:
    """The rounds on the way to what stands; without any the first ones."""
    nodes = list(dict.fromkeys((len(c.within), c.within) for c in candidates))
    path = [node for node in nodes if set(node[1]) <= set(standing.named)] or nodes
    kept = sorted(path, key=lambda node: node[0])[:PANELS]
    most = ROWS.get(len(kept), 6)

    def rows(within: tuple[str, ...]) -> int:
        return SPARE if standing.complete(within) else most

    return [_round([c for c in candidates if c.within == within], standing, rows(within)) for _, within in kept]


def _round(group: Sequence[Candidate], standing: Standing, most: int) -> _Round:
    ranked = sorted((c for c in group if not c.remark), key=lambda c: (-c.gain, c.name))
    best = {c.name: c for c in reversed(ranked)}
    # Cross-validation has a gain of its own kind: of a candidate that was also in the search only its answer is taken.
    for c in sorted((c for c in group if c.remark), key=lambda c: c.remark == STANDS):
        found = best.get(c.name, c)
        best[c.name] = replace(found, fitted=True, held_out_change=c.held_out_change, held_out_scatter=c.held_out_scatter, remark=c.remark)
    order = sorted(best.values(), key=lambda c: (-c.gain, c.name))
    first = [c for c in order if c.name in standing.named or c.remark or c.held_out_change is not None]
    kept = {c.name for c in [*first, *(c for c in order if c not in first)][:most]}
    return _Round(group[0].round, group[0].within, tuple(c for c in order if c.name in kept), len(order) - len(kept))


def _places(each: _Round) -> list[float]:
    return [float(len(each.shown) - 1 - place) for place in range(len(each.shown))]


def _colour(c: Candidate, standing: Standing) -> str:
    return BLUE if c.name in standing.claimed else SKY if is_alternative(c, standing) or c.name in standing.hints else GREY


def _draw_gains(panel: Axes, each: _Round, standing: Standing) -> None:
    """Bars from the left edge to how far a gain lies below the best, on a scale that is linear up to one and logarithmic from there."""
    best = max(c.gain for c in each.shown)
    behind = [best - c.gain for c in each.shown]
    edge = -max(2.0 * max(behind), 10.0)
    panel.set_xscale("symlog", linthresh=1.0, linscale=0.6)
    for y, c, below in zip(_places(each), each.shown, behind, strict=True):
        colour = _colour(c, standing)
        what = "claimed" if colour == BLUE else "alternative or hint" if colour == SKY else "fitted in full" if c.fitted else "screened"
        panel.barh(y, -below - edge, left=edge, height=0.66, color=colour if c.fitted else "white", edgecolor=colour, linewidth=0.9, label=what)
    panel.axvline(0.0, **ZERO)
    panel.set_xlim(edge, 0.6)
    powers = [-(10.0**power) for power in range(int(np.log10(-edge)), -1, -1)]
    panel.xaxis.set_major_locator(FixedLocator([*powers[:: 1 if len(powers) < 4 else 2], 0.0]))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_major_formatter(FuncFormatter(lambda value, position: f"{value:.0f}".replace("-", "−")))
    panel.set_yticks(_places(each), [plain(c.name) for c in each.shown], fontsize=_SMALL)


def _draw_held_out(panel: Axes, each: _Round, standing: Standing) -> None:
    panel.set_yticks(_places(each), [""] * len(each.shown))
    if all(c.held_out_change is None for c in each.shown):
        panel.set_axis_off()
        return
    panel.axvline(0.0, **{**ZERO, "linewidth": 1.0})
    if any(c.remark for c in each.shown):
        panel.axvline(100.0 * (np.exp(-thresholds.WORTH) - 1.0), label="what cross-validation asks for", **TRUE)
    for y, c in zip(_places(each), each.shown, strict=True):
        if c.held_out_change is None:
            continue
        change = 100.0 * c.held_out_change
        colour = _colour(c, standing)
        colour = VERMILION if colour == GREY and change > 0.0 else colour
        if change > _WIDEST:
            panel.plot([_WIDEST], [y], ">", color=colour, markersize=5.0, clip_on=False)
            continue
        bars = None if c.held_out_scatter is None else [[200.0 * c.held_out_scatter]]
        panel.errorbar([change], [y], xerr=bars, fmt="o", color=colour, markersize=4.5, linewidth=1.2, capsize=2.0)
    reached = [100.0 * np.array([c.held_out_change, c.held_out_scatter or 0.0]) for c in each.shown if c.held_out_change is not None]
    low = min([-12.0, *(1.08 * (change - 2.0 * scatter) for change, scatter in reached)])
    high = max([6.0, *(1.08 * min(change + 2.0 * scatter, _WIDEST) for change, scatter in reached)])
    panel.set_xlim(max(low, -108.0), high)


def _head(panel: Axes, each: _Round, standing: Standing, x: float) -> None:
    """What the round began from, above the names, and below them how many others there are."""
    beside = f"beside {' + '.join(each.within)}" if each.within else "beside the declared model"
    done = "; nothing more was needed" if standing.complete(each.within) and each.within else "; nothing was needed" if standing.complete(()) else ""
    panel.set_title(plain(f"round {each.number}, {beside}{done}"), fontsize=TICK_SIZE, loc="left", x=x, pad=4.5, y=1.0)
    if each.others:
        panel.annotate(f"{each.others} others below", (0.0, -1.0), **{**_at(-0.06), "xycoords": ("axes fraction", "data")}, va="center", color=GREY)


def _column(panel: Axes, texts: Sequence[str], heading: str) -> None:
    """Numbers at the right of a panel, one a row from the top, with a heading."""
    for place, text in enumerate(reversed(texts)):
        panel.annotate(text, (1.0, place), **_at(_NUMBER), va="center")
    if any(texts):
        panel.annotate(heading, (1.0, len(texts) - 0.45), **_at(_NUMBER), va="bottom")


def _at(inches: float, side: str = "right") -> dict[str, Any]:
    """A small text in a row of a panel, so many inches right of its edge."""
    place = {"xycoords": ("axes fraction", "data"), "xytext": (72.0 * inches, 0.0), "textcoords": "offset points"}
    return {**place, "ha": side, "fontsize": _SMALL, "annotation_clip": False}


def _labels(sheet: Sheet, rounds: Sequence[_Round], held: bool) -> None:
    for line, each in zip(sheet.axes, rounds, strict=True):
        for panel in line:
            panel.tick_params(axis="y", length=0)
            panel.grid(False, axis="y")
            panel.set_ylim(-1.55 if each.others else -0.55, len(each.shown) - 0.45)
            panel.spines["left"].set_color(LIGHT)
    sheet.axes[-1][0].set_xlabel("log likelihood below the best", fontsize=LABEL_SIZE)
    if held:
        last = next(panel for *_, panel in reversed(sheet.axes) if panel.axison)
        last.set_xlabel("held-out error ±2σ (%)", fontsize=LABEL_SIZE)


def _gain(c: Candidate) -> str:
    return (f"{c.gain:.0f}" if abs(c.gain) >= 99.5 else f"{c.gain:.1f}").replace("-", "−")


def _percent(change: float) -> str:
    return f"{signed(100.0 * change, '.1f' if abs(change) < 0.995 else '.0f')} %" if change < 9.0 else "> +900 %"
