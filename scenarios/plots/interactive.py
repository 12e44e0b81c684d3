"""Data of a finished figure, from which a page draws it so that it zooms and shows values."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle

from scenarios.report.plot_data import BAND, HELD, LINE, POINTS, Curve, Panel, PlotData, as_kept

MOST = 4000  # samples of a curve; of more the extremes of each interval are kept
CURVES = 40  # of one figure that zooms
# Of words in a panel that a figure that zooms does without: a table beside it has them.
ORNAMENT = "ornament"
_SCALES = ("linear", "log")
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
    """The panels of a finished figure with their curves, or None where something in it cannot be
    drawn from curves over a rising abscissa: bars, error bars, maps, words in a panel.

    Curves of more than ``MOST`` samples keep the smallest and the largest value of each interval.
    """
    panels = [panel for panel in figure.axes if panel.get_visible()]
    if not panels or not all(map(_plain_panel, panels)):
        return None
    tops = sorted({round(panel.get_position().y1, 3) for panel in panels}, reverse=True)
    lefts = sorted({round(panel.get_position().x0, 3) for panel in panels})
    out = []
    for panel in panels:
        place = panel.get_position()
        curves = tuple(map(_thinned, _curves(panel)))
        if not any(curve.kind != BAND and len(curve.x) > 2 for curve in curves):
            return None
        shared = panel.get_shared_x_axes().get_siblings(panel)
        left, right = sorted(map(float, panel.get_xlim()))
        low, high = sorted(map(float, panel.get_ylim()))
        out.append(
            Panel(
                words(panel.get_xlabel()),
                words(panel.get_ylabel()),
                words(panel.get_title(loc="left")),
                min(panels.index(each) for each in shared if each in panels),
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
    if sum(len(panel.curves) for panel in out) > CURVES * len(out):
        return None
    return as_kept(PlotData(tuple(out)))


def words(label: str) -> str:
    """A label with letters in the place of mathtext: ``$\\alpha$ (deg)`` becomes ``α (deg)``."""
    for name, letter in _GREEK.items():
        label = re.sub(rf"\\{name}(?![a-z])", letter, label)
    label = re.sub(r"\\(?:dot|mathrm|mathit)(?![a-z])", "", label)
    # Outside of mathtext an underscore is one, as in the name of a file.
    bare = re.sub(r"\$([^$]*)\$", lambda found: re.sub(r"[{}_\\\s]", "", found[1]), label)
    return " ".join(bare.replace("$", "").split())


def _plain_panel(panel: Axes) -> bool:
    """Whether lines, points, bands and spans are all that is drawn in a panel."""
    spans = [patch for patch in panel.patches if _span(panel, patch) is not None]
    bands = [each for each in panel.collections if _is_band(each)]
    drawable = all(line.get_marker() in _MARKS for line in panel.lines)
    return (
        panel.get_xscale() in _SCALES
        and panel.get_yscale() in _SCALES
        and all(text.get_gid() == ORNAMENT for text in panel.texts)
        and not (panel.images or panel.tables)
        and len(spans) == len(panel.patches)
        and len(bands) == len(panel.collections)
        and all(line.get_drawstyle() in ("default", "steps-post") for line in panel.lines)
        and drawable
    )


_MARKS = ("None", "none", None, "", " ", ".", "o")


def _is_band(each: object) -> bool:
    """An area between two curves (``fill_between``), by the shape of its outlines."""
    if not isinstance(each, PolyCollection):
        return False
    return all(_is_outline(np.asarray(path.vertices)) for path in each.get_paths())


def _is_outline(points: np.ndarray) -> bool:
    count = (len(points) - 3) // 2
    return (
        len(points) >= 5
        and len(points) == 2 * count + 3
        and np.array_equal(points[1 : count + 1, 0], points[count + 2 : -1, 0][::-1])
    )


def _curves(panel: Axes) -> Iterator[Curve]:
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
    """The name in a legend; matplotlib's own names begin with an underscore."""
    name = str(text or "")
    return "" if name.startswith("_") else words(name)


