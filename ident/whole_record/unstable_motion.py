"""Whole-record fits of a motion that grows by itself: an aircraft that only its flight control
system holds.

A mode may grow by e^15 along a record. All unknowns then change the end of the trajectory
enormously and almost alike, and Levenberg-Marquardt in all unknowns is slow. Here the unknowns of
single records (initial states, biases) are projected out of the sensitivities of the shared
parameters (variable projection: Golub and Pereyra 1973; Kaufman 1975), and solved for again after
every step. Growing parts of the record are fitted in turn.
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

# smallest growth, in e-foldings along a record, that needs a fit by parts
MOST_EFOLDINGS_AT_ONCE = 3.0
_FIRST_PART_EFOLDINGS = 3.0  # e-foldings of the first part; each further part is twice as long
_PART_TOLERANCE = 0.3  # tolerance of the parts before the last, in sigmas
# most steps in a record's own unknowns, and the smallest gain of log likelihood that needs another
_OWN_STEPS, _OWN_GAIN = 12, 0.1


def fastest(layout: FitLayout, theta: np.ndarray | None = None) -> float:
    """Return the growth rate (1/s) of the fastest mode at rest, at ``theta`` (None: the start);
    zero if stable, infinite if it overflows.
    """
    theta = layout.start if theta is None else theta
    system, most = layout.system, 0.0
    for r in range(len(layout.problems)):
        p, x0 = layout.split(theta, r)
        with np.errstate(all="ignore"):
            slopes = complex_step_jacobian(partial(_rates_at_rest, system, p.tolist()), x0.tolist())
        if not np.all(np.isfinite(slopes)):
            return np.inf
        most = max(most, float(np.max(np.linalg.eigvals(slopes).real, initial=0.0)))
    return most


def _rates_at_rest(system: System, p: list[float], x: list[Any]) -> Sequence[Any]:
    return system.f(0.0, x, [0.0] * len(system.inputs), p)


def growth(layout: FitLayout, theta: np.ndarray | None = None) -> float:
    """Return the growth of the fastest mode along the longest record, in e-foldings, at ``theta``
    (None: the start).
    """
    return fastest(layout, theta) * max(
        float(problem.record.time[-1] - problem.record.time[0]) for problem in layout.problems
    )


def fit_unstable(layout: FitLayout) -> Fit | None:
    """Minimise the cost of output error from ``layout.start`` over parts of the records that grow
    to the whole; None where no cost was finite.

    Outcomes as of ``fit_whole_records``. No priors, and at least one shared parameter.
    """
    exact = replace(
        layout, problems=tuple(replace(problem, exact=True) for problem in layout.problems)
    )
    found, spent, left = None, 0, layout.settings.iterations
    for part in _growing_parts(exact):
        found = _fit_part(replace(part, start=exact.start if found is None else found.theta), left)
        if found is None:
            return None
        spent += found.iterations
        left = max(layout.settings.iterations - spent, 1)
    return None if found is None else replace(found, iterations=spent)


def projectable(layout: FitLayout) -> bool:
    """Return whether there are shared parameters, and each prior is of one unknown by itself."""
    tied = layout.prior is not None and np.count_nonzero(layout.prior.information) > len(
        layout.prior.mean
    )
    return bool(layout.shared) and not tied


def fit_projected(layout: FitLayout, guesses: list[np.ndarray] | None = None) -> Fit | None:
    """Fit as ``fit_unstable`` does, from a start near enough to fit the whole record at once;
    priors are counted, if ``projectable``.
    """
    exact = replace(
        layout, problems=tuple(replace(problem, exact=True) for problem in layout.problems)
    )
    return _fit_part(exact, layout.settings.iterations, guesses)


def projected_covariance(fit: Fit) -> tuple[np.ndarray, bool]:
    """Return the covariance of the shared parameters ``(s, s)`` with all others projected out,
    corrected for colour as the settings say; all determined?

    Equal to the block of ``fit_covariance``; the projection comes before squaring, which would lose
    all digits for unstable motion.
    """
    n, left = len(fit.layout.shared), _projected(fit)
    inverse, determined = inverse_information(left.information, fit.theta[:n])
    if not fit.layout.settings.coloured:
        return inverse, determined
    sigma = np.sqrt(fit.variance)[:, None, None]
    parts, count = [], n
    for jacobian, own, residual, problem in zip(
        left.jacobians, left.own, fit.residuals, fit.layout.problems, strict=True
    ):
        # The noise that a record's own unknowns fit is missing from its residuals.
        both = np.concatenate([jacobian, own[: residual.size].reshape(*residual.shape, -1)], axis=2)
        at = np.concatenate([np.arange(n), count + np.arange(own.shape[1])])
        parts.append((at, sigma * both, residual, problem.valid))
        count += own.shape[1]
    whole = np.eye(count)
    whole[:n, :n] = inverse
    return corrected_covariance(whole, parts, fit.variance)[:n, :n], determined


@dataclass(frozen=True, eq=False)
class _Projected:
    """Sensitivities by the shared parameters, with each record's own unknowns projected out, in
    sigmas of the outputs.

    ``jacobians (m, N, s)``; ``information (s, s)`` and ``gradient (s,)``. ``own`` of each record:
    orthonormal columns ``(mN, o)``; ``back``: the map ``(o, mN)`` to its unknowns.
    """

    jacobians: tuple[np.ndarray, ...]
    information: np.ndarray
    gradient: np.ndarray
    own: tuple[np.ndarray, ...]
    back: tuple[np.ndarray, ...]

    def own_steps(self, fit: Fit, shared: np.ndarray) -> np.ndarray:
        """Return the step ``(n,)`` of all unknowns for a step ``(s,)`` of the shared ones, with the
        best step of each record's own.
        """
        step, n = np.zeros(len(fit.theta)), len(shared)
        step[:n] = shared
        for r, back in enumerate(self.back):
            J, residual = _weighted(fit, r)
            step[fit.layout.columns(r)[n:]] = back @ (residual - J[:, :n] @ shared)
        return step


def _weighted(fit: Fit, r: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the sensitivities ``(mN, c)`` and residual ``(mN,)`` of a record over the sigma of
    each output, zero where a sample is missing.

    Priors of the record's own unknowns are added below, one row each.
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


def _projected(fit: Fit) -> _Projected:
    n = len(fit.layout.shared)
    information, gradient, jacobians, own, back = np.zeros((n, n)), np.zeros(n), [], [], []
    prior = fit.layout.prior
    if prior is not None:
        known = np.flatnonzero(prior.positions < n)
        at, block = prior.positions[known], prior.information[np.ix_(known, known)]
        information[np.ix_(at, at)] += block
        gradient[at] += block @ (prior.mean[known] - fit.theta[at])
    for r in range(len(fit.layout.problems)):
        J, residual = _weighted(fit, r)
        size = np.linalg.norm(J[:, n:], axis=0)
        size = np.where(size > 0.0, size, 1.0)
        left, values, right = np.linalg.svd(J[:, n:] / size, full_matrices=False)
        told = values > 1e-13 * max(float(np.max(values, initial=0.0)), 1e-300)
        basis = left[:, told]
        rest = J[:, :n]
        for _ in range(2):  # twice, as the sensitivities may be nearly parallel
            rest = rest - basis @ (basis.T @ rest)
        information += rest.T @ rest
        gradient += rest.T @ residual
        jacobians.append(rest[: fit.residuals[r].size].reshape(*fit.residuals[r].shape, n))
        own.append(basis)
        back.append((right[told].T / values[told] @ basis.T) / size[:, None])
    return _Projected(tuple(jacobians), information, gradient, tuple(own), tuple(back))


def _growing_parts(layout: FitLayout) -> Iterator[FitLayout]:
    """Yield layouts of the beginnings of the records, each twice as long as the one before, then of
    the whole.
    """
    length = max(
        float(problem.record.time[-1] - problem.record.time[0]) for problem in layout.problems
    )
    span = _FIRST_PART_EFOLDINGS * length / max(growth(layout), _FIRST_PART_EFOLDINGS)
    rough = replace(layout.settings, tolerance=max(_PART_TOLERANCE, layout.settings.tolerance))
    while 0.0 < span < length:  # an infinite growth rate leaves no part
        problems = tuple(
            replace(each, valid=each.valid & (each.record.time - each.record.time[0] <= span))
            for each in layout.problems
        )
        if all(
            np.all(each.valid.any(axis=1) == whole.valid.any(axis=1))
            for each, whole in zip(problems, layout.problems, strict=True)
        ):
            yield replace(layout, settings=rough, problems=problems)
        span *= 2.0
    yield layout


def _fit_part(layout: FitLayout, limit: int, guesses: list[np.ndarray] | None = None) -> Fit | None:
    """Levenberg-Marquardt in the shared parameters, with each record's own solved for after every
    step; at most ``limit`` steps.
    """
    problem, n, settings = FitProblem(layout), len(layout.shared), layout.settings
    first_fit = evaluate(
        problem, layout.start, layout.guesses(layout.start) if guesses is None else guesses
    )
    if first_fit is None and guesses is not None:
        first_fit = evaluate(problem, layout.start, layout.guesses(layout.start))
    if first_fit is None:
        return None

    def model(at: tuple[Fit, _Projected]) -> LocalModel:
        fit, left = at
        bounds = layout.low[:n], layout.high[:n]
        return local_model(left.information, left.gradient, fit.theta[:n], *bounds)

    def trial(
        at: tuple[Fit, _Projected], model: LocalModel, damping: float
    ) -> tuple[Fit, _Projected] | None:
        fit, left = at
        step = left.own_steps(fit, model.scale * model.step(damping))
        theta = np.clip(fit.theta + step, layout.low, layout.high)
        tried = evaluate(problem, theta, predicted_trajectories(fit, theta))
        tried = None if tried is None else _with_best_own(tried)
        if tried is None or not tried.cost <= fit.cost + unresolved(float(fit.counts.sum())):
            return None
        return tried, _projected(tried)

    def settled(at: tuple[Fit, _Projected], model: LocalModel) -> bool:
        return has_converged(model, at[0].theta[:n], settings)

    fit = _with_best_own(first_fit)
    found = minimise(Descent(model, trial, settled), (fit, _projected(fit)), limit)
    outcome = Outcome.CONVERGED if settled(found.point, found.model) else Outcome.MAX_ITERATIONS
    return replace(with_exact_trajectory(found.point[0]), outcome=outcome, iterations=found.steps)


def _with_best_own(fit: Fit) -> Fit:
    """Return the fit with the own unknowns of each record at their optimum: one step for linear
    motion, a few otherwise.
    """
    for _ in range(_OWN_STEPS):
        step = _projected(fit).own_steps(fit, np.zeros(len(fit.layout.shared)))
        theta = np.clip(fit.theta + step, fit.layout.low, fit.layout.high)
        moved = evaluate(fit.problem, theta, predicted_trajectories(fit, theta))
        if moved is None or moved.cost >= fit.cost:
            break
        gain, fit = fit.cost - moved.cost, moved
        if gain < _OWN_GAIN:
            break
    return fit
