"""Fast linearisation of a record whose equations are linear in states and inputs.

It applies where rates and outputs are linear in (states, 1, inputs), do not depend on time, and the
samples are evenly spaced. Parameters may enter in any way. A few calls of the equations then give
all coefficients and their derivatives with respect to the parameters. One step of the integrator is
a matrix times (states, 1, inputs at its stages). The states and the sensitivities are two solutions
of one banded system, exact to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np

from ident.bilinear_table import constant_within_steps
from ident.whole_record.record_problem import (
    RecordProblem,
    VehicleInputs,
    changed_parameters,
    slopes_of,
    stacked,
    state_increments,
)
from sim.declaration.model import System
from sim.declaration.user_arguments import WatchedTime
from sim.errors import ModelError
from sim.maths import COMPLEX_STEP
from sim.propagation import Drive, Grid, euler_step, rk4_step

_INTEGRATORS = (rk4_step, euler_step)
_EVEN_SAMPLING_TOLERANCE = 1e-9  # largest relative difference of even steps
_TRIAL_POINTS = 8  # random states and inputs at which equations are tested for linearity
_LARGEST_DIFFERENCE = 1e-10  # largest difference at these points, relative to the sum of terms


# arrays y, jacobian, states and by_state of a `Linearisation`
LinearisationArrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def linear_record(
    problem: RecordProblem,
    p: np.ndarray,
    x0: np.ndarray,
    guess: np.ndarray,
    inputs: VehicleInputs,
    increments: np.ndarray,
) -> LinearisationArrays | None:
    """Return the linearisation of linear equations at parameters ``p (np,)`` and initial state ``x0
    (nx,)``; None where it does not apply.

    The states are simulated. Their sensitivities are taken along the ``guess (nx, K + 1)``, as in
    `ident.whole_record.linearise`: a fit then also converges from a poor start, whose simulation is
    farther from the truth than the measured states. The function does not apply where the equations
    are not linear or depend on time, or the steps differ.

    Parameters
    ----------
    inputs : inputs at the vehicle at ``p``.
    increments : differentiation steps of the unknown parameters, ``(len(problem.free),)``.
    """
    system, grid = problem.system, problem.grid
    if problem.step not in _INTEGRATORS or not _has_even_steps(grid) or _is_not_linear(system):
        return None
    n_x, starts, n_p = len(x0), list(problem.free_initial), len(problem.free)
    functions = _linear_functions(problem, p, increments)
    if functions is None:
        return None
    if inputs.acting:
        rows = _inputs_of(inputs, grid, problem.exact, tuple(increments.tolist()))
    else:
        rows = _unchanged_inputs(inputs.drive, grid)
    transition, by_transition = _step_matrices(
        functions.rates,
        functions.by_rates,
        float(grid.steps.mean()),
        held=rows.held,
        euler=problem.step is euler_step,
    )
    count, c = len(grid.steps), n_p + len(starts)

    # The arguments (states, 1, inputs) have one row for each step.
    band = _band(transition[:, :n_x], count)
    right = np.empty((1, count + 1, n_x))
    right[0, 0] = x0
    np.matmul(rows.steps, transition[:, n_x:].T, out=right[0, 1:])
    states = _solve_recursion(band, right)[0]
    right = np.zeros((c, count + 1, n_x))
    arguments = _step_arguments(guess, transition, rows.steps, grid.substeps)
    np.matmul(arguments, by_transition.transpose(0, 2, 1), out=right[:n_p, 1:])
    for position, changes in rows.by_parameter.items():
        right[position, 1:] += changes.steps @ transition[:, n_x + 1 :].T
    right[n_p + np.arange(len(starts)), 0, starts] = 1.0
    by_state = np.ascontiguousarray(_solve_recursion(band, right).transpose(2, 1, 0))
    if system.sensor_stages:
        steps = np.append(increments, state_increments(problem, guess)[starts])
        y, jacobian = _sensed_outputs(problem, functions, rows, (states, by_state), (p, steps))
    else:
        samples = _samples(grid)
        y, jacobian = functions.outputs(
            states[samples],
            by_state[:, samples],
            rows.begin[samples],
            {position: each.begin[samples] for position, each in rows.by_parameter.items()},
        )
    return y, jacobian, states[:: grid.substeps].T.copy(), by_state[:, :: grid.substeps]


@lru_cache(maxsize=16)
def _samples(grid: Grid) -> slice | np.ndarray:
    """Return the positions of the record's samples among the edges, as a slice where it can be."""
    every_node = len(grid.sample) == len(grid.nodes)
    return slice(None, None, grid.substeps) if every_node else grid.sample


