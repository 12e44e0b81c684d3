"""Fits of a linear System to the Fourier transforms of records, by maximum likelihood.

Transforms of noise are complex Gaussian and independent from harmonic to harmonic. Minus the log
likelihood, without constants, is therefore the sum over outputs i and noise bands b of
n_ib ln(mean |Y - Y_model|^2), with n_ib the number of harmonics. The unknowns are the shared
parameters, and of each record the end vector x[0] - x[N].
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ident.estimate import LARGEST_NUMBER, Outcome
from ident.frequency_domain.transform import (
    Delay,
    TransformedRecord,
    linear_model,
    noise_levels,
    response,
)
from ident.statistics import profile_likelihood
from ident.statistics.intervals import add_normal_equations, inverse_information
from ident.statistics.minimise import Descent, LocalModel, cost_rounding, local_model, minimise
from ident.statistics.profile_likelihood import ProfileInterval
from sim.declaration.model import System

_PROGRESS_STEPS = 8  # steps over which the progress is measured
# A smaller gain of log likelihood over these steps, 0.04 sigmas of a parameter, ends the search.
_NEGLIGIBLE_GAIN = 1e-3
# smallest mean square residual, relative to the mean square of an output: an exact fit
_EXACT_FIT_SHARE = 1e-24


@dataclass(frozen=True, eq=False)
class FrequencyProblem:
    """A fit of a linear System to transforms of records.

    Attributes
    ----------
    system : the linear model.
    records : transforms of the records.
    delays : position of an input -> name of its delay parameter.
    names : names of the q shared parameters.
    start, low, high : ``(q,)`` their starting values, lower and upper bounds.
    prior : ``(q,)`` information of their priors about the start; zero without a prior.
    bands : ``(f,)`` of each record, number of the noise band of each frequency.
    iterations : most steps of the search.
    tolerance : largest change, in sigmas, of a step after which the search has converged.
    """

    system: System
    records: tuple[TransformedRecord, ...]
    delays: Mapping[int, str]
    names: tuple[str, ...]
    start: np.ndarray
    low: np.ndarray
    high: np.ndarray
    prior: np.ndarray
    bands: tuple[np.ndarray, ...]
    iterations: int = 60
    tolerance: float = 1e-3

    @cached_property
    def positions(self) -> tuple[int, ...]:
        """Positions of the shared parameters among all parameters of the System."""
        return tuple(self.system.parameters.index(name) for name in self.names)

    @cached_property
    def floor(self) -> np.ndarray:
        """Smallest mean square residual ``(m,)``: an output with less is fitted to rounding."""
        power = np.sum(
            [np.sum(np.abs(record.outputs) ** 2, axis=1) for record in self.records], axis=0
        )
        return np.maximum(
            _EXACT_FIT_SHARE * power / sum(len(record.omega) for record in self.records), 1e-60
        )

    def columns(self, r: int) -> np.ndarray:
        """Return the positions in theta of the shared parameters and of the end vector of record
        ``r``.
        """
        q, n = len(self.names), len(self.system.states)
        return np.concatenate([np.arange(q), q + r * n + np.arange(n)])

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds ``(k,)`` of all unknowns; end vectors have no bounds."""
        free = np.full(len(self.records) * len(self.system.states), np.inf)
        return np.concatenate([self.low, -free]), np.concatenate([self.high, free])


