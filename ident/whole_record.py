"""A whole record linearised at once: outputs and all their sensitivities about a trajectory guess.

Every node interval is integrated at the same time, for the base and one complex-step column a state and
parameter; one banded triangular solve then joins the intervals. The guess need not obey the equations:
its defects are corrected to first order by the same solve (a multiple-shooting Gauss-Newton step with
the intermediate states condensed out; Bock 1981). For equations linear in the states one correction is
exact, and at convergence the trajectory equals the sequential simulation to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.grid import Drive, Grid, drive_from_record, make_grid
from sim.integrate import Step, rk4_step
from sim.maths import COMPLEX_STEP
from sim.record import Record
from sim.system import System


@dataclass(frozen=True, eq=False)
class RecordProblem:
    """A record laid out for whole-record fits: ``z``, ``valid`` ``(m, N)``, grid, and the columns wanted.

    ``free`` are positions of the wanted parameters among all, ``starts`` those of the wanted initial states.
    """

    record: Record
    system: System
    grid: Grid
    z: np.ndarray
    valid: np.ndarray
    free: tuple[int, ...]
    starts: tuple[int, ...]
    step: Step = rk4_step


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Outputs and sensitivities at a point.

    ``y (m, N)`` of the defect-corrected trajectory; ``jacobian (m, N, c)`` by the wanted parameters, then the wanted
    initial states; ``states (nx, K + 1)`` at the nodes, defect-corrected; ``by_state (nx, K + 1, c)``.
    """

    y: np.ndarray
    jacobian: np.ndarray
    states: np.ndarray
    by_state: np.ndarray


def record_problem(
    record: Record, system: System, max_step: float, free: Sequence[int], starts: Sequence[int], step: Step = rk4_step
) -> RecordProblem:
    """Lay out a record; sub-steps of at most ``max_step`` s."""
    z, valid = record.output_array(system.output_names)
    return RecordProblem(record, system, make_grid(record.time, max_step), z, valid, tuple(free), tuple(starts), step)


def guess_states(problem: RecordProblem, p: Sequence[float] | np.ndarray, x0: Sequence[float] | np.ndarray) -> np.ndarray:
    """Trajectory guess ``(nx, K + 1)``: measured states from the record, the others simulated between.

    Bounded also where the model alone would run away, which a simulation from a wrong start would not be.
    """
    system, grid, record = problem.system, problem.grid, problem.record
    measured: dict[int, np.ndarray] = {}
    for i, name in enumerate(system.state_names):
        if name in record.output_names:
            channel = record[name]
            measured[i] = np.interp(grid.nodes, record.time[channel.valid], channel.values[channel.valid])
    drive = drive_from_record(system, p, record.input_array(system.input_names), record.time, record.hold, grid)
    stages = [[row.tolist() for row in stage] for stage in drive.stages]
    x, out = [float(v) for v in x0], np.empty((len(x0), len(grid.nodes)))
    times, steps, p = grid.edges.tolist(), grid.steps.tolist(), [float(v) for v in p]
    for k in range(len(grid.nodes)):
        for i, values in measured.items():
            x[i] = float(values[k])
        out[:, k] = x
        if k < len(grid.nodes) - 1:
            for s in range(k * grid.substeps, (k + 1) * grid.substeps):
                u = ([row[s] for row in stages[0]], [row[s] for row in stages[1]], [row[s] for row in stages[2]])
                with suppress(ArithmeticError, ValueError):  # beyond the range of floats the last state serves as well as any
                    x = problem.step(system.f, times[s], x, u, p, steps[s])
    return np.nan_to_num(np.clip(out, -1e12, 1e12))


def linearise(problem: RecordProblem, p: np.ndarray, x0: np.ndarray, guess: np.ndarray) -> Linearisation:
    """Outputs and sensitivities about the parameters ``p``, initial state ``x0`` and a trajectory guess."""
    system, grid = problem.system, problem.grid
    n_x, n_p, n_s = len(system.states), len(problem.free), len(problem.starts)
    nodes = len(grid.nodes)
    p_columns: list[Any] = list(p)
    for column, index in enumerate(problem.free):
        p_columns[index] = p[index] + 1j * COMPLEX_STEP * (np.arange(n_x + n_p) == n_x + column)
    X = np.array(np.broadcast_to(guess[:, :-1, None], (n_x, nodes - 1, n_x + n_p)), dtype=complex)
    X[np.arange(n_x), :, np.arange(n_x)] += 1j * COMPLEX_STEP
    drive = _drive(problem, p_columns)
    reached = _cross_intervals(problem, list(X), drive, p_columns)[-1]
    ends = np.array([np.broadcast_to(r, X.shape[1:]) for r in reached])
    slopes = ends.imag / COMPLEX_STEP
    defects = ends[:, :, 0].real - guess[:, 1:]
    corrections = _join(slopes[:, :, :n_x], slopes[:, :, n_x:], defects, problem.starts, x0 - guess[:, 0])
    states, by_state = guess + corrections[:, :, 0], corrections[:, :, 1:]
    y, jacobian = _outputs(problem, p, states, by_state, n_p, n_s)
    return Linearisation(y, jacobian, states, by_state)


