"""A whole record linearised at once: outputs and all their sensitivities about a trajectory guess.

Every node interval is integrated at the same time, for the base and one complex-step column a state
and parameter; one banded triangular solve then joins the intervals. The guess need not obey the
equations: its defects are corrected to first order by the same solve (a multiple-shooting
Gauss-Newton step with the intermediate states condensed out; Bock 1981). For equations linear in
the states one correction is exact, and at convergence the trajectory equals the sequential
simulation to rounding.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.whole_record.record_problem import (
    INCREMENT,
    RecordProblem,
    changed_rows,
    driven_by,
    interval_ends,
    linear_record,
    sample_outputs,
)
from sim.maths import COMPLEX_STEP
from sim.propagation import Drive


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Outputs and sensitivities at a point.

    ``y (m, N)`` of the defect-corrected trajectory; ``jacobian (m, N, c)`` by the wanted
    parameters, then the wanted initial states; ``states (nx, K + 1)`` at the nodes,
    defect-corrected; ``by_state (nx, K + 1, c)``.
    """

    y: np.ndarray
    jacobian: np.ndarray
    states: np.ndarray
    by_state: np.ndarray


def linearise(
    problem: RecordProblem, p: np.ndarray, x0: np.ndarray, guess: np.ndarray
) -> Linearisation:
    """Outputs and sensitivities about the parameters ``p``, initial state ``x0`` and a trajectory
    guess.

    One batch with the base in column 0, then a column a state, then one a parameter that acts in
    the dynamics. A column's numbers stand side by side in memory, ``(c, K)``: whatever is the same
    for all columns then meets long rows.
    """
    linear = linear_record(problem, p, x0, guess)
    if linear is not None:
        return Linearisation(*linear)
    n_x, n_p, moving = len(problem.system.states), len(problem.free), list(problem.moving)
    by_parameter, by_state = _increments(problem, guess)
    width = 1 + n_x + len(moving)
    columns = {position: 1 + n_x + column for column, position in enumerate(moving)}
    X = np.empty((n_x, width, guess.shape[1] - 1), dtype=by_parameter.dtype)
    X[:] = guess[:, None, :-1]
    X[np.arange(n_x), 1 + np.arange(n_x)] += by_state[:, None]
    driven = _drive(problem, p, by_parameter)
    ends = interval_ends(
        problem,
        list(X),
        driven.spread(columns, width),
        _shifted(problem, p, columns, by_parameter, width),
    )
    base = ends[:, 0].real
    A = _slopes(problem, ends[:, 1 : 1 + n_x], base, by_state)
    B = np.zeros((n_x, n_p, guess.shape[1] - 1))
    B[:, moving] = _slopes(problem, ends[:, 1 + n_x :], base, by_parameter[moving])
    corrections = join_intervals(A, B, base - guess[:, 1:], problem.starts, x0 - guess[:, 0])
    states, sensitivity = guess + corrections[:, 0], corrections[:, 1:]
    steps = np.concatenate([by_parameter, by_state[list(problem.starts)]])
    y, jacobian = _outputs(problem, p, driven, states, sensitivity, steps)
    return Linearisation(
        y, np.ascontiguousarray(jacobian.swapaxes(1, 2)), states, sensitivity.swapaxes(1, 2)
    )


