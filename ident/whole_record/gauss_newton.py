"""Levenberg-Marquardt over whole records, profiled refits, and numerical errors of estimates.

The cost is minus the log likelihood that the noise model gives (each output's noise variance
concentrated out, 0.5 sum_i N_i ln(sigma_i^2), unless it says otherwise) plus the prior's. A step is
accepted on the defect-corrected residual, see `ident.whole_record.linearise`.

A residual at the size of the integration error is no noise, and sigmas made of it say nothing. With
y_h the outputs of steps h and order-4 integration, y - y_h = 16/15 (y_{h/2} - y_h) to leading order
(Richardson), and an error dy of the outputs moves an output-error estimate by (J' W J)^-1 J' W dy.

Equation error takes slopes over windows and smoothed regressors. A simulation at the estimate,
sampled as the record is, has the same errors and a known truth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ident.estimate import LARGEST, Estimate, Outcome
from ident.regression.equation_error import run_equation_error
from ident.statistics import intervals
from ident.statistics.intervals import (
    LocalModel,
    ProfileInterval,
    add_normal_equations,
    inverse_information,
    local_model,
    unresolved,
)
from ident.whole_record.layout import (
    ROUNDING,
    FitLayout,
    FitProblem,
    FitSettings,
    NoiseModel,
    WeightedResiduals,
    lay_out,
)
from ident.whole_record.linearise import Linearisation, linearise
from ident.whole_record.record_problem import record_problem
from sim.declaration.model import System
from sim.record import Channel, Record

# ---- Levenberg-Marquardt over whole records: the engine of every maximum-likelihood fit

_LEAST_DAMPING = 1e-12  # of a step where a quadratic holds
_REMEMBERED = 4  # steps whose change of gradient is used
# of log likelihood: what a step along a direction that the data hardly know may still promise (0.04
# sigmas)
_NOTHING = 1e-3
# gain of log likelihood by a step below which its change of gradient is taken for curvature at the
# optimum
_NEAR = 1.0
_LEAST_CURVATURE = 0.1  # of what is expected, below which a step tells nothing
_SLOW = 0.1  # of what the undamped step promises: a step that gains less creeps along a valley
_NEARBY = 0.1  # of the undamped step, over which the curvature of a valley is measured
_WAY = (
    1.0,
    0.5,
    0.25,
    0.125,
)  # shares of a curved step, the first that gains as it should is taken
# trials in a row that change the likelihood by less than is enough, after which a fit that is only
# compared ends
_IDLE = 3


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit, finished or on its way.

    Attributes
    ----------
    theta : ``(n,)`` unknowns: the layout's, then the noise model's.
    lines : outputs and sensitivities of each record. weighted : residuals and sensitivities as
    those of independent samples. counts : ``(m,)`` samples. cost : see above.
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
        """Which unknowns there are, and which record sees which."""
        return self.problem.layout

    @property
    def noise_model(self) -> NoiseModel:
        """The model of what is random in the data."""
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
        """Columns ``(m, N, c)`` of record ``r`` in the outputs' units, as those of independent
        samples of variance one.
        """
        return self.weighted.filters[r].whiten(columns)

    @property
    def log_likelihood(self) -> float:
        """Of the data, Gaussian, at the estimated variances; the prior's term included."""
        return -self.cost - 0.5 * float(self.counts.sum()) * (1.0 + np.log(2.0 * np.pi))

    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Information matrix ``(n, n)`` and gradient of the log likelihood ``(n,)``; worked out
        once, not to be written to.
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

    ``guesses`` are trajectories to begin with, from the measured channels when None; ``begun`` is
    the start where it has been evaluated. Outcomes: ``CONVERGED`` or ``MAX_ITERATIONS``; whether
    all directions are determined is for the caller to judge.
    """
    layout, noise_model, settings = problem.layout, problem.noise_model, problem.layout.settings
    start, low, high = problem.start, problem.low, problem.high
    fit = _sound(begun) or _sound(
        evaluate(problem, start, layout.guesses(start) if guesses is None else guesses)
    )
    if fit is None and guesses is None and layout.problems:
        return None
    if fit is None:
        fit = _sound(evaluate(problem, start, layout.guesses(start)))
        if fit is None:
            return None
    damping, outcome, done, idle = 1e-4, Outcome.MAX_ITERATIONS, 0, 0
    gain = slow = np.inf
    bare, refused = without_sensitivities(problem), 0.0
    curved = bool(noise_model.names)
    floor = settings.least_damping if curved else _LEAST_DAMPING
    moves: list[tuple[np.ndarray, np.ndarray]] = []
    straight, wait = 0, 1  # steps until the next curved one, and after the next that fails
    share = _WAY[0]
    gradient = fit.normal_equations()[1]
    model = local_model(*fit.normal_equations(), fit.theta, low, high)
    while done < settings.iterations:
        done += 1
        least, most = noise_model.step_bounds(layout, fit.theta)
        straight -= 1
        if straight < 0 and model.promised > max(settings.enough, slow / _SLOW, _NOTHING):
            bounds = np.maximum(low, least), np.minimum(high, most)
            bent, share = _along_the_valley(fit, model, bare, bounds, 2.0 * share)
            if bent is not None:
                gain, slow, wait, fit = fit.cost - bent.cost, 0.0, 1, bent
                gradient = fit.normal_equations()[1]
                model = local_model(*fit.normal_equations(), fit.theta, low, high)
                continue
            straight, wait = wait, 2 * wait
        trial_theta = np.clip(fit.theta + model.scale * model.step(damping), least, most)
        # A damping that was too small for the last steps is likely to be so again: the cost alone,
        # which is cheaper, tells that.
        trial = evaluate(
            bare if damping <= refused else problem, trial_theta, carried(fit, trial_theta)
        )
        most_cost = fit.cost + unresolved(float(fit.counts.sum()))
        level = trial is not None and abs(trial.cost - fit.cost) < max(settings.enough, _NOTHING)
        idle = idle + 1 if level else 0
        if damping <= refused and trial is not None and trial.cost <= most_cost:
            trial, refused = evaluate(problem, trial_theta, carried(fit, trial_theta)), 0.0
        if trial is not None and trial.cost <= most_cost and _sound(trial) is not None:
            small = np.abs(trial.theta - fit.theta) < np.maximum(
                settings.tolerance * model.scale, ROUNDING * np.abs(fit.theta)
            )
            before, fit = fit, trial
            gain, (information, after) = before.cost - fit.cost, fit.normal_equations()
            slow = gain
            # Near the optimum no damping goes too far, and any would creep along what the data know
            # a hundredth as well.
            damping = max(damping / 10.0, floor if gain > _NEAR else _LEAST_DAMPING)
            if curved and gain < _NEAR:
                moves = [*moves[-_REMEMBERED + 1 :], (fit.theta - before.theta, gradient - after)]
            model = local_model(_with_curvature(information, moves), after, fit.theta, low, high)
            gradient = after
            # A step that damping or a bound made small says nothing of the way that is left: the
            # undamped one does.
            if (np.all(small) or gain < settings.enough) and arrived(model, fit.theta, settings):
                outcome = Outcome.CONVERGED
                break
        else:
            refused = damping
            damping *= 10.0
            if damping > 1e8:
                # No descent is left: at the optimum if the undamped step says so too.
                outcome = (
                    Outcome.CONVERGED
                    if arrived(model, fit.theta, settings)
                    else Outcome.MAX_ITERATIONS
                )
                break
        if idle == _IDLE and settings.enough > 0.0:
            break
    # Steps along a direction that the data do not know may stay long for ever; the likelihood
    # settles.
    if (
        (done == settings.iterations or idle == _IDLE)
        and gain < _NOTHING
        and arrived(model, fit.theta, settings)
    ):
        outcome = Outcome.CONVERGED
    return replace(_sound(joined_up(fit)) or fit, outcome=outcome, iterations=done)


def _along_the_valley(
    fit: Fit,
    model: LocalModel,
    bare: FitProblem,
    bounds: tuple[np.ndarray, np.ndarray],
    largest: float,
) -> tuple[Fit | None, float]:
    """The fit after a step along a curve: the undamped step, and a second-order term that keeps to
    the floor of a curved valley (geodesic acceleration [1]_).

    Where unknowns trade off, straight steps leave the floor and are damped: hundreds creep along.

    Parameters
    ----------
    fit, model : where the step begins. bare : the fit without sensitivities.
    bounds : ``(n,)`` of the unknowns, low and high. largest : share of the step, at most.

    Returns
    -------
    None where no share of the step gains; and the share that was taken, or the largest one.

    References
    ----------
    .. [1] M. K. Transtrum and J. P. Sethna, "Improvements to the Levenberg-Marquardt algorithm for
       nonlinear least-squares minimization", arXiv:1201.5885, 2012.
    """
    step = model.scale * model.step(0.0)

    def at(problem: FitProblem, theta: np.ndarray) -> Fit | None:
        first = evaluate(problem, theta, carried(fit, theta))
        if first is None:
            return None
        return evaluate(problem, theta, [line.states for line in first.lines])

    near = at(bare, np.clip(fit.theta + _NEARBY * step, *bounds))
    if near is None:
        return None, _WAY[0]
    bend = np.zeros(len(step))
    for r, (before, after) in enumerate(zip(fit.residuals, near.residuals, strict=True)):
        columns, jacobian = fit.layout.columns(r), fit.jacobians[r]
        second = (after - before + jacobian @ (_NEARBY * step[columns])) * (2.0 / _NEARBY**2)
        second /= fit.variance[:, None]
        bend[columns] += np.einsum("mnc,mn->c", jacobian, second)
    curved = model.scale * replace(model, gradient=model.scale * bend).step(0.0)
    for share in (each for each in _WAY if each <= largest):
        theta = np.clip(fit.theta + share * step + 0.5 * share**2 * curved, *bounds)
        tried = at(bare, theta)
        asked = 0.5 * (2.0 - share) * share * model.promised
        if tried is not None and fit.cost - tried.cost > asked:
            found = evaluate(fit.problem, theta, [line.states for line in tried.lines])
            if found is not None and found.cost < fit.cost:
                return _sound(found), share
    return None, _WAY[0]


def arrived(model: LocalModel, theta: np.ndarray, settings: FitSettings) -> bool:
    """Whether the undamped step is shorter than the tolerance, or than rounding, or promises less
    than is enough, or than anyone could tell.
    """
    resolved = max(
        settings.tolerance, float(np.max(ROUNDING * np.abs(theta) / model.scale, initial=0.0))
    )
    return model.promised < max(settings.enough, 0.5 * resolved**2, _NOTHING)


def evaluate(problem: FitProblem, theta: np.ndarray, guesses: list[np.ndarray]) -> Fit | None:
    """Cost, residuals and sensitivities at ``theta``; None where they are not finite."""
    layout = problem.layout
    lines: list[Linearisation] = []
    residuals: list[np.ndarray] = []
    with np.errstate(all="ignore"):
        for r, recorded in enumerate(layout.problems):
            line = linearise(recorded, *layout.split(theta, r), guesses[r])
            if not (np.all(np.abs(line.y) < LARGEST) and np.all(np.abs(line.jacobian) < LARGEST)):
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
    """The same fit with nothing to differentiate by: the cost at given unknowns is as it was."""
    bare = tuple(
        replace(each, free=(), starts=(), moving=(), increment=each.increment[:0])
        for each in problem.layout.problems
    )
    return replace(problem, layout=replace(problem.layout, problems=bare))


def joined_up(fit: Fit) -> Fit:
    """The same parameters with a trajectory that obeys the equations to rounding: what the last
    step left is squared away.

    A fit that only compares models has a cost, of second order in the gap, that need not be as
    exact.
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


