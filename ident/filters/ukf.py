"""Unscented Kalman filter for states and parameters, and its iterated form.

filterpy computes the update and the weights. The square root of the covariance is unique and exists
for singular covariances too: a state that is known exactly has no variance. The System is called
once for all sigma points. Channels without a sample are left out of the update.

The points are sqrt(n) sigmas from the mean (alpha = 1, kappa = 0). The central point has the weight
beta = 2 in the covariance, which represents a part of the fourth moments of a Gaussian. No weight
is negative, so that the predicted covariance is semi-definite and no digits cancel (alpha = 0.001
loses six digits).

The iterated filter is the posterior linearisation of Garcia-Fernandez, Svensson and Sarkka
("Iterated Posterior Linearization Smoother", IEEE Transactions on Automatic Control 62(4), 2017).
The points of the ordinary filter cover the prior. Where the prior is wide, products of unknowns are
strongly nonlinear over it, and the estimate is biased. The points of the iterated filter cover the
posterior of the whole record. The prior keeps its mean and weight, so that no sample counts twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.estimate import Estimate, Outcome, quiet_numerics
from ident.filters.ekf import FilterSettings, iterated_to_convergence, repeated_passes
from ident.filters.one_record import log_gaussian
from ident.filters.problem import FilterProblem, HistoryKeeper, breakdown, filter_problem, with_free
from ident.filters.smoother import SmoothedHistory
from sim.declaration.model import System
from sim.maths import complex_step_jacobian
from sim.record import Record

# ---- Unscented Kalman filter for states and parameters, on filterpy's UnscentedKalmanFilter

ALPHA = 1.0  # spread of the sigma points (Wan and van der Merwe)
BETA = 2.0  # further weight of the central point in the covariance, 2 for a Gaussian
KAPPA = 0.0  # secondary scaling of the sigma points
# eigenvalues of a correlation matrix below this share of the largest one are rounding
ROUNDING_EIGENVALUE_SHARE = 1e-14


def run_ukf(record: Record, system: System, settings: FilterSettings | None = None) -> Estimate:
    """Estimate states and free parameters by an unscented Kalman filter.

    Parameters
    ----------
    record, system : as for ``run_ekf``.
    settings : ``step``, ``max_step`` and ``passes`` as for ``run_ekf``; ``transition`` is used for
        the process noise only.

    Returns
    -------
    Estimate as ``run_ekf`` returns it. ``history.transition[k]`` is the statistical linearisation G
    of the interval: in each sub-step C = P G^T, with P the covariance before and C the
    cross-covariance of the states before and after. ``history.sensitivity`` is the statistical
    linearisation H of the outputs: the cross-covariance of state and outputs is P H^T. With these
    matrices the fixed-interval smoother applies to both filters.

    Raises
    ------
    ModelError : as for ``run_ekf``.
    """
    settings = settings or FilterSettings()
    problem = filter_problem(record, system, settings.max_step)
    return repeated_passes(problem, settings, filter_by_points)


def square_root(P: np.ndarray) -> np.ndarray:
    """Return ``U (n, n)`` with ``U^T U = P`` for a symmetric semi-definite ``P``. Its columns are
    zero for entries without variance.

    U is the symmetric root of the correlation matrix times the standard deviations. This root is
    unique and continuous in P. Points along eigenvectors would not be unique: eigenvectors of equal
    eigenvalues depend on rounding.
    """
    return roots(P)[0]


def statistical_slopes(P: np.ndarray, half_differences: np.ndarray) -> np.ndarray:
    """Return the statistical linearisation ``L (rows, n)`` of a function: ``P L^T`` is the
    cross-covariance of its argument and its values.

    ``half_differences (n, rows)`` are half the differences between the values at the paired points
    ``x + U_i`` and ``x - U_i``, with ``U = square_root(P)``. Division by the root, not by P, keeps
    the digits of a nearly singular P.
    """
    return (roots(P)[1] @ half_differences).T


def roots(P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ``square_root(P)`` and its inverse, ``(n, n)`` each. The inverse is zero for entries
    without variance.
    """
    scale = np.sqrt(np.maximum(np.diag(P), 0.0))
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0)
    values, vectors = np.linalg.eigh(P * np.outer(inverse, inverse))
    values = np.where(values > ROUNDING_EIGENVALUE_SHARE * values[-1], values, 0.0)
    reciprocal = np.divide(1.0, np.sqrt(values), out=np.zeros_like(values), where=values > 0)
    root = (vectors * np.sqrt(values)) @ vectors.T * scale
    return root, inverse[:, None] * ((vectors * reciprocal) @ vectors.T)


