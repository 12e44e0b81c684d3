"""One record laid out for a fit: grid and inputs, interval transitions, exact simulation of linear
equations.

A batch has c columns: the first is the base, and each further one has one parameter or state
changed. Arrays of states and inputs have columns first and times last, so that one step of the
integrator handles all intervals and columns. An interval lies between two nodes of the grid and has
S sub-steps; an edge is the beginning or end of a sub-step.

Linear equations are faster: where the rates are linear in the states, with coefficients that are at
most products of two parameters, one table holds the coefficients (`ident.bilinear_table`). One step
of the integrator is then a matrix times (states, 1, inputs), and so are its derivatives with
respect to the parameters. The states and the sensitivities are two solutions of one banded system,
exact to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from typing import Any

import numpy as np

from ident.bilinear_table import constant_within_steps, system_tables
from sim.declaration.effect import Parameter
from sim.declaration.model import System
from sim.maths import COMPLEX_STEP
from sim.propagation import (
    Drive,
    Grid,
    Step,
    drive_from_record,
    euler_step,
    make_grid,
    recorded_drive,
    rk4_step,
)
from sim.record import Record

# ---- One record laid out for a whole-record fit

DIFFERENCE_STEP_SHARE = 1e-6  # step of forward differences, relative to the parameter or state


@dataclass(frozen=True, eq=False)
class RecordProblem:
    """A record laid out for whole-record fits, with its unknowns.

    Attributes
    ----------
    grid : nodes and sub-steps of the integration.
    z : ``(m, N)`` measured outputs.
    valid : ``(m, N)`` False where a sample does not count.
    free : positions of the unknown parameters among all parameters.
    starts : positions of the unknown initial states among the states.
    moving : positions in ``free`` of the parameters that act in the dynamics.
    increment : ``(np,)`` forward differences of the parameters in ``free``.
    exact : differentiate by complex steps, else by forward differences. These are a few times
        faster and good to about a millionth.
    drive : inputs at the vehicle; None where an unknown parameter changes them.
    step : one step of the integrator.
    """

    record: Record
    system: System
    grid: Grid
    z: np.ndarray
    valid: np.ndarray
    free: tuple[int, ...]
    starts: tuple[int, ...]
    moving: tuple[int, ...]
    increment: np.ndarray
    exact: bool
    drive: Drive | None
    step: Step = rk4_step


def record_problem(
    record: Record,
    system: System,
    max_step: float,
    free: Sequence[int],
    starts: Sequence[int],
    *,
    valid: np.ndarray | None = None,
    at: np.ndarray | None = None,
    exact: bool = True,
    step: Step = rk4_step,
) -> RecordProblem:
    """Lay out a record for a fit.

    Parameters
    ----------
    max_step : longest sub-step, s.
    free, starts : positions of the unknown parameters and initial states.
    valid : ``(m, N)`` further mask of the samples; None uses all valid samples.
    at : ``(np,)`` parameters at which a fixed input path is evaluated; None takes those of the
        system.
    exact, step : as in `RecordProblem`.
    """
    z, measured = record.output_array(system.output_names)
    grid, recorded = _recorded(record, system.input_names, max_step)
    items = [system.parameters.items[index] for index in free]
    sizes = [abs(item.value) or _size_of_zero(item) for item in items]
    moving = [
        position for position, item in enumerate(items) if item.name not in system.output_parameters
    ]
    drive = None
    if not system.input_parameters.intersection(item.name for item in items):
        drive = recorded
        if system.input_stages:
            p = system.parameters.values() if at is None else at
            drive = driven_by(record, system, p.tolist(), grid)
    mask = measured if valid is None else measured & valid
    increment = DIFFERENCE_STEP_SHARE * np.array(sizes, dtype=float)
    return RecordProblem(
        record,
        system,
        grid,
        z,
        mask,
        tuple(free),
        tuple(starts),
        tuple(moving),
        increment,
        exact,
        drive,
        step,
    )


def _size_of_zero(item: Parameter) -> float:
    """Return the size by which a parameter of value zero is differenced."""
    return item.prior_std if np.isfinite(item.prior_std) else 1.0


@lru_cache(maxsize=16)  # a search lays out the same records hundreds of times
def _recorded(record: Record, inputs: tuple[str, ...], max_step: float) -> tuple[Grid, Drive]:
    """Return the grid of a record and its recorded inputs on this grid."""
    grid = make_grid(record.time, max_step)
    return grid, recorded_drive(record.input_array(inputs), record.time, record.hold, grid)


def driven_by(record: Record, system: System, p: Sequence[Any] | np.ndarray, grid: Grid) -> Drive:
    """Return the inputs of a record at the vehicle, after the input path at parameters ``p``."""
    return drive_from_record(
        system, p, record.input_array(system.input_names), record.time, record.hold, grid
    )


# ---- Interval transitions

# most values of one state (columns times intervals) that are integrated together; more do not fit
# the processor's cache
_LARGEST_BATCH = 16_000


def changed_rows(drive: Drive, change: Callable[[Any], Any]) -> Drive:
    """Return the drive with ``change`` applied to every row; a row that occurs several times, as
    that of a held input, is changed once.
    """
    first, middle, last, begin, end = _changed([*drive.stages, drive.begin, drive.end], change)
    return Drive((first, middle, last), begin, end)


def _changed(row_lists: Sequence[list[Any]], change: Callable[[Any], Any]) -> list[list[Any]]:
    """Return the lists with ``change`` applied once to every different row."""
    distinct = {id(row): row for rows in row_lists for row in rows}
    changed = {key: change(row) for key, row in distinct.items()}
    return [[changed[id(row)] for row in rows] for rows in row_lists]


def sample_outputs(
    problem: RecordProblem, p: Sequence[Any], X: list[Any], drive: Drive, apart: Sequence[int]
) -> np.ndarray:
    """Return the outputs ``(m, c, N)`` at the samples of the record.

    Parameters
    ----------
    p : parameters, numbers or rows ``(c,)``.
    X : row ``(c, K + 1)`` of each state at the nodes.
    drive : inputs, rows ``(c, M)`` over the M sub-steps.
    apart : columns whose states differ, 0 first. The other columns differ from column 0 in the
        output equation only.
    """
    system, grid, parameters, c = problem.system, problem.grid, _as_columns(p), len(X[0])
    sample = grid.sample
    if not system.sensor_stages:
        nodes, outputs = sample // grid.substeps, None
        for part in _parts(c, len(sample)):
            columns = part if len(sample) == len(grid.nodes) else nodes[part]
            x = [row[:, columns] for row in X]
            u = [row[..., sample[part]] for row in drive.begin]
            y = system.h(grid.edges[sample[part]], x, u, parameters)
            outputs = _write_part(outputs, y, (c, len(sample)), part)
        assert outputs is not None
        return outputs
    edges = _all_edges(problem, p, X, drive, apart)
    last = [row[:, -1:] for row in X]
    begin_x = [
        np.concatenate([_in_time_order(rows), row], axis=1)
        for rows, row in zip(zip(*edges[:-1], strict=True), last, strict=True)
    ]
    end_x = [_in_time_order(rows) for rows in zip(*edges[1:], strict=True)]
    begin = stacked(system.h(grid.edges, begin_x, drive.begin, parameters), (c, len(grid.edges)))
    end = stacked(system.h(grid.edges[1:], end_x, drive.end, parameters), (c, len(grid.edges) - 1))
    # The sensor path needs time as its first axis.
    rows, _ = system.sensor_path(p, [row.T for row in begin], [row.T for row in end], grid.steps)
    return stacked(
        [np.broadcast_to(row, (len(grid.edges), c)).T[:, sample] for row in rows], (c, len(sample))
    )


def _all_edges(
    problem: RecordProblem, p: Sequence[Any], X: list[Any], drive: Drive, apart: Sequence[int]
) -> list[list[Any]]:
    """Return the states at all edges as `cross_intervals` does, from rows ``X (c, K + 1)`` at the
    nodes. Only the columns ``apart`` are integrated; the others equal column 0.
    """
    starts, c = [row[:, :-1] for row in X], len(X[0])
    if len(apart) == c:
        return cross_intervals(problem, starts, drive, p)
    chosen = list(apart)
    chosen_values = [value[chosen] if np.ndim(value) else value for value in p]
    chosen_drive = changed_rows(drive, lambda row: row[chosen] if np.ndim(row) == 2 else row)
    place = np.zeros(c, dtype=int)
    place[chosen] = np.arange(len(chosen))
    shape = (len(chosen), starts[0].shape[1])
    edges = cross_intervals(problem, [row[chosen] for row in starts], chosen_drive, chosen_values)
    return [[np.broadcast_to(row, shape)[place] for row in rows] for rows in edges]


def _in_time_order(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Return values in order of time, ``(c, K S)``; ``rows`` are the S sub-steps, ``(c, K)``
    each.
    """
    return np.stack(rows, axis=2).reshape(len(rows[0]), -1)


