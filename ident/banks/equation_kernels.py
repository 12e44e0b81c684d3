"""Kernels of a bank of extended Kalman filters, for any equations and for bilinear ones.

Bilinear equations: values and Jacobians of all runs come from one matrix product
(`ident.bilinear_table`). A Runge-Kutta step of equations that are affine in the states, with
constant inputs, is a Taylor series of four terms; its first two also give the fundamental matrix of
three terms. Every product is written into arrays that are allocated once for many samples, since
for such small matrices a call costs more than its arithmetic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np

from ident.bilinear_table import Bilinear, constant_within_steps, system_tables
from ident.filters.ekf import FilterSettings
from ident.filters.one_record import Taylor
from ident.filters.problem import FilterProblem, with_free
from sim.declaration.model import System
from sim.maths import COMPLEX_STEP, rows_into
from sim.propagation import Drive, rk4_step

# ---- Inputs and results of a pass of a bank of filters


@dataclass(frozen=True, eq=False)
class BankRuns:
    """Data of B runs that may differ: all parameters ``p`` (entries floats or ``(B,)``), the drive,
    outputs ``z (m, N, B)`` or ``(m, N, 1)``, starting means ``start (n, B)``.
    """

    p: list[Any]
    drive: Drive
    z: np.ndarray
    start: np.ndarray

    def only(self, chosen: np.ndarray) -> BankRuns:
        """Return the chosen runs, by position."""
        runs = self.start.shape[1]

        def cut(row: Any) -> Any:
            return row[..., chosen] if np.ndim(row) and np.shape(row)[-1] == runs > 1 else row

        def cut_rows(rows: list[Any]) -> list[Any]:
            return [cut(row) if np.ndim(row) > 1 else row for row in rows]

        begin, middle, end = (cut_rows(rows) for rows in self.drive.stages)
        drive = Drive((begin, middle, end), cut_rows(self.drive.begin), cut_rows(self.drive.end))
        return BankRuns([cut(value) for value in self.p], drive, cut(self.z), self.start[:, chosen])


@dataclass(frozen=True, eq=False)
class BankHistory:
    """Sample by sample, each ``(rows, N, B)``: innovations with their standard deviations, means
    and standard deviations after each update. A failed run keeps its last mean; an innovation that
    is missing is zero with standard deviation one.
    """

    innovation: np.ndarray
    innovation_std: np.ndarray
    mean: np.ndarray
    std: np.ndarray


@dataclass(frozen=True, eq=False)
class BankPass:
    """Result of one pass: mean ``(n, B)``, covariance ``(B, n, n)``, log-likelihood ``(B,)`` and
    nis ``(N, B)`` of the sound samples, ``sound (B,)``, the history when asked for."""

    mean: np.ndarray
    covariance: np.ndarray
    log_likelihood: np.ndarray
    nis: np.ndarray
    sound: np.ndarray
    history: BankHistory | None


@dataclass(frozen=True, eq=False)
class BankTrace:
    """Data of one pass over N samples for a smoother: after each update ``mean (N, n, B)`` and
    ``covariance (N, B, n, n)``; the state rows ``moved (N, B, n_x, n)`` of the transition from the
    sample before, less the identity; of the update ``H`` and ``HP (N, B, m, n)``, ``S (N, B, m,
    m)`` and ``y (N, B, m)``, zero, and one in S, for a missing channel.
    """

    mean: np.ndarray
    covariance: np.ndarray
    moved: np.ndarray
    H: np.ndarray
    HP: np.ndarray
    S: np.ndarray
    y: np.ndarray


def empty_trace(problem: FilterProblem, B: int) -> BankTrace:
    """Return a trace to be filled by ``run_pass``."""
    n, n_x, (m, N) = len(problem.names), len(problem.system.states), problem.valid.shape
    shapes = (N, n, B), (N, B, n, n), (N, B, n_x, n), (N, B, m, n), (N, B, m, n)
    S = np.array(np.broadcast_to(np.eye(m), (N, B, m, m)))
    mean, covariance, moved, H, HP = map(np.zeros, shapes)
    return BankTrace(mean, covariance, moved, H, HP, S, np.zeros((N, B, m)))


class PassStretch(NamedTuple):
    """K samples of a pass: after each update ``mean (K, B, n)`` and ``covariance (K, B, n, n)``,
    and of the update itself ``innovation (K, B, m, 1 + m)``, y and S side by side; a channel that
    is missing has zero in y and S, and one on the diagonal."""

    mean: np.ndarray
    covariance: np.ndarray
    innovation: np.ndarray


class March(Protocol):
    """Filters the samples ``first`` to before ``last`` from means ``x (n, B)`` and covariances ``P
    (B, n, n)`` after the sample before.

    ``about (n, N, B)`` is a trajectory to linearise about instead of the filter's own; ``trace`` is
    filled where given. A failed run continues with non-finite numbers or negative variances.
    """

    def __call__(
        self,
        first: int,
        last: int,
        x: np.ndarray,
        P: np.ndarray,
        about: np.ndarray | None,
        trace: BankTrace | None,
    ) -> PassStretch: ...


# ---- A block of a pass for any equations


def march_of_steps(problem: FilterProblem, settings: FilterSettings, runs: BankRuns) -> March:
    """Prepare a pass; the update takes all channels of a sample that are there at once."""
    n, m = len(problem.names), problem.valid.shape[0]
    nudge = (1j * COMPLEX_STEP) * np.eye(n)[:, :, None]
    samples = problem.grid.sample.tolist()
    predict = _prediction(problem, settings, runs, nudge)
    update = _update(problem, runs, nudge)

    def march(
        first: int,
        last: int,
        x: np.ndarray,
        P: np.ndarray,
        about: np.ndarray | None,
        trace: BankTrace | None,
    ) -> PassStretch:
        K, B = last - first, x.shape[1]
        out = PassStretch(np.empty((K, B, n)), np.empty((K, B, n, n)), np.empty((K, B, m, 1 + m)))
        for k in range(first, last):
            point = None if about is None or not k else about[:, k - 1].copy()
            for s in range(samples[k - 1], samples[k]) if k else ():
                x, P, D = predict(s, x, P, point)
                if trace is not None:
                    _chain(trace.moved[k], D, first=s == samples[k - 1])
            here = None if about is None else about[:, k]
            x, P, out.innovation[k - first] = update(k, x, P, here, trace)
            out.mean[k - first], out.covariance[k - first] = x.T, P
        return out

    return march


def _prediction(
    problem: FilterProblem, settings: FilterSettings, runs: BankRuns, nudge: np.ndarray
) -> Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]:
    system, grid, n_x = problem.system, problem.grid, len(problem.system.states)
    transition = settings.transition.of_rows(n_x, problem.density)
    walk = problem.density[n_x:] if problem.walking else None

    def predict(
        s: int, x: np.ndarray, P: np.ndarray, point: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the means, covariances and transition rows over sub-step ``s``; a ``point`` to
        linearise at moves along in place.
        """
        stages: Any = tuple([row[s] for row in stage] for stage in runs.drive.stages)
        t, dt = float(grid.edges[s]), float(grid.steps[s])
        at = x if point is None else point
        values, F = values_and_jacobians(
            lambda a: system.f(t, a[:n_x], stages[0], with_free(runs.p, problem.free, a[n_x:])),
            at,
            nudge,
        )
        D, noise = transition(F, dt)
        start, parameters = [at[:n_x]], with_free(runs.p, problem.free, list(at[n_x:]))

        def rates(t: Any, x: Sequence[Any], u: Sequence[Any], p: Sequence[Any]) -> list[Any]:
            # All states as one row; at the start of the step, the Jacobian's call has them already.
            if x is start:
                return [values]
            return [rows_into(np.empty_like(values), system.f(t, list(x[0]), u, p))]

        (moved,) = settings.step(rates, t, start, stages, parameters, dt)
        after = x.copy()
        if point is None:
            after[:n_x] = moved
        else:
            away = x - point
            point[:n_x] = moved
            after = point + away
            after[:n_x] += (D @ away.T[:, :, None])[:, :, 0].T
        return after, moved_covariance(P, D, noise, walk, dt), D

    return predict


