"""Outputs of a record for many sets of parameters (trials) at once, linearised about one motion:
the base.

The trials may have a System with more states than the base. The states of the base come
first, and the added states follow.
"""

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

# most values of one output that are computed at once; more do not fit the processor's cache
_LARGEST_BATCH = 60_000


@dataclass(frozen=True, eq=False)
class BaseMotion:
    """Motion of the base, about which trials are simulated.

    Attributes
    ----------
    slopes : ``(n_base, n_base, K)`` derivatives of the states at the end of each interval with
        respect to the states at its beginning (second axis).
    states : ``(n_base, K + 1)`` trajectory that obeys the equations on the grid of the record.
    """

    slopes: np.ndarray
    states: np.ndarray


def base_motion(
    problem: RecordProblem, p: np.ndarray, states: np.ndarray, n_base: int, drive: Drive
) -> BaseMotion:
    """Return the motion of the base at parameters ``p (np,)``, about a trajectory ``states (nx, K +
    1)``.

    The first ``n_base`` states belong to the base. The rows of the ``drive`` are ``(M,)``.
    """
    size = np.sqrt(np.mean(states[:n_base] ** 2, axis=1))
    steps = DIFFERENCE_STEP_SHARE * np.where(size > 0, size, 1.0)
    start = np.repeat(states[:, None, :-1], 1 + n_base, axis=1)
    start[np.arange(n_base), 1 + np.arange(n_base)] += steps[:, None]
    with np.errstate(all="ignore"):
        ends = interval_ends(problem, list(start), drive, p.tolist())[:n_base]
        A = (ends[:, 1:] - ends[:, :1]) / steps[:, None]
        defects = ends[:, 0] - states[:n_base, 1:]
        return BaseMotion(
            A,
            states[:n_base] + join_intervals(A, A[:, :0], defects, (), np.zeros(n_base))[:, 0],
        )