def _span(panel: Axes, patch: object) -> Curve | None:
    """A span along the whole panel as a band; None of any other patch."""
    if not isinstance(patch, Rectangle | Polygon):
        return None
    points = np.asarray(patch.get_path().vertices)
    points = np.asarray(patch.get_patch_transform().transform(points))
    low, high = points.min(axis=0), points.max(axis=0)
    look = to_hex(patch.get_facecolor()), _label(patch.get_label())
    along = np.array(sorted(map(float, panel.get_xlim())))
    if patch.get_data_transform() == panel.get_yaxis_transform(which="grid"):
        return _band(look, along, np.full(2, low[1]), np.full(2, high[1]))
    if patch.get_data_transform() == panel.get_xaxis_transform(which="grid"):
        bottom, top = sorted(map(float, panel.get_ylim()))
        return _band(look, np.array([low[0], high[0]]), np.full(2, bottom), np.full(2, top))
    return None


def _bands(area: PolyCollection) -> Iterator[Curve]:
    colours = area.get_facecolor()
    for path in area.get_paths():
        points = np.asarray(path.vertices, dtype=float)
        count = (len(points) - 3) // 2
        x, one = points[1 : count + 1].T
        other = points[count + 2 : -1, 1][::-1]
        look = to_hex(np.asarray(colours).reshape(-1, 4)[0]), _label(area.get_label())
        yield _band(look, x, np.minimum(one, other), np.maximum(one, other))


def _band(look: tuple[str, str], x: np.ndarray, low: np.ndarray, high: np.ndarray) -> Curve:
    return Curve(look[1], BAND, look[0], x, low, top=high)


def _curve(panel: Axes, line: Line2D) -> Curve | None:
    """A line or its marks; a line across the panel has two points. None of one without samples."""
    x, y = (np.asarray(values, dtype=float) for values in line.get_data())
    if line.get_transform() == panel.get_yaxis_transform(which="grid"):
        x = np.array(sorted(map(float, panel.get_xlim())))
    elif line.get_transform() == panel.get_xaxis_transform(which="grid"):
        y = np.array(sorted(map(float, panel.get_ylim())))
    x = _apart(x, panel)
    sound = np.isfinite(x)
    x, y = x[sound], np.where(np.isfinite(y), y, np.nan)[sound]
    if not x.size:
        return None
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    marks = str(line.get_linestyle()) in ("None", "none", " ", "")
    kind, size = (POINTS, line.get_markersize()) if marks else (LINE, line.get_linewidth())
    return Curve(
        _label(line.get_label()),
        HELD if kind == LINE and line.get_drawstyle() == "steps-post" else kind,
        to_hex(line.get_color()),
        x,
        y,
        float(size),
        () if marks else _dash(line),
    )


def _apart(x: np.ndarray, panel: Axes) -> np.ndarray:
    """The two abscissas of an upright line, less than a pixel apart: a page joins all curves over
    one abscissa, and would keep one of two ends at the same place.
    """
    if x.size != 2 or x[0] != x[1]:
        return x
    left, right = panel.get_xlim()
    return np.array([x[0], x[0] + max(1e-5 * abs(right - left), 2e-11 * abs(x[0]))])


def _dash(line: Line2D) -> tuple[float, ...]:
    """Lengths of stroke and gap in points of print."""
    if not line.is_dashed():
        return ()
    lengths = getattr(line, "_dash_pattern", (0, None))[1]  # matplotlib has no other way to ask
    return tuple(map(float, lengths)) if lengths else (4.0, 2.0)


def _thinned(curve: Curve) -> Curve:
    """The curve with ``MOST`` samples at most: of each interval the smallest and the largest."""
    if len(curve.x) <= MOST:
        return curve
    edges = np.linspace(0, len(curve.x), MOST // 2 + 1).astype(int)
    kept: list[int] = []
    for start, stop in pairwise(edges.tolist()):
        part = curve.y[start:stop]
        if np.all(np.isnan(part)):
            kept.append(int(start))
            continue
        kept += sorted({start + int(np.nanargmin(part)), start + int(np.nanargmax(part))})
    at = np.array(kept)
    top = None if curve.top is None else curve.top[at]
    return replace(curve, x=curve.x[at], y=curve.y[at], top=top)
