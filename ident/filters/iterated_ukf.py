"""Iterated unscented filter: each pass linearises by sigma points of the smoothed result of the one before.

Posterior linearisation (Garcia-Fernandez, Svensson and Sarkka, "Iterated Posterior Linearization Smoother", IEEE Transactions on Automatic
Control 62(4), 2017). The plain filter's points reach over the prior, as far as the product of a wide zero and a wide derivative bends, and what
that bends away is never given back; these reach over what the whole record leaves open. The prior keeps its mean and weight, so no datum
counts twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.estimate import Estimate, Outcome, quiet_numerics
from ident.filters.ekf import FilterSettings
from ident.filters.history import HistoryKeeper, breakdown
from ident.filters.iterated_ekf import settled
from ident.filters.problem import FilterProblem, filter_problem, with_free
from ident.filters.smoother import SmoothedHistory
from ident.filters.transition import log_gaussian
from ident.filters.ukf import filter_by_points, roots
from sim.declaration.model import System
from sim.maths import complex_step_jacobian
from sim.record import Record

ROUNDING = float(np.sqrt(np.finfo(float).eps))  # half the digits: of a difference of covariances the rest may be rounding
CENTRE = 2.0  # weight of the central point in a covariance, beta of the scaled points


def run_iterated_ukf(
    record: Record, system: System, settings: FilterSettings | None = None, iterations: int = 15, first: System | None = None
) -> Estimate:
    """Estimate states and free parameters by an unscented filter that is linearised anew about its own smoothed result.

    Parameters
    ----------
    record, system, settings : as for ``run_ukf``; ``settings.passes`` is not used.
    iterations : limit of passes; it stops when no parameter moves by more than a hundredth of its sigma.
    first : the same system with narrower priors, for the first pass alone, whose points reach over the prior.

    Returns
    -------
    Estimate after the last pass; its outcome is ``MAX_ITERATIONS`` when it had not settled. Where a pass broke down, the
    estimate is that of the pass before it, with the outcome of the one that broke down.

    Raises
    ------
    ModelError : as for ``run_ekf``.
    """
    settings = settings or FilterSettings()
    problem = filter_problem(record, system, settings.max_step)
    begun = filter_by_points(problem if first is None else filter_problem(record, first, settings.max_step), settings)
    return settled(begun, lambda done: _pass_about(problem, settings, done), iterations)


@dataclass(frozen=True, eq=False)
class _Cloud:
    """Sigma points ``(2n + 1, n)`` of a mean and a covariance, the mean first, and what turns half differences of their images into slopes."""

    points: np.ndarray
    back: np.ndarray

    @property
    def mean(self) -> np.ndarray:
        return self.points[0]


def _cloud(about: SmoothedHistory, k: int, reach: np.ndarray) -> _Cloud:
    """Points about sample ``k`` of a smoothed result, out to its covariance.

    Where the smoother's difference of covariances is rounding alone, ``reach (n,)`` are the standard
    deviations and directions without variance get ``ROUNDING`` of one: without points that lie apart
    no slope along them would be seen, and the record would say nothing of them.
    """
    mean, P = about.mean[:, k], about.covariance[k]
    std = np.sqrt(np.maximum(np.diagonal(P), 0.0))
    scale = np.where(std < ROUNDING * reach, reach, std)
    inverse = np.divide(1.0, scale, out=np.zeros_like(scale), where=scale > 0.0)
    values, vectors = np.linalg.eigh(P * np.outer(inverse, inverse))
    values = np.maximum(values, ROUNDING * values[-1])
    root, back = roots(len(mean) * (vectors * values) @ vectors.T * np.outer(scale, scale))
    return _Cloud(np.concatenate([mean[None], mean + root, mean - root]), back)


def _pass_about(problem: FilterProblem, settings: FilterSettings, about: SmoothedHistory) -> Estimate:
    """One pass of the Kalman filter of the functions linearised over ``about``."""
    keeper, grid = HistoryKeeper(problem), problem.grid
    x, P = problem.start.astype(float), problem.covariance.copy()
    reach = np.sqrt(np.maximum(np.diagonal(about.covariance[-1]), 0.0))
    cloud = _cloud(about, 0, reach)
    with quiet_numerics():
        for k in range(len(problem.time)):
            G = np.eye(len(x))
            try:
                if k:
                    moved, G, noise = _moved(problem, settings, cloud, grid.sample[k - 1], grid.sample[k])
                    x, P = moved + G @ (x - cloud.mean), _symmetric(G @ P @ G.T + noise)
                    cloud = _cloud(about, k, reach)
                keeper.predicted(k, x, P, G)
                x, P, trouble = _updated(problem, keeper, k, x, P, cloud)
            except (ArithmeticError, ValueError):
                trouble = Outcome.DIVERGED
            if trouble is not None:
                return keeper.estimate("ukf", trouble)
            keeper.filtered(k, x, P)
    return keeper.estimate("ukf", Outcome.CONVERGED)


def _moved(problem: FilterProblem, settings: FilterSettings, cloud: _Cloud, first: int, last: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """From one sample to the next, the sub-steps ``first`` to ``last``: the mean's image, its slopes, and noise and curvature together."""
    system, n_x, points = problem.system, len(problem.system.states), cloud.points
    noise = np.zeros_like(cloud.back)
    for s in range(first, last):
        t, dt = float(problem.grid.edges[s]), float(problem.grid.steps[s])
        u: Any = tuple([float(row[s]) for row in stage] for stage in problem.drive.stages)
        if np.any(problem.density):
            Phi, added = settings.transition(_slopes(problem, points[0], t, u[0]), problem.density, dt)
            noise = Phi @ noise @ Phi.T + added
        columns = list(points.T)
        rows = settings.step(system.f, t, columns[:n_x], u, with_free(problem.p, problem.free, columns[n_x:]), dt)
        points = np.array([*(np.broadcast_to(row, len(points)) for row in rows), *columns[n_x:]]).T
    moved, G, curved = _linearised(points, cloud)
    return moved, G, noise + curved


