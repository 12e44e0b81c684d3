"""Extended Kalman filter for states and parameters, and its iterated form.

Continuous dynamics, discrete measurements (eqs. 1-16 of the simulated-flight-data paper, eqs. 12-22
of NASA TM-101722): free parameters are states with zero rate; the mean is integrated, the
covariance moves with a fundamental matrix whose F is held over a step, the update is Joseph's.
Missing samples are left out channel by channel; sampling may be uneven. Prediction and update are
filterpy's; the matrices come from the table of the equations (`ident.filters.one_record`) where
they have one, else from complex steps.

For the dynamics and noise declared, the iterated form is the Gauss-Newton method for the most
probable trajectory and parameters (Bell, "The Iterated Kalman Smoother as a Gauss-Newton Method",
SIAM J. Optimization 4(3), 1994). The result no longer depends on a poor start: the prior keeps its
mean and weight, only the point of linearisation moves, so no datum counts twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ident.estimate import Estimate, Outcome, quiet_numerics
from ident.filters.one_record import (
    FilterEquations,
    Taylor,
    Transition,
    filter_one,
    log_gaussian,
    table_equations,
)
from ident.filters.problem import (
    FilterProblem,
    HistoryKeeper,
    breakdown,
    empty_history,
    filter_problem,
    finished,
    with_free,
)
from ident.filters.smoother import SmoothedHistory, smooth
from sim.declaration.model import System
from sim.maths import complex_step_jacobian, jacobian_in_one_call
from sim.propagation import Step, rk4_step
from sim.record import Record

# ---- Extended Kalman filter for states and parameters, on filterpy's ExtendedKalmanFilter

SETTLED_SIGMAS = 0.01  # change in sigmas below which no further pass is needed
OnePass = Callable[..., Estimate]
_FEW_COLUMNS = 6  # states and parameters below which the Jacobian by columns is cheaper


@dataclass(frozen=True)
class FilterSettings:
    """Integration and linearisation of a filter.

    Attributes
    ----------
    step : integrator of the mean (``euler_step`` or ``rk4_step``).
    transition : fundamental matrix and process noise (``Taylor(2)``, ``Taylor(3)``,
        ``Exponential()``).
    max_step : longest sub-step, s; F is formed anew in each. The sampling interval when infinite.
    passes : at most how often the record is run through; each pass starts from the parameters that
        the one before found, with the declared prior covariance, so that F is formed nearer to the
        truth. It stops when nothing moves by more than a hundredth of a sigma. 1 is the plain
        filter.
    """

    step: Step = rk4_step
    transition: Transition = field(default_factory=lambda: Taylor(3))
    max_step: float = math.inf
    passes: int = 1


def run_ekf(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    *,
    by: OnePass | None = None,
) -> Estimate:
    """Estimate states and free parameters by an extended Kalman filter.

    Parameters
    ----------
    record : measured data; outputs that the System does not know are ignored.
    system : compiled with ``online=True``; initial state, priors and noise from its declaration.
    settings : integration; RK4 mean and three Taylor terms when None.
    by : function that runs a pass; ``filter_by_filterpy`` when None. ``filter_batched`` of
        ``ident.banks.bank`` is equal to rounding.

    Returns
    -------
    Estimate, its outcome ``DIVERGED`` or ``INDEFINITE`` when the filter broke down; values and
    covariance are then those of the last sound sample.

    Raises
    ------
    ModelError : no common output, an undeclared noise level or prior.
    """
    settings, one_pass = settings or FilterSettings(), by or filter_by_filterpy
    problem = filter_problem(record, system, settings.max_step)
    estimate = one_pass(problem, settings)
    n_x = len(system.states)
    for done in range(1, settings.passes):
        if estimate.outcome is not Outcome.CONVERGED:
            break
        start = np.concatenate([problem.start[:n_x], estimate.values])
        again = one_pass(problem, settings, start)
        moved = np.max(
            np.abs(again.values - estimate.values) / np.maximum(estimate.std, np.finfo(float).tiny),
            initial=0.0,
        )
        estimate = replace(again, iterations=done + 1)
        if moved < SETTLED_SIGMAS:
            break
    return estimate


def filter_by_table(
    problem: FilterProblem,
    settings: FilterSettings,
    start: np.ndarray | None = None,
    about: np.ndarray | None = None,
) -> Estimate | None:
    """Return one pass by the table of the equations, without filterpy; None where they have no
    table, or the filter broke down.

    Arguments as for ``filter_by_filterpy``, which it equals to rounding.
    """
    equations = table_equations(problem, settings.step, settings.transition)
    if equations is None:
        return None
    buffers = empty_history(problem)
    with np.errstate(all="ignore"):
        sound = filter_one(
            problem, equations, problem.start if start is None else start, about, buffers
        )
        return finished(problem, buffers, "ekf") if sound else None


def filter_by_filterpy(
    problem: FilterProblem,
    settings: FilterSettings,
    start: np.ndarray | None = None,
    about: np.ndarray | None = None,
) -> Estimate:
    """Return one pass over a prepared problem by filterpy's ``ExtendedKalmanFilter``: every
    ``predict`` and every ``update`` is filterpy's.

    Parameters
    ----------
    problem, settings : record and System brought together, and how to integrate.
    start : ``(n,)`` mean before the first sample; the declared one when None.
    about : ``(n, N)`` trajectory at the samples to linearise about, instead of the filter's own
        estimate.

    Returns
    -------
    Estimate with its history; its outcome says how the filter broke down, if it did.
    """
    return _filtered(problem, _linearised(problem, settings), start, about)


def filter_by_complex_step(
    problem: FilterProblem,
    settings: FilterSettings,
    start: np.ndarray | None = None,
    about: np.ndarray | None = None,
) -> Estimate:
    """Run ``filter_by_filterpy`` with matrices from complex steps also for bilinear equations: the
    reference of the tables.
    """
    return _filtered(problem, _by_complex_step(problem, settings), start, about)


def _filtered(
    problem: FilterProblem,
    equations: _Linearised,
    start: np.ndarray | None,
    about: np.ndarray | None,
) -> Estimate:
    # its import loads scipy.stats: only filters pay for that
    from filterpy.kalman import ExtendedKalmanFilter

    n, m = len(problem.names), len(problem.variance)
    ekf = ExtendedKalmanFilter(dim_x=n, dim_z=m)
    ekf.x = (problem.start if start is None else start).reshape(n, 1).copy()
    ekf.P, ekf.R = problem.covariance.copy(), np.diag(problem.variance)
    samples, keeper = problem.grid.sample.tolist(), HistoryKeeper(problem)
    with quiet_numerics():
        for k in range(len(problem.time)):
            Phi = np.eye(n)
            try:
                if k:
                    point = None if about is None else about[:, k - 1].copy()
                    for s in range(samples[k - 1], samples[k]):
                        _predict(ekf, equations, s, point)
                        Phi = ekf.F @ Phi
                keeper.predicted(k, ekf.x[:, 0], ekf.P, Phi)
                trouble = _update(
                    ekf, problem, equations, k, keeper, None if about is None else about[:, k]
                )
            # errors of scalar functions where arrays would become infinite
            except (ArithmeticError, ValueError):
                trouble = Outcome.DIVERGED
            if trouble is not None:
                return keeper.estimate("ekf", trouble)
            keeper.filtered(k, ekf.x[:, 0], ekf.P)
    return keeper.estimate("ekf", Outcome.CONVERGED)


@dataclass(frozen=True, eq=False)
class _Linearised:
    """Equations of one record in the form that filterpy needs.

    Attributes
    ----------
    move : from sub-step ``s`` and a point ``(n,)``: the states ``(n_x,)`` after it, the fundamental
        matrix and Q_k ``(n, n)``.
    observe : from sample ``k`` and a point ``(n,)``: outputs ``(m,)`` and their slopes ``(m, n)``.
    """

    move: Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
    observe: Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]]


def _linearised(problem: FilterProblem, settings: FilterSettings) -> _Linearised:
    """Equations by their table if they are bilinear, else by complex steps."""
    equations = table_equations(problem, settings.step, settings.transition)
    return (
        _by_complex_step(problem, settings) if equations is None else _by_table(problem, equations)
    )


def _by_table(problem: FilterProblem, equations: FilterEquations) -> _Linearised:
    n, n_x, m = len(problem.names), len(problem.system.states), len(problem.variance)
    point, slopes, none, one = equations.point, equations.G[:, :n], np.zeros((n, n)), np.eye(n)

    def move(s: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        point[:] = at
        Phi = one.copy()
        noise = equations.move(s, Phi[:n_x])
        return point[:n_x].copy(), Phi, none if noise is None else noise

    def observe(k: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        point[:] = at
        expected = np.empty(m)
        equations.observe(k, expected)
        return expected, slopes.copy()

    return _Linearised(move, observe)


def _by_complex_step(problem: FilterProblem, settings: FilterSettings) -> _Linearised:
    system, p, free = problem.system, problem.p, problem.free
    n, n_x = len(problem.names), len(problem.system.states)
    grid = problem.grid
    times, steps, samples = grid.edges.tolist(), grid.steps.tolist(), grid.sample.tolist()
    begin, middle, end = ([row.tolist() for row in stage] for stage in problem.drive.stages)
    feed = [row[grid.sample].tolist() for row in problem.drive.begin]

    def move(s: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        point, t, dt, F = at.tolist(), times[s], steps[s], np.zeros((n, n))
        u = ([row[s] for row in begin], [row[s] for row in middle], [row[s] for row in end])
        F[:n_x] = _jacobian(
            lambda a: system.f(t, a[:n_x], u[0], with_free(p, free, a[n_x:])), point
        )
        Phi, noise = settings.transition(F, problem.density, dt)
        moved = settings.step(system.f, t, point[:n_x], u, with_free(p, free, point[n_x:]), dt)
        return np.array(moved, dtype=float), Phi, noise

    def observe(k: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        t, u, point = times[samples[k]], [row[k] for row in feed], at.tolist()

        def outputs(a: list[Any]) -> list[Any]:
            return system.h(t, a[:n_x], u, with_free(p, free, a[n_x:]))

        return np.array(outputs(point), dtype=float), _jacobian(outputs, point)

    return _Linearised(move, observe)


def _predict(ekf: Any, equations: _Linearised, s: int, point: np.ndarray | None) -> None:
    """Prediction over one sub-step with filterpy, the mean integrated in its ``predict_x``; ``point
    (n,)`` to linearise at, which is moved over the sub-step as well.
    """
    before = ekf.x[:, 0]
    moved, ekf.F, ekf.Q = equations.move(s, before if point is None else point)
    n_x = len(moved)
    if point is None:
        mean = before.copy()
        mean[:n_x] = moved
    else:
        away = before - point
        point[:n_x] = moved
        mean = point + ekf.F @ away

    def predict_x(u: object = 0) -> None:
        ekf.x = mean.reshape(-1, 1)

    ekf.predict_x = predict_x
    ekf.predict()
    ekf.P = 0.5 * (ekf.P + ekf.P.T)


def _update(
    ekf: Any,
    problem: FilterProblem,
    equations: _Linearised,
    k: int,
    keeper: HistoryKeeper,
    point: np.ndarray | None,
) -> Outcome | None:
    """Update (Joseph's form) with filterpy, of channels that have a sample; returns how it
    diverged, if so.
    """
    at = ekf.x[:, 0] if point is None else point
    expected, slopes = equations.observe(k, at)
    rows = np.flatnonzero(problem.valid[:, k])
    if point is not None:
        expected = expected + slopes @ (ekf.x[:, 0] - point)
    log_likelihood = nis = 0.0
    if rows.size:
        H, y = slopes[rows], expected[rows].reshape(-1, 1)
        ekf.update(
            problem.z[rows, k].reshape(-1, 1),
            lambda x: H,
            lambda x: y,
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
    return (
        complex_step_jacobian(function, x)
        if len(x) < _FEW_COLUMNS
        else jacobian_in_one_call(function, x)
    )


# ---- Iterated extended Kalman filter


def run_iterated_ekf(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    iterations: int = 15,
    *,
    first: System | None = None,
    by: OnePass = filter_by_filterpy,
) -> Estimate:
    """Estimate states and free parameters by a filter linearised about its own smoothed trajectory,
    iterated to convergence.

    Parameters
    ----------
    record, system, settings : as for ``run_ekf``; ``settings.passes`` is not used.
    iterations : limit of passes; it stops when no parameter moves by more than a hundredth of its
        sigma.
    first : the same system with another start and narrower priors, for the first pass alone: it
        gives the first point to linearise at.
    by : function that runs a pass, as for ``run_ekf``.

    Returns
    -------
    Estimate after the last pass; its outcome is ``MAX_ITERATIONS`` when it had not settled. Where a
    pass broke down, the estimate is that of the pass before it, with the outcome of the one that
    broke down.

    Raises
    ------
    ModelError : as for ``run_ekf``.
    """
    settings = settings or FilterSettings()
    problem = filter_problem(record, system, settings.max_step)
    first_pass = by(
        problem if first is None else filter_problem(record, first, settings.max_step), settings
    )
    return iterated_to_convergence(
        first_pass, lambda done: by(problem, settings, about=done.mean), iterations
    )


def iterated_to_convergence(
    estimate: Estimate, further: Callable[[SmoothedHistory], Estimate], iterations: int
) -> Estimate:
    """Repeat passes about the last smoothed trajectory until no parameter changes by more than a
    hundredth of its sigma.
    """
    if estimate.outcome is not Outcome.CONVERGED:
        return estimate
    for done in range(2, iterations + 1):
        assert estimate.history is not None
        again = further(smooth(estimate.history))
        if again.outcome is not Outcome.CONVERGED:
            message = (
                f"pass {done} broke down {again.message}: values and sigmas are those of the pass "
                "before it, which had not settled"
            )
            return replace(estimate, outcome=again.outcome, message=message)
        moved = np.max(
            np.abs(again.values - estimate.values) / np.maximum(estimate.std, np.finfo(float).tiny),
            initial=0.0,
        )
        estimate = replace(again, iterations=done)
        if moved < SETTLED_SIGMAS:
            return estimate
    return replace(estimate, outcome=Outcome.MAX_ITERATIONS)