def _join(A: np.ndarray, B: np.ndarray, defects: np.ndarray, starts: Sequence[int], first: np.ndarray) -> np.ndarray:
    """Solve dx[k+1] = A[k] dx[k] + B[k] dp + d[k] for all right-hand sides: ``(nx, K + 1, 1 + np + ns)``."""
    from scipy.linalg.lapack import dtbtrs

    n_x, intervals, n_p = B.shape
    size, width = (intervals + 1) * n_x, 2 * n_x
    band = np.zeros((width, size))
    band[0] = 1.0
    columns = np.arange(intervals) * n_x
    for i in range(n_x):
        for j in range(n_x):
            band[n_x + i - j, columns + j] = -A[i, :, j]
    right = np.zeros((intervals + 1, n_x, 1 + n_p + len(starts)))
    right[0, :, 0] = first
    right[1:, :, 0] = defects.T
    right[1:, :, 1 : 1 + n_p] = B.transpose(1, 0, 2)
    for column, i in enumerate(starts):
        right[0, i, 1 + n_p + column] = 1.0
    solution, _ = dtbtrs(band, right.reshape(size, -1), uplo="L", diag="U")
    return solution.reshape(intervals + 1, n_x, -1).transpose(1, 0, 2)


def _outputs(problem: RecordProblem, p: np.ndarray, states: np.ndarray, by_state: np.ndarray, n_p: int, n_s: int) -> tuple[np.ndarray, np.ndarray]:
    """Outputs at the samples and their derivatives along each column of ``by_state``."""
    system, grid, c = problem.system, problem.grid, n_p + n_s
    p_columns: list[Any] = list(p)
    for column, index in enumerate(problem.free):
        p_columns[index] = p[index] + 1j * COMPLEX_STEP * (np.arange(c) == column)
    drive = _drive(problem, p_columns)
    X = list(states[:, :, None] + 1j * COMPLEX_STEP * by_state)
    sample = grid.sample
    if not system.sensor_stages:
        at = [row[sample // grid.substeps] for row in X]
        rows = system.h(grid.edges[sample, None], at, [_column(row[sample]) for row in drive.begin], p_columns)
    else:
        inside = _cross_intervals(problem, [row[:-1] for row in X], drive, p_columns)
        begin_x = [np.concatenate([np.stack([step[i] for step in inside[:-1]], 1).reshape(-1, c), X[i][-1:]]) for i in range(len(X))]
        end_x = [np.stack([step[i] for step in inside[1:]], 1).reshape(-1, c) for i in range(len(X))]
        begin = system.h(grid.edges[:, None], begin_x, [_column(row) for row in drive.begin], p_columns)
        end = system.h(grid.edges[1:, None], end_x, [_column(row) for row in drive.end], p_columns)
        n = len(grid.edges)
        begin, end = [np.broadcast_to(v, (n, c)) for v in begin], [np.broadcast_to(v, (n - 1, c)) for v in end]
        begin, _ = system.sensor_path(p_columns, begin, end, grid.steps)
        rows = [row[sample] for row in begin]
    full = np.array([np.broadcast_to(row, (len(sample), c)) for row in rows])
    return full[:, :, 0].real.copy(), full.imag / COMPLEX_STEP


def _cross_intervals(problem: RecordProblem, x: list[Any], drive: Drive, p: Sequence[Any]) -> list[list[Any]]:
    """States before the first and after every sub-step of all node intervals, rows ``(K, c)``."""
    grid, substeps = problem.grid, problem.grid.substeps
    times, steps = grid.edges[:-1].reshape(-1, substeps, 1), grid.steps.reshape(-1, substeps, 1)
    stages = [[_column(row).reshape(-1, substeps, _column(row).shape[-1]) for row in stage] for stage in drive.stages]
    path = [x]
    for s in range(substeps):
        u = ([row[:, s] for row in stages[0]], [row[:, s] for row in stages[1]], [row[:, s] for row in stages[2]])
        x = problem.step(problem.system.f, times[:, s], x, u, p, steps[:, s])
        path.append(x)
    return path


def _drive(problem: RecordProblem, p: Sequence[Any]) -> Drive:
    record, system = problem.record, problem.system
    return drive_from_record(system, p, record.input_array(system.input_names), record.time, record.hold, problem.grid)


def _column(row: np.ndarray) -> np.ndarray:
    return row[:, None] if row.ndim == 1 else row
