"""Kernels of a pass of a bank of extended Kalman filters: one for any equations, and one for
bilinear equations with held inputs. A pass filters its samples in blocks.

The kernels differ in the prediction and in the outputs with their Jacobian. The update is common.
The kernel for any equations calls them once for the values and Jacobians of all runs. In the other
one they come from one matrix product (`ident.bilinear_table`). There a Runge-Kutta step of
equations that are affine in the states, with constant inputs, is a Taylor series of four terms. Its
first two terms also give the transition matrix to second order. Every product is written into
arrays that are allocated once for many samples, since a call takes more time than the arithmetic of
such small matrices.

Symbols: B runs, n states and free parameters, n_x states, m outputs, N samples, K samples of a
block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np

from ident.bilinear_table import (
    SERIES_TERMS,
    Tables,
    constant_within_steps,
    equation_tables,
)
from ident.filters.ekf import FilterSettings
from ident.filters.one_record import Taylor
from ident.filters.problem import FilterProblem, with_free
from sim.maths import COMPLEX_STEP, rows_into
from sim.propagation import Drive, rk4_step

# ---- Inputs and results of a pass of a bank of filters


@dataclass(frozen=True, eq=False)
class BankRuns:
    """Data in which B runs may differ.

    Attributes
    ----------
    p : all parameters: a number, or ``(B,)`` with one value for each run.
    drive : inputs at the vehicle.
    z : ``(m, N, B)`` measured outputs, or ``(m, N, 1)`` for all runs.
    start : ``(n, B)`` starting means.
    """

    p: list[Any]
    drive: Drive
    z: np.ndarray
    start: np.ndarray

    def select(self, chosen: np.ndarray) -> BankRuns:
        """Return the runs at the positions ``chosen``."""
        runs = self.start.shape[1]

        def cut(row: Any) -> Any:
            return row[..., chosen] if np.ndim(row) and np.shape(row)[-1] == runs > 1 else row

        def cut_rows(rows: list[Any]) -> list[Any]:
            return [cut(row) if np.ndim(row) > 1 else row for row in rows]

        begin, middle, end = (cut_rows(rows) for rows in self.drive.stages)
        drive = Drive((begin, middle, end), cut_rows(self.drive.begin), cut_rows(self.drive.end))
        return BankRuns([cut(value) for value in self.p], drive, cut(self.z), self.start[:, chosen])


@dataclass(frozen=True, eq=False)
class BankTrace:
    """Data of one pass over N samples, for a smoother.

    Attributes
    ----------
    mean : ``(N, n, B)`` after each update.
    covariance : ``(N, B, n, n)`` after each update.
    transition : ``(N, B, n_x, n)`` rows of the states in the transition matrix from the sample
        before, minus the identity.
    H : ``(N, B, m, n)`` Jacobian of the outputs, zero for a missing channel.
    HP : ``(N, B, m, n)`` H times the covariance before the update, zero for a missing channel.
    S : ``(N, B, m, m)`` innovation covariance, of the unit matrix for a missing channel.
    y : ``(N, B, m)`` innovations, zero for a missing channel.
    """

    mean: np.ndarray
    covariance: np.ndarray
    transition: np.ndarray
    H: np.ndarray
    HP: np.ndarray
    S: np.ndarray
    y: np.ndarray


def empty_trace(problem: FilterProblem, B: int) -> BankTrace:
    """Return a trace of B runs, which ``run_pass`` fills."""
    n, n_x, (m, N) = len(problem.names), len(problem.system.states), problem.valid.shape
    shapes = (N, n, B), (N, B, n, n), (N, B, n_x, n), (N, B, m, n), (N, B, m, n)
    S = np.array(np.broadcast_to(np.eye(m), (N, B, m, m)))
    mean, covariance, moved, H, HP = map(np.zeros, shapes)
    return BankTrace(mean, covariance, moved, H, HP, S, np.zeros((N, B, m)))


class FilteredBlock(NamedTuple):
    """Results of the K samples of one block of a pass.

    Attributes
    ----------
    mean : ``(K, B, n)`` after each update.
    covariance : ``(K, B, n, n)`` after each update.
    innovation : ``(K, B, m, 1 + m)`` innovations y, and their covariances S to the right. A missing
        channel has zero in y and S, and one on the diagonal of S.
    """

    mean: np.ndarray
    covariance: np.ndarray
    innovation: np.ndarray


class BlockFilter(Protocol):
    """Function that filters one block: the samples ``first`` to ``last - 1``.

    It starts from the means ``x (n, B)`` and covariances ``P (B, n, n)`` after the sample before.
    ``nominal (n, N, B)`` is the trajectory about which the filters are linearised; None takes their
    means. The ``trace`` is filled unless it is None. A failed run continues with non-finite numbers
    or negative variances.
    """

    def __call__(
        self,
        first: int,
        last: int,
        x: np.ndarray,
        P: np.ndarray,
        nominal: np.ndarray | None,
        trace: BankTrace | None,
    ) -> FilteredBlock: ...


# ---- A block of a pass, and the update of all kernels


class Kernel(NamedTuple):
    """Filters of B runs with the equations of one kernel. Its functions write into its arrays.

    Attributes
    ----------
    x, P : ``(B, n)`` means and ``(B, n, n)`` covariances.
    point : ``(B, n)`` point of linearisation; ``x`` itself where filters are linearised about
        their means.
    predict : function of the position of a step. It propagates ``x``, ``P`` and ``point`` over
        this step, and returns Phi - I ``(B, n_x, n)``.
    observe : function of the position of a sample in the block. It returns the outputs ``(B, m,
        1)`` at the point and their Jacobian ``(B, m, n)``.
    """

    x: np.ndarray
    P: np.ndarray
    point: np.ndarray
    predict: Callable[[int], np.ndarray]
    observe: Callable[[int], tuple[np.ndarray, np.ndarray]]


def filter_samples(
    kernel: Kernel,
    R: np.ndarray,
    steps: Sequence[Sequence[int]],
    z: np.ndarray,
    missing: Sequence[np.ndarray | None],
    nominal: tuple[np.ndarray, int] | None = None,
    trace: tuple[BankTrace, int] | None = None,
) -> FilteredBlock:
    """Return the results of K samples. The arrays of the kernel have the means and covariances
    before them.

    Parameters
    ----------
    R : ``(m, m)`` covariance of the measurement noise.
    steps : positions of the steps before each sample.
    z : ``(K, B or 1, m, 1)`` measured outputs.
    missing : positions of the missing channels of each sample; None where none is missing.
    nominal : trajectory ``(n, N, B)`` about which the filters are linearised, and the position of
        the first sample in it; None takes their means.
    trace : trace to fill, and the position of the first sample in it; None fills none.
    """
    (B, n), m, K = kernel.x.shape, len(R), len(steps)
    result = FilteredBlock(np.empty((K, B, n)), np.empty((K, B, n, n)), np.empty((K, B, m, 1 + m)))
    update = _updater(kernel, R)
    for k, steps_before in enumerate(steps):
        if nominal is not None:
            kernel.point[:] = nominal[0][:, max(nominal[1] + k - 1, 0)].T
        for s in steps_before:
            D = kernel.predict(s)
            if trace is not None:
                # the transition from the sample before, without the identity
                moved = trace[0].transition[trace[1] + k]
                moved[:] = D if s == steps_before[0] else moved + D + D[:, :, : D.shape[1]] @ moved
        if nominal is not None:
            kernel.point[:] = nominal[0][:, nominal[1] + k].T
        update(k, z[k], missing[k], result.innovation[k], trace)
        result.mean[k], result.covariance[k] = kernel.x, kernel.P
    return result


def _updater(kernel: Kernel, R: np.ndarray) -> Callable[..., None]:
    """Return the function that updates the arrays of a kernel with one sample. It writes the
    innovations ``(B, m, 1 + m)`` into an array, and fills the trace.
    """
    (B, n), m, (x, P, point, _, observe) = kernel.x.shape, len(R), kernel
    # rows = [H P, y, S], in which each channel is eliminated from those after it.
    rows, gain = np.empty((B, m, n + 1 + m)), np.empty((B, m, n + 1))
    change = np.empty((B, n, n + 1))
    HP, y, S, used = rows[:, :, :n], rows[:, :, n : n + 1], rows[:, :, n + 1 :], rows[:, :, : n + 1]
    HP_transposed, y_S = HP.transpose(0, 2, 1), rows[:, :, n:]
    variance = rows.reshape(B, -1)[:, n + 1 :: n + 2 + m][:, :, None]
    change_P, change_x = change[:, :, :n], change[:, :, n]
    eliminated = [
        (
            rows[:, i + 1 :],
            rows[:, i + 1 :, n + 1 + i, None],
            rows[:, i, n + 1 + i, None, None],
            rows[:, i : i + 1],
            np.empty((B, m - 1 - i, 1)),
            np.empty((B, m - 1 - i, n + 1 + m)),
        )
        for i in range(m - 1)
    ]

    def update(
        k: int,
        z: np.ndarray,
        missing: np.ndarray | None,
        innovation: np.ndarray,
        trace: tuple[BankTrace, int] | None,
    ) -> None:
        expected, H = observe(k)
        if point is not x:
            np.add(expected, np.matmul(H, (x - point)[:, :, None]), out=expected)
        np.matmul(H, P, out=HP)
        np.subtract(z, expected, out=y)
        np.matmul(HP, H.transpose(0, 2, 1), out=S)
        np.add(S, R, out=S)
        if missing is not None:
            # neutral values: zeros, and one on the diagonal of S
            rows[:, missing] = 0.0
            S[:, :, missing] = 0.0
            S[:, missing, missing] = 1.0
        innovation[:] = y_S
        if trace is not None:
            history, at = trace[0], trace[1] + k
            history.H[at], history.HP[at], history.y[at], history.S[at] = H, HP, y[:, :, 0], S
            if missing is not None:
                history.H[at, :, missing] = 0.0
        for below, column, pivot, row, ratio, product in eliminated:
            np.divide(column, pivot, out=ratio)
            np.multiply(ratio, row, out=product)
            np.subtract(below, product, out=below)
        np.divide(used, variance, out=gain)
        np.matmul(HP_transposed, gain, out=change)
        np.subtract(P, change_P, out=P)
        np.add(x, change_x, out=x)

    return update


def _block_filter(
    problem: FilterProblem,
    runs: BankRuns,
    kernel_of: Callable[[int, np.ndarray, np.ndarray, bool], Kernel],
) -> BlockFilter:
    """Return the function that filters a block. ``kernel_of`` returns its kernel from the first
    sample, the means ``(n, B)`` and covariances before it, and whether filters are linearised about
    their means.
    """
    steps = [range(0), *(range(a, b) for a, b in pairwise(problem.grid.sample.tolist()))]
    z, R = runs.z.transpose(1, 2, 0)[:, :, :, None], np.diag(problem.variance)
    missing = [None if column.all() else np.flatnonzero(~column) for column in problem.valid.T]

    def filter_next_block(
        first: int,
        last: int,
        x: np.ndarray,
        P: np.ndarray,
        nominal: np.ndarray | None,
        trace: BankTrace | None,
    ) -> FilteredBlock:
        at = slice(first, last)
        return filter_samples(
            kernel_of(first, x, P, nominal is None),
            R,
            steps[at],
            z[at],
            missing[at],
            None if nominal is None else (nominal, first),
            None if trace is None else (trace, first),
        )

    return filter_next_block


# ---- Kernel for any equations


def step_block_filter(
    problem: FilterProblem, settings: FilterSettings, runs: BankRuns
) -> BlockFilter:
    """Return the function that filters a block by calls of the equations."""
    system, grid, free = problem.system, problem.grid, problem.free
    n_x, walk = len(system.states), problem.density[len(system.states) :]
    transition = settings.transition.of_rows(n_x, problem.density)
    complex_steps = (1j * COMPLEX_STEP) * np.eye(len(problem.names))[:, :, None]

    def kernel_of(first: int, mean: np.ndarray, covariance: np.ndarray, about_mean: bool) -> Kernel:
        x, P = np.array(mean.T, order="C"), np.array(covariance)
        point = x if about_mean else x.copy()

        def predict(s: int) -> np.ndarray:
            stages: Any = tuple([row[s] for row in stage] for stage in runs.drive.stages)
            t, dt, at = float(grid.edges[s]), float(grid.steps[s]), np.ascontiguousarray(point.T)
            values, F = values_and_jacobians(
                lambda a: system.f(t, a[:n_x], stages[0], with_free(runs.p, free, a[n_x:])),
                at,
                complex_steps,
            )
            D, noise = transition(F, dt)
            start, parameters = [at[:n_x]], with_free(runs.p, free, list(at[n_x:]))

            def rates(t: Any, x: Sequence[Any], u: Sequence[Any], p: Sequence[Any]) -> list[Any]:
                # All states as one row; at the start of the step the Jacobian's call has them.
                if x is start:
                    return [values]
                return [rows_into(np.empty_like(values), system.f(t, list(x[0]), u, p))]

            (moved,) = settings.step(rates, t, start, stages, parameters, dt)
            away = None if about_mean else x - point
            point[:, :n_x] = moved.T
            if away is not None:
                x[:] = point + away
                x[:, :n_x] += (D @ away[:, :, None])[:, :, 0]
            P[:] = predicted_covariance(P, D, noise, walk if problem.walking else None, dt)
            return D

        def observe(k: int) -> tuple[np.ndarray, np.ndarray]:
            sample = grid.sample[first + k]
            t, u = float(grid.edges[sample]), [row[sample] for row in runs.drive.begin]
            expected, H = values_and_jacobians(
                lambda a: system.h(t, a[:n_x], u, with_free(runs.p, free, a[n_x:])),
                np.ascontiguousarray(point.T),
                complex_steps,
            )
            return expected.T[:, :, None], H

        return Kernel(x, P, point, predict, observe)

    return _block_filter(problem, runs, kernel_of)


def predicted_covariance(
    P: np.ndarray, D: np.ndarray, noise: np.ndarray | None, walk: np.ndarray | None, dt: float
) -> np.ndarray:
    """Return the covariances ``(B, n, n)`` after a step, from ``P (B, n, n)`` before it.

    Parameters
    ----------
    D : ``(B, n_x, n)`` rows of the states in the transition matrix, minus the identity.
    noise : the same rows of the process-noise covariance Q_k, with all columns or the first n_x;
        None without noise on states.
    walk : ``(n - n_x,)`` spectral densities of the parameters that are random walks; None without.
    dt : step, s.
    """
    n_x, n = D.shape[1], P.shape[1]
    rows = P[:, :n_x] + D @ P
    rows[:, :, :n_x] += rows @ D.transpose(0, 2, 1)
    if noise is not None:
        rows[:, :, : noise.shape[2]] += noise
    result = P.copy()
    result[:, :n_x] = rows
    result[:, n_x:, :n_x] = rows[:, :, n_x:].transpose(0, 2, 1)
    state_block = rows[:, :, :n_x]
    result[:, :n_x, :n_x] = 0.5 * (state_block + state_block.transpose(0, 2, 1))
    if walk is not None:
        parameters = np.arange(n_x, n)
        result[:, parameters, parameters] += walk * dt
    return result


def eliminate_channels(rows: np.ndarray) -> np.ndarray:
    """Eliminate from each channel the channels before it, in place (Gaussian elimination), and
    return the variances ``(..., m)`` that remain.

    The last columns of ``rows (..., m, width)`` are the innovations y and their covariance S. The
    pivots of S are the variances of independent scalars, so that the update needs no inverse.
    """
    m, width = rows.shape[-2:]
    for i in range(m - 1):
        column = width - m + i
        ratio = rows[..., i + 1 :, column] / rows[..., i, column, None]
        rows[..., i + 1 :, :] -= ratio[..., None] * rows[..., i, None, :]
    return np.einsum("...ii->...i", rows[..., width - m :])


def values_and_jacobians(
    function: Callable[[list[Any]], Sequence[Any]], x: np.ndarray, complex_steps: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the values ``(m, B)`` of a function at the points ``x (n, B)`` of all runs, and its
    Jacobians ``(B, m, n)``, in one call of the function.

    ``complex_steps (n, n, 1)`` has the complex step on its diagonal: column j steps entry j of the
    point.
    """
    n, B = x.shape
    values = function(list(x[:, None, :] + complex_steps))
    result = rows_into(np.empty((len(values), n, B), dtype=complex), values)
    slopes = np.multiply(result.imag.transpose(2, 0, 1), 1.0 / COMPLEX_STEP, order="C")
    return result[:, 0].real.copy(), slopes


