"""Extended Kalman filter for states and parameters, and its iterated form.

The dynamics are continuous and the measurements discrete (eqs. 1-16 of the simulated-flight-data
paper, eqs. 12-22 of NASA TM-101722). Free parameters are states with zero rate. The mean is
integrated. The covariance is propagated by a fundamental matrix with F constant over a step, and
updated in Joseph's form. Missing samples are left out channel by channel. Sampling may be uneven.
filterpy makes the prediction and the update. The matrices come from the table of the equations
(`ident.filters.one_record`) where they have one, else from complex steps.

For the declared dynamics and noise, the iterated form is the Gauss-Newton method for the most
probable trajectory and parameters (Bell, "The Iterated Kalman Smoother as a Gauss-Newton Method",
SIAM J. Optimization 4(3), 1994). Its result does not depend on a poor start. The prior keeps its
mean and weight, and only the point of linearisation changes, so that no sample counts twice.
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
    empty_buffers,
    estimate_from_buffers,
    filter_problem,
    with_free,
)
from ident.filters.smoother import SmoothedHistory, smooth
from sim.declaration.model import System
from sim.maths import complex_step_jacobian, jacobian_in_one_call
from sim.propagation import Step, rk4_step
from sim.record import Record

# ---- Extended Kalman filter for states and parameters, on filterpy's ExtendedKalmanFilter

SETTLED_SIGMAS = 0.01  # passes end when no parameter changes by more than this many sigmas
OnePass = Callable[..., Estimate]  # function that runs one pass, as `filter_by_filterpy`
_FEW_COLUMNS = 6  # with fewer states and parameters, a Jacobian is faster column by column


@dataclass(frozen=True)
class FilterSettings:
    """Integration and linearisation of a filter.

    Attributes
    ----------
    step : integrator of the mean (``euler_step`` or ``rk4_step``).
    transition : fundamental matrix and process noise (``Taylor(2)``, ``Taylor(3)``,
        ``Exponential()``).
    max_step : longest sub-step, s; infinite takes the sampling interval. F is computed again in
        each sub-step.
    passes : largest number of passes over the record; 1 is the ordinary filter. Each further pass
        starts from the parameters of the pass before, with the declared prior covariance, so that
        the linearisation is nearer to the truth. Passes end when no parameter changes by more than
        a hundredth of its sigma.
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
    record : measured data; outputs that the System does not have are ignored.
    system : model compiled with ``online=True``; its declaration has the initial state, the priors
        and the noise.
    settings : None takes the defaults, a Runge-Kutta mean and three Taylor terms.
    by : function that runs a pass; None takes `filter_by_filterpy`. ``filter_batched`` of
        ``ident.banks.bank`` gives the same to rounding.

    Returns
    -------
    Estimate. Where the filter broke down, its outcome is ``DIVERGED`` or ``INDEFINITE``, and its
    values and covariance are those of the last sample before the breakdown.

    Raises
    ------
    ModelError : where there is no common output, or a noise level or prior is not declared.
    """
    settings = settings or FilterSettings()
    problem = filter_problem(record, system, settings.max_step)
    return repeated_passes(problem, settings, by or filter_by_filterpy)


def repeated_passes(
    problem: FilterProblem, settings: FilterSettings, one_pass: OnePass
) -> Estimate:
    """Return the estimate of the last pass. Each pass starts from the parameters of the pass before
    (`FilterSettings.passes`).
    """
    estimate, n_x = one_pass(problem, settings), len(problem.system.states)
    for iteration in range(2, settings.passes + 1):
        if estimate.outcome is not Outcome.CONVERGED:
            break
        start, before = np.concatenate([problem.start[:n_x], estimate.values]), estimate
        estimate = replace(one_pass(problem, settings, start), iterations=iteration)
        if change_in_sigmas(before, estimate) < SETTLED_SIGMAS:
            break
    return estimate


def change_in_sigmas(before: Estimate, after: Estimate) -> float:
    """Return the largest change of a parameter between two passes, in sigmas of the first."""
    sigmas = np.maximum(before.std, np.finfo(float).tiny)
    return float(np.max(np.abs(after.values - before.values) / sigmas, initial=0.0))


def filter_by_table(
    problem: FilterProblem,
    settings: FilterSettings,
    start: np.ndarray | None = None,
    nominal: np.ndarray | None = None,
) -> Estimate | None:
    """Return the estimate of one pass by the table of the equations, without filterpy; None where
    the equations have no table, or the filter broke down.

    The arguments are those of `filter_by_filterpy`. The results agree to rounding.
    """
    equations = table_equations(problem, settings.step, settings.transition)
    if equations is None:
        return None
    buffers = empty_buffers(problem)
    with np.errstate(all="ignore"):
        first = problem.start if start is None else start
        definite = filter_one(problem, equations, first, nominal, buffers)
        return estimate_from_buffers(problem, buffers, "ekf") if definite else None


def filter_by_filterpy(
    problem: FilterProblem,
    settings: FilterSettings,
    start: np.ndarray | None = None,
    nominal: np.ndarray | None = None,
) -> Estimate:
    """Return the estimate of one pass over a record by the ``ExtendedKalmanFilter`` of filterpy.

    Parameters
    ----------
    problem : record and System.
    settings : integration and linearisation.
    start : ``(n,)`` mean before the first sample; None takes the declared one.
    nominal : ``(n, N)`` trajectory at the samples about which the filter is linearised; None takes
        the estimate of the filter.

    Returns
    -------
    Estimate with its history. Its outcome shows whether and how the filter broke down.
    """
    equations = table_equations(problem, settings.step, settings.transition)
    if equations is None:
        return filter_by_complex_step(problem, settings, start, nominal)
    return _run_filterpy(problem, _by_table(problem, equations), start, nominal)


def filter_by_complex_step(
    problem: FilterProblem,
    settings: FilterSettings,
    start: np.ndarray | None = None,
    nominal: np.ndarray | None = None,
) -> Estimate:
    """Return the estimate of `filter_by_filterpy` with all Jacobians by complex steps, without
    tables of bilinear equations. It is the reference for the tables.
    """
    return _run_filterpy(problem, _by_complex_step(problem, settings), start, nominal)


def _run_filterpy(
    problem: FilterProblem,
    equations: _Linearised,
    start: np.ndarray | None,
    nominal: np.ndarray | None,
) -> Estimate:
    """Return the estimate of one pass by filterpy with the given equations."""
    # imported here, since it loads scipy.stats
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
                    point = None if nominal is None else nominal[:, k - 1].copy()
                    for s in range(samples[k - 1], samples[k]):
                        _predict(ekf, equations, s, point)
                        Phi = ekf.F @ Phi
                keeper.store_prediction(k, ekf.x[:, 0], ekf.P, Phi)
                failure = _update(
                    ekf, problem, equations, k, keeper, None if nominal is None else nominal[:, k]
                )
            # functions of scalars raise an error where arrays would become infinite
            except (ArithmeticError, ValueError):
                failure = Outcome.DIVERGED
            if failure is not None:
                return keeper.estimate("ekf", failure)
            keeper.store_update(k, ekf.x[:, 0], ekf.P)
    return keeper.estimate("ekf", Outcome.CONVERGED)


@dataclass(frozen=True, eq=False)
class _Linearised:
    """Equations of one record in the form that filterpy needs.

    Attributes
    ----------
    propagate : function of a sub-step ``s`` and a point ``(n,)``. It returns the states ``(n_x,)``
        after the sub-step, the fundamental matrix ``(n, n)`` and Q_k ``(n, n)``.
    observe : function of a sample ``k`` and a point ``(n,)``. It returns the outputs ``(m,)`` and
        their Jacobian ``(m, n)``.
    """

    propagate: Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
    observe: Callable[[int, np.ndarray], tuple[np.ndarray, np.ndarray]]


def _by_table(problem: FilterProblem, equations: FilterEquations) -> _Linearised:
    """Return the linearised equations from their table, in the form that filterpy needs."""
    n, n_x, m = len(problem.names), len(problem.system.states), len(problem.variance)
    point, slopes, zero, identity = equations.point, equations.G[:, :n], np.zeros((n, n)), np.eye(n)

    def propagate(s: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        point[:] = at
        Phi = identity.copy()
        noise = equations.propagate(s, Phi[:n_x])
        return point[:n_x].copy(), Phi, zero if noise is None else noise

    def observe(k: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        point[:] = at
        expected = np.empty(m)
        equations.observe(k, expected)
        return expected, slopes.copy()

    return _Linearised(propagate, observe)


def _by_complex_step(problem: FilterProblem, settings: FilterSettings) -> _Linearised:
    """Return the linearised equations with Jacobians by complex steps."""
    system, p, free = problem.system, problem.p, problem.free
    n, n_x = len(problem.names), len(problem.system.states)
    grid = problem.grid
    times, steps, samples = grid.edges.tolist(), grid.steps.tolist(), grid.sample.tolist()
    begin, middle, end = ([row.tolist() for row in stage] for stage in problem.drive.stages)
    direct_inputs = [row[grid.sample].tolist() for row in problem.drive.begin]

    def propagate(s: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        point, t, dt, F = at.tolist(), times[s], steps[s], np.zeros((n, n))
        u = ([row[s] for row in begin], [row[s] for row in middle], [row[s] for row in end])
        F[:n_x] = _jacobian(
            lambda a: system.f(t, a[:n_x], u[0], with_free(p, free, a[n_x:])), point
        )
        Phi, noise = settings.transition(F, problem.density, dt)
        moved = settings.step(system.f, t, point[:n_x], u, with_free(p, free, point[n_x:]), dt)
        return np.array(moved, dtype=float), Phi, noise

    def observe(k: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        t, u, point = times[samples[k]], [row[k] for row in direct_inputs], at.tolist()

        def outputs(a: list[Any]) -> list[Any]:
            return system.h(t, a[:n_x], u, with_free(p, free, a[n_x:]))

        return np.array(outputs(point), dtype=float), _jacobian(outputs, point)

    return _Linearised(propagate, observe)


def _predict(ekf: Any, equations: _Linearised, s: int, point: np.ndarray | None) -> None:
    """Predict over the sub-step ``s`` with filterpy, with the mean integrated in its
    ``predict_x``.

    ``point (n,)`` is the point of linearisation, which is propagated in place; None takes the mean.
    """
    before = ekf.x[:, 0]
    moved, ekf.F, ekf.Q = equations.propagate(s, before if point is None else point)
    n_x = len(moved)
    if point is None:
        mean = before.copy()
        mean[:n_x] = moved
    else:
        deviation = before - point
        point[:n_x] = moved
        mean = point + ekf.F @ deviation

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
    """Update by filterpy (Joseph's form). Return the outcome of a breakdown, else None."""
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
    failure = breakdown(ekf.x, ekf.P, keeper.transition(k), expected, nis)
    if failure is None:
        keeper.store_outputs(k, expected)
        if rows.size:
            keeper.store_innovation(k, rows, ekf.y[:, 0], ekf.S, H, log_likelihood, nis)
    return failure


def _jacobian(function: Callable[[list[Any]], Sequence[Any]], x: list[float]) -> np.ndarray:
    """Return the Jacobian of a function at the point ``x`` by complex steps."""
    if len(x) < _FEW_COLUMNS:
        return complex_step_jacobian(function, x)
    return jacobian_in_one_call(function, x)


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
    """Estimate states and free parameters by passes of a filter, each linearised about the smoothed
    trajectory of the pass before, until they converge.

    Parameters
    ----------
    record, system, settings : as for ``run_ekf``; ``settings.passes`` is not used.
    iterations : largest number of passes. They end when no parameter changes by more than a
        hundredth of its sigma.
    first : the same model with another start and narrower priors, for the first pass only. The
        second pass is linearised about the smoothed trajectory of this pass; None takes
        ``system``.
    by : function that runs a pass, as for ``run_ekf``.

    Returns
    -------
    Estimate of the last pass. Its outcome is ``MAX_ITERATIONS`` where the passes have not
    converged. Where a pass broke down, values and sigmas are those of the pass before, and the
    outcome is that of the broken pass.

    Raises
    ------
    ModelError : as for ``run_ekf``.
    """
    settings = settings or FilterSettings()
    problem = filter_problem(record, system, settings.max_step)
    first_problem = problem if first is None else filter_problem(record, first, settings.max_step)
    return iterated_to_convergence(
        by(first_problem, settings),
        lambda smoothed: by(problem, settings, nominal=smoothed.mean),
        iterations,
    )


def iterated_to_convergence(
    estimate: Estimate, further: Callable[[SmoothedHistory], Estimate], iterations: int
) -> Estimate:
    """Return the estimate after repeated passes, each linearised about the smoothed trajectory of
    the pass before, until no parameter changes by more than a hundredth of its sigma.

    Parameters
    ----------
    estimate : estimate of the first pass.
    further : function that runs a pass about a smoothed trajectory.
    iterations : largest number of passes.
    """
    if estimate.outcome is not Outcome.CONVERGED:
        return estimate
    for iteration in range(2, iterations + 1):
        assert estimate.history is not None
        last = further(smooth(estimate.history))
        if last.outcome is not Outcome.CONVERGED:
            message = (
                f"pass {iteration} broke down {last.message}: values and sigmas are those of the "
                "pass before it, which had not converged"
            )
            return replace(estimate, outcome=last.outcome, message=message)
        change = change_in_sigmas(estimate, last)
        estimate = replace(last, iterations=iteration)
        if change < SETTLED_SIGMAS:
            return estimate
    return replace(estimate, outcome=Outcome.MAX_ITERATIONS)
