"""One record laid out for a fit: grid and inputs, interval transitions, exact simulation of linear
equations.

Arrays of states and inputs have columns first and times last, so that one step of the integrator
handles all intervals and columns.

Where the rates are linear in the states with coefficients that are at most products of two
parameters, one table holds them all (`ident.bilinear_table`). A step of the integrator is then one
matrix on (states, 1, inputs), and its derivatives by the parameters are matrices too: simulation
and sensitivities are two solutions of one banded recursion, exact to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ident.bilinear_table import constant_within_steps, system_tables
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
    """A record laid out for whole-record fits: ``z``, ``valid`` ``(m, N)``, grid, and the columns
    wanted.

    ``free`` are positions of the wanted parameters among all, ``starts`` those of the wanted
    initial states; ``moving`` are those of ``free`` that act in the dynamics. ``exact``
    differentiates by complex steps, else by forward differences of ``increment (np,)``: a few times
    cheaper, good to about a millionth. ``drive`` is kept where no parameter moves it.
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
    """Lay out a record; sub-steps of at most ``max_step`` s; ``valid (m, N)`` replaces the record's
    own mask.

    ``at (np,)``: parameters of the input path if none of them is free; None: the system's own.
    """
    z, measured = record.output_array(system.output_names)
    grid, recorded = _recorded(record, system.input_names, max_step)
    items = [system.parameters.items[index] for index in free]
    sizes = [
        abs(item.value) or (item.prior_std if np.isfinite(item.prior_std) else 1.0)
        for item in items
    ]
    acting = [
        position for position, item in enumerate(items) if item.name not in system.output_parameters
    ]
    drive = None
    if not system.input_parameters.intersection(item.name for item in items):
        held = system.parameters.values() if at is None else at
        drive = driven_by(record, system, held.tolist(), grid) if system.input_stages else recorded
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
        tuple(acting),
        increment,
        exact,
        drive,
        step,
    )


@lru_cache(maxsize=16)  # a search lays out the same records hundreds of times
def _recorded(record: Record, inputs: tuple[str, ...], max_step: float) -> tuple[Grid, Drive]:
    grid = make_grid(record.time, max_step)
    return grid, recorded_drive(record.input_array(inputs), record.time, record.hold, grid)


def driven_by(record: Record, system: System, p: Sequence[Any] | np.ndarray, grid: Grid) -> Drive:
    """Return a record's inputs at the vehicle, through the input path at parameters ``p``."""
    return drive_from_record(
        system, p, record.input_array(system.input_names), record.time, record.hold, grid
    )


# ---- Interval transitions

# numbers of a state integrated together; more do not fit the processor's cache
_LARGEST_BATCH = 16_000


def changed_rows(drive: Drive, change: Callable[[Any], Any]) -> Drive:
    """Return a drive with every row changed; a row that occurs several times (held inputs) is
    changed once.
    """
    first, middle, ended, begin, end = _changed([*drive.stages, drive.begin, drive.end], change)
    return Drive((first, middle, ended), begin, end)


def _changed(lists: Sequence[list[Any]], change: Callable[[Any], Any]) -> list[list[Any]]:
    done: dict[int, Any] = {}
    return [
        [
            done[id(row)] if id(row) in done else done.setdefault(id(row), change(row))
            for row in rows
        ]
        for rows in lists
    ]


def sample_outputs(
    problem: RecordProblem, p: Sequence[Any], X: list[Any], drive: Drive, apart: Sequence[int]
) -> np.ndarray:
    """Return the outputs at the record's samples ``(m, c, N)`` from states at the nodes, rows ``(c,
    K + 1)``; rows of the drive ``(c, M)``.

    ``apart`` are the columns, 0 first, whose states differ; the other columns differ from column 0
    in the output equation only.
    """
    system, grid, upright, c = problem.system, problem.grid, _as_columns(p), len(X[0])
    sample = grid.sample
    if not system.sensor_stages:
        nodes, out = sample // grid.substeps, None
        for at in _parts(c, len(sample)):
            here = [
                row[:, at] if len(sample) == len(grid.nodes) else row[:, nodes[at]] for row in X
            ]
            y = system.h(
                grid.edges[sample[at]], here, [row[..., sample[at]] for row in drive.begin], upright
            )
            out = _write_part(out, y, (c, len(sample)), at)
        assert out is not None
        return out
    edges = _all_edges(problem, p, X, drive, apart)
    last = [row[:, -1:] for row in X]
    begin_x = [
        np.concatenate([_in_time_order(rows), row], axis=1)
        for rows, row in zip(zip(*edges[:-1], strict=True), last, strict=True)
    ]
    end_x = [_in_time_order(rows) for rows in zip(*edges[1:], strict=True)]
    begin = stacked(system.h(grid.edges, begin_x, drive.begin, upright), (c, len(grid.edges)))
    end = stacked(system.h(grid.edges[1:], end_x, drive.end, upright), (c, len(grid.edges) - 1))
    # The sensor path needs time as its first axis.
    rows, _ = system.sensor_path(p, [row.T for row in begin], [row.T for row in end], grid.steps)
    return stacked(
        [np.broadcast_to(row, (len(grid.edges), c)).T[:, sample] for row in rows], (c, len(sample))
    )


