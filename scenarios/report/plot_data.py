"""Data of an interactive figure of a page, and their JSON; loads no plotting library."""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
from collections.abc import Mapping
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

    Attributes
    ----------
    label : label in the legend; empty without one.
    kind : ``"line"``, ``"held"`` (each value until the next), ``"points"`` or ``"band"`` (between
        ``y`` and ``top``).
    colour : ``#rrggbb`` in small letters.
    x, y : samples in the units of the axes, ``(N,)``. ``x`` is finite and does not decrease; ``y``
        is NaN if a sample is missing.
    width : width of a line or diameter of a point, in points of print.
    dash : lengths of stroke and gap, in widths; empty for a solid line.
    top : upper limit of a band, ``(N,)``.

    Raises
    ------
    ModelError : the arrays have different lengths, ``x`` decreases, or kind or colour is unknown.
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
            raise ModelError("x decreases or is not finite", where=where, remedy="sort the samples")
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

    Attributes
    ----------
    group : panels with the same number share their x axis.
    row, column : place in the figure.
    height : height in print, inches.
    x_range, y_range : initial limits of the axes.
    log_x, log_y : whether an axis is logarithmic.

    Raises
    ------
    ModelError : limits are not finite, do not increase, or are not positive on a logarithmic axis.
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
    """All panels of a figure, row by row."""

    panels: tuple[Panel, ...]


# ---- Short JSON: values of 16 bits; evenly spaced abscissas by their ends


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
    panels = checked_list(content["panels"], MOST_PANELS)
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
    group, row, column = (checked_count(value) for value in checked_list(content["place"], 3))
    low, high = (_finite(value) for value in checked_list(content["xRange"], 2))
    bottom, top = (_finite(value) for value in checked_list(content["yRange"], 2))
    return Panel(
        checked_text(content["x"]),
        checked_text(content["y"]),
        checked_text(content["caption"]),
        group,
        row,
        column,
        _finite(content["height"]),
        (low, high),
        (bottom, top),
        tuple(map(_curve_of, checked_list(content["curves"], MOST_CURVES))),
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
        checked_text(content["label"]),
        checked_text(content["kind"]),
        checked_text(content["colour"]),
        x,
        _ordinates_of(content["y"]),
        _finite(content["width"]),
        tuple(_finite(value) for value in checked_list(content.get("dash", []), 16)),
        _ordinates_of(content["top"]) if "top" in content else None,
    )


def _abscissas(x: np.ndarray) -> Any:
    """Return ``{"from", "to", "count"}`` for evenly spaced abscissas, else a list."""
    even = np.linspace(x[0], x[-1], len(x))
    if len(x) > 2 and np.max(np.abs(x - even)) <= 1e-6 * (x[-1] - x[0]):
        return {"from": float(x[0]), "to": float(x[-1]), "count": len(x)}
    return [_short(value, ABSCISSA_DIGITS) for value in x.tolist()]


def _abscissas_of(content: Any) -> np.ndarray:
    if isinstance(content, dict):
        count = checked_count(content["count"])
        if not 1 <= count <= MOST_SAMPLES:
            raise ValueError(f"{count} samples")
        return np.linspace(_finite(content["from"]), _finite(content["to"]), count)
    return np.array([_finite(value) for value in checked_list(content, MOST_SAMPLES)])


def _ordinates(y: np.ndarray) -> dict[str, Any]:
    """Return the smallest and largest value, and each value between them in 16 bits."""
    sound = np.isfinite(y)
    low = _short(float(np.min(y[sound])), 9) if np.any(sound) else 0.0
    high = _short(float(np.max(y[sound])), 9) if np.any(sound) else 0.0
    scaled = np.zeros(len(y)) if high == low else (np.where(sound, y, low) - low) / (high - low)
    codes = np.where(sound, np.round(np.clip(scaled, 0.0, 1.0) * CURVE_LEVELS), GAP_CODE).astype(
        "<u2"
    )
    return {"low": low, "high": high, "codes": base64.b64encode(codes.tobytes()).decode("ascii")}


def _ordinates_of(content: Any) -> np.ndarray:
    try:
        raw = base64.b64decode(checked_text(content["codes"]), validate=True)
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


# ---- Checked values of untrusted JSON


def checked_text(value: Any) -> str:
    """Return the value if it is a text. Raises TypeError."""
    if not isinstance(value, str):
        raise TypeError(f"a {type(value).__name__} instead of a text")
    return value


def checked_number(value: Any) -> float:
    """Return the value if it is a number, which may be infinite or NaN. Raises TypeError."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"a {type(value).__name__} instead of a number")
    return value


def checked_count(value: Any, most: int = MOST_SAMPLES) -> int:
    """Return the value if it is a whole number from 0 to ``most``. Raises TypeError."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
        raise TypeError(f"{value!r:.40} is no count")
    return value


def checked_list(value: Any, most: float = math.inf) -> list[Any]:
    """Return the value if it is a list of at most ``most`` items. Raises TypeError."""
    if not isinstance(value, list) or len(value) > most:
        raise TypeError(f"no list of at most {most:g} items")
    return value


def _finite(value: Any) -> float:
    if not math.isfinite(checked_number(value)):
        raise TypeError(f"{value!r:.40} is not finite")
    return float(value)
