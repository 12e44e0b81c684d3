"""Elementary functions and splines that accept floats, arrays, batches and complex steps;
constants.

NumPy's abs, sign and comparisons drop or bend the imaginary part that carries a derivative
(Squire and Trapp, SIAM Review 40(1), 1998); these keep it.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

# ---- Numbers fixed by definition

G0 = 9.80665  # m/s2, standard gravity: the unit of nz


# ---- Elementary functions that survive a complex step and serve floats

COMPLEX_STEP = 1e-30
# From this number of runs on, stepping them together is faster than solving them one by one.
_LEAST_BATCHED_RUNS = 64


def plus(x: Any, port: Any) -> Any:
    """Return ``x + port``. A port without effects is the number zero; then ``x`` is returned."""
    return x if type(port) is float and port == 0.0 else x + port


def add_product(total: Any, factor: Any, x: Any) -> Any:
    """Return ``total + factor x``; the array of ``total`` is reused if the sum fits into it.

    Parameters
    ----------
    total : a sum; as an array it may be overwritten.
    factor, x : numbers or arrays.
    """
    more = factor * x
    if (
        type(total) is np.ndarray
        and type(more) is np.ndarray
        and total.shape == more.shape
        and total.dtype == more.dtype
    ):
        total += more
        return total
    return total + more


def times(factor: Any, x: Any) -> Any:
    """Return ``factor * x``; if the factor is the number one, ``x``."""
    return x if type(factor) is float and factor == 1.0 else factor * x


def real(x: Any) -> Any:
    """Return the real part, for comparisons."""
    return x.real if isinstance(x, (complex, np.ndarray, np.generic)) else x


def exp(x: Any) -> Any:
    """Return the exponential of a float, complex number or array; infinite on overflow.

    Floats are passed to ``math``, which is ten times faster than NumPy for them.
    """
    try:
        if isinstance(x, float):
            return math.exp(x)
        return cmath.exp(x) if isinstance(x, complex) else np.exp(x)
    except OverflowError:
        return (
            complex(math.inf, math.copysign(math.inf, x.imag) if x.imag else 0.0)
            if isinstance(x, complex)
            else math.inf
        )


def cos(x: Any) -> Any:
    """Return the cosine of a float, complex number or array; NaN for an infinite float."""
    if isinstance(x, float):
        return math.cos(x) if math.isfinite(x) else math.nan
    return cmath.cos(x) if isinstance(x, complex) else np.cos(x)


def sin(x: Any) -> Any:
    """Return the sine of a float, complex number or array; NaN for an infinite float."""
    if isinstance(x, float):
        return math.sin(x) if math.isfinite(x) else math.nan
    return cmath.sin(x) if isinstance(x, complex) else np.sin(x)


def log(x: Any) -> Any:
    """Return the natural logarithm of a float, a complex number near a positive one, or an array.

    It is minus infinity for zero, and NaN for a negative float, as for arrays.
    """
    if isinstance(x, float):
        return math.log(x) if x > 0.0 else -math.inf if x == 0.0 else math.nan
    if isinstance(x, complex):
        return cmath.log(x) if x else complex(-math.inf)
    return np.log(x)


def sqrt(x: Any) -> Any:
    """Return the square root of a float, complex number or array; NaN for a negative float."""
    if isinstance(x, float):
        return math.sqrt(x) if x >= 0.0 else math.nan
    return cmath.sqrt(x) if isinstance(x, complex) else np.sqrt(x)


def asinh(x: Any) -> Any:
    """Return the inverse hyperbolic sine of a float, complex number or array."""
    if isinstance(x, float):
        return math.asinh(x)
    return cmath.asinh(x) if isinstance(x, complex) else np.arcsinh(x)


def arctan(x: Any) -> Any:
    """Return the inverse tangent of a float, complex number or array."""
    if isinstance(x, float):
        return math.atan(x)
    return cmath.atan(x) if isinstance(x, complex) else np.arctan(x)


def where(condition: Any, yes: Any, no: Any) -> Any:
    """Return ``yes`` where a condition holds, else ``no``; the caller computes both."""
    if isinstance(condition, (bool, np.bool_)):
        return yes if condition else no
    return np.where(condition, yes, no)


def absolute(x: Any) -> Any:
    """Return ``x`` or ``-x`` by the sign of the real part, so that a derivative is kept."""
    return where(real(x) < 0, -x, x)


def clip(x: Any, low: Any, high: Any) -> Any:
    """Return ``x`` limited to ``[low, high]``, its derivative included."""
    return minimum(maximum(x, low), high)


def maximum(x: Any, y: Any) -> Any:
    """Return the larger by real part."""
    return where(real(x) >= real(y), x, y)


def minimum(x: Any, y: Any) -> Any:
    """Return the smaller by real part."""
    return where(real(x) <= real(y), x, y)


def complex_step_jacobian(
    function: Callable[[list[Any]], Sequence[Any]], x: Sequence[float]
) -> np.ndarray:
    """Return the Jacobian of ``function`` at the point ``x``, exact to rounding, shape ``(m, n)``.

    ``function`` maps ``n`` scalars to ``m`` scalars. It is called once for each column, with Python
    complex numbers: for small systems this is several times faster than one call with arrays.
    """
    columns = []
    point: list[Any] = list(x)
    for j, value in enumerate(x):
        point[j] = complex(value, COMPLEX_STEP)
        columns.append(
            [out.imag if isinstance(out, complex) else np.imag(out) for out in function(point)]
        )
        point[j] = value
    return np.array(columns).T / COMPLEX_STEP


def jacobian_in_one_call(
    function: Callable[[list[Any]], Sequence[Any]], x: Sequence[float]
) -> np.ndarray:
    """Return the Jacobian of ``complex_step_jacobian``, equal to rounding, by one call with arrays.

    ``function`` must broadcast. This is faster from about six columns on: 3 to 5 times for the 19
    states and parameters of a flexible aircraft.
    """
    n = len(x)
    points = np.repeat(np.asarray(x, dtype=complex)[:, None], n, axis=1)
    points.imag[np.arange(n), np.arange(n)] = COMPLEX_STEP
    out = function(list(points))
    columns = rows_into(np.empty((len(out), n), dtype=complex), out)
    return np.asarray(columns.imag / COMPLEX_STEP)


def rows_into(out: np.ndarray, values: Sequence[Any]) -> np.ndarray:
    """Broadcast each value into a row of ``out``, and return ``out``."""
    for i, value in enumerate(values):
        out[i] = value
    return out


def interpolate(x: Any, knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate linearly between knots; constant outside; complex steps are kept.

    Parameters
    ----------
    x : points of evaluation, ``(n, ...)``; may be complex.
    knots : increasing, ``(m,)``.
    values : at the knots, ``(m,)`` or ``(m, ...)`` with the trailing axes of ``x``.
    """
    formula = getattr(x, "interpolated", None)  # x is a symbol of `scenarios.export`
    if formula is not None:
        result: np.ndarray = formula(knots, values)
        return result
    x = np.asarray(x)
    low = np.clip(np.searchsorted(knots, x.real, side="right") - 1, 0, len(knots) - 2)
    if values.ndim == 1:
        y0, y1 = values[low], values[low + 1]
    else:
        shape = np.broadcast_shapes(x.shape[1:], values.shape[1:])
        full = np.broadcast_to(values, (values.shape[0], *shape))
        index = np.broadcast_to(
            low.reshape(low.shape + (1,) * (len(shape) + 1 - low.ndim)), (low.shape[0], *shape)
        )
        y0, y1 = np.take_along_axis(full, index, 0), np.take_along_axis(full, index + 1, 0)
        x = x.reshape(x.shape + (1,) * (len(shape) + 1 - x.ndim))
        low = low.reshape(x.shape)
    share = clip((x - knots[low]) / (knots[low + 1] - knots[low]), 0.0, 1.0)
    return y0 + share * (y1 - y0)


