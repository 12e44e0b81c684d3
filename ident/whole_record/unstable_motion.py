"""Whole-record fits of a motion that grows by itself: an aircraft that only its flight control
system holds.

A mode may grow by e^15 along a record. A small change of any unknown then changes the end of the
trajectory much, and in nearly the same direction, so that Levenberg-Marquardt in all unknowns is
slow. Here the unknowns of single records (initial states, biases) are projected out of the
sensitivities to the shared parameters, and solved for again after every step. This is variable
projection (Golub and Pereyra 1973; Kaufman 1975). The fit begins with a short part at the beginning
of the records, and each further part is twice as long.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ident.estimate import Outcome
from ident.statistics.intervals import inverse_information
from ident.statistics.minimise import Descent, LocalModel, local_model, minimise, unresolved
from ident.statistics.residual_spectrum import corrected_covariance
from ident.whole_record.gauss_newton import (
    Fit,
    evaluate,
    has_converged,
    predicted_trajectories,
    with_exact_trajectory,
)
from ident.whole_record.layout import FitLayout, FitProblem
from sim.declaration.model import System
from sim.maths import complex_step_jacobian

# largest growth, in e-foldings along a record, of a motion that is fitted without parts
MOST_EFOLDINGS_AT_ONCE = 3.0
_FIRST_PART_EFOLDINGS = 3.0  # growth of the first part, in e-foldings
_PART_TOLERANCE = 0.3  # tolerance of the fits of parts before the last, in sigmas
_OWN_STEPS = 12  # most steps in the unknowns of single records, after a step in the shared ones
_OWN_GAIN = 0.1  # these steps end when one gains less log likelihood
# smallest singular value of the scaled sensitivities, over the largest, of a determined direction
_RESOLVED_SHARE = 1e-13


def fastest(layout: FitLayout, theta: np.ndarray | None = None) -> float:
    """Return the growth rate (1/s) of the fastest unstable mode without inputs, at the initial
    states of ``theta`` (None: the start); zero if all modes are stable, infinite on overflow.
    """
    theta = layout.start if theta is None else theta
    system, rate = layout.system, 0.0
    for r in range(len(layout.problems)):
        p, x0 = layout.split(theta, r)
        with np.errstate(all="ignore"):
            rates = partial(_rates_without_inputs, system, p.tolist())
            slopes = complex_step_jacobian(rates, x0.tolist())
        if not np.all(np.isfinite(slopes)):
            return np.inf
        rate = max(rate, float(np.max(np.linalg.eigvals(slopes).real, initial=0.0)))
    return rate


def _rates_without_inputs(system: System, p: list[float], x: list[Any]) -> Sequence[Any]:
    return system.f(0.0, x, [0.0] * len(system.inputs), p)


def growth(layout: FitLayout, theta: np.ndarray | None = None) -> float:
    """Return the growth of the fastest mode along the longest record, in e-foldings, at ``theta``
    (None: the start).
    """
    return fastest(layout, theta) * max(
        float(problem.record.time[-1] - problem.record.time[0]) for problem in layout.problems
    )


def fit_unstable(layout: FitLayout) -> Fit | None:
    """Return the output-error fit from ``layout.start``, over longer and longer parts of the
    records; None where a cost is not finite.

    The outcomes are those of `fit_whole_records`. The layout has no priors and at least one shared
    parameter.
    """
    exact = _with_complex_steps(layout)
    fit, iterations, remaining = None, 0, layout.settings.iterations
    for part in _growing_parts(exact):
        start = exact.start if fit is None else fit.theta
        fit = _fit_part(replace(part, start=start), remaining)
        if fit is None:
            return None
        iterations += fit.iterations
        remaining = max(layout.settings.iterations - iterations, 1)
    return None if fit is None else replace(fit, iterations=iterations)


def _with_complex_steps(layout: FitLayout) -> FitLayout:
    """Return the layout with exact derivatives."""
    problems = tuple(replace(problem, exact=True) for problem in layout.problems)
    return replace(layout, problems=problems)


def projectable(layout: FitLayout) -> bool:
    """Return whether a layout has shared parameters and no prior that couples unknowns."""
    coupled = layout.prior is not None and np.count_nonzero(layout.prior.information) > len(
        layout.prior.mean
    )
    return bool(layout.shared) and not coupled


def fit_projected(layout: FitLayout, guesses: list[np.ndarray] | None = None) -> Fit | None:
    """Return the fit as `fit_unstable` does, but of the whole records at once: the start must be
    near the optimum. Priors are allowed where the layout is `projectable`.

    ``guesses`` : starting trajectories; None takes them from the measured channels.
    """
    return _fit_part(_with_complex_steps(layout), layout.settings.iterations, guesses)


def projected_covariance(fit: Fit) -> tuple[np.ndarray, bool]:
    """Return the covariance of the shared parameters ``(s, s)``, and whether all are determined.

    It equals their block of `fit_covariance`. The other unknowns are projected out of the
    sensitivities before these are squared, since squaring loses all digits for an unstable motion.
    """
    n, projection = len(fit.layout.shared), _project(fit)
    inverse, determined = inverse_information(projection.information, fit.theta[:n])
    if not fit.layout.settings.coloured:
        return inverse, determined
    sigma = np.sqrt(fit.variance)[:, None, None]
    parts, count = [], n
    for jacobian, own, residual, problem in zip(
        projection.jacobians, projection.own, fit.residuals, fit.layout.problems, strict=True
    ):
        # The unknowns of a record fit a part of its noise, which its residuals lack.
        both = np.concatenate([jacobian, own[: residual.size].reshape(*residual.shape, -1)], axis=2)
        columns = np.concatenate([np.arange(n), count + np.arange(own.shape[1])])
        parts.append((columns, sigma * both, residual, problem.valid))
        count += own.shape[1]
    whole = np.eye(count)
    whole[:n, :n] = inverse
    return corrected_covariance(whole, parts, fit.variance)[:n, :n], determined


@dataclass(frozen=True, eq=False)
class _Projection:
    """Sensitivities to the shared parameters with the unknowns of single records projected out.

    All are in sigmas of the outputs.

    Attributes
    ----------
    jacobians : ``(m, N, s)`` projected sensitivities of each record.
    information : ``(s, s)`` of the shared parameters.
    gradient : ``(s,)`` of the log likelihood.
    own : ``(mN, o)`` of each record: orthonormal basis of the sensitivities to its own unknowns.
    back : ``(o, mN)`` of each record: map of a residual to the step of its own unknowns.
    """

    jacobians: tuple[np.ndarray, ...]
    information: np.ndarray
    gradient: np.ndarray
    own: tuple[np.ndarray, ...]
    back: tuple[np.ndarray, ...]

    def own_steps(self, fit: Fit, shared: np.ndarray) -> np.ndarray:
        """Return the step ``(n,)`` of all unknowns for the step ``shared (s,)`` of the shared ones:
        the unknowns of each record go to their optimum.
        """
        step, n = np.zeros(len(fit.theta)), len(shared)
        step[:n] = shared
        for r, back in enumerate(self.back):
            J, residual = _weighted(fit, r)
            step[fit.layout.columns(r)[n:]] = back @ (residual - J[:, :n] @ shared)
        return step


def _weighted(fit: Fit, r: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the sensitivities ``(mN, c)`` and the residual ``(mN,)`` of a record, each over the
    sigma of its output; zero where a sample is missing.

    Each prior of an unknown of this record adds one row below.
    """
    weight = np.where(fit.layout.problems[r].valid, 1.0 / np.sqrt(fit.variance)[:, None], 0.0)
    jacobian = (fit.jacobians[r] * weight[:, :, None]).reshape(weight.size, -1)
    residual = (fit.residuals[r] * weight).ravel()
    prior, columns = fit.layout.prior, fit.layout.columns(r)
    if prior is None:
        return jacobian, residual
    n, size = len(fit.layout.shared), np.sqrt(np.diag(prior.information))
    mine = [k for k, position in enumerate(prior.positions) if position in columns[n:]]
    rows = np.zeros((len(mine), len(columns)))
    rows[
        np.arange(len(mine)), [int(np.flatnonzero(columns == prior.positions[k])[0]) for k in mine]
    ] = size[mine]
    away = size[mine] * (prior.mean[mine] - fit.theta[prior.positions[mine]])
    return np.vstack([jacobian, rows]), np.concatenate([residual, away])


