"""What holds for every figure, found by drawing it once: texts apart and on the canvas, labels with
units, lines that can be told apart.
"""

from __future__ import annotations

import re
from collections import Counter
from itertools import combinations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox

TOUCH = 1.0  # pixels by which boxes of text may overlap: those of glyphs are smaller
NO_UNIT = (
    "autocorrelation",
    "too few samples",
    "no sample",
    "no candidate",
    "likelihood",
    "log posterior odds",
    "method",
    "study",
)  # no quantity, or a pure number


def broken_laws(figure: Figure) -> list[str]:
    """Sentences on what is wrong with a figure; none where all is well."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    boxes = [(text, text.get_window_extent(renderer)) for text in drawn_texts(figure)]
    return [
        *_off_canvas(figure, boxes),
        *_over_each_other(boxes),
        *_legends(figure, renderer),
        *_labels(figure),
        *_coincident(figure),
    ]


def words(figure: Figure) -> str:
    """Every text of a figure, legends included."""
    return "\n".join(text.get_text() for text in figure.findobj(Text) if isinstance(text, Text))


def drawn_texts(figure: Figure) -> list[Text]:
    """Every text that is seen; of the ticks those within the limits, since matplotlib keeps others
    in store.
    """
    panels = [panel for panel in figure.axes if panel.get_visible()]
    axes = [axis for panel in figure.axes for axis in (panel.xaxis, panel.yaxis)]
    stored = {
        id(label)
        for axis in axes
        for tick in (*axis.majorTicks, *axis.minorTicks)
        for label in (tick.label1, tick.label2)
    }
    seen = [axis for panel in panels if panel.axison for axis in (panel.xaxis, panel.yaxis)]
    shown = [tick.label1 for axis in seen for tick in axis._update_ticks()]  # type: ignore[union-attr]
    hidden = {
        id(text) for panel in figure.axes if not panel.get_visible() for text in panel.findobj(Text)
    }
    hidden |= {
        id(axis.label)
        for panel in panels
        if not panel.axison
        for axis in (panel.xaxis, panel.yaxis)
    }
    others = [text for text in figure.findobj(Text) if id(text) not in stored | hidden]
    return [
        text
        for text in (*others, *shown)
        if isinstance(text, Text) and text.get_visible() and text.get_text().strip()
    ]


def _off_canvas(figure: Figure, boxes: list[tuple[Text, Bbox]]) -> list[str]:
    sheet = figure.bbox.padded(1.0)
    inside = [
        sheet.x0 <= box.x0 and box.x1 <= sheet.x1 and sheet.y0 <= box.y0 and box.y1 <= sheet.y1
        for _, box in boxes
    ]
    return [
        f"{text.get_text()!r} leaves the figure"
        for (text, _), within in zip(boxes, inside, strict=True)
        if not within
    ]


def _over_each_other(boxes: list[tuple[Text, Bbox]]) -> list[str]:
    out = []
    for (one, a), (other, b) in combinations(boxes, 2):
        wide, high = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        if wide > TOUCH and high > TOUCH and one is not other:
            out.append(f"{one.get_text()!r} and {other.get_text()!r} lie over each other")
    return out


def _legends(figure: Figure, renderer: object) -> list[str]:
    out = []
    panels = [panel for panel in figure.axes if panel.get_visible()]
    for legend in (
        *figure.legends,
        *(panel.legend_ for panel in panels if panel.legend_ is not None),
    ):
        twice = [
            label
            for label, count in Counter(text.get_text() for text in legend.get_texts()).items()
            if count > 1
        ]
        out += [f"the legend says {label!r} twice" for label in twice]
        covered = legend.get_window_extent(renderer)  # type: ignore[arg-type]
        out += [
            "the legend covers a panel"
            for panel in panels
            if covered.overlaps(panel.get_window_extent(renderer))  # type: ignore[arg-type]
        ]
    for one, other in combinations(panels, 2):
        if one.get_window_extent(renderer).overlaps(other.get_window_extent(renderer)):  # type: ignore[arg-type]
            out.append("two panels lie over each other")
    return out


def _labels(figure: Figure) -> list[str]:
    """Numbers at an axis have a label with a unit, at the axis, above the panel, or at the panel
    that shares it.
    """
    out = []
    panels = [panel for panel in figure.axes if panel.get_visible() and panel.axison]
    for panel in panels:
        row = [
            other
            for other in panels
            if abs(other.get_position().y0 - panel.get_position().y0) < 1e-6
        ]
        column = [
            other
            for other in panels
            if abs(other.get_position().x0 - panel.get_position().x0) < 1e-6
        ]
        above = panel.get_title(loc="left")
        for axis, own, shared in (
            (panel.xaxis, panel.get_xlabel(), " ".join(other.get_xlabel() for other in column)),
            (panel.yaxis, panel.get_ylabel(), row[0].get_ylabel()),
        ):
            numbers = [
                tick.label1.get_text()
                for tick in axis._update_ticks()  # type: ignore[union-attr]
                if tick.label1.get_visible()
            ]
            if not any(re.fullmatch(r"[−-]?[\d.]+(e[−-]?\d+)?", text) for text in numbers):
                continue
            told = " ".join((own, shared, above))
            if "(" not in told and not any(word in told for word in NO_UNIT):
                out.append(
                    f"an axis with the numbers {', '.join(numbers[:3])} has no unit: "
                    f"{told.strip()!r}"
                )
    return out


def _coincident(figure: Figure) -> list[str]:
    out = []
    for panel in figure.axes:
        lines = [line for line in panel.lines if _seen(line)]
        for one, other in combinations(lines, 2):
            if _same_data(one, other) and not told_apart(panel, one, other):
                out.append(f"{one.get_label()!r} and {other.get_label()!r} coincide and look alike")
    return out


def told_apart(panel: Axes, one: Line2D, other: Line2D) -> bool:
    """Whether of two lines over each other both are seen: the upper one has gaps or is thinner, and
    another colour.
    """
    order = sorted((one, other), key=lambda line: (line.get_zorder(), panel.lines.index(line)))
    below, above = order
    gaps = str(above.get_linestyle()) not in ("-", "solid")
    return below.get_color() != above.get_color() and (
        gaps or above.get_linewidth() < 0.8 * below.get_linewidth()
    )


def _seen(line: Line2D) -> bool:
    return (
        line.get_visible()
        and str(line.get_linestyle()) not in ("None", "none", "")
        and len(np.atleast_1d(line.get_xdata())) > 2
    )


def _same_data(one: Line2D, other: Line2D) -> bool:
    a, b = (np.asarray(line.get_xydata(), dtype=float) for line in (one, other))
    size = 1e-3 * np.nanmax(np.abs(a), axis=0, initial=0.0)
    return a.shape == b.shape and bool(
        np.all((np.abs(a - b) <= size) | (np.isnan(a) & np.isnan(b)))
    )
