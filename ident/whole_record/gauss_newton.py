"""Levenberg-Marquardt over whole records, and profiled refits.

The cost is minus the log likelihood of the noise model, plus the prior's term. By default each
output's noise variance is concentrated out: 0.5 sum_i N_i ln(sigma_i^2). A step is accepted on the
defect-corrected residual, see `ident.whole_record.linearise`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from ident.estimate import LARGEST_NUMBER, Outcome
from ident.statistics import intervals
from ident.statistics.intervals import (
    ProfileInterval,
    add_normal_equations,
    inverse_information,
)
from ident.statistics.minimise import (
    LEAST_DAMPING,
    Descent,
    LocalModel,
    local_model,
    minimise,
    unresolved,
)
from ident.whole_record.layout import (
    ROUNDING_SHARE,
    FitLayout,
    FitProblem,
    FitSettings,
    NoiseModel,
    WeightedResiduals,
)
from ident.whole_record.linearise import Linearisation, linearise

# ---- Levenberg-Marquardt over whole records: the engine of every maximum-likelihood fit

_REMEMBERED_STEPS = 4  # most recent steps whose change of gradient gives curvature
# largest gain of log likelihood that is negligible (0.04 sigmas along a poorly known direction)
_NEGLIGIBLE_GAIN = 1e-3
# largest gain of log likelihood by a step whose change of gradient counts as curvature at the
# optimum
_CURVATURE_GAIN = 1.0
_LEAST_CURVATURE = 0.1  # smallest curvature of a step, relative to the expected one
# a step that gains less than this share of the undamped step's prediction makes slow progress in a
# valley
_CREEPING_GAIN_SHARE = 0.1
# share of the undamped step over which the curvature of a valley is measured
_CURVATURE_STEP_SHARE = 0.1
# shares of a curved step, tried in turn until one gains
_CURVED_STEP_SHARES = (1.0, 0.5, 0.25, 0.125)
# most successive trials without progress before the fit of a model comparison ends
_MOST_IDLE_TRIALS = 3


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit, finished or on its way.

    Attributes
    ----------
    theta : ``(n,)`` unknowns: the layout's, then the noise model's.
    lines : outputs and sensitivities of each record.
    weighted : whitened residuals and sensitivities.
    counts : ``(m,)`` samples.
    cost : see the module.
    """

    problem: FitProblem
    theta: np.ndarray
    guesses: tuple[np.ndarray, ...]
    lines: tuple[Linearisation, ...]
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
    def residuals(self) -> tuple[np.ndarray, ...]:
        """Independent residuals ``(m, N)`` a record, zero where a sample is missing: measured minus
        fitted, or whitened.
        """
        return self.weighted.residuals

    @property
    def jacobians(self) -> tuple[np.ndarray, ...]:
        """Sensitivities ``(m, N, c)`` of each record that go with ``residuals``."""
        return self.weighted.jacobians

    @property
    def variance(self) -> np.ndarray:
        """Variance of ``residuals``, ``(m,)``: of each output's noise, or ones where they are
        whitened.
        """
        return self.weighted.variance

    def whiten(self, r: int, columns: np.ndarray) -> np.ndarray:
        """Return the columns ``(m, N, c)`` of record ``r`` in the outputs' units, whitened to unit
        variance.
        """
        return self.weighted.filters[r].whiten(columns)

    @property
    def log_likelihood(self) -> float:
        """Gaussian log likelihood of the data at the estimated variances; the prior's term
        included.
        """
        return -self.cost - 0.5 * float(self.counts.sum()) * (1.0 + np.log(2.0 * np.pi))

    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the information matrix ``(n, n)`` and gradient of the log likelihood ``(n,)``;
        cached and read-only.
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
        terms = self.noise_model.covariance_terms(
            self.layout, self.theta, self.lines, self.weighted
        )
        if terms is not None:
            gradient += terms[0]
            normal += terms[1]
        for r, (problem, residual) in enumerate(
            zip(self.layout.problems, self.residuals, strict=True)
        ):
            weight = np.where(problem.valid, 1.0 / self.variance[:, None], 0.0)
            add_normal_equations(
                normal, gradient, self.layout.columns(r), self.jacobians[r], residual, weight
            )
        return normal, gradient


