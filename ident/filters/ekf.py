"""Extended Kalman filter for states and parameters, on filterpy's ExtendedKalmanFilter.

Continuous dynamics, discrete measurements (eqs. 1-16 of the simulated-flight-data paper, eqs. 12-22 of
NASA TM-101722): free parameters are states with zero rate; the mean is integrated, the covariance moves
with a fundamental matrix whose F is held over a step, the update is Joseph's. Missing samples are left
out channel by channel; sampling may be uneven. Equations that have a table (`ident.filters.table_equations`) are
filtered by it, with the same numbers to rounding.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ident.estimate import Estimate, Outcome, quiet_numerics
from ident.filters.history import HistoryKeeper, breakdown, empty_history, finished
from ident.filters.one_record import filter_one
from ident.filters.problem import FilterProblem, filter_problem, with_free
from ident.filters.table_equations import table_equations
from ident.filters.transition import Taylor, Transition, log_gaussian
from sim.declaration.system import System
from sim.maths.elementary import complex_step_jacobian, jacobian_in_one_call
from sim.propagation.integrate import Step, rk4_step
from sim.record import Record

SETTLED = 0.01  # of a standard deviation: below it a further pass changes nothing that matters
OnePass = Callable[..., Estimate]
_FEW = 6  # states and parameters below which column by column is the cheaper Jacobian


@dataclass(frozen=True)
class FilterSettings:
    """How a filter integrates.

    Attributes
    ----------
    step : integrator of the mean (``euler_step`` or ``rk4_step``).
    transition : fundamental matrix and process noise (``Taylor(2)``, ``Taylor(3)``, ``Exponential()``).
    max_step : longest sub-step, s; F is formed anew in each. The sampling interval when infinite.
    passes : at most how often the record is run through; each pass starts from the parameters that the one
        before found, with the declared prior covariance, so that F is formed nearer to the truth. It stops
        when nothing moves by more than a hundredth of a sigma. 1 is the plain filter.
    """

    step: Step = rk4_step
    transition: Transition = field(default_factory=lambda: Taylor(3))
    max_step: float = math.inf
    passes: int = 1


def run_ekf(record: Record, system: System, settings: FilterSettings | None = None, *, by: OnePass | None = None) -> Estimate:
    """Estimate states and free parameters by an extended Kalman filter.

    Parameters
    ----------
    record : measured data; outputs that the System does not know are ignored.
    system : compiled with ``online=True``; initial state, priors and noise from its declaration.
    settings : integration; RK4 mean and three Taylor terms when None.
    by : what runs a pass, ``filter_record`` when None; ``filter_by_filterpy`` is the same filter by filterpy alone, whatever the equations.

    Returns
    -------
    Estimate, its outcome ``DIVERGED`` or ``INDEFINITE`` when the filter broke down; values and covariance are then
    those of the last sound sample.

    Raises
    ------
    ModelError : no common output, an undeclared noise level or prior.
    """
    settings, one_pass = settings or FilterSettings(), by or filter_record
    problem = filter_problem(record, system, settings.max_step)
    estimate = one_pass(problem, settings)
    n_x = len(system.states)
    for done in range(1, settings.passes):
        if estimate.outcome is not Outcome.CONVERGED:
            break
        start = np.concatenate([problem.start[:n_x], estimate.values])
        again = one_pass(problem, settings, start)
        moved = np.max(np.abs(again.values - estimate.values) / np.maximum(estimate.std, np.finfo(float).tiny), initial=0.0)
        estimate = replace(again, iterations=done + 1)
        if moved < SETTLED:
            break
    return estimate


def filter_record(problem: FilterProblem, settings: FilterSettings, start: np.ndarray | None = None, about: np.ndarray | None = None) -> Estimate:
    """One pass of the filter over a prepared problem, from ``start (n,)`` when given.

    ``about (n, N)`` is a trajectory at the samples to linearise about, instead of the filter's own estimate. By the table of the
    equations where they have one; a filter that breaks down is left to filterpy's, which says how.
    """
    return filter_by_table(problem, settings, start, about) or filter_by_filterpy(problem, settings, start, about)


def filter_by_table(
    problem: FilterProblem, settings: FilterSettings, start: np.ndarray | None = None, about: np.ndarray | None = None
) -> Estimate | None:
    """``filter_record`` by the table of its equations, equal to filterpy's to rounding; None where they have none, or the filter broke down."""
    equations = table_equations(problem, settings.step, settings.transition)
    if equations is None:
        return None
    kept = empty_history(problem)
    with np.errstate(all="ignore"):
        sound = filter_one(problem, equations, problem.start if start is None else start, about, kept)
        return finished(problem, kept, "ekf") if sound else None


