"""Renderer of a figure as the content of an SVG element within a page.

Smaller by an order of magnitude than the file that the plotting library writes: no identifier but
of what is referred to, the marks of one line as one path, letters as text. Colours are attributes,
so that the page's own rules may replace them on a dark ground.
"""

from __future__ import annotations

from functools import lru_cache
from html import escape
from typing import Any

import numpy as np
from matplotlib.backend_bases import GraphicsContextBase, RendererBase
from matplotlib.colors import to_hex
from matplotlib.font_manager import FontProperties, ttfFontProperty, weight_dict
from matplotlib.path import Path as Outline
from matplotlib.transforms import Affine2D, Transform

# ---- Outlines and lines as the path data of an SVG

TENTHS = 10.0  # parts of a point: a tenth is a sixth of a pixel where a figure is as wide as a page
LONG = 128  # vertices from which a line is simplified
TOLERANCE = 0.25  # points by which a simplified line may be off, a quarter of its width
DOT = 2  # cells that the diameter of a dot has: of several dots in one cell a single one is drawn

_LETTERS = {Outline.MOVETO: "m", Outline.LINETO: "l", Outline.CURVE3: "q", Outline.CURVE4: "c"}
_POINTS = {Outline.CURVE3: 2, Outline.CURVE4: 3}


def path_data(path: Outline, transform: Transform, *, filled: bool) -> str:
    """The path after ``transform`` into page coordinates (points, y down); empty where nothing of
    it is finite.

    Long lines are simplified to within ``TOLERANCE``; so are long outlines of areas, which are
    closed again.
    """
    vertices = np.asarray(path.vertices, dtype=float)
    straight = path.codes is None or not np.any(
        np.isin(path.codes, (Outline.CURVE3, Outline.CURVE4))
    )
    long = len(vertices) >= LONG and straight
    source = Outline(vertices, path.codes)
    closed = filled and long
    if closed:
        ends = (
            np.flatnonzero(path.codes == Outline.CLOSEPOLY)
            if path.codes is not None
            else np.array([], dtype=int)
        )
        if len(ends) > 1 or (len(ends) == 1 and ends[0] != len(vertices) - 1):
            closed = long = False  # several areas in one path are left as they are
        elif len(ends):
            source = Outline(vertices[:-1])
    if long:
        source.should_simplify = True
        source.simplify_threshold = TOLERANCE
    clean = source.cleaned(transform=transform, remove_nans=True, simplify=long, curves=True)
    return _text(*_arrays(clean)) + ("z" if closed else "")


def dots_data(points: np.ndarray, size: float) -> str:
    """Dots of a diameter at ``points (n, 2)`` as strokes of no length; dots that cover each other
    to a part of ``DOT`` are one.
    """
    points = points[np.all(np.isfinite(points), axis=1)]
    if not len(points):
        return ""
    _, first = np.unique(np.round(points * (DOT / size)), axis=0, return_index=True)
    return _moves(points[np.sort(first)], "h0")


def marks_data(points: np.ndarray, mark: Outline, transform: Transform) -> str:
    """The same outline at each of ``points (n, 2)``."""
    shape = mark.cleaned(transform=transform + Affine2D().scale(1.0, -1.0), curves=True)
    vertices, codes = _arrays(shape)
    if not len(vertices):
        return ""
    start = vertices[0]
    further = _text(vertices, codes, hundredths=True)
    further = further[_end_of_first(further) :]
    # A pen that has drawn a mark stands at its end: each begins at its own absolute place.
    points = points[np.all(np.isfinite(points), axis=1)] + start
    return "".join(f"M{x:.2f} {y:.2f}{further}" for x, y in points.tolist())


def _arrays(path: Outline) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(path.vertices, dtype=float), np.asarray(path.codes)


def _end_of_first(text: str) -> int:
    return next((at for at, letter in enumerate(text) if at and letter.isalpha()), len(text))


def _moves(points: np.ndarray, mark: str) -> str:
    whole = np.rint(points * TENTHS).astype(np.int64)
    steps = np.diff(whole, axis=0, prepend=np.zeros((1, 2), dtype=np.int64))
    return "".join(f"m{_pair(x, y)}{mark}" for x, y in steps.tolist())


