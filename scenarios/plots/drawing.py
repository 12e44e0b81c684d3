"""Write figures as files, as SVG elements of a page, and as data of interactive figures.

The same figure always gives the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from html import escape
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backend_bases import GraphicsContextBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG, RendererSVG
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from matplotlib.path import Path as Outline
from matplotlib.transforms import IdentityTransform, Transform

from scenarios.plots.style import bold_title, hide_bold_title
from scenarios.report.figure_formats import PDF, PNG, SVG, USUAL, Drawn, Formats, caption_of
from scenarios.report.plot_data import BAND, HELD, LINE, POINTS, Curve, Panel, PlotData, as_kept

MOST_CURVE_SAMPLES = 4000  # a longer curve keeps only the extremes of its intervals
MOST_INTERACTIVE_CURVES = 40  # a figure with more curves a panel, on average, is not interactive
# Identifier of texts that an interactive figure omits, since a table has them.
ORNAMENT = "ornament"
_SCALES = ("linear", "log")
# Values of matplotlib for no marker, a dot and a disc.
_MARKS = ("None", "none", None, "", " ", ".", "o")
_GREEK = {
    "alpha": "α",
    "beta": "β",
    "delta": "δ",
    "eta": "η",
    "omega": "ω",
    "phi": "φ",
    "psi": "ψ",
    "sigma": "σ",
    "tau": "τ",
    "theta": "θ",
    "zeta": "ζ",
}


def plot_data(figure: Figure) -> PlotData | None:
    """Return the data of an interactive figure, or None if the figure cannot be interactive.

    An interactive figure consists of curves over a rising abscissa: it has no bars, error bars,
    maps or texts in a panel. Long curves keep the smallest and the largest value of each interval.
    """
    panels = [panel for panel in figure.axes if panel.get_visible()]
    if not panels or not all(map(_plain_panel, panels)):
        return None
    tops = sorted({round(panel.get_position().y1, 3) for panel in panels}, reverse=True)
    lefts = sorted({round(panel.get_position().x0, 3) for panel in panels})
    panel_data = []
    for panel in panels:
        place = panel.get_position()
        curves = tuple(map(_thinned, _curves(panel)))
        if not any(curve.kind != BAND and len(curve.x) > 2 for curve in curves):
            return None
        shared = panel.get_shared_x_axes().get_siblings(panel)
        left, right = sorted(map(float, panel.get_xlim()))
        low, high = sorted(map(float, panel.get_ylim()))
        panel_data.append(
            Panel(
                words(panel.get_xlabel()),
                words(panel.get_ylabel()),
                words(panel.get_title(loc="left")),
                min(panels.index(other) for other in shared if other in panels),
                tops.index(round(place.y1, 3)),
                lefts.index(round(place.x0, 3)),
                float(place.height * figure.get_figheight()),
                (left, right),
                (low, high),
                curves,
                panel.get_xscale() == "log",
                panel.get_yscale() == "log",
            )
        )
    if sum(len(panel.curves) for panel in panel_data) > MOST_INTERACTIVE_CURVES * len(panel_data):
        return None
    return as_kept(PlotData(tuple(panel_data)))


def words(label: str) -> str:
    """Return a label without mathtext: ``$\\alpha$ (deg)`` becomes ``α (deg)``."""
    for name, letter in _GREEK.items():
        label = re.sub(rf"\\{name}(?![a-z])", letter, label)
    label = re.sub(r"\\(?:dot|mathrm|mathit)(?![a-z])", "", label)
    # Outside mathtext, underscores stay.
    plain = re.sub(r"\$([^$]*)\$", lambda match: re.sub(r"[{}_\\\s]", "", match[1]), label)
    return " ".join(plain.replace("$", "").split())


def _plain_panel(panel: Axes) -> bool:
    """Return whether a panel has only lines, points, bands and spans."""
    spans = [patch for patch in panel.patches if _span(panel, patch) is not None]
    bands = [area for area in panel.collections if _is_band(area)]
    plain_lines = all(
        line.get_marker() in _MARKS and line.get_drawstyle() in ("default", "steps-post")
        for line in panel.lines
    )
    return (
        panel.get_xscale() in _SCALES
        and panel.get_yscale() in _SCALES
        and all(text.get_gid() == ORNAMENT for text in panel.texts)
        and not (panel.images or panel.tables)
        and len(spans) == len(panel.patches)
        and len(bands) == len(panel.collections)
        and plain_lines
    )


def _is_band(artist: object) -> bool:
    """Return whether an artist is an area between two curves (``fill_between``)."""
    if not isinstance(artist, PolyCollection):
        return False
    return all(_is_band_outline(np.asarray(path.vertices)) for path in artist.get_paths())


def _is_band_outline(points: np.ndarray) -> bool:
    """Return whether an outline, ``(M, 2)``, goes along one curve and back along another.

    Both curves have the same abscissas. Matplotlib adds a point at each end and closes the outline.
    """
    count = (len(points) - 3) // 2
    return (
        len(points) >= 5
        and len(points) == 2 * count + 3
        and np.array_equal(points[1 : count + 1, 0], points[count + 2 : -1, 0][::-1])
    )


def _curves(panel: Axes) -> Iterator[Curve]:
    """Yield spans, bands and lines of a panel, in the order in which they are drawn."""
    for patch in panel.patches:
        span = _span(panel, patch)
        if span is not None:
            yield span
    for area in panel.collections:
        if isinstance(area, PolyCollection):
            yield from _bands(area)
    for line in panel.lines:
        curve = _curve(panel, line)
        if curve is not None:
            yield curve


def _label(text: object) -> str:
    """Return the legend label; empty for matplotlib's automatic labels (leading underscore)."""
    name = str(text or "")
    return "" if name.startswith("_") else words(name)