def filter_by_points(
    problem: FilterProblem, settings: FilterSettings, start: np.ndarray | None = None
) -> Estimate:
    """Return the estimate of one pass of the filter from the mean ``start (n,)``; None takes the
    declared mean.
    """
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    n, grid, drive = len(problem.names), problem.grid, problem.drive
    points = MerweScaledSigmaPoints(n, ALPHA, BETA, KAPPA, sqrt_method=square_root)
    ukf = UnscentedKalmanFilter(
        dim_x=n, dim_z=len(problem.variance), dt=0.0, hx=None, fx=None, points=points
    )
    ukf.x = (problem.start if start is None else start).astype(float)
    ukf.P = problem.covariance.copy()
    keeper = HistoryKeeper(problem)
    with quiet_numerics():
        for k in range(len(problem.time)):
            G = np.eye(n)
            try:
                if k:
                    for s in range(grid.sample[k - 1], grid.sample[k]):
                        u = tuple([float(row[s]) for row in stage] for stage in drive.stages)
                        t, dt = float(grid.edges[s]), float(grid.steps[s])
                        G = _predict(ukf, problem, settings, t, u, dt) @ G
                keeper.store_prediction(k, ukf.x, ukf.P, G)
                failure = _update(ukf, problem, k, keeper)
            except (ArithmeticError, ValueError):
                failure = Outcome.DIVERGED
            if failure is not None:
                return keeper.estimate("ukf", failure)
            keeper.store_update(k, ukf.x, ukf.P)
    return keeper.estimate("ukf", Outcome.CONVERGED)


def _predict(
    ukf: Any, problem: FilterProblem, settings: FilterSettings, t: float, u: Any, dt: float
) -> np.ndarray:
    """Move the sigma points over one sub-step; return its statistical linearisation ``(n, n)``."""
    from filterpy.kalman import unscented_transform

    system, n_x = problem.system, len(problem.system.states)
    before, mean, P = ukf.points_fn.sigma_points(ukf.x, ukf.P), ukf.x, ukf.P
    columns = list(before.T)
    moved = settings.step(
        system.f, t, columns[:n_x], u, with_free(problem.p, problem.free, columns[n_x:]), dt
    )
    after = before.copy()
    for i, row in enumerate(moved):
        after[:, i] = row
    noise = np.zeros_like(P)
    if np.any(problem.density):
        F = _slopes(problem, mean, t, u[0])
        noise = settings.transition(F, problem.density, dt)[1]
    ukf.x, ukf.P = unscented_transform(after, ukf.Wm, ukf.Wc, noise)
    ukf.P = 0.5 * (ukf.P + ukf.P.T)
    return statistical_slopes(len(P) * P, _central_differences(after))


def _update(ukf: Any, problem: FilterProblem, k: int, keeper: HistoryKeeper) -> Outcome | None:
    """Update by filterpy. Return the outcome of a filter that broke down, else None."""
    n_x, at = len(problem.system.states), problem.grid.sample[k]
    ukf.sigmas_f = ukf.points_fn.sigma_points(ukf.x, ukf.P)
    columns = list(ukf.sigmas_f.T)
    u = [float(row[at]) for row in problem.drive.begin]
    y = problem.system.h(
        float(problem.grid.edges[at]),
        columns[:n_x],
        u,
        with_free(problem.p, problem.free, columns[n_x:]),
    )
    outputs = np.array([np.broadcast_to(row, len(ukf.sigmas_f)) for row in y])
    expected = outputs @ ukf.Wm
    rows = np.flatnonzero(problem.valid[:, k])
    log_likelihood = nis = 0.0
    if rows.size:
        point, before = iter(outputs[rows].T), ukf.P
        ukf.update(problem.z[rows, k], R=np.diag(problem.variance[rows]), hx=lambda x: next(point))
        ukf.P = 0.5 * (ukf.P + ukf.P.T)
        try:
            log_likelihood, nis = log_gaussian(ukf.y, ukf.S)
        except np.linalg.LinAlgError:
            return breakdown(ukf.x, ukf.S) or Outcome.INDEFINITE
    failure = breakdown(ukf.x, ukf.P, keeper.transition(k), expected, nis)
    if failure is None:
        keeper.store_outputs(k, expected)
        if rows.size:
            H = statistical_slopes(len(before) * before, _central_differences(outputs[rows].T))
            keeper.store_innovation(k, rows, ukf.y, ukf.S, H, log_likelihood, nis)
    return failure