def _text(vertices: np.ndarray, codes: np.ndarray, *, hundredths: bool = False) -> str:
    """Relative path data of cleaned vertices ``(n, 2)`` with their codes."""
    parts = 10.0 * TENTHS if hundredths else TENTHS
    whole = np.rint(np.clip(np.nan_to_num(vertices), -1e6, 1e6) * parts).astype(np.int64).tolist()
    pair = _hundredths if hundredths else _pair
    out: list[str] = []
    last, x, y, begun, skip = "", 0, 0, (0, 0), 0
    for at, (code, (ex, ey)) in enumerate(zip(codes.tolist(), whole, strict=True)):
        if skip:
            skip -= 1
            continue
        if code == Outline.STOP:
            break
        if code == Outline.CLOSEPOLY:
            out.append("z")
            last, (x, y) = "", begun
            continue
        count = _POINTS.get(code, 1)
        letter = _LETTERS[code]
        told = [pair(px - x, py - y) for px, py in whole[at : at + count]]
        ex, ey = whole[at + count - 1]
        if code == Outline.MOVETO:
            begun = (ex, ey)
        elif count == 1 and (ex, ey) == (x, y) and last == letter:
            continue
        out.append(
            (letter if letter != last or code == Outline.MOVETO else _joint(told[0]))
            + _joined(told)
        )
        last, x, y, skip = letter, ex, ey, count - 1
    return "".join(out)


def _joined(pairs: list[str]) -> str:
    return "".join(pair if not at else _joint(pair) + pair for at, pair in enumerate(pairs))


def _joint(text: str) -> str:
    return "" if text.startswith("-") else " "


@lru_cache(maxsize=4096)
def _number(whole: int) -> str:
    """Tenths as the shortest decimal."""
    text = f"{whole / TENTHS:.1f}".removesuffix(".0")
    return text.replace("0.", ".", 1) if text.startswith(("0.", "-0.")) else text


def _pair(x: int, y: int) -> str:
    second = _number(y)
    return _number(x) + _joint(second) + second


def _hundredths(x: int, y: int) -> str:
    return f"{x / 100.0:g} {y / 100.0:g}"


# ---- Draws a figure as the content of an SVG element within a page

_CAPS = {"projecting": "square", "butt": "butt", "round": "round"}
_ANCHORS = {"center": "middle", "right": "end"}
_BOLD = 600
_ROUND = 8  # curves from which a closed outline as wide as high is a disc