def _sound(fit: Fit | None) -> Fit | None:
    """The fit itself; None where its information matrix or gradient is not finite: no step and no
    sigma follows from it.
    """
    if fit is None:
        return None
    with np.errstate(all="ignore"):
        equations = fit.normal_equations()
    return fit if all(bool(np.all(np.isfinite(each))) for each in equations) else None


def carried(fit: Fit, theta: np.ndarray) -> list[np.ndarray]:
    """Trajectory guesses at other parameters, by the sensitivities of this point."""
    step = theta - fit.theta
    return [
        np.array(line.states + line.by_state @ step[fit.layout.columns(r)])
        for r, line in enumerate(fit.lines)
    ]


def _with_curvature(
    information: np.ndarray, moves: Sequence[tuple[np.ndarray, np.ndarray]]
) -> np.ndarray:
    """Expected information changed so that it maps recent steps to the changes of gradient they
    brought (BFGS).

    Where noise levels are unknowns the expected information alone converges slowly.
    """
    for step, change in moves:
        pressed = information @ step
        work, seen = float(step @ change), float(step @ pressed)
        if work > _LEAST_CURVATURE * seen > 0.0:
            information = (
                information + np.outer(change, change) / work - np.outer(pressed, pressed) / seen
            )
    return information


# ---- Refits of a whole-record fit with one parameter held, for profile-likelihood intervals

