"""Outputs of a record for many alternative parameters at once, linearised about one motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.whole_record.linearise import join_intervals
from ident.whole_record.record_problem import (
    DIFFERENCE_STEP_SHARE,
    RecordProblem,
    changed_rows,
    interval_ends,
    sample_outputs,
)
from sim.propagation import Drive, drive_from_record

# numbers of an output computed together; more do not fit the processor's cache
_LARGEST_BATCH = 60_000


@dataclass(frozen=True, eq=False)
class BaseMotion:
    """Motion of the base, about which alternatives are simulated.

    ``slopes (known, known, K)`` of the states after each interval by those before; ``states (known,
    K + 1)`` of the equations on this grid.
    """

    slopes: np.ndarray
    states: np.ndarray


def base_motion(
    problem: RecordProblem, p: np.ndarray, states: np.ndarray, known: int, drive: Drive
) -> BaseMotion:
    """Return the motion about parameters ``p (np,)`` and a trajectory ``states (nx, K + 1)``, whose
    first ``known`` states belong to the base; ``drive`` rows ``(M,)``.
    """
    size = np.sqrt(np.mean(states[:known] ** 2, axis=1))
    steps = DIFFERENCE_STEP_SHARE * np.where(size > 0, size, 1.0)
    start = np.repeat(states[:, None, :-1], 1 + known, axis=1)
    start[np.arange(known), 1 + np.arange(known)] += steps[:, None]
    with np.errstate(all="ignore"):
        ends = interval_ends(problem, list(start), drive, p.tolist())[:known]
        A = (ends[:, 1:] - ends[:, :1]) / steps[:, None]
        defects = ends[:, 0] - states[:known, 1:]
        return BaseMotion(
            A, states[:known] + join_intervals(A, A[:, :0], defects, (), np.zeros(known))[:, 0]
        )


def alternative_outputs(
    problem: RecordProblem,
    p: np.ndarray,
    states: np.ndarray,
    alternatives: np.ndarray,
    known: int,
    base: BaseMotion | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs at the samples for alternative parameters.

    Parameters
    ----------
    problem : the record laid out for a System.
    p : ``(np,)`` parameters of the base.
    states : ``(nx, K + 1)`` trajectory of the base, which obeys its equations; added states are
        zero in it.
    alternatives : ``(np, a)`` all parameters, a column an alternative.
    known : the number of states of the base; further ones are added.
    base : its motion under these inputs, if computed before.

    Returns
    -------
    Base outputs ``(m, N)`` and those of the alternatives ``(m, N, a)``.
    """
    few = max(1, _LARGEST_BATCH // states.shape[1])
    varied = np.flatnonzero(np.any(alternatives != p[:, None], axis=1))
    outputs = np.empty(
        (len(problem.system.outputs), alternatives.shape[1], len(problem.grid.sample))
    )
    # a divergent alternative gives infinite outputs and is dropped
    with np.errstate(all="ignore"):
        for first in range(0, alternatives.shape[1], few):
            some = slice(first, first + few)
            y, outputs[:, some], base = _outputs_of_some(
                problem, p, states, alternatives[:, some], varied, known, base
            )
    return y, outputs.swapaxes(1, 2)


def _outputs_of_some(
    problem: RecordProblem,
    p: np.ndarray,
    states: np.ndarray,
    alternatives: np.ndarray,
    varied: np.ndarray,
    known: int,
    base: BaseMotion | None,
) -> tuple[np.ndarray, np.ndarray, BaseMotion]:
    """Return the base outputs, those of a few alternatives ``(m, a, N)``, and the base's motion;
    ``varied`` are the parameters that differ in any alternative.
    """
    n_x, a, K = len(states), alternatives.shape[1], states.shape[1] - 1
    rows: list[Any] = p.tolist()
    for index in varied:
        rows[index] = np.concatenate([[p[index]], alternatives[index]])
    drive = _drive(problem, rows, varied)
    base = base or base_motion(
        problem,
        p,
        states,
        known,
        changed_rows(drive, lambda row: row[0] if np.ndim(row) == 2 else row),
    )
    X = np.zeros((n_x, 1 + a, K + 1))
    X[:known] = base.states[:, None]
    if n_x > known:
        X[known:, 1:] = _added_states(problem, alternatives, varied, states, known)
    # Alternatives that differ only in the output equation have the motion of the base.
    after = all(
        problem.system.parameters.items[index].name in problem.system.output_parameters
        for index in varied
    )
    moving = 0 if after and n_x == known else a
    if moving:
        start = [*(row[None, :-1] for row in states[:known]), *(row[1:, :-1] for row in X[known:])]
        own = [value[1:] if np.ndim(value) else value for value in rows]
        ends = interval_ends(
            problem,
            start,
            changed_rows(drive, lambda row: row[1:] if np.ndim(row) == 2 else row),
            own,
            a,
        )[:known]
        ends -= states[:known, None, 1:]
        X[:known, 1:] = states[:known, None] + join_intervals(
            base.slopes, ends[:, 1:], ends[:, 0], (), np.zeros(known)
        )
    full = sample_outputs(problem, rows, list(X), drive, range(1 + moving))
    return full[:, 0], full[:, 1:], base


def _added_states(
    problem: RecordProblem,
    alternatives: np.ndarray,
    varied: np.ndarray,
    states: np.ndarray,
    known: int,
) -> np.ndarray:
    """Return trajectories of the added states under the base's motion, ``(nx - known, a, K + 1)``;
    equal alternatives share one.
    """
    from scipy.linalg.lapack import dtbtrs

    added, intervals = len(states) - known, states.shape[1] - 1
    acting = _parameters_of_added_states(problem, alternatives, varied, states, known)
    keys, share = np.unique(alternatives[acting], axis=1, return_inverse=True)
    chosen = [int(np.flatnonzero(share.ravel() == k)[0]) for k in range(keys.shape[1])]
    few = alternatives[:, chosen]
    count, width = len(chosen), len(chosen) * (1 + added)
    rows: list[Any] = few[:, 0].tolist()
    for index in varied:
        rows[index] = np.repeat(few[index], 1 + added)
    moved = np.repeat(states[known:, None, :-1], width, axis=1)
    step = 1e-3
    for j in range(added):
        moved[j, 1 + j :: 1 + added] += step
    start = [*(row[None, :-1] for row in states[:known]), *moved]
    ends = interval_ends(problem, start, _drive(problem, rows, varied), rows, width)[
        known:
    ].reshape(added, count, 1 + added, intervals)
    found = np.empty((added, alternatives.shape[1], intervals + 1))
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
        found[:, share.ravel() == k] = trajectory[:, None]
    return found


def _parameters_of_added_states(
    problem: RecordProblem,
    alternatives: np.ndarray,
    varied: np.ndarray,
    states: np.ndarray,
    known: int,
) -> list[int]:
    """Return the varied parameters that act on the rates of the added states."""
    system = problem.system
    x = states[:, states.shape[1] // 2] + 1e-2
    u = [0.01] * len(system.inputs)
    base = alternatives[:, 0].tolist()
    reference = system.f(0.0, x.tolist(), u, base)[known:]
    out = []
    for index in varied:
        other = list(base)
        other[index] = base[index] + max(1e-3, 0.1 * abs(base[index]))
        if any(
            a != b
            for a, b in zip(system.f(0.0, x.tolist(), u, other)[known:], reference, strict=True)
        ):
            out.append(int(index))
    return out


def _drive(
    problem: RecordProblem, rows: Sequence[Any], varied: Sequence[int] | np.ndarray
) -> Drive:
    """Return the inputs at the vehicle, rows ``(M,)`` or ``(c, M)``."""
    system, record = problem.system, problem.record
    moved = any(system.parameters.items[index].name in system.input_parameters for index in varied)
    if problem.drive is not None and not moved:
        return problem.drive
    drive = drive_from_record(
        system, rows, record.input_array(system.input_names), record.time, record.hold, problem.grid
    )
    return changed_rows(drive, np.transpose)
