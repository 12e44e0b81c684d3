"""Data of an interactive figure of a page; loads no plotting library."""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.errors import ModelError

LINE, HELD, POINTS, BAND = "line", "held", "points", "band"
KINDS = (LINE, HELD, POINTS, BAND)
CURVE_LEVELS = 65534  # levels between the smallest and the largest value of a curve
GAP_CODE = 65535  # the code of a sample that is missing
MOST_SAMPLES, MOST_PANELS, MOST_CURVES = 100_000, 400, 400
ABSCISSA_DIGITS = 12  # digits of abscissas: a second of a GPS week, 6e5 s, in microseconds
_COLOUR = re.compile(r"#[0-9a-f]{6}", re.ASCII)


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve of a panel.

    Parameters
    ----------
    label : its name in the legend; empty if it has none.
    kind : ``"line"``, ``"held"`` (each value until the next), ``"points"`` or ``"band"`` (between
        ``y`` and ``top``).
    colour : ``#rrggbb`` in small letters.
    x, y : ``(N,)``, in the units of the axes; NaN if a sample is missing. ``x`` is finite and
        does not fall.
    width : of a line or the diameter of a point, in points of print.
    dash : lengths of stroke and gap, in widths; empty for a full line.
    top : ``(N,)`` of a band.

    Raises ModelError for arrays of different lengths and for an ``x`` that falls.
    """

    label: str
    kind: str
    colour: str
    x: np.ndarray
    y: np.ndarray
    width: float = 1.2
    dash: tuple[float, ...] = ()
    top: np.ndarray | None = None

    def __post_init__(self) -> None:
        where = f"curve {self.label!r} of a figure"
        lengths = {len(self.x), len(self.y), *([] if self.top is None else [len(self.top)])}
        if len(lengths) != 1 or not 1 <= len(self.x) <= MOST_SAMPLES:
            raise ModelError(
                f"has arrays of {sorted(lengths)} samples",
                where=where,
                remedy="give x and y the same length, at least one sample",
            )
        if not np.all(np.isfinite(self.x)) or np.any(np.diff(self.x) < 0.0):
            raise ModelError("x falls or is not finite", where=where, remedy="sort the samples")
        known = self.kind in KINDS and (self.kind == BAND) == (self.top is not None)
        if not known or not _COLOUR.fullmatch(self.colour):
            raise ModelError(
                f"is a {self.kind!r} in {self.colour!r}",
                where=where,
                remedy="use line, held, points or band, and a colour such as #0072b2",
            )


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes.

    ``group``: panels with the same number share their x axis. ``x_range``, ``y_range``: initial
    limits of the axes. ``row``, ``column``: place in the figure. ``height``: in print, inches.
    """

    x_label: str
    y_label: str
    caption: str
    group: int
    row: int
    column: int
    height: float
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    curves: tuple[Curve, ...]
    log_x: bool = False
    log_y: bool = False

    def __post_init__(self) -> None:
        ends = (*self.x_range, *self.y_range, self.height)
        rising = self.x_range[0] < self.x_range[1] and self.y_range[0] < self.y_range[1]
        positive = (not self.log_x or self.x_range[0] > 0.0) and (
            not self.log_y or self.y_range[0] > 0.0
        )
        if not all(map(math.isfinite, ends)) or not (rising and positive and self.height > 0.0):
            raise ModelError(
                f"has the limits {self.x_range} and {self.y_range}",
                where=f"panel {self.y_label!r} of a figure",
                remedy="give each axis finite limits that rise, above zero on a logarithmic axis",
            )


@dataclass(frozen=True, eq=False)
class PlotData:
    """All panels of a figure, in the order of reading."""

    panels: tuple[Panel, ...]


# ---- As JSON, short: 16 bits a value, evenly spaced abscissas by their ends


def plot_content(data: PlotData) -> dict[str, Any]:
    """Return the data as JSON; ``plot_of`` reads it."""
    return {"panels": [_panel(each) for each in data.panels]}