def linear_recurrence(a: Any, b: Any, start: Any) -> np.ndarray:
    """Solve ``y[k+1] = a[k] y[k] + b[k]`` from ``y[0] = start``.

    ``a`` and ``b`` are real or complex, ``(n, ...)`` with trailing batch axes; the result is ``(n +
    1, ...)``. Each run of a batch is solved as a banded triangular system; the runs of a wide batch
    are stepped together.
    """
    a, b, start = np.asarray(a), np.asarray(b), np.asarray(start)
    n, shape = len(b), np.broadcast_shapes(a.shape[1:], b.shape[1:], start.shape)
    y = np.empty((n + 1, *shape), dtype=np.result_type(a, b, start, float))
    y[0] = start
    if math.prod(shape) > _LEAST_BATCHED_RUNS:
        for k in range(n):
            y[k + 1] = a[k] * y[k] + b[k]
        return y
    from scipy.linalg.lapack import dtbtrs, ztbtrs

    solve, depth = ztbtrs if np.iscomplexobj(y) else dtbtrs, len(shape)
    y[1:] = trailing(b, depth)
    factor = np.broadcast_to(trailing(a, depth), (n, *shape))
    band = np.ones((2, n + 1), dtype=y.dtype)
    for index in np.ndindex(shape):
        column = (slice(None), *index)
        band[1, :n] = -factor[column]
        y[column] = solve(band, y[column][:, None], uplo="L", diag="U")[0][:, 0]
    return y


