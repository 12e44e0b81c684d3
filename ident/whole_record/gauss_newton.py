"""Levenberg-Marquardt over whole records, and refits with one fixed parameter.

The cost is minus the log likelihood of the noise model, plus the term of the prior. By default the
noise variance of each output is concentrated out, which leaves 0.5 sum_i N_i ln(sigma_i^2). The
cost after a step is computed from the defect-corrected residuals, see
`ident.whole_record.linearise`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from ident.estimate import LARGEST_NUMBER, Outcome
from ident.statistics import profile_likelihood
from ident.statistics.intervals import add_normal_equations, inverse_information
from ident.statistics.minimise import (
    LEAST_DAMPING,
    Descent,
    LocalModel,
    cost_rounding,
    local_model,
    minimise,
)
from ident.statistics.profile_likelihood import ProfileInterval
from ident.whole_record.layout import ROUNDING_SHARE, FitLayout, FitProblem, FitSettings
from ident.whole_record.linearise import Linearisation, linearise
from ident.whole_record.noise_model import NoiseModel, WeightedResiduals

# ---- Levenberg-Marquardt over whole records, for all maximum-likelihood fits

# number of recent steps whose changes of gradient correct the information matrix
_REMEMBERED_STEPS = 4
# largest gain of log likelihood that is negligible (0.04 sigmas along a poorly known direction)
_NEGLIGIBLE_GAIN = 1e-3
# a step is near the optimum if it gains less log likelihood than this; only such steps correct the
# information matrix by their changes of gradient
_CURVATURE_GAIN = 1.0
# smallest measured curvature along a step that is used, over that of the information matrix
_LEAST_CURVATURE = 0.1
# progress along a valley is slow where a step gains less than this share of the gain that the
# quadratic model predicts for the undamped step
_CREEPING_GAIN_SHARE = 0.1
# finite-difference step that measures the curvature of a valley, over the undamped step
_CURVATURE_STEP_SHARE = 0.1
# shares of a curved step, tried in turn until one gains
_CURVED_STEP_SHARES = (1.0, 0.5, 0.25, 0.125)
# most successive trials without progress before the fit of a model comparison ends
_MOST_TRIALS_WITHOUT_GAIN = 3
# largest difference of guess and corrected trajectory at the end of a fit, over the largest state:
# of an ordinary fit, and of a fit for a model comparison
_CLOSED_GAP, _COMPARISON_GAP = 1e-13, 1e-6
_MOST_CORRECTIONS = 3  # most corrections of a trajectory at the end of a fit


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit at one point of its iteration, or at the end.

    Attributes
    ----------
    problem : the problem of the fit.
    theta : ``(n,)`` unknowns of the layout, then those of the noise model.
    guesses : trajectory ``(nx, K + 1)`` of each record about which it was linearised.
    linearisations : outputs and sensitivities of each record.
    weighted : whitened residuals and sensitivities.
    counts : ``(m,)`` numbers of valid samples of each output in all records.
    cost : minus the log likelihood and the term of the prior, without constants.
    outcome : result of the iteration; ``MAX_ITERATIONS`` for a fit that was evaluated only.
    iterations : number of steps that were made.
    """

    problem: FitProblem
    theta: np.ndarray
    guesses: tuple[np.ndarray, ...]
    linearisations: tuple[Linearisation, ...]
    weighted: WeightedResiduals
    counts: np.ndarray
    cost: float
    outcome: Outcome = Outcome.MAX_ITERATIONS
    iterations: int = 0

    @property
    def layout(self) -> FitLayout:
        """Layout of the unknowns over the records."""
        return self.problem.layout

    @property
    def noise_model(self) -> NoiseModel:
        """The noise model."""
        return self.problem.noise_model

    @property
    def trajectories(self) -> list[np.ndarray]:
        """Corrected trajectories ``(nx, K + 1)`` of the records."""
        return [linearisation.states for linearisation in self.linearisations]

    @property
    def residuals(self) -> tuple[np.ndarray, ...]:
        """Residuals ``(m, N)`` of each record, zero where a sample is missing: measured minus
        fitted, or whitened innovations.
        """
        return self.weighted.residuals

    @property
    def jacobians(self) -> tuple[np.ndarray, ...]:
        """Derivatives ``(m, N, c)`` of the fitted outputs, in the units of ``residuals``."""
        return self.weighted.jacobians

    @property
    def variance(self) -> np.ndarray:
        """Variance ``(m,)`` of ``residuals``: the noise variance of each output, or ones where
        the residuals are whitened.
        """
        return self.weighted.variance

    def whiten(self, r: int, columns: np.ndarray) -> np.ndarray:
        """Return ``columns (m, N, c)`` of record ``r``, given in the units of the outputs, whitened
        to unit variance.
        """
        return self.weighted.filters[r].whiten(columns)

    @property
    def log_likelihood(self) -> float:
        """Gaussian log likelihood of the data at the estimated variances, plus the term of the
        prior.
        """
        return -self.cost - 0.5 * float(self.counts.sum()) * (1.0 + np.log(2.0 * np.pi))

    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the information matrix ``(n, n)`` and the gradient ``(n,)`` of the log likelihood.
        Both are cached: do not change them in place.
        """
        return self._equations

    @cached_property
    def _equations(self) -> tuple[np.ndarray, np.ndarray]:
        n = len(self.theta)
        normal, gradient = np.zeros((n, n)), np.zeros(n)
        prior = self.layout.prior
        if prior is not None:
            normal[np.ix_(prior.positions, prior.positions)] += prior.information
            gradient[prior.positions] += prior.information @ (
                prior.mean - self.theta[prior.positions]
            )
        covariance_terms = self.noise_model.covariance_terms(
            self.layout, self.theta, self.linearisations, self.weighted
        )
        if covariance_terms is not None:
            noise_gradient, noise_information = covariance_terms
            gradient += noise_gradient
            normal += noise_information
        for r, (problem, residual) in enumerate(
            zip(self.layout.problems, self.residuals, strict=True)
        ):
            weight = np.where(problem.valid, 1.0 / self.variance[:, None], 0.0)
            add_normal_equations(
                normal, gradient, self.layout.columns(r), self.jacobians[r], residual, weight
            )
        return normal, gradient


def fit_whole_records(
    problem: FitProblem, guesses: list[np.ndarray] | None = None, start_fit: Fit | None = None
) -> Fit | None:
    """Return the fit of minimum cost that is reached from ``problem.start``.

    Parameters
    ----------
    guesses : trajectory ``(nx, K + 1)`` of each record to start from; None takes them from the
        measured channels.
    start_fit : the start, where the caller has already evaluated it.

    Returns
    -------
    The fit with the outcome ``CONVERGED`` or ``MAX_ITERATIONS``; None where the start has no finite
    cost. The caller tests whether all parameters are determined.
    """
    fit = _finite_or_none(start_fit) or _evaluated_start(problem, guesses)
    if fit is None:
        return None
    settings = problem.layout.settings
    search = _Search(problem)
    descent = Descent(search.model, search.trial, search.settled, search.shortcut, search.least)
    minimum = minimise(descent, fit, settings.iterations)
    fit = minimum.point
    # Steps along an undetermined direction may stay long; then the gain of likelihood decides.
    ended = (
        minimum.steps == settings.iterations
        or search.trials_without_gain == _MOST_TRIALS_WITHOUT_GAIN
    )
    no_progress = search.small_step or minimum.stuck or (ended and search.gain < _NEGLIGIBLE_GAIN)
    converged = no_progress and has_converged(minimum.model, fit.theta, settings)
    return replace(
        _finite_or_none(with_exact_trajectory(fit)) or fit,
        outcome=Outcome.CONVERGED if converged else Outcome.MAX_ITERATIONS,
        iterations=minimum.steps,
    )


@dataclass(eq=False)
class _Search:
    """State of the descent of one fit, and the functions that `Descent` calls.

    Attributes
    ----------
    gain : gain of log likelihood by the last accepted step; infinite before the first one.
    small_step : whether the last accepted step was below the tolerance.
    trials_without_gain : number of successive trials with a negligible change of the likelihood.
    rejected_damping : damping of the last rejected step; 0 after an accepted one.
    moves : recent steps ``(n,)``, each with its change of the gradient ``(n,)``.
    noise_unknowns : whether noise levels are unknowns; only then ``moves`` are used.
    bare : the fit problem without sensitivities.
    used_moves : those of ``moves`` that correct the information matrix; none after a curved step.
    """

    problem: FitProblem
    gain: float = np.inf
    small_step: bool = False
    trials_without_gain: int = 0
    rejected_damping: float = 0.0
    moves: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.noise_unknowns = bool(self.problem.noise_model.names)
        self.bare = without_sensitivities(self.problem)
        self.valley = _Valley(self.bare)
        self.used_moves: list[tuple[np.ndarray, np.ndarray]] = []

    def model(self, fit: Fit) -> LocalModel:
        """Return the quadratic model of the cost at a fit, with an information matrix that recent
        steps correct.
        """
        information, gradient = fit.normal_equations()
        information = _with_curvature(information, self.used_moves)
        return local_model(information, gradient, fit.theta, self.problem.low, self.problem.high)

    def least(self) -> float:
        """Return the smallest damping of the next step. Near the optimum it is nearly zero, since
        damping slows progress in poorly determined directions.
        """
        near_optimum = not self.noise_unknowns or self.gain <= _CURVATURE_GAIN
        return LEAST_DAMPING if near_optimum else self.problem.layout.settings.least_damping

    def settled(self, fit: Fit, model: LocalModel) -> bool:
        """Return whether the fit has converged.

        The last step and the undamped next step must both be small, since damping or a bound may
        have shortened the last one. A fit for a model comparison also ends after
        ``_MOST_TRIALS_WITHOUT_GAIN`` trials without a gain.
        """
        settings = self.problem.layout.settings
        if self.trials_without_gain == _MOST_TRIALS_WITHOUT_GAIN and settings.enough > 0.0:
            return True
        return self.small_step and has_converged(model, fit.theta, settings)

    def shortcut(self, fit: Fit, model: LocalModel) -> Fit | None:
        """Return the fit after a curved step along a valley of the cost; None where no curved step
        gains. Fits with unknown noise levels take no curved step, since the curvature of their
        innovations differs from the curvature of the residuals.
        """
        if self.noise_unknowns:
            return None
        problem = self.problem
        least, most = problem.noise_model.step_bounds(problem.layout, fit.theta)
        low, high = np.maximum(problem.low, least), np.minimum(problem.high, most)
        curved_fit = self.valley.curved_step(fit, model, low, high)
        if curved_fit is not None:
            self.gain, self.small_step, self.used_moves = fit.cost - curved_fit.cost, False, []
        return curved_fit

    def trial(self, fit: Fit, model: LocalModel, damping: float) -> Fit | None:
        """Return the fit after a damped step; None where the cost rises or is not finite."""
        problem, settings = self.problem, self.problem.layout.settings
        least, most = problem.noise_model.step_bounds(problem.layout, fit.theta)
        theta = np.clip(fit.theta + model.scale * model.step(damping), least, most)
        # A damping up to a rejected one may fail again: compute the cost alone, which is cheaper.
        cost_first = damping <= self.rejected_damping
        trial = evaluate(
            self.bare if cost_first else problem, theta, predicted_trajectories(fit, theta)
        )
        highest_cost = fit.cost + cost_rounding(float(fit.counts.sum()))
        no_change = trial is not None and abs(trial.cost - fit.cost) < max(
            settings.enough, _NEGLIGIBLE_GAIN
        )
        self.trials_without_gain = self.trials_without_gain + 1 if no_change else 0
        if cost_first and trial is not None and trial.cost <= highest_cost:
            trial, self.rejected_damping = (
                evaluate(problem, theta, predicted_trajectories(fit, theta)),
                0.0,
            )
        if trial is None or not trial.cost <= highest_cost or _finite_or_none(trial) is None:
            self.rejected_damping = damping
            return None
        small = np.abs(trial.theta - fit.theta) < np.maximum(
            settings.tolerance * model.scale, ROUNDING_SHARE * np.abs(fit.theta)
        )
        self.gain = self.valley.last_gain = fit.cost - trial.cost
        self.small_step = bool(np.all(small)) or self.gain < settings.enough
        if self.noise_unknowns and self.gain < _CURVATURE_GAIN:
            change = fit.normal_equations()[1] - trial.normal_equations()[1]
            self.moves = [*self.moves[-_REMEMBERED_STEPS + 1 :], (trial.theta - fit.theta, change)]
        self.used_moves = self.moves
        return trial


def _evaluated_start(problem: FitProblem, guesses: list[np.ndarray] | None) -> Fit | None:
    """Return the fit at the start, with trajectories from ``guesses`` or else the measured
    channels; None where its cost is not finite.
    """
    start, layout = problem.start, problem.layout
    if guesses is not None:
        start_fit = _finite_or_none(evaluate(problem, start, guesses))
        if start_fit is not None or not layout.problems:
            return start_fit
    return _finite_or_none(evaluate(problem, start, layout.guesses(start)))


@dataclass(eq=False)
class _Valley:
    """State of the curved steps along a valley of the cost, where straight steps are slow (geodesic
    acceleration [1]_).

    Strongly correlated unknowns make a curved valley. Straight steps along it must be short, and a
    fit may take hundreds of them.

    Attributes
    ----------
    bare : the fit problem without sensitivities.
    last_gain : gain of log likelihood by the last straight step; 0 after a curved one.
    straight_steps_left : number of straight steps before the next curved one is tried.
    next_wait : value of ``straight_steps_left`` after the next failure; each failure doubles it.
    share : share of the full step in the last successful curved step, one of
        ``_CURVED_STEP_SHARES``.

    References
    ----------
    .. [1] M. K. Transtrum and J. P. Sethna, "Improvements to the Levenberg-Marquardt algorithm for
       nonlinear least-squares minimization", arXiv:1201.5885, 2012.
    """

    bare: FitProblem
    last_gain: float = np.inf
    straight_steps_left: int = 0
    next_wait: int = 1
    share: float = _CURVED_STEP_SHARES[0]

    def curved_step(
        self, fit: Fit, model: LocalModel, low: np.ndarray, high: np.ndarray
    ) -> Fit | None:
        """Return the fit after a curved step within the bounds ``low`` and ``high``, ``(n,)`` each;
        None where the last straight step gained enough, or no curved step gains.
        """
        self.straight_steps_left -= 1
        least_gain = max(
            fit.layout.settings.enough, self.last_gain / _CREEPING_GAIN_SHARE, _NEGLIGIBLE_GAIN
        )
        if self.straight_steps_left >= 0 or model.predicted_gain <= least_gain:
            return None
        step = model.scale * model.step(LEAST_DAMPING)
        acceleration = self._second_order_term(fit, model, step, low, high)
        for share in _CURVED_STEP_SHARES:
            if acceleration is None or share > 2.0 * self.share:
                continue
            theta = np.clip(fit.theta + share * step + 0.5 * share**2 * acceleration, low, high)
            trial = self._cost_at(fit, theta)
            # half of the gain that the quadratic model predicts for this share of the step
            required_gain = 0.5 * (2.0 - share) * share * model.predicted_gain
            if trial is not None and fit.cost - trial.cost > required_gain:
                curved_fit = _finite_or_none(
                    evaluate(
                        fit.problem,
                        theta,
                        trial.trajectories,
                    )
                )
                if curved_fit is not None and curved_fit.cost < fit.cost:
                    self.last_gain, self.next_wait, self.share = 0.0, 1, share
                    return curved_fit
        self.straight_steps_left, self.next_wait, self.share = (
            self.next_wait,
            2 * self.next_wait,
            _CURVED_STEP_SHARES[0],
        )
        return None

    def _cost_at(self, fit: Fit, theta: np.ndarray) -> Fit | None:
        """Return the fit at ``theta`` without sensitivities; None where it is not finite. A second
        correction of its trajectory makes the defects negligible.
        """
        first_pass = evaluate(self.bare, theta, predicted_trajectories(fit, theta))
        if first_pass is None:
            return None
        return evaluate(self.bare, theta, first_pass.trajectories)

    def _second_order_term(
        self, fit: Fit, model: LocalModel, step: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> np.ndarray | None:
        """Return the second-order term ``(n,)`` of the curve that starts along ``step (n,)``; None
        where a cost is not finite. It is the geodesic acceleration, from finite differences of the
        residuals.
        """
        nearby = self._cost_at(fit, np.clip(fit.theta + _CURVATURE_STEP_SHARE * step, low, high))
        if nearby is None:
            return None
        gradient = np.zeros(len(step))
        for r, (before, after) in enumerate(zip(fit.residuals, nearby.residuals, strict=True)):
            columns, jacobian = fit.layout.columns(r), fit.jacobians[r]
            second_difference = after - before + jacobian @ (_CURVATURE_STEP_SHARE * step[columns])
            second = second_difference * (2.0 / _CURVATURE_STEP_SHARE**2)
            gradient[columns] += np.einsum("mnc,mn->c", jacobian, second / fit.variance[:, None])
        scaled: np.ndarray = replace(model, gradient=model.scale * gradient).step(LEAST_DAMPING)
        return model.scale * scaled


def has_converged(model: LocalModel, theta: np.ndarray, settings: FitSettings) -> bool:
    """Return whether a fit has converged: the quadratic model predicts that the undamped step is
    shorter than the tolerance or rounding, or that its gain is negligible.
    """
    rounding = float(np.max(ROUNDING_SHARE * np.abs(theta) / model.scale, initial=0.0))
    shortest_step = max(settings.tolerance, rounding)  # in sigmas
    return model.predicted_gain < max(settings.enough, 0.5 * shortest_step**2, _NEGLIGIBLE_GAIN)


def evaluate(problem: FitProblem, theta: np.ndarray, guesses: list[np.ndarray]) -> Fit | None:
    """Return the fit at ``theta (n,)``, with each record linearised about its trajectory in
    ``guesses``; None where outputs, sensitivities or the likelihood are not finite.
    """
    layout = problem.layout
    linearisations: list[Linearisation] = []
    residuals: list[np.ndarray] = []
    with np.errstate(all="ignore"):
        for r, recorded in enumerate(layout.problems):
            linearisation = linearise(recorded, *layout.split(theta, r), guesses[r])
            if not (
                np.all(np.abs(linearisation.y) < LARGEST_NUMBER)
                and np.all(np.abs(linearisation.jacobian) < LARGEST_NUMBER)
            ):
                return None
            linearisations.append(linearisation)
            residuals.append(np.where(recorded.valid, recorded.z - linearisation.y, 0.0))
        counts = np.sum([recorded.valid.sum(axis=1) for recorded in layout.problems], axis=0)
        weighted = problem.noise_model.weight_residuals(
            layout, theta, linearisations, residuals, counts
        )
    if weighted is None:
        return None
    cost = weighted.cost
    if layout.prior is not None:
        deviation = theta[layout.prior.positions] - layout.prior.mean
        cost += 0.5 * float(deviation @ layout.prior.information @ deviation)
    return Fit(problem, theta, tuple(guesses), tuple(linearisations), weighted, counts, cost)


def without_sensitivities(problem: FitProblem) -> FitProblem:
    """Return the fit problem without sensitivities; its cost is the same."""
    bare_problems = tuple(
        replace(
            recorded, free=(), free_initial=(), in_dynamics=(), increment=recorded.increment[:0]
        )
        for recorded in problem.layout.problems
    )
    return replace(problem, layout=replace(problem.layout, problems=bare_problems))


def with_exact_trajectory(fit: Fit) -> Fit:
    """Return the fit at the same parameters, with trajectories that obey the equations.

    At most ``_MOST_CORRECTIONS`` corrections are made. They end when the trajectory changes by less
    than ``_CLOSED_GAP`` of its size; in a model comparison by less than ``_COMPARISON_GAP``, since
    the change affects the cost to second order only.
    """
    closed = _CLOSED_GAP if fit.layout.settings.enough == 0.0 else _COMPARISON_GAP
    for _ in range(_MOST_CORRECTIONS):
        gap = max(
            np.max(np.abs(linearisation.states - guess), initial=0.0)
            for linearisation, guess in zip(fit.linearisations, fit.guesses, strict=True)
        )
        size = max(
            np.max(np.abs(linearisation.states), initial=0.0)
            for linearisation in fit.linearisations
        )
        if not gap > closed * size:
            break
        corrected = evaluate(fit.problem, fit.theta, fit.trajectories)
        if corrected is None:
            break
        fit = corrected
    return fit


def _finite_or_none(fit: Fit | None) -> Fit | None:
    """Return the fit; None where its information matrix or gradient is not finite."""
    if fit is None:
        return None
    with np.errstate(all="ignore"):
        equations = fit.normal_equations()
    return fit if all(bool(np.all(np.isfinite(part))) for part in equations) else None


def predicted_trajectories(fit: Fit, theta: np.ndarray) -> list[np.ndarray]:
    """Return the trajectories ``(nx, K + 1)`` of the records at ``theta``, extrapolated linearly
    from a fit by its sensitivities.
    """
    step = theta - fit.theta
    return [
        np.array(linearisation.states + linearisation.by_state @ step[fit.layout.columns(r)])
        for r, linearisation in enumerate(fit.linearisations)
    ]


def _with_curvature(
    information: np.ndarray, moves: Sequence[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Return the information matrix with a BFGS update by each of the recent steps in ``moves``.

    The updated matrix maps a step to its change of gradient. With unknown noise levels, a fit with
    the expected information alone converges slowly.
    """
    for step, change in moves:
        expected_change = information @ step
        measured, expected = float(step @ change), float(step @ expected_change)
        if measured > _LEAST_CURVATURE * expected > 0.0:
            information = (
                information
                + np.outer(change, change) / measured
                - np.outer(expected_change, expected_change) / expected
            )
    return information