ENOUGH = 1e-3  # of log likelihood, which moves an end by 1/4000 of it
ITERATIONS = 30


def profile_intervals(
    fit: Fit,
    names: Sequence[str],
    covariance: np.ndarray,
    noise_at: Callable[[Fit, np.ndarray], NoiseModel] | None = None,
) -> tuple[ProfileInterval, ...]:
    """Intervals of the shared parameters ``names`` of a settled fit.

    Parameters
    ----------
    covariance : ``(s, s)`` of the shared parameters as it is printed; where it is larger than that
    of white residuals the threshold is too. noise_at : the noise model with its unknowns started at
    a theta; None leaves it as it is.
    """
    inverse, _ = inverse_information(fit.normal_equations()[0], fit.theta)
    layout, begun = fit.layout, noise_at or (lambda at, theta: at.noise_model)
    places = {name: layout.shared.index(name) for name in names}
    refits = partial(_refit, fit, noise_at=begun)
    return intervals.profile_intervals(
        places, fit.theta, fit.cost, (covariance, inverse), (layout.low, layout.high), refits
    )


def _refit(
    fit: Fit, j: int, along: np.ndarray, noise_at: Callable[[Fit, np.ndarray], NoiseModel]
) -> Callable[[float, Fit | None], tuple[float, Fit] | None]:
    """Cost with unknown ``j`` held at a value; the others begin where the curvature at the maximum
    puts them.
    """
    settings = replace(fit.layout.settings, enough=ENOUGH, iterations=ITERATIONS)

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
        found = fit_whole_records(FitProblem(layout, noise_at(near, theta)), carried(near, theta))
        return None if found is None else (found.cost, found)

    return refit