# ---- Kernel for bilinear equations with held inputs

_SERIES = Taylor(SERIES_TERMS)  # transition matrix of the tables


class BlockInputs(NamedTuple):
    """Inputs of a block of K samples, with M steps of the whole pass.

    Attributes
    ----------
    dt : sizes of all M steps, s.
    u : ``(M, B, n_u)`` inputs of all steps, or ``(M, 1, n_u)`` for all runs.
    direct_inputs : ``(K, B or 1, n_u)`` inputs at the samples; None where no input acts on an
        output directly.
    """

    dt: Sequence[float]
    u: np.ndarray
    direct_inputs: np.ndarray | None


def pass_tables(problem: FilterProblem, settings: FilterSettings, runs: BankRuns) -> Tables | None:
    """Return the tables of a pass; None where the equations, the integrator, the transition matrix
    or the inputs are not those of the table kernels.
    """
    as_series = settings.step is rk4_step and settings.transition == _SERIES
    if not as_series or not constant_within_steps(runs.drive):
        return None
    return equation_tables(problem.system, runs.p, problem.density, problem.variance)


def table_block_filter(
    problem: FilterProblem, settings: FilterSettings, runs: BankRuns
) -> BlockFilter | None:
    """Return the function that filters a block by the tables of the equations; None without
    tables.
    """
    if (tables := pass_tables(problem, settings, runs)) is None:
        return None
    at_samples = [row[problem.grid.sample] for row in runs.drive.begin]
    u = _by_run(runs.drive.stages[0], len(problem.grid.steps))
    direct = _by_run(at_samples, len(problem.time)) if tables.h.feeds_through else None
    dt = problem.grid.steps.tolist()

    def kernel_of(first: int, mean: np.ndarray, covariance: np.ndarray, about_mean: bool) -> Kernel:
        inputs = BlockInputs(dt, u, None if direct is None else direct[first:])
        return table_kernel(tables, inputs, mean, covariance, about_mean=about_mean)

    return _block_filter(problem, runs, kernel_of)


