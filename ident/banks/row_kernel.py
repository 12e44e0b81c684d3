"""Extended Kalman filters of many runs at once, for bilinear equations and large campaigns.

The last axis of every array counts the runs: each number of the filter is a row ``(B,)`` over the
runs. NumPy works on whole rows, element by element. The result of a run therefore does not depend
on the other runs, and zero coefficients of the equations are skipped. The filters equal those of
`ident.banks.block_kernels` and are several times faster for hundreds of runs.

A pass filters as many runs together as fit into the cache of a processor. After every
``SAMPLES_PER_CHECK`` samples it checks which runs are still finite. If a run has diverged, the pass
repeats these samples one by one to find the last finite one.

Symbols: B runs, n states and parameters, n_x states, m outputs. ``w (len w, B)`` has the entries
(1, states, parameters, inputs), and ``P (n, n, B)`` are the covariances. ``F`` and ``H`` are
Jacobians of rates and outputs, and ``S (m, m, B)`` is the covariance of the innovations ``y (m,
B)``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ident.banks.block_kernels import BankRuns, pass_tables
from ident.bilinear_table import Bilinear, Tables
from ident.estimate import LARGEST_NUMBER
from ident.filters.ekf import FilterSettings
from ident.filters.problem import FilterProblem

# ---- Result of a pass

_EMPTY = (np.zeros, np.ones, np.zeros, np.zeros)  # functions that make the arrays of a history


@dataclass(frozen=True, eq=False)
class BankHistory:
    """Histories of B runs over N samples. A failed run keeps its last mean.

    Attributes
    ----------
    innovation : ``(m, N, B)``, zero where a sample is missing.
    innovation_std : ``(m, N, B)`` standard deviations, one where a sample is missing.
    mean : ``(n, N, B)`` after each update.
    std : ``(n, N, B)`` standard deviations after each update.
    """

    innovation: np.ndarray
    innovation_std: np.ndarray
    mean: np.ndarray
    std: np.ndarray

    @classmethod
    def empty(cls, n: int, m: int, N: int, B: int) -> BankHistory:
        """Return a history without samples."""
        shapes = (m, N, B), (m, N, B), (n, N, B), (n, N, B)
        return cls(*(fill(shape) for fill, shape in zip(_EMPTY, shapes, strict=True)))

    def write(
        self,
        at: slice,
        mean: np.ndarray,
        variance: np.ndarray,
        y: np.ndarray,
        y_variance: np.ndarray,
        finite: np.ndarray,
        before: tuple[np.ndarray, np.ndarray],
    ) -> None:
        """Write K samples. Runs that have broken down keep their last finite values.

        Parameters
        ----------
        at : the samples in the history.
        mean, variance : ``(K, B, n)`` after each update.
        y, y_variance : ``(K, B, m)`` innovations and their variances.
        finite : ``(K, B)`` False where a run has broken down.
        before : mean and variance ``(B, n)`` of the last finite sample before these.
        """
        if not finite.all():
            # the last finite sample, -1 if before these samples
            row = np.minimum(np.arange(len(mean))[:, None], np.count_nonzero(finite, axis=0) - 1)
            inside, row = (row >= 0)[:, :, None], np.maximum(row, 0)[:, :, None]
            mean, variance = (
                np.where(inside, np.take_along_axis(rows, row, axis=0), last)
                for rows, last in zip((mean, variance), before, strict=True)
            )
        self.mean[:, at] = mean.transpose(2, 0, 1)
        self.std[:, at] = np.sqrt(np.maximum(variance, 0.0)).transpose(2, 0, 1)
        self.innovation[:, at] = np.where(finite[:, :, None], y, 0.0).transpose(2, 0, 1)
        y_std = np.where(finite[:, :, None], np.sqrt(y_variance), 1.0)
        self.innovation_std[:, at] = y_std.transpose(2, 0, 1)


@dataclass(frozen=True, eq=False)
class BankPass:
    """Result of one pass of B runs.

    Attributes
    ----------
    mean : ``(n, B)`` after the last finite sample.
    covariance : ``(B, n, n)`` after the last finite sample.
    log_likelihood : ``(B,)`` of the finite samples.
    nis : ``(N, B)`` normalised innovation squared, zero where a run has broken down.
    sound : ``(B,)`` False where a run broke down.
    history : histories, None where they are not kept.
    """

    mean: np.ndarray
    covariance: np.ndarray
    log_likelihood: np.ndarray
    nis: np.ndarray
    sound: np.ndarray
    history: BankHistory | None


# ---- One step of many filters of bilinear equations


class UpdateBuffers(NamedTuple):
    """Results of an update, ``(m, B)`` each.

    Attributes
    ----------
    y : innovations, zero for a missing channel.
    S : variances of the innovations, one for a missing channel.
    pivots : pivots of the covariance of the innovations, one for a missing channel. A pivot is the
        variance of an innovation, given the innovations of the channels before.
    squared : squares of the innovations, given those of the channels before, over the pivots.
    """

    y: np.ndarray
    S: np.ndarray
    pivots: np.ndarray
    squared: np.ndarray


class RowTerm(NamedTuple):
    """One term of a polynomial in the entries of ``w``.

    Attributes
    ----------
    row : row of the result to which the term belongs.
    coefficient : coefficient of the term.
    first, second : positions of the two factors in ``w``; ``second`` is 0 if there is only one.
    """

    row: int
    coefficient: float
    first: int
    second: int


def slope_terms(table: Bilinear) -> list[RowTerm]:
    """Return the terms of the Jacobian with respect to states and parameters. Its entry (i, j) is
    row ``i n + j``.
    """
    n, width = table.n, len(table.table)
    slopes = table.table.reshape(width, -1, n + width)[:, :, :n].reshape(width, -1)
    by_row = [
        [RowTerm(row, float(slopes[a, row]), a, 0) for a in np.flatnonzero(slopes[:, row]).tolist()]
        for row in range(slopes.shape[1])
    ]
    return _first_terms_first(by_row)


def value_terms(table: Bilinear) -> list[RowTerm]:
    """Return the terms of the values of the equations, one row for each equation."""
    n, width = table.n, len(table.table)
    halves = table.table.reshape(width, -1, n + width)[:, :, n:]
    by_row = []
    for row in range(halves.shape[1]):
        # The table has half of each quadratic coefficient at (a, b) and half at (b, a), and linear
        # coefficients at (0, b) only.
        coefficients = np.triu(halves[:, row] + halves[:, row].T - np.diag(np.diag(halves[:, row])))
        pairs = zip(*(index.tolist() for index in np.nonzero(coefficients)), strict=True)
        by_row.append([RowTerm(row, float(coefficients[a, b]), b, a) for a, b in pairs])
    return _first_terms_first(by_row)


def _first_terms_first(by_row: list[list[RowTerm]]) -> list[RowTerm]:
    """Return all terms: the first term of each row, then all others."""
    return [terms[0] for terms in by_row if terms] + [
        term for terms in by_row for term in terms[1:]
    ]


def sum_of_terms(
    terms: Sequence[RowTerm], w: np.ndarray, out: np.ndarray
) -> Callable[[float], None]:
    """Return a function of a factor. It fills ``out (rows, B)`` with the factor times the sum of
    the terms of each row at the present ``w (len w, B)``. Rows without a term are zero.
    """
    out[:] = 0.0
    rows_with_term: set[int] = set()
    workspace, multiply, add = np.empty_like(w[0]), np.multiply, np.add
    operations = []
    for term in terms:
        # The first term of a row sets the row, further terms are added to it.
        is_added = term.row in rows_with_term
        rows_with_term.add(term.row)
        row = out[term.row]
        target = workspace if is_added else row
        second = w[term.second] if term.second else None
        operations.append((term.coefficient, w[term.first], second, row, target, is_added))

    def fill(factor: float) -> None:
        for coefficient, first, second, row, target, is_added in operations:
            multiply(first, coefficient * factor, target)
            if second is not None:
                multiply(target, second, target)
            if is_added:
                add(row, target, row)

    return fill


def predictor(tables: Tables, w: np.ndarray, P: np.ndarray) -> Callable[[float], None]:
    """Return a function of the time step, s. It propagates the states in ``w (len w, B)`` and the
    covariances ``P (n, n, B)`` over the step.
    """
    n, n_x, B = tables.n, tables.n_x, w.shape[1]
    # F: Jacobian times step; D: first A F / 2, then transition matrix minus identity; moved: rows
    # of the states in the propagated covariance
    F, D, DP, moved = (np.empty((n_x, n, B)) for _ in range(4))
    rates_at_rest, f, change, workspace = (np.empty((n_x, B)) for _ in range(4))
    state_covariance, pair = np.empty((n_x, n_x, B)), np.empty((n_x, n_x, B))
    # Rates are affine in the states: A x, where A is a part of the Jacobian, plus the terms without
    # states.
    terms_at_rest = [
        term
        for term in value_terms(tables.f)
        if not (0 < term.first <= n_x or 0 < term.second <= n_x)
    ]
    fill_jacobian = sum_of_terms(slope_terms(tables.f), w, F.reshape(-1, B))
    fill_rates_at_rest = sum_of_terms(terms_at_rest, w, rates_at_rest)
    noise = _process_noise(tables, F, D) if tables.driven else None
    states, multiply, add = w[1 : 1 + n_x], np.multiply, np.add
    change_products = [(F[:, k], change[k]) for k in range(n_x)]
    state_products = [(F[:, k], states[k]) for k in range(n_x)]
    squared_jacobian = [(F[:, k, None], F[k]) for k in range(n_x)]
    # Columns of the transition matrix that differ from those of the identity belong to the states
    # and parameters that the rates depend on.
    columns = sorted({term.row % n for term in slope_terms(tables.f)}) or [0]
    transition_products = [(D[:, k, None], P[k]) for k in columns]
    covariance_products = [(moved[:, None, k], D[None, :, k]) for k in columns]
    P_states, P_mirror, mirror = P[:n_x], P[n_x:, :n_x], moved[:, n_x:].swapaxes(0, 1)

    def predict(dt: float) -> None:
        fill_jacobian(dt)
        fill_rates_at_rest(dt)
        _product(state_products, workspace, D[:, 0])
        add(rates_at_rest, workspace, f)
        # Runge-Kutta of equations that are affine in the states: f + A/2 (f + A/3 (f + A/4 f)).
        change[:] = f
        for divisor in (4.0, 3.0, 2.0):
            _product(change_products, workspace, D[:, 0])
            multiply(workspace, 1.0 / divisor, workspace)
            add(f, workspace, change)
        # transition matrix minus identity: F + A F / 2
        _product(squared_jacobian, D, DP)
        multiply(D, 0.5, D)
        Q = None if noise is None else noise(dt)
        add(D, F, D)
        _product(transition_products, moved, DP)
        add(moved, P_states, moved)
        _product(covariance_products, state_covariance, pair)
        add(state_covariance, moved[:, :n_x], state_covariance)
        if Q is not None:
            add(state_covariance, Q, state_covariance)
        add(states, change, states)
        P_states[:] = moved
        add(state_covariance, state_covariance.swapaxes(0, 1), pair)
        multiply(pair, 0.5, P_states[:, :n_x])
        P_mirror[:] = mirror

    return predict


def _product(
    factors: Sequence[tuple[np.ndarray, np.ndarray]], out: np.ndarray, workspace: np.ndarray
) -> None:
    """Write the sum of the products of the pairs ``factors`` into ``out``, added in their order."""
    np.multiply(*factors[0], out)
    for left, right in factors[1:]:
        np.multiply(left, right, workspace)
        np.add(out, workspace, out)


def _process_noise(
    tables: Tables, F: np.ndarray, second: np.ndarray
) -> Callable[[float], np.ndarray]:
    """Return a function of the time step, s. It returns the covariance ``(n_x, n_x, B)`` of the
    process noise from the present terms ``F`` and ``second`` = A F / 2 of the transition matrix.
    """
    n_x, B, driven = len(F), F.shape[2], tables.driven
    terms = len(tables.noise_weights) // len(driven)
    C = np.zeros((len(tables.noise_weights), n_x, B))
    for j, i in enumerate(driven):
        C[j, i] = 1.0
    total, workspace = np.empty((n_x, n_x, B)), np.empty((n_x, n_x, B))

    def noise(dt: float) -> np.ndarray:
        for j, i in enumerate(driven):
            for term, matrix in zip(range(1, terms), (F, second), strict=False):
                C[term * len(driven) + j] = matrix[:, i]
        total[:] = 0.0
        for a, row in enumerate(tables.noise_weights):
            for b in np.flatnonzero(row).tolist():
                np.multiply(C[a][:, None], C[b][None], workspace)
                np.multiply(workspace, float(row[b]) * dt, workspace)
                np.add(total, workspace, total)
        return total

    return noise


def updater(
    tables: Tables, w: np.ndarray, P: np.ndarray
) -> Callable[[np.ndarray, np.ndarray | None, UpdateBuffers], None]:
    """Return a function of measurements ``(m, B)`` or ``(m, 1)``, positions of missing channels,
    and buffers. It updates ``w`` and ``P`` in place and fills the buffers.
    """
    n, m, B = tables.n, len(tables.R), w.shape[1]
    H, expected = np.empty((m, n, B)), np.empty((m, B))
    rows, workspace = np.empty((m, n + 1 + m, B)), np.empty((n + 1 + m, B))
    fill_jacobian = sum_of_terms(slope_terms(tables.h), w, H.reshape(-1, B))
    fill_expected = sum_of_terms(value_terms(tables.h), w, expected)
    jacobian_varies = bool(np.any(tables.h.table[1:]))
    fill_jacobian(1.0)
    # states and parameters on which each output depends
    slopes = tables.h.table.reshape(len(w), m, -1)[:, :, :n]
    columns = [np.flatnonzero(np.any(slopes[:, i], axis=0)).tolist() or [0] for i in range(m)]
    HP, y, S, scaled = rows[:, :n], rows[:, n], rows[:, n + 1 :], np.empty((n + 1, B))
    products = [[(H[i, k], P[k]) for k in columns[i]] for i in range(m)]
    squares = [[[(HP[i, k], H[j, k]) for k in columns[j]] for j in range(m)] for i in range(m)]
    R = tables.R.diagonal().tolist()
    subtract, multiply, divide = np.subtract, np.multiply, np.divide
    diagonal = rows.reshape(-1, B)[n + 1 :: n + 2 + m]
    s, outer, mean = scaled[:n], np.empty_like(P), w[1 : 1 + n]
    s_column, s_row = s[:, None], s[None]

    def update(z: np.ndarray, missing: np.ndarray | None, buffers: UpdateBuffers) -> None:
        if jacobian_varies:
            fill_jacobian(1.0)
        fill_expected(1.0)
        subtract(z, expected, y)
        for i in range(m):
            _product(products[i], HP[i], workspace[:n])
            for j in range(m):
                _product(squares[i][j], S[i, j], workspace[0])
            np.add(S[i, i], R[i], S[i, i])
        if missing is not None:
            rows[missing] = 0.0
            S[:, missing] = 0.0
            S[missing, missing] = 1.0
        buffers.y[:], buffers.S[:] = y, diagonal
        # Gaussian elimination makes the innovations uncorrelated.
        for i in range(m - 1):
            for j in range(i + 1, m):
                divide(S[j, i], S[i, i], workspace[0])
                ratio = workspace[0].copy()
                multiply(rows[i], ratio, workspace)
                subtract(rows[j], workspace, rows[j])
        buffers.pivots[:] = diagonal
        multiply(y, y, buffers.squared)
        divide(buffers.squared, diagonal, buffers.squared)
        for i in range(m):
            np.sqrt(S[i, i], workspace[0])
            divide(rows[i, : n + 1], workspace[0], scaled)
            # P - s s^T remains exactly symmetric.
            multiply(s_column, s_row, outer)
            subtract(P, outer, P)
            multiply(s, scaled[n], workspace[:n])
            np.add(mean, workspace[:n], mean)

    return update


# ---- One pass of many filters of bilinear equations

LOG_TWO_PI = float(np.log(2.0 * np.pi))
SAMPLES_PER_CHECK = 32  # samples between two checks for diverged runs
_MOST_COVARIANCE_ENTRIES = 64_000  # covariance entries of the runs that are filtered together


def run_pass_in_rows(
    problem: FilterProblem, settings: FilterSettings, runs: BankRuns, keep: bool
) -> BankPass | None:
    """Return the result of one pass of all runs, as ``run_pass`` does; None if the equations have
    no table. With ``keep`` the result has the histories.
    """
    tables = pass_tables(problem, settings, runs)
    if tables is None:
        return None
    B, size = runs.start.shape[1], len(problem.names) ** 2
    width = max(8, -(-_MOST_COVARIANCE_ENTRIES // size))
    parts = [slice(b, min(b + width, B)) for b in range(0, B, width)]
    with np.errstate(all="ignore"):
        return _joined([_filtered(problem, tables, runs, part, keep) for part in parts])


class _BlockBuffers(NamedTuple):
    """Buffers for K samples: means and variances ``(K, n, B)``, and results of the updates
    ``(K, m, B)``.
    """

    mean: np.ndarray
    variance: np.ndarray
    updates: UpdateBuffers


def _filtered(
    problem: FilterProblem, tables: Tables, runs: BankRuns, part: slice, keep: bool
) -> BankPass:
    """Return the result of one pass of the runs ``part``."""
    (n, B), (m, N) = runs.start[:, part].shape, problem.valid.shape
    w, P, filter_samples = _prepared(problem, tables, runs, part)
    mean = w[1 : 1 + n]
    last_mean, last_P, finite = mean.copy(), P.copy(), np.ones(B, dtype=bool)
    log_likelihood, nis = np.zeros(B), np.zeros((N, B))
    history = BankHistory.empty(n, m, N, B) if keep else None
    buffers = _BlockBuffers(
        np.empty((SAMPLES_PER_CHECK, n, B)),
        np.empty((SAMPLES_PER_CHECK, n, B)),
        UpdateBuffers(*(np.empty((SAMPLES_PER_CHECK, m, B)) for _ in UpdateBuffers._fields)),
    )
    channels = np.count_nonzero(problem.valid, axis=0)
    for first in range(0, N, SAMPLES_PER_CHECK):
        last = min(first + SAMPLES_PER_CHECK, N)
        samples, before = slice(first, last), (w.copy(), P.copy())
        filter_samples(first, last, buffers)
        sample_nis = buffers.updates.squared[: last - first].sum(axis=1)
        log_determinant = np.log(buffers.updates.pivots[: last - first]).sum(axis=1)
        gains = -0.5 * (sample_nis + log_determinant + channels[samples, None] * LOG_TWO_PI)
        good = _finite_so_far(buffers, sample_nis, P, finite)
        # The order of the sum must not depend on the number of runs.
        for row in np.where(good, gains, 0.0):
            log_likelihood += row
        nis[samples], finite = np.where(good, sample_nis, 0.0), good[-1]
        if history is not None:
            last_variance = last_P.reshape(n * n, B)[:: n + 1]
            updates = buffers.updates
            means, variances, y, S = (
                array[: last - first].swapaxes(1, 2)
                for array in (buffers.mean, buffers.variance, updates.y, updates.S)
            )
            before_block = (last_mean.T, last_variance.T)
            history.write(samples, means, variances, y, S, good, before_block)
        if good[-1].all():
            last_mean[:], last_P[:] = mean, P
            continue
        w[:], P[:] = before
        for k, finite_runs in enumerate(good):
            filter_samples(first + k, first + k + 1, buffers)
            last_mean[:, finite_runs] = mean[:, finite_runs]
            last_P[:, :, finite_runs] = P[:, :, finite_runs]
    return BankPass(
        last_mean,
        np.ascontiguousarray(last_P.transpose(2, 0, 1)),
        log_likelihood,
        nis,
        finite,
        history,
    )


def _prepared(
    problem: FilterProblem, tables: Tables, runs: BankRuns, part: slice
) -> tuple[np.ndarray, np.ndarray, Callable[[int, int, _BlockBuffers], None]]:
    """Return the entries ``w (len w, B)`` and the covariances ``P (n, n, B)`` at the start, and a
    function that filters the samples ``first`` to ``last - 1`` in place and fills buffers.
    """
    B, n = len(range(*part.indices(runs.start.shape[1]))), tables.n
    node = problem.grid.sample  # node of the integration at each sample
    w, P = np.zeros((len(tables.f.table), B)), np.empty((n, n, B))
    w[0], w[1 : 1 + n] = 1.0, runs.start[:, part]
    covariance = problem.covariance
    P[:] = covariance[:, :, None] if covariance.ndim == 2 else covariance[part].transpose(1, 2, 0)
    inputs, predict, update = w[1 + n :], predictor(tables, w, P), updater(tables, w, P)
    steps = [range(0), *(range(a, b) for a, b in pairwise(node.tolist()))]
    u, dt = _runs_of(runs.drive.stages[0], part), problem.grid.steps.tolist()
    direct_inputs = None  # inputs that act on outputs directly
    if tables.h.feeds_through:
        direct_inputs = _runs_of([row[node] for row in runs.drive.begin], part)
    measured = runs.z if runs.z.shape[2] == 1 else runs.z[:, :, part]
    z = np.where(problem.valid[:, :, None], measured, 0.0).transpose(1, 0, 2).copy()
    missing = {
        k: np.flatnonzero(~problem.valid[:, k])
        for k in np.flatnonzero(~problem.valid.all(axis=0)).tolist()
    }
    diagonal, mean = P.reshape(n * n, B)[:: n + 1], w[1 : 1 + n]

    def filter_samples(first: int, last: int, buffers: _BlockBuffers) -> None:
        for k in range(first, last):
            for s in steps[k]:
                for row, values in zip(inputs, u, strict=True):
                    row[:] = values[s]
                predict(dt[s])
            if direct_inputs is not None:
                for row, values in zip(inputs, direct_inputs, strict=True):
                    row[:] = values[k]
            i = k - first
            update(z[k], missing.get(k), UpdateBuffers(*(array[i] for array in buffers.updates)))
            buffers.mean[i], buffers.variance[i] = mean, diagonal

    return w, P, filter_samples


def _runs_of(rows: Sequence[np.ndarray], part: slice) -> list[np.ndarray]:
    """Return the columns ``part`` of rows ``(M, B)``; rows common to all runs stay as they are."""
    return [
        row if row.ndim == 1 or row.shape[1] == 1 else row[:, part] for row in map(np.asarray, rows)
    ]


def _finite_so_far(
    buffers: _BlockBuffers, nis: np.ndarray, P: np.ndarray, before: np.ndarray
) -> np.ndarray:
    """Return ``(K, B)``: True where a run is finite and without a negative variance up to this one
    of K samples.

    ``nis (K, B)`` are the normalised innovations squared, ``P`` the covariances after the last
    sample, and ``before (B,)`` the result at the sample before.
    """
    mean, variance = buffers.mean[: len(nis)], buffers.variance[: len(nis)]
    # A NaN fails each comparison.
    good = (
        (np.abs(mean).max(axis=1) < LARGEST_NUMBER)
        & (variance.min(axis=1) >= 0.0)
        & (variance.max(axis=1) < LARGEST_NUMBER)
        & (nis < LARGEST_NUMBER)
    )
    good[-1] &= np.abs(P).max(axis=(0, 1)) < LARGEST_NUMBER
    return np.logical_and.accumulate(good, axis=0) & before


def _joined(parts: Sequence[BankPass]) -> BankPass:
    """Return one result for all runs from the results of the ``parts``."""
    if len(parts) == 1:
        return parts[0]
    histories = [part.history for part in parts if part.history is not None]
    history = None
    if histories:
        history = BankHistory(
            *(
                np.concatenate([getattr(part, f.name) for part in histories], axis=2)
                for f in fields(BankHistory)
            )
        )
    return BankPass(
        mean=np.concatenate([part.mean for part in parts], axis=1),
        covariance=np.concatenate([part.covariance for part in parts]),
        log_likelihood=np.concatenate([part.log_likelihood for part in parts]),
        nis=np.concatenate([part.nis for part in parts], axis=1),
        sound=np.concatenate([part.sound for part in parts]),
        history=history,
    )