def fit_whole_records(
    problem: FitProblem, guesses: list[np.ndarray] | None = None, begun: Fit | None = None
) -> Fit | None:
    """Minimise the cost from ``problem.start``; None when not even the start has a finite cost.

    ``guesses`` : starting trajectories; None takes them from the measured channels. ``begun`` : the
    start, if it was evaluated before. Outcomes: ``CONVERGED`` or ``MAX_ITERATIONS``; the caller
    tests whether all parameters are determined.
    """
    fit = _finite_or_none(begun) or _evaluated_start(problem, guesses)
    if fit is None:
        return None
    settings = problem.layout.settings
    search = _Search(problem)
    descent = Descent(search.model, search.trial, search.settled, search.shortcut, search.least)
    found = minimise(descent, fit, settings.iterations)
    fit, done = found.point, found.steps
    # The optimum also needs a small undamped step. Steps along an undetermined direction may stay
    # long; then the likelihood decides.
    ended = done == settings.iterations or search.idle == _MOST_IDLE_TRIALS
    converged = (
        search.near or found.stuck or (ended and search.gain < _NEGLIGIBLE_GAIN)
    ) and has_converged(found.model, fit.theta, settings)
    return replace(
        _finite_or_none(with_exact_trajectory(fit)) or fit,
        outcome=Outcome.CONVERGED if converged else Outcome.MAX_ITERATIONS,
        iterations=done,
    )


