"""Inputs and results of a pass of a bank of extended Kalman filters, and the kernel for any
equations.

The kernel calls the equations once for the values and Jacobians of all runs.
`ident.banks.table_kernel` is faster where the equations are bilinear.

Symbols: B runs, n states and free parameters, n_x states, m outputs, N samples, K samples of a
block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from ident.filters.ekf import FilterSettings
from ident.filters.problem import FilterProblem, with_free
from sim.maths import COMPLEX_STEP, rows_into
from sim.propagation import Drive

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


# ---- A block of a pass, for any equations


def step_block_filter(
    problem: FilterProblem, settings: FilterSettings, runs: BankRuns
) -> BlockFilter:
    """Return the function that filters a block by calls of the equations. An update uses all
    channels of a sample at once.
    """
    n, m = len(problem.names), problem.valid.shape[0]
    complex_steps = (1j * COMPLEX_STEP) * np.eye(n)[:, :, None]
    samples = problem.grid.sample.tolist()
    predict = _prediction(problem, settings, runs, complex_steps)
    update = _update(problem, runs, complex_steps)

    def filter_next_block(
        first: int,
        last: int,
        x: np.ndarray,
        P: np.ndarray,
        nominal: np.ndarray | None,
        trace: BankTrace | None,
    ) -> FilteredBlock:
        K, B = last - first, x.shape[1]
        result = FilteredBlock(
            np.empty((K, B, n)), np.empty((K, B, n, n)), np.empty((K, B, m, 1 + m))
        )
        for k in range(first, last):
            point = None if nominal is None or not k else nominal[:, k - 1].copy()
            for s in range(samples[k - 1], samples[k]) if k else ():
                x, P, D = predict(s, x, P, point)
                if trace is not None:
                    extend_transition(trace.transition[k], D, first=s == samples[k - 1])
            here = None if nominal is None else nominal[:, k]
            x, P, result.innovation[k - first] = update(k, x, P, here, trace)
            result.mean[k - first], result.covariance[k - first] = x.T, P
        return result

    return filter_next_block


def _prediction(
    problem: FilterProblem, settings: FilterSettings, runs: BankRuns, complex_steps: np.ndarray
) -> Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]:
    system, grid, n_x = problem.system, problem.grid, len(problem.system.states)
    transition = settings.transition.of_rows(n_x, problem.density)
    walk = problem.density[n_x:] if problem.walking else None

    def predict(
        s: int, x: np.ndarray, P: np.ndarray, point: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the means, the covariances and the transition matrix minus the identity
        (rows of the states) after sub-step ``s``. A ``point`` of linearisation moves along in
        place.
        """
        stages: Any = tuple([row[s] for row in stage] for stage in runs.drive.stages)
        t, dt = float(grid.edges[s]), float(grid.steps[s])
        at = x if point is None else point
        values, F = values_and_jacobians(
            lambda a: system.f(t, a[:n_x], stages[0], with_free(runs.p, problem.free, a[n_x:])),
            at,
            complex_steps,
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
        return after, predicted_covariance(P, D, noise, walk, dt), D

    return predict


def _update(
    problem: FilterProblem, runs: BankRuns, complex_steps: np.ndarray
) -> Callable[..., tuple[np.ndarray, np.ndarray, np.ndarray]]:
    system, grid, (m, _) = problem.system, problem.grid, problem.valid.shape
    n, n_x = len(problem.names), len(system.states)
    R = np.diag(problem.variance)

    def update(
        k: int, x: np.ndarray, P: np.ndarray, point: np.ndarray | None, trace: BankTrace | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the means and covariances after the update at sample ``k``, and the innovations
        with their covariances ``(B, m, 1 + m)``.
        """
        sample, B = problem.grid.sample[k], x.shape[1]
        t, u = float(grid.edges[sample]), [row[sample] for row in runs.drive.begin]
        at = x if point is None else point
        predicted, H = values_and_jacobians(
            lambda a: system.h(t, a[:n_x], u, with_free(runs.p, problem.free, a[n_x:])),
            at,
            complex_steps,
        )
        if point is not None:
            predicted = predicted + (H @ (x - point).T[:, :, None])[:, :, 0].T
        first = np.empty((B, m, n + 1 + m))
        first[:, :, :n], first[:, :, n] = H @ P, (runs.z[:, k] - predicted).T
        first[:, :, n + 1 :] = first[:, :, :n] @ H.transpose(0, 2, 1) + R
        missing = np.flatnonzero(~problem.valid[:, k])
        if missing.size:
            neutralise_missing(first, missing)
        if trace is not None:
            trace.H[k], trace.HP[k] = H, first[:, :, :n]
            trace.y[k], trace.S[k] = first[:, :, n], first[:, :, n + 1 :]
            trace.H[k, :, missing] = 0.0
        innovation = first[:, :, n:].copy()
        variance = eliminate_channels(first)
        change = first[:, :, :n].transpose(0, 2, 1) @ (first[:, :, : n + 1] / variance[:, :, None])
        return x + change[:, :, n].T, P - change[:, :, :n], innovation

    return update


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


def extend_transition(moved: np.ndarray, D: np.ndarray, *, first: bool) -> None:
    """Extend the transition ``moved (B, n_x, n)``, which lacks the identity, by the step ``D`` in
    place. ``first`` is True for the first step after a sample.
    """
    moved[:] = D if first else moved + D + D[:, :, : D.shape[1]] @ moved


def neutralise_missing(rows: np.ndarray, missing: np.ndarray) -> None:
    """Write neutral values for the ``missing`` channels into ``rows``, [H P, y, S] of shape ``(B,
    m, width)``: zeros, and one on the diagonal of S.
    """
    m, width = rows.shape[1:]
    rows[:, missing] = 0.0
    rows[:, :, width - m + missing] = 0.0
    rows[:, missing, width - m + missing] = 1.0


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
