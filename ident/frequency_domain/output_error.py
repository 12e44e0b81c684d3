"""Output error in the frequency domain: from records to an Estimate.

Complex least squares, weighted by the noise found in each output (Klein and Morelli, Aircraft
System Identification, ch. 7). The model must be linear; a delay of an input is represented exactly.

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

from ident.estimate import LARGEST_NUMBER, Estimate, Outcome
from ident.frequency_domain.transform import (
    Delay,
    TransformedRecord,
    default_band,
    equal_bands,
    first_nonlinear,
    levels_differ,
    linear_model,
    means_over_neighbours,
    noise_levels,
    response,
    transformed,
)
from ident.regression.equation_error import run_equation_error
from ident.statistics import profile_likelihood
from ident.statistics.intervals import add_normal_equations, inverse_information, split_covariance
from ident.statistics.minimise import Descent, LocalModel, cost_rounding, local_model, minimise
from ident.statistics.profile_likelihood import ProfileInterval
from sim.declaration.model import System
from sim.errors import FlightidError, ModelError
from sim.record import Record

# ---- Fit of the transforms by maximum likelihood

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
            both_slopes = np.concatenate([slope.real, slope.imag], axis=1)
            both_parts = np.concatenate([residual.real, residual.imag], axis=1)
            weight = np.tile(self.weight(r), 2)
            columns = self.problem.columns(r)
            add_normal_equations(information, gradient, columns, both_slopes, both_parts, weight)
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
        delays = {
            i: Delay(
                float(p[problem.system.parameters.index(name)]),
                problem.names.index(name) if name in problem.names else None,
            )
            for i, name in problem.delays.items()
        }
        for r, record in enumerate(problem.records):
            try:
                result = response(model, record, delays, theta[problem.columns(r)[q:]])
            except (np.linalg.LinAlgError, ValueError):  # a pole at a harmonic, or overflow
                return None
            slope = np.concatenate([result.by_parameter, result.by_ends], axis=2)
            if not all(np.all(np.abs(row) < LARGEST_NUMBER) for row in (result.y, slope)):
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
    if begin is None:
        fit = at_start(problem)
    else:
        fit = evaluate(problem, np.clip(begin.theta, *problem.bounds))
    if fit is None:
        return None
    costs, refused = [fit.cost], [False]

    def trial(fit: FrequencyFit, model: LocalModel, damping: float) -> FrequencyFit | None:
        theta = np.clip(fit.theta + model.scale * model.step(damping), *problem.bounds)
        tried, most = evaluate(problem, theta), fit.cost + cost_rounding(float(fit.counts.sum()))
        if tried is not None and not tried.cost <= most:
            tried = None
        costs.append(fit.cost if tried is None else tried.cost)
        refused.append(tried is None)
        return tried

    def settled(fit: FrequencyFit, model: LocalModel) -> bool:
        if model.predicted_gain < 0.5 * problem.tolerance**2:
            return True
        # The cost has a kink where a delay is a whole number of samples: steps are refused there
        # while the cost hardly falls.
        gain = costs[-1 - _PROGRESS_STEPS] - costs[-1] if len(costs) > _PROGRESS_STEPS else np.inf
        return gain < _NEGLIGIBLE_GAIN and any(refused[-_PROGRESS_STEPS:])

    solution = minimise(Descent(lambda fit: fit.model, trial, settled), fit, problem.iterations)
    done = settled(solution.point, solution.model)
    return replace(
        solution.point,
        outcome=Outcome.CONVERGED if done else Outcome.MAX_ITERATIONS,
        iterations=solution.steps,
    )


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


# ---- From records to an Estimate

METHOD = "frequency-domain"
_LEAST_LEFT = 0.2  # smallest value of one minus the leverage of a residual
_NUMBERS_PER_UNKNOWN = 2.0  # fewest real numbers in the default band, per unknown


@dataclass(frozen=True)
class FrequencySettings:
    """Settings of a fit.

    Attributes
    ----------
    band : lowest and highest frequency, Hz; None takes `band_for`.
    use_priors : whether the priors of parameters are used.
    coloured : whether sigmas are corrected for coloured residuals.
    """

    band: tuple[float, float] | None = None
    use_priors: bool = False
    coloured: bool = True


def fit_frequency_domain(
    records: Sequence[Record],
    system: System,
    settings: FrequencySettings | None = None,
    *,
    delays: Mapping[str, str] | None = None,
) -> Estimate:
    """Fit the free parameters of a linear System to the transforms of records.

    Parameters
    ----------
    records : one or more evenly sampled records, which need not begin or end in trim. Constant
        biases have no effect on the fit.
    delays : name of an input -> name of its delay parameter, s. No other effect may act on the
        input path.

    Returns
    -------
    Estimate of the shared free parameters. ``fitted`` are the outputs of the model within the band,
    without means; for the full response, simulate with the estimate. ``message`` has the number of
    harmonics, the band, and the number of noise bands if there are several. The outcomes are those
    of ``fit_output_error``.

    Raises
    ------
    ModelError : if there is no input, a rate or output is not linear, effects other than the delays
        act on the input or sensor path, or no parameter is free.
    RecordError : if samples are uneven or missing, or no harmonic is within the band.
    """
    fit, problem = frequency_fit(records, system, settings, delays=delays)
    if fit is None:
        return _failed_estimate(problem)
    return _estimate_of(fit, settings or FrequencySettings())


def frequency_fit(
    records: Sequence[Record],
    system: System,
    settings: FrequencySettings | None = None,
    *,
    delays: Mapping[str, str] | None = None,
) -> tuple[FrequencyFit | None, FrequencyProblem]:
    """Return the fit of ``fit_frequency_domain``, or None if no start has a finite cost, and the
    problem.
    """
    settings = settings or FrequencySettings()
    refuse_unfit(records, system, delays or {})
    problem = _problem(records, system, settings, delays or {})
    fit = from_best_start(problem, records)
    if fit is not None:
        bands = equal_bands([record.omega for record in problem.records])
        if levels_differ(
            fit.residuals, [record.usable for record in problem.records], bands, problem.floor
        ):
            with_several = fit_transforms(replace(problem, bands=tuple(bands)), fit)
            if with_several is not None and with_several.outcome is Outcome.CONVERGED:
                fit = with_several
    return fit, problem


def _scaled_for_leverage(fit: FrequencyFit, r: int, inverse: np.ndarray) -> np.ndarray:
    """Return the residuals ``(m, f)`` of record ``r``, divided by the root of one minus their
    leverage.

    This corrects for the part of the noise that the fit has absorbed (HC2 of MacKinnon and White,
    J. Econometrics 29, 1985). The leverage is a mean over real and imaginary parts. ``inverse (c,
    c)`` is the inverse information of the unknowns of the record.
    """
    slope = fit.slopes[r]
    leverage = (
        sum(np.einsum("mfc,cd,mfd->mf", part, inverse, part) for part in (slope.real, slope.imag))
        * 0.5
        * fit.weight(r)
    )
    return np.asarray(fit.residuals[r] / np.sqrt(np.maximum(1.0 - leverage, _LEAST_LEFT)))


def band_for(records: Sequence[Record], system: System) -> tuple[float, float]:
    """Return the default band, Hz: where the inputs have power, and wide enough for
    ``_NUMBERS_PER_UNKNOWN``.
    """
    free = [name for name in system.parameters.free_names if not name.startswith("bias_")]
    unknown = len(free) + len(records) * len(system.states)
    measured = max(
        sum(name in record.output_names for name in system.output_names) for record in records
    )
    fewest = int(np.ceil(_NUMBERS_PER_UNKNOWN * unknown / (2.0 * max(measured, 1))))
    return default_band(records, system.input_names, fewest)


def covariance_of(fit: FrequencyFit, *, colour: bool) -> tuple[np.ndarray, bool]:
    """Return the covariance ``(k, k)`` of all unknowns, corrected for the degrees of freedom, and
    whether all unknowns are observable.

    With ``colour`` the covariance uses the power of the residuals about each frequency (Morelli and
    Klein 1997), and their correlation between outputs, which gusts cause. No sigma is then below
    that for white residuals.
    """
    information, _ = fit.normal_equations
    full_inverse, determined = inverse_information(information, fit.theta)
    inverse, open_part = full_inverse, 0.0 * full_inverse
    if not determined:
        inverse, open_part = split_covariance(information, fit.theta)
    values = 2.0 * float(fit.counts.sum())
    white_covariance = inverse * values / max(values - len(fit.theta), 1.0)
    if not colour:
        return white_covariance + open_part, determined
    gradient_covariance = np.zeros_like(inverse)
    for r, slope in enumerate(fit.slopes):
        columns = fit.problem.columns(r)
        weighted = fit.weight(r)[:, :, None] * slope
        residual = _scaled_for_leverage(fit, r, inverse[np.ix_(columns, columns)])
        m = len(residual)
        cross_powers = means_over_neighbours(
            (residual[:, None] * np.conj(residual[None])).reshape(m * m, -1)
        ).reshape(m, m, -1)
        # Outputs that were not measured have zero weight.
        covariance = np.einsum(
            "ifc,ijf,jfd->cd", np.conj(weighted), cross_powers, weighted, optimize=True
        )
        gradient_covariance[np.ix_(columns, columns)] += 0.5 * covariance.real
    corrected = inverse @ gradient_covariance @ inverse
    white_variance, variance = np.diag(white_covariance), np.diag(corrected)
    ratio, least = np.ones_like(variance), np.maximum(variance, 1e-12 * white_variance)
    np.divide(white_variance, least, out=ratio, where=white_variance > 0.0)
    factor = np.sqrt(np.maximum(ratio, 1.0))
    return corrected * np.outer(factor, factor) + open_part, determined


def _problem(
    records: Sequence[Record],
    system: System,
    settings: FrequencySettings,
    delays: Mapping[str, str],
) -> FrequencyProblem:
    names = tuple(name for name in system.parameters.free_names if not name.startswith("bias_"))
    if not names:
        raise ModelError(
            "no parameter is free",
            where=f"model with {', '.join(system.parameters.names)}",
            remedy="release at least one",
        )
    band = settings.band or band_for(records, system)
    result = tuple(transformed(record, system, band) for record in records)
    items = [system.parameters[name] for name in names]
    prior = np.array([item.prior_std if settings.use_priors else np.inf for item in items]) ** -2.0
    low, high = np.array([item.bounds for item in items]).T.copy()
    return FrequencyProblem(
        system,
        result,
        {system.input_names.index(name): parameter for name, parameter in delays.items()},
        names,
        np.array([item.value for item in items]),
        low,
        high,
        prior,
        tuple(np.zeros(len(record.omega), dtype=int) for record in result),
    )


def refuse_unfit(records: Sequence[Record], system: System, delays: Mapping[str, str]) -> None:
    """Raise ModelError for a System without a frequency response that can be fitted."""
    where, remedy = f"model with states {', '.join(system.state_names)}", "use output-error"
    if not system.inputs:
        raise ModelError(
            "it has no input, and therefore no frequency response", where=where, remedy=remedy
        )
    if len(system.input_stages) > len(delays) or system.sensor_stages:
        stages = ", ".join((*system.input_stages, *system.sensor_stages))
        raise ModelError(f"{stages} act on the input or sensor path", where=where, remedy=remedy)
    nonlinear = first_nonlinear(system, records)
    if nonlinear:
        raise ModelError(
            f"{nonlinear} is no linear function of states and inputs: it has no frequency response",
            where=where,
            remedy=remedy,
        )


def from_best_start(problem: FrequencyProblem, records: Sequence[Record]) -> FrequencyFit | None:
    """Return the fit from the declared values or, if that does not converge and the record has all
    states, from equation error; None without a finite cost.
    """
    first = fit_transforms(problem)
    if first is not None and first.outcome is Outcome.CONVERGED:
        return first
    try:
        estimate = run_equation_error(records, problem.system)
    except FlightidError:
        return first
    if estimate.names != problem.names or not np.all(np.isfinite(estimate.values)):
        return first
    # The prior stays about the declared values: otherwise the data would count twice.
    start = np.clip(estimate.values, problem.low, problem.high)
    from_estimate = at_start(replace(problem, start=start))
    second = None if from_estimate is None else fit_transforms(problem, from_estimate)
    return min(
        (fit for fit in (first, second) if fit is not None), key=lambda fit: fit.cost, default=None
    )


def _estimate_of(fit: FrequencyFit, settings: FrequencySettings) -> Estimate:
    problem, q = fit.problem, len(fit.problem.names)
    covariance, determined = covariance_of(fit, colour=settings.coloured)
    exact = np.all(fit.levels <= 1e6 * problem.floor[:, None], axis=1)
    total = fit.counts.sum(axis=1)
    used = total > 0
    outcome = fit.outcome if determined else Outcome.NOT_IDENTIFIABLE
    if np.any(exact & used) and np.any(~exact & used):
        outcome = Outcome.DEGENERATE
    mean_level = np.sum(fit.levels * fit.counts, axis=1) / np.maximum(total, 1.0)
    noise = np.sqrt(np.where(used, mean_level, 1.0))
    return Estimate(
        METHOD,
        problem.names,
        tuple(problem.system.parameters[name].unit for name in problem.names),
        fit.theta[:q].copy(),
        covariance[:q, :q],
        outcome,
        fit.log_likelihood,
        problem.system.output_names,
        noise,
        tuple(_fitted_outputs(fit, r) for r in range(len(problem.records))),
        iterations=fit.iterations,
        message=_message(fit),
    )


def _fitted_outputs(fit: FrequencyFit, r: int) -> np.ndarray:
    """Return the outputs ``(m, N)`` of the model in record ``r``, within the band."""
    record, count = fit.problem.records[r], len(fit.problem.records[r].record)
    spectrum = np.zeros((len(fit.modelled[r]), count // 2 + 1), dtype=complex)
    spectrum[:, record.bins] = fit.modelled[r] * np.sqrt(count)
    return np.asarray(np.fft.irfft(spectrum, count))


def _message(fit: FrequencyFit) -> str:
    """Return the message of the estimate: harmonics, noise bands, interpolated samples."""
    hertz = np.concatenate([record.omega for record in fit.problem.records]) / (2.0 * np.pi)
    texts = [f"{len(hertz)} harmonics from {hertz.min():.3g} to {hertz.max():.3g} Hz"]
    if fit.levels.shape[1] > 1:
        texts.append(f"the noise level depends on frequency: {fit.levels.shape[1]} bands")
    bridged = sum(record.bridged for record in fit.problem.records)
    if bridged:
        texts.append(f"{bridged} missing samples interpolated")
    return "; ".join(texts)


def _failed_estimate(problem: FrequencyProblem) -> Estimate:
    """Return the estimate of a fit without a finite cost: the start, with large sigmas."""
    m = len(problem.system.outputs)
    return Estimate(
        METHOD,
        problem.names,
        tuple(problem.system.parameters[name].unit for name in problem.names),
        problem.start.copy(),
        np.diag(np.maximum(1.0, problem.start**2)),
        Outcome.DIVERGED,
        -LARGEST_NUMBER,
        problem.system.output_names,
        np.ones(m),
        tuple(np.zeros((m, len(record.record))) for record in problem.records),
    )
