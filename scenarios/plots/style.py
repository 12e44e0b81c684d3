"""Style of all figures: sizes for print at 100 %, a palette for colour-blind readers, a sheet of
panels.

The size of each panel is given in inches: a layout engine of matplotlib would draw every figure
twice to find the sizes.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator, ScalarFormatter

from scenarios.plots.display import escaped_dollars
from sim.errors import ModelError

DPI = 110
WIDTH = 7.0  # inches, the text width of an A4 page
TITLE = "title"  # identifier of the bold lines of a title
TITLE_SIZE, LABEL_SIZE, TICK_SIZE = 10.0, 9.0, 8.0

# Okabe and Ito's palette, without its yellow.
BLUE, VERMILION, GREEN, PURPLE, SKY, ORANGE = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#E69F00",
)
BLACK, GREY, LIGHT = "#000000", "#7F7F7F", "#D9D9D9"
# Colour, dashes and width of each line. Each is drawn over the one before and is thinner, so that
# lines that coincide are all visible.
_METHODS: tuple[tuple[str, Any, float], ...] = (
    (BLUE, "-", 2.2),
    (VERMILION, (0, (5, 2)), 1.6),
    (GREEN, (0, (4, 1.5, 1, 1.5)), 1.4),
    (PURPLE, (0, (1, 1.2)), 1.3),
    (ORANGE, "-", 0.9),
    (BLACK, (0, (7, 4)), 0.8),
)

MEASURED: dict[str, Any] = {
    "color": GREY,
    "marker": ".",
    "markersize": 3.0,
    "markeredgewidth": 0.0,
    "linestyle": "none",
}
# Dots of a residual.
DOTS: dict[str, Any] = {
    "marker": ".",
    "markersize": 2.5,
    "markeredgewidth": 0.0,
    "linestyle": "none",
}
TRUE: dict[str, Any] = {"color": BLACK, "linestyle": (0, (4, 2)), "linewidth": 0.9}
ZERO: dict[str, Any] = {"color": BLACK, "linewidth": 0.6}

_WITHOUT_WIDTH = str.maketrans("", "", "${}_^")  # characters of mathtext that are not drawn
_SMALLEST_MARK = 4.0  # points; a mark below it is enlarged in the legend
_TITLE_ROW = 0.17  # inches
_LEGEND_ROW = 0.16  # inches
_CHARACTER_WIDTH = 0.066  # inches, width of a character
_HANDLE_WIDTH = 0.55  # inches, width of a line in the legend
_SMALLEST_LABEL = 6.0  # points, of a label that has little room
_MOST_TICKS = 8, 5  # along the x axis and the y axis
_BOLD_WIDTH_RATIO = 1.1  # how much wider bold letters are


@dataclass(frozen=True, eq=False)
class Sheet:
    """A figure under construction: a grid of panels that is filled row by row.

    Attributes
    ----------
    axes : panels by row.
    heights : heights of the rows, inches.
    widths : widths of the columns, in proportion to each other.
    column_gap, row_gap, left, right : gaps and margins, inches.
    """

    figure: Figure
    axes: tuple[tuple[Axes, ...], ...]
    heights: tuple[float, ...]
    widths: tuple[float, ...]
    column_gap: float
    row_gap: float
    left: float
    right: float

    @property
    def panels(self) -> tuple[Axes, ...]:
        """All panels in reading order."""
        return tuple(axes for row in self.axes for axes in row)


def method_style(number: int, *, alone: bool = False) -> dict[str, Any]:
    """Return colour, dashes, width and drawing order of the line of the method with this number.

    Colours and dashes repeat after six methods. ``alone``: no other line coincides with this one,
    so that it may be thin and does not hide the data below it.
    """
    colour, line, width = _METHODS[number % len(_METHODS)]
    width = min(width, 1.3) if alone else width
    return {"color": colour, "linestyle": line, "linewidth": width, "zorder": 3.0 + 0.1 * number}


def make_sheet(
    heights: Sequence[float],
    widths: Sequence[float] = (1.0,),
    *,
    count: int | None = None,
    share_x: bool = True,
    column_gap: float = 0.75,
    row_gap: float = 0.12,
    left: float = 0.72,
    right: float = 0.15,
) -> Sheet:
    """Return a grid of panels; ``finish`` must follow.

    Parameters
    ----------
    heights : heights of the rows, inches.
    widths : widths of the columns, in proportion to each other.
    count : number of panels, so that the last places of the last row are empty. None: all.
    share_x : whether the panels of a column have one x axis, with numbers at the lowest only.
    column_gap, row_gap, left, right : gaps and margins, inches.

    Raises
    ------
    ModelError : there is no panel.
    """
    rows, columns = len(heights), len(widths)
    total = rows * columns if count is None else count
    if total < 1:
        raise ModelError(
            "there is nothing to draw", where="figure", remedy="give it at least one result"
        )
    figure = Figure(figsize=(WIDTH, 1.0), dpi=DPI, facecolor="white")
    axes: list[tuple[Axes, ...]] = []
    for row in range(rows):
        row_panels = []
        for column in range(min(columns, total - row * columns)):
            # Matplotlib takes equal rectangles for the same axes. finish() sets the real ones.
            panel = figure.add_axes(
                (0.01 * column, 0.01 * row, 0.5, 0.5),
                sharex=axes[0][column] if share_x and row else None,
            )
            _set_up(panel)
            lowest = not share_x or (row + 1) * columns + column >= total
            panel.tick_params(labelbottom=lowest)
            panel.xaxis.get_offset_text().set_visible(lowest)
            row_panels.append(panel)
        axes.append(tuple(row_panels))
    return Sheet(
        figure, tuple(axes), tuple(heights), tuple(widths), column_gap, row_gap, left, right
    )


def finish(
    sheet: Sheet, title: str = "", *, bottom: float = 0.5, head: float = 0.08, legend: bool = True
) -> Figure:
    """Place the panels below a title and a legend, and return the figure.

    Parameters
    ----------
    title : its first line is bold; long lines are folded.
    bottom, head : space for labels below the last row and above the first row, inches.
    legend : whether there is a legend, with each label once.
    """
    figure = sheet.figure
    handles: dict[str, Any] = {}
    for panel in sheet.panels if legend else ():
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    inner = WIDTH - sheet.left - sheet.right
    columns = _legend_columns(list(handles), WIDTH - 0.3)
    legend_height = -(-len(handles) // columns) * _LEGEND_ROW + 0.06 if handles else 0.0
    title_height = title_space(title, WIDTH)
    body = sum(sheet.heights) + sheet.row_gap * (len(sheet.heights) - 1)
    height = bottom + body + head + legend_height + title_height + 0.04
    figure.set_size_inches(WIDTH, height)
    scale = (inner - sheet.column_gap * (len(sheet.widths) - 1)) / sum(sheet.widths)
    y = bottom + body
    for row_height, row in zip(sheet.heights, sheet.axes, strict=True):
        y -= row_height
        x = sheet.left
        for share, panel in zip(sheet.widths, row, strict=False):
            panel.set_position((x / WIDTH, y / height, share * scale / WIDTH, row_height / height))
            _fewer_ticks(panel, share * scale, row_height)
            x += share * scale + sheet.column_gap
        y -= sheet.row_gap
    for row in sheet.axes:
        if len(row) > 0 and row[0].get_ylabel():
            for panel in row:
                panel.yaxis.set_label_coords(
                    -(0.56 if panel is row[0] else 0.48) / (panel.get_position().width * WIDTH), 0.5
                )
    for row_height, row in zip(sheet.heights, sheet.axes, strict=True):
        for panel in row:
            _fit_y_label(panel, row_height + 0.9 * sheet.row_gap)
    draw_title(figure, title, WIDTH, height)
    if handles:
        drawn = figure.legend(
            list(handles.values()),
            list(handles),
            loc="upper left",
            bbox_to_anchor=(0.15 / WIDTH, 1.0 - (title_height + 0.06) / height),
            ncols=columns,
            frameon=False,
            fontsize=TICK_SIZE,
            borderaxespad=0.0,
            borderpad=0.0,
            labelspacing=0.3,
            handlelength=2.2,
            columnspacing=1.6,
        )
        for mark in drawn.legend_handles:
            if isinstance(mark, Line2D) and mark.get_markersize() < _SMALLEST_MARK:
                mark.set_markersize(2.5 * mark.get_markersize())
    return figure


def title_space(title: str, width: float) -> float:
    """Return the height of a title in a figure of this width, inches; zero without a title."""
    return len(_title_lines(title, width)) * _TITLE_ROW + 0.11 if title else 0.0


def draw_title(figure: Figure, title: str, width: float, height: float) -> None:
    """Write a title at the top left of a figure of ``width`` by ``height`` inches."""
    for number, (line, bold) in enumerate(_title_lines(title, width) if title else ()):
        y = 1.0 - (0.08 + number * _TITLE_ROW) / height
        size, weight = (TITLE_SIZE, "bold") if bold else (LABEL_SIZE, "normal")
        text = figure.text(
            0.15 / width,
            y,
            escaped_dollars(line),
            fontsize=size,
            fontweight=weight,
            va="top",
            ha="left",
        )
        text.set_gid(TITLE if bold else None)


def bold_title(figure: Figure) -> str:
    """Return the bold lines of a figure's title in one; empty if it has none."""
    return " ".join(text.get_text() for text in figure.texts if text.get_gid() == TITLE)