def each_column(function: Callable[..., np.ndarray], rows: Any, *values: Any) -> np.ndarray:
    """Apply ``function(row, *scalars)`` to every run of a batch, for functions that take one run.

    Parameters
    ----------
    function : function of a contiguous row ``(n,)`` and Python scalars that returns a row ``(n,)``.
    rows : ``(n, ...)``, with trailing batch axes.
    values : scalars, or arrays that broadcast with the batch axes.
    """
    rows, values = np.asarray(rows), tuple(np.asarray(value) for value in values)
    shape = np.broadcast_shapes(rows.shape[1:], *(value.shape for value in values))
    if shape == ():
        return function(rows, *(value.item() for value in values))
    full = np.broadcast_to(trailing(rows, len(shape)), (len(rows), *shape))
    given = [np.broadcast_to(value, shape) for value in values]
    out = np.empty(full.shape, dtype=np.result_type(full, *given, float))
    one_row = rows.size == len(rows)
    # Equal runs are computed once: in a batch of finite differences most runs are equal.
    computed: dict[tuple[Any, ...], np.ndarray] = {}
    for index in np.ndindex(shape):
        scalars, column = tuple(value[index].item() for value in given), (slice(None), *index)
        if scalars not in computed or not one_row:
            computed[scalars] = function(np.ascontiguousarray(full[column]), *scalars)
        out[column] = computed[scalars]
    return out


def once_for_alike(function: Callable[..., Any], *values: Any) -> Any:
    """Return ``function(*values)``, computed once for equal runs of a batch.

    In a batch of finite differences most runs are equal. This applies if every value is a number or
    a column ``(c, 1)`` with a row for each run; else the function is simply called. ``function``
    must broadcast, and return a row for each run.
    """
    columns = [value for value in values if np.ndim(value) > 0]
    if not columns or any(np.shape(value) != (len(columns[0]), 1) for value in columns):
        return function(*values)
    rows: dict[tuple[Any, ...], int] = {}
    place = [
        rows.setdefault(run, len(rows))
        for run in zip(*(value[:, 0].tolist() for value in columns), strict=True)
    ]
    if len(rows) == len(place):
        return function(*values)
    first = [place.index(k) for k in range(len(rows))]
    return function(*(value[first] if np.ndim(value) > 0 else value for value in values))[place]


def trailing(row: np.ndarray, depth: int) -> np.ndarray:
    """Return a row ``(n, ...)`` with its batch axes as the last ones of ``depth`` batch axes.

    The shape becomes ``(n, 1, ..., ...)``, so that the row broadcasts with rows of more batch axes.
    """
    return row.reshape(row.shape[:1] + (1,) * (depth + 1 - row.ndim) + row.shape[1:])


