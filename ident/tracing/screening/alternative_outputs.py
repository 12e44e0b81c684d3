"""How the outputs of a fitted model would change under many alternative parameter values, in one batch.

Every alternative is integrated over all intervals from the fitted trajectory; the defects that this leaves
are joined with the base model's transition matrices. States that the alternatives add (a mode, a lagged load)
are first driven by the fitted trajectory, each with its own dynamics: what they feed back is of second order
where they begin without influence. Exact for equations linear in the states, first order else: enough to rank candidates.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.whole_record.intervals import changed_rows, interval_ends, sample_outputs
from ident.whole_record.linearise import join_intervals
from ident.whole_record.record_problem import INCREMENT, RecordProblem
from sim.propagation.grid import Drive, drive_from_record


def alternative_outputs(
    problem: RecordProblem, p: np.ndarray, states: np.ndarray, alternatives: np.ndarray, known: int
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs at the samples for alternative parameters.

    Parameters
    ----------
    problem : the record laid out for a System. p : ``(np,)`` parameters of the base.
    states : ``(nx, K + 1)`` trajectory of the base, which obeys its equations; added states are zero in it.
    alternatives : ``(np, a)`` all parameters, a column an alternative.
    known : the first so many states are the base's own, the others are added.

    Returns
    -------
    Base outputs ``(m, N)`` and those of the alternatives ``(m, N, a)``.
    """
    with np.errstate(all="ignore"):  # an alternative may run away; its signature is then not finite, and dropped
        return _alternative_outputs(problem, p, states, alternatives, known)


def _alternative_outputs(
    problem: RecordProblem, p: np.ndarray, states: np.ndarray, alternatives: np.ndarray, known: int
) -> tuple[np.ndarray, np.ndarray]:
    n_x, a, K = len(states), alternatives.shape[1], states.shape[1] - 1
    varied = np.flatnonzero(np.any(alternatives != p[:, None], axis=1))
    few: list[Any] = p.tolist()
    for index in varied:
        few[index] = np.concatenate([[p[index]], alternatives[index]])
    X = np.array(np.broadcast_to(states[:, None], (n_x, 1 + a, K + 1)))
    if n_x > known:
        _drive_added(problem, alternatives, varied, X, known)
    size = np.sqrt(np.mean(states[:known] ** 2, axis=1))
    steps = INCREMENT * np.where(size > 0, size, 1.0)
    # Alternatives that differ only after the dynamics all move as the base does.
    after = all(problem.system.parameters.items[index].name in problem.system.output_parameters for index in varied)
    moving = 0 if after and n_x == known else a
    rows: list[Any] = p.tolist()
    for index in varied if moving else ():
        rows[index] = np.concatenate([np.full(1 + known, p[index]), alternatives[index]])
    start = np.concatenate([np.repeat(X[:, :1, :-1], 1 + known, axis=1), X[:, 1 : 1 + moving, :-1]], axis=1)
    start[np.arange(known), 1 + np.arange(known)] += steps[:, None]
    drive = _drive(problem, few, varied)
    ends = interval_ends(problem, start, _repeated(drive, known), rows)[:known]
    A = (ends[:, 1 : 1 + known] - ends[:, :1]) / steps[:, None]
    B = ends[:, 1 + known :] - X[:known, 1 : 1 + moving, 1:]
    joined = join_intervals(A, B, ends[:, 0] - X[:known, 0, 1:], (), np.zeros(known))
    X[:known] += joined if moving else joined[:, :1]
    full = sample_outputs(problem, few, list(X), drive, range(1 + moving))
    return full[:, 0], np.ascontiguousarray(full[:, 1:].swapaxes(1, 2))


def _drive_added(problem: RecordProblem, alternatives: np.ndarray, varied: np.ndarray, X: np.ndarray, known: int) -> None:
    """Trajectories of the added states under the base's motion, into ``X (nx, 1 + a, K + 1)``; alike alternatives share one."""
    from scipy.linalg.lapack import dtbtrs

    added = len(X) - known
    acting = _acting(problem, alternatives, varied, X, known)
    keys, share = np.unique(alternatives[acting], axis=1, return_inverse=True)
    chosen = [int(np.flatnonzero(share.ravel() == k)[0]) for k in range(keys.shape[1])]
    few = alternatives[:, chosen]
    count, width = len(chosen), len(chosen) * (1 + added)
    rows: list[Any] = few[:, 0].tolist()
    for index in varied:
        rows[index] = np.repeat(few[index], 1 + added)
    intervals = X.shape[2] - 1
    start = np.array(np.broadcast_to(X[:, :1, :-1], (len(X), width, intervals)))
    step = 1e-3
    for j in range(added):
        start[known + j, 1 + j :: 1 + added] += step
    ends = interval_ends(problem, start, _drive(problem, rows, varied), rows)[known:].reshape(added, count, 1 + added, intervals)
    columns = np.arange(intervals) * added
    for k in range(count):
        base = ends[:, k, 0]
        A = (ends[:, k, 1:] - base[:, None]) / step
        band = np.zeros((2 * added, (intervals + 1) * added))
        band[0] = 1.0
        for i in range(added):
            for j in range(added):
                band[added + i - j, columns + j] = -A[i, j]
        right = np.zeros((intervals + 1, added))
        right[1:] = base.T
        solution, _ = dtbtrs(band, right.reshape(-1, 1), uplo="L", diag="U")
        trajectory = solution.reshape(intervals + 1, added).T
        for column in np.flatnonzero(share.ravel() == k):
            X[known:, 1 + column] = trajectory


def _acting(problem: RecordProblem, alternatives: np.ndarray, varied: np.ndarray, X: np.ndarray, known: int) -> list[int]:
    """Which of the varied parameters move the rates of the added states."""
    system = problem.system
    middle = X.shape[2] // 2
    x = X[:, 0, middle] + 1e-2
    u = [0.01] * len(system.inputs)
    base = alternatives[:, 0].tolist()
    reference = system.f(0.0, x.tolist(), u, base)[known:]
    out = []
    for index in varied:
        other = list(base)
        other[index] = base[index] + max(1e-3, 0.1 * abs(base[index]))
        if any(a != b for a, b in zip(system.f(0.0, x.tolist(), u, other)[known:], reference, strict=True)):
            out.append(int(index))
    return out


def _repeated(drive: Drive, times: int) -> Drive:
    """The base's column so many times more."""
    return changed_rows(drive, lambda row: np.concatenate([np.repeat(row[:1], times, axis=0), row]) if np.ndim(row) == 2 else row)


def _drive(problem: RecordProblem, rows: Sequence[Any], varied: np.ndarray) -> Drive:
    """Inputs at the vehicle, rows ``(M,)`` or ``(c, M)``."""
    system, record = problem.system, problem.record
    moved = any(system.parameters.items[index].name in system.input_parameters for index in varied)
    if problem.drive is not None and not moved:
        return problem.drive
    drive = drive_from_record(system, rows, record.input_array(system.input_names), record.time, record.hold, problem.grid)
    return changed_rows(drive, np.transpose)
