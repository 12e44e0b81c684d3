"""Figures as files and as SVG elements of a page, the same bytes for the same figure."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backend_bases import GraphicsContextBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG, RendererSVG
from matplotlib.collections import QuadMesh
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline
from matplotlib.transforms import IdentityTransform, Transform

from scenarios.plots.interactive import plot_data
from scenarios.report.figure_formats import PDF, PNG, SVG, USUAL, Drawn, Formats, caption_of

# ---- Figures as bytes

Named = tuple[str, Callable[[], Figure]]  # the stem of a figure's file, and what draws it

# Letters as outlines in SVG, so that it looks alike everywhere; as TrueType in PDF, so that its
# text can be searched.
_VECTOR: dict[Any, Any] = {"svg.hashsalt": "flightid", "svg.fonttype": "path", "pdf.fonttype": 42}


def save_figures(figures: Iterable[Named], folder: Path, formats: Formats = USUAL) -> list[Path]:
    """Draw each figure once and write ``folder/STEM.FORMAT`` in every format; the paths. The folder
    must exist.
    """
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
    buffer = io.BytesIO()
    with rc_context(_VECTOR):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def figure_pdf(figure: Figure) -> bytes:
    """The figure as a PDF of one page at its own size."""
    # it loads a library of fonts, which takes as long as a figure
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    buffer = io.BytesIO()
    with rc_context(_VECTOR):
        FigureCanvasPdf(figure).print_pdf(
            buffer, metadata={"Creator": None, "Producer": None, "CreationDate": None}
        )
    return buffer.getvalue()


_WRITERS: Mapping[str, Callable[[Figure], bytes]] = {
    PNG: figure_png,
    SVG: figure_svg,
    PDF: figure_pdf,
}


# ---- A figure as an <svg> element of a page, with a description for screen readers

POINTS = 72.0
SCALE = 1.75  # pixels a point, where there is room
# points: a wider figure is moved sideways on a small screen rather than made too small to read
FULL = 400.0
LONG = 128  # vertices from which the outline of an area is simplified
TOLERANCE = 0.25  # points by which a simplified line may be off, a quarter of its width
ARCS = 8  # curves of matplotlib's disc
DOT = 2  # cells in the diameter of a dot: of several dots in one cell a single one is drawn

TALLEST = 1.15  # height over width of a drawing that is printed
LOWEST = 0.5  # height of a printed panel over that on the screen
# Letters stay text, in the font of the page.
_PAGE: dict[Any, Any] = _VECTOR | {
    "svg.fonttype": "none",
    "path.simplify_threshold": TOLERANCE,
}
_OF_FILE = re.compile(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", re.DOTALL)
_STYLE = re.compile(r' style="([^"]*)"')
_PATH = re.compile(r' d="([^"]*)"')
_FRACTION = re.compile(r"-?\d+\.\d+")
_TAG = re.compile(r"<[^>]*>")  # places are shortened, numbers that are read are not
_IDENTIFIER = re.compile(r'( id="|url\(#|xlink:href="#)')
_FONT = re.compile(
    r"(?P<font_style>italic|oblique)? ?(?P<font_weight>bold|[1-9]00)? ?(?P<font_size>[\d.]+)px"
)
_DROPPED = ("font-family", "font-variant", "font-stretch")


def drawn_for_page(figures: Iterable[Named], folder: Path, formats: Formats) -> tuple[Drawn, ...]:
    """Draw each figure once: into ``folder`` in every format, and for the page."""
    out = []
    for stem, make in figures:
        figure = make()
        if not save_figure(figure, folder, stem, formats):
            figure.draw_without_rendering()  # it places what is shared between panels
        data = plot_data(figure)
        svg = page_svg(figure, stem) if data is None else _for_a_sheet(figure, stem)
        out.append(Drawn(stem, svg, caption_of(stem), data))
    return tuple(out)


def _for_a_sheet(figure: Figure, stem: str) -> str:
    """The drawing of a figure that is live on the screen, for paper: one that is tall has lower
    panels, so that it fits a sheet at its full width.

    Panels keep half of their height: with more of them all is drawn smaller instead, since labels
    would stand upon each other.
    """
    width, height = figure.get_size_inches()
    if height > TALLEST * width:
        wide = max(width, LOWEST * height / TALLEST)
        figure.set_size_inches(wide, TALLEST * wide)
    try:
        return page_svg(figure, stem)
    finally:
        figure.set_size_inches(width, height)


def figure_document(figure: Figure, words: str) -> str:
    """A figure as an HTML document of its own that zooms and shows values under the pointer, with
    the drawing alone where its curves cannot be taken from it. ``words``: what it shows.
    """
    from scenarios.report.document import Figure as Block
    from scenarios.report.html import figure_html

    svg = page_svg(figure, "alone")  # drawn first: it places what is shared between panels
    return figure_html(Block("figure-alone", svg, words, plot_data(figure)))


def figure_frame(document: str, words: str, height: int) -> str:
    """An HTML document as a frame of a notebook's page, as wide as its place.

    Parameters
    ----------
    document : the document; the frame holds it itself, because a file beside the notebook may be
        gone before the frame has read it.
    words : what the figure shows, for those who do not see it.
    height : of the frame, px.

    Examples
    --------
    >>> figure_frame("<p>a & b</p>", "two letters", 300)[:48]
    '<iframe title="two letters" srcdoc="&lt;p&gt;a &'
    """
    inside, title = (escape(text, quote=True) for text in (document, words))
    style = f"width: 100%; height: {height}px; border: 0; display: block"
    return f'<iframe title="{title}" srcdoc="{inside}" style="{style}"></iframe>'


def page_svg(figure: Figure, stem: str) -> str:
    """The figure as an ``<svg>`` element of a page, as wide as its place; the same bytes for the
    same figure.

    Matplotlib's SVG with its styles as attributes, which the policy of a page allows and its
    rules for a dark ground replace, and with shorter numbers. ``stem`` begins the identifiers:
    figures of one page have different ones.
    """
    buffer, dpi = io.StringIO(), figure.dpi
    width, height = (figure.get_size_inches() * POINTS).tolist()
    figure.patch.set_visible(False)
    try:
        with rc_context(_PAGE):
            metadata = {"Date": None, "Creator": None}
            figure.dpi = POINTS
            renderer = PageRenderer(width, height, buffer, metadata=metadata)
            figure.draw(renderer)
            renderer.finalize()
    finally:
        figure.dpi = dpi
        figure.patch.set_visible(True)
    text = buffer.getvalue()
    body = _OF_FILE.sub("", text[text.index(">", text.index("<svg")) + 1 :])
    body = re.sub(r"<g id=\"[^\"]*\"", "<g", body)
    body = _PATH.sub(_path_data, _STYLE.sub(_attributes, body))
    body = re.sub(r' transform="rotate\(-0 [^"]*\)"|<defs>\s*</defs>', "", body)
    body = _TAG.sub(_short_numbers, body)
    body = _IDENTIFIER.sub(rf"\g<1>figure-{stem}-", body).replace("xlink:href", "href")
    body = re.sub(r">\s+<", "><", body).strip()
    mapped = bool(figure.findobj(QuadMesh))  # colours that stand for numbers stay as they are
    kinds = [*(["full"] if width > FULL else []), *(["mapped"] if mapped else [])]
    wide = f' class="{" ".join(kinds)}"' if kinds else ""
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{SCALE * width:.0f}" '
        f'height="{SCALE * height:.0f}"{wide} role="img" '
        f'aria-label="{escape(description(figure), quote=True)}">{body}'
    )


def _short_numbers(tag: re.Match[str]) -> str:
    return _FRACTION.sub(lambda found: _decimal(float(found[0])), tag[0])


def _decimal(value: float) -> str:
    """With two decimals at most."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _declarations(style: str) -> dict[str, str]:
    pairs = (part.partition(":") for part in style.split(";") if part.strip())
    return {name.strip(): value.strip() for name, _, value in pairs}


