"""Outlines and lines as the path data of an SVG: relative, in tenths of a point, without what nobody could see."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from matplotlib.path import Path
from matplotlib.transforms import Affine2D, Transform

TENTHS = 10.0  # parts of a point: a tenth is a sixth of a pixel where a figure is as wide as a page
LONG = 128  # vertices from which a line is simplified
TOLERANCE = 0.25  # points by which a simplified line may be off, a quarter of its width
DOT = 2  # cells that the diameter of a dot has: of several dots in one cell a single one is drawn

_LETTERS = {Path.MOVETO: "m", Path.LINETO: "l", Path.CURVE3: "q", Path.CURVE4: "c"}
_POINTS = {Path.CURVE3: 2, Path.CURVE4: 3}


def path_data(path: Path, transform: Transform, *, filled: bool) -> str:
    """The path after ``transform`` into page coordinates (points, y down); empty where nothing of it is finite.

    Long lines are simplified to within ``TOLERANCE``; so are long outlines of areas, which are closed again.
    """
    vertices = np.asarray(path.vertices, dtype=float)
    straight = path.codes is None or not np.any(np.isin(path.codes, (Path.CURVE3, Path.CURVE4)))
    long = len(vertices) >= LONG and straight
    source = Path(vertices, path.codes)
    closed = filled and long
    if closed:
        ends = np.flatnonzero(path.codes == Path.CLOSEPOLY) if path.codes is not None else np.array([], dtype=int)
        if len(ends) > 1 or (len(ends) == 1 and ends[0] != len(vertices) - 1):
            closed = long = False  # several areas in one path are left as they are
        elif len(ends):
            source = Path(vertices[:-1])
    if long:
        source.should_simplify = True
        source.simplify_threshold = TOLERANCE
    clean = source.cleaned(transform=transform, remove_nans=True, simplify=long, curves=True)
    return _text(*_arrays(clean)) + ("z" if closed else "")


def dots_data(points: np.ndarray, size: float) -> str:
    """Dots of a diameter at ``points (n, 2)`` as strokes of no length; dots that cover each other to a part of ``DOT`` are one."""
    points = points[np.all(np.isfinite(points), axis=1)]
    if not len(points):
        return ""
    _, first = np.unique(np.round(points * (DOT / size)), axis=0, return_index=True)
    return _moves(points[np.sort(first)], "h0")


def marks_data(points: np.ndarray, mark: Path, transform: Transform) -> str:
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


def _arrays(path: Path) -> tuple[np.ndarray, np.ndarray]:
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
        if code == Path.STOP:
            break
        if code == Path.CLOSEPOLY:
            out.append("z")
            last, (x, y) = "", begun
            continue
        count = _POINTS.get(code, 1)
        letter = _LETTERS[code]
        told = [pair(px - x, py - y) for px, py in whole[at : at + count]]
        ex, ey = whole[at + count - 1]
        if code == Path.MOVETO:
            begun = (ex, ey)
        elif count == 1 and (ex, ey) == (x, y) and last == letter:
            continue
        out.append((letter if letter != last or code == Path.MOVETO else _joint(told[0])) + _joined(told))
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
