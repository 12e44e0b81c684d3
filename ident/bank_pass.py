"""One pass of many extended Kalman filters over one time base, runs on a batch axis.

The prediction is `ident.ekf`'s; measurements are taken one scalar at a time, which equals the joint update
for a diagonal R.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.ekf import FilterSettings
from ident.keeping import LARGEST
from ident.setup import FilterProblem, with_free
from ident.transition import RowTransition
from sim.grid import Drive
from sim.integrate import Step
from sim.maths import COMPLEX_STEP

LOG_TWO_PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class BankRuns:
    """What differs between B runs: all parameters ``p`` (entries floats or ``(B,)``), the drive, outputs ``z (m, N, B)`` or
    ``(m, N, 1)``, starting means ``start (n, B)``."""

    p: list[Any]
    drive: Drive
    z: np.ndarray
    start: np.ndarray

    def only(self, chosen: np.ndarray) -> BankRuns:
        """The chosen runs, by position."""
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
    """Sample by sample, each ``(rows, N, B)``: innovations with their standard deviations, means and standard deviations
    after each update. From the sample on where a run broke down its mean stays; an innovation that is missing is
    zero with standard deviation one."""

    innovation: np.ndarray
    innovation_std: np.ndarray
    mean: np.ndarray
    std: np.ndarray


@dataclass(frozen=True, eq=False)
class BankPass:
    """Result of one pass: mean ``(n, B)``, covariance ``(B, n, n)``, log-likelihood ``(B,)`` and nis ``(N, B)`` of the sound
    samples, ``sound (B,)``, the history when asked for."""

    mean: np.ndarray
    covariance: np.ndarray
    log_likelihood: np.ndarray
    nis: np.ndarray
    sound: np.ndarray
    history: BankHistory | None


def run_pass(problem: FilterProblem, settings: FilterSettings, runs: BankRuns, keep: bool) -> BankPass:
    """Filter all runs once. A run that breaks down keeps the mean and covariance of its last sound sample."""
    (n, B), (m, N) = runs.start.shape, problem.valid.shape
    x, P = runs.start.copy(), np.array(np.broadcast_to(problem.covariance, (B, n, n)), order="C")
    last_x, last_P, sound = x, P, np.ones(B, dtype=bool)
    log_likelihood, nis = np.zeros(B), np.zeros((N, B))
    history = BankHistory(np.zeros((m, N, B)), np.ones((m, N, B)), np.zeros((n, N, B)), np.zeros((n, N, B))) if keep else None
    samples = problem.grid.sample.tolist()
    transition = settings.transition.of_rows(len(problem.system.states), problem.density)
    walk = problem.density[len(problem.system.states) :] if problem.walking else None
    nudge = (1j * COMPLEX_STEP) * np.eye(n)[:, :, None]
    with np.errstate(all="ignore"):
        for k in range(N):
            if k:
                for s in range(samples[k - 1], samples[k]):
                    x, P = _predict(problem, settings.step, transition, walk, runs, s, x, P, nudge)
            x, P, gained, squared, innovation = _update(problem, runs, k, x, P, nudge, keep)
            if sound.all() and _all_sound(x, P, squared):
                last_x, last_P, nis[k] = x, P, squared
                log_likelihood += gained
            else:
                sound = sound & _sound(x, P) & (np.abs(squared) < LARGEST)
                last_x, last_P = np.where(sound, x, last_x), np.where(sound[:, None, None], P, last_P)
                log_likelihood, nis[k] = log_likelihood + np.where(sound, gained, 0.0), np.where(sound, squared, 0.0)
            if history is not None:
                variance = np.diagonal(last_P, axis1=1, axis2=2).T
                history.mean[:, k], history.std[:, k] = last_x, np.sqrt(np.maximum(variance, 0.0))
                for i, (y, S) in innovation.items():
                    history.innovation[i, k], history.innovation_std[i, k] = np.where(sound, y, 0.0), np.where(sound, np.sqrt(S), 1.0)
    return BankPass(last_x, last_P, log_likelihood, nis, sound, history)


def _predict(
    problem: FilterProblem,
    step: Step,
    transition: RowTransition,
    walk: np.ndarray | None,
    runs: BankRuns,
    s: int,
    x: np.ndarray,
    P: np.ndarray,
    nudge: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Means and covariances over sub-step ``s``; only the rows of the states move, and what is a random walk."""
    system, grid, n_x = problem.system, problem.grid, len(problem.system.states)
    begin, middle, end = ([row[s] for row in stage] for stage in runs.drive.stages)
    t, dt = float(grid.edges[s]), float(grid.steps[s])
    values, F = values_and_jacobians(lambda a: system.f(t, a[:n_x], begin, with_free(runs.p, problem.free, a[n_x:])), x, nudge)
    D, noise = transition(F, dt)
    start, first = list(x[:n_x]), list(values)

    def rates(t: Any, x: Sequence[Any], u: Sequence[Any], p: Sequence[Any]) -> list[Any]:
        # At the start of the step the Jacobian's call has the rates already.
        return first if x is start else system.f(t, x, u, p)

    after = x.copy()
    for i, row in enumerate(step(rates, t, start, (begin, middle, end), with_free(runs.p, problem.free, list(x[n_x:])), dt)):
        after[i] = row
    rows = P[:, :n_x] + D @ P
    rows[:, :, :n_x] += rows @ np.swapaxes(D, 1, 2)
    if noise is not None:
        rows += noise
    out = P.copy()
    out[:, :n_x] = rows
    out[:, n_x:, :n_x] = np.swapaxes(rows[:, :, n_x:], 1, 2)
    out[:, :n_x, :n_x] = 0.5 * (rows[:, :, :n_x] + np.swapaxes(rows[:, :, :n_x], 1, 2))
    if walk is not None:
        own = np.arange(n_x, len(x))
        out[:, own, own] += walk * dt
    return after, out