@dataclass(frozen=True, eq=False)
class _InputRows:
    """Inputs in the order of the columns of the step and output matrices.

    Attributes
    ----------
    held : whether all inputs are constant within each step.
    steps : ``(M, 1 + w)`` 1 and the inputs of each step, ``(M, w)`` for the change by a parameter.
        ``w`` is the number of inputs if they are held; else three times this number: all inputs at
        the beginning, the middle and the end of the step.
    begin, end : ``(M + 1, 1 + nu)`` and ``(M, 1 + nu)``: 1 and the inputs that act on the outputs
        at the begin of each step (with the last edge), and at its end; without the 1 for the change
        by a parameter.
    by_parameter : position of an unknown parameter that changes the inputs -> derivatives.
    """

    held: bool
    steps: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    by_parameter: dict[int, _InputRows]


@lru_cache(maxsize=16)  # a fit needs the same inputs many times
def _unchanged_inputs(drive: Drive, grid: Grid) -> _InputRows:
    """Return the inputs at the vehicle where no unknown parameter changes them."""
    return _inputs_of(VehicleInputs(drive, ()), grid, False, ())


def _inputs_of(
    inputs: VehicleInputs,
    grid: Grid,
    exact: bool,
    increments: tuple[float, ...],
) -> _InputRows:
    """Return the inputs at the vehicle, and their derivatives with respect to the parameters of the
    input path.

    ``increments`` are the differentiation steps of the unknown parameters, complex where ``exact``.
    """
    drive, count = inputs.drive, len(grid.steps)
    held = constant_within_steps(drive)
    stages = drive.stages[:1] if held else drive.stages

    def table(values: Callable[[np.ndarray], np.ndarray], first: int) -> _InputRows:
        """Return the rows of the drive mapped by ``values``, after ``first`` columns of ones."""

        def stack(rows: Sequence[np.ndarray], length: int) -> np.ndarray:
            columns = [*[np.ones(length)] * first, *(values(row) for row in rows)]
            return np.stack(columns, axis=1) if columns else np.zeros((length, 0))

        return _InputRows(
            held,
            stack([row for stage in stages for row in stage], count),
            stack(drive.begin, count + 1),
            stack(drive.end, count),
            {},
        )

    def base(row: np.ndarray) -> np.ndarray:
        return row if np.ndim(row) == 1 else row[:, 0].real

    def slope(column: int, row: np.ndarray) -> np.ndarray:
        if np.ndim(row) == 1:
            return np.zeros(len(row))
        step = np.array([increments[inputs.acting[column - 1]]])
        return slopes_of(exact, row[:, [column]].T, base(row), step)[0]

    changes = {
        position: table(partial(slope, 1 + number), 0)
        for number, position in enumerate(inputs.acting)
    }
    return replace(table(base, 1), by_parameter=changes)