def filter_by_filterpy(
    problem: FilterProblem, settings: FilterSettings, start: np.ndarray | None = None, about: np.ndarray | None = None
) -> Estimate:
    """``filter_record`` by filterpy's filter, whatever the equations."""
    from filterpy.kalman import ExtendedKalmanFilter

    grid, n = problem.grid, len(problem.names)
    ekf = ExtendedKalmanFilter(dim_x=n, dim_z=len(problem.variance))
    ekf.x = (problem.start if start is None else start).reshape(n, 1).copy()
    ekf.P = problem.covariance.copy()
    stages = [[row.tolist() for row in stage] for stage in problem.drive.stages]
    feed = [row[grid.sample].tolist() for row in problem.drive.begin]
    times, steps, samples = grid.edges.tolist(), grid.steps.tolist(), grid.sample.tolist()
    keeper = HistoryKeeper(problem)

    with quiet_numerics():
        for k in range(len(problem.time)):
            Phi = np.eye(n)
            point = None if about is None or not k else about[:, k - 1].copy()
            try:
                if k:
                    for s in range(samples[k - 1], samples[k]):
                        u = ([row[s] for row in stages[0]], [row[s] for row in stages[1]], [row[s] for row in stages[2]])
                        Phi = _predict(ekf, problem, settings, times[s], u, steps[s], point) @ Phi
                keeper.predicted(k, ekf.x[:, 0], ekf.P, Phi)
                here = None if about is None else about[:, k]
                trouble = _update(ekf, problem, times[samples[k]], [row[k] for row in feed], k, keeper, here)
            except (ArithmeticError, ValueError):  # what math and linear algebra raise where arrays would turn infinite
                trouble = Outcome.DIVERGED
            if trouble is not None:
                return keeper.estimate("ekf", trouble)
            keeper.filtered(k, ekf.x[:, 0], ekf.P)
    return keeper.estimate("ekf", Outcome.CONVERGED)


def _predict(ekf: Any, problem: FilterProblem, settings: FilterSettings, t: float, u: Any, dt: float, point: np.ndarray | None) -> np.ndarray:
    """Move mean and covariance over one sub-step; returns the fundamental matrix. ``point (n,)`` to linearise at moves along."""
    system, p, free, n_x = problem.system, problem.p, problem.free, len(problem.system.states)
    at = (ekf.x[:, 0] if point is None else point).tolist()
    F = np.zeros_like(ekf.P)
    F[:n_x] = _jacobian(lambda a: system.f(t, a[:n_x], u[0], with_free(p, free, a[n_x:])), at)
    Phi, noise = settings.transition(F, problem.density, dt)
    moved = settings.step(system.f, t, at[:n_x], u, with_free(p, free, at[n_x:]), dt)
    if point is None:
        ekf.x[:n_x, 0] = moved
    else:
        away = ekf.x[:, 0] - point
        point[:n_x] = moved
        ekf.x[:, 0] = point + Phi @ away
    ekf.P = Phi @ ekf.P @ Phi.T + noise
    ekf.P = 0.5 * (ekf.P + ekf.P.T)
    return Phi


def _update(ekf: Any, problem: FilterProblem, t: float, u: list[float], k: int, keeper: HistoryKeeper, point: np.ndarray | None) -> Outcome | None:
    """filterpy's Joseph update with the channels that have a sample; how it broke down, if it did."""
    n_x = len(problem.system.states)

    def outputs(a: list[Any]) -> list[Any]:
        return problem.system.h(t, a[:n_x], u, with_free(problem.p, problem.free, a[n_x:]))

    at = (ekf.x[:, 0] if point is None else point).tolist()
    expected = np.array(outputs(at))
    rows = np.flatnonzero(problem.valid[:, k])
    slopes = _jacobian(outputs, at) if point is not None or rows.size else np.zeros((len(expected), len(at)))
    if point is not None:
        expected = expected + slopes @ (ekf.x[:, 0] - point)
    log_likelihood = nis = 0.0
    if rows.size:
        H = slopes[rows]
        ekf.update(
            problem.z[rows, k].reshape(-1, 1),
            lambda x: H,
            lambda x: expected[rows].reshape(-1, 1),
            R=np.diag(problem.variance[rows]),
        )
        ekf.P = 0.5 * (ekf.P + ekf.P.T)
        try:
            log_likelihood, nis = log_gaussian(ekf.y[:, 0], ekf.S)
        except np.linalg.LinAlgError:
            return breakdown(ekf.x, ekf.S) or Outcome.INDEFINITE
    trouble = breakdown(ekf.x, ekf.P, keeper.transition(k), expected, nis)
    if trouble is None:
        keeper.outputs(k, expected)
        if rows.size:
            keeper.innovation(k, rows, ekf.y[:, 0], ekf.S, H, log_likelihood, nis)
    return trouble


def _jacobian(function: Callable[[list[Any]], Sequence[Any]], x: list[float]) -> np.ndarray:
    return complex_step_jacobian(function, x) if len(x) < _FEW else jacobian_in_one_call(function, x)