def _span(panel: Axes, patch: object) -> Curve | None:
    """Return a span over the whole panel as a band; None for other patches."""
    if not isinstance(patch, Rectangle | Polygon):
        return None
    points = np.asarray(patch.get_path().vertices)
    points = np.asarray(patch.get_patch_transform().transform(points))
    low, high = points.min(axis=0), points.max(axis=0)
    colour, label = to_hex(patch.get_facecolor()), _label(patch.get_label())
    if patch.get_data_transform() == panel.get_yaxis_transform(which="grid"):
        x = np.array(sorted(map(float, panel.get_xlim())))
        return Curve(label, BAND, colour, x, np.full(2, low[1]), top=np.full(2, high[1]))
    if patch.get_data_transform() == panel.get_xaxis_transform(which="grid"):
        bottom, top = sorted(map(float, panel.get_ylim()))
        x = np.array([low[0], high[0]])
        return Curve(label, BAND, colour, x, np.full(2, bottom), top=np.full(2, top))
    return None


def _bands(area: PolyCollection) -> Iterator[Curve]:
    """Yield the areas between two curves, from outlines as in ``_is_band_outline``."""
    colours = area.get_facecolor()
    for path in area.get_paths():
        points = np.asarray(path.vertices, dtype=float)
        count = (len(points) - 3) // 2
        x, first = points[1 : count + 1].T
        second = points[count + 2 : -1, 1][::-1]
        colour = to_hex(np.asarray(colours).reshape(-1, 4)[0])
        low, high = np.minimum(first, second), np.maximum(first, second)
        yield Curve(_label(area.get_label()), BAND, colour, x, low, top=high)


