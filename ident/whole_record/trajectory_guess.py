"""Where a whole-record fit takes its states from before there is a trajectory: the measured ones, and the others simulated between."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from ident.estimate import LARGEST
from ident.whole_record.first_guess import known_states
from ident.whole_record.intervals import interval_ends
from ident.whole_record.linearise import join_intervals
from ident.whole_record.record_problem import RecordProblem, driven_by
from sim.maths import COMPLEX_STEP
from sim.propagation import Drive

_CLOSED = 1e-9  # of a state's size: gaps that are left where the states simulated are linear in themselves


def guess_states(problem: RecordProblem, p: Sequence[float] | np.ndarray, x0: Sequence[float] | np.ndarray) -> np.ndarray:
    """Trajectory guess ``(nx, K + 1)``: measured states from the record, the others simulated between.

    Bounded also where the model alone would run away, which a simulation from a wrong start would not be.
    """
    system, grid, record = problem.system, problem.grid, problem.record
    measured = {i: np.interp(grid.nodes, time, values) for i, (time, values) in known_states(record, system, p).items()}
    if len(measured) == len(system.states):
        return np.array([measured[i] for i in range(len(measured))])
    drive = driven_by(record, system, p, grid)
    found = simulated_at_once(problem, measured, drive, p, x0) if measured else None
    if found is None:
        found = simulated_in_turn(problem, measured, drive, p, x0)
    return np.nan_to_num(np.clip(found, -1e12, 1e12))


def simulated_at_once(
    problem: RecordProblem, measured: Mapping[int, np.ndarray], drive: Drive, p: Sequence[float] | np.ndarray, x0: Sequence[float] | np.ndarray
) -> np.ndarray | None:
    """States ``(nx, K + 1)``, those that are not measured by one banded solve over all intervals; None where they are not linear in themselves."""
    free = [i for i in range(len(x0)) if i not in measured]
    X = np.repeat(np.array(x0, dtype=float)[:, None], len(problem.grid.nodes), axis=1)
    for i, values in measured.items():
        X[i] = values
    start = np.array(x0, dtype=float)[free]
    with np.errstate(all="ignore"):  # what runs away is not finite, and simulated in turn
        for last in (False, True):
            ends = _ends(problem, X, drive, p, free)
            defects = ends[:, 0].real - X[free, 1:]
            if not np.all(np.abs(ends) < LARGEST):
                return None
            if last:
                return X if np.all(np.abs(defects) <= _CLOSED * np.max(np.abs(X[free]), axis=1, keepdims=True)) else None
            slopes = ends[:, 1:].imag / COMPLEX_STEP
            X[free] += join_intervals(slopes, np.zeros((len(free), 0, len(defects[0]))), defects, (), start - X[free, 0])[:, 0]
    return None


def _ends(problem: RecordProblem, X: np.ndarray, drive: Drive, p: Sequence[float] | np.ndarray, free: Sequence[int]) -> np.ndarray:
    """The states ``free`` at the end of each interval, from ``X`` at its beginning and from a complex step of each: ``(f, 1 + f, K)``."""
    start = np.repeat(X[:, None, :-1].astype(complex), 1 + len(free), axis=1)
    start[free, 1 + np.arange(len(free))] += 1j * COMPLEX_STEP
    return interval_ends(problem, list(start), drive, [float(v) for v in p])[list(free)]


def simulated_in_turn(
    problem: RecordProblem, measured: Mapping[int, np.ndarray], drive: Drive, p: Sequence[float] | np.ndarray, x0: Sequence[float] | np.ndarray
) -> np.ndarray:
    """States ``(nx, K + 1)``, node by node; beyond the range of numbers a state stays."""
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
                u = ([row[s] for row in stages[0]], [row[s] for row in stages[1]], [row[s] for row in stages[2]])
                with suppress(ArithmeticError, ValueError):  # beyond the range of floats the last state serves as well as any
                    x = problem.step(problem.system.f, times[s], x, u, p, steps[s])
    return out
