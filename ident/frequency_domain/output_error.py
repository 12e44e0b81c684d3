"""Output error in the frequency domain: from records to an Estimate.

Complex least squares, weighted by the noise found in each output (Klein and Morelli, Aircraft
System Identification, ch. 7). The model must be linear; a delay of an input is represented exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.estimate import LARGEST_NUMBER, Estimate, Outcome
from ident.frequency_domain.fit import (
    FrequencyFit,
    FrequencyProblem,
    at_start,
    fit_transforms,
    with_bands,
)
from ident.frequency_domain.transform import (
    default_band,
    equal_bands,
    first_nonlinear,
    levels_differ,
    means_over_neighbours,
    one_band,
    transformed,
)
from ident.regression.equation_error import run_equation_error
from ident.statistics.intervals import inverse_information, split_covariance
from sim.declaration.model import System
from sim.errors import FlightidError, ModelError
from sim.record import Record

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
    return (
        _failed_estimate(problem)
        if fit is None
        else _estimate_of(fit, settings or FrequencySettings())
    )


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
            with_several = fit_transforms(with_bands(problem, bands), fit)
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
    return default_band(
        records,
        system.input_names,
        int(np.ceil(_NUMBERS_PER_UNKNOWN * unknown / (2.0 * max(measured, 1)))),
    )


def covariance_of(fit: FrequencyFit, *, colour: bool) -> tuple[np.ndarray, bool]:
    """Return the covariance ``(k, k)`` of all unknowns, corrected for the degrees of freedom, and
    whether all unknowns are observable.

    With ``colour`` the covariance uses the power of the residuals about each frequency (Morelli and
    Klein 1997), and their correlation between outputs, which gusts cause. No sigma is then below
    that for white residuals.
    """
    information, _ = fit.normal_equations
    full_inverse, determined = inverse_information(information, fit.theta)
    inverse, open_part = (
        (full_inverse, 0.0 * full_inverse)
        if determined
        else split_covariance(information, fit.theta)
    )
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
    factor = np.sqrt(
        np.maximum(
            np.divide(
                white_variance,
                np.maximum(variance, 1e-12 * white_variance),
                out=np.ones_like(variance),
                where=white_variance > 0.0,
            ),
            1.0,
        )
    )
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
            "it has no input, and therefore no frequency response", where=where, remedy=remedy
        )
    if len(system.input_stages) > len(delays) or system.sensor_stages:
        stages = ", ".join((*system.input_stages, *system.sensor_stages))
        raise ModelError(f"{stages} act on the input or sensor path", where=where, remedy=remedy)
    nonlinear = first_nonlinear(system, records)
    if nonlinear:
        what = (
            f"{nonlinear} is no linear function of states and inputs: it has no frequency response"
        )
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
    frequencies = np.concatenate([record.omega for record in fit.problem.records]) / (2.0 * np.pi)
    texts = [
        f"{len(frequencies)} harmonics from {frequencies.min():.3g} to {frequencies.max():.3g} Hz"
    ]
    if fit.levels.shape[1] > 1:
        texts.append(f"the noise level depends on frequency: {fit.levels.shape[1]} bands")
    bridged = sum(record.bridged for record in fit.problem.records)
    if bridged:
        texts.append(f"{bridged} missing samples interpolated")
    return "; ".join(texts)


def _failed_estimate(problem: FrequencyProblem) -> Estimate:
    """Return the estimate of a fit without a finite cost: the start, with large sigmas."""
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