def _central_differences(rows: np.ndarray) -> np.ndarray:
    """Return half the differences ``(n, ...)`` between the values ``rows (2n + 1, ...)`` at paired
    sigma points. The points are a root of ``n P`` away from the mean.
    """
    n = len(rows) // 2
    return 0.5 * (rows[1 : n + 1] - rows[n + 1 :])


# ---- Iterated unscented filter

# relative rounding error of a difference of covariances, in which half the digits may cancel
ROUNDING = float(np.sqrt(np.finfo(float).eps))
# weight of the central point in a covariance (beta of the scaled points)
CENTRAL_COVARIANCE_WEIGHT = 2.0


def run_iterated_ukf(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    iterations: int = 15,
    first: System | None = None,
) -> Estimate:
    """Estimate states and free parameters by passes of an unscented filter, each linearised about
    the smoothed result of the pass before, until they converge.

    Arguments, results and errors are those of ``run_iterated_ekf``. The points of the first pass
    cover the priors of ``first``.
    """
    settings = settings or FilterSettings()
    problem = filter_problem(record, system, settings.max_step)
    first_problem = problem if first is None else filter_problem(record, first, settings.max_step)
    return iterated_to_convergence(
        filter_by_points(first_problem, settings),
        lambda smoothed: _filter_about(problem, settings, smoothed),
        iterations,
    )


@dataclass(frozen=True, eq=False)
class _SigmaPoints:
    """Sigma points of a mean and a covariance.

    Attributes
    ----------
    points : ``(2n + 1, n)``, the mean first.
    slope_map : ``(n, n)`` matrix that turns half the differences of images of paired points into
        slopes.
    """

    points: np.ndarray
    slope_map: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        return self.points[0]


def _sigma_points(nominal: SmoothedHistory, k: int, fallback_std: np.ndarray) -> _SigmaPoints:
    """Return the sigma points of the mean and covariance at sample ``k`` of a smoothed result.

    Slopes need distinct points along every direction. Where a smoothed standard deviation is
    rounding, ``fallback_std (n,)`` is used in its place. A direction without variance gets the
    share ``ROUNDING`` of the largest eigenvalue.
    """
    mean, P = nominal.mean[:, k], nominal.covariance[k]
    std = np.sqrt(np.maximum(np.diagonal(P), 0.0))
    scale = np.where(std < ROUNDING * fallback_std, fallback_std, std)
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
    values, vectors = np.linalg.eigh(P * np.outer(inverse, inverse))
    values = np.maximum(values, ROUNDING * values[-1])
    root, slope_map = roots(len(mean) * (vectors * values) @ vectors.T * np.outer(scale, scale))
    return _SigmaPoints(np.concatenate([mean[None], mean + root, mean - root]), slope_map)


def _filter_about(
    problem: FilterProblem, settings: FilterSettings, nominal: SmoothedHistory
) -> Estimate:
    """Return the estimate of one pass, linearised statistically over the result ``nominal``."""
    keeper, grid = HistoryKeeper(problem), problem.grid
    x, P = problem.start.astype(float), problem.covariance.copy()
    fallback_std = np.sqrt(np.maximum(np.diagonal(nominal.covariance[-1]), 0.0))
    sigma_points = _sigma_points(nominal, 0, fallback_std)
    with quiet_numerics():
        for k in range(len(problem.time)):
            G = np.eye(len(x))
            try:
                if k:
                    moved, G, noise = _predicted(
                        problem, settings, sigma_points, grid.sample[k - 1], grid.sample[k]
                    )
                    x, P = moved + G @ (x - sigma_points.mean), _symmetric(G @ P @ G.T + noise)
                    sigma_points = _sigma_points(nominal, k, fallback_std)
                keeper.store_prediction(k, x, P, G)
                x, P, failure = _updated(problem, keeper, k, x, P, sigma_points)
            except (ArithmeticError, ValueError):
                failure = Outcome.DIVERGED
            if failure is not None:
                return keeper.estimate("ukf", failure)
            keeper.store_update(k, x, P)
    return keeper.estimate("ukf", Outcome.CONVERGED)