def _attributes(found: re.Match[str]) -> str:
    """A style as attributes; the font is that of the page."""
    known = _declarations(found[1])
    if font := _FONT.search(known.pop("font", "")):  # of matplotlib before 3.11
        known |= {key: value for key, value in font.groupdict().items() if value}
    known = {key.replace("_", "-"): value for key, value in known.items()}
    return "".join(
        f' {name}="{value.removesuffix("px")}"'
        for name, value in known.items()
        if name not in _DROPPED
    )


def _path_data(found: re.Match[str]) -> str:
    """Path data with one decimal; a long outline without curves simplified as lines are."""
    data = found[1]
    if data.count("L") >= LONG and data.count("M") == 1 and data.rstrip().endswith("z"):
        numbers = np.array(re.findall(r"-?[\d.]+", data), dtype=float).reshape(-1, 2)
        line = Outline(numbers)
        line.should_simplify, line.simplify_threshold = True, TOLERANCE
        clean = line.cleaned(simplify=True)
        points = np.asarray(clean.vertices)[np.asarray(clean.codes) != Outline.STOP].tolist()
        data = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points) + "z"
    else:
        data = _FRACTION.sub(lambda number: f"{float(number[0]):.1f}", data)
    data = re.sub(r"\s*([A-Za-z])\s*", r"\1", data).strip()
    return ' d="' + re.sub(r"M([^A-Za-z]+)L\1(?=M|$)", r"M\1h0", data) + '"'