# ---- Errors of estimates that numerical methods leave

# of an output's motion: with more noise than that, integration errors are far below a sigma
QUIET = 1e-3
RICHARDSON = 16.0 / 15.0  # of the difference of steps h and h/2, order 4
# times what smoothing leaves of a record without noise: a record that leaves more has noise of its
# own
ALIKE = 3.0


def with_integration_error(estimate: Estimate, fit: Fit) -> Estimate:
    """An output-error estimate whose covariance holds the error of the integration where a record
    has hardly any noise.

    The message says where that error is larger than the sigma. A fit that stopped at its limit has
    it too: at the level of rounding the last steps are shorter than this error.
    """
    error = (
        integration_error(fit)
        if estimate.outcome in (Outcome.CONVERGED, Outcome.MAX_ITERATIONS)
        else None
    )
    if error is None:
        return estimate
    step = max(float(np.max(problem.grid.steps)) for problem in fit.layout.problems)
    cause = (
        f"the integration leaves larger errors than the noise of the record (steps of {step:g} s)"
    )
    return _widened(
        estimate, error[: len(estimate.names)], f"{cause}: sigmas are those of the integration"
    )


def integration_error(fit: Fit) -> np.ndarray | None:
    """Error of all unknowns ``(n,)`` from the finite steps of the integration; None where the noise
    is larger than ``QUIET`` or it fails.
    """
    layout = fit.layout
    if not _quiet(fit) or layout.prior is not None:
        return None
    finer = tuple(
        record_problem(
            problem.record,
            problem.system,
            0.5 * float(np.max(problem.grid.steps)),
            problem.free,
            problem.starts,
            valid=problem.valid,
            at=layout.split(fit.theta, r)[0],
            exact=problem.exact,
        )
        for r, problem in enumerate(layout.problems)
    )
    bare = without_sensitivities(FitProblem(replace(layout, problems=finer), fit.noise_model))
    begun = evaluate(bare, fit.theta, bare.layout.guesses(fit.theta))
    if begun is None:
        return None
    better, gradient = joined_up(begun), np.zeros(len(fit.theta))
    for r, problem in enumerate(layout.problems):
        weight = np.where(problem.valid, 1.0 / fit.variance[:, None], 0.0)
        moved = weight * (better.lines[r].y - fit.lines[r].y)
        gradient[layout.columns(r)] -= np.einsum("mnc,mn->c", fit.jacobians[r], moved)
    error = RICHARDSON * (inverse_information(fit.normal_equations()[0], fit.theta)[0] @ gradient)
    return error if np.all(np.isfinite(error)) else None


