"""Kernel of a bank of extended Kalman filters, for bilinear equations with held inputs.

Values and Jacobians of all runs come from one matrix product (`ident.bilinear_table`). A
Runge-Kutta step of equations that are affine in the states, with constant inputs, is a Taylor
series of four terms. Its first two terms also give the transition matrix to second order. Every
product is written into arrays that are allocated once for many samples, since a call takes more
time than the arithmetic of such small matrices.

Symbols are those of `ident.banks.equation_kernels`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ident.banks.equation_kernels import (
    BankRuns,
    BankTrace,
    BlockFilter,
    FilteredBlock,
    extend_transition,
    neutralise_missing,
)
from ident.bilinear_table import Bilinear, constant_within_steps, system_tables
from ident.filters.ekf import FilterSettings
from ident.filters.one_record import Taylor
from ident.filters.problem import FilterProblem
from sim.declaration.model import System
from sim.propagation import rk4_step

_SERIES = Taylor(3)  # transition matrix of the table kernels: I + F dt + (F dt)^2/2


@dataclass(frozen=True, eq=False)
class Tables:
    """Bilinear equations and noise of a filter.

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


class BlockData(NamedTuple):
    """Inputs and measurements of a block of K samples, with M steps of the whole pass.

    Attributes
    ----------
    steps : positions of the steps before each sample.
    dt : sizes of all M steps, s.
    u : ``(M, B, n_u)`` inputs of all steps, or ``(M, 1, n_u)`` for all runs.
    direct_inputs : ``(K, B or 1, n_u)`` inputs at the samples; None where no input acts on an
        output directly.
    z : ``(K, B or 1, m, 1)`` measured outputs.
    missing : positions of the missing channels of each sample; None where none is missing.
    """

    steps: Sequence[Sequence[int]]
    dt: Sequence[float]
    u: np.ndarray
    direct_inputs: np.ndarray | None
    z: np.ndarray
    missing: Sequence[np.ndarray | None]


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
    driven, order = np.flatnonzero(density), np.arange(_SERIES.terms)
    # With M_0 = I, Q_k = sum over i, j of M_i Q M_j^T dt / (i + j + 1), M_i the terms of the
    # series.
    noise_weights = np.kron(1.0 / (order[:, None] + order + 1.0), np.diag(density[driven]))
    R = np.diag(np.asarray(variance, dtype=float))
    return Tables(result[0].n, n_x, *result, tuple(driven.tolist()), noise_weights, R)


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
    samples, dt = problem.grid.sample.tolist(), problem.grid.steps.tolist()
    steps = [range(0), *(range(first, last) for first, last in pairwise(samples))]
    u = _by_run(runs.drive.stages[0], len(dt))
    at_samples = [row[problem.grid.sample] for row in runs.drive.begin]
    direct_inputs = _by_run(at_samples, len(samples)) if tables.h.feeds_through else None
    z = runs.z.transpose(1, 2, 0)[:, :, :, None]
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
        data = BlockData(
            steps[at],
            dt,
            u,
            None if direct_inputs is None else direct_inputs[at],
            z[at],
            missing[at],
        )
        point = None if nominal is None else (nominal, first)
        return filter_block(tables, data, x, P, point, None if trace is None else (trace, first))

    return filter_next_block


def filter_block(
    tables: Tables,
    data: BlockData,
    mean: np.ndarray,
    covariance: np.ndarray,
    nominal: tuple[np.ndarray, int] | None = None,
    trace: tuple[BankTrace, int] | None = None,
) -> FilteredBlock:
    """Return the results of K samples, filtered from ``mean (n, B)`` and ``covariance (B, n, n)``.

    Parameters
    ----------
    nominal : trajectory ``(n, N, B)`` about which the filters are linearised, and the position of
        the first sample in it; None takes their means.
    trace : trace to fill, and the position of the first sample in it; None fills none.
    """
    n, m, B, K = tables.n, len(tables.R), mean.shape[1], len(data.steps)
    result = FilteredBlock(np.empty((K, B, n)), np.empty((K, B, n, n)), np.empty((K, B, m, 1 + m)))
    w = np.ones((B, len(tables.f.table)))
    w[:, 1 + n :] = 0.0
    point = w[:, 1 : 1 + n]
    point[:] = mean.T
    x = point if nominal is None else np.array(mean.T)
    P = np.array(covariance)
    predict = _table_prediction(tables, data, w, x, P)
    update = _table_update(tables, data, w, x, P)
    for k, steps in enumerate(data.steps):
        if nominal is not None:
            point[:] = nominal[0][:, max(nominal[1] + k - 1, 0)].T
        for s in steps:
            D = predict(s)
            if trace is not None:
                extend_transition(trace[0].transition[trace[1] + k], D, first=s == steps[0])
        if nominal is not None:
            point[:] = nominal[0][:, nominal[1] + k].T
        update(k, result, trace)
        result.mean[k], result.covariance[k] = x, P
    return result


