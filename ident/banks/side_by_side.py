"""A plain pass of many filters of bilinear equations, runs side by side in rows: for campaigns of hundreds of runs.

A pass goes over as many runs at once as stay in a processor's cache, and looks once a stretch of samples for what broke down; where
something did, the stretch is gone over again sample by sample to find the last sound one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ident.banks.bilinear_equations import Tables, tables_for
from ident.banks.rows_of_runs import Seen, predictor, updater
from ident.banks.runs import BankHistory, BankPass, BankRuns
from ident.estimate import LARGEST
from ident.filters.ekf import FilterSettings
from ident.filters.problem import FilterProblem

Go = Callable[[int, int, "_Room"], None]
LOG_TWO_PI = float(np.log(2.0 * np.pi))
_STRETCH = 32  # samples between two looks
_AT_ONCE = 64_000  # numbers of all covariances of runs that are filtered together


def pass_side_by_side(problem: FilterProblem, settings: FilterSettings, runs: BankRuns, keep: bool) -> BankPass | None:
    """Filter all runs once, as ``run_pass``; None where the equations have no table."""
    tables = tables_for(problem, settings, runs)
    if tables is None:
        return None
    B, size = runs.start.shape[1], len(problem.names) ** 2
    width = max(8, -(-_AT_ONCE // size))
    parts = [slice(b, min(b + width, B)) for b in range(0, B, width)]
    with np.errstate(all="ignore"):
        return _joined([_filtered(problem, tables, runs, part, keep) for part in parts])


class _Room(NamedTuple):
    """What a stretch of K samples writes: means and variances ``(K, n, B)``, the updates' ``Seen`` of ``(K, m, B)``."""

    mean: np.ndarray
    variance: np.ndarray
    seen: Seen


def _filtered(problem: FilterProblem, tables: Tables, runs: BankRuns, part: slice, keep: bool) -> BankPass:
    x0 = runs.start[:, part]
    (n, B), (m, N) = x0.shape, problem.valid.shape
    w, P, go = _prepared(problem, tables, runs, part)
    point = w[1 : 1 + n]
    last_x, last_P, sound = point.copy(), P.copy(), np.ones(B, dtype=bool)
    log_likelihood, nis = np.zeros(B), np.zeros((N, B))
    history = BankHistory(np.zeros((m, N, B)), np.ones((m, N, B)), np.zeros((n, N, B)), np.zeros((n, N, B))) if keep else None
    room = _Room(np.empty((_STRETCH, n, B)), np.empty((_STRETCH, n, B)), Seen(*(np.empty((_STRETCH, m, B)) for _ in Seen._fields)))
    channels = np.count_nonzero(problem.valid, axis=0)
    for first in range(0, N, _STRETCH):
        last = min(first + _STRETCH, N)
        at, before = slice(first, last), (w.copy(), P.copy())
        go(first, last, room)
        squared = room.seen.squared[: last - first].sum(axis=1)
        gained = -0.5 * (squared + np.log(room.seen.alone[: last - first]).sum(axis=1) + channels[at, None] * LOG_TWO_PI)
        good = _sound_so_far(room, squared, P, sound)
        for row in np.where(good, gained, 0.0):  # one after the other, whatever the number of runs
            log_likelihood += row
        nis[at], sound = np.where(good, squared, 0.0), good[-1]
        if history is not None:
            _written(history, at, room, good, (last_x, last_P.reshape(n * n, B)[:: n + 1]))
        if good[-1].all():
            last_x[:], last_P[:] = point, P
            continue
        w[:], P[:] = before
        for k, serves in enumerate(good):
            go(first + k, first + k + 1, room)
            last_x[:, serves], last_P[:, :, serves] = point[:, serves], P[:, :, serves]
    return BankPass(last_x, np.ascontiguousarray(last_P.transpose(2, 0, 1)), log_likelihood, nis, sound, history)