def interval_ends(
    problem: RecordProblem, x: Sequence[Any], drive: Drive, p: Sequence[Any], columns: int = 0
) -> np.ndarray:
    """Return the states ``(nx, c, K)`` at the end of all intervals.

    Parameters
    ----------
    x : row ``(c, K)`` of each state at the beginning of the intervals.
    drive : inputs, rows ``(c, M)``.
    columns : number c of columns, needed where a state that is equal in all columns is a row
        ``(1, K)``; 0 takes it from ``x``.
    """
    shape, ends = (columns or len(x[0]), x[0].shape[1]), None
    for part in _parts(*shape):
        last = _cross_part(problem, [row[:, part] for row in x], drive, p, part)[-1]
        ends = _write_part(ends, last, shape, part)
    assert ends is not None
    return ends


def _parts(c: int, K: int) -> list[slice]:
    """Return parts of K intervals in c columns that fit the processor's cache."""
    count = max(1, ceil(c * K / _LARGEST_BATCH))
    length = max(1, ceil(K / count))
    return [slice(k, min(k + length, K)) for k in range(0, max(K, 1), length)]


def _write_part(
    whole: np.ndarray | None, rows: Sequence[Any], shape: tuple[int, ...], part: slice
) -> np.ndarray:
    """Write the rows of one part of the intervals into the array ``(len(rows), *shape)`` of all
    intervals, and return it. The first part, with ``whole`` None, creates the array.
    """
    if whole is None:
        whole = np.empty((len(rows), *shape), dtype=np.result_type(float, *rows))
    for i, row in enumerate(rows):
        whole[i, :, part] = row
    return whole