def trial_outputs(
    problem: RecordProblem,
    p: np.ndarray,
    states: np.ndarray,
    trials: np.ndarray,
    n_base: int,
    base: BaseMotion | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the outputs at the samples for the base and for trial parameters. Outputs of a
    divergent trial are not finite.

    Parameters
    ----------
    problem : the record laid out for the System of the trials.
    p : ``(np,)`` parameters of the base.
    states : ``(nx, K + 1)`` trajectory of the base, which obeys its equations; added states are
        zero in it.
    trials : ``(np, a)`` all parameters; each column is one trial.
    n_base : number of states of the base; further states are added ones.
    base : motion of the base under these inputs; None computes it.

    Returns
    -------
    Outputs of the base ``(m, N)`` and of the trials ``(m, N, a)``.
    """
    batch_size = max(1, _LARGEST_BATCH // states.shape[1])
    varied = np.flatnonzero(np.any(trials != p[:, None], axis=1))
    outputs = np.empty((len(problem.system.outputs), trials.shape[1], len(problem.grid.sample)))
    # a divergent trial overflows; the caller drops it
    with np.errstate(all="ignore"):
        for first in range(0, trials.shape[1], batch_size):
            batch = slice(first, first + batch_size)
            y, outputs[:, batch], base = _outputs_of_batch(
                problem, p, states, trials[:, batch], varied, n_base, base
            )
    return y, outputs.swapaxes(1, 2)


def _outputs_of_batch(
    problem: RecordProblem,
    p: np.ndarray,
    states: np.ndarray,
    trials: np.ndarray,
    varied: np.ndarray,
    n_base: int,
    base: BaseMotion | None,
) -> tuple[np.ndarray, np.ndarray, BaseMotion]:
    """Return the outputs of the base ``(m, N)`` and of a batch of trials ``(m, a, N)``, and the
    motion of the base.

    ``varied`` are the positions of the parameters that differ from the base in any trial.
    """
    n_x, a, K = len(states), trials.shape[1], states.shape[1] - 1
    rows: list[Any] = p.tolist()
    for index in varied:
        rows[index] = np.concatenate([[p[index]], trials[index]])
    drive = _vehicle_inputs(problem, rows, varied)
    base = base or base_motion(
        problem,
        p,
        states,
        n_base,
        changed_rows(drive, lambda row: row[0] if np.ndim(row) == 2 else row),
    )
    X = np.zeros((n_x, 1 + a, K + 1))
    X[:n_base] = base.states[:, None]
    if n_x > n_base:
        X[n_base:, 1:] = _added_states(problem, trials, varied, states, n_base)
    # Trials that differ only in the output equation have the motion of the base.
    only_outputs = all(
        problem.system.parameters.items[index].name in problem.system.output_parameters
        for index in varied
    )
    moving = 0 if only_outputs and n_x == n_base else a
    if moving:
        start = [
            *(row[None, :-1] for row in states[:n_base]),
            *(row[1:, :-1] for row in X[n_base:]),
        ]
        trial_values = [value[1:] if np.ndim(value) else value for value in rows]
        ends = interval_ends(
            problem,
            start,
            changed_rows(drive, lambda row: row[1:] if np.ndim(row) == 2 else row),
            trial_values,
            a,
        )[:n_base]
        ends -= states[:n_base, None, 1:]
        X[:n_base, 1:] = states[:n_base, None] + join_intervals(
            base.slopes, ends[:, 1:], ends[:, 0], (), np.zeros(n_base)
        )
    outputs = sample_outputs(problem, rows, list(X), drive, range(1 + moving))
    return outputs[:, 0], outputs[:, 1:], base


def _added_states(
    problem: RecordProblem,
    trials: np.ndarray,
    varied: np.ndarray,
    states: np.ndarray,
    n_base: int,
) -> np.ndarray:
    """Return the trajectories ``(nx - n_base, a, K + 1)`` of the added states, driven by the motion
    of the base.

    Trials with equal parameters of the added states share one trajectory. The result is exact
    where the rates of the added states are linear in these states.
    """
    from scipy.linalg.lapack import dtbtrs

    added, intervals = len(states) - n_base, states.shape[1] - 1
    acting = _parameters_of_added_states(problem, trials, varied, states, n_base)
    keys, group = np.unique(trials[acting], axis=1, return_inverse=True)
    chosen = [int(np.flatnonzero(group.ravel() == k)[0]) for k in range(keys.shape[1])]
    distinct = trials[:, chosen]
    count, width = len(chosen), len(chosen) * (1 + added)
    rows: list[Any] = distinct[:, 0].tolist()
    for index in varied:
        rows[index] = np.repeat(distinct[index], 1 + added)
    stepped = np.repeat(states[n_base:, None, :-1], width, axis=1)
    step = 1e-3  # any size gives the derivatives of linear rates
    for j in range(added):
        stepped[j, 1 + j :: 1 + added] += step
    start = [*(row[None, :-1] for row in states[:n_base]), *stepped]
    ends = interval_ends(problem, start, _vehicle_inputs(problem, rows, varied), rows, width)[
        n_base:
    ].reshape(added, count, 1 + added, intervals)
    trajectories = np.empty((added, trials.shape[1], intervals + 1))
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
        trajectories[:, group.ravel() == k] = trajectory[:, None]
    return trajectories


def _parameters_of_added_states(
    problem: RecordProblem,
    trials: np.ndarray,
    varied: np.ndarray,
    states: np.ndarray,
    n_base: int,
) -> list[int]:
    """Return the positions of the varied parameters that act on the rates of the added states.

    A parameter acts if a change of it changes a rate at one point, whose states and inputs are kept
    away from zero.
    """
    system = problem.system
    x = states[:, states.shape[1] // 2] + 1e-2
    u = [0.01] * len(system.inputs)
    base = trials[:, 0].tolist()
    base_rates = system.f(0.0, x.tolist(), u, base)[n_base:]
    acting = []
    for index in varied:
        changed = list(base)
        changed[index] = base[index] + max(1e-3, 0.1 * abs(base[index]))
        if any(
            rate != base_rate
            for rate, base_rate in zip(
                system.f(0.0, x.tolist(), u, changed)[n_base:], base_rates, strict=True
            )
        ):
            acting.append(int(index))
    return acting


def _vehicle_inputs(
    problem: RecordProblem, rows: Sequence[Any], varied: Sequence[int] | np.ndarray
) -> Drive:
    """Return the inputs at the vehicle, rows ``(M,)`` or ``(c, M)``.

    ``rows`` are all parameters: a number, or a row ``(c,)`` with one value for each column.
    """
    system, record = problem.system, problem.record
    inputs_vary = any(
        system.parameters.items[index].name in system.input_parameters for index in varied
    )
    if problem.drive is not None and not inputs_vary:
        return problem.drive
    drive = drive_from_record(
        system, rows, record.input_array(system.input_names), record.time, record.hold, problem.grid
    )
    return changed_rows(drive, np.transpose)
