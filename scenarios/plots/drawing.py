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
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline

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
    from matplotlib.backends.backend_svg import FigureCanvasSVG

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
DOT = 2  # cells in the diameter of a dot: of several dots in one cell a single one is drawn

# Letters stay text, in the font of the page.
_PAGE: dict[Any, Any] = _VECTOR | {
    "svg.fonttype": "none",
    "path.simplify_threshold": TOLERANCE,
}
_OF_FILE = re.compile(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", re.DOTALL)
_STYLE = re.compile(r' style="([^"]*)"')
_PATH = re.compile(r' d="([^"]*)"')
_FRACTION = re.compile(r"-?\d+\.\d+")
_IDENTIFIER = re.compile(r'( id="|url\(#|xlink:href="#)')
_MARK = re.compile(r'<path id="(\w+)" d="([^"]*)"[^>]*/>')
_USES = re.compile(r'(?:<use xlink:href="#(\w+)"[^>]*/>\s*)(?:<use xlink:href="#\1"[^>]*/>\s*)*')
_PLACE = re.compile(r' x="([^"]*)" y="([^"]*)"(?: style="([^"]*)")?')
_FONT = re.compile(
    r"(?P<font_style>italic|oblique)? ?(?P<font_weight>bold|[1-9]00)? ?(?P<font_size>[\d.]+)px"
)
_DROPPED = ("font-family", "font-variant", "font-stretch")


def drawn_for_page(figures: Iterable[Named], folder: Path, formats: Formats) -> tuple[Drawn, ...]:
    """Draw each figure once: into ``folder`` in every format, and for the page."""
    out = []
    for stem, make in figures:
        figure = make()
        save_figure(figure, folder, stem, formats)
        out.append(Drawn(stem, page_svg(figure, stem), caption_of(stem)))
    return tuple(out)


def page_svg(figure: Figure, stem: str) -> str:
    """The figure as an ``<svg>`` element of a page, as wide as its place; the same bytes for the
    same figure.

    Matplotlib's SVG with its styles as attributes, which the policy of a page allows and its
    rules for a dark ground replace, and with shorter numbers. ``stem`` begins the identifiers:
    figures of one page have different ones.
    """
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    buffer = io.BytesIO()
    figure.patch.set_visible(False)
    try:
        with rc_context(_PAGE):
            FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    finally:
        figure.patch.set_visible(True)
    text = buffer.getvalue().decode("utf-8")
    body = _OF_FILE.sub("", text[text.index(">", text.index("<svg")) + 1 :])
    body = _with_dots(re.sub(r"<g id=\"[^\"]*\"", "<g", body))
    body = _PATH.sub(_path_data, _STYLE.sub(_attributes, body))
    body = re.sub(r' transform="rotate\(-0 [^"]*\)"|<defs>\s*</defs>', "", body)
    body = _FRACTION.sub(lambda found: _decimal(float(found[0])), body)
    body = _IDENTIFIER.sub(rf"\g<1>figure-{stem}-", body).replace("xlink:href", "href")
    body = re.sub(r">\s+<", "><", body).strip()
    width, height = figure.get_size_inches() * POINTS
    mapped = bool(figure.findobj(QuadMesh))  # colours that stand for numbers stay as they are
    kinds = [*(["full"] if width > FULL else []), *(["mapped"] if mapped else [])]
    wide = f' class="{" ".join(kinds)}"' if kinds else ""
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{SCALE * width:.0f}" '
        f'height="{SCALE * height:.0f}"{wide} role="img" '
        f'aria-label="{escape(description(figure), quote=True)}">{body}'
    )


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
    return ' d="' + re.sub(r"\s*([A-Za-z])\s*", r"\1", data).strip() + '"'


def _with_dots(body: str) -> str:
    """Discs of one line as one path of strokes without length; other marks as they are."""
    shapes = {name: size for name, data in _MARK.findall(body) if (size := _diameter(data))}

    def dots(found: re.Match[str]) -> str:
        marks = _PLACE.findall(found[0])
        look = _declarations(marks[0][2])
        fill, edge = look.get("fill", "#000000"), look.get("stroke")
        one = all(style == marks[0][2] for _, _, style in marks)
        if found[1] not in shapes or not one or fill == "none" or edge not in (None, fill):
            return found[0]
        width = shapes[found[1]] + (float(look.get("stroke-width", 1.0)) if edge else 0.0)
        places = np.array([(x, y) for x, y, _ in marks], dtype=float)
        _, first = np.unique(np.round(places * (DOT / width)), axis=0, return_index=True)
        data = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in places[np.sort(first)].tolist())
        shine = look.get("fill-opacity") or look.get("opacity")
        clear = f"; stroke-opacity: {shine}" if shine else ""
        return (
            f'<path d="{data}" style="fill: none; stroke: {fill}; stroke-width: {width:.3g}; '
            f'stroke-linecap: round{clear}"/>'
        )

    body = _USES.sub(dots, body)
    used = set(re.findall(r'xlink:href="#(\w+)"', body))
    return _MARK.sub(lambda found: found[0] if found[1] in used else "", body)


def _diameter(data: str) -> float:
    """The diameter of a mark that is a disc, zero of any other."""
    if data.count("C") != 8:
        return 0.0
    points = np.array(re.findall(r"-?[\d.]+", data), dtype=float).reshape(-1, 2)
    width, height = np.ptp(points, axis=0).tolist()
    return float(width) if abs(width - height) < 1e-3 * width else 0.0


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
