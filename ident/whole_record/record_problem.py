"""One record laid out for a fit: grid and inputs, simulation of all node intervals at once.

An interval lies between two nodes of the grid and has S sub-steps. An edge is the beginning or end
of a sub-step. Several variants of the motion are simulated as the c columns of one batch: the first
column is the base, and each further one has one parameter or state changed. Arrays of states and
inputs have columns first and times last, so that one step of the integrator handles all intervals
and columns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from typing import Any

import numpy as np

from sim.declaration.effect import Parameter
from sim.declaration.model import System
from sim.maths import COMPLEX_STEP
from sim.propagation import (
    Drive,
    Grid,
    Step,
    drive_from_record,
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
    record : the record.
    system : the model.
    grid : nodes and sub-steps of the integration.
    z : ``(m, N)`` measured outputs.
    valid : ``(m, N)`` False where a sample does not count.
    free : positions of the unknown parameters among all parameters.
    free_initial : positions of the unknown initial states among the states.
    in_dynamics : positions in ``free`` of the parameters that change the motion; all others act in
        the output equation only.
    increment : ``(len(free),)`` steps of the forward differences of the parameters in ``free``.
    exact : differentiate by complex steps, else by forward differences. These are a few times
        faster and good to about a millionth.
    drive : inputs at the vehicle on the grid; None where an unknown parameter changes them.
    step : function that makes one step of the integrator.
    """

    record: Record
    system: System
    grid: Grid
    z: np.ndarray
    valid: np.ndarray
    free: tuple[int, ...]
    free_initial: tuple[int, ...]
    in_dynamics: tuple[int, ...]
    increment: np.ndarray
    exact: bool
    drive: Drive | None
    step: Step = rk4_step


def record_problem(
    record: Record,
    system: System,
    max_step: float,
    free: Sequence[int],
    free_initial: Sequence[int],
    *,
    valid: np.ndarray | None = None,
    at: np.ndarray | None = None,
    exact: bool = True,
    step: Step = rk4_step,
) -> RecordProblem:
    """Return a record laid out for a fit.

    Parameters
    ----------
    max_step : longest sub-step, s.
    free, free_initial : positions of the unknown parameters and of the unknown initial states.
    valid : ``(m, N)`` mask of the samples to use, of the valid ones; None uses all valid samples.
    at : ``(np,)`` parameters at which a fixed input path is evaluated; None takes those of the
        system.
    exact, step : as in `RecordProblem`.
    """
    z, measured = record.output_array(system.output_names)
    grid, recorded = _recorded(record, system.input_names, max_step)
    items = [system.parameters.items[index] for index in free]
    sizes = [abs(item.value) or _size_of_zero(item) for item in items]
    in_dynamics = [
        position for position, item in enumerate(items) if item.name not in system.output_parameters
    ]
    drive = None
    if not system.input_parameters.intersection(item.name for item in items):
        drive = recorded
        if system.input_stages:
            p = system.parameters.values() if at is None else at
            drive = vehicle_inputs(record, system, p.tolist(), grid)
    mask = measured if valid is None else measured & valid
    increment = DIFFERENCE_STEP_SHARE * np.array(sizes, dtype=float)
    return RecordProblem(
        record,
        system,
        grid,
        z,
        mask,
        tuple(free),
        tuple(free_initial),
        tuple(in_dynamics),
        increment,
        exact,
        drive,
        step,
    )


def _size_of_zero(item: Parameter) -> float:
    """Return the size to which the difference step of a parameter of value zero is relative."""
    return item.prior_std if np.isfinite(item.prior_std) else 1.0


@lru_cache(maxsize=16)  # a search lays out the same records hundreds of times
def _recorded(record: Record, inputs: tuple[str, ...], max_step: float) -> tuple[Grid, Drive]:
    """Return the grid of a record and its recorded inputs on this grid."""
    grid = make_grid(record.time, max_step)
    return grid, recorded_drive(record.input_array(inputs), record.time, record.hold, grid)


def vehicle_inputs(
    record: Record, system: System, p: Sequence[Any] | np.ndarray, grid: Grid
) -> Drive:
    """Return the inputs of a record at the vehicle: after the input path (lags, delays) at
    parameters ``p (np,)``.
    """
    return drive_from_record(
        system, p, record.input_array(system.input_names), record.time, record.hold, grid
    )


# ---- Simulation of all node intervals at once

# most values of one state (columns times intervals) that are integrated together; more do not fit
# the processor's cache
_LARGEST_BATCH = 16_000


def changed_rows(drive: Drive, change: Callable[[Any], Any]) -> Drive:
    """Return the drive with ``change`` applied to every row. A row that occurs several times, such
    as the row of a held input, is changed once.
    """
    first, middle, last, begin, end = _changed([*drive.stages, drive.begin, drive.end], change)
    return Drive((first, middle, last), begin, end)


