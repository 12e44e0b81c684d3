"""Elementary functions that survive a complex step and serve floats, arrays and batches alike.

NumPy's abs, sign and comparisons drop or bend the imaginary part that carries a derivative
(Squire and Trapp, SIAM Review 40(1), 1998); these keep it.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

COMPLEX_STEP = 1e-30


def plus(x: Any, port: Any) -> Any:
    """``x + port``; a port on which nothing acts is a plain zero, and an array is spared that addition."""
    return x if type(port) is float and port == 0.0 else x + port


def times(factor: Any, x: Any) -> Any:
    """``factor * x``; a factor that is a plain one costs nothing."""
    return x if type(factor) is float and factor == 1.0 else factor * x


def real(x: Any) -> Any:
    """Real part, for comparisons."""
    return x.real if isinstance(x, (complex, np.ndarray, np.generic)) else x


def exp(x: Any) -> Any:
    """Exponential; ``math`` for floats, since NumPy's scalar call is ten times dearer."""
    if isinstance(x, float):
        return math.exp(x)
    return cmath.exp(x) if isinstance(x, complex) else np.exp(x)


def cos(x: Any) -> Any:
    """Cosine of a float, complex number or array."""
    if isinstance(x, float):
        return math.cos(x)
    return cmath.cos(x) if isinstance(x, complex) else np.cos(x)


def where(condition: Any, yes: Any, no: Any) -> Any:
    """Choose by a condition on real parts; both branches are evaluated by the caller."""
    if isinstance(condition, (bool, np.bool_)):
        return yes if condition else no
    return np.where(condition, yes, no)


def absolute(x: Any) -> Any:
    """Magnitude that keeps the derivative: ``x`` or ``-x`` by the sign of the real part."""
    return where(real(x) < 0, -x, x)


def clip(x: Any, low: Any, high: Any) -> Any:
    """``x`` limited to ``[low, high]``, derivative included."""
    return minimum(maximum(x, low), high)


def maximum(x: Any, y: Any) -> Any:
    """The larger by real part."""
    return where(real(x) >= real(y), x, y)


def minimum(x: Any, y: Any) -> Any:
    """The smaller by real part."""
    return where(real(x) <= real(y), x, y)


def complex_step_jacobian(function: Callable[[list[Any]], Sequence[Any]], x: Sequence[float]) -> np.ndarray:
    """Jacobian of ``function`` at the point ``x``, exact to rounding, shape ``(m, n)``.

    One call a column with Python complex numbers: for the small systems here that is several times
    cheaper than one call with arrays. ``function`` maps ``n`` scalars to ``m`` scalars.
    """
    columns = []
    point: list[Any] = list(x)
    for j, value in enumerate(x):
        point[j] = complex(value, COMPLEX_STEP)
        columns.append([out.imag if isinstance(out, complex) else np.imag(out) for out in function(point)])
        point[j] = value
    return np.array(columns).T / COMPLEX_STEP


def interpolate(x: Any, knots: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Piecewise-linear interpolation, constant outside, that keeps complex steps.

    Parameters
    ----------
    x : where to evaluate, ``(n, ...)``; may be complex.
    knots : increasing, ``(m,)``.
    values : at the knots, ``(m,)`` or ``(m, ...)`` with the trailing axes of ``x``.
    """
    x = np.asarray(x)
    low = np.clip(np.searchsorted(knots, x.real, side="right") - 1, 0, len(knots) - 2)
    if values.ndim == 1:
        y0, y1 = values[low], values[low + 1]
    else:
        shape = np.broadcast_shapes(x.shape[1:], values.shape[1:])
        full = np.broadcast_to(values, (values.shape[0], *shape))
        index = np.broadcast_to(low.reshape(low.shape + (1,) * (len(shape) + 1 - low.ndim)), (low.shape[0], *shape))
        y0, y1 = np.take_along_axis(full, index, 0), np.take_along_axis(full, index + 1, 0)
        x = x.reshape(x.shape + (1,) * (len(shape) + 1 - x.ndim))
        low = low.reshape(x.shape)
    share = clip((x - knots[low]) / (knots[low + 1] - knots[low]), 0.0, 1.0)
    return y0 + share * (y1 - y0)


def linear_recurrence(a: np.ndarray, b: np.ndarray, start: Any) -> np.ndarray:
    """Solve ``y[k+1] = a[k] y[k] + b[k]`` from ``y[0] = start``.

    Shapes: ``a`` and ``b`` are ``(n, ...)`` with batch axes trailing; the result is
    ``(n + 1, ...)``. Real one-dimensional input takes one banded triangular solve.
    """
    n = len(b)
    if np.ndim(b) == 1 and np.ndim(a) == 1 and not (np.iscomplexobj(a) or np.iscomplexobj(b) or isinstance(start, complex)):
        from scipy.linalg.lapack import dtbtrs

        band = np.ones((2, n + 1))
        band[1, :n] = -a
        right = np.empty(n + 1)
        right[0], right[1:] = start, b
        solution, info = dtbtrs(band, right[:, None], uplo="L")
        if info == 0:
            return solution[:, 0]
    shape = np.broadcast_shapes(np.shape(a)[1:], np.shape(b)[1:], np.shape(start))
    y = np.empty((n + 1, *shape), dtype=np.result_type(a, b, np.asarray(start)))
    y[0] = start
    for k in range(n):
        y[k + 1] = a[k] * y[k] + b[k]
    return y


def trailing(row: np.ndarray, depth: int) -> np.ndarray:
    """A row with time first, its batch axes moved to the end of ``depth`` batch axes: ``(n, ...)`` to ``(n, 1, ..., ...)``."""
    return row.reshape(row.shape[:1] + (1,) * (depth + 1 - row.ndim) + row.shape[1:])
