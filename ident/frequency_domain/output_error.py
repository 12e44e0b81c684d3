"""Output error in the frequency domain: from records to an Estimate.

Klein and Morelli, Aircraft System Identification, ch. 7: complex least squares weighted by the noise found in each output. For linear
models alone; a delay of an input enters exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.estimate import LARGEST, Estimate, Outcome
from ident.frequency_domain.fit import FrequencyFit, FrequencyProblem, at_start, fit_transforms, with_bands
from ident.frequency_domain.linear_model import bent
from ident.frequency_domain.noise_spectrum import about_each, coloured, equal_bands, one_band
from ident.frequency_domain.transform import transformed, usual_band
from ident.regression.equation_error import run_equation_error
from ident.statistics.information import determined_and_open, inverse_information
from sim.declaration.model import System
from sim.errors import FlightidError, ModelError
from sim.record import Record

METHOD = "frequency-domain"
_LEAST_LEFT = 0.2  # of a residual, that a fit leaves where it follows a frequency as closely as it may
_SPARE = 2.0  # real numbers in the transforms for each unknown, at least


@dataclass(frozen=True)
class FrequencySettings:
    """How a fit runs: ``band`` in Hz (None: from the inputs' power), ``use_priors`` on parameters, ``coloured`` corrects sigmas for colour."""

    band: tuple[float, float] | None = None
    use_priors: bool = False
    coloured: bool = True


def fit_frequency_domain(
    records: Sequence[Record], system: System, settings: FrequencySettings | None = None, *, delays: Mapping[str, str] | None = None
) -> Estimate:
    """Fit the free parameters of a linear System to the transforms of records.

    Parameters
    ----------
    records : one or more, evenly sampled; each begins and ends as it will. Biases have no part in it.
    delays : input -> the parameter by which it is late, s; the only effect on the input path that may act.

    Returns
    -------
    Estimate of the shared free parameters. ``fitted`` are the outputs' transforms in the band turned back, without the mean: for a
    response to the samples simulate with the values found. ``message`` tells band, frequencies, and where the noise has several levels.
    Outcomes as of ``fit_output_error``.

    Raises
    ------
    ModelError : no input, a rate or output that is not linear, effects on the input or sensor path besides the delays, nothing to estimate.
    RecordError : uneven samples, missing ones, or no harmonic within the band.
    """
    fit, problem = frequency_fit(records, system, settings, delays=delays)
    return _failed(problem) if fit is None else _estimate_of(fit, settings or FrequencySettings())


def frequency_fit(
    records: Sequence[Record], system: System, settings: FrequencySettings | None = None, *, delays: Mapping[str, str] | None = None
) -> tuple[FrequencyFit | None, FrequencyProblem]:
    """The fit behind ``fit_frequency_domain``, None where no start has a finite cost, and the problem."""
    settings = settings or FrequencySettings()
    refuse_unfit(records, system, delays or {})
    problem = _posed(records, system, settings, delays or {})
    fit = from_best_start(problem, records)
    if fit is not None:
        bands = equal_bands([record.omega for record in problem.records])
        if coloured(fit.residuals, [record.known for record in problem.records], bands, problem.floor):
            again = fit_transforms(with_bands(problem, bands), fit)
            fit = fit if again is None or again.outcome is not Outcome.CONVERGED else again
    return fit, problem


def _as_if_left_out(fit: FrequencyFit, r: int, inverse: np.ndarray) -> np.ndarray:
    """Residuals ``(m, f)`` of a record, each as if it had had no part in the fit, which follows the strongest frequencies closely.

    Their squares are those over one less their leverage (MacKinnon and White, J. Econometrics 29, 1985: HC2); the leverage is the mean
    over both parts.
    """
    slope = fit.slopes[r]
    leverage = sum(np.einsum("mfc,cd,mfd->mf", part, inverse, part) for part in (slope.real, slope.imag)) * 0.5 * fit.weight(r)
    return np.asarray(fit.residuals[r] / np.sqrt(np.maximum(1.0 - leverage, _LEAST_LEFT)))


def band_for(records: Sequence[Record], system: System) -> tuple[float, float]:
    """The band (Hz) of a fit that is given none: where the inputs' power lies, and wide enough for as many harmonics as there are unknowns."""
    free = [name for name in system.parameters.free_names if not name.startswith("bias_")]
    unknown = len(free) + len(records) * len(system.states)
    measured = max(sum(name in record.output_names for name in system.output_names) for record in records)
    return usual_band(records, system.input_names, int(np.ceil(_SPARE * unknown / (2.0 * max(measured, 1)))))


def covariance_of(fit: FrequencyFit, *, colour: bool) -> tuple[np.ndarray, bool]:
    """Covariance of all unknowns and whether all are determined; larger by what the unknowns took from the noise levels.

    With ``colour`` the scatter of the gradient is formed with the residuals' power about each frequency (Morelli and Klein 1997 in the
    frequency domain), and with what the residuals of two outputs have in common there: gusts move all outputs. No sigma is below that of
    level noise.
    """
    information, _ = fit.normal_equations
    whole, determined = inverse_information(information, fit.theta)
    inverse, unknown = (whole, 0.0 * whole) if determined else determined_and_open(information, fit.theta)
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
        shared = about_each((residual[:, None] * np.conj(residual[None])).reshape(m * m, -1)).reshape(m, m, -1)
        # An output was measured with others, or it was not: where not, its weight is zero.
        middle[np.ix_(at, at)] += 0.5 * np.einsum("ifc,ijf,jfd->cd", np.conj(weighted), shared, weighted, optimize=True).real
    corrected = inverse @ middle @ inverse
    white, own = np.diag(level), np.diag(corrected)
    factor = np.sqrt(np.maximum(np.divide(white, np.maximum(own, 1e-12 * white), out=np.ones_like(own), where=white > 0.0), 1.0))
    return corrected * np.outer(factor, factor) + unknown, determined


def _posed(records: Sequence[Record], system: System, settings: FrequencySettings, delays: Mapping[str, str]) -> FrequencyProblem:
    names = tuple(name for name in system.parameters.free_names if not name.startswith("bias_"))
    if not names:
        raise ModelError("no parameter is free", where=f"model with {', '.join(system.parameters.names)}", remedy="release at least one")
    band = settings.band or band_for(records, system)
    found = tuple(transformed(record, system, band) for record in records)
    items = [system.parameters[name] for name in names]
    prior = np.array([item.prior_std if settings.use_priors else np.inf for item in items]) ** -2.0
    return FrequencyProblem(
        system,
        found,
        {system.input_names.index(name): parameter for name, parameter in delays.items()},
        names,
        np.array([item.value for item in items]),
        np.array([item.bounds[0] for item in items]),
        np.array([item.bounds[1] for item in items]),
        prior,
        tuple(one_band(len(record.omega)) for record in found),
    )


def refuse_unfit(records: Sequence[Record], system: System, delays: Mapping[str, str]) -> None:
    """Raise ModelError where a System has no frequency response that such a fit could use: see ``fit_frequency_domain``."""
    where, remedy = f"model with states {', '.join(system.state_names)}", "use output-error"
    if not system.inputs:
        raise ModelError("it has no input, to which a frequency response could be", where=where, remedy=remedy)
    if len(system.input_stages) > len(delays) or system.sensor_stages:
        stages = ", ".join((*system.input_stages, *system.sensor_stages))
        raise ModelError(f"{stages} act on the input or sensor path", where=where, remedy=remedy)
    crooked = bent(system, records)
    if crooked:
        what = f"{crooked} is no linear function of states and inputs: it has no frequency response"
        raise ModelError(what, where=where, remedy=remedy)


def from_best_start(problem: FrequencyProblem, records: Sequence[Record]) -> FrequencyFit | None:
    """The fit from the declared values; where it does not settle from equation error as well, if the record has all states. None: no finite cost."""
    first = fit_transforms(problem)
    if first is not None and first.outcome is Outcome.CONVERGED:
        return first
    try:
        found = run_equation_error(records, problem.system)
    except FlightidError:
        return first
    if found.names != problem.names or not np.all(np.isfinite(found.values)):
        return first
    # The prior stays about the declared values: the data are not to be counted twice.
    begun = at_start(replace(problem, start=np.clip(found.values, problem.low, problem.high)))
    second = None if begun is None else fit_transforms(problem, begun)
    return min((fit for fit in (first, second) if fit is not None), key=lambda fit: fit.cost, default=None)


def _estimate_of(fit: FrequencyFit, settings: FrequencySettings) -> Estimate:
    problem, q = fit.problem, len(fit.problem.names)
    covariance, determined = covariance_of(fit, colour=settings.coloured)
    exact = np.all(fit.levels <= 1e6 * problem.floor[:, None], axis=1)
    used = fit.counts.sum(axis=1) > 0
    outcome = fit.outcome if determined else Outcome.NOT_IDENTIFIABLE
    if np.any(exact & used) and np.any(~exact & used):
        outcome = Outcome.DEGENERATE
    total = fit.counts.sum(axis=1)
    noise = np.sqrt(np.where(used, np.sum(fit.levels * fit.counts, axis=1) / np.maximum(total, 1.0), 1.0))
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
    told = [f"{len(frequencies)} harmonics from {frequencies.min():.3g} to {frequencies.max():.3g} Hz"]
    if fit.levels.shape[1] > 1:
        told.append(f"the noise is not level along the frequency: {fit.levels.shape[1]} bands, each with its own")
    filled = sum(record.filled for record in fit.problem.records)
    if filled:
        told.append(f"{filled} missing samples bridged")
    return "; ".join(told)


def _failed(problem: FrequencyProblem) -> Estimate:
    """The start with sigmas as large as itself, for a fit that found no finite cost."""
    blank = tuple(np.zeros((len(problem.system.outputs), len(record.record))) for record in problem.records)
    units = tuple(problem.system.parameters[name].unit for name in problem.names)
    wide, ones = np.diag(np.maximum(1.0, problem.start**2)), np.ones(len(problem.system.outputs))
    return Estimate(METHOD, problem.names, units, problem.start.copy(), wide, Outcome.DIVERGED, -LARGEST, problem.system.output_names, ones, blank)