def _curve(panel: Axes, line: Line2D) -> Curve | None:
    """Return a line or its markers as a curve; None without samples."""
    x, y = (np.asarray(values, dtype=float) for values in line.get_data())
    if line.get_transform() == panel.get_yaxis_transform(which="grid"):
        x = np.array(sorted(map(float, panel.get_xlim())))
    elif line.get_transform() == panel.get_xaxis_transform(which="grid"):
        y = np.array(sorted(map(float, panel.get_ylim())))
    x = _distinct_abscissas(x, panel)
    finite = np.isfinite(x)
    x, y = x[finite], np.where(np.isfinite(y), y, np.nan)[finite]
    if not x.size:
        return None
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    label, colour = _label(line.get_label()), to_hex(line.get_color())
    if str(line.get_linestyle()) in ("None", "none", " ", ""):
        return Curve(label, POINTS, colour, x, y, float(line.get_markersize()), ())
    kind = HELD if line.get_drawstyle() == "steps-post" else LINE
    return Curve(label, kind, colour, x, y, float(line.get_linewidth()), _dash(line))


def _distinct_abscissas(x: np.ndarray, panel: Axes) -> np.ndarray:
    """Return the abscissas of a line; those of a vertical line become less than a pixel apart.

    A page merges all curves over one abscissa, and would drop one of two equal abscissas.
    """
    if x.size != 2 or x[0] != x[1]:
        return x
    left, right = panel.get_xlim()
    # The second term keeps the abscissas distinct after rounding of a large number.
    return np.array([x[0], x[0] + max(1e-5 * abs(right - left), 2e-11 * abs(x[0]))])


_USUAL_DASH = (4.0, 2.0)  # points, lengths of stroke and gap


def _dash(line: Line2D) -> tuple[float, ...]:
    """Return the lengths of strokes and gaps in points; empty for a solid line."""
    if not line.is_dashed():
        return ()
    lengths = getattr(line, "_dash_pattern", (0, None))[1]  # no public access in matplotlib
    return tuple(map(float, lengths)) if lengths else _USUAL_DASH