def table_kernel(
    tables: Tables,
    inputs: BlockInputs,
    mean: np.ndarray,
    covariance: np.ndarray,
    *,
    about_mean: bool = True,
) -> Kernel:
    """Return the kernel of a block from the means ``(n, B)`` and covariances ``(B, n, n)`` before
    it. Filters are linearised about their means, or else about a given trajectory.
    """
    n, m, B, width = tables.n, len(tables.R), mean.shape[1], tables.n + len(tables.f.table)
    # the point of linearisation: (1, states, parameters, inputs)
    w = np.ones((B, len(tables.f.table)))
    w[:, 1 + n :] = 0.0
    point, w_inputs, w_column = w[:, 1 : 1 + n], w[:, 1 + n :], w[:, :, None]
    point[:] = mean.T
    x, P = point if about_mean else np.array(mean.T), np.array(covariance)
    h_flat, expected = np.empty((B, m * width)), np.empty((B, m, 1))
    h_all = h_flat.reshape(B, m, width)
    H, h_halves = h_all[:, :, :n], h_all[:, :, n:]

    def observe(k: int) -> tuple[np.ndarray, np.ndarray]:
        if inputs.direct_inputs is not None:
            w_inputs[:] = inputs.direct_inputs[k]
        np.matmul(w, tables.h.table, out=h_flat)
        np.matmul(h_halves, w_column, out=expected)
        return expected, H

    return Kernel(x, P, point, _table_prediction(tables, inputs, w, x, P), observe)


