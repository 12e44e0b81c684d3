"""What records determine of many parameters, and what only the priors do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from scenarios.plots.display import plain, symbol
from scenarios.plots.style import BLACK, LABEL_SIZE, LIGHT, caption, finish, make_sheet, method_style, text_width

_ROW = 0.235  # inches a parameter
KEPT = 0.95  # of the prior's deviation: parameters above it with every method are counted, not drawn
_MARKS = ("o", "^", "x", "D")


@dataclass(frozen=True, eq=False)
class DeterminedBy:
    """One method: by parameter deviation over the prior's, share of the variance that the prior gives, and strengths, largest first.

    ``unseen``: how many directions have none to rounding; they are left out of ``strengths``.
    """

    label: str
    ratio: Mapping[str, float]
    share: Mapping[str, float]
    strengths: np.ndarray
    unseen: int


def figure_determination(methods: Sequence[DeterminedBy], title: str = "") -> Figure:
    """Above: strength of each direction, record against prior. Below: a row a parameter, sorted by what the first method leaves of its prior."""
    everything = sorted(methods[0].ratio, key=lambda name: methods[0].ratio[name])
    names = [name for name in everything if any(each.ratio.get(name, 1.0) <= KEPT for each in methods)] or everything[:1]
    n, rest = len(names), len(everything) - len(names)
    left = max(0.75, *(text_width(symbol(name)) + 0.2 for name in names))
    sheet = make_sheet([1.9, n * _ROW + 0.1], (1.0, 1.0), count=4, left=left, column_gap=0.3, row_gap=0.75, share_x=False)
    spectrum, spare, ratio, share = sheet.panels
    spectrum.set_yscale("log")
    spectrum.axhline(1.0, color=BLACK, linewidth=0.8)
    for number, each in enumerate(methods):
        colour, mark = method_style(number)["color"], _MARKS[number % len(_MARKS)]
        look = {"color": colour, "marker": mark, "linestyle": "none", "markersize": 3.5}
        along = np.arange(1, len(each.strengths) + 1)
        spectrum.plot(along, each.strengths, label=plain(each.label), **look)
        spare.plot(along, np.cumsum(each.strengths**2 / (1.0 + each.strengths**2)), **method_style(number))
        places = np.arange(n, dtype=float)
        ratio.plot([each.ratio.get(name, np.nan) for name in names], places, **look)
        share.plot([100.0 * each.share.get(name, np.nan) for name in names], places, **look)
    caption(spectrum, "strength of each direction (–): 1 where record = prior")
    caption(spare, "numbers that the record settles (–), added up")
    unseen = sorted({each.unseen for each in methods})
    for panel in (spectrum, spare):
        panel.set_xlabel(f"direction (–); {' or '.join(map(str, unseen))} more have no influence", fontsize=LABEL_SIZE)
    for panel, text in ((ratio, "σ over the prior's σ (–)"), (share, "variance that the prior gives (%)")):
        panel.set_ylim(n - 0.4, -0.6)
        panel.set_xlabel(text, fontsize=LABEL_SIZE)
        panel.set_yticks(range(n), [symbol(name) for name in names] if panel is ratio else [""] * n)
        panel.tick_params(axis="y", labelsize=LABEL_SIZE, length=0)
        panel.grid(True, axis="y", color=LIGHT, linewidth=0.4)
    if rest:
        caption(ratio, f"{rest} further parameters keep > {KEPT:g} of their prior's σ")
    ratio.set_xlim(-0.02, 1.05)
    share.set_xlim(-2.0, 105.0)
    return finish(sheet, title, head=0.24)
