"""One pass of many extended Kalman filters over one time base, runs on a batch axis.

The prediction is `ident.ekf`'s; measurements are taken one scalar at a time, which equals the joint update
for a diagonal R.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

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


@dataclass(frozen=True, eq=False)
class BankTrace:
    """What a smoother needs of one pass over N samples: after each update ``mean (N, n, B)`` and ``covariance (N, B, n, n)``; the
    state rows ``moved (N, B, n_x, n)`` of the transition from the sample before, less the identity; of the update ``H`` and
    ``HP (N, B, m, n)``, ``S (N, B, m, m)`` and ``y (N, B, m)``, zero, and one in S, for a missing channel."""

    mean: np.ndarray
    covariance: np.ndarray
    moved: np.ndarray
    H: np.ndarray
    HP: np.ndarray
    S: np.ndarray
    y: np.ndarray


@dataclass(frozen=True, eq=False)
class _Bench:
    """What stays the same from sample to sample: ``walk`` densities of parameters, ``nudge`` the complex step of each column,
    ``channels`` with a sample at each time, ``R`` of all channels."""

    problem: FilterProblem
    runs: BankRuns
    step: Step
    transition: RowTransition
    walk: np.ndarray | None
    nudge: np.ndarray
    channels: list[np.ndarray]
    R: np.ndarray


class _Updated(NamedTuple):
    """Outcome of an update: ``gained`` log-likelihood and ``squared`` innovation, innovation and its covariance, H and H P by channel."""

    x: np.ndarray
    P: np.ndarray
    gained: np.ndarray
    squared: np.ndarray
    channels: np.ndarray
    H: np.ndarray
    rows: np.ndarray


def run_pass(
    problem: FilterProblem, settings: FilterSettings, runs: BankRuns, keep: bool, about: np.ndarray | None = None, trace: BankTrace | None = None
) -> BankPass:
    """Filter all runs once. A run that breaks down keeps the mean and covariance of its last sound sample.

    ``about (n, N, B)`` is a trajectory to linearise about instead of the filter's own; ``trace`` is filled where given.
    """
    (n, B), (m, N), n_x = runs.start.shape, problem.valid.shape, len(problem.system.states)
    x, P = runs.start.copy(), np.array(np.broadcast_to(problem.covariance, (B, n, n)), order="C")
    last_x, last_P, sound = x, P, np.ones(B, dtype=bool)
    log_likelihood, nis = np.zeros(B), np.zeros((N, B))
    history = BankHistory(np.zeros((m, N, B)), np.ones((m, N, B)), np.zeros((n, N, B)), np.zeros((n, N, B))) if keep else None
    samples = problem.grid.sample.tolist()
    walk = problem.density[n_x:] if problem.walking else None
    nudge = (1j * COMPLEX_STEP) * np.eye(n)[:, :, None]
    channels = [np.flatnonzero(problem.valid[:, k]) for k in range(N)]
    bench = _Bench(problem, runs, settings.step, settings.transition.of_rows(n_x, problem.density), walk, nudge, channels, np.diag(problem.variance))
    with np.errstate(all="ignore"):
        for k in range(N):
            point = None if about is None or not k else about[:, k - 1].copy()
            for s in range(samples[k - 1], samples[k]) if k else ():
                x, P, D = _predict(bench, s, x, P, point)
                if trace is not None:
                    trace.moved[k] = D if s == samples[k - 1] else trace.moved[k] + D + D[:, :, :n_x] @ trace.moved[k]
            done = _update(bench, k, x, P, None if about is None else about[:, k])
            x, P, squared = done.x, done.P, done.squared
            if sound.all() and all_sound(x, P, squared):
                last_x, last_P, nis[k] = x, P, squared
                log_likelihood += done.gained
            else:
                sound = sound & sound_runs(x, P) & (np.abs(squared) < LARGEST)
                last_x, last_P = np.where(sound, x, last_x), np.where(sound[:, None, None], P, last_P)
                log_likelihood, nis[k] = log_likelihood + np.where(sound, done.gained, 0.0), np.where(sound, squared, 0.0)
            if trace is not None:
                _write(trace, k, done)
            if history is not None:
                variance = np.diagonal(last_P, axis1=1, axis2=2).T
                history.mean[:, k], history.std[:, k] = last_x, np.sqrt(np.maximum(variance, 0.0))
                for row, i in enumerate(done.channels):
                    y, S = done.rows[:, row, n], done.rows[:, row, n + 1 + row]
                    history.innovation[i, k], history.innovation_std[i, k] = np.where(sound, y, 0.0), np.where(sound, np.sqrt(S), 1.0)
    # What rounding left unsymmetric in between is of its own order; the rows of the states are mirrored in every step.
    return BankPass(last_x, 0.5 * (last_P + np.swapaxes(last_P, 1, 2)), log_likelihood, nis, sound, history)


def empty_trace(problem: FilterProblem, B: int) -> BankTrace:
    """A trace to be filled by ``run_pass``."""
    n, n_x, (m, N) = len(problem.names), len(problem.system.states), problem.valid.shape
    rows, whole = (N, B, m, n), np.zeros((N, B, n, n))
    S = np.array(np.broadcast_to(np.eye(m), (N, B, m, m)))
    return BankTrace(np.zeros((N, n, B)), whole, np.zeros((N, B, n_x, n)), np.zeros(rows), np.zeros(rows), S, np.zeros((N, B, m)))


def _write(trace: BankTrace, k: int, done: _Updated) -> None:
    n, at = len(done.x), done.channels
    trace.mean[k], trace.covariance[k] = done.x, done.P
    if at.size:
        trace.H[k][:, at], trace.HP[k][:, at], trace.y[k][:, at] = done.H, done.rows[:, :, :n], done.rows[:, :, n]
        trace.S[k][:, at[:, None], at] = done.rows[:, :, n + 1 :]


def _predict(bench: _Bench, s: int, x: np.ndarray, P: np.ndarray, point: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means, covariances and transition rows over sub-step ``s``; only the rows of the states move, and what is a random walk.

    A ``point`` to linearise at moves along in place.
    """
    problem, runs = bench.problem, bench.runs
    system, grid, n_x = problem.system, problem.grid, len(problem.system.states)
    begin, middle, end = ([row[s] for row in stage] for stage in runs.drive.stages)
    t, dt = float(grid.edges[s]), float(grid.steps[s])
    at = x if point is None else point
    values, F = values_and_jacobians(lambda a: system.f(t, a[:n_x], begin, with_free(runs.p, problem.free, a[n_x:])), at, bench.nudge)
    D, noise = bench.transition(F, dt)
    start, parameters = [at[:n_x]], with_free(runs.p, problem.free, list(at[n_x:]))

    def rates(t: Any, x: Sequence[Any], u: Sequence[Any], p: Sequence[Any]) -> list[Any]:
        # All states as one row. At the start of the step the Jacobian's call has the rates already.
        if x is start:
            return [values]
        out = np.empty_like(values)
        for i, rate in enumerate(system.f(t, list(x[0]), u, p)):
            out[i] = rate
        return [out]

    (moved,) = bench.step(rates, t, start, (begin, middle, end), parameters, dt)
    after = x.copy()
    if point is None:
        after[:n_x] = moved
    else:
        away = x - point
        point[:n_x] = moved
        after = point + away
        after[:n_x] += (D @ away.T[:, :, None])[:, :, 0].T
    out = moved_covariance(P, D, noise, bench.walk, dt)
    return after, out, D