class PageRenderer(RendererSVG):
    """Matplotlib's SVG with the discs of a line as one path of strokes without length, where it has
    an element for each; of discs that cover each other to a part of ``DOT`` one is drawn.
    """

    def draw_markers(
        self,
        gc: GraphicsContextBase,
        marker_path: Outline,
        marker_trans: Transform,
        path: Outline,
        trans: Transform,
        rgbFace: Any = None,
    ) -> None:
        """Marks of a line; those that are no discs of one colour as matplotlib draws them."""
        size = 0.0 if rgbFace is None else _diameter(marker_path, marker_trans)
        edge = gc.get_linewidth()
        if not size or (edge and to_hex(gc.get_rgb()) != to_hex(rgbFace)):
            super().draw_markers(gc, marker_path, marker_trans, path, trans, rgbFace)
            return
        points = np.asarray(trans.transform(path.vertices))
        points = points[np.all(np.isfinite(points), axis=1)]
        _, first = np.unique(np.round(points * (DOT / (size + edge))), axis=0, return_index=True)
        strokes = np.repeat(points[np.sort(first)], 2, axis=0)
        codes = np.tile([Outline.MOVETO, Outline.LINETO], len(first))
        look = self.new_gc()
        look.copy_properties(gc)
        look.set_linewidth(size + edge)
        look.set_capstyle("round")
        look.set_foreground(rgbFace)
        look.set_dashes(0.0, None)
        dots = Outline(strokes, codes)
        dots.should_simplify = False
        self.draw_path(look, dots, IdentityTransform())


def _diameter(mark: Outline, transform: Transform) -> float:
    """The diameter of a mark that is a disc, zero of any other."""
    if mark.codes is None or np.count_nonzero(mark.codes == Outline.CURVE4) < 3 * ARCS:
        return 0.0
    width, height = np.ptp(mark.get_extents(transform).get_points(), axis=0).tolist()
    return float(width) if abs(width - height) < 1e-6 * width else 0.0


def description(figure: Figure) -> str:
    """What a figure shows in words: its title, what its panels have at their axes, and what is
    drawn in them.
    """
    title = " ".join(text.get_text() for text in figure.texts).strip()
    panels = [panel for panel in figure.axes if panel.get_visible()]
    across = dict.fromkeys(label for panel in panels if (label := _plain(panel.get_xlabel())))
    upward = dict.fromkeys(
        label
        for panel in panels
        for label in (_plain(panel.get_ylabel()), _plain(panel.get_title(loc="left")))
        if label
    )
    lines = dict.fromkeys(
        _plain(label)
        for panel in panels
        for label in panel.get_legend_handles_labels()[1]
        if label and not str(label).startswith("_")
    )
    told = [_plain(title) or "Figure"]
    against = f" against {', '.join(across)}" if across else ""
    told += [f"Panels: {', '.join(upward)}{against}"] if upward or across else []
    told += [f"Shown: {', '.join(lines)}"] if lines else []
    return ". ".join(told) + "."


def _plain(text: str) -> str:
    """A label without the marks of mathematics."""
    return " ".join(
        text.replace("\\mathrm", "")
        .replace("\\dot", "")
        .translate(str.maketrans("", "", "${}\\"))
        .split()
    )
