"""Extended Kalman filters of many runs at once, for bilinear equations and large campaigns.

The last axis of every array counts the runs: each number of the filter is a row ``(B,)``. NumPy
works on whole rows, element by element, so that the result of a run does not depend on the other
runs; zero entries of the table cost nothing. The filters equal those of
`ident.banks.equation_kernels` and are several times faster for hundreds of runs.

A pass filters as many runs together as fit into a processor's cache. Every ``SAMPLES_PER_CHECK``
samples it checks which runs are still finite; where a run has diverged, it repeats these samples
one by one to find the last finite one.

Symbols: B runs, n states and parameters, n_x states, m outputs; ``w (len w, B)`` holds the entries
(1, states, parameters, inputs), ``P (n, n, B)`` covariances, ``F`` and ``H`` Jacobians of rates and
outputs, ``S (m, m, B)`` the covariance of the innovations ``y (m, B)``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ident.banks.equation_kernels import BankHistory, BankPass, BankRuns, Tables, tables_for
from ident.bilinear_table import Bilinear
from ident.estimate import LARGEST_NUMBER
from ident.filters.ekf import FilterSettings
from ident.filters.problem import FilterProblem

# ---- One step of many filters of bilinear equations, each number of the filter a row of runs


class UpdateBuffers(NamedTuple):
    """Results of an update, ``(m, B)`` each: innovations ``y`` and the diagonal ``S`` of their
    covariance; variances ``alone`` of the innovations after elimination of the channels before
    them (the pivots of ``S``), and their squares over these variances ``squared``. Of a missing
    channel zeros, and ones in ``S`` and ``alone``.
    """

    y: np.ndarray
    S: np.ndarray
    alone: np.ndarray
    squared: np.ndarray


class RowTerm(NamedTuple):
    """One term of a polynomial: ``coefficient`` times the entries ``first`` and ``second`` of
    ``w``, added to row ``row``; ``second`` is 0 where there is only one factor.
    """

    row: int
    coefficient: float
    first: int
    second: int


def slope_terms(table: Bilinear) -> list[RowTerm]:
    """Return the terms of the Jacobian by states and parameters, (i, j) in row ``i n + j``."""
    n, width = table.n, len(table.table)
    slopes = table.table.reshape(width, -1, n + width)[:, :, :n].reshape(width, -1)
    by_row = [
        [RowTerm(row, float(slopes[a, row]), a, 0) for a in np.flatnonzero(slopes[:, row]).tolist()]
        for row in range(slopes.shape[1])
    ]
    return _first_terms_first(by_row)


def value_terms(table: Bilinear) -> list[RowTerm]:
    """Return the terms of the values of the equations, a row each."""
    n, width = table.n, len(table.table)
    halves = table.table.reshape(width, -1, n + width)[:, :, n:]
    by_row = []
    for row in range(halves.shape[1]):
        # The table holds half of each quadratic coefficient twice, and linear ones once, at (0, b).
        whole = np.triu(halves[:, row] + halves[:, row].T - np.diag(np.diag(halves[:, row])))
        pairs = zip(*(index.tolist() for index in np.nonzero(whole)), strict=True)
        by_row.append([RowTerm(row, float(whole[a, b]), b, a) for a, b in pairs])
    return _first_terms_first(by_row)


def _first_terms_first(by_row: list[list[RowTerm]]) -> list[RowTerm]:
    """All terms: the first of each row, which sets the row, then those that are added to it."""
    return [terms[0] for terms in by_row if terms] + [
        term for terms in by_row for term in terms[1:]
    ]


def summed(terms: Sequence[RowTerm], w: np.ndarray, out: np.ndarray) -> Callable[[float], None]:
    """Return a function of a factor that fills ``out (rows, B)`` with the factor times the sum of
    each row's terms at ``w``; rows without a term are zeroed once.
    """
    out[:] = 0.0
    begun: set[int] = set()
    other, multiply, add = np.empty_like(w[0]), np.multiply, np.add
    plan = []
    for term in terms:
        further_term = term.row in begun
        begun.add(term.row)
        second, row = w[term.second] if term.second else None, out[term.row]
        plan.append(
            (
                term.coefficient,
                w[term.first],
                second,
                row,
                other if further_term else row,
                further_term,
            )
        )

    def fill(factor: float) -> None:
        for coefficient, first, second, row, target, further_term in plan:
            multiply(first, coefficient * factor, target)
            if second is not None:
                multiply(target, second, target)
            if further_term:
                add(row, target, row)

    return fill


def predictor(tables: Tables, w: np.ndarray, P: np.ndarray) -> Callable[[float], None]:
    """Return a function of the time step (s) that propagates the states in ``w (len w, B)`` and
    the covariances ``P (n, n, B)`` over it.
    """
    n, n_x, B = tables.n, tables.n_x, w.shape[1]
    F, D, DP, moved = (np.empty((n_x, n, B)) for _ in range(4))
    rates_at_rest, f, change, t = (np.empty((n_x, B)) for _ in range(4))
    state_covariance, pair = np.empty((n_x, n_x, B)), np.empty((n_x, n_x, B))
    # Rates are affine in the states: A x, with A a part of the Jacobian, plus the terms without
    # states.
    at_rest = [
        term
        for term in value_terms(tables.f)
        if not (0 < term.first <= n_x or 0 < term.second <= n_x)
    ]
    slopes, values = (
        summed(slope_terms(tables.f), w, F.reshape(-1, B)),
        summed(at_rest, w, rates_at_rest),
    )
    noise = _noise(tables, F, D) if tables.driven else None
    states, multiply, add = w[1 : 1 + n_x], np.multiply, np.add
    change_products = [(F[:, k], change[k]) for k in range(n_x)]
    state_products = [(F[:, k], states[k]) for k in range(n_x)]
    squared_jacobian = [(F[:, k, None], F[k]) for k in range(n_x)]
    # Columns of Phi that differ from those of the identity: entries that the rates depend on.
    acting = sorted({term.row % n for term in slope_terms(tables.f)}) or [0]
    transition_products = [(D[:, k, None], P[k]) for k in acting]
    covariance_products = [(moved[:, None, k], D[None, :, k]) for k in acting]
    P_states, P_mirror, mirror = P[:n_x], P[n_x:, :n_x], moved[:, n_x:].swapaxes(0, 1)

    def predict(dt: float) -> None:
        slopes(dt)
        values(dt)
        _product(state_products, t, D[:, 0])
        add(rates_at_rest, t, f)
        # Runge-Kutta of equations that are affine in the states: f + A/2 (f + A/3 (f + A/4 f)).
        change[:] = f
        for divisor in (4.0, 3.0, 2.0):
            _product(change_products, t, D[:, 0])
            multiply(t, 1.0 / divisor, t)
            add(f, t, change)
        # Phi - I = F + A F / 2.
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
    parts: Sequence[tuple[np.ndarray, np.ndarray]], out: np.ndarray, workspace: np.ndarray
) -> None:
    """Write the sum of the products of pairs into ``out``, always added in the same order."""
    np.multiply(*parts[0], out)
    for one, other in parts[1:]:
        np.multiply(one, other, workspace)
        np.add(out, workspace, out)


def _noise(tables: Tables, F: np.ndarray, second: np.ndarray) -> Callable[[float], np.ndarray]:
    """Return a function of the time step (s) that gives the process noise covariance Q_k ``(n_x,
    n_x, B)`` from the terms of Phi that ``F`` and ``second`` (= A F / 2) hold at that time.
    """
    n_x, B, driven = len(F), F.shape[2], tables.driven
    terms = len(tables.share) // len(driven)
    C = np.zeros((len(tables.share), n_x, B))
    for j, i in enumerate(driven):
        C[j, i] = 1.0
    total, workspace = np.empty((n_x, n_x, B)), np.empty((n_x, n_x, B))

    def noise(dt: float) -> np.ndarray:
        for j, i in enumerate(driven):
            for term, matrix in zip(range(1, terms), (F, second), strict=False):
                C[term * len(driven) + j] = matrix[:, i]
        total[:] = 0.0
        for a, row in enumerate(tables.share):
            for b in np.flatnonzero(row).tolist():
                np.multiply(C[a][:, None], C[b][None], workspace)
                np.multiply(workspace, float(row[b]) * dt, workspace)
                np.add(total, workspace, total)
        return total

    return noise


def updater(
    tables: Tables, w: np.ndarray, P: np.ndarray
) -> Callable[[np.ndarray, np.ndarray | None, UpdateBuffers], None]:
    """Return a function that updates ``w`` and ``P`` with measurements ``(m, B)`` or ``(m, 1)``,
    given the positions of missing channels, and fills ``UpdateBuffers``.
    """
    n, m, B = tables.n, len(tables.R), w.shape[1]
    H, expected = np.empty((m, n, B)), np.empty((m, B))
    rows, workspace = np.empty((m, n + 1 + m, B)), np.empty((n + 1 + m, B))
    slopes = summed(slope_terms(tables.h), w, H.reshape(-1, B))
    values = summed(value_terms(tables.h), w, expected)
    varying = bool(np.any(tables.h.table[1:]))
    slopes(1.0)
    present = [
        np.flatnonzero(np.any(tables.h.table.reshape(len(w), m, -1)[:, i, :n], axis=0)).tolist()
        or [0]
        for i in range(m)
    ]
    HP, y, S, scaled = rows[:, :n], rows[:, n], rows[:, n + 1 :], np.empty((n + 1, B))
    products = [[(H[i, k], P[k]) for k in present[i]] for i in range(m)]
    squares = [[[(HP[i, k], H[j, k]) for k in present[j]] for j in range(m)] for i in range(m)]
    R = tables.R.diagonal().tolist()
    subtract, multiply, divide = np.subtract, np.multiply, np.divide
    diagonal = rows.reshape(-1, B)[n + 1 :: n + 2 + m]
    s, outer, point = scaled[:n], np.empty_like(P), w[1 : 1 + n]
    above, beside = s[:, None], s[None]

    def update(z: np.ndarray, missing: np.ndarray | None, seen: UpdateBuffers) -> None:
        if varying:
            slopes(1.0)
        values(1.0)
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
        seen.y[:], seen.S[:] = y, diagonal
        for i in range(m - 1):
            for j in range(i + 1, m):
                divide(S[j, i], S[i, i], workspace[0])
                ratio = workspace[0].copy()
                multiply(rows[i], ratio, workspace)
                subtract(rows[j], workspace, rows[j])
        seen.alone[:] = diagonal
        multiply(y, y, seen.squared)
        divide(seen.squared, diagonal, seen.squared)
        for i in range(m):
            np.sqrt(S[i, i], workspace[0])
            divide(rows[i, : n + 1], workspace[0], scaled)
            # P - s s^T stays symmetric to the last bit.
            multiply(above, beside, outer)
            subtract(P, outer, P)
            multiply(s, scaled[n], workspace[:n])
            np.add(point, workspace[:n], point)

    return update


# ---- One pass of many filters of bilinear equations

LOG_TWO_PI = float(np.log(2.0 * np.pi))
SAMPLES_PER_CHECK = 32  # samples between two checks for diverged runs
_MOST_COVARIANCE_ENTRIES = 64_000  # covariance entries of the runs that are filtered together


def pass_side_by_side(
    problem: FilterProblem, settings: FilterSettings, runs: BankRuns, keep: bool
) -> BankPass | None:
    """Filter all runs once, as ``run_pass``; return None where the equations have no table."""
    tables = tables_for(problem, settings, runs)
    if tables is None:
        return None
    B, size = runs.start.shape[1], len(problem.names) ** 2
    width = max(8, -(-_MOST_COVARIANCE_ENTRIES // size))
    parts = [slice(b, min(b + width, B)) for b in range(0, B, width)]
    with np.errstate(all="ignore"):
        return _joined([_filtered(problem, tables, runs, part, keep) for part in parts])


class _StretchBuffers(NamedTuple):
    """Buffers for K samples: means and variances ``(K, n, B)``, and those of the updates
    ``(K, m, B)``.
    """

    mean: np.ndarray
    variance: np.ndarray
    seen: UpdateBuffers


def _filtered(
    problem: FilterProblem, tables: Tables, runs: BankRuns, part: slice, keep: bool
) -> BankPass:
    x0 = runs.start[:, part]
    (n, B), (m, N) = x0.shape, problem.valid.shape
    w, P, filter_samples = _prepared(problem, tables, runs, part)
    point = w[1 : 1 + n]
    last_x, last_P, finite = point.copy(), P.copy(), np.ones(B, dtype=bool)
    log_likelihood, nis = np.zeros(B), np.zeros((N, B))
    history = (
        BankHistory(
            np.zeros((m, N, B)), np.ones((m, N, B)), np.zeros((n, N, B)), np.zeros((n, N, B))
        )
        if keep
        else None
    )
    workspace = _StretchBuffers(
        np.empty((SAMPLES_PER_CHECK, n, B)),
        np.empty((SAMPLES_PER_CHECK, n, B)),
        UpdateBuffers(*(np.empty((SAMPLES_PER_CHECK, m, B)) for _ in UpdateBuffers._fields)),
    )
    channels = np.count_nonzero(problem.valid, axis=0)
    for first in range(0, N, SAMPLES_PER_CHECK):
        last = min(first + SAMPLES_PER_CHECK, N)
        at, before = slice(first, last), (w.copy(), P.copy())
        filter_samples(first, last, workspace)
        squared = workspace.seen.squared[: last - first].sum(axis=1)
        likelihood_gain = -0.5 * (
            squared
            + np.log(workspace.seen.alone[: last - first]).sum(axis=1)
            + channels[at, None] * LOG_TWO_PI
        )
        good = _finite_so_far(workspace, squared, P, finite)
        for row in np.where(good, likelihood_gain, 0.0):  # in the same order for any number of runs
            log_likelihood += row
        nis[at], finite = np.where(good, squared, 0.0), good[-1]
        if history is not None:
            _write_history(
                history, at, workspace, good, (last_x, last_P.reshape(n * n, B)[:: n + 1])
            )
        if good[-1].all():
            last_x[:], last_P[:] = point, P
            continue
        w[:], P[:] = before
        for k, finite_runs in enumerate(good):
            filter_samples(first + k, first + k + 1, workspace)
            last_x[:, finite_runs], last_P[:, :, finite_runs] = (
                point[:, finite_runs],
                P[:, :, finite_runs],
            )
    return BankPass(
        last_x,
        np.ascontiguousarray(last_P.transpose(2, 0, 1)),
        log_likelihood,
        nis,
        finite,
        history,
    )


def _prepared(
    problem: FilterProblem, tables: Tables, runs: BankRuns, part: slice
) -> tuple[np.ndarray, np.ndarray, Callable[[int, int, _StretchBuffers], None]]:
    """Return the entries ``w (len w, B)`` and covariances ``P (n, n, B)`` at the start, and a
    function that filters samples ``first`` to ``last - 1``.
    """
    B, n, at = len(range(*part.indices(runs.start.shape[1]))), tables.n, problem.grid.sample
    w, P = np.zeros((len(tables.f.table), B)), np.empty((n, n, B))
    w[0], w[1 : 1 + n] = 1.0, runs.start[:, part]
    covariance = problem.covariance
    P[:] = covariance[:, :, None] if covariance.ndim == 2 else covariance[part].transpose(1, 2, 0)
    inputs, predict, update = w[1 + n :], predictor(tables, w, P), updater(tables, w, P)
    steps = [range(0), *(range(a, b) for a, b in pairwise(at.tolist()))]
    u, dt = _runs_of(runs.drive.stages[0], part), problem.grid.steps.tolist()
    feed = _runs_of([row[at] for row in runs.drive.begin], part) if tables.h.feeds_through else None
    z = (
        np.where(
            problem.valid[:, :, None], runs.z if runs.z.shape[2] == 1 else runs.z[:, :, part], 0.0
        )
        .transpose(1, 0, 2)
        .copy()
    )
    missing = {
        k: np.flatnonzero(~problem.valid[:, k])
        for k in np.flatnonzero(~problem.valid.all(axis=0)).tolist()
    }
    diagonal, point = P.reshape(n * n, B)[:: n + 1], w[1 : 1 + n]

    def filter_samples(first: int, last: int, workspace: _StretchBuffers) -> None:
        for k in range(first, last):
            for s in steps[k]:
                for row, values in zip(inputs, u, strict=True):
                    row[:] = values[s]
                predict(dt[s])
            if feed is not None:
                for row, values in zip(inputs, feed, strict=True):
                    row[:] = values[k]
            at = k - first
            update(z[k], missing.get(k), UpdateBuffers(*(each[at] for each in workspace.seen)))
            workspace.mean[at], workspace.variance[at] = point, diagonal

    return w, P, filter_samples


def _runs_of(rows: Sequence[np.ndarray], part: slice) -> list[np.ndarray]:
    """Return rows ``(count,)`` unchanged, and the columns of a part of rows ``(count, B)``."""
    return [
        row if row.ndim == 1 or row.shape[1] == 1 else row[:, part] for row in map(np.asarray, rows)
    ]


def _finite_so_far(
    workspace: _StretchBuffers, squared: np.ndarray, P: np.ndarray, before: np.ndarray
) -> np.ndarray:
    """Return ``(K, B)``: whether each run is finite, without a negative variance, up to each
    sample.
    """
    mean, variance = workspace.mean[: len(squared)], workspace.variance[: len(squared)]
    # A NaN fails each comparison.
    good = (
        (np.abs(mean).max(axis=1) < LARGEST_NUMBER)
        & (variance.min(axis=1) >= 0.0)
        & (variance.max(axis=1) < LARGEST_NUMBER)
        & (squared < LARGEST_NUMBER)
    )
    good[-1] &= np.abs(P).max(axis=(0, 1)) < LARGEST_NUMBER
    return np.logical_and.accumulate(good, axis=0) & before


def _write_history(
    history: BankHistory,
    at: slice,
    workspace: _StretchBuffers,
    good: np.ndarray,
    before: tuple[np.ndarray, np.ndarray],
) -> None:
    """Write K samples into the history. Runs that have diverged keep their last finite mean and
    variance, or those of ``before``, ``(n, B)`` each.
    """
    K = len(good)
    mean, variance = workspace.mean[:K].copy(), workspace.variance[:K].copy()
    for run in np.flatnonzero(~good[-1]):
        count = np.count_nonzero(good[:, run])
        mean[count:, :, run] = mean[count - 1, :, run] if count else before[0][:, run]
        variance[count:, :, run] = variance[count - 1, :, run] if count else before[1][:, run]
    history.mean[:, at], history.std[:, at] = (
        mean.swapaxes(0, 1),
        np.sqrt(np.maximum(variance, 0.0)).swapaxes(0, 1),
    )
    history.innovation[:, at] = np.where(good[:, None], workspace.seen.y[:K], 0.0).swapaxes(0, 1)
    history.innovation_std[:, at] = np.where(
        good[:, None], np.sqrt(workspace.seen.S[:K]), 1.0
    ).swapaxes(0, 1)


def _joined(parts: Sequence[BankPass]) -> BankPass:
    """Join the passes of parts of the runs."""
    if len(parts) == 1:
        return parts[0]

    def together(name: str, axis: int) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in parts], axis=axis)

    histories = [part.history for part in parts if part.history is not None]
    history = (
        BankHistory(
            *(
                np.concatenate([getattr(each, f.name) for each in histories], axis=2)
                for f in fields(BankHistory)
            )
        )
        if histories
        else None
    )
    covariance, log_likelihood, sound = (
        together(name, 0) for name in ("covariance", "log_likelihood", "sound")
    )
    return BankPass(
        together("mean", 1), covariance, log_likelihood, together("nis", 1), sound, history
    )
