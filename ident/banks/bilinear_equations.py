"""A stretch of a pass for bilinear equations under held inputs: the same filters as `ident.banks.any_equations`, several times faster.

Values and Jacobians of all runs come from one matrix product (`ident.bilinear_table`); a Runge-Kutta step of equations that are affine in
the states, under an input that is held, is four terms of a Taylor series, whose first two give the fundamental matrix of three terms
as well; and every product lands in room that is made once a stretch, for at this size a call costs more than its arithmetic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ident.banks.any_equations import leave_out
from ident.banks.runs import BankRuns, BankTrace, March, Stretch
from ident.bilinear_table import Bilinear, held_within_steps, system_tables
from ident.filters.ekf import FilterSettings
from ident.filters.problem import FilterProblem
from ident.filters.transition import Taylor
from sim.declaration.model import System
from sim.propagation import rk4_step

_SERIES = Taylor(3)  # the fundamental matrix that is made here


@dataclass(frozen=True, eq=False)
class Tables:
    """The equations of a filter with ``n`` states and free parameters, ``f`` and ``h``; the states that noise drives and ``share``,
    their densities with the weights of the series' terms; R ``(m, m)``."""

    n: int
    n_x: int
    f: Bilinear
    h: Bilinear
    driven: tuple[int, ...]
    share: np.ndarray
    R: np.ndarray


class Legs(NamedTuple):
    """The way between K samples: which steps lead to each; of all steps their sizes ``dt`` (s) and inputs ``u (M, B, n_u)`` or
    ``(M, 1, n_u)``; of the samples the inputs that act on the outputs, where they do, measurements ``z (K, B, m, 1)`` or
    ``(K, 1, m, 1)``, and the missing channels of each."""

    steps: Sequence[Sequence[int]]
    dt: Sequence[float]
    u: np.ndarray
    feed: np.ndarray | None
    z: np.ndarray
    missing: Sequence[np.ndarray | None]


def tables_of(system: System, p: Sequence[Any], density: np.ndarray, variance: np.ndarray) -> Tables | None:
    """The tables of a System whose free parameters are states, at held values ``p``; None where its equations have none.

    ``density (n,)`` as in ``FilterProblem``. None also for equations that ask for the time, for parameters that are random walks, and
    for a held parameter of several values that acts anywhere but on the input path.
    """
    n_x = len(system.states)
    if np.any(density[n_x:]):
        return None
    found = system_tables(system, p)
    if found is None:
        return None
    driven, order = np.flatnonzero(density), np.arange(_SERIES.terms)
    # With M_0 = I, Q_k = sum over i, j of M_i Q M_j^T dt / (i + j + 1), M_i the terms of the series.
    share = np.kron(1.0 / (order[:, None] + order + 1.0), np.diag(density[driven]))
    return Tables(found[0].n, n_x, *found, tuple(driven.tolist()), share, np.diag(np.asarray(variance, dtype=float)))


def tables_for(problem: FilterProblem, settings: FilterSettings, runs: BankRuns) -> Tables | None:
    """The tables of a pass, None where the equations, the integrator, the transition or the inputs have none."""
    if settings.step is not rk4_step or settings.transition != _SERIES or not held_within_steps(runs.drive):
        return None
    return tables_of(problem.system, runs.p, problem.density, problem.variance)


def march_of_table(problem: FilterProblem, settings: FilterSettings, runs: BankRuns) -> March | None:
    """Prepare a pass; None where the equations, the integrator, the transition or the inputs ask for `ident.banks.any_equations`."""
    tables = tables_for(problem, settings, runs)
    if tables is None:
        return None
    samples, dt = problem.grid.sample.tolist(), problem.grid.steps.tolist()
    steps = [range(0), *(range(first, last) for first, last in pairwise(samples))]
    u = _by_run(runs.drive.stages[0], len(dt))
    feed = _by_run([row[problem.grid.sample] for row in runs.drive.begin], len(samples)) if tables.h.feeds_through else None
    z = runs.z.transpose(1, 2, 0)[:, :, :, None]
    missing = [None if column.all() else np.flatnonzero(~column) for column in problem.valid.T]

    def march(first: int, last: int, x: np.ndarray, P: np.ndarray, about: np.ndarray | None, trace: BankTrace | None) -> Stretch:
        at = slice(first, last)
        legs = Legs(steps[at], dt, u, None if feed is None else feed[at], z[at], missing[at])
        return along(tables, legs, x, P, None if about is None else (about, first), None if trace is None else (trace, first))

    return march