# ---- Smooth curves of a few shapes

USUAL_INTERVALS = 5  # intervals of the usual form


@dataclass(frozen=True, eq=False)
class Shapes:
    """Functions of one variable: cubics on equal intervals, and straight lines beyond the range.

    Attributes
    ----------
    low, spacing : begin of the first interval, and length of each interval.
    intervals : number of intervals.
    table : ``(4, n, intervals + 2)``, coefficients of the powers 0 to 3 of the position in an
        interval, 0 to 1, by function and interval; the first and the last column are the straight
        lines below and above the range.
    columns : the same coefficients for the evaluation of single numbers: by interval, then by
        function, the third power first.
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
def natural_shapes(
    low: float, high: float, fine: bool = False, anchor: float = 0.0, flat: bool = True
) -> Shapes:
    """Return natural cubic splines on equal intervals over ``[low, high]`` that vanish at an
    anchor.

    Parameters
    ----------
    low, high : the range; it is extended to the anchor.
    fine : halve the intervals; five finer functions follow those of the usual form.
    anchor : point at which every function is zero.
    flat : whether the slope is zero there, too.

    Returns
    -------
    Functions that are orthonormal over the range: the mean of a product of two is one or zero. The
    usual form has five intervals, thus six free ordinates: four functions if ``flat``, for which
    the anchor takes two ordinates, else five.
    """
    low, high = min(low, anchor), max(high, anchor)
    if not high > low:
        high = low + 1.0
    intervals = 2 * USUAL_INTERVALS if fine else USUAL_INTERVALS
    at = (anchor - low) / (high - low)
    coarse = np.linspace(0.0, 1.0, USUAL_INTERVALS + 1)
    powers = (coarse[:, None] - at) ** np.arange(2 if flat else 1, USUAL_INTERVALS + 1)
    ordinates = _without_anchor(powers, at, flat)
    if fine:
        middle = _values(_cubics(ordinates), np.linspace(0.0, 1.0, 2 * USUAL_INTERVALS + 1))
        bumps = np.zeros((2 * USUAL_INTERVALS + 1, USUAL_INTERVALS))
        bumps[1::2] = np.eye(USUAL_INTERVALS)
        ordinates = np.hstack([middle, _without_anchor(bumps, at, flat)])
    grid = (np.arange(400) + 0.5) / 400
    _, mixing = np.linalg.qr(_values(_cubics(ordinates), grid) / np.sqrt(len(grid)))
    ordinates = ordinates @ np.linalg.inv(mixing * np.sign(np.diag(mixing))[:, None])
    table = _cubics(ordinates)
    columns = tuple(
        tuple(tuple(table[::-1, j, i].tolist()) for j in range(table.shape[1]))
        for i in range(table.shape[2])
    )
    return Shapes(low, (high - low) / intervals, intervals, table, columns)


@lru_cache(maxsize=256)
def first_shapes(shapes: Shapes, count: int) -> Shapes:
    """Return the first ``count`` shapes: if they are not flat, a straight line, a parabola and so
    on.
    """
    columns = tuple(cell[:count] for cell in shapes.columns)
    return Shapes(shapes.low, shapes.spacing, shapes.intervals, shapes.table[:, :count], columns)


def shape_names(fine: bool = False, flat: bool = True) -> tuple[str, ...]:
    """Return the names of the parameters that scale the shapes: ``shape1`` ..., finer ones last."""
    usual = USUAL_INTERVALS - 1 if flat else USUAL_INTERVALS
    return tuple(f"shape{i + 1}" for i in range(usual + USUAL_INTERVALS if fine else usual))


def combine(shapes: Shapes, x: Any, sizes: Sequence[Any]) -> Any:
    """Return ``sum_j sizes[j] shape_j(x)`` for numbers or arrays that broadcast; complex steps are
    kept.
    """
    z = (x - shapes.low) / shapes.spacing
    if isinstance(z, (float, complex)) and all(
        isinstance(size, (float, complex)) for size in sizes
    ):
        share = real(z)
        cell = (
            -1
            if not share >= 0.0
            else (shapes.intervals if share >= shapes.intervals else int(share))
        )
        u, total = z - cell, 0.0
        for size, (c3, c2, c1, c0) in zip(sizes, shapes.columns[cell + 1], strict=True):
            total = total + size * (((c3 * u + c2) * u + c1) * u + c0)
        return total
    z = np.asarray(z)
    # NaN is put into the lowest interval, and remains NaN.
    cells = np.fmin(np.fmax(np.floor(z.real), -1.0), shapes.intervals)
    u = z - cells
    shape = np.broadcast_shapes(*(np.shape(size) for size in sizes))
    depth = (1,) * len(shape)
    blend = sum(
        np.asarray(size) * shapes.table[:, j].reshape(4, -1, *depth) for j, size in enumerate(sizes)
    )
    each = int(np.prod(shape, dtype=int))
    where = cells.astype(np.intp) * each + (each + np.arange(each).reshape(shape))
    c0, c1, c2, c3 = (np.take(row, where) for row in np.asarray(blend).reshape(4, -1))
    return ((c3 * u + c2) * u + c1) * u + c0


def _without_anchor(ordinates: np.ndarray, at: float, flat: bool) -> np.ndarray:
    """Return ordinates ``(K, n)`` at equal knots on [0, 1] minus each function's value at the
    anchor ``at``; if ``flat``, minus its tangent there.
    """
    knots = np.linspace(0.0, 1.0, len(ordinates))
    table = _cubics(ordinates)
    value = _values(table, np.array([at]))[0]
    if not flat:
        return ordinates - value
    intervals = len(ordinates) - 1
    cell = min(int(at * intervals), intervals - 1)
    u = at * intervals - cell
    slope = intervals * (
        table[1, :, cell + 1]
        + 2.0 * u * table[2, :, cell + 1]
        + 3.0 * u * u * table[3, :, cell + 1]
    )
    return ordinates - value - np.outer(knots - at, slope)


def _cubics(ordinates: np.ndarray) -> np.ndarray:
    """Return the table of ``Shapes`` for natural cubic splines through ordinates ``(K, n)`` at
    equal knots.
    """
    knots = len(ordinates)
    matrix = (
        np.diag(np.full(knots, 4.0))
        + np.diag(np.ones(knots - 1), 1)
        + np.diag(np.ones(knots - 1), -1)
    )
    matrix[0], matrix[-1] = np.eye(knots)[0], np.eye(knots)[-1]
    right = np.zeros_like(ordinates)
    right[1:-1] = 6.0 * (ordinates[:-2] - 2.0 * ordinates[1:-1] + ordinates[2:])
    bend = np.linalg.solve(matrix, right)
    y0, y1, m0, m1 = ordinates[:-1], ordinates[1:], bend[:-1], bend[1:]
    inner = np.array([y0, y1 - y0 - m0 / 3.0 - m1 / 6.0, 0.5 * m0, (m1 - m0) / 6.0])
    first, last = inner[1, 0], inner[1, -1] + 2.0 * inner[2, -1] + 3.0 * inner[3, -1]
    none = np.zeros_like(first)
    below = np.array([ordinates[0] - first, first, none, none])
    above = np.array([ordinates[-1], last, none, none])
    return np.concatenate([below[:, None], inner, above[:, None]], axis=1).transpose(0, 2, 1)


def _values(table: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return the functions of a table at shares of the range, 0 to 1: ``(len(share), n)``."""
    intervals = table.shape[2] - 2
    z = share * intervals
    cell = np.clip(np.floor(z).astype(int), 0, intervals - 1)
    u = (z - cell)[:, None]
    c0, c1, c2, c3 = (row[:, cell + 1].T for row in table)
    return np.asarray(((c3 * u + c2) * u + c1) * u + c0)