def _quiet(fit: Fit) -> bool:
    """Whether some output has less noise than ``QUIET`` of its motion."""
    for i in np.flatnonzero(fit.layout.used):
        rows = [problem.z[i, problem.valid[i]] for problem in fit.layout.problems]
        motion = np.concatenate([row - np.mean(row) for row in rows if row.size])
        if np.sqrt(fit.variance[i]) < QUIET * np.sqrt(np.mean(motion**2)):
            return True
    return False


def with_sampling_error(
    estimate: Estimate, records: Sequence[Record], system: System, settings: FitSettings
) -> Estimate:
    """An estimate by equation error whose covariance holds the error of sampling where a record has
    hardly any noise.

    The estimate itself where the records have noise, or where their simulation leaves the range of
    numbers. The message says where the error is larger than the sigma.
    """
    if estimate.outcome not in (Outcome.CONVERGED, Outcome.MAX_ITERATIONS):
        return estimate
    calm = _simulated(estimate, records, system, settings)
    if calm is None:
        return estimate
    again = run_equation_error(calm, system)
    quiet = np.any((estimate.noise_std < ALIKE * again.noise_std) & (again.noise_std > 0.0))
    error = again.values - estimate.values
    if (
        again.outcome not in (Outcome.CONVERGED, Outcome.MAX_ITERATIONS)
        or not quiet
        or not np.all(np.isfinite(error))
    ):
        return estimate
    return _widened(
        estimate,
        error,
        "slopes of samples leave larger errors than the noise of the record: sigmas are those of "
        "sampling",
    )


def _widened(estimate: Estimate, error: np.ndarray, said: str) -> Estimate:
    """An estimate with an error ``(n,)`` added to its covariance, and a sentence where that is
    larger than a sigma.
    """
    message = said if np.any(np.abs(error) > estimate.std) else ""
    return replace(
        estimate,
        covariance=estimate.covariance + np.outer(error, error),
        message=message or estimate.message,
    )


def _simulated(
    estimate: Estimate, records: Sequence[Record], system: System, settings: FitSettings
) -> list[Record] | None:
    """The records with outputs simulated at an estimate from their first samples, without noise and
    biases; None where they overflow.
    """
    known = replace(system, parameters=system.parameters.with_values(estimate.as_dict()))
    layout = lay_out(
        records, known, replace(settings, max_step=0.5 * settings.max_step, use_priors=False)
    )
    bare = without_sensitivities(FitProblem(layout))
    begun = evaluate(bare, layout.start, layout.guesses(layout.start))
    if begun is None:
        return None
    lines = joined_up(begun).lines
    out = []
    for record, line in zip(records, lines, strict=True):
        rows = dict(zip(known.output_names, line.y, strict=True))
        outputs = tuple(
            Channel.of(each.name, each.unit, np.where(each.valid, rows[each.name], np.nan))
            if each.name in rows
            else each
            for each in record.outputs
        )
        out.append(replace(record, outputs=outputs))
    return out