def plot_text(content: Mapping[str, Any]) -> str:
    """Return the content in one line for an attribute of a page; the same for the same content."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False)


def as_kept(data: PlotData) -> PlotData:
    """Return the data as rounded in JSON, so that a page remade from JSON is the same."""
    return plot_of(plot_content(data))


def plot_of(content: Any) -> PlotData:
    """Return the data that ``plot_content`` wrote; every value is checked.

    Raises KeyError, TypeError, ValueError or ModelError for invalid content.
    """
    panels = _sequence(content["panels"], MOST_PANELS)
    return PlotData(tuple(map(_panel_of, panels)))


def _panel(panel: Panel) -> dict[str, Any]:
    out: dict[str, Any] = {
        "x": panel.x_label,
        "y": panel.y_label,
        "caption": panel.caption,
        "place": [panel.group, panel.row, panel.column],
        "height": _short(panel.height),
        "xRange": [_short(value, ABSCISSA_DIGITS) for value in panel.x_range],
        "yRange": [_short(value) for value in panel.y_range],
        "curves": [_curve(each) for each in panel.curves],
    }
    return out | ({"logX": True} if panel.log_x else {}) | ({"logY": True} if panel.log_y else {})


def _panel_of(content: Any) -> Panel:
    group, row, column = (_whole(value) for value in _sequence(content["place"], 3))
    low, high = (_finite(value) for value in _sequence(content["xRange"], 2))
    bottom, top = (_finite(value) for value in _sequence(content["yRange"], 2))
    return Panel(
        _words(content["x"]),
        _words(content["y"]),
        _words(content["caption"]),
        group,
        row,
        column,
        _finite(content["height"]),
        (low, high),
        (bottom, top),
        tuple(map(_curve_of, _sequence(content["curves"], MOST_CURVES))),
        content.get("logX", False) is True,
        content.get("logY", False) is True,
    )


def _curve(curve: Curve) -> dict[str, Any]:
    out: dict[str, Any] = {
        "label": curve.label,
        "kind": curve.kind,
        "colour": curve.colour,
        "width": _short(curve.width),
        "x": _abscissas(curve.x),
        "y": _ordinates(curve.y),
    }
    out |= {"dash": [_short(value) for value in curve.dash]} if curve.dash else {}
    return out | ({} if curve.top is None else {"top": _ordinates(curve.top)})


def _curve_of(content: Any) -> Curve:
    x = _abscissas_of(content["x"])
    return Curve(
        _words(content["label"]),
        _words(content["kind"]),
        _words(content["colour"]),
        x,
        _ordinates_of(content["y"]),
        _finite(content["width"]),
        tuple(_finite(value) for value in _sequence(content.get("dash", []), 16)),
        _ordinates_of(content["top"]) if "top" in content else None,
    )


def _abscissas(x: np.ndarray) -> Any:
    """``{"from", "to", "count"}`` where they are evenly spaced, else a list."""
    even = np.linspace(x[0], x[-1], len(x))
    if len(x) > 2 and np.max(np.abs(x - even)) <= 1e-6 * (x[-1] - x[0]):
        return {"from": float(x[0]), "to": float(x[-1]), "count": len(x)}
    return [_short(value, ABSCISSA_DIGITS) for value in x.tolist()]


def _abscissas_of(content: Any) -> np.ndarray:
    if isinstance(content, dict):
        count = _whole(content["count"])
        if not 1 <= count <= MOST_SAMPLES:
            raise ValueError(f"{count} samples")
        return np.linspace(_finite(content["from"]), _finite(content["to"]), count)
    return np.array([_finite(value) for value in _sequence(content, MOST_SAMPLES)])


def _ordinates(y: np.ndarray) -> dict[str, Any]:
    """Return the smallest and largest value, and each value between them in 16 bits."""
    sound = np.isfinite(y)
    low = _short(float(np.min(y[sound])), 9) if np.any(sound) else 0.0
    high = _short(float(np.max(y[sound])), 9) if np.any(sound) else 0.0
    scaled = np.zeros(len(y)) if high == low else (np.where(sound, y, low) - low) / (high - low)
    codes = np.where(sound, np.round(np.clip(scaled, 0.0, 1.0) * CURVE_LEVELS), GAP_CODE).astype(
        "<u2"
    )
    return {
        "low": low,
        "high": high,
        "codes": base64.b64encode(codes.tobytes()).decode("ascii"),
    }


def _ordinates_of(content: Any) -> np.ndarray:
    try:
        raw = base64.b64decode(_words(content["codes"]), validate=True)
    except binascii.Error:
        raise ValueError("values are no base64 text") from None
    if len(raw) % 2 or len(raw) > 2 * MOST_SAMPLES:
        raise ValueError(f"{len(raw)} bytes of values")
    codes = np.frombuffer(raw, dtype="<u2")
    low, high = _finite(content["low"]), _finite(content["high"])
    return np.where(codes == GAP_CODE, np.nan, low + (high - low) * (codes / CURVE_LEVELS))


def _short(value: float, digits: int = 6) -> float:
    """Return the value with as many significant digits as a page shows."""
    return float(f"{value:.{digits}g}")


def _words(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"a {type(value).__name__} where words are due")
    return value


def _finite(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise TypeError(f"{value!r:.40} is no finite number")
    return float(value)


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MOST_SAMPLES:
        raise TypeError(f"{value!r:.40} is no count")
    return value


def _sequence(value: Any, most: int) -> Sequence[Any]:
    if not isinstance(value, list) or len(value) > most:
        raise TypeError("no list of this length is due")
    return value
