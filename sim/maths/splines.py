"""Smooth curves of a few shapes: natural cubic splines over a range, orthonormal, evaluated by plain arithmetic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from sim.maths.elementary import real

COARSE = 5  # intervals of the usual form


@dataclass(frozen=True, eq=False)
class Shapes:
    """Functions of one variable, tabulated as cubics on equal intervals; beyond the range they go on straight.

    Attributes
    ----------
    low, spacing : where the first interval begins and how long each is. intervals : their number.
    table : ``(4, n, intervals + 2)`` coefficients of the powers 0 to 3 of the share of an interval passed, by function and
        interval; the first and the last column are the straight lines below and above.
    columns : the same for single numbers: by interval, then by function, from the third power down.
    """

    low: float
    spacing: float
    intervals: int
    table: np.ndarray
    columns: tuple[tuple[tuple[float, float, float, float], ...], ...]

    @property
    def count(self) -> int:
        return self.table.shape[1]


@lru_cache(maxsize=256)
def natural_shapes(low: float, high: float, fine: bool = False, anchor: float = 0.0, flat: bool = True) -> Shapes:
    """Natural cubic splines on equal intervals over ``[low, high]``, without what an anchor takes.

    Parameters
    ----------
    low, high : the range; the anchor is taken into it.
    fine : halve the intervals: four functions as before, then five finer ones (six if not ``flat``).
    anchor : where every function is zero. flat : there the slopes are zero, too.

    Returns
    -------
    Functions that are orthonormal in the mean over the range: the mean of a product is one or zero. The usual form has
    four: five intervals, of six free ordinates two taken by the anchor; if not ``flat`` five.
    """
    low, high = min(low, anchor), max(high, anchor)
    if not high > low:
        high = low + 1.0
    intervals = 2 * COARSE if fine else COARSE
    at = (anchor - low) / (high - low)
    coarse = np.linspace(0.0, 1.0, COARSE + 1)
    powers = (coarse[:, None] - at) ** np.arange(2 if flat else 1, COARSE + 1)
    ordinates = _without_anchor(powers, at, flat)
    if fine:
        middle = _values(_cubics(ordinates), np.linspace(0.0, 1.0, 2 * COARSE + 1))
        bumps = np.zeros((2 * COARSE + 1, COARSE))
        bumps[1::2] = np.eye(COARSE)
        ordinates = np.hstack([middle, _without_anchor(bumps, at, flat)])
    grid = (np.arange(400) + 0.5) / 400
    _, mixing = np.linalg.qr(_values(_cubics(ordinates), grid) / np.sqrt(len(grid)))
    ordinates = ordinates @ np.linalg.inv(mixing * np.sign(np.diag(mixing))[:, None])
    table = _cubics(ordinates)
    columns = tuple(tuple(tuple(table[::-1, j, i].tolist()) for j in range(table.shape[1])) for i in range(table.shape[2]))
    return Shapes(low, (high - low) / intervals, intervals, table, columns)


@lru_cache(maxsize=256)
def first_shapes(shapes: Shapes, count: int) -> Shapes:
    """The first ``count`` of some shapes, which are the plainest: a straight line, a parabola and so on where they are not flat."""
    columns = tuple(cell[:count] for cell in shapes.columns)
    return Shapes(shapes.low, shapes.spacing, shapes.intervals, shapes.table[:, :count], columns)


def shape_names(fine: bool = False, flat: bool = True) -> tuple[str, ...]:
    """Names of the sizes of these functions: ``shape1`` ..., the finer ones last."""
    usual = COARSE - 1 if flat else COARSE
    return tuple(f"shape{i + 1}" for i in range(usual + COARSE if fine else usual))


def combine(shapes: Shapes, x: Any, sizes: Sequence[Any]) -> Any:
    """``sum_j sizes[j] shape_j(x)``; numbers or arrays that broadcast, complex steps kept."""
    z = (x - shapes.low) / shapes.spacing
    if isinstance(z, (float, complex)) and all(isinstance(size, (float, complex)) for size in sizes):
        share = real(z)
        cell = -1 if not share >= 0.0 else (shapes.intervals if share >= shapes.intervals else int(share))
        u, total = z - cell, 0.0
        for size, (c3, c2, c1, c0) in zip(sizes, shapes.columns[cell + 1], strict=True):
            total = total + size * (((c3 * u + c2) * u + c1) * u + c0)
        return total
    z = np.asarray(z)
    # What is not a number is put into the lowest interval and stays what it is.
    cells = np.fmin(np.fmax(np.floor(z.real), -1.0), shapes.intervals)
    u = z - cells
    shape = np.broadcast_shapes(*(np.shape(size) for size in sizes))
    depth = (1,) * len(shape)
    blend = sum(np.asarray(size) * shapes.table[:, j].reshape(4, -1, *depth) for j, size in enumerate(sizes))
    each = int(np.prod(shape, dtype=int))
    where = cells.astype(np.intp) * each + (each + np.arange(each).reshape(shape))
    c0, c1, c2, c3 = (np.take(row, where) for row in np.asarray(blend).reshape(4, -1))
    return ((c3 * u + c2) * u + c1) * u + c0


def _without_anchor(ordinates: np.ndarray, at: float, flat: bool) -> np.ndarray:
    """Ordinates ``(K, n)`` at equal knots on [0, 1] less each function's value, and tangent, at the anchor."""
    knots = np.linspace(0.0, 1.0, len(ordinates))
    table = _cubics(ordinates)
    value = _values(table, np.array([at]))[0]
    if not flat:
        return ordinates - value
    intervals = len(ordinates) - 1
    cell = min(int(at * intervals), intervals - 1)
    u = at * intervals - cell
    slope = intervals * (table[1, :, cell + 1] + 2.0 * u * table[2, :, cell + 1] + 3.0 * u * u * table[3, :, cell + 1])
    return ordinates - value - np.outer(knots - at, slope)


def _cubics(ordinates: np.ndarray) -> np.ndarray:
    """Natural cubic splines through ``(K, n)`` ordinates at equal knots: the table of ``Shapes``."""
    knots = len(ordinates)
    matrix = np.diag(np.full(knots, 4.0)) + np.diag(np.ones(knots - 1), 1) + np.diag(np.ones(knots - 1), -1)
    matrix[0], matrix[-1] = np.eye(knots)[0], np.eye(knots)[-1]
    right = np.zeros_like(ordinates)
    right[1:-1] = 6.0 * (ordinates[:-2] - 2.0 * ordinates[1:-1] + ordinates[2:])
    bend = np.linalg.solve(matrix, right)
    y0, y1, m0, m1 = ordinates[:-1], ordinates[1:], bend[:-1], bend[1:]
    inner = np.array([y0, y1 - y0 - m0 / 3.0 - m1 / 6.0, 0.5 * m0, (m1 - m0) / 6.0])
    first, last = inner[1, 0], inner[1, -1] + 2.0 * inner[2, -1] + 3.0 * inner[3, -1]
    none = np.zeros_like(first)
    below, above = np.array([ordinates[0] - first, first, none, none]), np.array([ordinates[-1], last, none, none])
    return np.concatenate([below[:, None], inner, above[:, None]], axis=1).transpose(0, 2, 1)


def _values(table: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Functions of a table at shares of the whole range: ``(len(share), n)``."""
    intervals = table.shape[2] - 2
    z = share * intervals
    cell = np.clip(np.floor(z).astype(int), 0, intervals - 1)
    u = (z - cell)[:, None]
    c0, c1, c2, c3 = (row[:, cell + 1].T for row in table)
    return np.asarray(((c3 * u + c2) * u + c1) * u + c0)