def cross_intervals(
    problem: RecordProblem, x: list[Any], drive: Drive, p: Sequence[Any]
) -> list[list[Any]]:
    """Return the states, rows ``(c, K)``, before the first sub-step of all intervals and after each
    sub-step. ``x`` has the rows before the first one; rows of the drive are ``(c, M)``.
    """
    c, K = x[0].shape
    parts = _parts(c, K)
    if len(parts) == 1:
        return _cross_part(problem, x, drive, p, slice(0, K))
    paths = [_cross_part(problem, [row[:, part] for row in x], drive, p, part) for part in parts]
    shapes = [path[0][0].shape for path in paths]

    def joined(rows: Sequence[Any]) -> np.ndarray:
        return np.concatenate(
            [np.broadcast_to(row, shape) for row, shape in zip(rows, shapes, strict=True)], axis=1
        )

    return [[joined(rows) for rows in zip(*edge, strict=True)] for edge in zip(*paths, strict=True)]


def _cross_part(
    problem: RecordProblem, x: list[Any], drive: Drive, p: Sequence[Any], part: slice
) -> list[list[Any]]:
    """Return the states as `cross_intervals` does, for the intervals ``part`` with states ``x``."""
    grid, substeps, parameters = problem.grid, problem.grid.substeps, _as_columns(p)
    path = [x]
    for s in range(substeps):

        def at_substep(row: Any, s: int = s) -> Any:
            return np.ascontiguousarray(row.reshape(*row.shape[:-1], -1, substeps)[..., part, s])

        first, middle, last = _changed(drive.stages, at_substep)
        x = problem.step(
            problem.system.f,
            at_substep(grid.edges[:-1]),
            x,
            (first, middle, last),
            parameters,
            at_substep(grid.steps),
        )
        path.append(x)
    return path


