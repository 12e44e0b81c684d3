"""Whole-record fits of an unstable motion: an aircraft that only its flight control system
stabilises.

A mode may grow by e^15 along a record. A small change of any unknown then has a large effect at the
end of the trajectory, in nearly the same direction for all unknowns, so that Levenberg-Marquardt in
all unknowns is slow. Here the unknowns of single records (initial states, biases) are projected out
of the sensitivities to the shared parameters, and solved for again after every step. This is
variable projection (Golub and Pereyra 1973; Kaufman 1975). The first fit uses a short part at the
beginning of each record, and each further fit a part twice as long.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ident.estimate import Outcome
from ident.statistics.intervals import inverse_information
from ident.statistics.minimise import Descent, LocalModel, cost_rounding, local_model, minimise
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
# after a step in the shared parameters: most steps in the unknowns of single records; they end when
# one gains less log likelihood than the second value
_MOST_RECORD_STEPS, _NEGLIGIBLE_RECORD_GAIN = 12, 0.1
# smallest singular value of the scaled sensitivities, over the largest, of a determined direction
_RESOLVED_SHARE = 1e-13


def fastest_growth_rate(layout: FitLayout, theta: np.ndarray | None = None) -> float:
    """Return the growth rate (1/s) of the fastest unstable mode; zero if all modes are stable,
    infinite on overflow.

    The motion is linearised without inputs, at the parameters and initial states of ``theta``
    (None: the start).
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
    """Return the rates of the states ``x (nx,)`` at parameters ``p (np,)`` with all inputs zero."""
    return system.f(0.0, x, [0.0] * len(system.inputs), p)


def growth(layout: FitLayout, theta: np.ndarray | None = None) -> float:
    """Return the growth of the fastest mode along the longest record, in e-foldings, at
    ``theta`` (None: the start).
    """
    return fastest_growth_rate(layout, theta) * max(
        float(problem.record.time[-1] - problem.record.time[0]) for problem in layout.problems
    )


def fit_unstable(layout: FitLayout) -> Fit | None:
    """Return the output-error fit from ``layout.start``, by fits of longer and longer parts of the
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
    """Return the layout with derivatives by complex steps."""
    problems = tuple(replace(problem, exact=True) for problem in layout.problems)
    return replace(layout, problems=problems)


def projectable(layout: FitLayout) -> bool:
    """Return whether `fit_projected` can fit a layout: it has shared parameters, and no prior
    correlates unknowns.
    """
    coupled = layout.prior is not None and np.count_nonzero(layout.prior.information) > len(
        layout.prior.mean
    )
    return bool(layout.shared) and not coupled


def fit_projected(layout: FitLayout, guesses: list[np.ndarray] | None = None) -> Fit | None:
    """Return the fit as `fit_unstable` does, but of the whole records at once. The start must be
    near the optimum, and the layout `projectable`.

    ``guesses`` are starting trajectories ``(nx, K + 1)``; None takes them from the measured
    channels.
    """
    return _fit_part(_with_complex_steps(layout), layout.settings.iterations, guesses)


def projected_covariance(fit: Fit) -> tuple[np.ndarray, bool]:
    """Return the covariance of the shared parameters ``(s, s)``, and whether all are determined.

    The covariance equals the block of the shared parameters in `fit_covariance`. Here the other
    unknowns are projected out before the sensitivities are squared, since squaring loses all digits
    for an unstable motion.
    """
    n, projection = len(fit.layout.shared), _project(fit)
    inverse, determined = inverse_information(projection.information, fit.theta[:n])
    if not fit.layout.settings.coloured:
        return inverse, determined
    sigma = np.sqrt(fit.variance)[:, None, None]
    parts, count = [], n
    for jacobian, basis, residual, problem in zip(
        projection.jacobians, projection.bases, fit.residuals, fit.layout.problems, strict=True
    ):
        # The unknowns of a record absorb a part of its noise: the correction needs their columns.
        jacobian_and_basis = np.concatenate(
            [jacobian, basis[: residual.size].reshape(*residual.shape, -1)], axis=2
        )
        columns = np.concatenate([np.arange(n), count + np.arange(basis.shape[1])])
        parts.append((columns, sigma * jacobian_and_basis, residual, problem.valid))
        count += basis.shape[1]
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
    bases : ``(mN, o)`` of each record: orthonormal basis of the sensitivities to the unknowns of
        this record.
    step_maps : ``(o, mN)`` of each record: matrix that maps a residual to the step of the unknowns
        of this record.
    """

    jacobians: tuple[np.ndarray, ...]
    information: np.ndarray
    gradient: np.ndarray
    bases: tuple[np.ndarray, ...]
    step_maps: tuple[np.ndarray, ...]

    def step_to_optimum(self, fit: Fit, shared: np.ndarray) -> np.ndarray:
        """Return the step ``(n,)`` of all unknowns, for the step ``shared (s,)`` of the shared
        parameters. The unknowns of each record go to their optimum.
        """
        step, n = np.zeros(len(fit.theta)), len(shared)
        step[:n] = shared
        for r, step_map in enumerate(self.step_maps):
            J, residual = _weighted(fit, r)
            step[fit.layout.columns(r)[n:]] = step_map @ (residual - J[:, :n] @ shared)
        return step


