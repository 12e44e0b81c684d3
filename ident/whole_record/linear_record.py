"""Fast linearisation of a record whose equations are linear and whose inputs are held.

It applies where rates and outputs are linear in (states, 1, inputs), with coefficients that are at
most products of two parameters (`ident.bilinear_table`). One step of the integrator is then a
matrix times (states, 1, inputs), and so are its derivatives with respect to the parameters. The
states and the sensitivities are two solutions of one banded system, exact to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ident.bilinear_table import constant_within_steps, system_tables
from ident.whole_record.record_problem import RecordProblem
from sim.declaration.model import System
from sim.maths import COMPLEX_STEP
from sim.propagation import Drive, Grid, euler_step, rk4_step

_ORDERS = {rk4_step: 4, euler_step: 1}  # order of each integrator
_EVEN_SAMPLING_TOLERANCE = 1e-9  # largest relative difference of even steps


# arrays y, jacobian, states and by_state of a `Linearisation`
LinearisationArrays = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def linear_record(
    problem: RecordProblem, p: np.ndarray, x0: np.ndarray, guess: np.ndarray
) -> LinearisationArrays | None:
    """Return the linearisation of linear equations at parameters ``p (np,)`` and initial state ``x0
    (nx,)``; None where it does not apply.

    The states are simulated. Their sensitivities are taken along the ``guess (nx, K + 1)``, as in
    `ident.whole_record.linearise`: a fit then also converges from a poor start, whose simulation is
    farther from the truth than the measured states. The function does not apply where the equations
    are not linear, an unknown parameter changes the inputs, a sensor has dynamics, or the steps
    differ.
    """
    system = problem.system
    if problem.drive is None or system.sensor_stages or problem.step not in _ORDERS:
        return None
    steps = _equal_steps(problem.drive, problem.grid)
    if steps is None:
        return None
    functions = _linear_functions(system, _values_of_fixed_parameters(system, p))
    if functions is None or not set(problem.free) <= set(functions.free):
        return None
    n_x, starts, substeps = len(x0), list(problem.free_initial), problem.grid.substeps
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
    if np.any(by_output):  # zero where outputs are states
        jacobian[:, :, :n_p] += sampled @ by_output.transpose(1, 2, 0)
    return output @ sampled.T, jacobian, states[::substeps].T.copy(), by_state[:, ::substeps]


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
    rates: np.ndarray, by_rates: np.ndarray, dt: float, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix ``(n_x, l)`` that maps (states, 1, inputs) to the states one step later,
    and its derivatives ``(c, n_x, l)`` with respect to the parameters.

    It has the first rows of I + A + A^2/2 + ... up to the order of the integrator. The first rows
    of the square matrix A are the rates times dt. The other rows are zero, since 1 and the inputs
    are constant within a step.

    Parameters
    ----------
    rates : ``(n_x, l)`` coefficients of the state rates on (states, 1, inputs).
    by_rates : ``(c, n_x, l)`` derivatives of these coefficients with respect to the parameters.
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
    """Return the steps of a grid; None where their sizes differ or an input changes within a
    step.
    """
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
    """State rates and outputs as r linear functions of the l arguments (states, 1, inputs).

    Attributes
    ----------
    free : positions of the P free parameters among all parameters.
    matrix : ``(r, l)`` coefficients where all free parameters are zero.
    by_parameter : ``(P, r, l)`` derivatives of the coefficients with respect to the free
        parameters, where these are zero.
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
        ``(c, r, l)`` with respect to the c parameters at the positions ``wanted`` among all.
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


def _values_of_fixed_parameters(system: System, p: np.ndarray) -> tuple[float, ...]:
    """Return the values of the parameters that are not free."""
    items = enumerate(system.parameters.items)
    return tuple(p[[index for index, item in items if not item.free]].tolist())


@lru_cache(maxsize=64)  # a fit needs the same functions many times
def _linear_functions(system: System, fixed: tuple[float, ...]) -> _LinearFunctions | None:
    """Return the state rates and outputs as linear functions; None where they are not linear.
    ``fixed`` are the values of the parameters that are not free.
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