# ---- Refits with one fixed parameter, for profile-likelihood intervals

# a refit ends when a step gains less log likelihood; this moves an end of the interval by 1/4000 of
# its distance from the estimate
SETTLED_LOG_LIKELIHOOD = 1e-3
MOST_ITERATIONS = 30  # largest number of steps of a refit


def profile_intervals(
    fit: Fit,
    names: Sequence[str],
    covariance: np.ndarray,
    noise_at: Callable[[Fit, np.ndarray], NoiseModel] | None = None,
) -> tuple[ProfileInterval, ...]:
    """Return the profile-likelihood intervals of the shared parameters ``names`` of a converged
    fit.

    Parameters
    ----------
    covariance : ``(s, s)`` reported covariance of the shared parameters; the threshold of the
        likelihood grows with its ratio to the covariance for white residuals.
    noise_at : function of a fit and of theta ``(n,)`` that returns the noise model with its start
        at this theta; None keeps the noise model of the fit.
    """
    inverse, _ = inverse_information(fit.normal_equations()[0], fit.theta)
    layout, noise_model_at = fit.layout, noise_at or (lambda fit, theta: fit.noise_model)
    positions = {name: layout.shared.index(name) for name in names}
    refits = partial(_refit, fit, noise_at=noise_model_at)
    return profile_likelihood.profile_intervals(
        positions, fit.theta, fit.cost, (covariance, inverse), (layout.low, layout.high), refits
    )


