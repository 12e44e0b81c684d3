"""Figures as bytes, files and text of a page, the same for the same figure: no date, no program version, no random name."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from scenarios.plots.formats import PDF, PNG, SVG, USUAL, Formats

Named = tuple[str, Callable[[], Figure]]  # the stem of a figure's file, and what draws it

# Letters as outlines in SVG, so that it looks alike everywhere; as TrueType in PDF, so that its text can be searched.
_VECTOR: dict[Any, Any] = {"svg.hashsalt": "flightid", "svg.fonttype": "path", "pdf.fonttype": 42}
_REFERENCE = re.compile(r'(\bid="|url\(#|href="#)')
# What only a file needs: its description, and a rule of style that would hold for the whole page.
_OF_FILE = re.compile(r"<metadata>.*?</metadata>\s*|<defs>\s*<style.*?</style>\s*</defs>\s*", re.DOTALL)


def save_figures(figures: Iterable[Named], folder: Path, formats: Formats = USUAL) -> list[Path]:
    """Draw each figure once and write ``folder/STEM.FORMAT`` in every format; the paths. The folder must exist."""
    if not formats:
        return []
    return [path for stem, make in figures for path in save_figure(make(), folder, stem, formats)]


def save_figure(figure: Figure, folder: Path, stem: str, formats: Formats = USUAL) -> list[Path]:
    """Write ``folder/stem.FORMAT`` in every format; the paths. The folder must exist."""
    paths = []
    for name in formats:
        path = Path(folder) / f"{stem}.{name}"
        path.write_bytes(_WRITERS[name](figure))
        paths.append(path)
    return paths


def figure_png(figure: Figure) -> bytes:
    """The figure as a PNG at its own size and resolution."""
    buffer = io.BytesIO()
    # None takes the entry out that names matplotlib's version.
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()


def figure_svg(figure: Figure) -> bytes:
    """The figure as an SVG file at its own size."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.BytesIO()
    with rc_context(_VECTOR):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def figure_pdf(figure: Figure) -> bytes:
    """The figure as a PDF of one page at its own size."""
    from matplotlib.backends.backend_pdf import FigureCanvasPdf  # it loads a library of fonts, which takes as long as a figure

    buffer = io.BytesIO()
    with rc_context(_VECTOR):
        FigureCanvasPdf(figure).print_pdf(buffer, metadata={"Creator": None, "Producer": None, "CreationDate": None})
    return buffer.getvalue()


def svg_text(figure: Figure, name: str = "figure", description: str = "") -> str:
    """The figure as an ``<svg>`` element to stand within a page; ``description`` is what a screen reader says.

    All its identifiers begin with ``name``: several figures of one page must have different ones.
    """
    text = figure_svg(figure).decode("utf-8")
    head, rest = _OF_FILE.sub("", text[text.index("<svg") :]).strip().split(">", 1)
    look = 'style="stroke-linejoin: round; stroke-linecap: butt"'
    named = _REFERENCE.sub(rf"\g<1>{name}-", rest)
    return f'{head} {look} role="img" aria-label="{escape(description or name, quote=True)}">{named}'


_WRITERS: Mapping[str, Callable[[Figure], bytes]] = {PNG: figure_png, SVG: figure_svg, PDF: figure_pdf}
