"""Why the winner won: the log evidence of the candidates of each round, and in words what spoke against the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from ident.tracing.diagnosis import Candidate
from scenarios.plots.display import plain
from scenarios.plots.style import (
    BLACK,
    BLUE,
    GREY,
    LABEL_SIZE,
    LIGHT,
    SKY,
    TICK_SIZE,
    WIDTH,
    ZERO,
    Sheet,
    finish,
    make_sheet,
    text_width,
)
from scenarios.plots.tracing.reasons import Standing, is_alternative, reason

ROWS = {1: 12, 2: 8}  # candidates of a round, by the number of rounds; 6 of more
SPARE, PANELS = 4, 3  # candidates of a round after which nothing was needed; rounds
_ROW, _NUMBER, _SMALL = 0.2, 0.56, TICK_SIZE - 0.5  # inches a candidate, inches for a number, size of text
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
    """A panel a round: how far each candidate's log posterior odds lie below the best one's, as numbers, and why it was not chosen.

    Filled bars were fitted, open ones are linearised. The rounds are those that led to what stands, ``PANELS`` at most.
    """
    rounds = _rounds(candidates, standing)
    if not rounds:
        sheet = make_sheet([1.0])
        sheet.panels[0].set_title("no candidate was tried", fontsize=TICK_SIZE, loc="left")
        return finish(sheet, title, legend=False)
    words = [[reason(c, standing, each.shown) for c in each.shown] for each in rounds]
    left = min(1.85, max([1.0, *(text_width(plain(c.name), _SMALL) + 0.25 for each in rounds for c in each.shown)]))
    right = max([0.7, *(text_width(text, _SMALL) for some in words for text in some)]) + 0.1 + _NUMBER
    heights = [_ROW * (len(each.shown) + bool(each.others)) + 0.1 for each in rounds]
    sheet = make_sheet(heights, row_gap=0.42, left=left, right=right, share_x=False)
    scale = WIDTH - left - right
    for panel, each, some in zip(sheet.panels, rounds, words, strict=True):
        _draw_odds(panel, each, standing)
        _head(panel, each, standing, (_TITLE_LEFT - left) / scale)
        _column(panel, [_odds(c) for c in each.shown], "ln odds" if panel is sheet.panels[0] else "")
        for y, (c, text) in zip(_places(each), zip(each.shown, some, strict=True), strict=True):
            panel.annotate(text, (1.0, y), **_at(_NUMBER + 0.08, "left"), va="center", color=BLUE if c.name in standing.claimed else BLACK)
    _labels(sheet, rounds)
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
    ranked = sorted(group, key=lambda c: (not c.fitted, -c.weight, c.name))
    best = {c.name: c for c in reversed(ranked)}  # as fitted, where it was
    order = sorted(best.values(), key=lambda c: (-c.weight, c.name))
    first = [c for c in order if c.name in standing.named]
    kept = {c.name for c in [*first, *(c for c in order if c not in first)][:most]}
    return _Round(group[0].round, group[0].within, tuple(c for c in order if c.name in kept), len(order) - len(kept))


def _places(each: _Round) -> list[float]:
    return [float(len(each.shown) - 1 - place) for place in range(len(each.shown))]


def _colour(c: Candidate, standing: Standing) -> str:
    return BLUE if c.name in standing.claimed else SKY if is_alternative(c, standing) or c.name in standing.hints else GREY


def _draw_odds(panel: Axes, each: _Round, standing: Standing) -> None:
    """Bars from the left edge to how far the odds lie below the best, on a scale that is linear up to one and logarithmic from there."""
    best = max(c.weight for c in each.shown)
    behind = [best - c.weight for c in each.shown]
    edge = -max(2.0 * max(behind), 10.0)
    panel.set_xscale("symlog", linthresh=1.0, linscale=0.6)
    for y, c, below in zip(_places(each), each.shown, behind, strict=True):
        colour = _colour(c, standing)
        what = "claimed" if colour == BLUE else "alternative or hint" if colour == SKY else "fitted" if c.fitted else "linearised"
        panel.barh(y, -below - edge, left=edge, height=0.66, color=colour if c.fitted else "white", edgecolor=colour, linewidth=0.9, label=what)
    panel.axvline(0.0, **ZERO)
    panel.set_xlim(edge, 0.6)
    powers = [-(10.0**power) for power in range(int(np.log10(-edge)), -1, -1)]
    panel.xaxis.set_major_locator(FixedLocator([*powers[:: 1 if len(powers) < 4 else 2], 0.0]))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_major_formatter(FuncFormatter(lambda value, position: f"{value:.0f}".replace("-", "−")))
    panel.set_yticks(_places(each), [plain(c.name) for c in each.shown], fontsize=_SMALL)


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


def _labels(sheet: Sheet, rounds: Sequence[_Round]) -> None:
    for panel, each in zip(sheet.panels, rounds, strict=True):
        panel.tick_params(axis="y", length=0)
        panel.grid(False, axis="y")
        panel.set_ylim(-1.55 if each.others else -0.55, len(each.shown) - 0.45)
        panel.spines["left"].set_color(LIGHT)
    sheet.panels[-1].set_xlabel("log posterior odds below the best", fontsize=LABEL_SIZE)


def _odds(c: Candidate) -> str:
    return (f"{c.weight:.0f}" if abs(c.weight) >= 99.5 else f"{c.weight:.1f}").replace("-", "−")