def _project(fit: Fit) -> _Projection:
    """Return the projection of the sensitivities of a fit."""
    n = len(fit.layout.shared)
    information, gradient, jacobians, own, back = np.zeros((n, n)), np.zeros(n), [], [], []
    prior = fit.layout.prior
    if prior is not None:
        known = np.flatnonzero(prior.positions < n)  # priors of shared parameters
        positions, block = prior.positions[known], prior.information[np.ix_(known, known)]
        information[np.ix_(positions, positions)] += block
        gradient[positions] += block @ (prior.mean[known] - fit.theta[positions])
    for r in range(len(fit.layout.problems)):
        J, residual = _weighted(fit, r)
        size = np.linalg.norm(J[:, n:], axis=0)
        size = np.where(size > 0.0, size, 1.0)
        left, values, right = np.linalg.svd(J[:, n:] / size, full_matrices=False)
        determined = values > _RESOLVED_SHARE * max(float(np.max(values, initial=0.0)), 1e-300)
        basis = left[:, determined]
        shared = J[:, :n]
        for _ in range(2):  # a second projection removes the rounding error of the first
            shared = shared - basis @ (basis.T @ shared)
        information += shared.T @ shared
        gradient += shared.T @ residual
        jacobians.append(shared[: fit.residuals[r].size].reshape(*fit.residuals[r].shape, n))
        own.append(basis)
        back.append((right[determined].T / values[determined] @ basis.T) / size[:, None])
    return _Projection(tuple(jacobians), information, gradient, tuple(own), tuple(back))