def _increments(problem: RecordProblem, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps by which each parameter and each state is moved to differentiate."""
    if problem.exact:
        return np.full(len(problem.free), 1j * COMPLEX_STEP), np.full(len(guess), 1j * COMPLEX_STEP)
    size = np.sqrt(np.mean(guess**2, axis=1))
    return problem.increment, INCREMENT * np.where(size > 0, size, 1.0)


def _slopes(
    problem: RecordProblem, moved: np.ndarray, base: np.ndarray, steps: np.ndarray
) -> np.ndarray:
    """Derivatives by what moved each column of ``moved (..., c, n)``; ``base (..., n)`` is what did
    not move.
    """
    return (
        moved.imag / COMPLEX_STEP
        if problem.exact
        else (moved - base[..., None, :]) / steps[:, None]
    )


def _shifted(
    problem: RecordProblem, p: np.ndarray, columns: Mapping[int, int], steps: np.ndarray, width: int
) -> list[Any]:
    """Parameters as rows: a column's own parameter moved there, all else as it is."""
    rows: list[Any] = p.tolist()
    for position, column in columns.items():
        row = np.full(width, p[problem.free[position]], dtype=steps.dtype)
        row[column] += steps[position]
        rows[problem.free[position]] = row
    return rows


@dataclass(frozen=True, eq=False)
class _Driven:
    """Inputs at the vehicle; ``acting`` are positions of the wanted parameters that move them, each
    with a column behind the base's.
    """

    drive: Drive
    acting: tuple[int, ...]

    def spread(self, columns: Mapping[int, int], width: int) -> Drive:
        """The same with a column for each of the batch's, of which ``columns`` tells where a
        parameter's own stands: rows ``(c, M)``.
        """
        if not self.acting:
            return self.drive
        take = np.zeros(width, dtype=int)
        for column, q in enumerate(self.acting):
            if q in columns:
                take[columns[q]] = 1 + column
        return changed_rows(self.drive, lambda row: row.T[take] if np.ndim(row) == 2 else row)


def _drive(problem: RecordProblem, p: np.ndarray, steps: np.ndarray) -> _Driven:
    """The input path is run once for the base and once a parameter that acts on it."""
    if problem.drive is not None:
        return _Driven(problem.drive, ())
    system = problem.system
    acting = tuple(
        q
        for q, index in enumerate(problem.free)
        if system.parameters.items[index].name in system.input_parameters
    )
    few = _shifted(
        problem, p, {q: 1 + column for column, q in enumerate(acting)}, steps, 1 + len(acting)
    )
    return _Driven(driven_by(problem.record, system, few, problem.grid), acting)


def join_intervals(
    A: np.ndarray, B: np.ndarray, defects: np.ndarray, starts: Sequence[int], first: np.ndarray
) -> np.ndarray:
    """Solve dx[k+1] = A[k] dx[k] + B[k] dp + d[k] for all right-hand sides: ``(nx, 1 + np + ns, K +
    1)``.

    ``A (nx, nx, K)`` with the state it starts from in the middle, ``B (nx, np, K)``, ``defects (nx,
    K)``.
    """
    from scipy.linalg.lapack import dtbtrs

    n_x, n_p, intervals = B.shape
    size, width = (intervals + 1) * n_x, 2 * n_x
    band = np.zeros((width, size))
    band[0] = 1.0
    columns = np.arange(intervals) * n_x
    for i in range(n_x):
        for j in range(n_x):
            band[n_x + i - j, columns + j] = -A[i, j]
    right = np.zeros((1 + n_p + len(starts), intervals + 1, n_x))
    right[0, 0] = first
    right[0, 1:] = defects.T
    right[1 : 1 + n_p, 1:] = B.transpose(1, 2, 0)
    for column, i in enumerate(starts):
        right[1 + n_p + column, 0, i] = 1.0
    solution, _ = dtbtrs(band, right.reshape(-1, size).T, uplo="L", diag="U", overwrite_b=True)
    return solution.T.reshape(right.shape).transpose(2, 0, 1)


def _outputs(
    problem: RecordProblem,
    p: np.ndarray,
    driven: _Driven,
    states: np.ndarray,
    by_state: np.ndarray,
    steps: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs at the samples and their derivatives ``(m, c, N)`` along each column of ``by_state
    (nx, c, K + 1)``.
    """
    c = 1 + len(steps)
    columns = {position: 1 + position for position in range(len(problem.free))}
    rows_p, drive = _shifted(problem, p, columns, steps, c), driven.spread(columns, c)
    X = np.empty((len(states), c, states.shape[1]), dtype=np.result_type(states, steps))
    X[:, 0] = states
    X[:, 1:] = states[:, None] + by_state * steps[:, None]
    apart = [0, *(1 + position for position in problem.moving), *range(1 + len(problem.free), c)]
    full = sample_outputs(problem, rows_p, list(X), drive, apart)
    base = full[:, 0].real.copy()
    return base, _slopes(problem, full[:, 1:], base, steps)