def _all_edges(
    problem: RecordProblem, p: Sequence[Any], X: list[Any], drive: Drive, apart: Sequence[int]
) -> list[list[Any]]:
    """Return the same as ``cross_intervals`` from ``X (c, K + 1)``, computed for the columns
    ``apart``; the others equal column 0.
    """
    starts, c = [row[:, :-1] for row in X], len(X[0])
    if len(apart) == c:
        return cross_intervals(problem, starts, drive, p)
    chosen = list(apart)
    chosen_values = [value[chosen] if np.ndim(value) else value for value in p]
    fewer = changed_rows(drive, lambda row: row[chosen] if np.ndim(row) == 2 else row)
    place = np.zeros(c, dtype=int)
    place[chosen] = np.arange(len(chosen))
    shape = (len(chosen), starts[0].shape[1])
    return [
        [np.broadcast_to(row, shape)[place] for row in rows]
        for rows in cross_intervals(problem, [row[chosen] for row in starts], fewer, chosen_values)
    ]


def _in_time_order(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Return the values ``(c, K)`` at each of S sub-steps in order of time: ``(c, K S)``."""
    return np.stack(rows, axis=2).reshape(len(rows[0]), -1)


def interval_ends(
    problem: RecordProblem, x: Sequence[Any], drive: Drive, p: Sequence[Any], columns: int = 0
) -> np.ndarray:
    """Return the states ``(nx, c, K)`` at the end of all node intervals from those at the
    beginning, rows ``(c, K)``; rows of the drive ``(c, M)``.

    ``columns`` : c; a state that is equal in all columns may be a row ``(1, K)``.
    """
    shape, out = (columns or len(x[0]), x[0].shape[1]), None
    for at in _parts(*shape):
        out = _write_part(
            out, _crossed(problem, [row[:, at] for row in x], drive, p, at)[-1], shape, at
        )
    assert out is not None
    return out


def _parts(c: int, K: int) -> list[slice]:
    """Yield the columns ``(c, K)`` cut along time, to fit the processor's cache."""
    rows = max(1, -(-K // max(1, -(-c * K // _LARGEST_BATCH))))
    return [slice(k, min(k + rows, K)) for k in range(0, max(K, 1), rows)]


def _write_part(
    out: np.ndarray | None, rows: Sequence[Any], shape: tuple[int, ...], at: slice
) -> np.ndarray:
    """Write the rows of one part to its place in the whole, ``(len(rows), *shape)``, created with
    the first part; return the whole.
    """
    if out is None:
        out = np.empty((len(rows), *shape), dtype=np.result_type(float, *rows))
    for i, row in enumerate(rows):
        out[i, :, at] = row
    return out


def cross_intervals(
    problem: RecordProblem, x: list[Any], drive: Drive, p: Sequence[Any]
) -> list[list[Any]]:
    """Return the states before the first and after every sub-step of all node intervals, rows ``(c,
    K)``; rows of the drive ``(c, M)``.
    """
    c, K = x[0].shape
    parts = _parts(c, K)
    if len(parts) == 1:
        return _crossed(problem, x, drive, p, slice(0, K))
    done = [_crossed(problem, [row[:, at] for row in x], drive, p, at) for at in parts]
    shapes = [part[0][0].shape for part in done]

    def joined(rows: Sequence[Any]) -> np.ndarray:
        return np.concatenate(
            [np.broadcast_to(row, shape) for row, shape in zip(rows, shapes, strict=True)], axis=1
        )

    return [[joined(rows) for rows in zip(*edge, strict=True)] for edge in zip(*done, strict=True)]


def _crossed(
    problem: RecordProblem, x: list[Any], drive: Drive, p: Sequence[Any], at: slice
) -> list[list[Any]]:
    """Return the same for some of the intervals, whose states are ``x``."""
    grid, substeps, upright = problem.grid, problem.grid.substeps, _as_columns(p)
    path = [x]
    for s in range(substeps):

        def mine(row: Any, s: int = s) -> Any:
            return np.ascontiguousarray(row.reshape(*row.shape[:-1], -1, substeps)[..., at, s])

        first, middle, ended = _changed(drive.stages, mine)
        x = problem.step(
            problem.system.f,
            mine(grid.edges[:-1]),
            x,
            (first, middle, ended),
            upright,
            mine(grid.steps),
        )
        path.append(x)
    return path


def stacked(rows: Sequence[Any], shape: tuple[int, ...]) -> np.ndarray:
    """Return the rows, some of them shared by all columns or numbers, in one array ``(len(rows),
    *shape)``.
    """
    out = np.empty((len(rows), *shape), dtype=np.result_type(float, *rows))
    for i, row in enumerate(rows):
        out[i] = row
    return out


def _as_columns(p: Sequence[Any]) -> list[Any]:
    """Return the parameters for rows ``(c, K)``: those with one value a column as ``(c, 1)``."""
    return [value[:, None] if np.ndim(value) else value for value in p]


# ---- Linear equations with held inputs

_ORDERS = {rk4_step: 4, euler_step: 1}
_EVEN_SAMPLING_TOLERANCE = 1e-9  # largest relative difference of even steps


Line = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def linear_record(
    problem: RecordProblem, p: np.ndarray, x0: np.ndarray, guess: np.ndarray
) -> Line | None:
    """``y``, ``jacobian``, ``states`` and ``by_state`` of a ``Linearisation`` at parameters ``p
    (np,)`` and initial state ``x0``.

    States are simulated; their sensitivities are formed along the ``guess (nx, K + 1)`` as in
    `ident.whole_record.linearise`, so that a fit converges from a poor start: measured states are
    nearer to the truth than its simulation. None where the equations are not of this kind, a
    parameter moves the inputs, a sensor has a memory, or steps are not even.
    """
    system = problem.system
    if problem.drive is None or system.sensor_stages or problem.step not in _ORDERS:
        return None
    step = _held(problem.drive, problem.grid)
    line = None if step is None else _line(system, _held_values(system, p))
    if step is None or line is None or not set(problem.free) <= set(line.free):
        return None
    n_x, starts, substeps = len(x0), list(problem.starts), problem.grid.substeps
    both, by_both = line.at(p, problem.free)
    reading, by_reading = both[n_x:], by_both[:, n_x:]
    moves, by_moves = _step_matrices(both[:n_x], by_both[:, :n_x], step.dt, _ORDERS[problem.step])
    n_p, m, c, count = len(by_both), len(reading), len(by_both) + len(starts), len(step.fed)

    # Rows of time: the arguments (states, 1, inputs) of a step, which multiply every right-hand
    # side of the recursion.
    band = _band(moves[:, :n_x], count)
    right = np.empty((1, count + 1, n_x))
    right[0, 0] = x0
    np.matmul(step.fed, moves[:, n_x:].T, out=right[0, 1:])
    states = _solved(band, right)[0]
    right = np.zeros((c, count + 1, n_x))
    np.matmul(
        _along(guess, moves, step.fed, substeps), by_moves.transpose(0, 2, 1), out=right[:n_p, 1:]
    )
    right[n_p + np.arange(len(starts)), 0, starts] = 1.0
    by_state = np.ascontiguousarray(_solved(band, right).transpose(2, 1, 0))

    at = step.samples
    seen = np.concatenate([states[at], step.seen], axis=1)
    jacobian = (reading[:, :n_x] @ by_state[:, at].reshape(n_x, -1)).reshape(m, len(seen), c)
    if np.any(by_reading):  # outputs that are states depend on no parameter
        jacobian[:, :, :n_p] += seen @ by_reading.transpose(1, 2, 0)
    return reading @ seen.T, jacobian, states[::substeps].T.copy(), by_state[:, ::substeps]


def _along(guess: np.ndarray, moves: np.ndarray, fed: np.ndarray, substeps: int) -> np.ndarray:
    """Return the arguments of each step, (states, 1, inputs) ``(M, l)``, with its states from the
    guess at the node before.
    """
    n_x = len(guess)
    out = np.empty((len(fed), n_x + fed.shape[1]))
    out[:, n_x:] = fed
    out[::substeps, :n_x] = guess[:, :-1].T
    for s in range(1, substeps):
        out[s::substeps, :n_x] = out[s - 1 :: substeps] @ moves.T
    return out


def _band(Phi: np.ndarray, count: int) -> np.ndarray:
    """Return the matrix of x[k] - Phi x[k - 1] over so many steps, ``(2 n, (count + 1) n)`` in the
    diagonal storage of LAPACK.
    """
    n = len(Phi)
    band = np.zeros((2 * n, count + 1, n))
    band[0] = 1.0
    for i in range(n):
        for j in range(n):
            band[n + i - j, :, j] = -Phi[i, j]
    return np.asfortranarray(band.reshape(2 * n, -1))


def _solved(band: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve x[k] - Phi x[k - 1] = right[k], x[0] = right[0], for every right-hand side ``(c, count
    + 1, n)``, which is overwritten.
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
    """Return the matrix ``(n_x, l)`` of a step of this order on (states, 1, inputs), and its
    derivatives ``(c, n_x, l)``, from those of the rates.

    I + A + A^2/2 + ... of the square matrix with the rates in its first rows and zeros below, which
    holds 1 and the inputs.
    """
    n_x, size = rates.shape
    A = np.zeros((1 + len(by_rates), size, size), dtype=complex)
    A[:, :n_x] = rates * dt
    A[1:, :n_x] += (1j * COMPLEX_STEP * dt) * by_rates
    one = np.eye(size)
    total = one + A / order
    for k in range(order - 1, 0, -1):
        total = one + A @ total / k
    return total[0, :n_x].real.copy(), total[1:, :n_x].imag / COMPLEX_STEP


@dataclass(frozen=True, eq=False)
class _EqualSteps:
    """Steps of equal size ``dt`` (s) with their arguments ``(M, 1 + n_u)``: 1 and the inputs;
    ``seen (N, 1 + n_u)`` are those at the ``samples`` among the edges.
    """

    dt: float
    fed: np.ndarray
    seen: np.ndarray
    samples: slice | np.ndarray


@lru_cache(maxsize=16)
def _held(drive: Drive, grid: Grid) -> _EqualSteps | None:
    if (
        not constant_within_steps(drive)
        or np.ptp(grid.steps) > _EVEN_SAMPLING_TOLERANCE * grid.steps[0]
    ):
        return None
    at = grid.sample
    every = slice(None, None, grid.substeps) if len(at) == len(grid.nodes) else at
    fed, seen = (
        [np.ones(count), *rows]
        for count, rows in (
            (len(grid.steps), drive.stages[0]),
            (len(at), [row[at] for row in drive.begin]),
        )
    )
    return _EqualSteps(
        float(grid.steps.mean()), np.stack(fed, axis=1), np.stack(seen, axis=1), every
    )


@dataclass(frozen=True, eq=False)
class _LinearFunctions:
    """Rates and outputs as ``r`` linear functions of the ``l`` arguments (states, 1, inputs), with
    ``P`` free parameters at positions ``free``.

    ``matrix (r, l)`` at zero, ``by_parameter (P, r, l)``, and of the column of the 1, at ``one``,
    second derivatives ``(P, r, P)``, None without.
    """

    free: tuple[int, ...]
    matrix: np.ndarray
    by_parameter: np.ndarray
    squares: np.ndarray | None
    one: int

    def at(self, p: np.ndarray, wanted: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Return the matrix at all parameters ``p (np,)`` and its derivatives ``(c, r, l)`` by the
        ``wanted`` of the free ones, positions among all.
        """
        theta, order = p[list(self.free)], [self.free.index(index) for index in wanted]
        matrix = self.matrix + (
            theta @ self.by_parameter.reshape(len(theta), self.matrix.size)
        ).reshape(self.matrix.shape)
        derivatives = self.by_parameter[order]
        if self.squares is not None:
            bent = self.squares @ theta
            matrix[:, self.one] += 0.5 * theta @ bent
            derivatives[:, :, self.one] += bent[order]
        return matrix, derivatives


def _held_values(system: System, p: np.ndarray) -> tuple[float, ...]:
    return tuple(
        p[[index for index, item in enumerate(system.parameters.items) if not item.free]].tolist()
    )


@lru_cache(maxsize=64)  # a fit needs the same one many times
def _line(system: System, held: tuple[float, ...]) -> _LinearFunctions | None:
    values, left = system.parameters.values().tolist(), iter(held)
    for index, item in enumerate(system.parameters.items):
        values[index] = values[index] if item.free else next(left)
    with np.errstate(all="ignore"):
        found = system_tables(system, values)
    if found is None:
        return None
    n_x, n, width = len(system.states), found[0].n, len(found[0].table)
    # Half the derivatives by (1, states, parameters, inputs), linear terms whole.
    halves = np.concatenate(
        [table.table.reshape(width, -1, n + width)[:, :, n:] for table in found], axis=1
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