def _growing_parts(layout: FitLayout) -> Iterator[FitLayout]:
    """Yield the layout with only the beginning of each record valid, twice as long each time, and
    at last the layout of the whole records. A part in which an output has no sample is left out.
    """
    length = max(
        float(problem.record.time[-1] - problem.record.time[0]) for problem in layout.problems
    )
    span = _FIRST_PART_EFOLDINGS * length / max(growth(layout), _FIRST_PART_EFOLDINGS)
    rough = replace(layout.settings, tolerance=max(_PART_TOLERANCE, layout.settings.tolerance))
    while 0.0 < span < length:  # an infinite growth rate leaves no part
        problems = tuple(
            replace(whole, valid=whole.valid & (whole.record.time - whole.record.time[0] <= span))
            for whole in layout.problems
        )
        if all(
            np.all(part.valid.any(axis=1) == whole.valid.any(axis=1))
            for part, whole in zip(problems, layout.problems, strict=True)
        ):
            yield replace(layout, settings=rough, problems=problems)
        span *= 2.0
    yield layout


def _fit_part(layout: FitLayout, limit: int, guesses: list[np.ndarray] | None = None) -> Fit | None:
    """Return the fit by at most ``limit`` Levenberg-Marquardt steps in the shared parameters; after
    each step the unknowns of each record go to their optimum.
    """
    problem, n, settings = FitProblem(layout), len(layout.shared), layout.settings
    start_fit = None if guesses is None else evaluate(problem, layout.start, guesses)
    if start_fit is None:
        start_fit = evaluate(problem, layout.start, layout.guesses(layout.start))
    if start_fit is None:
        return None

    def model(point: tuple[Fit, _Projection]) -> LocalModel:
        fit, projection = point
        bounds = layout.low[:n], layout.high[:n]
        return local_model(projection.information, projection.gradient, fit.theta[:n], *bounds)

    def trial(
        point: tuple[Fit, _Projection], model: LocalModel, damping: float
    ) -> tuple[Fit, _Projection] | None:
        fit, projection = point
        step = projection.own_steps(fit, model.scale * model.step(damping))
        theta = np.clip(fit.theta + step, layout.low, layout.high)
        moved = evaluate(problem, theta, predicted_trajectories(fit, theta))
        if moved is None:
            return None
        moved = _with_best_own(moved)
        if not moved.cost <= fit.cost + unresolved(float(fit.counts.sum())):
            return None
        return moved, _project(moved)

    def settled(point: tuple[Fit, _Projection], model: LocalModel) -> bool:
        return has_converged(model, point[0].theta[:n], settings)

    fit = _with_best_own(start_fit)
    minimum = minimise(Descent(model, trial, settled), (fit, _project(fit)), limit)
    converged = settled(minimum.point, minimum.model)
    return replace(
        with_exact_trajectory(minimum.point[0]),
        outcome=Outcome.CONVERGED if converged else Outcome.MAX_ITERATIONS,
        iterations=minimum.steps,
    )


def _with_best_own(fit: Fit) -> Fit:
    """Return the fit with the unknowns of each record at their optimum. This takes one step for a
    linear motion and a few for any other.
    """
    for _ in range(_OWN_STEPS):
        step = _project(fit).own_steps(fit, np.zeros(len(fit.layout.shared)))
        theta = np.clip(fit.theta + step, fit.layout.low, fit.layout.high)
        moved = evaluate(fit.problem, theta, predicted_trajectories(fit, theta))
        if moved is None or moved.cost >= fit.cost:
            break
        gain, fit = fit.cost - moved.cost, moved
        if gain < _OWN_GAIN:
            break
    return fit
