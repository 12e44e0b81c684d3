"""How the outputs of a fitted node would change under many alternative parameter values, in one batch.

Every alternative is integrated over all node intervals from the fitted trajectory; the defects that this leaves
are joined with the base model's transition matrices. Exact for equations linear in the states, first order else:
good enough to rank candidates.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ident.whole_record import INCREMENT, RecordProblem, cross_intervals, join_intervals, sample_outputs
from sim.grid import Drive, drive_from_record


def alternative_outputs(problem: RecordProblem, p: np.ndarray, states: np.ndarray, alternatives: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outputs at the samples for alternative parameters.

    Parameters
    ----------
    problem : the record laid out for a System. p : ``(np,)`` parameters of the base.
    states : ``(nx, K + 1)`` trajectory of the base, which obeys its equations.
    alternatives : ``(np, a)`` all parameters, a column an alternative.

    Returns
    -------
    Base outputs ``(m, N)`` and those of the alternatives ``(m, N, a)``.
    """
    n_x, a = len(states), alternatives.shape[1]
    size = np.sqrt(np.mean(states**2, axis=1))
    steps = INCREMENT * np.where(size > 0, size, 1.0)
    width = 1 + n_x + a
    rows: list[Any] = p.tolist()
    varied = np.flatnonzero(np.any(alternatives != p[:, None], axis=1))
    for index in varied:
        rows[index] = np.concatenate([np.full(1 + n_x, p[index]), alternatives[index]])
    X = np.array(np.broadcast_to(states[:, :-1, None], (n_x, states.shape[1] - 1, width)))
    X[np.arange(n_x), :, 1 + np.arange(n_x)] += steps[:, None]
    drive = _drive(problem, rows, varied)
    ends = np.array([np.broadcast_to(r, X.shape[1:]) for r in cross_intervals(problem, list(X), drive, rows)[-1]])
    A = (ends[:, :, 1 : 1 + n_x] - ends[:, :, :1]) / steps
    B = ends[:, :, 1 + n_x :] - states[:, 1:, None]
    base_defect = ends[:, :, 0] - states[:, 1:]
    joined = join_intervals(A, B, base_defect, (), np.zeros(n_x))
    X = states[:, :, None] + np.concatenate([joined[:, :, :1], joined[:, :, 1:]], axis=2)
    few: list[Any] = p.tolist()
    for index in varied:
        few[index] = np.concatenate([[p[index]], alternatives[index]])
    full = sample_outputs(problem, few, list(X), _drive(problem, few, varied), 1 + a)
    return full[:, :, 0], full[:, :, 1:]


def _drive(problem: RecordProblem, rows: Sequence[Any], varied: np.ndarray) -> Drive:
    system, record = problem.system, problem.record
    moved = any(system.parameters.items[index].name in system.input_parameters for index in varied)
    if problem.drive is not None and not moved:
        return problem.drive
    return drive_from_record(system, rows, record.input_array(system.input_names), record.time, record.hold, problem.grid)