def _changed(row_lists: Sequence[list[Any]], change: Callable[[Any], Any]) -> list[list[Any]]:
    """Return the lists with ``change`` applied to every row, once to each distinct row object."""
    distinct = {id(row): row for rows in row_lists for row in rows}
    changed = {key: change(row) for key, row in distinct.items()}
    return [[changed[id(row)] for row in rows] for rows in row_lists]


# ---- Variants of the motion: one unknown changed in each column


def parameter_increments(problem: RecordProblem) -> np.ndarray:
    """Return the differentiation steps of the unknown parameters, ``(len(problem.free),)``."""
    return np.full(len(problem.free), 1j * COMPLEX_STEP) if problem.exact else problem.increment


def state_increments(problem: RecordProblem, guess: np.ndarray) -> np.ndarray:
    """Return the differentiation steps ``(nx,)`` of the states of a trajectory ``guess (nx, K +
    1)``.
    """
    if problem.exact:
        return np.full(len(guess), 1j * COMPLEX_STEP)
    size = np.sqrt(np.mean(guess**2, axis=1))
    return DIFFERENCE_STEP_SHARE * np.where(size > 0, size, 1.0)


def slopes_of(exact: bool, changed: np.ndarray, base: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the derivatives ``(..., c, n)`` from values at the base, ``base (..., n)``, and from
    values that are changed by one of the ``steps (c,)`` each, ``changed (..., c, n)``. The steps
    are complex where ``exact`` is True.
    """
    if exact:
        return np.asarray(changed.imag / COMPLEX_STEP)
    return np.asarray((changed - base[..., None, :]) / steps[:, None])


def changed_parameters(
    problem: RecordProblem, p: np.ndarray, columns: Mapping[int, int], steps: np.ndarray, width: int
) -> list[Any]:
    """Return all parameters for a batch of ``width`` columns: a number, or a row ``(width,)`` for a
    changed parameter.

    ``columns`` maps the position of an unknown parameter to the column in which it is changed by
    its step, one of ``steps (len(problem.free),)``.
    """
    rows: list[Any] = p.tolist()
    for position, column in columns.items():
        row = np.full(width, p[problem.free[position]], dtype=steps.dtype)
        row[column] += steps[position]
        rows[problem.free[position]] = row
    return rows


@dataclass(frozen=True, eq=False)
class VehicleInputs:
    """Inputs at the vehicle, with one further column for each unknown parameter of the input path.

    Attributes
    ----------
    drive : rows ``(M,)``, or ``(M, 1 + a)`` where a unknown parameters act in the input path: the
        base, then one column with each of them changed.
    acting : positions of these a parameters among the unknown ones.
    """

    drive: Drive
    acting: tuple[int, ...]

    def in_columns(self, columns: Mapping[int, int], width: int) -> Drive:
        """Return the inputs in the ``width`` columns of a batch, rows ``(width, M)`` or ``(M,)``;
        ``columns`` maps the position of an unknown parameter to its column in the batch.
        """
        if not self.acting:
            return self.drive
        source = np.zeros(width, dtype=int)  # column of the drive for each column of the batch
        for column, position in enumerate(self.acting):
            if position in columns:
                source[columns[position]] = 1 + column
        return changed_rows(self.drive, lambda row: row.T[source] if np.ndim(row) == 2 else row)


def inputs_with_changes(problem: RecordProblem, p: np.ndarray, steps: np.ndarray) -> VehicleInputs:
    """Return the inputs at the vehicle for the base and with each unknown parameter of the input
    path changed by its step.
    """
    if problem.drive is not None:
        return VehicleInputs(problem.drive, ())
    system = problem.system
    acting = tuple(
        position
        for position, index in enumerate(problem.free)
        if system.parameters.items[index].name in system.input_parameters
    )
    columns = {position: 1 + column for column, position in enumerate(acting)}
    parameters = changed_parameters(problem, p, columns, steps, 1 + len(acting))
    return VehicleInputs(vehicle_inputs(problem.record, system, parameters, problem.grid), acting)


# ---- Outputs and ends of intervals


def sample_outputs(
    problem: RecordProblem,
    p: Sequence[Any],
    X: list[Any],
    drive: Drive,
    moving_columns: Sequence[int],
) -> np.ndarray:
    """Return the outputs ``(m, c, N)`` at the samples of the record.

    Parameters
    ----------
    p : all parameters: a number, or a row ``(c,)`` with one value for each column.
    X : row ``(c, K + 1)`` of each state at the nodes.
    drive : inputs, rows ``(c, M)`` over the M sub-steps.
    moving_columns : columns whose states differ, 0 first. The other columns differ from column 0 in
        the output equation only.
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
    edges = _all_edges(problem, p, X, drive, moving_columns)
    last = [row[:, -1:] for row in X]
    begin_x = [
        np.concatenate([_in_time_order(rows), row], axis=1)
        for rows, row in zip(zip(*edges[:-1], strict=True), last, strict=True)
    ]
    end_x = [_in_time_order(rows) for rows in zip(*edges[1:], strict=True)]
    begin = stacked(system.h(grid.edges, begin_x, drive.begin, parameters), (c, len(grid.edges)))
    end = stacked(system.h(grid.edges[1:], end_x, drive.end, parameters), (c, len(grid.edges) - 1))
    # The sensor path needs time as the first axis of its arrays.
    rows, _ = system.sensor_path(p, [row.T for row in begin], [row.T for row in end], grid.steps)
    return stacked(
        [np.broadcast_to(row, (len(grid.edges), c)).T[:, sample] for row in rows], (c, len(sample))
    )


def _all_edges(
    problem: RecordProblem,
    p: Sequence[Any],
    X: list[Any],
    drive: Drive,
    moving_columns: Sequence[int],
) -> list[list[Any]]:
    """Return the states at all edges as `integrate_intervals` does.

    ``X`` has a row ``(c, K + 1)`` of each state at the nodes. Only the columns ``moving_columns``
    are integrated; the others equal column 0.
    """
    starts, c = [row[:, :-1] for row in X], len(X[0])
    if len(moving_columns) == c:
        return integrate_intervals(problem, starts, drive, p)
    chosen = list(moving_columns)
    chosen_values = [value[chosen] if np.ndim(value) else value for value in p]
    chosen_drive = changed_rows(drive, lambda row: row[chosen] if np.ndim(row) == 2 else row)
    column_of = np.zeros(c, dtype=int)
    column_of[chosen] = np.arange(len(chosen))
    shape = (len(chosen), starts[0].shape[1])
    edges = integrate_intervals(
        problem, [row[chosen] for row in starts], chosen_drive, chosen_values
    )
    return [[np.broadcast_to(row, shape)[column_of] for row in rows] for rows in edges]


def _in_time_order(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Return values in order of time, ``(c, K S)``. ``rows`` has one array ``(c, K)`` for each of
    the S sub-steps.
    """
    return np.stack(rows, axis=2).reshape(len(rows[0]), -1)


def interval_ends(
    problem: RecordProblem, x: Sequence[Any], drive: Drive, p: Sequence[Any], columns: int = 0
) -> np.ndarray:
    """Return the states ``(nx, c, K)`` at the end of all intervals.

    Parameters
    ----------
    x : row ``(c, K)`` of each state at the beginning of the intervals.
    drive : inputs, rows ``(M,)`` or ``(c, M)`` over the M sub-steps.
    p : all parameters: a number, or a row ``(c,)`` with one value for each column.
    columns : number c of columns, needed where a state that is equal in all columns is given as a
        row ``(1, K)``; 0 takes it from ``x``.
    """
    shape, ends = (columns or len(x[0]), x[0].shape[1]), None
    for part in _parts(*shape):
        last = _integrate_part(problem, [row[:, part] for row in x], drive, p, part)[-1]
        ends = _write_part(ends, last, shape, part)
    assert ends is not None
    return ends


def _parts(c: int, K: int) -> list[slice]:
    """Return slices of K intervals whose states in c columns fit the processor's cache."""
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


def integrate_intervals(
    problem: RecordProblem, x: list[Any], drive: Drive, p: Sequence[Any]
) -> list[list[Any]]:
    """Return the states at the beginning of all intervals and after each of the S sub-steps: S + 1
    lists with a row ``(c, K)`` for each state.

    ``x`` has the rows at the beginning. Rows of the drive are ``(M,)`` or ``(c, M)``.
    """
    c, K = x[0].shape
    parts = _parts(c, K)
    if len(parts) == 1:
        return _integrate_part(problem, x, drive, p, slice(0, K))
    paths = [
        _integrate_part(problem, [row[:, part] for row in x], drive, p, part) for part in parts
    ]
    shapes = [path[0][0].shape for path in paths]

    def joined(rows: Sequence[Any]) -> np.ndarray:
        return np.concatenate(
            [np.broadcast_to(row, shape) for row, shape in zip(rows, shapes, strict=True)], axis=1
        )

    return [[joined(rows) for rows in zip(*edge, strict=True)] for edge in zip(*paths, strict=True)]


def _integrate_part(
    problem: RecordProblem, x: list[Any], drive: Drive, p: Sequence[Any], part: slice
) -> list[list[Any]]:
    """Return the states as `integrate_intervals` does, for the intervals ``part`` alone. ``x`` has
    the states at the beginning of these intervals.
    """
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
    """Return the rows in one array ``(len(rows), *shape)``; each row is broadcast to ``shape``."""
    array = np.empty((len(rows), *shape), dtype=np.result_type(float, *rows))
    for i, row in enumerate(rows):
        array[i] = row
    return array


def _as_columns(p: Sequence[Any]) -> list[Any]:
    """Return the parameters in shapes that match rows ``(c, K)``: a number, or ``(c, 1)`` with one
    value for each column.
    """
    return [value[:, None] if np.ndim(value) else value for value in p]
