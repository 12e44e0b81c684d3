"""What each candidate would bring."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from ident.tracing.diagnosis import Candidate
from scenarios.plots.display import plain
from scenarios.plots.style import BLUE, GREY, LABEL_SIZE, TICK_SIZE, caption, decades, finish, make_sheet, text_width

BARS, PANELS = 7, 4  # candidates of a round, rounds
LEAST = 0.1  # gain at the left edge of the evidence


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
        decades(panel.xaxis)
        within = f", beside {' + '.join(node[1])}" if node[1] else ", beside the declared model"
        caption(panel, plain(f"round {node[0]}{within}"))
    if groups:
        sheet.panels[-1].set_xlabel("gain of the log likelihood", fontsize=LABEL_SIZE)
    else:
        caption(sheet.panels[0], "no candidate was tried")
    return finish(sheet, title, head=0.22, legend=False)


def _best(group: Sequence[Candidate]) -> list[Candidate]:
    """The candidates of a round that gain most, each name once."""
    ranked = sorted(group, key=lambda c: (-c.gain, c.name))
    first = {c.name: c for c in reversed(ranked)}
    return [c for c in ranked if first[c.name] is c][:BARS]
