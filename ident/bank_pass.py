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
from sim.grid import Drive
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
    x, P = runs.start.copy(), np.array(np.broadcast_to(problem.covariance, (B, n, n)))
    last_x, last_P, sound = x.copy(), P, np.ones(B, dtype=bool)
    log_likelihood, nis = np.zeros(B), np.zeros((N, B))
    history = BankHistory(np.zeros((m, N, B)), np.ones((m, N, B)), np.zeros((n, N, B)), np.zeros((n, N, B))) if keep else None
    with np.errstate(all="ignore"):
        for k in range(N):
            if k:
                for s in range(problem.grid.sample[k - 1], problem.grid.sample[k]):
                    x, P = _predict(problem, settings, runs, s, x, P)
            x, P, gained, squared, innovation = _update(problem, runs, k, x, P, keep)
            sound = sound & _sound(x, P) & (np.abs(squared) < LARGEST)
            last_x, last_P = np.where(sound, x, last_x), P if sound.all() else np.where(sound[:, None, None], P, last_P)
            log_likelihood, nis[k] = log_likelihood + np.where(sound, gained, 0.0), np.where(sound, squared, 0.0)
            if history is not None:
                variance = np.diagonal(last_P, axis1=1, axis2=2).T
                history.mean[:, k], history.std[:, k] = last_x, np.sqrt(np.maximum(variance, 0.0))
                for i, (y, S) in innovation.items():
                    history.innovation[i, k], history.innovation_std[i, k] = np.where(sound, y, 0.0), np.where(sound, np.sqrt(S), 1.0)
    return BankPass(last_x, last_P, log_likelihood, nis, sound, history)


def _predict(problem: FilterProblem, settings: FilterSettings, runs: BankRuns, s: int, x: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means and covariances over sub-step ``s``."""
    system, grid, n_x = problem.system, problem.grid, len(problem.system.states)
    begin, middle, end = ([row[s] for row in stage] for stage in runs.drive.stages)
    t, dt = float(grid.edges[s]), float(grid.steps[s])
    F = np.zeros_like(P)
    F[:, :n_x] = jacobians(lambda a: system.f(t, a[:n_x], begin, with_free(runs.p, problem.free, a[n_x:])), x)
    Phi, noise = settings.transition(F, problem.density, dt)
    moved = settings.step(system.f, t, list(x[:n_x]), (begin, middle, end), with_free(runs.p, problem.free, list(x[n_x:])), dt)
    after = x.copy()
    for i, row in enumerate(moved):
        after[i] = row
    P = Phi @ P @ np.swapaxes(Phi, 1, 2) + noise
    return after, 0.5 * (P + np.swapaxes(P, 1, 2))


def _update(
    problem: FilterProblem, runs: BankRuns, k: int, x: np.ndarray, P: np.ndarray, keep: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[int, tuple[np.ndarray, np.ndarray]]]:
    """Means, covariances, gain of log-likelihood, NIS and, with ``keep``, innovations and their variances by channel."""
    B, n_x, at = x.shape[1], len(problem.system.states), problem.grid.sample[k]
    gained, nis = np.zeros(B), np.zeros(B)
    innovation: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    channels = np.flatnonzero(problem.valid[:, k])
    if channels.size == 0:
        return x, P, gained, nis, innovation
    t, u = float(problem.grid.edges[at]), [row[at] for row in runs.drive.begin]

    def outputs(a: Sequence[Any]) -> list[Any]:
        return problem.system.h(t, a[:n_x], u, with_free(runs.p, problem.free, a[n_x:]))

    H = jacobians(outputs, x)
    predicted = [np.broadcast_to(y, B) for y in outputs(list(x))]
    if keep:
        for i in channels:
            row = H[:, i]
            innovation[int(i)] = runs.z[i, k] - predicted[i], np.einsum("bi,bij,bj->b", row, P, row) + problem.variance[i]
    move = np.zeros_like(x)
    for i in channels:
        row = H[:, i]
        PH = (P @ row[:, :, None])[:, :, 0]
        S = np.einsum("bi,bi->b", row, PH) + problem.variance[i]
        y = runs.z[i, k] - predicted[i] - np.einsum("bi,ib->b", row, move)
        gain = PH / S[:, None]
        move += gain.T * y
        P = P - gain[:, :, None] * PH[:, None, :]
        squared = y * y / S
        nis += squared
        gained -= 0.5 * (squared + np.log(S) + LOG_TWO_PI)
    return x + move, 0.5 * (P + np.swapaxes(P, 1, 2)), gained, nis, innovation


def _sound(x: np.ndarray, P: np.ndarray) -> np.ndarray:
    """Which runs hold numbers that serve: finite and no negative variance, ``(B,)``."""
    finite = np.all(np.abs(x) < LARGEST, axis=0) & np.all(np.abs(P) < LARGEST, axis=(1, 2))
    return finite & np.all(np.diagonal(P, axis1=1, axis2=2) >= 0.0, axis=1)


def jacobians(function: Callable[[list[Any]], Sequence[Any]], x: np.ndarray) -> np.ndarray:
    """Complex-step Jacobian of each run, ``(B, m, n)``, all columns in one call."""
    n, B = x.shape
    rows = np.array(np.broadcast_to(x[:, None, :], (n, n, B)), dtype=complex)
    rows[np.arange(n), np.arange(n)] += 1j * COMPLEX_STEP
    out = function(list(rows))
    jacobian = np.empty((B, len(out), n))
    for i, value in enumerate(out):
        jacobian[:, i] = np.broadcast_to(np.imag(value), (n, B)).T / COMPLEX_STEP
    return jacobian