def along(
    tables: Tables,
    legs: Legs,
    mean: np.ndarray,
    covariance: np.ndarray,
    about: tuple[np.ndarray, int] | None = None,
    trace: tuple[BankTrace, int] | None = None,
) -> Stretch:
    """Filter K samples from ``mean (n, B)`` and ``covariance (B, n, n)``; ``about`` and ``trace`` with the position of the first sample in them."""
    n, n_x, m, B, K = tables.n, tables.n_x, len(tables.R), mean.shape[1], len(legs.steps)
    out = Stretch(np.empty((K, B, n)), np.empty((K, B, n, n)), np.empty((K, B, m, 1 + m)))
    # w = (1, states, parameters, inputs) at the point of linearisation, which is the mean x unless there is one to go about.
    w = np.ones((B, len(tables.f.table)))
    w_dt, point, w_states, w_inputs, w_column = np.empty_like(w), w[:, 1 : 1 + n], w[:, 1 : 1 + n_x], w[:, 1 + n :], w[:, :, None]
    x = point if about is None else np.array(mean.T)
    x_states = x[:, :n_x]
    point[:] = mean.T
    w_inputs[:] = 0.0
    P = np.array(covariance)
    P_states, P_mirror = P[:, :n_x], P[:, n_x:, :n_x]

    # Of the step: first = [F, f, ...] dt, second = F first dt / 2, L = [D, D's column of values, C] with D = Phi - I in its first n
    # columns and C the terms that noise enters by; moved = [(I + D) P, 0, C W], and Phi P Phi^T + Q_k = moved + moved L^T.
    width, terms = n + len(w[0]), _SERIES.terms * len(tables.driven)
    first_flat, second = np.empty((B, n_x * width)), np.empty((B, n_x, n + 1))
    first = first_flat.reshape(B, n_x, width)
    first_halves, first_value, first_used, F_states = first[:, :, n:], first[:, :, n : n + 1], first[:, :, : n + 1], first[:, :, :n_x]
    second_value, value, third, fourth = second[:, :, n:], np.empty((B, n_x, 1)), np.empty((B, n_x, 1)), np.empty((B, n_x, 1))
    L, moved, own = np.zeros((B, n_x, n + 1 + terms)), np.zeros((B, n_x, n + 1 + terms)), np.empty((B, n_x, n_x))
    L_used, D, L_value, C, L_turned = L[:, :, : n + 1], L[:, :, :n], L[:, :, n], L[:, :, n + 1 :], L.transpose(0, 2, 1)
    moved_P, moved_C, moved_own, moved_mirror = moved[:, :, :n], moved[:, :, n + 1 :], moved[:, :, :n_x], moved[:, :, n_x:n].transpose(0, 2, 1)
    C[:, :, : len(tables.driven)] = np.eye(n_x)[:, list(tables.driven)]
    by_noise = [(C[:, :, j + len(tables.driven)], first[:, :, i]) for j, i in enumerate(tables.driven)]
    by_noise += [(C[:, :, j + 2 * len(tables.driven)], second[:, :, i]) for j, i in enumerate(tables.driven)]
    W = np.empty_like(tables.share)

    # Of the update: rows = [H P, y, S], freed of each other in place.
    h_flat, rows, gain, change = np.empty((B, m * width)), np.empty((B, m, n + 1 + m)), np.empty((B, m, n + 1)), np.empty((B, n, n + 1))
    h_all = h_flat.reshape(B, m, width)
    H, H_turned, h_halves, expected = h_all[:, :, :n], h_all[:, :, :n].transpose(0, 2, 1), h_all[:, :, n:], np.empty((B, m, 1))
    HP, HP_turned, y, S, used = rows[:, :, :n], rows[:, :, :n].transpose(0, 2, 1), rows[:, :, n : n + 1], rows[:, :, n + 1 :], rows[:, :, : n + 1]
    y_S, variance = rows[:, :, n:], rows.reshape(B, -1)[:, n + 1 :: n + 2 + m][:, :, None]
    change_P, change_x = change[:, :, :n], change[:, :, n]
    eliminated = [(rows[:, i + 1 :], rows[:, i + 1 :, n + 1 + i, None], rows[:, i, n + 1 + i, None, None], rows[:, i : i + 1]) for i in range(m - 1)]
    ratios = [np.empty((B, m - 1 - i, 1)) for i in range(m - 1)]
    products = [np.empty((B, m - 1 - i, n + 1 + m)) for i in range(m - 1)]

    for k, steps in enumerate(legs.steps):
        if about is not None:
            point[:] = about[0][:, max(about[1] + k - 1, 0)].T
        for s in steps:
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
            if about is None:
                np.add(rest, L_value, out=rest)
                np.add(w_states, rest, out=w_states)
            else:
                further = np.matmul(D, (x - point)[:, :, None])[:, :, 0]
                np.add(rest, L_value, out=rest)
                np.add(w_states, rest, out=w_states)
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
            if trace is not None:
                so_far = trace[0].moved[trace[1] + k]
                so_far[:] = D if s == steps[0] else so_far + D + D[:, :, :n_x] @ so_far

        if about is not None:
            point[:] = about[0][:, about[1] + k].T
        if legs.feed is not None:
            w_inputs[:] = legs.feed[k]
        np.matmul(w, tables.h.table, out=h_flat)
        np.matmul(h_halves, w_column, out=expected)
        if about is not None:
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
            kept, at = trace[0], trace[1] + k
            kept.H[at], kept.HP[at], kept.y[at], kept.S[at] = H, HP, y[:, :, 0], S
            if missing is not None:
                kept.H[at, :, missing] = 0.0
        for (below, column, pivot, row), ratio, product in zip(eliminated, ratios, products, strict=True):
            np.divide(column, pivot, out=ratio)
            np.multiply(ratio, row, out=product)
            np.subtract(below, product, out=below)
        np.divide(used, variance, out=gain)
        np.matmul(HP_turned, gain, out=change)
        np.subtract(P, change_P, out=P)
        np.add(x, change_x, out=x)
        out.mean[k], out.covariance[k] = x, P
    return out


def _by_run(rows: Sequence[np.ndarray], count: int) -> np.ndarray:
    """Rows ``(count,)`` or ``(count, B)`` side by side, ``(count, B, rows)`` or ``(count, 1, rows)``."""
    parts = np.broadcast_arrays(*(np.asarray(row).reshape(count, -1) for row in rows))
    return np.stack(parts, axis=2)