def _prepared(
    problem: FilterProblem, tables: Tables, runs: BankRuns, part: slice
) -> tuple[np.ndarray, np.ndarray, Callable[[int, int, _Room], None]]:
    """Entries ``w (len w, B)`` and covariances ``P (n, n, B)`` at the start, and a function that filters the samples from one to before another."""
    B, n, at = len(range(*part.indices(runs.start.shape[1]))), tables.n, problem.grid.sample
    w, P = np.zeros((len(tables.f.table), B)), np.empty((n, n, B))
    w[0], w[1 : 1 + n] = 1.0, runs.start[:, part]
    covariance = problem.covariance
    P[:] = covariance[:, :, None] if covariance.ndim == 2 else covariance[part].transpose(1, 2, 0)
    inputs, predict, update = w[1 + n :], predictor(tables, w, P), updater(tables, w, P)
    steps = [range(0), *(range(a, b) for a, b in pairwise(at.tolist()))]
    u, dt = _mine(runs.drive.stages[0], part), problem.grid.steps.tolist()
    feed = _mine([row[at] for row in runs.drive.begin], part) if tables.h.feeds_through else None
    z = np.where(problem.valid[:, :, None], runs.z if runs.z.shape[2] == 1 else runs.z[:, :, part], 0.0).transpose(1, 0, 2).copy()
    missing = {k: np.flatnonzero(~problem.valid[:, k]) for k in np.flatnonzero(~problem.valid.all(axis=0)).tolist()}
    diagonal, point = P.reshape(n * n, B)[:: n + 1], w[1 : 1 + n]

    def go(first: int, last: int, room: _Room) -> None:
        for k in range(first, last):
            for s in steps[k]:
                for row, values in zip(inputs, u, strict=True):
                    row[:] = values[s]
                predict(dt[s])
            if feed is not None:
                for row, values in zip(inputs, feed, strict=True):
                    row[:] = values[k]
            at = k - first
            update(z[k], missing.get(k), Seen(*(each[at] for each in room.seen)))
            room.mean[at], room.variance[at] = point, diagonal

    return w, P, go


def _mine(rows: Sequence[np.ndarray], part: slice) -> list[np.ndarray]:
    """Rows ``(count,)`` or ``(count, B)``, of the latter the runs of a part."""
    return [row if row.ndim == 1 or row.shape[1] == 1 else row[:, part] for row in map(np.asarray, rows)]


def _sound_so_far(room: _Room, squared: np.ndarray, P: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Which runs hold numbers that serve up to each sample, finite and no negative variance: ``(K, B)``."""
    mean, variance = room.mean[: len(squared)], room.variance[: len(squared)]
    # A NaN fails each comparison.
    good = (np.abs(mean).max(axis=1) < LARGEST) & (variance.min(axis=1) >= 0.0) & (variance.max(axis=1) < LARGEST) & (squared < LARGEST)
    good[-1] &= np.abs(P).max(axis=(0, 1)) < LARGEST
    return np.logical_and.accumulate(good, axis=0) & before


def _written(history: BankHistory, at: slice, room: _Room, good: np.ndarray, before: tuple[np.ndarray, np.ndarray]) -> None:
    """Write a stretch into the history; runs that broke down stay where they were, ``before`` mean and variance ``(n, B)``."""
    K = len(good)
    mean, variance = room.mean[:K].copy(), room.variance[:K].copy()
    for run in np.flatnonzero(~good[-1]):
        count = np.count_nonzero(good[:, run])
        mean[count:, :, run] = mean[count - 1, :, run] if count else before[0][:, run]
        variance[count:, :, run] = variance[count - 1, :, run] if count else before[1][:, run]
    history.mean[:, at], history.std[:, at] = mean.swapaxes(0, 1), np.sqrt(np.maximum(variance, 0.0)).swapaxes(0, 1)
    history.innovation[:, at] = np.where(good[:, None], room.seen.y[:K], 0.0).swapaxes(0, 1)
    history.innovation_std[:, at] = np.where(good[:, None], np.sqrt(room.seen.S[:K]), 1.0).swapaxes(0, 1)


def _joined(parts: Sequence[BankPass]) -> BankPass:
    """Passes of parts of the runs as one."""
    if len(parts) == 1:
        return parts[0]

    def together(name: str, axis: int) -> np.ndarray:
        return np.concatenate([getattr(part, name) for part in parts], axis=axis)

    histories = [part.history for part in parts if part.history is not None]
    history = (
        BankHistory(*(np.concatenate([getattr(each, f.name) for each in histories], axis=2) for f in fields(BankHistory))) if histories else None
    )
    covariance, log_likelihood, sound = (together(name, 0) for name in ("covariance", "log_likelihood", "sound"))
    return BankPass(together("mean", 1), covariance, log_likelihood, together("nis", 1), sound, history)
