"""Draws a figure as the content of an SVG element within a page.

Smaller by an order of magnitude than the file that the plotting library writes: no identifier but of what is referred to, the marks of one
line as one path, letters as text. Colours are attributes, so that the page's own rules may replace them on a dark ground.
"""

from __future__ import annotations

from html import escape
from typing import Any

import numpy as np
from matplotlib.backend_bases import GraphicsContextBase, RendererBase
from matplotlib.colors import to_hex
from matplotlib.font_manager import FontProperties, ttfFontProperty, weight_dict
from matplotlib.path import Path
from matplotlib.transforms import Affine2D, Transform

from scenarios.plots.page.path_text import dots_data, marks_data, path_data

_CAPS = {"projecting": "square", "butt": "butt", "round": "round"}
_ANCHORS = {"center": "middle", "right": "end"}
_BOLD = 600
_ROUND = 8  # curves from which a closed outline as wide as high is a disc


class PageRenderer(RendererBase):
    """Gathers elements in ``parts``; sizes in points, 72 to the inch. ``name`` begins every identifier."""

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

    def draw_path(self, gc: GraphicsContextBase, path: Path, transform: Transform, rgbFace: Any = None) -> None:
        """One path; areas that are clear white without an edge are the paper and left out."""
        data = path_data(path, transform + self._flip(), filled=rgbFace is not None)
        if data:
            self.parts.append(f'<path d="{data}"{self._look(gc, rgbFace)}{self._clip(gc)}/>')

    def draw_markers(
        self, gc: GraphicsContextBase, marker_path: Path, marker_trans: Transform, path: Path, trans: Transform, rgbFace: Any = None
    ) -> None:
        """All marks of a line as one path; discs as dots."""
        points = np.asarray(path.cleaned(transform=trans + self._flip(), remove_nans=False).vertices, dtype=float)[: len(np.asarray(path.vertices))]
        inside = (points[:, 0] > -9) & (points[:, 0] < self.width + 9) & (points[:, 1] > -9) & (points[:, 1] < self.height + 9)
        points = points[inside]
        size = _disc(marker_path, marker_trans) if rgbFace is not None and (not gc.get_linewidth() or _same(gc, rgbFace)) else 0.0
        if size:
            data = dots_data(points, size)
            look = f' fill="none" stroke="{to_hex(rgbFace)}" stroke-width="{size + gc.get_linewidth():.3g}" stroke-linecap="round"'
            look += _opacity("stroke-opacity", gc, rgbFace)
        else:
            data, look = marks_data(points, marker_path, marker_trans), self._look(gc, rgbFace)
        if data:
            self.parts.append(f'<path d="{data}"{look}{self._clip(gc)}/>')

    def draw_image(self, gc: GraphicsContextBase, x: float, y: float, im: Any, transform: Transform | None = None) -> None:
        """An image of few pixels, each of them that is not clear a rectangle; ``im (rows, columns, 4)`` from below, colours from 0 to 255."""
        self.mapped = True
        rows, columns = im.shape[:2]
        across = Affine2D().scale(1.0 / columns, 1.0 / rows)
        place = across + (transform if transform is not None else Affine2D().scale(columns, rows)) + Affine2D().translate(x, y) + self._flip()
        for row in range(rows):
            for column in range(columns):
                (left, low), (right, high) = place.transform([(column, row), (column + 1, row + 1)])
                at = f'x="{min(left, right):.2f}" y="{min(low, high):.2f}" width="{abs(right - left):.2f}" height="{abs(high - low):.2f}"'
                if im[row, column, 3]:
                    self.parts.append(f'<rect {at} fill="{to_hex(im[row, column] / 255.0)}" shape-rendering="crispEdges"{self._clip(gc)}/>')

    def draw_text(
        self, gc: GraphicsContextBase, x: float, y: float, s: str, prop: FontProperties, angle: float, ismath: Any = False, mtext: Any = None
    ) -> None:
        """A line of text, anchored where it was placed, so that another font than the figure's moves it least."""
        colour = to_hex(gc.get_rgb())
        look = "" if colour == "#000000" else f' fill="{colour}"'
        look += _opacity("opacity", gc, gc.get_rgb())
        if ismath:
            self.parts.append(self._mathematics(x, y, s, prop, angle, look))
            return
        look += f' font-size="{prop.get_size_in_points():g}"' + _weight(prop.get_weight()) + _slant(prop.get_style())
        if mtext is not None and (angle == 0 or mtext.get_rotation_mode() == "anchor"):
            ax, ay = mtext.get_transform().transform(mtext.get_unitless_position())
            ay = self.height - ay
            up = np.array([np.sin(np.deg2rad(angle)), np.cos(np.deg2rad(angle))])
            x, y = np.array([ax, ay]) + up * np.dot(up, [x - ax, y - ay])
            anchor = _ANCHORS.get(mtext.get_ha())
            look += f' text-anchor="{anchor}"' if anchor else ""
        turned = f' transform="rotate({-angle:g} {x:.1f} {y:.1f})"' if angle else ""
        self.parts.append(f'<text x="{x:.1f}" y="{y:.1f}"{look}{turned}>{escape(s, quote=False)}</text>')

    def _mathematics(self, x: float, y: float, s: str, prop: FontProperties, angle: float, look: str) -> str:
        """Symbols with sub- and superscripts: letters at the places of the library's own typesetting."""
        _, _, _, glyphs, rules = self._text2path.mathtext_parser.parse(s, 72, prop)
        spans: dict[tuple[str, float], list[tuple[float, float, int]]] = {}
        for font, size, code, *_, across, above in glyphs:
            entry = ttfFontProperty(font)
            spans.setdefault((_weight(entry.weight) + _slant(entry.style), size), []).append((across, -above, 0xA0 if code == 32 else code))
        told = []
        for (style, size), letters in spans.items():
            letters.sort()
            places = " ".join(f"{place:.1f}" for place, _, _ in letters)
            heights = " ".join(f"{height:.1f}" for _, height, _ in letters)
            heights = heights.split(" ")[0] if len(set(heights.split(" "))) == 1 else heights
            words = escape("".join(chr(code) for _, _, code in letters), quote=False)
            told.append(f'<tspan x="{places}" y="{heights}" font-size="{size:g}"{style}>{words}</tspan>')
        lines = [f'<rect x="{a:.1f}" y="{-b - 1:.1f}" width="{width:.1f}" height="{height:.1f}"/>' for a, b, width, height in rules]
        turned = f" rotate({-angle:g})" if angle else ""
        return f'<g transform="translate({x:.1f} {y:.1f}){turned}"{look}><text>{"".join(told)}</text>{"".join(lines)}</g>'

    def _look(self, gc: GraphicsContextBase, face: Any) -> str:
        out = ' fill="none"' if face is None else f' fill="{to_hex(face)}"' + _opacity("fill-opacity", gc, face)
        width = gc.get_linewidth()
        if not width or gc.get_rgb()[3] == 0.0:
            return out
        out += f' stroke="{to_hex(gc.get_rgb())}"' + _opacity("stroke-opacity", gc, gc.get_rgb())
        out += f' stroke-width="{width:g}"' if width != 1.0 else ""
        offset, dashes = gc.get_dashes()
        if dashes is not None:
            lengths = " ".join(f"{dash:.3g}" for dash in np.asarray(dashes).tolist())
            out += f' stroke-dasharray="{lengths}"' + (f' stroke-dashoffset="{offset:.3g}"' if offset else "")
        cap = _CAPS[str(getattr(gc.get_capstyle(), "value", gc.get_capstyle()))]
        return out + (f' stroke-linecap="{cap}"' if cap != "butt" else "")

    def _clip(self, gc: GraphicsContextBase) -> str:
        box = gc.get_clip_rectangle()
        if box is None:
            return ""
        x0, y0, width, height = (float(value) for value in np.asarray(box.bounds))
        key = tuple(round(value, 1) for value in (x0, self.height - y0 - height, width, height))
        return f' clip-path="url(#{self.clips.setdefault(key, f"{self.name}-clip{len(self.clips)}")})"'

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


def _disc(mark: Path, transform: Transform) -> float:
    """The diameter of a mark that is a disc, 0 of any other."""
    if mark.codes is None or np.sum(mark.codes == Path.CURVE4) < _ROUND:
        return 0.0
    low, high = mark.get_extents(transform).get_points()
    width, height = (np.asarray(high) - np.asarray(low)).tolist()
    return float(width) if abs(width - height) < 1e-6 * abs(width) else 0.0