@dataclass(eq=False)
class _Search:
    """State of a search over whole records, and the functions that its `Descent` is made of.

    Attributes
    ----------
    gain : of log likelihood by the last step taken; none is infinite.
    near : whether that step was small.
    idle : trials in a row that changed the likelihood by less than is enough.
    refused : damping of the last step that was not taken.
    moves : the last steps with their changes of gradient.
    curved : whether the noise's levels are unknowns, for which these are used.
    """

    problem: FitProblem
    gain: float = np.inf
    near: bool = False
    idle: int = 0
    refused: float = 0.0
    moves: list[tuple[np.ndarray, np.ndarray]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.curved = bool(self.problem.noise_model.names)
        self.bare = without_sensitivities(self.problem)
        self.valley = _Valley(self.bare)
        self.used: list[tuple[np.ndarray, np.ndarray]] = []

    def model(self, fit: Fit) -> LocalModel:
        """Return the quadratic model at a fit, with the curvature of recent steps; after a valley
        step without it.
        """
        information, gradient = fit.normal_equations()
        information = _with_curvature(information, self.used)
        return local_model(information, gradient, fit.theta, self.problem.low, self.problem.high)

    def least(self) -> float:
        """Return the least damping: near the optimum none is needed, and any slows progress in
        poorly determined directions.
        """
        steady = not self.curved or self.gain <= _CURVATURE_GAIN
        return LEAST_DAMPING if steady else self.problem.layout.settings.least_damping

    def settled(self, fit: Fit, model: LocalModel) -> bool:
        """Return whether the fit has converged.

        The last step and the undamped next one must both be small; damping or a bound may shorten
        the former. The fit of a model comparison also ends without further gain.
        """
        settings = self.problem.layout.settings
        if self.idle == _MOST_IDLE_TRIALS and settings.enough > 0.0:
            return True
        return self.near and has_converged(model, fit.theta, settings)

    def shortcut(self, fit: Fit, model: LocalModel) -> Fit | None:
        """Return a curved step along a valley of the cost; None with process noise, whose
        innovations have another curvature than these residuals.
        """
        if self.curved:
            return None
        problem = self.problem
        least, most = problem.noise_model.step_bounds(problem.layout, fit.theta)
        low, high = np.maximum(problem.low, least), np.minimum(problem.high, most)
        bent = self.valley.along(fit, model, low, high)
        if bent is not None:
            self.gain, self.near, self.used = fit.cost - bent.cost, False, []
        return bent

    def trial(self, fit: Fit, model: LocalModel, damping: float) -> Fit | None:
        """Return the fit after a damped step; None where the cost rises or is not finite."""
        problem, settings = self.problem, self.problem.layout.settings
        least, most = problem.noise_model.step_bounds(problem.layout, fit.theta)
        theta = np.clip(fit.theta + model.scale * model.step(damping), least, most)
        # A damping that failed lately may fail again; the cost alone is cheaper to test.
        first = self.bare if damping <= self.refused else problem
        trial = evaluate(first, theta, predicted_trajectories(fit, theta))
        most_cost = fit.cost + unresolved(float(fit.counts.sum()))
        level = trial is not None and abs(trial.cost - fit.cost) < max(
            settings.enough, _NEGLIGIBLE_GAIN
        )
        self.idle = self.idle + 1 if level else 0
        if first is self.bare and trial is not None and trial.cost <= most_cost:
            trial, self.refused = evaluate(problem, theta, predicted_trajectories(fit, theta)), 0.0
        if trial is None or not trial.cost <= most_cost or _finite_or_none(trial) is None:
            self.refused = damping
            return None
        small = np.abs(trial.theta - fit.theta) < np.maximum(
            settings.tolerance * model.scale, ROUNDING_SHARE * np.abs(fit.theta)
        )
        self.gain = self.valley.slow = fit.cost - trial.cost
        self.near = bool(np.all(small)) or self.gain < settings.enough
        if self.curved and self.gain < _CURVATURE_GAIN:
            change = fit.normal_equations()[1] - trial.normal_equations()[1]
            self.moves = [*self.moves[-_REMEMBERED_STEPS + 1 :], (trial.theta - fit.theta, change)]
        self.used = self.moves
        return trial


def _evaluated_start(problem: FitProblem, guesses: list[np.ndarray] | None) -> Fit | None:
    """Return the start, with trajectories from ``guesses`` or the measured channels; None where its
    cost is not finite.
    """
    start, layout = problem.start, problem.layout
    given = None if guesses is None else _finite_or_none(evaluate(problem, start, guesses))
    if given is not None or (guesses is not None and not layout.problems):
        return given
    return _finite_or_none(evaluate(problem, start, layout.guesses(start)))


@dataclass(eq=False)
class _Valley:
    """Curved steps along a valley of the cost, where straight steps are slow (geodesic acceleration
    [1]_).

    Strongly correlated unknowns make a curved valley. Straight steps leave its floor and are
    damped: hundreds of them are needed.

    Attributes
    ----------
    bare : the fit without sensitivities.
    slow : gain of log likelihood by the last step.
    straight : steps until the next curved one.
    wait : the same after a failure.
    share : of the last successful curved step.

    References
    ----------
    .. [1] M. K. Transtrum and J. P. Sethna, "Improvements to the Levenberg-Marquardt algorithm for
       nonlinear least-squares minimization", arXiv:1201.5885, 2012.
    """

    bare: FitProblem
    slow: float = np.inf
    straight: int = 0
    wait: int = 1
    share: float = _CURVED_STEP_SHARES[0]

    def along(self, fit: Fit, model: LocalModel, low: np.ndarray, high: np.ndarray) -> Fit | None:
        """Return the fit after a curved step within bounds ``(n,)``; None where the last straight
        step was not slow, or no curved step gains.
        """
        self.straight -= 1
        enough = max(fit.layout.settings.enough, self.slow / _CREEPING_GAIN_SHARE, _NEGLIGIBLE_GAIN)
        if self.straight >= 0 or model.promised <= enough:
            return None
        step = model.scale * model.step(LEAST_DAMPING)
        bend = self._second_order_term(fit, model, step, low, high)
        for share in _CURVED_STEP_SHARES:
            if bend is None or share > 2.0 * self.share:
                continue
            theta = np.clip(fit.theta + share * step + 0.5 * share**2 * bend, low, high)
            tried = self._at(fit, theta)
            asked = 0.5 * (2.0 - share) * share * model.promised
            if tried is not None and fit.cost - tried.cost > asked:
                found = _finite_or_none(
                    evaluate(fit.problem, theta, [line.states for line in tried.lines])
                )
                if found is not None and found.cost < fit.cost:
                    self.slow, self.wait, self.share = 0.0, 1, share
                    return found
        self.straight, self.wait, self.share = self.wait, 2 * self.wait, _CURVED_STEP_SHARES[0]
        return None

    def _at(self, fit: Fit, theta: np.ndarray) -> Fit | None:
        """Return the cost at ``theta``, with a trajectory that nearly obeys the equations."""
        first = evaluate(self.bare, theta, predicted_trajectories(fit, theta))
        if first is None:
            return None
        return evaluate(self.bare, theta, [line.states for line in first.lines])

    def _second_order_term(
        self, fit: Fit, model: LocalModel, step: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> np.ndarray | None:
        """Return the second-order term ``(n,)`` of the curve that starts along ``step``."""
        near = self._at(fit, np.clip(fit.theta + _CURVATURE_STEP_SHARE * step, low, high))
        if near is None:
            return None
        pull = np.zeros(len(step))
        for r, (before, after) in enumerate(zip(fit.residuals, near.residuals, strict=True)):
            columns, jacobian = fit.layout.columns(r), fit.jacobians[r]
            second = (after - before + jacobian @ (_CURVATURE_STEP_SHARE * step[columns])) * (
                2.0 / _CURVATURE_STEP_SHARE**2
            )
            pull[columns] += np.einsum("mnc,mn->c", jacobian, second / fit.variance[:, None])
        curved: np.ndarray = replace(model, gradient=model.scale * pull).step(LEAST_DAMPING)
        return model.scale * curved


def has_converged(model: LocalModel, theta: np.ndarray, settings: FitSettings) -> bool:
    """Return whether the undamped step is shorter than the tolerance or rounding, or its predicted
    gain is negligible.
    """
    resolved = max(
        settings.tolerance, float(np.max(ROUNDING_SHARE * np.abs(theta) / model.scale, initial=0.0))
    )
    return model.promised < max(settings.enough, 0.5 * resolved**2, _NEGLIGIBLE_GAIN)


def evaluate(problem: FitProblem, theta: np.ndarray, guesses: list[np.ndarray]) -> Fit | None:
    """Return the cost, residuals and sensitivities at ``theta``; None where they are not finite."""
    layout = problem.layout
    lines: list[Linearisation] = []
    residuals: list[np.ndarray] = []
    with np.errstate(all="ignore"):
        for r, recorded in enumerate(layout.problems):
            line = linearise(recorded, *layout.split(theta, r), guesses[r])
            if not (
                np.all(np.abs(line.y) < LARGEST_NUMBER)
                and np.all(np.abs(line.jacobian) < LARGEST_NUMBER)
            ):
                return None
            lines.append(line)
            residuals.append(np.where(recorded.valid, recorded.z - line.y, 0.0))
        counts = np.sum([recorded.valid.sum(axis=1) for recorded in layout.problems], axis=0)
        weighted = problem.noise_model.weight_residuals(layout, theta, lines, residuals, counts)
    if weighted is None:
        return None
    cost = weighted.cost
    if layout.prior is not None:
        away = theta[layout.prior.positions] - layout.prior.mean
        cost += 0.5 * float(away @ layout.prior.information @ away)
    return Fit(problem, theta, tuple(guesses), tuple(lines), weighted, counts, cost)


def without_sensitivities(problem: FitProblem) -> FitProblem:
    """Return the fit problem without sensitivities, which gives the same cost."""
    bare = tuple(
        replace(each, free=(), starts=(), moving=(), increment=each.increment[:0])
        for each in problem.layout.problems
    )
    return replace(problem, layout=replace(problem.layout, problems=bare))


def with_exact_trajectory(fit: Fit) -> Fit:
    """Return the fit at the same parameters, with a trajectory that obeys the equations to
    rounding.

    For model comparisons the gaps need not vanish: their effect on the cost is of second order.
    """
    closed = 1e-13 if fit.layout.settings.enough == 0.0 else 1e-6
    for _ in range(3):
        gap = max(
            np.max(np.abs(line.states - guess), initial=0.0)
            for line, guess in zip(fit.lines, fit.guesses, strict=True)
        )
        size = max(np.max(np.abs(line.states), initial=0.0) for line in fit.lines)
        again = (
            evaluate(fit.problem, fit.theta, [line.states for line in fit.lines])
            if gap > closed * size
            else None
        )
        if again is None:
            break
        fit = again
    return fit


def _finite_or_none(fit: Fit | None) -> Fit | None:
    """Return the fit; None where its information matrix or gradient is not finite."""
    if fit is None:
        return None
    with np.errstate(all="ignore"):
        equations = fit.normal_equations()
    return fit if all(bool(np.all(np.isfinite(each))) for each in equations) else None


def predicted_trajectories(fit: Fit, theta: np.ndarray) -> list[np.ndarray]:
    """Return trajectory guesses at other parameters, by the sensitivities of this fit."""
    step = theta - fit.theta
    return [
        np.array(line.states + line.by_state @ step[fit.layout.columns(r)])
        for r, line in enumerate(fit.lines)
    ]


def _with_curvature(
    information: np.ndarray, moves: Sequence[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Return the expected information, changed to map recent steps to their changes of gradient
    (BFGS).

    With unknown noise levels the expected information alone converges slowly.
    """
    for step, change in moves:
        pressed = information @ step
        work, seen = float(step @ change), float(step @ pressed)
        if work > _LEAST_CURVATURE * seen > 0.0:
            information = (
                information + np.outer(change, change) / work - np.outer(pressed, pressed) / seen
            )
    return information


# ---- Refits with one fixed parameter, for profile-likelihood intervals

# smallest gain of log likelihood of a refit; it moves an end of the interval by 1/4000
SETTLED_LOG_LIKELIHOOD = 1e-3
MOST_ITERATIONS = 30


def profile_intervals(
    fit: Fit,
    names: Sequence[str],
    covariance: np.ndarray,
    noise_at: Callable[[Fit, np.ndarray], NoiseModel] | None = None,
) -> tuple[ProfileInterval, ...]:
    """Return the intervals of the shared parameters ``names`` of a settled fit.

    Parameters
    ----------
    covariance : ``(s, s)`` of the shared parameters as reported; its ratio to that of white
        residuals widens the threshold.
    noise_at : returns the noise model started at a theta; None keeps it.
    """
    inverse, _ = inverse_information(fit.normal_equations()[0], fit.theta)
    layout, noise_model_at = fit.layout, noise_at or (lambda at, theta: at.noise_model)
    places = {name: layout.shared.index(name) for name in names}
    refits = partial(_refit, fit, noise_at=noise_model_at)
    return intervals.profile_intervals(
        places, fit.theta, fit.cost, (covariance, inverse), (layout.low, layout.high), refits
    )


def _refit(
    fit: Fit, j: int, along: np.ndarray, noise_at: Callable[[Fit, np.ndarray], NoiseModel]
) -> Callable[[float, Fit | None], tuple[float, Fit] | None]:
    """Return the cost with unknown ``j`` fixed at a value; the others start at the optimum of the
    quadratic model.
    """
    settings = replace(
        fit.layout.settings, enough=SETTLED_LOG_LIKELIHOOD, iterations=MOST_ITERATIONS
    )

    def refit(value: float, begun: Fit | None) -> tuple[float, Fit] | None:
        near = begun or fit
        theta = np.clip(
            near.theta + along * (value - near.theta[j]), fit.problem.low, fit.problem.high
        )
        theta[j] = value
        count = len(fit.layout.start)
        low, high = fit.layout.low.copy(), fit.layout.high.copy()
        low[j] = high[j] = value
        layout = replace(fit.layout, settings=settings, start=theta[:count], low=low, high=high)
        found = fit_whole_records(
            FitProblem(layout, noise_at(near, theta)), predicted_trajectories(near, theta)
        )
        return None if found is None else (found.cost, found)

    return refit
