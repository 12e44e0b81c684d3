"""Linearisation of a whole record at once: outputs and all their sensitivities about a guessed
trajectory.

All node intervals are integrated at the same time, for the base and for a small step in each state
and parameter. One banded triangular solve then joins the intervals. The guess need not obey
the equations: the same solve corrects its defects to first order. This is a Gauss-Newton step of
multiple shooting with the intermediate states condensed out (Bock 1981). One correction is exact
for equations linear in the states. At convergence the trajectory equals the sequential simulation
to rounding.

The first guess takes the states from the measured channels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ident.estimate import LARGEST_NUMBER
from ident.regression.state_histories import rate_relations, windows
from ident.whole_record.linear_record import linear_record
from ident.whole_record.record_problem import (
    RecordProblem,
    VehicleInputs,
    changed_parameters,
    inputs_with_changes,
    interval_ends,
    parameter_increments,
    sample_outputs,
    slopes_of,
    state_increments,
    vehicle_inputs,
)
from sim.declaration.model import System
from sim.maths import COMPLEX_STEP
from sim.propagation import Drive
from sim.record import Record

# number of samples of a record, divided by the half-width of the window for a slope
SLOPE_PARTS = 60
_FEWEST_SLOPE_SAMPLES = 12  # a state needs more samples than this for a slope
_MEDIAN_SAMPLES = 5  # samples of the running median that is taken before slopes
_LARGEST_GUESS = 1e12  # largest size of a state in a guessed trajectory


def known_states(
    record: Record, system: System, p: Sequence[float] | np.ndarray | None = None
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Return position -> times ``(k,)`` and values ``(k,)`` of the states that the record
    determines directly. The values are accurate enough to start a fit.

    Such a state is measured, or it is the rate of a measured state. Sensor biases at parameters
    ``p`` (None: those of the System) are subtracted. A rate is the slope of a line fitted over a
    window, after a running median.
    """
    names = system.state_names
    known: dict[int, tuple[np.ndarray, np.ndarray]] = {}
    for i, name in enumerate(names):
        if name in record.output_names:
            channel = record[name]
            known[i] = (
                record.time[channel.valid],
                channel.values[channel.valid] - _bias(system, name, p),
            )
    if len(known) in (0, len(names)):
        return known
    for source, rate in rate_relations(system, record.time).items():
        i, j = names.index(source), names.index(rate)
        if i in known and j not in known and len(known[i][0]) > _FEWEST_SLOPE_SAMPLES:
            time, values = known[i]
            padded = np.pad(values, _MEDIAN_SAMPLES // 2, mode="edge")
            shifted = [padded[k : k + len(values)] for k in range(_MEDIAN_SAMPLES)]
            smooth = np.median(shifted, axis=0)
            fit = windows(time, np.ones(len(time), dtype=bool), max(3, len(time) // SLOPE_PARTS), 1)
            slope = np.sum(fit.slope_weights * fit.gather(smooth), axis=1)
            known[j] = time[fit.usable], slope[fit.usable]
    return known


def _bias(system: System, name: str, p: Sequence[float] | np.ndarray | None) -> float:
    """Return the sensor bias of a state at parameters ``p``; zero where the System has none."""
    parameters, bias = system.parameters, f"bias_{name}"
    if bias not in parameters.names:
        return 0.0
    return parameters[bias].value if p is None else float(p[parameters.index(bias)])


# Largest defect after one correction, relative to the state, at which the rates of the simulated
# states count as linear in these states.
LARGEST_TRAJECTORY_GAP = 1e-9


def guess_states(
    problem: RecordProblem, p: Sequence[float] | np.ndarray, x0: Sequence[float] | np.ndarray
) -> np.ndarray:
    """Return a starting trajectory ``(nx, K + 1)``. Its measured states are taken from the record,
    and the others are simulated with these as inputs.

    It stays bounded even where a simulation of all states from a wrong start would diverge.
    """
    system, grid, record = problem.system, problem.grid, problem.record
    measured = {
        i: np.interp(grid.nodes, time, values)
        for i, (time, values) in known_states(record, system, p).items()
    }
    if len(measured) == len(system.states):
        return np.array([measured[i] for i in range(len(measured))])
    drive = vehicle_inputs(record, system, p, grid)
    states = simulate_by_banded_solve(problem, measured, drive, p, x0) if measured else None
    if states is None:
        states = simulate_node_by_node(problem, measured, drive, p, x0)
    return np.nan_to_num(np.clip(states, -_LARGEST_GUESS, _LARGEST_GUESS))


def simulate_by_banded_solve(
    problem: RecordProblem,
    measured: Mapping[int, np.ndarray],
    drive: Drive,
    p: Sequence[float] | np.ndarray,
    x0: Sequence[float] | np.ndarray,
) -> np.ndarray | None:
    """Return the states ``(nx, K + 1)``, with the unmeasured ones simulated by one banded solve;
    None where their rates are not linear in them, or the simulation diverges.

    ``measured`` maps the position of a measured state to its values at the nodes, ``(K + 1,)``.
    """
    free = [i for i in range(len(x0)) if i not in measured]
    X = np.repeat(np.array(x0, dtype=float)[:, None], len(problem.grid.nodes), axis=1)
    for i, values in measured.items():
        X[i] = values
    start = np.array(x0, dtype=float)[free]
    with np.errstate(all="ignore"):  # a divergent simulation is repeated node by node
        for corrected in (False, True):
            ends = _interval_ends(problem, X, drive, p, free)
            defects = ends[:, 0].real - X[free, 1:]
            if not np.all(np.abs(ends) < LARGEST_NUMBER):
                return None
            if corrected:
                size = np.max(np.abs(X[free]), axis=1, keepdims=True)
                return X if np.all(np.abs(defects) <= LARGEST_TRAJECTORY_GAP * size) else None
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
    """Return the f states at the positions ``free`` at the end of each interval, ``(f, 1 + f, K)``.

    Column 0 starts from the states ``X (nx, K + 1)`` at the beginning of the interval. Each further
    column has a complex step in one free state.
    """
    start = np.repeat(X[:, None, :-1].astype(complex), 1 + len(free), axis=1)
    start[free, 1 + np.arange(len(free))] += 1j * COMPLEX_STEP
    return interval_ends(problem, list(start), drive, [float(v) for v in p])[list(free)]


def simulate_node_by_node(
    problem: RecordProblem,
    measured: Mapping[int, np.ndarray],
    drive: Drive,
    p: Sequence[float] | np.ndarray,
    x0: Sequence[float] | np.ndarray,
) -> np.ndarray:
    """Return the states ``(nx, K + 1)``, with the unmeasured ones simulated node by node; after an
    overflow they keep their values. ``measured`` is as in `simulate_by_banded_solve`.
    """
    grid = problem.grid
    stages = [[row.tolist() for row in stage] for stage in drive.stages]
    x, states = [float(v) for v in x0], np.empty((len(x0), len(grid.nodes)))
    times, steps, p = grid.edges.tolist(), grid.steps.tolist(), [float(v) for v in p]
    for k in range(len(grid.nodes)):
        for i, values in measured.items():
            x[i] = float(values[k])
        states[:, k] = x
        if k < len(grid.nodes) - 1:
            for s in range(k * grid.substeps, (k + 1) * grid.substeps):
                u = (
                    [row[s] for row in stages[0]],
                    [row[s] for row in stages[1]],
                    [row[s] for row in stages[2]],
                )
                with suppress(ArithmeticError, ValueError):
                    x = problem.step(problem.system.f, times[s], x, u, p, steps[s])
    return states


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Defect-corrected trajectory of a record, with its outputs and sensitivities.

    Attributes
    ----------
    y : ``(m, N)`` outputs at the samples.
    jacobian : ``(m, N, c)`` derivatives of ``y`` with respect to the c unknowns: the unknown
        parameters, then the unknown initial states.
    states : ``(nx, K + 1)`` at the nodes.
    by_state : ``(nx, K + 1, c)`` derivatives of ``states`` with respect to the unknowns.
    """

    y: np.ndarray
    jacobian: np.ndarray
    states: np.ndarray
    by_state: np.ndarray


def linearise(
    problem: RecordProblem, p: np.ndarray, x0: np.ndarray, guess: np.ndarray
) -> Linearisation:
    """Return outputs and sensitivities at parameters ``p (np,)`` and initial state ``x0 (nx,)``,
    about the trajectory ``guess (nx, K + 1)``.

    All columns are integrated in one batch: column 0 is the base, then each state is changed in one
    column, then each parameter that changes the motion.
    """
    parameter_steps = parameter_increments(problem)
    inputs = inputs_with_changes(problem, p, parameter_steps)
    linear_result = linear_record(problem, p, x0, guess, inputs, parameter_steps)
    if linear_result is not None:
        return Linearisation(*linear_result)
    state_steps = state_increments(problem, guess)
    n_x, n_p, in_dynamics = len(problem.system.states), len(problem.free), list(problem.in_dynamics)
    width = 1 + n_x + len(in_dynamics)
    columns = {position: 1 + n_x + column for column, position in enumerate(in_dynamics)}
    X = np.empty((n_x, width, guess.shape[1] - 1), dtype=parameter_steps.dtype)
    X[:] = guess[:, None, :-1]
    X[np.arange(n_x), 1 + np.arange(n_x)] += state_steps[:, None]
    ends = interval_ends(
        problem,
        list(X),
        inputs.in_columns(columns, width),
        changed_parameters(problem, p, columns, parameter_steps, width),
    )
    base = ends[:, 0].real
    A = slopes_of(problem.exact, ends[:, 1 : 1 + n_x], base, state_steps)
    B = np.zeros((n_x, n_p, guess.shape[1] - 1))
    B[:, in_dynamics] = slopes_of(
        problem.exact, ends[:, 1 + n_x :], base, parameter_steps[in_dynamics]
    )
    corrections = join_intervals(A, B, base - guess[:, 1:], problem.free_initial, x0 - guess[:, 0])
    states, sensitivity = guess + corrections[:, 0], corrections[:, 1:]
    steps = np.concatenate([parameter_steps, state_steps[list(problem.free_initial)]])
    y, jacobian = _outputs(problem, p, inputs, states, sensitivity, steps)
    return Linearisation(
        y, np.ascontiguousarray(jacobian.swapaxes(1, 2)), states, sensitivity.swapaxes(1, 2)
    )


def join_intervals(
    A: np.ndarray,
    B: np.ndarray,
    defects: np.ndarray,
    free_initial: Sequence[int],
    first: np.ndarray,
) -> np.ndarray:
    """Return the corrections dx that solve dx[k+1] = A[k] dx[k] + B[k] dp + d[k] at all nodes, with
    their derivatives.

    Parameters
    ----------
    A : ``(nx, nx, K)`` transition of each interval; the second axis is the state at its beginning.
    B : ``(nx, np, K)`` derivatives of the state at the end with respect to the parameters.
    defects : ``(nx, K)`` the d[k]: end of an interval minus the guess at its end.
    free_initial : positions of the ns unknown initial states.
    first : ``(nx,)`` dx[0].

    Returns
    -------
    ``(nx, 1 + np + ns, K + 1)``: dx, then its derivatives with respect to the parameters and to the
    initial states.
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
    right = np.zeros((1 + n_p + len(free_initial), intervals + 1, n_x))
    right[0, 0] = first
    right[0, 1:] = defects.T
    right[1 : 1 + n_p, 1:] = B.transpose(1, 2, 0)
    for column, i in enumerate(free_initial):
        right[1 + n_p + column, 0, i] = 1.0
    solution, _ = dtbtrs(band, right.reshape(-1, size).T, uplo="L", diag="U", overwrite_b=True)
    return solution.T.reshape(right.shape).transpose(2, 0, 1)


def _outputs(
    problem: RecordProblem,
    p: np.ndarray,
    inputs: VehicleInputs,
    states: np.ndarray,
    by_state: np.ndarray,
    steps: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the outputs ``(m, N)`` and their derivatives ``(m, c, N)`` with respect to the c
    unknowns.

    ``by_state (nx, c, K + 1)`` are the derivatives of the ``states (nx, K + 1)``. ``steps (c,)``
    are the differentiation steps of the unknowns.
    """
    c = 1 + len(steps)
    columns = {position: 1 + position for position in range(len(problem.free))}
    rows_p, drive = (
        changed_parameters(problem, p, columns, steps, c),
        inputs.in_columns(columns, c),
    )
    X = np.empty((len(states), c, states.shape[1]), dtype=np.result_type(states, steps))
    X[:, 0] = states
    X[:, 1:] = states[:, None] + by_state * steps[:, None]
    moving_columns = [
        0,
        *(1 + position for position in problem.in_dynamics),
        *range(1 + len(problem.free), c),
    ]
    outputs = sample_outputs(problem, rows_p, list(X), drive, moving_columns)
    base = outputs[:, 0].real.copy()
    return base, slopes_of(problem.exact, outputs[:, 1:], base, steps)
