"""Correlations of estimated parameters as a map."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from scenarios.plots.display import symbol
from scenarios.plots.style import BLACK, DPI, GREY, LABEL_SIZE, TICK_SIZE, WIDTH, draw_title, text_width, title_space
from sim.errors import ModelError

LARGE, TOLD = 0.9, 0.5
_RIGHT, _COUNT = 1.0, 0.28  # inches


def figure_correlation(names: Sequence[str], correlation: np.ndarray, title: str = "", large: float = LARGE) -> Figure:
    """Heat map of a correlation matrix ``(n, n)``, lower triangle; pairs from ``TOLD`` on carry their number, those above ``large`` are framed.

    Entries that are not finite (a parameter of no variance) are left grey. Raises ModelError for fewer than two parameters.
    """
    n = len(names)
    if n < 2:
        raise ModelError(f"{n} parameter(s)", where="figure of correlations", remedy="draw it for two parameters or more")
    matrix = np.array(correlation, dtype=float)
    # The first row and the last column of the triangle are empty: they are not drawn.
    matrix, n = matrix[1:, :-1], n - 1
    below = np.tril(np.ones((n, n), dtype=bool))
    shown = np.ma.masked_where(~below | ~np.isfinite(matrix), matrix)
    labels = [symbol(name) for name in names]  # of the columns all but the last, of the rows all but the first
    size = LABEL_SIZE if n <= 20 else TICK_SIZE - 2.0
    left, bottom = (max([0.6, *(text_width(label, size) + 0.2 for label in some)]) for some in (labels[1:], labels[:-1]))
    cell = min(max(0.42, min(0.8, 2.0 / n)), (WIDTH - left - _RIGHT) / n)
    width = max(n * cell + left + _RIGHT, 5.0)
    head = title_space(title, width)
    height = max(n * cell, 1.2) + head + _COUNT + bottom
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    panel = figure.add_axes((left / width, bottom / height, n * cell / width, n * cell / height))
    image = panel.imshow(shown, cmap="RdBu_r", vmin=-1.0, vmax=1.0, interpolation="none", aspect="auto")
    number_size = min(TICK_SIZE, 27.0 * cell)
    for row, column in np.argwhere(below):
        value = matrix[row, column]
        if not np.isfinite(value):
            panel.add_patch(Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, facecolor=GREY, linewidth=0, antialiased=False))
        elif abs(value) >= TOLD:
            if abs(value) > large:
                panel.add_patch(Rectangle((column - 0.46, row - 0.46), 0.92, 0.92, fill=False, edgecolor=BLACK, linewidth=1.3))
            colour = "white" if abs(value) > 0.65 else BLACK
            panel.text(column, row, _short(value), ha="center", va="center", fontsize=number_size, color=colour)
    panel.set_xticks(range(n), labels[:-1], rotation=90, fontsize=size)
    panel.set_yticks(range(n), labels[1:], fontsize=size)
    panel.tick_params(length=0)
    for spine in panel.spines.values():
        spine.set_visible(False)
    bar = figure.colorbar(image, cax=figure.add_axes(((left + n * cell + 0.25) / width, bottom / height, 0.14 / width, n * cell / height)))
    bar.set_ticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    bar.set_label("correlation (–)", fontsize=LABEL_SIZE)
    bar.ax.tick_params(labelsize=TICK_SIZE)
    pairs = int(np.count_nonzero(below & (np.abs(np.nan_to_num(matrix)) > large)))
    counted = f"{pairs} of {n * (n + 1) // 2} pairs above {large:g} in size (framed)"
    draw_title(figure, title, width, height)
    figure.text(0.15 / width, 1.0 - (head + 0.04) / height, counted, fontsize=TICK_SIZE, va="top")
    return figure


def _short(value: float) -> str:
    """A correlation in as few characters as tell it: ``.87``, ``−.95``."""
    return f"{value:.2f}".replace("-", "−").replace("0.", ".")