def hide_bold_title(figure: Figure) -> float:
    """Hide the bold lines of a title, and return the height that they had, inches."""
    bold = [text for text in figure.texts if text.get_gid() == TITLE]
    for text in bold:
        text.set_visible(False)
    return len(bold) * _TITLE_ROW


def folded(text: str, width: float, points: float = LABEL_SIZE) -> list[str]:
    """Return a text in lines that fit ``width`` inches, broken at words."""
    return textwrap.wrap(
        text, max(8, int(width * TICK_SIZE / (_CHARACTER_WIDTH * points))), break_long_words=False
    )


def text_width(text: str, points: float = LABEL_SIZE) -> float:
    """Return the approximate width of a text, inches; the commands of mathtext count as one
    character each.
    """
    return (
        _CHARACTER_WIDTH
        * points
        / TICK_SIZE
        * len(re.sub(r"\\[a-zA-Z]+", "x", text).translate(_WITHOUT_WIDTH))
    )


@dataclass(frozen=True, eq=False)
class PanelsOverNames:
    """Small panels, up to three in a row, each with the same names along its x axis.

    If the names are too long for the axis, it has numbers, and a list of names is below the title.

    Attributes
    ----------
    sheet : the panels.
    names : names along each axis.
    kind : what the names denote, in one word, such as "study".
    title : the title, with the list of names if they are numbered.
    numbered : whether the names are numbered.
    """

    sheet: Sheet
    names: Sequence[str]
    kind: str
    title: str
    numbered: bool

    @classmethod
    def of(cls, count: int, names: Sequence[str], kind: str, title: str) -> PanelsOverNames:
        """Return ``count`` panels over ``names``."""
        columns = min(3, max(count, 1))
        sheet = make_sheet(
            [1.45] * -(-count // columns),
            (1.0,) * columns,
            count=count,
            row_gap=0.42,
            column_gap=0.62,
            left=0.66,
        )
        inner = WIDTH - sheet.left - sheet.right - sheet.column_gap * (columns - 1)
        width_per_name = inner / columns / max(len(names), 1)
        numbered = any(text_width(name, TICK_SIZE) > width_per_name for name in names)
        if numbered:
            title = "\n".join([title, *(f"{i}: {name}" for i, name in enumerate(names, start=1))])
        return cls(sheet, names, kind, title, numbered)

    def finished(self, head: float) -> Figure:
        """Return the figure with labelled axes; ``head``: space above the first row, inches."""
        labels = [
            str(number) if self.numbered else escaped_dollars(name)
            for number, name in enumerate(self.names, start=1)
        ]
        for panel in self.sheet.panels:
            panel.set_xticks(range(len(labels)), labels)
            panel.tick_params(labelbottom=True)
            panel.set_xlim(-0.6, len(labels) - 0.4)
            panel.grid(False, axis="x")
            panel.margins(y=0.12)
        for panel in self.sheet.panels[-len(self.sheet.widths) :] if self.numbered else ():
            panel.set_xlabel(f"{self.kind}, as numbered above", fontsize=TICK_SIZE)
        bottom = 0.5 if self.numbered else 0.3
        return finish(self.sheet, self.title, bottom=bottom, head=head)


def time_axis(panel: Axes) -> None:
    """Label the x axis as time."""
    panel.set_xlabel("time (s)", fontsize=LABEL_SIZE)


def y_label(panel: Axes, text: str, size: float = LABEL_SIZE) -> None:
    """Label the y axis."""
    panel.set_ylabel(text, fontsize=size)


def draw_estimate(panel: Axes, x: np.ndarray, mean: np.ndarray, std: np.ndarray) -> None:
    """Draw an estimate over ``x`` as a line with its band of two standard deviations."""
    low, high = mean - 2.0 * std, mean + 2.0 * std
    panel.fill_between(x, low, high, color=SKY, alpha=0.35, linewidth=0, label="±2σ")
    panel.plot(x, mean, color=BLUE, linewidth=1.2, label="estimate")


def draw_bar(
    panel: Axes, x: float, value: float, std: float, marker: str, colour: str, label: str
) -> None:
    """Draw a value with a bar of two standard deviations; without a bar if ``std`` is 0."""
    panel.errorbar(
        [x],
        [value],
        yerr=[2.0 * std] if std > 0.0 else None,
        fmt=marker,
        color=colour,
        markersize=4.5,
        linewidth=1.2,
        capsize=2.5,
        label=label,
    )


def caption(panel: Axes, text: str, size: float = TICK_SIZE) -> None:
    """Write a short line above a panel, at its left."""
    panel.set_title(text, fontsize=size, loc="left", pad=4.5, y=1.0)


def cells(panel: Axes, values: np.ndarray, **look: Any) -> QuadMesh:
    """Draw a square for each value and return the squares.

    Squares are centred on whole numbers, and the first row is on top. A masked value has none.

    Parameters
    ----------
    values : shape ``(rows, columns)``.
    look : properties of ``pcolormesh``.
    """
    rows, columns = values.shape
    edges = (np.arange(columns + 1) - 0.5, np.arange(rows + 1) - 0.5)
    mesh = panel.pcolormesh(*edges, values, antialiased=False, **look)
    panel.invert_yaxis()
    return mesh


def decades(axis: Axis, multiples: Sequence[float] = (1.0,)) -> None:
    """Label an axis with plain numbers at multiples of powers of ten."""
    axis.set_major_locator(LogLocator(subs=multiples, numticks=9))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, position: f"{value:g}"))