def _thinned(curve: Curve) -> Curve:
    """Return a curve; of a long one only the smallest and the largest value of each interval."""
    if len(curve.x) <= MOST_CURVE_SAMPLES:
        return curve
    edges = np.linspace(0, len(curve.x), MOST_CURVE_SAMPLES // 2 + 1).astype(int)
    chosen: list[int] = []
    for start, stop in pairwise(edges.tolist()):
        part = curve.y[start:stop]
        if np.all(np.isnan(part)):
            chosen.append(int(start))
            continue
        chosen += sorted({start + int(np.nanargmin(part)), start + int(np.nanargmax(part))})
    samples = np.array(chosen)
    top = None if curve.top is None else curve.top[samples]
    return replace(curve, x=curve.x[samples], y=curve.y[samples], top=top)


# ---- Figures as bytes

Named = tuple[str, Callable[[], Figure]]  # file stem, drawing function

# SVG: letters as outlines, which look alike everywhere. PDF: TrueType, which can be searched.
_VECTOR: dict[Any, Any] = {"svg.hashsalt": "flightid", "svg.fonttype": "path", "pdf.fonttype": 42}


def save_figure(figure: Figure, folder: Path, stem: str, formats: Formats = USUAL) -> list[Path]:
    """Write ``folder/stem.FORMAT`` in every format; return the paths. The folder must exist."""
    paths = []
    for format_name in formats:
        path = Path(folder) / f"{stem}.{format_name}"
        path.write_bytes(_WRITERS[format_name](figure))
        paths.append(path)
    return paths


def figure_png(figure: Figure) -> bytes:
    """Return the figure as a PNG at its own size and resolution."""
    buffer = io.BytesIO()
    # None removes the entry with matplotlib's version.
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()


def figure_svg(figure: Figure) -> bytes:
    """Return the figure as an SVG file at its own size."""
    buffer = io.BytesIO()
    with rc_context(_VECTOR):
        FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def figure_pdf(figure: Figure) -> bytes:
    """Return the figure as a PDF of one page at its own size."""
    # Imported here, since its font library loads slowly.
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

POINTS_PER_INCH = 72.0
PIXELS_PER_POINT = 1.75  # scale on a wide screen
# On a small screen, figures of more points in width scroll; others shrink.
WIDEST_SCALED_FIGURE = 400.0
LONG_OUTLINE = 128  # outlines with more vertices are simplified
OUTLINE_TOLERANCE = 0.25  # largest error of a simplified line, points: a quarter of its width
DISC_ARCS = 8  # arcs in matplotlib's outline of a disc
# A grid divides the diameter of a dot into this many cells; each cell gets at most one dot.
CELLS_PER_DOT = 2
TALLEST_ASPECT = 1.15  # largest height over width of a printed drawing
PRINTED_HEIGHT_SHARE = 0.85  # least height of a printed panel over its height on the screen
# In an SVG element of a page, letters stay text in the font of the page.
_PAGE: dict[Any, Any] = _VECTOR | {
    "svg.fonttype": "none",
    "path.simplify_threshold": OUTLINE_TOLERANCE,
}
_FILE_PARTS = re.compile(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", re.DOTALL)
_STYLE = re.compile(r' style="([^"]*)"')
_PATH = re.compile(r' d="([^"]*)"')
_FRACTION = re.compile(r"-?\d+\.\d+")
_TAG = re.compile(r"<[^>]*>")  # only numbers inside tags are shortened
_IDENTIFIER = re.compile(r'( id="|url\(#|xlink:href="#)')
_FONT = re.compile(
    r"(?P<font_style>italic|oblique)? ?(?P<font_weight>bold|[1-9]00)? ?(?P<font_size>[\d.]+)px"
)
_DROPPED = ("font-family", "font-variant", "font-stretch")


def draw_for_page(
    figures: Iterable[Named],
    folder: Path,
    formats: Formats,
    methods: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Drawn, ...]:
    """Draw each figure once: into ``folder`` in every format, and for the page.

    The page omits a title that an earlier figure has.

    Parameters
    ----------
    figures : file stem and drawing function of each figure.
    folder : folder of the files.
    formats : formats of the files.
    methods : label by method; a stem may end in the name of a method.
    """
    drawn, titles = [], set[str]()
    for stem, make in figures:
        figure = make()
        if not save_figure(figure, folder, stem, formats):
            figure.draw_without_rendering()  # places artists shared between panels
        data = plot_data(figure)
        title = bold_title(figure)
        cut = hide_bold_title(figure) if title and title in titles else 0.0
        titles |= {title}
        draw = page_svg if data is None else _print_svg
        svg = draw(figure, stem, cut)
        drawn.append(Drawn(stem, svg, caption_of(stem, methods=methods), data))
    return tuple(drawn)


def _print_svg(figure: Figure, stem: str, cut: float) -> str:
    """Return the drawing that replaces an interactive figure on paper; ``cut`` as in `page_svg`.

    The panels of a tall figure become lower so that it fits a sheet, but keep
    ``PRINTED_HEIGHT_SHARE`` of their height, so that labels do not overlap. If the figure is then
    still too tall, it is drawn smaller.
    """
    width, height = figure.get_size_inches()
    if height > TALLEST_ASPECT * width:
        wider = max(width, PRINTED_HEIGHT_SHARE * height / TALLEST_ASPECT)
        figure.set_size_inches(wider, TALLEST_ASPECT * wider)
    try:
        return page_svg(figure, stem, cut * figure.get_figheight() / height)
    finally:
        figure.set_size_inches(width, height)


def figure_document(figure: Figure, words: str) -> str:
    """Return a figure as an HTML document, interactive if ``plot_data`` is not None.

    ``words``: description of the figure.
    """
    from scenarios.report.document import Figure as Block
    from scenarios.report.html import figure_html

    svg = page_svg(figure, "alone")  # before plot_data, since it places artists of several panels
    return figure_html(Block("figure-alone", svg, words, plot_data(figure)))


def figure_frame(document: str, words: str, height: int) -> str:
    """Return an HTML document as a frame in a notebook, at full width.

    Parameters
    ----------
    document : text of the document. It is embedded: a separate file might be deleted too early.
    words : description for screen readers.
    height : height of the frame, px.

    Examples
    --------
    >>> figure_frame("<p>a & b</p>", "two letters", 300)[:48]
    '<iframe title="two letters" srcdoc="&lt;p&gt;a &'
    """
    inside, title = (escape(text, quote=True) for text in (document, words))
    style = f"width: 100%; height: {height}px; border: 0; display: block"
    return f'<iframe title="{title}" srcdoc="{inside}" style="{style}"></iframe>'


def page_svg(figure: Figure, stem: str, cut: float = 0.0) -> str:
    """Return the figure as an ``<svg>`` element at full width; the same bytes for the same figure.

    It is matplotlib's SVG with shorter numbers, and with attributes in place of styles: the
    security policy of a page allows no styles, and its dark theme can replace attributes.

    Parameters
    ----------
    figure : the figure.
    stem : unique prefix of the identifiers.
    cut : inches that are cut off at the top.
    """
    buffer, dpi = io.StringIO(), figure.dpi
    width, height = (figure.get_size_inches() * POINTS_PER_INCH).tolist()
    figure.patch.set_visible(False)
    try:
        with rc_context(_PAGE):
            metadata = {"Date": None, "Creator": None}
            figure.dpi = POINTS_PER_INCH
            renderer = PageRenderer(width, height, buffer, metadata=metadata)
            figure.draw(renderer)
            renderer.finalize()
    finally:
        figure.dpi = dpi
        figure.patch.set_visible(True)
    text = buffer.getvalue()
    body = _FILE_PARTS.sub("", text[text.index(">", text.index("<svg")) + 1 :])
    body = re.sub(r"<g id=\"[^\"]*\"", "<g", body)
    body = _PATH.sub(_path_data, _STYLE.sub(_attributes, body))
    body = re.sub(r' transform="rotate\(-0 [^"]*\)"|<defs>\s*</defs>', "", body)
    body = _TAG.sub(_short_numbers, body)
    body = _IDENTIFIER.sub(rf"\g<1>figure-{stem}-", body).replace("xlink:href", "href")
    body = re.sub(r">\s+<", "><", body).strip()
    classes = []
    if width > WIDEST_SCALED_FIGURE:
        classes.append("full")
    if figure.findobj(QuadMesh):  # colours of a map are data: the dark theme keeps them
        classes.append("mapped")
    class_attribute = f' class="{" ".join(classes)}"' if classes else ""
    top = cut * POINTS_PER_INCH
    visible = height - top
    return (
        f'<svg viewBox="0 {top:g} {width:g} {visible:g}" width="{PIXELS_PER_POINT * width:.0f}" '
        f'height="{PIXELS_PER_POINT * visible:.0f}"{class_attribute} role="img" '
        f'aria-label="{escape(description(figure), quote=True)}">{body}'
    )


def _short_numbers(tag: re.Match[str]) -> str:
    return _FRACTION.sub(lambda number: _decimal(float(number[0])), tag[0])


def _decimal(value: float) -> str:
    """Return a number with at most two decimals."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _declarations(style: str) -> dict[str, str]:
    pairs = (part.partition(":") for part in style.split(";") if part.strip())
    return {name.strip(): value.strip() for name, _, value in pairs}


def _attributes(match: re.Match[str]) -> str:
    """Return a style as attributes, without the names of fonts."""
    values = _declarations(match[1])
    if font := _FONT.search(values.pop("font", "")):  # matplotlib before 3.11
        values |= {key: value for key, value in font.groupdict().items() if value}
    values = {key.replace("_", "-"): value for key, value in values.items()}
    return "".join(
        f' {name}="{value.removesuffix("px")}"'
        for name, value in values.items()
        if name not in _DROPPED
    )


def _path_data(match: re.Match[str]) -> str:
    """Return path data with one decimal; long outlines without curves are simplified."""
    data = match[1]
    if data.count("L") >= LONG_OUTLINE and data.count("M") == 1 and data.rstrip().endswith("z"):
        numbers = np.array(re.findall(r"-?[\d.]+", data), dtype=float).reshape(-1, 2)
        line = Outline(numbers)
        line.should_simplify, line.simplify_threshold = True, OUTLINE_TOLERANCE
        clean = line.cleaned(simplify=True)
        points = np.asarray(clean.vertices)[np.asarray(clean.codes) != Outline.STOP].tolist()
        data = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points) + "z"
    else:
        data = _FRACTION.sub(lambda number: f"{float(number[0]):.1f}", data)
    data = re.sub(r"\s*([A-Za-z])\s*", r"\1", data).strip()
    return ' d="' + re.sub(r"M([^A-Za-z]+)L\1(?=M|$)", r"M\1h0", data) + '"'


class PageRenderer(RendererSVG):
    """SVG renderer that draws all disc markers of a line as a single path.

    The path has a stroke of length zero for each disc. Of discs that overlap much, one is drawn
    (``CELLS_PER_DOT``). Matplotlib would write an element for each marker.
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
        """Draw the markers of a line; other markers than discs of one colour as matplotlib does."""
        size = 0.0 if rgbFace is None else _diameter(marker_path, marker_trans)
        edge = gc.get_linewidth()
        if not size or (edge and to_hex(gc.get_rgb()) != to_hex(rgbFace)):
            super().draw_markers(gc, marker_path, marker_trans, path, trans, rgbFace)
            return
        points = np.asarray(trans.transform(path.vertices))
        points = points[np.all(np.isfinite(points), axis=1)]
        _, first = np.unique(
            np.round(points * (CELLS_PER_DOT / (size + edge))), axis=0, return_index=True
        )
        strokes = np.repeat(points[np.sort(first)], 2, axis=0)
        codes = np.tile([Outline.MOVETO, Outline.LINETO], len(first))
        stroke_style = self.new_gc()
        stroke_style.copy_properties(gc)
        stroke_style.set_linewidth(size + edge)
        stroke_style.set_capstyle("round")
        stroke_style.set_foreground(rgbFace)
        stroke_style.set_dashes(0.0, None)
        dots = Outline(strokes, codes)
        dots.should_simplify = False
        self.draw_path(stroke_style, dots, IdentityTransform())


def _diameter(mark: Outline, transform: Transform) -> float:
    """Return the diameter of a marker if it is a disc, else zero; in the unit of the drawing."""
    if mark.codes is None or np.count_nonzero(mark.codes == Outline.CURVE4) < 3 * DISC_ARCS:
        return 0.0
    width, height = np.ptp(mark.get_extents(transform).get_points(), axis=0).tolist()
    return float(width) if abs(width - height) < 1e-6 * width else 0.0


def description(figure: Figure) -> str:
    """Return a figure's description in words: title, axes and content of its panels."""
    title = " ".join(text.get_text() for text in figure.texts).strip()
    panels = [panel for panel in figure.axes if panel.get_visible()]
    x_labels = dict.fromkeys(
        label for panel in panels if (label := _without_math(panel.get_xlabel()))
    )
    y_labels = dict.fromkeys(
        label
        for panel in panels
        for label in (_without_math(panel.get_ylabel()), _without_math(panel.get_title(loc="left")))
        if label
    )
    lines = dict.fromkeys(
        _without_math(label)
        for panel in panels
        for label in panel.get_legend_handles_labels()[1]
        if label and not str(label).startswith("_")
    )
    sentences = [_without_math(title) or "Figure"]
    against = f" against {', '.join(x_labels)}" if x_labels else ""
    if y_labels or x_labels:
        sentences.append(f"Panels: {', '.join(y_labels)}{against}")
    if lines:
        sentences.append(f"Shown: {', '.join(lines)}")
    return ". ".join(sentences) + "."


def _without_math(text: str) -> str:
    return " ".join(
        text.replace("\\mathrm", "")
        .replace("\\dot", "")
        .translate(str.maketrans("", "", "${}\\"))
        .split()
    )