def _slopes(problem: FilterProblem, at: np.ndarray, t: float, u: list[float]) -> np.ndarray:
    """F ``(n, n)`` at a point, for the process noise alone."""
    n_x, F = len(problem.system.states), np.zeros((len(at), len(at)))
    F[:n_x] = complex_step_jacobian(lambda a: problem.system.f(t, a[:n_x], u, with_free(problem.p, problem.free, a[n_x:])), at.tolist())
    return F


def _updated(
    problem: FilterProblem, keeper: HistoryKeeper, k: int, x: np.ndarray, P: np.ndarray, cloud: _Cloud
) -> tuple[np.ndarray, np.ndarray, Outcome | None]:
    """Mean and covariance with the channels that have a sample (Joseph's form), and how the update broke down, if it did."""
    system, n_x, at = problem.system, len(problem.system.states), problem.grid.sample[k]
    columns, u = list(cloud.points.T), [float(row[at]) for row in problem.drive.begin]
    y: Any = system.h(float(problem.grid.edges[at]), columns[:n_x], u, with_free(problem.p, problem.free, columns[n_x:]))
    middle, slope, curved = _linearised(np.array([np.broadcast_to(row, len(cloud.points)) for row in y]).T, cloud)
    expected = middle + slope @ (x - cloud.mean)
    rows, log_likelihood, nis = np.flatnonzero(problem.valid[:, k]), 0.0, 0.0
    if rows.size:
        H, R = slope[rows], np.diag(problem.variance[rows]) + curved[np.ix_(rows, rows)]
        S, innovation = H @ P @ H.T + R, problem.z[rows, k] - expected[rows]
        try:
            log_likelihood, nis = log_gaussian(innovation, S)
        except np.linalg.LinAlgError:
            return x, P, breakdown(x, S) or Outcome.INDEFINITE
        K = np.linalg.solve(S, H @ P).T
        kept = np.eye(len(x)) - K @ H
        x, P = x + K @ innovation, _symmetric(kept @ P @ kept.T + K @ R @ K.T)
    trouble = breakdown(x, P, keeper.transition(k), expected, nis)
    if trouble is None:
        keeper.outputs(k, expected)
        if rows.size:
            keeper.innovation(k, rows, innovation, S, H, log_likelihood, nis)
    return x, P, trouble


def _linearised(images: np.ndarray, cloud: _Cloud) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Statistical linear regression of the points' images ``(2n + 1, rows)``: mean, slopes, and the covariance of what is no straight line.

    With even and odd parts of each pair apart nothing cancels, and the covariance is semi-definite.
    """
    n = len(cloud.back)
    plus, minus = images[1 : n + 1], images[n + 1 :]
    even = 0.5 * (plus + minus)
    mean = even.mean(axis=0)
    off, bent = images[0] - mean, even - mean
    return mean, (cloud.back @ (0.5 * (plus - minus))).T, CENTRE * np.outer(off, off) + bent.T @ bent / n


def _symmetric(P: np.ndarray) -> np.ndarray:
    return 0.5 * (P + P.T)