def _update(bench: _Bench, k: int, x: np.ndarray, P: np.ndarray, point: np.ndarray | None) -> _Updated:
    """The update with the channels that have a sample, linearised at the mean or at a given point.

    Gaussian elimination on the rows of [H P, y, S] decorrelates each channel from those before it; what is left on the
    diagonal of S are the variances of independent scalars.
    """
    problem, runs = bench.problem, bench.runs
    (n, B), n_x, sample = x.shape, len(problem.system.states), problem.grid.sample[k]
    channels, R = bench.channels[k], bench.R
    m = len(channels)
    if m == 0:
        return _Updated(x, P, np.zeros(B), np.zeros(B), channels, np.zeros((B, 0, n)), np.zeros((B, 0, n + 1)))
    t, u = float(problem.grid.edges[sample]), [row[sample] for row in runs.drive.begin]
    at = x if point is None else point
    predicted, H = values_and_jacobians(lambda a: problem.system.h(t, a[:n_x], u, with_free(runs.p, problem.free, a[n_x:])), at, bench.nudge)
    if point is not None:
        predicted = predicted + (H @ (x - point).T[:, :, None])[:, :, 0].T
    y = runs.z[:, k] - predicted
    if m < len(y):
        y, H, R = y[channels], H[:, channels], R[np.ix_(channels, channels)]
    first = innovation_rows(P, H, y, R)
    x, P, gained, squared = scalar_updates(x, P, first)
    return _Updated(x, P, gained, squared, channels, H, first)


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


def innovation_rows(P: np.ndarray, H: np.ndarray, y: np.ndarray, R: np.ndarray) -> np.ndarray:
    """``[H P, y, S]`` side by side, ``(B, m, n + 1 + m)``, of innovations ``y (m, B)`` with ``H (B, m, n)`` and ``R (m, m)``."""
    B, m, n = H.shape
    first = np.empty((B, m, n + 1 + m))
    first[:, :, :n], first[:, :, n] = H @ P, y.T
    first[:, :, n + 1 :] = first[:, :, :n] @ H.transpose(0, 2, 1) + R
    return first


def scalar_updates(x: np.ndarray, P: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Means ``(n, B)`` and covariances after the channels of ``innovation_rows``, log-likelihood gained and normalised square ``(B,)``."""
    (B, m, width), n = first.shape, len(x)
    rows = first.copy()
    for i in range(m - 1):
        below = rows[:, i + 1 :]
        below -= (below[:, :, n + 1 + i] / rows[:, i, n + 1 + i, None])[:, :, None] * rows[:, i : i + 1]
    variance = rows.reshape(B, -1)[:, n + 1 :: width + 1]
    change = rows[:, :, :n].transpose(0, 2, 1) @ (rows[:, :, : n + 1] / variance[:, :, None])
    squared = np.add.reduce(rows[:, :, n] ** 2 / variance, axis=1)
    gained = -0.5 * (squared + np.add.reduce(np.log(variance), axis=1) + m * LOG_TWO_PI)
    return x + change[:, :, n].T, P - change[:, :, :n], gained, squared


def all_sound(x: np.ndarray, P: np.ndarray, squared: np.ndarray) -> bool:
    """Whether every run surely holds numbers that serve; sums of squares are the cheapest bound, and a NaN fails the comparison."""
    return bool(np.vdot(P, P) + np.vdot(x, x) + np.vdot(squared, squared) < LARGEST**2 and P.reshape(len(P), -1)[:, :: P.shape[2] + 1].min() >= 0.0)


def sound_runs(x: np.ndarray, P: np.ndarray) -> np.ndarray:
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