def _update(
    problem: FilterProblem, runs: BankRuns, k: int, x: np.ndarray, P: np.ndarray, nudge: np.ndarray, keep: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[int, tuple[np.ndarray, np.ndarray]]]:
    """Means, covariances, gain of log-likelihood, NIS and, with ``keep``, innovations and their variances by channel.

    Gaussian elimination on the rows of [H P, y, S] decorrelates each channel from those before it; what is left on the
    diagonal of S are the variances of independent scalars.
    """
    (n, B), n_x, at = x.shape, len(problem.system.states), problem.grid.sample[k]
    innovation: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    channels = np.flatnonzero(problem.valid[:, k])
    m = len(channels)
    if m == 0:
        return x, P, np.zeros(B), np.zeros(B), innovation
    t, u = float(problem.grid.edges[at]), [row[at] for row in runs.drive.begin]
    predicted, H = values_and_jacobians(lambda a: problem.system.h(t, a[:n_x], u, with_free(runs.p, problem.free, a[n_x:])), x, nudge)
    y = runs.z[:, k] - predicted
    if m < len(y):
        y, H = y[channels], H[:, channels]
    rows = np.empty((B, m, n + 1 + m))
    rows[:, :, :n], rows[:, :, n] = H @ P, y.T
    rows[:, :, n + 1 :] = rows[:, :, :n] @ np.swapaxes(H, 1, 2)
    for i, channel in enumerate(channels):
        rows[:, i, n + 1 + i] += problem.variance[channel]
        if keep:
            innovation[int(channel)] = rows[:, i, n].copy(), rows[:, i, n + 1 + i].copy()
    for i in range(m - 1):
        for j in range(i + 1, m):
            rows[:, j] -= (rows[:, j, n + 1 + i] / rows[:, i, n + 1 + i])[:, None] * rows[:, i]
    variance = np.diagonal(rows[:, :, n + 1 :], axis1=1, axis2=2)
    change = np.swapaxes(rows[:, :, :n], 1, 2) @ (rows[:, :, : n + 1] / variance[:, :, None])
    squared = (rows[:, :, n] ** 2 / variance).sum(axis=1)
    P = P - change[:, :, :n]
    gained = -0.5 * (squared + np.log(variance).sum(axis=1) + m * LOG_TWO_PI)
    return x + change[:, :, n].T, 0.5 * (P + np.swapaxes(P, 1, 2)), gained, squared, innovation


def _all_sound(x: np.ndarray, P: np.ndarray, squared: np.ndarray) -> bool:
    """Whether every run surely holds numbers that serve; sums of squares are the cheapest bound, and a NaN fails the comparison."""
    return bool(np.vdot(P, P) + np.vdot(x, x) + np.vdot(squared, squared) < LARGEST**2 and np.diagonal(P, axis1=1, axis2=2).min() >= 0.0)


def _sound(x: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Which runs hold numbers that serve: finite and no negative variance, ``(B,)``."""
    finite = np.all(np.abs(x) < LARGEST, axis=0) & np.all(np.abs(P) < LARGEST, axis=(1, 2))
    return finite & np.all(np.diagonal(P, axis1=1, axis2=2) >= 0.0, axis=1)


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
