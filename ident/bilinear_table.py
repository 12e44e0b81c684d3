"""Bilinear equations as one table of coefficients. One matrix product then gives the Jacobians and
values of many runs.

Short-period equations with dimensional derivatives are sums of products of a parameter with a state
or an input. Their Jacobian is affine in states, inputs and parameters. Therefore a few calls of the
equations give all coefficients. An on-line filter is three to five times faster with the table.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.declaration.model import System
from sim.declaration.user_arguments import WatchedTime
from sim.errors import ModelError
from sim.maths import COMPLEX_STEP, rows_into
from sim.propagation import Drive

Function = Callable[[list[Any]], Sequence[Any]]
SERIES_TERMS = 3  # terms of the transition matrix of a step: I + F dt + (F dt)^2/2
_TRIAL_POINTS = 12  # random points at which the table is compared with the equations
_LARGEST_DIFFERENCE = 1e-10  # largest difference at these points, relative to the sum of terms


@dataclass(frozen=True, eq=False)
class Bilinear:
    """Bilinear function with m values of w = (1, states, parameters, inputs).

    Attributes
    ----------
    n : number of states and parameters together.
    table : ``(len w, m (n + len w))``. The product of w with the table gives a row for each value.
        Its first n entries are the derivatives with respect to states and parameters. The product
        of its last len w entries with w is the value: they are half of the second-order
        coefficients at w, plus the linear ones.
    """

    n: int
    table: np.ndarray

    def at(self, w: np.ndarray) -> np.ndarray:
        """Return the Jacobian and, as last column, the values, ``(B, m, n + 1)``, at ``w (B, 1 + n
        + inputs)``.
        """
        B, width = w.shape
        rows = (w @ self.table).reshape(B, -1, self.n + width)
        rows[:, :, self.n, None] = rows[:, :, self.n :] @ w[:, :, None]
        return rows[:, :, : self.n + 1]

    @property
    def feeds_through(self) -> bool:
        """Whether an input acts on a value directly."""
        blocks = self.table.reshape(len(self.table), -1, self.n + len(self.table))
        return bool(np.any(blocks[1 + self.n :]) or np.any(blocks[:, :, self.n + 1 + self.n :]))


def bilinear(function: Function, n: int, states: int, inputs: int) -> Bilinear | None:
    """Return the table of a function; None if it is not bilinear.

    A function is bilinear if each term has at most a product of two entries, but never of two
    states or inputs. This is checked at random points whose entries have sizes between 1e-3 and
    1e3.

    Parameters
    ----------
    function : function of a list of entries, each an array over points: first the states, then the
        parameters, then the inputs.
    n : number of states and parameters together.
    states, inputs : numbers of states and of inputs.
    """
    size = n + inputs
    with np.errstate(all="ignore"):
        try:
            # at zero, and at the points where one entry is one and all others are zero
            values, slopes = _values_and_slopes(
                function, np.column_stack([np.zeros(size), np.eye(size)])
            )
            constant, at_rest = values[:, 0], slopes[:, :, 0]
            twice = slopes[:, :, 1:] - at_rest[:, :, None]
            table = Bilinear(n, _table(constant, at_rest, twice, n))
            moving = [*range(states), *range(n, size)]
            if np.any(twice[:, moving][:, :, moving]) or not _agrees(function, table):
                return None
        # an error of the model is reported where it is simulated
        except (ArithmeticError, TypeError, ValueError, ModelError):
            return None
    return table


def system_tables(system: System, p: Sequence[Any]) -> tuple[Bilinear, Bilinear] | None:
    """Return the tables of the state equation f and the output equation h of a System, with its
    free parameters as states, at fixed values ``p`` of the others.

    None if the equations are not bilinear, depend on time, or use a fixed parameter with several
    values ``(B,)`` anywhere but on the input path.
    """
    free = [system.parameters.index(name) for name in system.parameters.free_names]
    n_x, n_u = len(system.states), len(system.inputs)
    n = n_x + len(free)
    # A fixed parameter with several values has an axis of its own: using it fails, as intended.
    fixed_values = [_scalar_or_row(value) for value in p]

    def split(w: list[Any]) -> tuple[list[Any], list[Any], list[Any]]:
        parameters = fixed_values.copy()
        for index, value in zip(free, w[n_x:n], strict=True):
            parameters[index] = value
        return w[:n_x], w[n:], parameters

    time: Any = WatchedTime()
    f = bilinear(lambda w: system.f(time, *split(w)), n, n_x, n_u)
    h = (
        None
        if f is None or time.used
        else bilinear(lambda w: system.h(time, *split(w)), n, n_x, n_u)
    )
    return None if f is None or h is None or time.used else (f, h)


@dataclass(frozen=True, eq=False)
class Tables:
    """Bilinear equations and noise of a filter with the free parameters as states.

    Attributes
    ----------
    n : number of states and free parameters.
    n_x : number of states.
    f, h : tables of the state equation and of the output equation.
    driven : positions of the states on which process noise acts.
    noise_weights : spectral densities of these states times the weights of the terms of the
        series, for the covariance of the process noise.
    R : ``(m, m)`` covariance of the measurement noise.
    """

    n: int
    n_x: int
    f: Bilinear
    h: Bilinear
    driven: tuple[int, ...]
    noise_weights: np.ndarray
    R: np.ndarray


def equation_tables(
    system: System, p: Sequence[Any], density: np.ndarray, variance: np.ndarray
) -> Tables | None:
    """Return the tables of a System whose free parameters are estimated as states; None where it
    has none.

    ``p`` are all parameters, ``density (n,)`` the spectral densities as in ``FilterProblem``, and
    ``variance (m,)`` that of the measurement noise. There are no tables where the equations are not
    bilinear or depend on time, where free parameters are random walks, and where a fixed parameter
    with several values acts anywhere but on the input path.
    """
    n_x = len(system.states)
    if np.any(density[n_x:]):
        return None
    if (result := system_tables(system, p)) is None:
        return None
    driven, order = np.flatnonzero(density), np.arange(SERIES_TERMS)
    # With M_0 = I, Q_k = sum over i, j of M_i Q M_j^T dt / (i + j + 1), M_i the terms of the
    # series.
    noise_weights = np.kron(1.0 / (order[:, None] + order + 1.0), np.diag(density[driven]))
    R = np.diag(np.asarray(variance, dtype=float))
    return Tables(result[0].n, n_x, *result, tuple(driven.tolist()), noise_weights, R)


def constant_within_steps(drive: Drive) -> bool:
    """Return whether all inputs are constant within each step."""
    return all(
        a is b is c or (np.array_equal(a, b) and np.array_equal(a, c))
        for a, b, c in zip(*drive.stages, strict=True)
    )


def _scalar_or_row(value: Any) -> Any:
    """Return a number, or several values ``(B,)`` as ``(B, 1, 1)``."""
    return (
        float(np.asarray(value).reshape(()))
        if np.size(value) == 1
        else np.asarray(value).reshape(-1, 1, 1)
    )


def _table(constant: np.ndarray, at_rest: np.ndarray, twice: np.ndarray, n: int) -> np.ndarray:
    """Return the table from values, Jacobian and second derivatives ``(m, size, size)`` at zero."""
    m, size = at_rest.shape
    slopes = np.concatenate([at_rest[None], np.moveaxis(twice, 2, 0)])
    halves = np.zeros((1 + size, m, 1 + size))
    halves[0, :, 0], halves[0, :, 1:], halves[1:, :, 1:] = constant, at_rest, 0.5 * slopes[1:]
    return np.concatenate([slopes[:, :, :n], halves], axis=2).reshape(1 + size, -1)


def _agrees(function: Function, table: Bilinear) -> bool:
    """Return whether a table gives the values and Jacobians of its function at random points."""
    rng = np.random.default_rng(0)
    n, width = table.n, len(table.table)
    points = rng.choice([-1.0, 1.0], (width - 1, _TRIAL_POINTS)) * 10.0 ** rng.uniform(
        -3.0, 3.0, (width - 1, _TRIAL_POINTS)
    )
    w = np.vstack([np.ones(_TRIAL_POINTS), points]).T
    terms = (np.abs(w) @ np.abs(table.table)).reshape(_TRIAL_POINTS, -1, n + width)
    # sums of the sizes of all terms: rounding errors are relative to them
    largest = np.concatenate([terms[:, :, :n], terms[:, :, n:] @ np.abs(w)[:, :, None]], axis=2)
    values, slopes = _values_and_slopes(function, points)
    exact = np.concatenate([slopes[:, :n], values[:, None]], axis=1).transpose(2, 0, 1)
    return bool(np.all(np.abs(table.at(w) - exact) <= _LARGEST_DIFFERENCE * largest))


def _values_and_slopes(function: Function, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values ``(m, K)`` and Jacobians ``(m, size, K)`` at ``points``, by complex steps."""
    size, count = points.shape
    out = function(list(points[:, None, :] + (1j * COMPLEX_STEP) * np.eye(size)[:, :, None]))
    result = rows_into(np.empty((len(out), size, count), dtype=complex), out)
    return result[:, 0].real.copy(), result.imag / COMPLEX_STEP
