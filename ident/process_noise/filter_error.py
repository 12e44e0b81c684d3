"""Filter-error fit: maximum likelihood with process noise, over one or several whole records.

The parameters of the vehicle, the levels of the measurement noise, and the parameters of the
process noise (intensity and scale length of turbulence) are estimated together. See Maine and
Iliff, NASA RP-1168 (1985), and Jategaonkar, Flight Vehicle System Identification, ch. 5.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.process_noise.best_start import (
    COARSE_TOLERANCE,
    degenerate,
    fit_from_best_start,
    fit_with_process_noise,
    implausibly_small_sigmas,
    noise_start,
    without_measurement_noise,
)
from ident.process_noise.innovations_model import (
    SCALE,
    ProcessNoise,
    filters_of,
    has_process_noise,
    process_noise,
    restricted_levels,
)
from ident.statistics.residual_spectrum import student_factor
from ident.statistics.residuals import ljung_box
from ident.whole_record.gauss_newton import Fit, fit_whole_records
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.output_error import (
    cut_into_pieces,
    failed_estimate,
    fit_covariance,
    grows_little,
    join_pieces,
    pieces_message,
    with_starting_values,
    with_unstable_start,
)
from sim.declaration.model import System
from sim.errors import ModelError
from sim.record import Record

METHOD = "filter-error"
_LJUNG_BOX_LAGS = 25  # lags of the autocorrelation in the whiteness test
__all__ = [
    "filter_error_estimate",
    "fit_filter_error",
    "fit_with_fixed_noise",
    "fit_with_process_noise",
    "noise_levels",
    "noise_start",
    "one_step_prediction",
    "residual_whiteness_p_value",
]


def fit_filter_error(
    records: Sequence[Record],
    system: System,
    settings: FitSettings | None = None,
    *,
    calm: System | None = None,
    local: Collection[str] = (),
) -> Estimate:
    """Return the maximum-likelihood estimate of a System with process noise, from the innovations
    of a Kalman filter.

    Parameters
    ----------
    records : one or more; each has its own initial state and its own ``bias_*`` parameters.
    system : model in its form for whole records. White noise acts on a state: by a noise effect,
        whose free parameters are estimated, or as declared process noise, whose standard deviation
        gets one estimated factor.
    settings : settings of the fit; None takes the defaults.
    calm : the same model without the noise effect; its equation error gives a second start.
    local : names of further parameters of which each record has its own value.

    Returns
    -------
    Estimate of the shared free parameters and, for declared process noise, of
    ``process_noise_scale``. ``noise_std`` are the estimated levels of the measurement noise.
    ``log_likelihood`` may be compared with that of an output-error fit of the same data.
    ``fitted`` are one-step predictions, so that measured minus fitted are the innovations. The
    outcomes are those of `fit_output_error`. ``DEGENERATE`` is also returned where the noise level
    of an output is at its limit, or a sigma is smaller than the record can give.

    Raises
    ------
    ModelError : where no white noise acts on a state, a record has none of the outputs, or nothing
        is free.
    """
    settings = settings or FitSettings()
    if not has_process_noise(system):
        raise ModelError(
            "no white noise acts on a state",
            where=f"model with states {', '.join(system.state_names)}",
            remedy="add a noise effect, declare process noise, or use output-error",
        )
    first, fit = _estimate_and_fit(records, system, settings, calm or system, local)
    # With the settings of a stable start, a fit that ends at an unstable motion may stop too early.
    if fit is not None and fit.outcome is Outcome.CONVERGED and grows_little(fit.layout, fit.theta):
        return first
    unstable = with_unstable_start(records, calm or system, settings, local)
    if unstable is None:
        return first
    values = zip(unstable.parameters.names, unstable.parameters.values().tolist(), strict=True)
    started = with_starting_values(
        system, {name: value for name, value in values if name in system.parameters}
    )
    second, fit = _estimate_and_fit(records, started, settings, unstable, local)
    if fit is not None and fit.outcome is Outcome.CONVERGED and _may_replace(second, first):
        return second
    return first


def _may_replace(second: Estimate, first: Estimate) -> bool:
    """Return whether a second estimate of the same records may replace the first: the first has not
    converged, or both have and the likelihood is no lower.
    """
    if first.outcome is not Outcome.CONVERGED:
        return True
    return second.outcome is Outcome.CONVERGED and second.log_likelihood >= first.log_likelihood


def _estimate_and_fit(
    records: Sequence[Record],
    system: System,
    settings: FitSettings,
    calm: System,
    local: Collection[str],
) -> tuple[Estimate, Fit | None]:
    """Return the estimate from the starting values of the System, and its fit; the fit is None
    where no cost is finite.
    """
    pieces = cut_into_pieces(records, calm, settings, local)
    all_pieces = [piece for record_pieces in pieces for piece in record_pieces]
    layout = lay_out(all_pieces, system, settings, local=local)
    if not layout.shared:
        raise ModelError(
            "no parameter is free",
            where=f"model with {', '.join(system.parameters.names)}",
            remedy="release at least one",
        )
    fit = fit_from_best_start(layout, calm)
    estimate = failed_estimate(layout, METHOD) if fit is None else filter_error_estimate(fit)
    estimate = replace(
        estimate, fitted=join_pieces(estimate.fitted, pieces), message=pieces_message(pieces)
    )
    return estimate, fit


def noise_levels(fit: Fit) -> dict[str, float]:
    """Return output -> standard deviation of its measurement noise, and for a fit with process
    noise also ``process_noise_scale`` -> scale of declared process noise.

    `fit_with_process_noise` and `fit_with_fixed_noise` take these levels.
    """
    noise_model = fit.noise_model
    if not isinstance(noise_model, ProcessNoise):
        return dict(
            zip(fit.layout.system.output_names, np.sqrt(fit.variance).tolist(), strict=True)
        )
    std, scale = noise_model.levels(fit.theta)
    return {**dict(zip(noise_model.outputs, std.tolist(), strict=True)), SCALE: scale}


def filter_error_estimate(fit: Fit) -> Estimate:
    """Return the shared parameters of a fit with process noise, and the scale of declared process
    noise, as an Estimate.

    Noise levels and turbulence parameters are those of the restricted likelihood
    (`ident.process_noise.innovations_model`). Sigmas include the uncertainty of the noise levels:
    they are multiplied by a ratio of Student's to the normal quantile.
    """
    layout, system, noise_model = fit.layout, fit.layout.system, fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    covariance, determined = fit_covariance(fit)
    levels, variance = restricted_levels(fit, covariance), np.diag(covariance)
    widening = student_factor(variance, levels.log_variance * variance**2)
    theta, factor = levels.theta, levels.factor * widening
    covariance = covariance * np.outer(factor, factor)
    scaled = noise_model.scaled
    outcome = fit.outcome if determined else Outcome.NOT_IDENTIFIABLE
    if not without_measurement_noise(fit):
        sigmas = np.sqrt(np.diag(covariance))[: len(layout.shared)]
        if degenerate(fit) or implausibly_small_sigmas(fit, sigmas):
            outcome = Outcome.DEGENERATE
    returned = [*range(len(layout.shared)), *([len(fit.theta) - 1] if scaled else [])]
    return Estimate(
        METHOD,
        (*layout.shared, *([SCALE] if scaled else [])),
        (*(system.parameters[name].unit for name in layout.shared), *(["1"] if scaled else [])),
        theta[returned],
        covariance[np.ix_(returned, returned)],
        outcome,
        fit.log_likelihood,
        system.output_names,
        noise_model.levels(theta)[0],
        tuple(one_step_prediction(fit, r) for r in range(len(fit.linearisations))),
        iterations=fit.iterations,
    )


def one_step_prediction(fit: Fit, r: int) -> np.ndarray:
    """Return the outputs ``(m, N)`` of record ``r``, each predicted from the samples before it."""
    problem, filter = fit.layout.problems[r], filters_of(fit.weighted)[r]
    motion, state = filter.whitener.motion, filter.residual.state[:, :, None]
    predicted = np.zeros_like(state)
    predicted[1:] = motion.Phi @ state[:-1]
    deviation = (motion.H @ predicted)[problem.grid.sample // problem.grid.substeps, :, 0]
    return np.asarray(fit.linearisations[r].y + deviation.T)


def residual_whiteness_p_value(fit: Fit) -> float:
    """Return the p-value of the hypothesis that the residuals of a fit are white.

    It is the smallest p-value of the Ljung-Box test over outputs and records, times the number of
    tests (Bonferroni's correction). A small value speaks for process noise such as turbulence.
    """
    p_values = [
        ljung_box(residual[i], problem.valid[i], name, _LJUNG_BOX_LAGS).p_value
        for problem, residual in zip(fit.layout.problems, fit.residuals, strict=True)
        for i, name in enumerate(fit.layout.system.output_names)
        if np.any(problem.valid[i])
    ]
    return float(min(1.0, len(p_values) * min(p_values)))


def fit_with_fixed_noise(
    records: Sequence[Record],
    system: System,
    values: Mapping[str, float],
    levels: Mapping[str, float],
    settings: FitSettings | None = None,
    *,
    local: Collection[str] = (),
    masks: Sequence[np.ndarray] | None = None,
    begin: Sequence[Mapping[str, float]] = (),
    freed: Collection[str] = (),
) -> Fit | None:
    """Return the fit of the local parameters to held-out records, with fixed noise levels; None
    where no cost is finite.

    The log likelihood of the fit is that of one-step predictions. The log likelihoods of two models
    are comparable for the same records, masks and local parameters.

    Parameters
    ----------
    records : held-out records.
    system : model, with or without process noise. Without it, the predictions are a free
        simulation.
    values : parameter -> fixed value.
    levels : output -> fixed measurement noise, and the fixed ``process_noise_scale`` where the
        model has one, as `noise_levels` returns them.
    local : names of the parameters that are fitted to each record, as are the initial states and
        ``bias_*``.
    masks : ``(m, N)`` of each record, False where a sample does not count.
    begin : for each record, local parameter -> starting value; other local parameters start at
        their declared values. The time of an event needs such a start, since a fit does not find it
        from far away.
    freed : names of further parameters. A second fit estimates these for each record too, starting
        from ``values``.
    """
    fitted_names = {
        name for name in system.parameters.free_names if name.startswith("bias_") or name in local
    }
    parameters = system.parameters.with_values(
        {name: value for name, value in values.items() if name in system.parameters}
    ).only_free(fitted_names)
    fixed_system = replace(system, parameters=parameters)
    settings = settings or FitSettings()
    if not fitted_names and not any(item.free for item in system.initial):
        raise ModelError(
            "no initial state and no bias is free",
            where=f"model with {', '.join(system.parameters.names)}",
            remedy="release at least one",
        )
    layout = lay_out(records, fixed_system, settings, local=local, masks=masks)
    for r, values_of_record in enumerate(begin):
        positions = layout.columns(r)[len(layout.shared) :]
        for name, position in zip(layout.local, positions, strict=False):
            layout.start[position] = values_of_record.get(name, layout.start[position])
    # A first fit without process noise gives a trajectory near the record.
    output_error_fit = fit_whole_records(
        FitProblem(replace(layout, settings=replace(settings, tolerance=COARSE_TOLERANCE)))
    )
    if output_error_fit is None:
        return None
    noise_model = process_noise(fixed_system, levels, (), fixed=True, scale=levels.get(SCALE, 1.0))
    fit = fit_whole_records(
        FitProblem(replace(layout, start=output_error_fit.theta), noise_model),
        output_error_fit.trajectories,
    )
    if fit is None or not freed:
        return fit
    freed_system = replace(fixed_system, parameters=parameters.only_free({*fitted_names, *freed}))
    freed_layout = lay_out(records, freed_system, settings, local=[*local, *freed], masks=masks)
    fitted = dict(zip(fit.layout.names, fit.theta.tolist(), strict=True))
    start = [
        fitted.get(name, declared)
        for name, declared in zip(freed_layout.names, freed_layout.start.tolist(), strict=True)
    ]
    return fit_whole_records(
        FitProblem(replace(freed_layout, start=np.array(start)), noise_model),
        fit.trajectories,
    )
