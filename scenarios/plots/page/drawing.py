"""A figure as an ``<svg>`` element of a page, with what a reader who cannot see it is told."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from scenarios.plots.files import Named, save_figure
from scenarios.plots.formats import Formats
from scenarios.plots.page.captions import caption_of
from scenarios.plots.page.named import FRAGMENT, Drawn, gathered
from scenarios.plots.page.renderer import PageRenderer
from scenarios.plots.page.sharing import shared_out

POINTS = 72.0
SCALE = 1.75  # pixels a point, where there is room
FULL = 400.0  # points: a wider figure is moved sideways on a small screen rather than made too small to read


def drawn_for_page(figures: Iterable[Named], folder: Path, formats: Formats) -> tuple[Drawn, ...]:
    """Draw each figure once: into ``folder`` in every format, and for the page; on two cores where that may be."""
    named = list(figures)
    leave_for_page(named, folder, formats)
    left = gathered(folder)
    return tuple(Drawn(stem, left[stem], caption_of(stem)) for stem, _ in named)


def leave_for_page(figures: Iterable[Named], folder: Path, formats: Formats) -> None:
    """The same, each element in a file of its own, for whoever makes the page to gather (``named.gathered``)."""
    shared_out([partial(_leave, stem, make, folder, formats) for stem, make in figures])


def _leave(stem: str, make: Callable[[], Figure], folder: Path, formats: Formats) -> None:
    figure = make()
    save_figure(figure, folder, stem, formats)
    (folder / f"{stem}{FRAGMENT}").write_text(page_svg(figure, stem), encoding="utf-8", errors="backslashreplace", newline="\n")


def page_svg(figure: Figure, stem: str) -> str:
    """The figure as an element that is as wide as its place and has no colours but those of the figure; the same for the same figure.

    ``stem`` begins its identifiers: figures of one page have different ones.
    """
    width, height = figure.get_size_inches() * POINTS
    dpi = figure.dpi
    renderer = PageRenderer(width, height, f"figure-{stem}")
    figure.patch.set_visible(False)
    try:
        figure.dpi = POINTS
        figure.draw(renderer)
    finally:
        figure.dpi = dpi
        figure.patch.set_visible(True)
    boxes = "".join(
        f'<clipPath id="{name}"><rect x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}"/></clipPath>' for (x, y, w, h), name in renderer.clips.items()
    )
    described = escape(description(figure), quote=True)
    size = f'viewBox="0 0 {width:g} {height:g}" width="{SCALE * width:.0f}" height="{SCALE * height:.0f}"'
    kinds = [*(["full"] if width > FULL else []), *(["mapped"] if renderer.mapped else [])]
    wide = f' class="{" ".join(kinds)}"' if kinds else ""
    head = f'<svg {size}{wide} role="img" aria-label="{described}">'
    return f"{head}{f'<defs>{boxes}</defs>' if boxes else ''}{''.join(renderer.parts)}</svg>"


def description(figure: Figure) -> str:
    """What a figure shows in words: its title, what its panels have at their axes, and what is drawn in them."""
    title = " ".join(text.get_text() for text in figure.texts).strip()
    panels = [panel for panel in figure.axes if panel.get_visible()]
    across = dict.fromkeys(label for panel in panels if (label := _plain(panel.get_xlabel())))
    upward = dict.fromkeys(label for panel in panels for label in (_plain(panel.get_ylabel()), _plain(panel.get_title(loc="left"))) if label)
    lines = dict.fromkeys(
        _plain(label) for panel in panels for label in panel.get_legend_handles_labels()[1] if label and not str(label).startswith("_")
    )
    told = [_plain(title) or "Figure"]
    against = f" against {', '.join(across)}" if across else ""
    told += [f"Panels: {', '.join(upward)}{against}"] if upward or across else []
    told += [f"Shown: {', '.join(lines)}"] if lines else []
    return ". ".join(told) + "."


def _plain(text: str) -> str:
    """A label without the marks of mathematics."""
    return " ".join(text.replace("\\mathrm", "").replace("\\dot", "").translate(str.maketrans("", "", "${}\\")).split())
