"""One pass of many extended Kalman filters over one time base, runs on a batch axis.

A pass goes over its samples in stretches: by the table of its equations where they have one (`ident.banks.bilinear_equations`), else step by
step (`ident.banks.any_equations`). What broke down is looked for once a stretch.
"""

from __future__ import annotations

import numpy as np

from ident.banks.any_equations import decorrelated, march_of_steps
from ident.banks.bilinear_equations import march_of_table
from ident.banks.runs import BankHistory, BankPass, BankRuns, BankTrace, Stretch
from ident.banks.side_by_side import pass_side_by_side
from ident.estimate import LARGEST
from ident.filters.ekf import FilterSettings
from ident.filters.problem import FilterProblem

LOG_TWO_PI = float(np.log(2.0 * np.pi))
_STRETCH = 32  # samples; more gain nothing and cost memory


def run_pass(
    problem: FilterProblem,
    settings: FilterSettings,
    runs: BankRuns,
    keep: bool,
    about: np.ndarray | None = None,
    trace: BankTrace | None = None,
    *,
    in_rows: bool = False,
) -> BankPass:
    """Filter all runs once. A run that breaks down keeps the mean and covariance of its last sound sample.

    ``about (n, N, B)`` is a trajectory to linearise about instead of the filter's own; ``trace`` is filled where given. ``in_rows`` asks
    for `ident.banks.side_by_side` where the equations have a table: from a hundred runs on the faster way, and below the slower one, by
    which no run's numbers depend on which others there are.
    """
    if in_rows and about is None and trace is None:
        plain = pass_side_by_side(problem, settings, runs, keep)
        if plain is not None:
            return plain
    (n, B), (m, N) = runs.start.shape, problem.valid.shape
    x, P = runs.start, np.array(np.broadcast_to(problem.covariance, (B, n, n)), order="C")
    last_x, last_P, sound = x, P, np.ones(B, dtype=bool)
    log_likelihood, nis = np.zeros(B), np.zeros((N, B))
    history = BankHistory(np.zeros((m, N, B)), np.ones((m, N, B)), np.zeros((n, N, B)), np.zeros((n, N, B))) if keep else None
    with np.errstate(all="ignore"):
        march = march_of_table(problem, settings, runs) or march_of_steps(problem, settings, runs)
        for first in range(0, N, _STRETCH):
            last = min(first + _STRETCH, N)
            done = march(first, last, x, P, about, trace)
            x, P = done.mean[-1].T, done.covariance[-1]
            gained, squared = worth(done.innovation, problem.valid[:, first:last])
            good = sound_so_far(done, squared, sound)
            log_likelihood = log_likelihood + np.where(good, gained, 0.0).sum(axis=0)
            nis[first:last] = np.where(good, squared, 0.0)
            if trace is not None:
                trace.mean[first:last], trace.covariance[first:last] = done.mean.transpose(0, 2, 1), done.covariance
            if history is not None:
                _keep(history, slice(first, last), done, good, (last_x, last_P))
            last_x, last_P, sound = *_kept(done, good, last_x, last_P), good[-1]
    # What rounding left unsymmetric in between is of its own order; the rows of the states are mirrored in every step.
    return BankPass(last_x, 0.5 * (last_P + np.swapaxes(last_P, 1, 2)), log_likelihood, nis, sound, history)


def worth(innovation: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log-likelihood gained and normalised square, ``(K, B)`` each, of innovations ``(K, B, m, 1 + m)`` as in ``Stretch``; ``valid (m, K)``."""
    rows = innovation.copy()
    variance = decorrelated(rows)
    squared = (rows[..., 0] ** 2 / variance).sum(axis=-1)
    channels = np.count_nonzero(valid, axis=0)[:, None]
    return -0.5 * (squared + np.log(variance).sum(axis=-1) + channels * LOG_TWO_PI), squared


def sound_so_far(done: Stretch, squared: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Which runs hold numbers that serve up to each sample, finite and no negative variance: ``(K, B)``, from ``before (B,)``."""
    variance = np.diagonal(done.covariance, axis1=2, axis2=3)
    # What is not finite stays so: the last sample tells of all. Sums of squares are the cheapest bound, and a NaN fails the comparison.
    ends = [each.ravel() for each in (done.mean[-1], done.covariance[-1], squared)]
    if before.all() and sum(np.vdot(each, each) for each in ends) < LARGEST**2 and variance.min() >= 0.0:
        return np.ones(squared.shape, dtype=bool)
    good = np.all(np.abs(done.mean) < LARGEST, axis=2) & np.all(np.abs(done.covariance) < LARGEST, axis=(2, 3))
    good &= np.all(variance >= 0.0, axis=2) & (np.abs(squared) < LARGEST)
    return np.logical_and.accumulate(good, axis=0) & before


def _kept(done: Stretch, good: np.ndarray, x: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean ``(n, B)`` and covariance ``(B, n, n)`` of each run after its last sound sample; ``x`` and ``P`` are those before the stretch."""
    if good[-1].all():
        return done.mean[-1].T, done.covariance[-1]
    out_x, out_P, count = x.copy(), P.copy(), np.count_nonzero(good, axis=0)
    for run in np.flatnonzero(count):
        out_x[:, run], out_P[run] = done.mean[count[run] - 1, run], done.covariance[count[run] - 1, run]
    return out_x, out_P


def _keep(history: BankHistory, at: slice, done: Stretch, good: np.ndarray, before: tuple[np.ndarray, np.ndarray]) -> None:
    """Write a stretch into the history; runs that broke down stay where they were."""
    mean, variance = done.mean, np.diagonal(done.covariance, axis1=2, axis2=3)
    if not good.all():
        count = np.count_nonzero(good, axis=0)
        row = np.minimum(np.arange(len(mean))[:, None], count - 1)  # the last sound sample so far, -1 where it lies before the stretch
        mean = np.where((row >= 0)[:, :, None], np.take_along_axis(mean, np.maximum(row, 0)[:, :, None], axis=0), before[0].T)
        variance_before = np.diagonal(before[1], axis1=1, axis2=2)
        variance = np.where((row >= 0)[:, :, None], np.take_along_axis(variance, np.maximum(row, 0)[:, :, None], axis=0), variance_before)
    history.mean[:, at], history.std[:, at] = mean.transpose(2, 0, 1), np.sqrt(np.maximum(variance, 0.0)).transpose(2, 0, 1)
    y, S = done.innovation[..., 0], np.diagonal(done.innovation[..., 1:], axis1=2, axis2=3)
    history.innovation[:, at] = np.where(good[:, :, None], y, 0.0).transpose(2, 0, 1)
    history.innovation_std[:, at] = np.where(good[:, :, None], np.sqrt(S), 1.0).transpose(2, 0, 1)