@dataclass(frozen=True, eq=False)
class FrequencyFit:
    """A finished fit, or one point of a search.

    Attributes
    ----------
    problem : the problem.
    theta : ``(k,)`` values of all unknowns.
    modelled : ``(m, f)`` of each record, transforms of the model.
    residuals : ``(m, f)`` of each record, zero for an output that is not recorded.
    slopes : ``(m, f, c)`` of each record, derivatives of ``modelled`` with respect to its unknowns.
    levels : ``(m, b)`` noise level of each output in each band.
    counts : ``(m, b)`` number of complex residuals.
    cost : minus the log likelihood without constants, with the term of the priors.
    outcome, iterations : outcome and number of steps of the search.
    """

    problem: FrequencyProblem
    theta: np.ndarray
    modelled: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]
    slopes: tuple[np.ndarray, ...]
    levels: np.ndarray
    counts: np.ndarray
    cost: float
    outcome: Outcome = Outcome.MAX_ITERATIONS
    iterations: int = 0

    @property
    def log_likelihood(self) -> float:
        """Log likelihood of the transforms within the band."""
        return -self.cost - float(self.counts.sum()) * (1.0 + np.log(np.pi))

    def weight(self, r: int) -> np.ndarray:
        """Return one over the noise variance ``(m, f)`` of the real part, which equals that of the
        imaginary part, in record ``r``; zero for an output that is not recorded.
        """
        record = self.problem.records[r]
        return np.where(record.usable[:, None], 2.0 / self.levels[:, self.problem.bands[r]], 0.0)

    @cached_property
    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Information ``(k, k)`` and gradient ``(k,)`` of the log likelihood."""
        information, gradient = np.zeros((len(self.theta),) * 2), np.zeros(len(self.theta))
        q = len(self.problem.names)
        information[range(q), range(q)] += self.problem.prior
        gradient[:q] += self.problem.prior * (self.problem.start - self.theta[:q])
        for r, (residual, slope) in enumerate(zip(self.residuals, self.slopes, strict=True)):
            parts = (
                np.concatenate([residual.real, residual.imag], axis=1),
                np.concatenate([slope.real, slope.imag], axis=1),
            )
            add_normal_equations(
                information,
                gradient,
                self.problem.columns(r),
                parts[1],
                parts[0],
                np.tile(self.weight(r), 2),
            )
        return information, gradient

    @property
    def model(self) -> LocalModel:
        """Quadratic model of the log likelihood about this point, within the bounds."""
        return local_model(*self.normal_equations, self.theta, *self.problem.bounds)


def at_start(problem: FrequencyProblem) -> FrequencyFit | None:
    """Return the point with the starting parameters and the best end vector of each record; None if
    it is not finite.
    """
    n, q = len(problem.system.states), len(problem.names)
    fit = evaluate(problem, np.concatenate([problem.start, np.zeros(n * len(problem.records))]))
    if fit is None:
        return None
    theta = fit.theta.copy()
    for r, (residual, slope) in enumerate(zip(fit.residuals, fit.slopes, strict=True)):
        root = np.sqrt(fit.weight(r))
        weighted = (root[:, :, None] * slope[:, :, q:]).reshape(-1, n), (root * residual).ravel()
        real = [np.concatenate([part.real, part.imag]) for part in weighted]
        theta[problem.columns(r)[q:]] += np.linalg.lstsq(real[0], real[1], rcond=None)[0]
    better = evaluate(problem, theta)
    return better if better is not None and better.cost < fit.cost else fit


def evaluate(problem: FrequencyProblem, theta: np.ndarray) -> FrequencyFit | None:
    """Return the point at ``theta (k,)``; None if residuals or derivatives are not finite."""
    q, p = len(problem.names), problem.system.parameters.values()
    p[list(problem.positions)] = theta[:q]
    modelled, residuals, slopes = [], [], []
    with np.errstate(all="ignore"):
        model = linear_model(problem.system, p, problem.positions)
        delays = {i: _delay(problem, name, p) for i, name in problem.delays.items()}
        for r, record in enumerate(problem.records):
            try:
                result = response(model, record, delays, theta[problem.columns(r)[q:]])
            except (np.linalg.LinAlgError, ValueError):  # a pole at a harmonic, or overflow
                return None
            slope = np.concatenate([result.by_parameter, result.by_ends], axis=2)
            if not (
                np.all(np.abs(result.y) < LARGEST_NUMBER) and np.all(np.abs(slope) < LARGEST_NUMBER)
            ):
                return None
            modelled.append(result.y)
            residuals.append(np.where(record.usable[:, None], record.outputs - result.y, 0.0))
            slopes.append(slope)
    usable = [record.usable for record in problem.records]
    level, counts = noise_levels(residuals, usable, problem.bands, problem.floor)
    from_start = theta[:q] - problem.start
    cost = float(np.sum(counts * np.log(level))) + 0.5 * float(
        from_start @ (problem.prior * from_start)
    )
    return FrequencyFit(
        problem, theta, tuple(modelled), tuple(residuals), tuple(slopes), level, counts, cost
    )


def fit_transforms(
    problem: FrequencyProblem, begin: FrequencyFit | None = None
) -> FrequencyFit | None:
    """Return the fit by Levenberg-Marquardt steps from the start or from the fit ``begin``; None if
    the cost there is not finite.

    The outcome is ``CONVERGED`` or ``MAX_ITERATIONS``; the caller checks observability.
    """
    fit = (
        at_start(problem)
        if begin is None
        else evaluate(problem, np.clip(begin.theta, *problem.bounds))
    )
    if fit is None:
        return None
    costs, refused = [fit.cost], [False]

    def trial(fit: FrequencyFit, model: LocalModel, damping: float) -> FrequencyFit | None:
        theta = np.clip(fit.theta + model.scale * model.step(damping), *problem.bounds)
        tried = evaluate(problem, theta)
        if tried is not None and not tried.cost <= fit.cost + cost_rounding(
            float(fit.counts.sum())
        ):
            tried = None
        costs.append(fit.cost if tried is None else tried.cost)
        refused.append(tried is None)
        return tried

    def settled(fit: FrequencyFit, model: LocalModel) -> bool:
        return model.predicted_gain < 0.5 * problem.tolerance**2 or _is_at_a_kink(costs, refused)

    solution = minimise(Descent(lambda fit: fit.model, trial, settled), fit, problem.iterations)
    done = settled(solution.point, solution.model)
    return replace(
        solution.point,
        outcome=Outcome.CONVERGED if done else Outcome.MAX_ITERATIONS,
        iterations=solution.steps,
    )


def _is_at_a_kink(costs: Sequence[float], refused: Sequence[bool]) -> bool:
    """Return whether steps are refused while the cost hardly falls. The cost has a kink where a
    delay is a whole number of samples.
    """
    return (
        len(costs) > _PROGRESS_STEPS
        and costs[-1 - _PROGRESS_STEPS] - costs[-1] < _NEGLIGIBLE_GAIN
        and any(refused[-_PROGRESS_STEPS:])
    )


def _delay(problem: FrequencyProblem, name: str, p: np.ndarray) -> Delay:
    position = problem.names.index(name) if name in problem.names else None
    return Delay(float(p[problem.system.parameters.index(name)]), position)


def with_bands(problem: FrequencyProblem, bands: Sequence[np.ndarray]) -> FrequencyProblem:
    """Return the problem with other noise bands."""
    return replace(problem, bands=tuple(bands))


# ---- Refits with one parameter fixed


def profile_intervals(
    fit: FrequencyFit, names: Sequence[str], covariance: np.ndarray
) -> tuple[ProfileInterval, ...]:
    """Return the profile-likelihood intervals of the parameters ``names``.

    ``covariance (q, q)`` is the reported one. Its ratio to that for white residuals scales the
    threshold of the likelihood.
    """
    inverse, _ = inverse_information(fit.normal_equations[0], fit.theta)
    problem = fit.problem
    places = {name: problem.names.index(name) for name in names}
    return profile_likelihood.profile_intervals(
        places,
        fit.theta,
        fit.cost,
        (covariance, inverse),
        (problem.low, problem.high),
        partial(_refit, fit),
    )


def _refit(
    fit: FrequencyFit, j: int, along: np.ndarray
) -> Callable[[float, FrequencyFit | None], tuple[float, FrequencyFit] | None]:
    """Return a function that fixes parameter ``j`` at a value, refits all others, and returns the
    cost and the fit.

    ``along (k,)`` is the expected change of all unknowns per unit of the parameter.
    """

    def refit(value: float, begin: FrequencyFit | None) -> tuple[float, FrequencyFit] | None:
        near = begin or fit
        theta = near.theta + along * (value - near.theta[j])
        low, high = fit.problem.low.copy(), fit.problem.high.copy()
        low[j] = high[j] = value
        # Priors stay about the start of the original fit: only the bounds differ.
        result = fit_transforms(
            replace(fit.problem, low=low, high=high), replace(near, theta=theta)
        )
        return None if result is None else (result.cost, result)

    return refit