def _set_up(panel: Axes) -> None:
    """Give a new panel its grid, ticks and number format."""
    panel.grid(True, color=LIGHT, linewidth=0.5)
    panel.set_axisbelow(True)
    panel.tick_params(labelsize=TICK_SIZE, length=2.5, width=0.6)
    for side, spine in panel.spines.items():
        spine.set_linewidth(0.6)
        spine.set_visible(side in ("left", "bottom"))
    # a title at a stated height: looking for a free one is half the cost of drawing
    panel.set_title("", loc="left", y=1.0)
    for axis, bins in ((panel.xaxis, _MOST_TICKS[0]), (panel.yaxis, _MOST_TICKS[1])):
        formatter = ScalarFormatter(useOffset=axis is panel.xaxis, useMathText=False)
        formatter.set_powerlimits((-3, 5))
        axis.set_major_formatter(formatter)
        axis.set_major_locator(MaxNLocator(nbins=bins, steps=[1, 2, 2.5, 5, 10]))
        axis.get_offset_text().set_fontsize(TICK_SIZE)
    # The power of ten of the numbers must not overlap the caption.
    panel.yaxis.get_offset_text().set_horizontalalignment("right")
    panel.yaxis.get_offset_text().set_x(-0.02)


def _fewer_ticks(panel: Axes, width: float, height: float) -> None:
    """Limit the number of ticks to those that fit a panel of this size, inches."""
    for axis, most in (
        (panel.xaxis, max(3, min(_MOST_TICKS[0], int(width / 0.42)))),
        (panel.yaxis, max(2, min(_MOST_TICKS[1], int(height / 0.24)))),
    ):
        locator = axis.get_major_locator()
        if isinstance(locator, MaxNLocator):
            locator.set_params(nbins=most)


def _fit_y_label(panel: Axes, available: float) -> None:
    """Make the label of the y axis smaller if it is longer than ``available``, inches."""
    points = float(panel.yaxis.label.get_fontsize())
    length = text_width(panel.get_ylabel(), points)
    if length > available:
        panel.yaxis.label.set_fontsize(max(_SMALLEST_LABEL, points * available / length))


def _title_lines(title: str, width: float) -> list[tuple[str, bool]]:
    """Return the folded lines of a title, and whether each is bold."""
    first, *rest = title.split("\n")
    available_width = width - 0.3
    return [
        (line, True) for line in folded(first, available_width / _BOLD_WIDTH_RATIO, TITLE_SIZE)
    ] + [(line, False) for text in rest for line in folded(text, available_width)]


def _legend_columns(labels: Sequence[str], width: float) -> int:
    """Return the number of columns of a legend that fit a width, inches."""
    if not labels:
        return 1
    widths = [text_width(label, TICK_SIZE) + _HANDLE_WIDTH for label in labels]
    return len(labels) if sum(widths) <= width else max(1, int(width / max(widths)))