def _table_prediction(
    tables: Tables, inputs: BlockInputs, w: np.ndarray, x: np.ndarray, P: np.ndarray
) -> Callable[[int], np.ndarray]:
    """Return ``Kernel.predict`` by the tables. ``w (B, len w)`` = (1, states, parameters, inputs)
    is the point of linearisation. ``x`` is a view of it where filters are linearised about their
    means.
    """
    n, n_x, B = tables.n, tables.n_x, len(x)
    w_dt, point, w_states = np.empty_like(w), w[:, 1 : 1 + n], w[:, 1 : 1 + n_x]
    w_inputs, w_column = w[:, 1 + n :], w[:, :, None]
    nominal_is_mean, x_states = np.may_share_memory(w, x), x[:, :n_x]
    P_states, P_mirror = P[:, :n_x], P[:, n_x:, :n_x]
    # first = [F, f, ...] dt and second = F first dt / 2. L = [D, value column, C] with D = Phi - I
    # and C the terms of the process noise. With moved = [(I + D) P, 0, C W], the covariance is Phi
    # P Phi^T + Q_k = moved + moved L^T.
    width, terms = n + len(w[0]), _SERIES.terms * len(tables.driven)
    first_flat, second = np.empty((B, n_x * width)), np.empty((B, n_x, n + 1))
    first = first_flat.reshape(B, n_x, width)
    first_halves, first_value = first[:, :, n:], first[:, :, n : n + 1]
    first_used, F_states = first[:, :, : n + 1], first[:, :, :n_x]
    second_value, value = second[:, :, n:], np.empty((B, n_x, 1))
    third, fourth = np.empty((B, n_x, 1)), np.empty((B, n_x, 1))
    L, moved = np.zeros((B, n_x, n + 1 + terms)), np.zeros((B, n_x, n + 1 + terms))
    state_product = np.empty((B, n_x, n_x))
    L_used, D, L_value = L[:, :, : n + 1], L[:, :, :n], L[:, :, n]
    C, L_transposed = L[:, :, n + 1 :], L.transpose(0, 2, 1)
    moved_P, moved_C = moved[:, :, :n], moved[:, :, n + 1 :]
    moved_states, moved_mirror = moved[:, :, :n_x], moved[:, :, n_x:n].transpose(0, 2, 1)
    driven = list(tables.driven)
    C[:, :, : len(driven)] = np.eye(n_x)[:, driven]
    by_noise = [
        (C[:, :, j + power * len(driven)], term[:, :, i])
        for power, term in ((1, first), (2, second))
        for j, i in enumerate(driven)
    ]
    W = np.empty_like(tables.noise_weights)

    def predict(s: int) -> np.ndarray:
        dt = inputs.dt[s]
        w_inputs[:] = inputs.u[s]
        np.multiply(w, dt, out=w_dt)
        np.matmul(w_dt, tables.f.table, out=first_flat)
        np.matmul(first_halves, w_column, out=value)
        first_value[:] = value
        np.matmul(F_states, first_used, out=second)
        np.multiply(second, 0.5, out=second)
        np.add(first_used, second, out=L_used)
        np.matmul(F_states, second_value, out=third)
        np.matmul(F_states, third, out=fourth)
        np.multiply(fourth, 0.25, out=fourth)
        np.add(third, fourth, out=third)
        np.multiply(third, 1.0 / 3.0, out=third)
        rest = third[:, :, 0]
        further = None if nominal_is_mean else np.matmul(D, (x - point)[:, :, None])[:, :, 0]
        np.add(rest, L_value, out=rest)
        np.add(w_states, rest, out=w_states)
        if further is not None:
            np.add(x_states, rest + further, out=x_states)
        np.matmul(D, P, out=moved_P)
        np.add(moved_P, P_states, out=moved_P)
        if by_noise:
            for column, term in by_noise:
                column[:] = term
            np.multiply(tables.noise_weights, dt, out=W)
            np.matmul(C, W, out=moved_C)
        np.matmul(moved, L_transposed, out=state_product)
        np.add(moved_states, state_product, out=moved_states)
        P_states[:] = moved_P
        P_mirror[:] = moved_mirror
        return D

    return predict


def _by_run(rows: Sequence[np.ndarray], count: int) -> np.ndarray:
    """Return inputs ``(count, B, n_u)``, or ``(count, 1, n_u)`` where they are equal for all runs,
    from ``rows`` of shape ``(count,)`` or ``(count, B)``, one for each input.
    """
    parts = (np.asarray(row).reshape(count, -1) for row in rows)
    return np.stack(np.broadcast_arrays(*parts), axis=2)
