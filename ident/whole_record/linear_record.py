"""A record of linear equations under held inputs, simulated with all its sensitivities by matrices that are the same in every step.

Where the rates are linear in the states with coefficients that are at most products of two parameters, one table holds them all
(`ident.bilinear_table`). A step of the integrator is then one matrix on (states, 1, inputs), and its derivatives by the parameters are
matrices too: simulation and sensitivities are two solutions of one banded recursion, exact to rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ident.bilinear_table import held_within_steps, system_tables
from ident.whole_record.record_problem import RecordProblem
from sim.declaration.model import System
from sim.maths import COMPLEX_STEP
from sim.propagation import Drive, Grid, euler_step, rk4_step

_ORDERS = {rk4_step: 4, euler_step: 1}
_EVEN = 1e-9  # of a step: what time stamps may differ by for all steps to be one


Line = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def linear_record(problem: RecordProblem, p: np.ndarray, x0: np.ndarray, guess: np.ndarray) -> Line | None:
    """``y``, ``jacobian``, ``states`` and ``by_state`` of a ``Linearisation`` at parameters ``p (np,)`` and initial state ``x0``.

    States are simulated; their sensitivities are formed along the ``guess (nx, K + 1)`` as in `ident.whole_record.linearise`, which is
    what brings a fit from a poor start home: measured states are nearer to the truth than its simulation.
    None where the equations are not of this kind, a parameter moves the inputs, a sensor has a memory, or steps are not even.
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

    # Rows of time: what a step is fed with is (states, 1, inputs), of which every right-hand side of the recursion is a product.
    band = _band(moves[:, :n_x], count)
    right = np.empty((1, count + 1, n_x))
    right[0, 0] = x0
    np.matmul(step.fed, moves[:, n_x:].T, out=right[0, 1:])
    states = _solved(band, right)[0]
    right = np.zeros((c, count + 1, n_x))
    np.matmul(_along(guess, moves, step.fed, substeps), by_moves.transpose(0, 2, 1), out=right[:n_p, 1:])
    right[n_p + np.arange(len(starts)), 0, starts] = 1.0
    by_state = np.ascontiguousarray(_solved(band, right).transpose(2, 1, 0))

    at = step.samples
    seen = np.concatenate([states[at], step.seen], axis=1)
    jacobian = (reading[:, :n_x] @ by_state[:, at].reshape(n_x, -1)).reshape(m, len(seen), c)
    if np.any(by_reading):  # outputs that are states know no parameter
        jacobian[:, :, :n_p] += seen @ by_reading.transpose(1, 2, 0)
    return reading @ seen.T, jacobian, states[::substeps].T.copy(), by_state[:, ::substeps]


def _along(guess: np.ndarray, moves: np.ndarray, fed: np.ndarray, substeps: int) -> np.ndarray:
    """What each step is fed with, (states, 1, inputs) ``(M, l)``, its states from the guess at the node before."""
    n_x = len(guess)
    out = np.empty((len(fed), n_x + fed.shape[1]))
    out[:, n_x:] = fed
    out[::substeps, :n_x] = guess[:, :-1].T
    for s in range(1, substeps):
        out[s::substeps, :n_x] = out[s - 1 :: substeps] @ moves.T
    return out


def _band(Phi: np.ndarray, count: int) -> np.ndarray:
    """The matrix of x[k] - Phi x[k - 1] over so many steps, ``(2 n, (count + 1) n)`` in diagonals as LAPACK wants it."""
    n = len(Phi)
    band = np.zeros((2 * n, count + 1, n))
    band[0] = 1.0
    for i in range(n):
        for j in range(n):
            band[n + i - j, :, j] = -Phi[i, j]
    return np.asfortranarray(band.reshape(2 * n, -1))


def _solved(band: np.ndarray, right: np.ndarray) -> np.ndarray:
    """x of x[k] - Phi x[k - 1] = right[k], x[0] = right[0], for every right-hand side ``(c, count + 1, n)``, which is overwritten."""
    from scipy.linalg.lapack import dtbtrs

    if not len(right):
        return right
    solution, _ = dtbtrs(band, right.reshape(len(right), -1).T, uplo="L", diag="U", overwrite_b=True)
    return np.asarray(solution.T.reshape(right.shape))