def _table_prediction(
    tables: Tables, data: BlockData, w: np.ndarray, x: np.ndarray, P: np.ndarray
) -> Callable[[int], np.ndarray]:
    """Return a function of the position of a step. It propagates ``w (B, len w)``, the means ``x
    (B, n)`` and the covariances ``P (B, n, n)`` over this step in place, and returns Phi - I ``(B,
    n_x, n)``.

    ``w`` = (1, states, parameters, inputs) is the point of linearisation. ``x`` is a view of it
    where filters are linearised about their means.
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
        dt = data.dt[s]
        w_inputs[:] = data.u[s]
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


def _table_update(
    tables: Tables, data: BlockData, w: np.ndarray, x: np.ndarray, P: np.ndarray
) -> Callable[[int, FilteredBlock, tuple[BankTrace, int] | None], None]:
    """Return a function of the position of a sample. It updates ``x (B, n)`` and ``P (B, n, n)`` in
    place with the measurements of this sample, and writes its innovations into the result and the
    trace. ``w`` is as in `_table_prediction`.
    """
    n, m, B, width = tables.n, len(tables.R), len(x), tables.n + w.shape[1]
    nominal_is_mean, point = np.may_share_memory(w, x), w[:, 1 : 1 + n]
    w_inputs, w_column = w[:, 1 + n :], w[:, :, None]
    # rows = [H P, y, S], in which each channel is eliminated from those after it.
    h_flat, rows = np.empty((B, m * width)), np.empty((B, m, n + 1 + m))
    gain, change = np.empty((B, m, n + 1)), np.empty((B, n, n + 1))
    h_all = h_flat.reshape(B, m, width)
    H, H_transposed = h_all[:, :, :n], h_all[:, :, :n].transpose(0, 2, 1)
    h_halves, expected = h_all[:, :, n:], np.empty((B, m, 1))
    HP, HP_transposed = rows[:, :, :n], rows[:, :, :n].transpose(0, 2, 1)
    y, S, used = rows[:, :, n : n + 1], rows[:, :, n + 1 :], rows[:, :, : n + 1]
    y_S, variance = rows[:, :, n:], rows.reshape(B, -1)[:, n + 1 :: n + 2 + m][:, :, None]
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

    def update(k: int, result: FilteredBlock, trace: tuple[BankTrace, int] | None) -> None:
        if data.direct_inputs is not None:
            w_inputs[:] = data.direct_inputs[k]
        np.matmul(w, tables.h.table, out=h_flat)
        np.matmul(h_halves, w_column, out=expected)
        if not nominal_is_mean:
            np.add(expected, np.matmul(H, (x - point)[:, :, None]), out=expected)
        np.matmul(H, P, out=HP)
        np.subtract(data.z[k], expected, out=y)
        np.matmul(HP, H_transposed, out=S)
        np.add(S, tables.R, out=S)
        missing = data.missing[k]
        if missing is not None:
            neutralise_missing(rows, missing)
        result.innovation[k] = y_S
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


def _by_run(rows: Sequence[np.ndarray], count: int) -> np.ndarray:
    """Return inputs ``(count, B, n_u)``, or ``(count, 1, n_u)`` where they are equal for all runs,
    from ``rows`` of shape ``(count,)`` or ``(count, B)``, one for each input.
    """
    parts = (np.asarray(row).reshape(count, -1) for row in rows)
    return np.stack(np.broadcast_arrays(*parts), axis=2)