def _refit(
    fit: Fit, j: int, along: np.ndarray, noise_at: Callable[[Fit, np.ndarray], NoiseModel]
) -> Callable[[float, Fit | None], tuple[float, Fit] | None]:
    """Return a function that fits all other unknowns with unknown ``j`` fixed at a value. It takes
    the value and a neighbouring refit, and returns the cost and the fit, or None.

    ``along (n,)`` is the change of all unknowns for a unit change of unknown ``j`` by the quadratic
    model. Each refit starts on this line.
    """
    settings = replace(
        fit.layout.settings, enough=SETTLED_LOG_LIKELIHOOD, iterations=MOST_ITERATIONS
    )

    def refit(value: float, neighbour: Fit | None) -> tuple[float, Fit] | None:
        near = neighbour or fit
        theta = np.clip(
            near.theta + along * (value - near.theta[j]), fit.problem.low, fit.problem.high
        )
        theta[j] = value
        count = len(fit.layout.start)
        low, high = fit.layout.low.copy(), fit.layout.high.copy()
        low[j] = high[j] = value
        layout = replace(fit.layout, settings=settings, start=theta[:count], low=low, high=high)
        refitted = fit_whole_records(
            FitProblem(layout, noise_at(near, theta)), predicted_trajectories(near, theta)
        )
        return None if refitted is None else (refitted.cost, refitted)

    return refit