def _predicted(
    problem: FilterProblem,
    settings: FilterSettings,
    sigma_points: _SigmaPoints,
    first: int,
    last: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the prediction over the sub-steps ``first`` to ``last``: the mean ``(n,)``, the slopes
    ``(n, n)``, and the covariance ``(n, n)`` of process noise and linearisation error.
    """
    system, n_x, points = problem.system, len(problem.system.states), sigma_points.points
    noise = np.zeros_like(sigma_points.slope_map)
    for s in range(first, last):
        t, dt = float(problem.grid.edges[s]), float(problem.grid.steps[s])
        u: Any = tuple([float(row[s]) for row in stage] for stage in problem.drive.stages)
        if np.any(problem.density):
            Phi, added = settings.transition(
                _slopes(problem, points[0], t, u[0]), problem.density, dt
            )
            noise = Phi @ noise @ Phi.T + added
        columns = list(points.T)
        rows = settings.step(
            system.f, t, columns[:n_x], u, with_free(problem.p, problem.free, columns[n_x:]), dt
        )
        points = np.array([*(np.broadcast_to(row, len(points)) for row in rows), *columns[n_x:]]).T
    moved, G, nonlinear_covariance = _linearised(points, sigma_points)
    return moved, G, noise + nonlinear_covariance


def _slopes(problem: FilterProblem, at: np.ndarray, t: float, u: list[float]) -> np.ndarray:
    """Return F ``(n, n)`` at the point ``at (n,)``, for the process noise."""
    n_x, F = len(problem.system.states), np.zeros((len(at), len(at)))
    F[:n_x] = complex_step_jacobian(
        lambda a: problem.system.f(t, a[:n_x], u, with_free(problem.p, problem.free, a[n_x:])),
        at.tolist(),
    )
    return F


def _updated(
    problem: FilterProblem,
    keeper: HistoryKeeper,
    k: int,
    x: np.ndarray,
    P: np.ndarray,
    sigma_points: _SigmaPoints,
) -> tuple[np.ndarray, np.ndarray, Outcome | None]:
    """Return the mean and the covariance after the update with the channels that have a sample
    (Joseph's form), and the outcome of a filter that broke down, else None.
    """
    system, n_x, at = problem.system, len(problem.system.states), problem.grid.sample[k]
    columns, u = list(sigma_points.points.T), [float(row[at]) for row in problem.drive.begin]
    y: Any = system.h(
        float(problem.grid.edges[at]),
        columns[:n_x],
        u,
        with_free(problem.p, problem.free, columns[n_x:]),
    )
    middle, slope, nonlinear_covariance = _linearised(
        np.array([np.broadcast_to(row, len(sigma_points.points)) for row in y]).T, sigma_points
    )
    expected = middle + slope @ (x - sigma_points.mean)
    rows, log_likelihood, nis = np.flatnonzero(problem.valid[:, k]), 0.0, 0.0
    if rows.size:
        H, R = (
            slope[rows],
            np.diag(problem.variance[rows]) + nonlinear_covariance[np.ix_(rows, rows)],
        )
        S, innovation = H @ P @ H.T + R, problem.z[rows, k] - expected[rows]
        try:
            log_likelihood, nis = log_gaussian(innovation, S)
        except np.linalg.LinAlgError:
            return x, P, breakdown(x, S) or Outcome.INDEFINITE
        K = np.linalg.solve(S, H @ P).T
        I_KH = np.eye(len(x)) - K @ H
        x, P = x + K @ innovation, _symmetric(I_KH @ P @ I_KH.T + K @ R @ K.T)
    failure = breakdown(x, P, keeper.transition(k), expected, nis)
    if failure is None:
        keeper.store_outputs(k, expected)
        if rows.size:
            keeper.store_innovation(k, rows, innovation, S, H, log_likelihood, nis)
    return x, P, failure


def _linearised(
    images: np.ndarray, sigma_points: _SigmaPoints
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the statistical linear regression of the values ``images (2n + 1, rows)`` at the
    sigma points: the mean, the slopes, and the covariance of the nonlinear part.

    The even and the odd part of each pair are separated, so that no digits cancel and the
    covariance is semi-definite.
    """
    n = len(sigma_points.slope_map)
    plus, minus = images[1 : n + 1], images[n + 1 :]
    even = 0.5 * (plus + minus)
    mean = even.mean(axis=0)
    off, nonlinear = images[0] - mean, even - mean
    return (
        mean,
        (sigma_points.slope_map @ (0.5 * (plus - minus))).T,
        CENTRAL_COVARIANCE_WEIGHT * np.outer(off, off) + nonlinear.T @ nonlinear / n,
    )


def _symmetric(P: np.ndarray) -> np.ndarray:
    return 0.5 * (P + P.T)