def _update(
    problem: FilterProblem, runs: BankRuns, nudge: np.ndarray
) -> Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]:
    system, grid, (m, _) = problem.system, problem.grid, problem.valid.shape
    n, n_x = len(problem.names), len(system.states)
    R = np.diag(problem.variance)

    def update(
        k: int, x: np.ndarray, P: np.ndarray, point: np.ndarray | None, trace: BankTrace | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the means and covariances after sample ``k``, and its innovations."""
        sample, B = problem.grid.sample[k], x.shape[1]
        t, u = float(grid.edges[sample]), [row[sample] for row in runs.drive.begin]
        at = x if point is None else point
        predicted, H = values_and_jacobians(
            lambda a: system.h(t, a[:n_x], u, with_free(runs.p, problem.free, a[n_x:])), at, nudge
        )
        if point is not None:
            predicted = predicted + (H @ (x - point).T[:, :, None])[:, :, 0].T
        first = np.empty((B, m, n + 1 + m))
        first[:, :, :n], first[:, :, n] = H @ P, (runs.z[:, k] - predicted).T
        first[:, :, n + 1 :] = first[:, :, :n] @ H.transpose(0, 2, 1) + R
        missing = np.flatnonzero(~problem.valid[:, k])
        if missing.size:
            leave_out(first, missing)
        if trace is not None:
            trace.H[k], trace.HP[k] = H, first[:, :, :n]
            trace.y[k], trace.S[k] = first[:, :, n], first[:, :, n + 1 :]
            trace.H[k, :, missing] = 0.0
        innovation = first[:, :, n:].copy()
        variance = decorrelated(first)
        change = first[:, :, :n].transpose(0, 2, 1) @ (first[:, :, : n + 1] / variance[:, :, None])
        return x + change[:, :, n].T, P - change[:, :, :n], innovation

    return update


def moved_covariance(
    P: np.ndarray, D: np.ndarray, noise: np.ndarray | None, walk: np.ndarray | None, dt: float
) -> np.ndarray:
    """Return the covariances ``P (B, n, n)`` moved by transitions whose first rows less the
    identity are ``D (B, n_x, n)``.

    ``noise`` are the same rows of Q_k, its first n_x columns or all; ``walk`` the spectral
    densities of the entries below, random walks.
    """
    n_x, n = D.shape[1], P.shape[1]
    rows = P[:, :n_x] + D @ P
    rows[:, :, :n_x] += rows @ D.transpose(0, 2, 1)
    if noise is not None:
        rows[:, :, : noise.shape[2]] += noise
    out = P.copy()
    out[:, :n_x] = rows
    out[:, n_x:, :n_x] = rows[:, :, n_x:].transpose(0, 2, 1)
    own_block = rows[:, :, :n_x]
    out[:, :n_x, :n_x] = 0.5 * (own_block + own_block.transpose(0, 2, 1))
    if walk is not None:
        own = np.arange(n_x, n)
        out[:, own, own] += walk * dt
    return out


def _chain(moved: np.ndarray, D: np.ndarray, *, first: bool) -> None:
    """Continue the transition ``moved (B, n_x, n)`` of a sample, less the identity, over a step."""
    moved[:] = D if first else moved + D + D[:, :, : D.shape[1]] @ moved


def leave_out(rows: np.ndarray, missing: np.ndarray) -> None:
    """Write neutral values for the missing channels of ``[H P, y, S] (B, m, width)``: zeros, and
    one on the diagonal of S.
    """
    m, width = rows.shape[1:]
    rows[:, missing] = 0.0
    rows[:, :, width - m + missing] = 0.0
    rows[:, missing, width - m + missing] = 1.0


def decorrelated(rows: np.ndarray) -> np.ndarray:
    """Return the variances ``(..., m)`` of channels after elimination of those before them, rows
    ``[..., y, S] (..., m, width)``: Gaussian elimination.

    The pivots of S are variances of independent scalars, so that the update needs no inverse.
    """
    m, width = rows.shape[-2:]
    for i in range(m - 1):
        column = width - m + i
        ratio = rows[..., i + 1 :, column] / rows[..., i, column, None]
        rows[..., i + 1 :, :] -= ratio[..., None] * rows[..., i, None, :]
    return np.einsum("...ii->...i", rows[..., width - m :])


def values_and_jacobians(
    function: Callable[[list[Any]], Sequence[Any]], x: np.ndarray, nudge: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the values ``(m, B)`` of a function at each run's ``x (n, B)`` and its Jacobians ``(B,
    m, n)``, all in one call.

    ``nudge (n, n, 1)`` is the complex step on the diagonal, one column of the Jacobian each.
    """
    n, B = x.shape
    values = function(list(x[:, None, :] + nudge))
    result = rows_into(np.empty((len(values), n, B), dtype=complex), values)
    slopes = np.multiply(result.imag.transpose(2, 0, 1), 1.0 / COMPLEX_STEP, order="C")
    return result[:, 0].real.copy(), slopes


# ---- A block of a pass for bilinear equations with held inputs

_SERIES = Taylor(3)  # order of the fundamental matrix here


@dataclass(frozen=True, eq=False)
class Tables:
    """The equations of a filter with ``n`` states and free parameters, ``f`` and ``h``; the states
    that noise drives and ``share``, their densities with the weights of the series' terms; R ``(m,
    m)``."""

    n: int
    n_x: int
    f: Bilinear
    h: Bilinear
    driven: tuple[int, ...]
    share: np.ndarray
    R: np.ndarray


class Legs(NamedTuple):
    """Steps between K samples: the steps before each; of all steps their sizes ``dt`` (s) and
    inputs ``u (M, B, n_u)`` or ``(M, 1, n_u)``; of the samples the inputs that act on the outputs,
    where they do, measurements ``z (K, B, m, 1)`` or ``(K, 1, m, 1)``, and the missing channels of
    each.
    """

    steps: Sequence[Sequence[int]]
    dt: Sequence[float]
    u: np.ndarray
    feed: np.ndarray | None
    z: np.ndarray
    missing: Sequence[np.ndarray | None]


def tables_of(
    system: System, p: Sequence[Any], density: np.ndarray, variance: np.ndarray
) -> Tables | None:
    """Return the tables of a System whose free parameters are states, at held values ``p``; None
    without tables.

    ``density (n,)`` as in ``FilterProblem``. None also for equations that ask for the time, for
    parameters that are random walks, and for a held parameter of several values that acts anywhere
    but on the input path.
    """
    n_x = len(system.states)
    if np.any(density[n_x:]):
        return None
    if (result := system_tables(system, p)) is None:
        return None
    driven, order = np.flatnonzero(density), np.arange(_SERIES.terms)
    # With M_0 = I, Q_k = sum over i, j of M_i Q M_j^T dt / (i + j + 1), M_i the terms of the
    # series.
    share = np.kron(1.0 / (order[:, None] + order + 1.0), np.diag(density[driven]))
    R = np.diag(np.asarray(variance, dtype=float))
    return Tables(result[0].n, n_x, *result, tuple(driven.tolist()), share, R)


def tables_for(problem: FilterProblem, settings: FilterSettings, runs: BankRuns) -> Tables | None:
    """Return the tables of a pass; None if equations, integrator, transition or inputs forbid."""
    as_series = settings.step is rk4_step and settings.transition == _SERIES
    if not as_series or not constant_within_steps(runs.drive):
        return None
    return tables_of(problem.system, runs.p, problem.density, problem.variance)


def march_of_table(
    problem: FilterProblem, settings: FilterSettings, runs: BankRuns
) -> March | None:
    """Prepare a pass by ``tables_for``; None without tables."""
    if (tables := tables_for(problem, settings, runs)) is None:
        return None
    samples, dt = problem.grid.sample.tolist(), problem.grid.steps.tolist()
    steps = [range(0), *(range(first, last) for first, last in pairwise(samples))]
    u = _by_run(runs.drive.stages[0], len(dt))
    at_samples = [row[problem.grid.sample] for row in runs.drive.begin]
    feed = _by_run(at_samples, len(samples)) if tables.h.feeds_through else None
    z = runs.z.transpose(1, 2, 0)[:, :, :, None]
    missing = [None if column.all() else np.flatnonzero(~column) for column in problem.valid.T]

    def march(
        first: int,
        last: int,
        x: np.ndarray,
        P: np.ndarray,
        about: np.ndarray | None,
        trace: BankTrace | None,
    ) -> PassStretch:
        at = slice(first, last)
        legs = Legs(steps[at], dt, u, None if feed is None else feed[at], z[at], missing[at])
        point = None if about is None else (about, first)
        return filter_stretch(tables, legs, x, P, point, None if trace is None else (trace, first))

    return march


def filter_stretch(
    tables: Tables,
    legs: Legs,
    mean: np.ndarray,
    covariance: np.ndarray,
    about: tuple[np.ndarray, int] | None = None,
    trace: tuple[BankTrace, int] | None = None,
) -> PassStretch:
    """Filter K samples from ``mean (n, B)`` and ``covariance (B, n, n)``.

    ``about``: trajectory ``(n, N, B)`` to linearise about, and the position of the first sample in
    it; None: about the mean. ``trace``: history to fill, and the position of the first sample.
    """
    n, m, B, K = tables.n, len(tables.R), mean.shape[1], len(legs.steps)
    out = PassStretch(np.empty((K, B, n)), np.empty((K, B, n, n)), np.empty((K, B, m, 1 + m)))
    w = np.ones((B, len(tables.f.table)))
    w[:, 1 + n :] = 0.0
    point = w[:, 1 : 1 + n]
    point[:] = mean.T
    x = point if about is None else np.array(mean.T)
    P = np.array(covariance)
    predict = _table_prediction(tables, legs, w, x, P)
    update = _table_update(tables, legs, w, x, P)
    for k, steps in enumerate(legs.steps):
        if about is not None:
            point[:] = about[0][:, max(about[1] + k - 1, 0)].T
        for s in steps:
            D = predict(s)
            if trace is not None:
                _chain(trace[0].moved[trace[1] + k], D, first=s == steps[0])
        if about is not None:
            point[:] = about[0][:, about[1] + k].T
        update(k, out, trace)
        out.mean[k], out.covariance[k] = x, P
    return out


def _table_prediction(
    tables: Tables, legs: Legs, w: np.ndarray, x: np.ndarray, P: np.ndarray
) -> Callable[[int], np.ndarray]:
    """Return a function of a step's number that moves ``w (B, len w)``, the means ``x (B, n)`` and
    the covariances ``P (B, n, n)`` over it, and returns Phi - I ``(B, n_x, n)``.

    ``w`` = (1, states, parameters, inputs) is the point of linearisation; ``x`` is a view of it
    where filters are linearised about their means.
    """
    n, n_x, B = tables.n, tables.n_x, len(x)
    w_dt, point, w_states = np.empty_like(w), w[:, 1 : 1 + n], w[:, 1 : 1 + n_x]
    w_inputs, w_column = w[:, 1 + n :], w[:, :, None]
    about_mean, x_states = np.may_share_memory(w, x), x[:, :n_x]
    P_states, P_mirror = P[:, :n_x], P[:, n_x:, :n_x]
    # first = [F, f, ...] dt, second = F first dt / 2, L = [D, D's column of values, C] with
    # D = Phi - I in its first n columns and C the terms that noise enters by; moved = [(I + D) P,
    # 0, C W], and Phi P Phi^T + Q_k = moved + moved L^T.
    width, terms = n + len(w[0]), _SERIES.terms * len(tables.driven)
    first_flat, second = np.empty((B, n_x * width)), np.empty((B, n_x, n + 1))
    first = first_flat.reshape(B, n_x, width)
    first_halves, first_value = first[:, :, n:], first[:, :, n : n + 1]
    first_used, F_states = first[:, :, : n + 1], first[:, :, :n_x]
    second_value, value = second[:, :, n:], np.empty((B, n_x, 1))
    third, fourth = np.empty((B, n_x, 1)), np.empty((B, n_x, 1))
    L, moved = np.zeros((B, n_x, n + 1 + terms)), np.zeros((B, n_x, n + 1 + terms))
    own = np.empty((B, n_x, n_x))
    L_used, D, L_value = L[:, :, : n + 1], L[:, :, :n], L[:, :, n]
    C, L_turned = L[:, :, n + 1 :], L.transpose(0, 2, 1)
    moved_P, moved_C = moved[:, :, :n], moved[:, :, n + 1 :]
    moved_own, moved_mirror = moved[:, :, :n_x], moved[:, :, n_x:n].transpose(0, 2, 1)
    driven = list(tables.driven)
    C[:, :, : len(driven)] = np.eye(n_x)[:, driven]
    by_noise = [
        (C[:, :, j + power * len(driven)], term[:, :, i])
        for power, term in ((1, first), (2, second))
        for j, i in enumerate(driven)
    ]
    W = np.empty_like(tables.share)

    def predict(s: int) -> np.ndarray:
        dt = legs.dt[s]
        w_inputs[:] = legs.u[s]
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
        further = None if about_mean else np.matmul(D, (x - point)[:, :, None])[:, :, 0]
        np.add(rest, L_value, out=rest)
        np.add(w_states, rest, out=w_states)
        if further is not None:
            np.add(x_states, rest + further, out=x_states)
        np.matmul(D, P, out=moved_P)
        np.add(moved_P, P_states, out=moved_P)
        if by_noise:
            for column, term in by_noise:
                column[:] = term
            np.multiply(tables.share, dt, out=W)
            np.matmul(C, W, out=moved_C)
        np.matmul(moved, L_turned, out=own)
        np.add(moved_own, own, out=moved_own)
        P_states[:] = moved_P
        P_mirror[:] = moved_mirror
        return D

    return predict


def _table_update(
    tables: Tables, legs: Legs, w: np.ndarray, x: np.ndarray, P: np.ndarray
) -> Callable[[int, PassStretch, tuple[BankTrace, int] | None], None]:
    """Return a function of a sample's number that updates ``x (B, n)`` and ``P (B, n, n)`` with its
    measurements, and writes the innovations into the pass and the history; ``w`` as for the
    prediction.
    """
    n, m, B, width = tables.n, len(tables.R), len(x), tables.n + w.shape[1]
    about_mean, point = np.may_share_memory(w, x), w[:, 1 : 1 + n]
    w_inputs, w_column = w[:, 1 + n :], w[:, :, None]
    # rows = [H P, y, S], in which each channel is eliminated from those after it.
    h_flat, rows = np.empty((B, m * width)), np.empty((B, m, n + 1 + m))
    gain, change = np.empty((B, m, n + 1)), np.empty((B, n, n + 1))
    h_all = h_flat.reshape(B, m, width)
    H, H_turned = h_all[:, :, :n], h_all[:, :, :n].transpose(0, 2, 1)
    h_halves, expected = h_all[:, :, n:], np.empty((B, m, 1))
    HP, HP_turned = rows[:, :, :n], rows[:, :, :n].transpose(0, 2, 1)
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

    def update(k: int, out: PassStretch, trace: tuple[BankTrace, int] | None) -> None:
        if legs.feed is not None:
            w_inputs[:] = legs.feed[k]
        np.matmul(w, tables.h.table, out=h_flat)
        np.matmul(h_halves, w_column, out=expected)
        if not about_mean:
            np.add(expected, np.matmul(H, (x - point)[:, :, None]), out=expected)
        np.matmul(H, P, out=HP)
        np.subtract(legs.z[k], expected, out=y)
        np.matmul(HP, H_turned, out=S)
        np.add(S, tables.R, out=S)
        missing = legs.missing[k]
        if missing is not None:
            leave_out(rows, missing)
        out.innovation[k] = y_S
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
        np.matmul(HP_turned, gain, out=change)
        np.subtract(P, change_P, out=P)
        np.add(x, change_x, out=x)

    return update


def _by_run(rows: Sequence[np.ndarray], count: int) -> np.ndarray:
    """Return rows ``(count,)`` or ``(count, B)`` as ``(count, 1, rows)``, ``(count, B, rows)``."""
    parts = (np.asarray(row).reshape(count, -1) for row in rows)
    return np.stack(np.broadcast_arrays(*parts), axis=2)
