"""A whole record linearised at once: outputs and all their sensitivities about a trajectory guess.

Every node interval is integrated at the same time, for the base and for a complex step in each
state and parameter; one banded triangular solve then joins the intervals. The guess need not obey
the equations: its defects are corrected to first order by the same solve (a multiple-shooting
Gauss-Newton step with the intermediate states condensed out; Bock 1981). For equations linear in
the states one correction is exact, and at convergence the trajectory equals the sequential
simulation to rounding.

The first guess takes states from the measured channels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.estimate import LARGEST_NUMBER
from ident.regression.state_histories import rate_relations, windows
from ident.whole_record.record_problem import (
    DIFFERENCE_STEP_SHARE,
    RecordProblem,
    changed_rows,
    driven_by,
    interval_ends,
    linear_record,
    sample_outputs,
)
from sim.declaration.model import System
from sim.maths import COMPLEX_STEP
from sim.propagation import Drive
from sim.record import Record

SLOPE_PARTS = 60  # a slope is fitted over two sixtieths of the record


def known_states(
    record: Record, system: System, p: Sequence[float] | np.ndarray | None = None
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return position of a state -> times ``(k,)`` and values ``(k,)``, for the states that the
    record shows; good enough to start a fit.

    Sensor biases are subtracted, at parameters ``p`` (None: the System's own). Rates are slopes of
    lines over a window, after a running median of five samples.
    """
    names = system.state_names
    found: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for i, name in enumerate(names):
        if name in record.output_names:
            channel = record[name]
            found[i] = (
                record.time[channel.valid],
                channel.values[channel.valid] - _bias(system, name, p),
            )
    if len(found) in (0, len(names)):
        return found
    for source, rate in rate_relations(system, record.time).items():
        i, j = names.index(source), names.index(rate)
        if i in found and j not in found and len(found[i][0]) > 12:
            time, values = found[i]
            padded = np.pad(values, 2, mode="edge")
            calm = np.median([padded[k : k + len(values)] for k in range(5)], axis=0)
            fit = windows(time, np.ones(len(time), dtype=bool), max(3, len(time) // SLOPE_PARTS), 1)
            slope = np.sum(fit.slope * fit.gather(calm), axis=1)
            found[j] = time[fit.usable], slope[fit.usable]
    return found


def _bias(system: System, name: str, p: Sequence[float] | np.ndarray | None) -> float:
    parameters, bias = system.parameters, f"bias_{name}"
    if bias not in parameters.names:
        return 0.0
    return parameters[bias].value if p is None else float(p[parameters.index(bias)])


# largest gap, relative to the state, if the simulated states are linear in themselves
LARGEST_TRAJECTORY_GAP = 1e-9


def guess_states(
    problem: RecordProblem, p: Sequence[float] | np.ndarray, x0: Sequence[float] | np.ndarray
) -> np.ndarray:
    """Return a starting trajectory ``(nx, K + 1)``: measured states from the record, the others
    simulated.

    It is bounded even where the simulation of all states from a wrong start would diverge.
    """
    system, grid, record = problem.system, problem.grid, problem.record
    measured = {
        i: np.interp(grid.nodes, time, values)
        for i, (time, values) in known_states(record, system, p).items()
    }
    if len(measured) == len(system.states):
        return np.array([measured[i] for i in range(len(measured))])
    drive = driven_by(record, system, p, grid)
    found = simulated_at_once(problem, measured, drive, p, x0) if measured else None
    if found is None:
        found = simulated_in_turn(problem, measured, drive, p, x0)
    return np.nan_to_num(np.clip(found, -1e12, 1e12))


def simulated_at_once(
    problem: RecordProblem,
    measured: Mapping[int, np.ndarray],
    drive: Drive,
    p: Sequence[float] | np.ndarray,
    x0: Sequence[float] | np.ndarray,
) -> np.ndarray | None:
    """Return the states ``(nx, K + 1)``, unmeasured ones by one banded solve; None if these are not
    linear in themselves.
    """
    free = [i for i in range(len(x0)) if i not in measured]
    X = np.repeat(np.array(x0, dtype=float)[:, None], len(problem.grid.nodes), axis=1)
    for i, values in measured.items():
        X[i] = values
    start = np.array(x0, dtype=float)[free]
    with np.errstate(all="ignore"):  # a divergent simulation is repeated node by node
        for last in (False, True):
            ends = _interval_ends(problem, X, drive, p, free)
            defects = ends[:, 0].real - X[free, 1:]
            if not np.all(np.abs(ends) < LARGEST_NUMBER):
                return None
            if last:
                return (
                    X
                    if np.all(
                        np.abs(defects)
                        <= LARGEST_TRAJECTORY_GAP * np.max(np.abs(X[free]), axis=1, keepdims=True)
                    )
                    else None
                )
            slopes = ends[:, 1:].imag / COMPLEX_STEP
            X[free] += join_intervals(
                slopes, np.zeros((len(free), 0, len(defects[0]))), defects, (), start - X[free, 0]
            )[:, 0]
    return None


def _interval_ends(
    problem: RecordProblem,
    X: np.ndarray,
    drive: Drive,
    p: Sequence[float] | np.ndarray,
    free: Sequence[int],
) -> np.ndarray:
    """Return the states ``free`` at the end of each interval, from ``X`` at its beginning and from
    a complex step of each: ``(f, 1 + f, K)``.
    """
    start = np.repeat(X[:, None, :-1].astype(complex), 1 + len(free), axis=1)
    start[free, 1 + np.arange(len(free))] += 1j * COMPLEX_STEP
    return interval_ends(problem, list(start), drive, [float(v) for v in p])[list(free)]


def simulated_in_turn(
    problem: RecordProblem,
    measured: Mapping[int, np.ndarray],
    drive: Drive,
    p: Sequence[float] | np.ndarray,
    x0: Sequence[float] | np.ndarray,
) -> np.ndarray:
    """Return the states ``(nx, K + 1)``, simulated node by node; a state keeps its value on
    overflow.
    """
    grid = problem.grid
    stages = [[row.tolist() for row in stage] for stage in drive.stages]
    x, out = [float(v) for v in x0], np.empty((len(x0), len(grid.nodes)))
    times, steps, p = grid.edges.tolist(), grid.steps.tolist(), [float(v) for v in p]
    for k in range(len(grid.nodes)):
        for i, values in measured.items():
            x[i] = float(values[k])
        out[:, k] = x
        if k < len(grid.nodes) - 1:
            for s in range(k * grid.substeps, (k + 1) * grid.substeps):
                u = (
                    [row[s] for row in stages[0]],
                    [row[s] for row in stages[1]],
                    [row[s] for row in stages[2]],
                )
                # on overflow the last state is kept
                with suppress(ArithmeticError, ValueError):
                    x = problem.step(problem.system.f, times[s], x, u, p, steps[s])
    return out


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Outputs and sensitivities at a point, of the defect-corrected trajectory.

    ``y (m, N)``; ``jacobian (m, N, c)`` by the wanted parameters, then the wanted initial states;
    ``states (nx, K + 1)`` at the nodes; ``by_state (nx, K + 1, c)``.
    """

    y: np.ndarray
    jacobian: np.ndarray
    states: np.ndarray
    by_state: np.ndarray


def linearise(
    problem: RecordProblem, p: np.ndarray, x0: np.ndarray, guess: np.ndarray
) -> Linearisation:
    """Return outputs and sensitivities about the parameters ``p``, initial state ``x0`` and a
    trajectory guess.

    One batch: column 0 is the base, the next ones change one state each, then one parameter of the
    dynamics each. The layout ``(c, K)`` in memory keeps the operations fast.
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
    driven = _driven_inputs(problem, p, by_parameter)
    ends = interval_ends(
        problem,
        list(X),
        driven.spread(columns, width),
        _changed_parameters(problem, p, columns, by_parameter, width),
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
    """Return the differentiation step of each parameter and each state."""
    if problem.exact:
        return np.full(len(problem.free), 1j * COMPLEX_STEP), np.full(len(guess), 1j * COMPLEX_STEP)
    size = np.sqrt(np.mean(guess**2, axis=1))
    return problem.increment, DIFFERENCE_STEP_SHARE * np.where(size > 0, size, 1.0)


def _slopes(
    problem: RecordProblem, moved: np.ndarray, base: np.ndarray, steps: np.ndarray
) -> np.ndarray:
    """Return the derivatives from the changed columns ``moved (..., c, n)`` and the unchanged
    ``base (..., n)``.
    """
    return (
        moved.imag / COMPLEX_STEP
        if problem.exact
        else (moved - base[..., None, :]) / steps[:, None]
    )


def _changed_parameters(
    problem: RecordProblem, p: np.ndarray, columns: Mapping[int, int], steps: np.ndarray, width: int
) -> list[Any]:
    """Return the parameters as rows; each column has one parameter changed."""
    rows: list[Any] = p.tolist()
    for position, column in columns.items():
        row = np.full(width, p[problem.free[position]], dtype=steps.dtype)
        row[column] += steps[position]
        rows[problem.free[position]] = row
    return rows


@dataclass(frozen=True, eq=False)
class _Driven:
    """Inputs at the vehicle, with one further column for each parameter of the input path;
    ``acting`` are its positions among the wanted ones.
    """

    drive: Drive
    acting: tuple[int, ...]

    def spread(self, columns: Mapping[int, int], width: int) -> Drive:
        """Return the inputs spread over the columns of the batch, rows ``(c, M)``; ``columns`` maps
        a parameter to its column.
        """
        if not self.acting:
            return self.drive
        take = np.zeros(width, dtype=int)
        for column, q in enumerate(self.acting):
            if q in columns:
                take[columns[q]] = 1 + column
        return changed_rows(self.drive, lambda row: row.T[take] if np.ndim(row) == 2 else row)


def _driven_inputs(problem: RecordProblem, p: np.ndarray, steps: np.ndarray) -> _Driven:
    """Return the inputs at the vehicle for the base and for each parameter of the input path."""
    if problem.drive is not None:
        return _Driven(problem.drive, ())
    system = problem.system
    acting = tuple(
        q
        for q, index in enumerate(problem.free)
        if system.parameters.items[index].name in system.input_parameters
    )
    few = _changed_parameters(
        problem, p, {q: 1 + column for column, q in enumerate(acting)}, steps, 1 + len(acting)
    )
    return _Driven(driven_by(problem.record, system, few, problem.grid), acting)


def join_intervals(
    A: np.ndarray, B: np.ndarray, defects: np.ndarray, starts: Sequence[int], first: np.ndarray
) -> np.ndarray:
    """Solve dx[k+1] = A[k] dx[k] + B[k] dp + d[k] for all right-hand sides: ``(nx, 1 + np + ns, K +
    1)``.

    ``A (nx, nx, K)`` by the state at the beginning in its second axis, ``B (nx, np, K)``, ``defects
    (nx, K)``.
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
    """Return the outputs at the samples, and their derivatives ``(m, c, N)`` along each column of
    ``by_state (nx, c, K + 1)``.
    """
    c = 1 + len(steps)
    columns = {position: 1 + position for position in range(len(problem.free))}
    rows_p, drive = _changed_parameters(problem, p, columns, steps, c), driven.spread(columns, c)
    X = np.empty((len(states), c, states.shape[1]), dtype=np.result_type(states, steps))
    X[:, 0] = states
    X[:, 1:] = states[:, None] + by_state * steps[:, None]
    apart = [0, *(1 + position for position in problem.moving), *range(1 + len(problem.free), c)]
    full = sample_outputs(problem, rows_p, list(X), drive, apart)
    base = full[:, 0].real.copy()
    return base, _slopes(problem, full[:, 1:], base, steps)