def stacked(rows: Sequence[Any], shape: tuple[int, ...]) -> np.ndarray:
    """Return the rows in one array ``(len(rows), *shape)``; a row may also be a number, or have one
    value for all columns.
    """
    array = np.empty((len(rows), *shape), dtype=np.result_type(float, *rows))
    for i, row in enumerate(rows):
        array[i] = row
    return array


def _as_columns(p: Sequence[Any]) -> list[Any]:
    """Return the parameters in shapes that match rows ``(c, K)``: a number, or ``(c, 1)`` with one
    value for each column.
    """
    return [value[:, None] if np.ndim(value) else value for value in p]


# ---- Linear equations with held inputs

_ORDERS = {rk4_step: 4, euler_step: 1}  # order of each integrator
_EVEN_SAMPLING_TOLERANCE = 1e-9  # largest relative difference of even steps


# ``y``, ``jacobian``, ``states`` and ``by_state`` of a ``Linearisation``
Line = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def linear_record(
    problem: RecordProblem, p: np.ndarray, x0: np.ndarray, guess: np.ndarray
) -> Line | None:
    """Return the linearisation of linear equations at parameters ``p (np,)`` and initial state ``x0
    (nx,)``.

    The states are simulated. Their sensitivities are taken along the ``guess (nx, K + 1)``, as in
    `ident.whole_record.linearise`: a fit then also converges from a poor start, whose simulation is
    farther from the truth than the measured states. None where the equations are not linear, an
    unknown parameter changes the inputs, a sensor has dynamics, or the steps differ.
    """
    system = problem.system
    if problem.drive is None or system.sensor_stages or problem.step not in _ORDERS:
        return None
    steps = _equal_steps(problem.drive, problem.grid)
    if steps is None:
        return None
    functions = _linear_functions(system, _fixed_values(system, p))
    if functions is None or not set(problem.free) <= set(functions.free):
        return None
    n_x, starts, substeps = len(x0), list(problem.starts), problem.grid.substeps
    matrix, by_parameter = functions.at(p, problem.free)
    output, by_output = matrix[n_x:], by_parameter[:, n_x:]
    order = _ORDERS[problem.step]
    transition, by_transition = _step_matrices(matrix[:n_x], by_parameter[:, :n_x], steps.dt, order)
    n_p, m, count = len(by_parameter), len(output), len(steps.step_inputs)
    c = n_p + len(starts)

    # The arguments (states, 1, inputs) have one row for each step.
    band = _band(transition[:, :n_x], count)
    right = np.empty((1, count + 1, n_x))
    right[0, 0] = x0
    np.matmul(steps.step_inputs, transition[:, n_x:].T, out=right[0, 1:])
    states = _solve_recursion(band, right)[0]
    right = np.zeros((c, count + 1, n_x))
    arguments = _step_arguments(guess, transition, steps.step_inputs, substeps)
    np.matmul(arguments, by_transition.transpose(0, 2, 1), out=right[:n_p, 1:])
    right[n_p + np.arange(len(starts)), 0, starts] = 1.0
    by_state = np.ascontiguousarray(_solve_recursion(band, right).transpose(2, 1, 0))

    samples = steps.samples
    sampled = np.concatenate([states[samples], steps.sample_inputs], axis=1)
    jacobian = output[:, :n_x] @ by_state[:, samples].reshape(n_x, -1)
    jacobian = jacobian.reshape(m, len(sampled), c)
    if np.any(by_output):  # outputs that are states depend on no parameter
        jacobian[:, :, :n_p] += sampled @ by_output.transpose(1, 2, 0)
    return output @ sampled.T, jacobian, states[::substeps].T.copy(), by_state[:, ::substeps]