def _step_matrices(rates: np.ndarray, by_rates: np.ndarray, dt: float, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Of a step of so many terms its matrix ``(n_x, l)`` on (states, 1, inputs) and the derivatives ``(c, n_x, l)``, from those of the rates.

    I + A + A^2/2 + ... of the square matrix with the rates in its first rows and zeros below, which holds 1 and the inputs.
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
class _Held:
    """Steps that are all of one size ``dt`` (s), what they are fed with, ``(M, 1 + n_u)``: 1 and the inputs; ``seen (N, 1 + n_u)`` at the
    ``samples`` among the edges."""

    dt: float
    fed: np.ndarray
    seen: np.ndarray
    samples: slice | np.ndarray


@lru_cache(maxsize=16)
def _held(drive: Drive, grid: Grid) -> _Held | None:
    if not held_within_steps(drive) or np.ptp(grid.steps) > _EVEN * grid.steps[0]:
        return None
    at = grid.sample
    every = slice(None, None, grid.substeps) if len(at) == len(grid.nodes) else at
    fed, seen = ([np.ones(count), *rows] for count, rows in ((len(grid.steps), drive.stages[0]), (len(at), [row[at] for row in drive.begin])))
    return _Held(float(grid.steps.mean()), np.stack(fed, axis=1), np.stack(seen, axis=1), every)


@dataclass(frozen=True, eq=False)
class _Line:
    """Rates and outputs, linear in (states, 1, inputs): ``r`` values of ``l`` entries, ``P`` parameters that are ``free`` (positions among all).

    ``matrix (r, l)`` at zero, ``by_parameter (P, r, l)``, and of the column of the 1, at ``one``, second derivatives ``(P, r, P)``, None without.
    """

    free: tuple[int, ...]
    matrix: np.ndarray
    by_parameter: np.ndarray
    squares: np.ndarray | None
    one: int

    def at(self, p: np.ndarray, wanted: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """The matrix at all parameters ``p (np,)`` and its derivatives ``(c, r, l)`` by the ``wanted`` of the free ones, positions among all."""
        theta, order = p[list(self.free)], [self.free.index(index) for index in wanted]
        matrix = self.matrix + (theta @ self.by_parameter.reshape(len(theta), self.matrix.size)).reshape(self.matrix.shape)
        derivatives = self.by_parameter[order]
        if self.squares is not None:
            bent = self.squares @ theta
            matrix[:, self.one] += 0.5 * theta @ bent
            derivatives[:, :, self.one] += bent[order]
        return matrix, derivatives


def _held_values(system: System, p: np.ndarray) -> tuple[float, ...]:
    return tuple(p[[index for index, item in enumerate(system.parameters.items) if not item.free]].tolist())


@lru_cache(maxsize=64)  # a fit asks for the same one again and again
def _line(system: System, held: tuple[float, ...]) -> _Line | None:
    values, left = system.parameters.values().tolist(), iter(held)
    for index, item in enumerate(system.parameters.items):
        values[index] = values[index] if item.free else next(left)
    with np.errstate(all="ignore"):
        found = system_tables(system, values)
    if found is None:
        return None
    n_x, n, width = len(system.states), found[0].n, len(found[0].table)
    # Halves of the slopes by every entry of (1, states, parameters, inputs), what is linear whole.
    halves = np.concatenate([table.table.reshape(width, -1, n + width)[:, :, n:] for table in found], axis=1)
    slopes = 2.0 * halves
    slopes[0] = halves[0]
    parameters, order = slice(1 + n_x, 1 + n), [*range(1, 1 + n_x), 0, *range(1 + n, width)]
    by_parameter = slopes[parameters][:, :, order]
    by_parameter[:, :, n_x] = slopes[0, :, parameters].T
    squares = slopes[parameters][:, :, parameters]
    free = tuple(system.parameters.index(name) for name in system.parameters.free_names)
    return _Line(free, slopes[0][:, order], by_parameter, squares if np.any(squares) else None, n_x)
