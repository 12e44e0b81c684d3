"""A stretch of a pass for any equations: values and Jacobians by complex steps, any integrator and transition, runs on a batch axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ident.banks.runs import BankRuns, BankTrace, March, Stretch
from ident.filters.ekf import FilterSettings
from ident.filters.problem import FilterProblem, with_free
from sim.maths import COMPLEX_STEP


def march_of_steps(problem: FilterProblem, settings: FilterSettings, runs: BankRuns) -> March:
    """Prepare a pass; the prediction is `ident.filters.ekf`'s, the update takes all channels of a sample that are there at once."""
    system, grid, (m, _) = problem.system, problem.grid, problem.valid.shape
    n, n_x = len(problem.names), len(system.states)
    transition = settings.transition.of_rows(n_x, problem.density)
    walk = problem.density[n_x:] if problem.walking else None
    nudge = (1j * COMPLEX_STEP) * np.eye(n)[:, :, None]
    samples, R = grid.sample.tolist(), np.diag(problem.variance)

    def predict(s: int, x: np.ndarray, P: np.ndarray, point: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Means, covariances and transition rows over sub-step ``s``; a ``point`` to linearise at moves along in place."""
        stages: Any = tuple([row[s] for row in stage] for stage in runs.drive.stages)
        t, dt = float(grid.edges[s]), float(grid.steps[s])
        at = x if point is None else point
        values, F = values_and_jacobians(lambda a: system.f(t, a[:n_x], stages[0], with_free(runs.p, problem.free, a[n_x:])), at, nudge)
        D, noise = transition(F, dt)
        start, parameters = [at[:n_x]], with_free(runs.p, problem.free, list(at[n_x:]))

        def rates(t: Any, x: Sequence[Any], u: Sequence[Any], p: Sequence[Any]) -> list[Any]:
            # All states as one row. At the start of the step the Jacobian's call has the rates already.
            if x is start:
                return [values]
            out = np.empty_like(values)
            for i, rate in enumerate(system.f(t, list(x[0]), u, p)):
                out[i] = rate
            return [out]

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

    def update(k: int, x: np.ndarray, P: np.ndarray, point: np.ndarray | None, trace: BankTrace | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Means and covariances after sample ``k``, and its innovations."""
        sample, B = problem.grid.sample[k], x.shape[1]
        t, u = float(grid.edges[sample]), [row[sample] for row in runs.drive.begin]
        at = x if point is None else point
        predicted, H = values_and_jacobians(lambda a: system.h(t, a[:n_x], u, with_free(runs.p, problem.free, a[n_x:])), at, nudge)
        if point is not None:
            predicted = predicted + (H @ (x - point).T[:, :, None])[:, :, 0].T
        first = np.empty((B, m, n + 1 + m))
        first[:, :, :n], first[:, :, n] = H @ P, (runs.z[:, k] - predicted).T
        first[:, :, n + 1 :] = first[:, :, :n] @ H.transpose(0, 2, 1) + R
        missing = np.flatnonzero(~problem.valid[:, k])
        if missing.size:
            leave_out(first, missing)
        if trace is not None:
            trace.H[k], trace.HP[k], trace.y[k], trace.S[k] = H, first[:, :, :n], first[:, :, n], first[:, :, n + 1 :]
            trace.H[k, :, missing] = 0.0
        innovation = first[:, :, n:].copy()
        variance = decorrelated(first)
        change = first[:, :, :n].transpose(0, 2, 1) @ (first[:, :, : n + 1] / variance[:, :, None])
        return x + change[:, :, n].T, P - change[:, :, :n], innovation

    def march(first: int, last: int, x: np.ndarray, P: np.ndarray, about: np.ndarray | None, trace: BankTrace | None) -> Stretch:
        B, count = x.shape[1], last - first
        out = Stretch(np.empty((count, B, n)), np.empty((count, B, n, n)), np.empty((count, B, m, 1 + m)))
        for k in range(first, last):
            point = None if about is None or not k else about[:, k - 1].copy()
            for s in range(samples[k - 1], samples[k]) if k else ():
                x, P, D = predict(s, x, P, point)
                if trace is not None:
                    trace.moved[k] = D if s == samples[k - 1] else trace.moved[k] + D + D[:, :, :n_x] @ trace.moved[k]
            x, P, out.innovation[k - first] = update(k, x, P, None if about is None else about[:, k], trace)
            out.mean[k - first], out.covariance[k - first] = x.T, P
        return out

    return march


def moved_covariance(P: np.ndarray, D: np.ndarray, noise: np.ndarray | None, walk: np.ndarray | None, dt: float) -> np.ndarray:
    """Covariances ``P (B, n, n)`` moved by transitions whose first rows less the identity are ``D (B, n_x, n)``.

    ``noise`` are the same rows of Q_k, its first n_x columns or all; ``walk`` the spectral densities of the entries below, random walks.
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


def leave_out(rows: np.ndarray, missing: np.ndarray) -> None:
    """Make the missing channels of ``[H P, y, S] (B, m, width)`` ones that say nothing: zeros, and one on the diagonal of S."""
    m, width = rows.shape[1:]
    rows[:, missing] = 0.0
    rows[:, :, width - m + missing] = 0.0
    rows[:, missing, width - m + missing] = 1.0


def decorrelated(rows: np.ndarray) -> np.ndarray:
    """Variances ``(..., m)`` of channels freed in place of what those before them tell, rows ``[..., y, S] (..., m, width)``: Gaussian elimination.

    What is left on the diagonal of S are the variances of independent scalars: the update for a joint S without its inverse.
    """
    m, width = rows.shape[-2:]
    for i in range(m - 1):
        column = width - m + i
        ratio = rows[..., i + 1 :, column] / rows[..., i, column, None]
        rows[..., i + 1 :, :] -= ratio[..., None] * rows[..., i, None, :]
    return np.einsum("...ii->...i", rows[..., width - m :])


def values_and_jacobians(function: Callable[[list[Any]], Sequence[Any]], x: np.ndarray, nudge: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values ``(m, B)`` of a function at each run's ``x (n, B)`` and its Jacobians ``(B, m, n)``, all in one call.

    ``nudge (n, n, 1)`` is the complex step on the diagonal, one column of the Jacobian each.
    """
    n, B = x.shape
    out = function(list(x[:, None, :] + nudge))
    found = np.empty((len(out), n, B), dtype=complex)
    for i, value in enumerate(out):
        found[i] = value
    return found[:, 0].real.copy(), np.multiply(found.imag.transpose(2, 0, 1), 1.0 / COMPLEX_STEP, order="C")