def _step_arguments(
    guess: np.ndarray, transition: np.ndarray, step_inputs: np.ndarray, substeps: int
) -> np.ndarray:
    """Return the arguments (states, 1, inputs) of each step, ``(M, l)``. The states at a node are
    those of the guess, and the sub-steps that follow start from them.
    """
    n_x = len(guess)
    arguments = np.empty((len(step_inputs), n_x + step_inputs.shape[1]))
    arguments[:, n_x:] = step_inputs
    arguments[::substeps, :n_x] = guess[:, :-1].T
    for s in range(1, substeps):
        arguments[s::substeps, :n_x] = arguments[s - 1 :: substeps] @ transition.T
    return arguments


def _band(Phi: np.ndarray, count: int) -> np.ndarray:
    """Return the matrix of x[k] - Phi x[k - 1] over ``count`` steps, ``(2 n, (count + 1) n)`` in
    the diagonal storage of LAPACK.
    """
    n = len(Phi)
    band = np.zeros((2 * n, count + 1, n))
    band[0] = 1.0
    for i in range(n):
        for j in range(n):
            band[n + i - j, :, j] = -Phi[i, j]
    return np.asfortranarray(band.reshape(2 * n, -1))


def _solve_recursion(band: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve x[k] - Phi x[k - 1] = right[k] with x[0] = right[0]. The right-hand sides ``right (c,
    count + 1, n)`` are overwritten.
    """
    from scipy.linalg.lapack import dtbtrs

    if not len(right):
        return right
    solution, _ = dtbtrs(
        band, right.reshape(len(right), -1).T, uplo="L", diag="U", overwrite_b=True
    )
    return np.asarray(solution.T.reshape(right.shape))


def _step_matrices(
    rates: np.ndarray, by_rates: np.ndarray, dt: float, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix ``(n_x, l)`` of one step on (states, 1, inputs), and its derivatives ``(c,
    n_x, l)`` with respect to the parameters.

    It is I + A + A^2/2 + ... up to the order of the integrator. The first rows of the square matrix
    A are the rates times dt. The other rows are zero, since 1 and the inputs are constant within a
    step.

    Parameters
    ----------
    rates : ``(n_x, l)`` matrix of the rates on (states, 1, inputs).
    by_rates : ``(c, n_x, l)`` its derivatives.
    dt : step, s.
    """
    n_x, size = rates.shape
    A = np.zeros((1 + len(by_rates), size, size), dtype=complex)
    A[:, :n_x] = rates * dt
    A[1:, :n_x] += (1j * COMPLEX_STEP * dt) * by_rates
    identity = np.eye(size)
    total = identity + A / order
    for k in range(order - 1, 0, -1):
        total = identity + A @ total / k
    return total[0, :n_x].real.copy(), total[1:, :n_x].imag / COMPLEX_STEP


@dataclass(frozen=True, eq=False)
class _EqualSteps:
    """Steps of equal size with constant inputs.

    Attributes
    ----------
    dt : step, s.
    step_inputs : ``(M, 1 + n_u)`` 1 and the inputs of each step.
    sample_inputs : ``(N, 1 + n_u)`` 1 and the inputs at each sample.
    samples : positions of the N samples among the edges.
    """

    dt: float
    step_inputs: np.ndarray
    sample_inputs: np.ndarray
    samples: slice | np.ndarray


@lru_cache(maxsize=16)
def _equal_steps(drive: Drive, grid: Grid) -> _EqualSteps | None:
    """Return the steps of a grid; None where they differ or an input changes within a step."""
    if (
        not constant_within_steps(drive)
        or np.ptp(grid.steps) > _EVEN_SAMPLING_TOLERANCE * grid.steps[0]
    ):
        return None
    sample = grid.sample
    every_node = len(sample) == len(grid.nodes)
    step_inputs = [np.ones(len(grid.steps)), *drive.stages[0]]
    sample_inputs = [np.ones(len(sample)), *(row[sample] for row in drive.begin)]
    return _EqualSteps(
        float(grid.steps.mean()),
        np.stack(step_inputs, axis=1),
        np.stack(sample_inputs, axis=1),
        slice(None, None, grid.substeps) if every_node else sample,
    )


@dataclass(frozen=True, eq=False)
class _LinearFunctions:
    """Rates and outputs as ``r`` linear functions of the ``l`` arguments (states, 1, inputs).

    Attributes
    ----------
    free : positions of the ``P`` free parameters among all parameters.
    matrix : ``(r, l)`` coefficients where all free parameters are zero.
    by_parameter : ``(P, r, l)`` derivatives of the coefficients.
    squares : ``(P, r, P)`` second derivatives of the constant terms; None where they vanish.
    one : position of the 1 among the arguments.
    """

    free: tuple[int, ...]
    matrix: np.ndarray
    by_parameter: np.ndarray
    squares: np.ndarray | None
    one: int

    def at(self, p: np.ndarray, wanted: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Return the coefficients ``(r, l)`` at all parameters ``p (np,)``, and their derivatives
        ``(c, r, l)`` with respect to the free parameters at the positions ``wanted`` among all.
        """
        theta, order = p[list(self.free)], [self.free.index(index) for index in wanted]
        matrix = self.matrix + (
            theta @ self.by_parameter.reshape(len(theta), self.matrix.size)
        ).reshape(self.matrix.shape)
        derivatives = self.by_parameter[order]
        if self.squares is not None:
            slopes = self.squares @ theta
            matrix[:, self.one] += 0.5 * theta @ slopes
            derivatives[:, :, self.one] += slopes[order]
        return matrix, derivatives


def _fixed_values(system: System, p: np.ndarray) -> tuple[float, ...]:
    """Return the values of the parameters that are not free."""
    items = enumerate(system.parameters.items)
    return tuple(p[[index for index, item in items if not item.free]].tolist())


@lru_cache(maxsize=64)  # a fit needs the same functions many times
def _linear_functions(system: System, fixed: tuple[float, ...]) -> _LinearFunctions | None:
    """Return rates and outputs at the values ``fixed`` of the parameters that are not free; None
    where they are not linear.
    """
    values, remaining = system.parameters.values().tolist(), iter(fixed)
    for index, item in enumerate(system.parameters.items):
        if not item.free:
            values[index] = next(remaining)
    with np.errstate(all="ignore"):
        tables = system_tables(system, values)
    if tables is None:
        return None
    n_x, n, width = len(system.states), tables[0].n, len(tables[0].table)
    # The tables hold half of the second derivatives with respect to (1, states, parameters,
    # inputs), and the linear terms as they are.
    halves = np.concatenate(
        [table.table.reshape(width, -1, n + width)[:, :, n:] for table in tables], axis=1
    )
    slopes = 2.0 * halves
    slopes[0] = halves[0]
    parameters, order = slice(1 + n_x, 1 + n), [*range(1, 1 + n_x), 0, *range(1 + n, width)]
    by_parameter = slopes[parameters][:, :, order]
    by_parameter[:, :, n_x] = slopes[0, :, parameters].T
    squares = slopes[parameters][:, :, parameters]
    free = tuple(system.parameters.index(name) for name in system.parameters.free_names)
    return _LinearFunctions(
        free, slopes[0][:, order], by_parameter, squares if np.any(squares) else None, n_x
    )