class PageRenderer(RendererBase):
    """Gathers elements in ``parts``; sizes in points, 72 to the inch. ``name`` begins every
    identifier.
    """

    def __init__(self, width: float, height: float, name: str) -> None:
        super().__init__()
        self.width, self.height, self.name = width, height, name
        self.parts: list[str] = []
        self.clips: dict[tuple[float, ...], str] = {}
        self.mapped = False  # whether colours stand for numbers, which no page may replace

    def get_canvas_width_height(self) -> tuple[float, float]:
        """In points."""
        return self.width, self.height

    def flipy(self) -> bool:
        """Texts are placed from the top."""
        return True

    def points_to_pixels(self, points: Any) -> Any:
        """A pixel is a point."""
        return points

    def option_scale_image(self) -> bool:
        """Images come as they are, with the transform that places them."""
        return True

    def draw_path(
        self, gc: GraphicsContextBase, path: Outline, transform: Transform, rgbFace: Any = None
    ) -> None:
        """One path; areas that are clear white without an edge are the paper and left out."""
        data = path_data(path, transform + self._flip(), filled=rgbFace is not None)
        if data:
            self.parts.append(f'<path d="{data}"{self._look(gc, rgbFace)}{self._clip(gc)}/>')

    def draw_markers(
        self,
        gc: GraphicsContextBase,
        marker_path: Outline,
        marker_trans: Transform,
        path: Outline,
        trans: Transform,
        rgbFace: Any = None,
    ) -> None:
        """All marks of a line as one path; discs as dots."""
        points = np.asarray(
            path.cleaned(transform=trans + self._flip(), remove_nans=False).vertices, dtype=float
        )[: len(np.asarray(path.vertices))]
        inside = (
            (points[:, 0] > -9)
            & (points[:, 0] < self.width + 9)
            & (points[:, 1] > -9)
            & (points[:, 1] < self.height + 9)
        )
        points = points[inside]
        size = (
            _disc(marker_path, marker_trans)
            if rgbFace is not None and (not gc.get_linewidth() or _same(gc, rgbFace))
            else 0.0
        )
        if size:
            data = dots_data(points, size)
            look = (
                f' fill="none" stroke="{to_hex(rgbFace)}" '
                f'stroke-width="{size + gc.get_linewidth():.3g}" stroke-linecap="round"'
            )
            look += _opacity("stroke-opacity", gc, rgbFace)
        else:
            data, look = marks_data(points, marker_path, marker_trans), self._look(gc, rgbFace)
        if data:
            self.parts.append(f'<path d="{data}"{look}{self._clip(gc)}/>')

    def draw_image(
        self,
        gc: GraphicsContextBase,
        x: float,
        y: float,
        im: Any,
        transform: Transform | None = None,
    ) -> None:
        """An image of few pixels, each of them that is not clear a rectangle; ``im (rows, columns,
        4)`` from below, colours from 0 to 255.
        """
        self.mapped = True
        rows, columns = im.shape[:2]
        across = Affine2D().scale(1.0 / columns, 1.0 / rows)
        place = (
            across
            + (transform if transform is not None else Affine2D().scale(columns, rows))
            + Affine2D().translate(x, y)
            + self._flip()
        )
        for row in range(rows):
            for column in range(columns):
                (left, low), (right, high) = place.transform([(column, row), (column + 1, row + 1)])
                at = (
                    f'x="{min(left, right):.2f}" y="{min(low, high):.2f}" '
                    f'width="{abs(right - left):.2f}" height="{abs(high - low):.2f}"'
                )
                if im[row, column, 3]:
                    self.parts.append(
                        f'<rect {at} fill="{to_hex(im[row, column] / 255.0)}" '
                        f'shape-rendering="crispEdges"{self._clip(gc)}/>'
                    )

    def draw_text(
        self,
        gc: GraphicsContextBase,
        x: float,
        y: float,
        s: str,
        prop: FontProperties,
        angle: float,
        ismath: Any = False,
        mtext: Any = None,
    ) -> None:
        """A line of text, anchored where it was placed, so that another font than the figure's
        moves it least.
        """
        colour = to_hex(gc.get_rgb())
        look = "" if colour == "#000000" else f' fill="{colour}"'
        look += _opacity("opacity", gc, gc.get_rgb())
        if ismath:
            self.parts.append(self._mathematics(x, y, s, prop, angle, look))
            return
        look += (
            f' font-size="{prop.get_size_in_points():g}"'
            + _weight(prop.get_weight())
            + _slant(prop.get_style())
        )
        if mtext is not None and (angle == 0 or mtext.get_rotation_mode() == "anchor"):
            ax, ay = mtext.get_transform().transform(mtext.get_unitless_position())
            ay = self.height - ay
            up = np.array([np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle))])
            x, y = np.array([ax, ay]) + up * np.dot(up, [x - ax, y - ay])
            anchor = _ANCHORS.get(mtext.get_ha())
            look += f' text-anchor="{anchor}"' if anchor else ""
        turned = f' transform="rotate({-angle:g} {x:.1f} {y:.1f})"' if angle else ""
        self.parts.append(
            f'<text x="{x:.1f}" y="{y:.1f}"{look}{turned}>{escape(s, quote=False)}</text>'
        )

    def _mathematics(
        self, x: float, y: float, s: str, prop: FontProperties, angle: float, look: str
    ) -> str:
        """Symbols with sub- and superscripts: letters at the places of the library's own
        typesetting.
        """
        _, _, _, glyphs, rules = self._text2path.mathtext_parser.parse(s, 72, prop)
        spans: dict[tuple[str, float], list[tuple[float, float, int]]] = {}
        for font, size, code, *_, across, above in glyphs:
            entry = ttfFontProperty(font)
            spans.setdefault((_weight(entry.weight) + _slant(entry.style), size), []).append(
                (across, -above, 0xA0 if code == 32 else code)
            )
        told = []
        for (style, size), letters in spans.items():
            letters.sort()
            places = " ".join(f"{place:.1f}" for place, _, _ in letters)
            heights = " ".join(f"{height:.1f}" for _, height, _ in letters)
            heights = heights.split(" ")[0] if len(set(heights.split(" "))) == 1 else heights
            words = escape("".join(chr(code) for _, _, code in letters), quote=False)
            told.append(
                f'<tspan x="{places}" y="{heights}" font-size="{size:g}"{style}>{words}</tspan>'
            )
        lines = [
            f'<rect x="{a:.1f}" y="{-b - 1:.1f}" width="{width:.1f}" height="{height:.1f}"/>'
            for a, b, width, height in rules
        ]
        turned = f" rotate({-angle:g})" if angle else ""
        return (
            f'<g transform="translate({x:.1f} '
            f'{y:.1f}){turned}"{look}><text>{"".join(told)}</text>{"".join(lines)}</g>'
        )

    def _look(self, gc: GraphicsContextBase, face: Any) -> str:
        out = (
            ' fill="none"'
            if face is None
            else f' fill="{to_hex(face)}"' + _opacity("fill-opacity", gc, face)
        )
        width = gc.get_linewidth()
        if not width or gc.get_rgb()[3] == 0.0:
            return out
        out += f' stroke="{to_hex(gc.get_rgb())}"' + _opacity("stroke-opacity", gc, gc.get_rgb())
        out += f' stroke-width="{width:g}"' if width != 1.0 else ""
        offset, dashes = gc.get_dashes()
        if dashes is not None:
            lengths = " ".join(f"{dash:.3g}" for dash in np.asarray(dashes).tolist())
            out += f' stroke-dasharray="{lengths}"' + (
                f' stroke-dashoffset="{offset:.3g}"' if offset else ""
            )
        cap = _CAPS[str(getattr(gc.get_capstyle(), "value", gc.get_capstyle()))]
        return out + (f' stroke-linecap="{cap}"' if cap != "butt" else "")

    def _clip(self, gc: GraphicsContextBase) -> str:
        box = gc.get_clip_rectangle()
        if box is None:
            return ""
        x0, y0, width, height = (float(value) for value in np.asarray(box.bounds))
        key = tuple(round(value, 1) for value in (x0, self.height - y0 - height, width, height))
        return (
            f' clip-path="url(#{self.clips.setdefault(key, f"{self.name}-clip{len(self.clips)}")})"'
        )

    def _flip(self) -> Affine2D:
        return Affine2D().scale(1.0, -1.0).translate(0.0, self.height)


def _opacity(name: str, gc: GraphicsContextBase, colour: Any) -> str:
    alpha = gc.get_alpha() if gc.get_forced_alpha() else (colour[3] if len(colour) == 4 else 1.0)
    return "" if alpha in (1.0, None) else f' {name}="{alpha:g}"'


def _weight(weight: Any) -> str:
    return ' font-weight="bold"' if weight_dict.get(weight, weight) >= _BOLD else ""


def _slant(style: str) -> str:
    return ' font-style="italic"' if style in ("italic", "oblique") else ""


def _same(gc: GraphicsContextBase, face: Any) -> bool:
    return to_hex(gc.get_rgb()) == to_hex(face)


def _disc(mark: Outline, transform: Transform) -> float:
    """The diameter of a mark that is a disc, 0 of any other."""
    if mark.codes is None or np.sum(mark.codes == Outline.CURVE4) < _ROUND:
        return 0.0
    low, high = mark.get_extents(transform).get_points()
    width, height = (np.asarray(high) - np.asarray(low)).tolist()
    return float(width) if abs(width - height) < 1e-6 * abs(width) else 0.0
