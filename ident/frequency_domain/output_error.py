"""Output error in the frequency domain: the fit, profiled refits, and the Estimate.

Minus the log likelihood, constants left out, is sum over outputs i and bands b of n_ib ln(mean |Y -
Y_model|^2): transforms of noise are complex Gaussian, independent from harmonic to harmonic.
Unknown are the shared parameters and, of each record, x[0] - x[N].

Klein and Morelli, Aircraft System Identification, ch. 7: complex least squares weighted by the
noise found in each output. For linear models alone; a delay of an input enters exactly.
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
    about_each,
    bent,
    coloured,
    equal_bands,
    levels,
    linear_model,
    one_band,
    response,
    transformed,
    usual_band,
)
from ident.regression.equation_error import run_equation_error
from ident.statistics import profile_likelihood
from ident.statistics.intervals import add_normal_equations, inverse_information, split_covariance
from ident.statistics.minimise import Descent, LocalModel, cost_rounding, local_model, minimise
from ident.statistics.profile_likelihood import ProfileInterval
from sim.declaration.model import System
from sim.errors import FlightidError, ModelError
from sim.record import Record

# ---- Output error in the frequency domain

_PROGRESS_STEPS = 8  # steps over which the progress is measured
# log likelihood (0.04 sigmas): a smaller gain over these steps ends the search
_NEGLIGIBLE_GAIN = 1e-3
_EXACT_FIT_SHARE = 1e-24  # largest residual of an exact fit, relative to an output's mean square


@dataclass(frozen=True, eq=False)
class FrequencyProblem:
    """A fit of a linear System to transforms of records.

    Attributes
    ----------
    system : linear.
    records : their transforms.
    delays : position of an input -> name of its delay parameter.
    names : the shared parameters.
    start, low, high : of them, ``(q,)``.
    prior : information on each, ``(q,)``, about the start; zero: none.
    bands : of each record, the noise band of each frequency.
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
        """Places of the shared parameters among the System's."""
        return tuple(self.system.parameters.index(name) for name in self.names)

    @cached_property
    def floor(self) -> np.ndarray:
        """Mean square below which an output is met to rounding, ``(m,)``."""
        power = np.sum(
            [np.sum(np.abs(record.outputs) ** 2, axis=1) for record in self.records], axis=0
        )
        return np.maximum(
            _EXACT_FIT_SHARE * power / sum(len(record.omega) for record in self.records), 1e-60
        )

    def columns(self, r: int) -> np.ndarray:
        """Return the positions in theta of the unknowns of record ``r``: the shared parameters and
        its own ends.
        """
        q, n = len(self.names), len(self.system.states)
        return np.concatenate([np.arange(q), q + r * n + np.arange(n)])

    @property
    def open(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest values of all unknowns; the end terms have no bounds."""
        free = np.full(len(self.records) * len(self.system.states), np.inf)
        return np.concatenate([self.low, -free]), np.concatenate([self.high, free])


@dataclass(frozen=True, eq=False)
class FrequencyFit:
    """A fit, finished or in progress.

    ``theta (k,)``; by record ``modelled (m, f)``, ``residuals (m, f)`` and ``slopes (m, f, c)``;
    ``levels (m, b)`` of noise; ``counts (m, b)`` of complex residuals; ``cost``: minus the log
    likelihood without constants, with the prior's term.
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
        """Return one over the variance of a real or imaginary part, ``(m, f)``, zero where an
        output was not recorded.
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
        """The log likelihood about this point, within the bounds."""
        return local_model(*self.normal_equations, self.theta, *self.problem.open)


def at_start(problem: FrequencyProblem) -> FrequencyFit | None:
    """The fit at the starting parameters, with the best ends of each record; None if not finite."""
    n, q = len(problem.system.states), len(problem.names)
    fit = evaluate(problem, np.concatenate([problem.start, np.zeros(n * len(problem.records))]))
    if fit is None:
        return None
    theta = fit.theta.copy()
    for r, (residual, slope) in enumerate(zip(fit.residuals, fit.slopes, strict=True)):
        root = np.sqrt(fit.weight(r))
        rows = (root[:, :, None] * slope[:, :, q:]).reshape(-1, n), (root * residual).ravel()
        real = [np.concatenate([each.real, each.imag]) for each in rows]
        theta[problem.columns(r)[q:]] += np.linalg.lstsq(real[0], real[1], rcond=None)[0]
    better = evaluate(problem, theta)
    return better if better is not None and better.cost < fit.cost else fit


def evaluate(problem: FrequencyProblem, theta: np.ndarray) -> FrequencyFit | None:
    """Return the residuals and slopes at ``theta``; None where they are not finite."""
    q, p = len(problem.names), problem.system.parameters.values()
    p[list(problem.positions)] = theta[:q]
    modelled, residuals, slopes = [], [], []
    with np.errstate(all="ignore"):
        model = linear_model(problem.system, p, problem.positions)
        delays = {i: _delay(problem, name, p) for i, name in problem.delays.items()}
        for r, record in enumerate(problem.records):
            try:
                result = response(model, record, delays, theta[problem.columns(r)[q:]])
            # a root at a harmonic, or overflow
            except (np.linalg.LinAlgError, ValueError):
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
    level, counts = levels(residuals, usable, problem.bands, problem.floor)
    away = theta[:q] - problem.start
    cost = float(np.sum(counts * np.log(level))) + 0.5 * float(away @ (problem.prior * away))
    return FrequencyFit(
        problem, theta, tuple(modelled), tuple(residuals), tuple(slopes), level, counts, cost
    )


def fit_transforms(
    problem: FrequencyProblem, begun: FrequencyFit | None = None
) -> FrequencyFit | None:
    """Levenberg-Marquardt from the start, or from another fit; None if no cost was finite.

    Outcomes ``CONVERGED`` and ``MAX_ITERATIONS``; the caller checks observability.
    """
    fit = (
        at_start(problem)
        if begun is None
        else evaluate(problem, np.clip(begun.theta, *problem.open))
    )
    if fit is None:
        return None
    costs, refused = [fit.cost], [False]

    def trial(fit: FrequencyFit, model: LocalModel, damping: float) -> FrequencyFit | None:
        theta = np.clip(fit.theta + model.scale * model.step(damping), *problem.open)
        tried = evaluate(problem, theta)
        if tried is not None and not tried.cost <= fit.cost + cost_rounding(
            float(fit.counts.sum())
        ):
            tried = None
        costs.append(fit.cost if tried is None else tried.cost)
        refused.append(tried is None)
        return tried

    def settled(fit: FrequencyFit, model: LocalModel) -> bool:
        return model.predicted_gain < 0.5 * problem.tolerance**2 or _between(costs, refused)

    solution = minimise(Descent(lambda fit: fit.model, trial, settled), fit, problem.iterations)
    done = settled(solution.point, solution.model)
    return replace(
        solution.point,
        outcome=Outcome.CONVERGED if done else Outcome.MAX_ITERATIONS,
        iterations=solution.steps,
    )


def _between(costs: Sequence[float], refused: Sequence[bool]) -> bool:
    """Return whether no step to either side lowers the cost: a delay of whole samples is a kink."""
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


# ---- Refits of a fit in the frequency domain with one parameter held


def profile_intervals(
    fit: FrequencyFit, names: Sequence[str], covariance: np.ndarray
) -> tuple[ProfileInterval, ...]:
    """Return intervals of the parameters ``names``; ``covariance (q, q)``: the printed one, whose
    ratio to the white one scales the threshold.
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
    """Return a function of a value of parameter ``j`` that refits the others and gives the cost."""

    def refit(value: float, begun: FrequencyFit | None) -> tuple[float, FrequencyFit] | None:
        near = begun or fit
        theta = near.theta + along * (value - near.theta[j])
        low, high = fit.problem.low.copy(), fit.problem.high.copy()
        low[j] = high[j] = value
        # Priors stay about the fit's own start: only the bounds differ.
        result = fit_transforms(
            replace(fit.problem, low=low, high=high), replace(near, theta=theta)
        )
        return None if result is None else (result.cost, result)

    return refit


# ---- Output error in the frequency domain: from records to an Estimate

METHOD = "frequency-domain"
_LEAST_LEFT = 0.2  # smallest remaining share of a residual at a frequency
_NUMBERS_PER_UNKNOWN = 2.0  # fewest real numbers per unknown


@dataclass(frozen=True)
class FrequencySettings:
    """Options of a fit: ``band`` in Hz (None: from the power of the inputs), ``use_priors`` on
    parameters, ``coloured`` to correct sigmas for coloured residuals.
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
    records : one or more, evenly sampled; each begins and ends as it will. Biases have no part in
        it.
    delays : input -> its delay parameter, s; the only effect on the input path that
        may act.

    Returns
    -------
    Estimate of the shared free parameters. ``fitted`` are the outputs' transforms in the band
    turned back, without the mean: for a response to the samples simulate with the values found.
    ``message`` tells band, frequencies, and where the noise has several levels. Outcomes as of
    ``fit_output_error``.

    Raises
    ------
    ModelError : no input, a rate or output that is not linear, effects on the input or sensor path
        besides the delays, nothing to estimate.
    RecordError : uneven samples, missing ones, or no harmonic within the band.
    """
    fit, problem = frequency_fit(records, system, settings, delays=delays)
    return _failed(problem) if fit is None else _estimate_of(fit, settings or FrequencySettings())


def frequency_fit(
    records: Sequence[Record],
    system: System,
    settings: FrequencySettings | None = None,
    *,
    delays: Mapping[str, str] | None = None,
) -> tuple[FrequencyFit | None, FrequencyProblem]:
    """The fit of ``fit_frequency_domain``, None if no start has a finite cost, and the problem."""
    settings = settings or FrequencySettings()
    refuse_unfit(records, system, delays or {})
    problem = _problem_of(records, system, settings, delays or {})
    fit = from_best_start(problem, records)
    if fit is not None:
        bands = equal_bands([record.omega for record in problem.records])
        if coloured(
            fit.residuals, [record.usable for record in problem.records], bands, problem.floor
        ):
            again = fit_transforms(with_bands(problem, bands), fit)
            fit = fit if again is None or again.outcome is not Outcome.CONVERGED else again
    return fit, problem


def _as_if_left_out(fit: FrequencyFit, r: int, inverse: np.ndarray) -> np.ndarray:
    """Return the residuals ``(m, f)`` scaled for their leverage, as if their record had not been
    fitted.

    Their squares are divided by one minus the leverage (MacKinnon and White, J. Econometrics 29,
    1985: HC2), the mean over real and imaginary parts.
    """
    slope = fit.slopes[r]
    leverage = (
        sum(np.einsum("mfc,cd,mfd->mf", part, inverse, part) for part in (slope.real, slope.imag))
        * 0.5
        * fit.weight(r)
    )
    return np.asarray(fit.residuals[r] / np.sqrt(np.maximum(1.0 - leverage, _LEAST_LEFT)))


def band_for(records: Sequence[Record], system: System) -> tuple[float, float]:
    """Band (Hz) of a fit without a given one: where the inputs have power, and wide enough for as
    many harmonics as unknowns.
    """
    free = [name for name in system.parameters.free_names if not name.startswith("bias_")]
    unknown = len(free) + len(records) * len(system.states)
    measured = max(
        sum(name in record.output_names for name in system.output_names) for record in records
    )
    return usual_band(
        records,
        system.input_names,
        int(np.ceil(_NUMBERS_PER_UNKNOWN * unknown / (2.0 * max(measured, 1)))),
    )


def covariance_of(fit: FrequencyFit, *, colour: bool) -> tuple[np.ndarray, bool]:
    """Return the covariance of all unknowns, and whether all are observable; corrected for the
    degrees of freedom.

    With ``colour`` the scatter of the gradient uses the power of the residuals about each frequency
    (Morelli and Klein 1997) and their correlation between outputs, which gusts cause. No sigma is
    below that of white residuals.
    """
    information, _ = fit.normal_equations
    whole, determined = inverse_information(information, fit.theta)
    inverse, unknown = (
        (whole, 0.0 * whole) if determined else split_covariance(information, fit.theta)
    )
    values = 2.0 * float(fit.counts.sum())
    level = inverse * values / max(values - len(fit.theta), 1.0)
    if not colour:
        return level + unknown, determined
    middle = np.zeros_like(inverse)
    for r, slope in enumerate(fit.slopes):
        at = fit.problem.columns(r)
        weighted = fit.weight(r)[:, :, None] * slope
        residual = _as_if_left_out(fit, r, inverse[np.ix_(at, at)])
        m = len(residual)
        shared = about_each(
            (residual[:, None] * np.conj(residual[None])).reshape(m * m, -1)
        ).reshape(m, m, -1)
        # Outputs that were not measured have zero weight.
        middle[np.ix_(at, at)] += (
            0.5
            * np.einsum("ifc,ijf,jfd->cd", np.conj(weighted), shared, weighted, optimize=True).real
        )
    corrected = inverse @ middle @ inverse
    white, own = np.diag(level), np.diag(corrected)
    factor = np.sqrt(
        np.maximum(
            np.divide(
                white, np.maximum(own, 1e-12 * white), out=np.ones_like(own), where=white > 0.0
            ),
            1.0,
        )
    )
    return corrected * np.outer(factor, factor) + unknown, determined


def _problem_of(
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
    return FrequencyProblem(
        system,
        result,
        {system.input_names.index(name): parameter for name, parameter in delays.items()},
        names,
        np.array([item.value for item in items]),
        np.array([item.bounds[0] for item in items]),
        np.array([item.bounds[1] for item in items]),
        prior,
        tuple(one_band(len(record.omega)) for record in result),
    )


def refuse_unfit(records: Sequence[Record], system: System, delays: Mapping[str, str]) -> None:
    """Raise ModelError for a System without a frequency response that can be fitted."""
    where, remedy = f"model with states {', '.join(system.state_names)}", "use output-error"
    if not system.inputs:
        raise ModelError(
            "it has no input, to which a frequency response could be", where=where, remedy=remedy
        )
    if len(system.input_stages) > len(delays) or system.sensor_stages:
        stages = ", ".join((*system.input_stages, *system.sensor_stages))
        raise ModelError(f"{stages} act on the input or sensor path", where=where, remedy=remedy)
    crooked = bent(system, records)
    if crooked:
        what = f"{crooked} is no linear function of states and inputs: it has no frequency response"
        raise ModelError(what, where=where, remedy=remedy)


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
    # The prior stays about the declared values: the data are not to be counted twice.
    moved = at_start(replace(problem, start=np.clip(estimate.values, problem.low, problem.high)))
    second = None if moved is None else fit_transforms(problem, moved)
    return min(
        (fit for fit in (first, second) if fit is not None), key=lambda fit: fit.cost, default=None
    )


def _estimate_of(fit: FrequencyFit, settings: FrequencySettings) -> Estimate:
    problem, q = fit.problem, len(fit.problem.names)
    covariance, determined = covariance_of(fit, colour=settings.coloured)
    exact = np.all(fit.levels <= 1e6 * problem.floor[:, None], axis=1)
    used = fit.counts.sum(axis=1) > 0
    outcome = fit.outcome if determined else Outcome.NOT_IDENTIFIABLE
    if np.any(exact & used) and np.any(~exact & used):
        outcome = Outcome.DEGENERATE
    total = fit.counts.sum(axis=1)
    noise = np.sqrt(
        np.where(used, np.sum(fit.levels * fit.counts, axis=1) / np.maximum(total, 1.0), 1.0)
    )
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
        tuple(_turned_back(fit, r) for r in range(len(problem.records))),
        iterations=fit.iterations,
        message=_said(fit),
    )


def _turned_back(fit: FrequencyFit, r: int) -> np.ndarray:
    record, count = fit.problem.records[r], len(fit.problem.records[r].record)
    whole = np.zeros((len(fit.modelled[r]), count // 2 + 1), dtype=complex)
    whole[:, record.bins] = fit.modelled[r] * np.sqrt(count)
    return np.asarray(np.fft.irfft(whole, count))


def _said(fit: FrequencyFit) -> str:
    frequencies = np.concatenate([record.omega for record in fit.problem.records]) / (2.0 * np.pi)
    texts = [
        f"{len(frequencies)} harmonics from {frequencies.min():.3g} to {frequencies.max():.3g} Hz"
    ]
    if fit.levels.shape[1] > 1:
        texts.append(
            f"the noise is not level along the frequency: {fit.levels.shape[1]} bands, each with "
            "its own"
        )
    filled = sum(record.filled for record in fit.problem.records)
    if filled:
        texts.append(f"{filled} missing samples bridged")
    return "; ".join(texts)


def _failed(problem: FrequencyProblem) -> Estimate:
    """Return the start with sigmas as large as itself, for a fit that found no finite cost."""
    blank = tuple(
        np.zeros((len(problem.system.outputs), len(record.record))) for record in problem.records
    )
    units = tuple(problem.system.parameters[name].unit for name in problem.names)
    wide, ones = np.diag(np.maximum(1.0, problem.start**2)), np.ones(len(problem.system.outputs))
    return Estimate(
        METHOD,
        problem.names,
        units,
        problem.start.copy(),
        wide,
        Outcome.DIVERGED,
        -LARGEST_NUMBER,
        problem.system.output_names,
        ones,
        blank,
    )