def _weighted(fit: Fit, r: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the sensitivities ``(mN, c)`` and the residual ``(mN,)`` of a record, each over the
    sigma of its output; zero where a sample is missing.

    Each prior of an unknown of this record adds one row at the end.
    """
    weight = np.where(fit.layout.problems[r].valid, 1.0 / np.sqrt(fit.variance)[:, None], 0.0)
    jacobian = (fit.jacobians[r] * weight[:, :, None]).reshape(weight.size, -1)
    residual = (fit.residuals[r] * weight).ravel()
    prior, columns = fit.layout.prior, fit.layout.columns(r)
    if prior is None:
        return jacobian, residual
    n, size = len(fit.layout.shared), np.sqrt(np.diag(prior.information))
    of_record = [k for k, position in enumerate(prior.positions) if position in columns[n:]]
    rows = np.zeros((len(of_record), len(columns)))
    rows[
        np.arange(len(of_record)),
        [int(np.flatnonzero(columns == prior.positions[k])[0]) for k in of_record],
    ] = size[of_record]
    prior_residual = size[of_record] * (
        prior.mean[of_record] - fit.theta[prior.positions[of_record]]
    )
    return np.vstack([jacobian, rows]), np.concatenate([residual, prior_residual])


def _project(fit: Fit) -> _Projection:
    """Return the sensitivities of a fit with the unknowns of single records projected out."""
    n = len(fit.layout.shared)
    information, gradient = np.zeros((n, n)), np.zeros(n)
    jacobians, bases, step_maps = [], [], []
    prior = fit.layout.prior
    if prior is not None:
        of_shared = np.flatnonzero(prior.positions < n)
        positions, block = (
            prior.positions[of_shared],
            prior.information[np.ix_(of_shared, of_shared)],
        )
        information[np.ix_(positions, positions)] += block
        gradient[positions] += block @ (prior.mean[of_shared] - fit.theta[positions])
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
        bases.append(basis)
        step_maps.append((right[determined].T / values[determined] @ basis.T) / size[:, None])
    return _Projection(tuple(jacobians), information, gradient, tuple(bases), tuple(step_maps))


def _growing_parts(layout: FitLayout) -> Iterator[FitLayout]:
    """Yield layouts in which only a part at the beginning of each record is valid, twice as long
    each time, and at last the layout of the whole records.

    A part is left out where it has no sample of an output that the whole record has.
    """
    length = max(
        float(problem.record.time[-1] - problem.record.time[0]) for problem in layout.problems
    )
    span = _FIRST_PART_EFOLDINGS * length / max(growth(layout), _FIRST_PART_EFOLDINGS)
    rough = replace(layout.settings, tolerance=max(_PART_TOLERANCE, layout.settings.tolerance))
    while 0.0 < span < length:  # span is zero for an infinite growth rate
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
        step = projection.step_to_optimum(fit, model.scale * model.step(damping))
        theta = np.clip(fit.theta + step, layout.low, layout.high)
        moved = evaluate(problem, theta, predicted_trajectories(fit, theta))
        if moved is None:
            return None
        moved = _with_optimal_record_unknowns(moved)
        if not moved.cost <= fit.cost + cost_rounding(float(fit.counts.sum())):
            return None
        return moved, _project(moved)

    def settled(point: tuple[Fit, _Projection], model: LocalModel) -> bool:
        return has_converged(model, point[0].theta[:n], settings)

    fit = _with_optimal_record_unknowns(start_fit)
    minimum = minimise(Descent(model, trial, settled), (fit, _project(fit)), limit)
    converged = settled(minimum.point, minimum.model)
    return replace(
        with_exact_trajectory(minimum.point[0]),
        outcome=Outcome.CONVERGED if converged else Outcome.MAX_ITERATIONS,
        iterations=minimum.steps,
    )


def _with_optimal_record_unknowns(fit: Fit) -> Fit:
    """Return the fit with the unknowns of each record at their optimum for the given shared
    parameters. This takes one step for a linear motion and a few steps for any other.
    """
    for _ in range(_MOST_RECORD_STEPS):
        step = _project(fit).step_to_optimum(fit, np.zeros(len(fit.layout.shared)))
        theta = np.clip(fit.theta + step, fit.layout.low, fit.layout.high)
        moved = evaluate(fit.problem, theta, predicted_trajectories(fit, theta))
        if moved is None or moved.cost >= fit.cost:
            break
        gain, fit = fit.cost - moved.cost, moved
        if gain < _NEGLIGIBLE_RECORD_GAIN:
            break
    return fit