def _sensed_outputs(
    problem: RecordProblem,
    functions: _LinearFunctions,
    inputs: _InputRows,
    trajectory: tuple[np.ndarray, np.ndarray],
    parameters: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the outputs ``(m, N)`` after sensors with memory, and their derivatives ``(m, N, c)``
    with respect to the c unknowns.

    ``trajectory`` are the states ``(M + 1, nx)`` at all edges and their derivatives ``(nx, M + 1,
    c)``. ``parameters`` are all parameters ``(np,)`` and the differentiation steps ``(c,)`` of the
    unknowns.
    """
    system, sample = problem.system, problem.grid.sample
    (states, by_state), (p, steps) = trajectory, parameters
    begin, by_begin = functions.outputs(
        states,
        by_state,
        inputs.begin,
        {position: rows.begin for position, rows in inputs.by_parameter.items()},
    )
    end, by_end = functions.outputs(
        states[1:],
        by_state[:, 1:],
        inputs.end,
        {position: rows.end for position, rows in inputs.by_parameter.items()},
    )
    columns, c = {position: 1 + position for position in range(len(problem.free))}, 1 + len(steps)
    rows, _ = system.sensor_path(
        changed_parameters(problem, p, columns, steps, c),
        _columns(begin, by_begin, steps),
        _columns(end, by_end, steps),
        problem.grid.steps,
    )
    full = stacked(
        [np.broadcast_to(row, (len(states), c)).T[:, sample] for row in rows], (c, len(sample))
    )
    base = full[:, 0].real.copy()
    slopes = slopes_of(problem.exact, full[:, 1:], base, steps)
    return base, np.ascontiguousarray(slopes.swapaxes(1, 2))


def _columns(values: np.ndarray, slopes: np.ndarray, steps: np.ndarray) -> list[np.ndarray]:
    """Return one array ``(k, 1 + c)`` for each output: its values ``(k,)``, and these changed by
    each of the ``steps (c,)`` times its slope. ``slopes`` is ``(m, k, c)``.
    """
    changes = np.concatenate([np.zeros((*values.shape, 1)), slopes * steps], axis=2)
    return list(values[:, :, None] + changes)


def _step_arguments(
    guess: np.ndarray, transition: np.ndarray, step_inputs: np.ndarray, substeps: int
) -> np.ndarray:
    """Return the arguments (states, 1, inputs) of each of the M steps, ``(M, l)``. The states at a
    node are those of the guess, and the sub-steps of an interval start from them.
    """
    n_x = len(guess)
    arguments = np.empty((len(step_inputs), n_x + step_inputs.shape[1]))
    arguments[:, n_x:] = step_inputs
    arguments[::substeps, :n_x] = guess[:, :-1].T
    for s in range(1, substeps):
        arguments[s::substeps, :n_x] = arguments[s - 1 :: substeps] @ transition.T
    return arguments


def _band(Phi: np.ndarray, count: int) -> np.ndarray:
    """Return the matrix that maps x[0], x[1], ... to x[k] - Phi x[k - 1] over ``count`` steps: ``(2
    n, (count + 1) n)`` in LAPACK's storage of banded matrices.
    """
    n = len(Phi)
    band = np.zeros((2 * n, count + 1, n))
    band[0] = 1.0
    for i in range(n):
        for j in range(n):
            band[n + i - j, :, j] = -Phi[i, j]
    return np.asfortranarray(band.reshape(2 * n, -1))


def _solve_recursion(band: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Return the solutions x ``(c, count + 1, n)`` of x[k] - Phi x[k - 1] = right[k] with x[0] =
    right[0]. ``band`` is the matrix from `_band`. The right-hand sides ``right (c, count + 1, n)``
    are overwritten.
    """
    from scipy.linalg.lapack import dtbtrs

    if not len(right):
        return right
    solution, _ = dtbtrs(
        band, right.reshape(len(right), -1).T, uplo="L", diag="U", overwrite_b=True
    )
    return np.asarray(solution.T.reshape(right.shape))


def _step_matrices(
    rates: np.ndarray, by_rates: np.ndarray, dt: float, *, held: bool, euler: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix ``(nx, l)`` that maps (states, 1, inputs of a step) to the states one step
    later, and its derivatives ``(c, nx, l)`` with respect to the parameters.

    The classical Runge-Kutta step of x_dot = A x + b(t) is linear in x and in b at the beginning,
    the middle and the end of the step, with polynomials in A dt as coefficients.

    Parameters
    ----------
    rates : ``(nx, nx + 1 + nu)`` coefficients of the state rates on (states, 1, inputs).
    by_rates : ``(c, nx, nx + 1 + nu)`` derivatives of these coefficients.
    dt : step, s.
    held : inputs are constant within a step; else their values at its three stages are arguments.
    euler : an Euler step.
    """
    n_x = len(rates)
    stack = np.zeros((1 + len(by_rates), *rates.shape), dtype=complex)
    stack[:] = rates
    stack[1:] += (1j * COMPLEX_STEP) * by_rates
    A, constant, by_input = stack[:, :, :n_x], stack[:, :, n_x : n_x + 1], stack[:, :, n_x + 1 :]
    eye, Z = np.eye(n_x), A * dt
    if euler:
        transition, by_stage = eye + Z, (dt * eye, 0.0 * eye, 0.0 * eye)
    else:
        Z2 = Z @ Z
        Z3 = Z2 @ Z
        transition = eye + Z + Z2 / 2.0 + Z3 / 6.0 + Z3 @ Z / 24.0
        sixth = dt / 6.0
        by_stage = (
            sixth * (eye + Z + Z2 / 2.0 + Z3 / 4.0),
            sixth * (4.0 * eye + 2.0 * Z + Z2 / 2.0),
            sixth * eye,
        )
    all_stages = by_stage[0] + by_stage[1] + by_stage[2]
    input_gains = [all_stages] if held else list(by_stage)
    total = np.concatenate(
        [transition, all_stages @ constant, *(gain @ by_input for gain in input_gains)], axis=2
    )
    return total[0].real.copy(), total[1:].imag / COMPLEX_STEP


@lru_cache(maxsize=64)
def _has_even_steps(grid: Grid) -> bool:
    """Return whether all steps of a grid have the same size."""
    return bool(np.ptp(grid.steps) <= _EVEN_SAMPLING_TOLERANCE * grid.steps[0])


@dataclass(frozen=True, eq=False)
class _LinearFunctions:
    """State rates and outputs as linear functions of the l arguments (states, 1, inputs).

    Attributes
    ----------
    rates : ``(nx, l)`` coefficients of the state rates.
    by_rates : ``(c, nx, l)`` their derivatives with respect to the c unknown parameters.
    coefficients : ``(m, l)`` coefficients of the outputs.
    by_coefficients : ``(c, m, l)`` their derivatives.
    """

    rates: np.ndarray
    by_rates: np.ndarray
    coefficients: np.ndarray
    by_coefficients: np.ndarray

    def outputs(
        self,
        states: np.ndarray,
        by_state: np.ndarray,
        inputs: np.ndarray,
        input_changes: dict[int, np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the outputs ``(m, k)`` at k times and their derivatives ``(m, k, c)``.

        Parameters
        ----------
        states, by_state : ``(k, nx)`` states and ``(nx, k, c)`` derivatives.
        inputs : ``(k, 1 + nu)`` 1 and the inputs.
        input_changes : position of a parameter -> derivatives ``(k, nu)`` of the inputs.
        """
        n_x, m = states.shape[1], len(self.coefficients)
        jacobian = self.coefficients[:, :n_x] @ by_state.reshape(n_x, -1)
        jacobian = jacobian.reshape(m, *by_state.shape[1:])
        arguments = np.concatenate([states, inputs], axis=1)
        n_p = len(self.by_coefficients)
        if np.any(self.by_coefficients):  # zero where outputs are states
            jacobian[:, :, :n_p] += arguments @ self.by_coefficients.transpose(1, 2, 0)
        for position, changes in input_changes.items():
            jacobian[:, :, position] += self.coefficients[:, n_x + 1 :] @ changes.T
        return self.coefficients @ arguments.T, jacobian


@lru_cache(maxsize=256)
def _is_not_linear(system: System) -> bool:
    """Return whether equations depend on time or are not linear at the values of the System. Such
    equations need no test at other values.
    """
    p = system.parameters.values()
    return _coefficients(system, [float(value) for value in p], 1) is None


def _linear_functions(
    problem: RecordProblem, p: np.ndarray, increments: np.ndarray
) -> _LinearFunctions | None:
    """Return state rates and outputs as linear functions at parameters ``p``; None where they are
    not linear there.

    Derivatives with respect to the unknown parameters are those of the problem: by complex steps,
    or by forward differences with the ``increments``.
    """
    width = 1 + len(problem.free)
    columns = {position: 1 + position for position in range(len(problem.free))}
    values = changed_parameters(problem, p, columns, increments, width)
    rows = [value[:, None] if np.ndim(value) else value for value in values]
    coefficients = _coefficients(problem.system, rows, width)
    if coefficients is None:
        return None
    rates, outputs = coefficients

    def with_slopes(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        base = matrix[:, 0].real.copy()
        slopes = slopes_of(problem.exact, matrix[:, 1:], base, increments)
        return base, np.ascontiguousarray(slopes.swapaxes(0, 1))

    return _LinearFunctions(*with_slopes(rates), *with_slopes(outputs))


def _coefficients(
    system: System, rows: Sequence[Any], width: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the coefficients of the state rates and of the outputs on (states, 1, inputs), ``(nx,
    width, l)`` and ``(m, width, l)``, for parameters in ``width`` columns; None where a function
    depends on time or is not linear.

    The functions are evaluated at zero, at unit values of each state and input, and at random
    points whose sizes are between 1e-3 and 1e3. There the linear function must have their values.
    """
    points, scales = _points(len(system.states), len(system.inputs))
    n_x, time = len(system.states), WatchedTime()
    clock: Any = time
    x, u = list(points[:n_x, None]), list(points[n_x:, None])
    size = len(points)
    matrices = []
    with np.errstate(all="ignore"):
        for function in (system.f, system.h):
            try:
                values = stacked(function(clock, x, u, list(rows)), (width, points.shape[1]))
            # an error of the model is reported where it is simulated
            except (ArithmeticError, TypeError, ValueError, ModelError):
                return None
            if time.used:
                return None
            constant, units = values[..., :1], values[..., 1 : 1 + size]
            slopes = units - constant
            trial = values[..., 1 + size :]
            predicted = constant + slopes @ points[:, 1 + size :]
            differences = [(trial - predicted, np.abs(constant) + np.abs(slopes) @ scales)]
            if np.iscomplexobj(values):  # the derivatives with respect to the parameters as well
                by_parameter = np.abs(constant.imag) + np.abs(slopes.imag) @ scales
                differences.append((differences[0][0].imag, by_parameter))
            # also False where a value is not a number
            if not all(
                np.all(np.abs(d) <= _LARGEST_DIFFERENCE * terms) for d, terms in differences
            ):
                return None
            matrices.append(
                np.concatenate([slopes[..., :n_x], constant, slopes[..., n_x:]], axis=2)
            )
    return matrices[0], matrices[1]


@lru_cache(maxsize=32)
def _points(states: int, inputs: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the points ``(states + inputs, P)`` at which equations are evaluated: zero, unit
    values, random values; and the sizes of the random ones.
    """
    size, rng = states + inputs, np.random.default_rng(0)
    random = rng.choice([-1.0, 1.0], (size, _TRIAL_POINTS)) * 10.0 ** rng.uniform(
        -3.0, 3.0, (size, _TRIAL_POINTS)
    )
    return np.column_stack([np.zeros(size), np.eye(size), random]), np.abs(random)
