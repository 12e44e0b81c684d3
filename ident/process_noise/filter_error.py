"""Filter-error fit: maximum likelihood with process noise, over one or several whole records.

Maine and Iliff, NASA RP-1168 (1985); Jategaonkar, Flight Vehicle System Identification, ch. 5.
Measurement noise levels, the parameters of the process noise (turbulence's intensity and length)
and those of the vehicle are estimated together.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.process_noise.best_start import (
    COARSE_TOLERANCE,
    absurd_sigmas,
    degenerate,
    fit_from_best_start,
    fit_with_process_noise,
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
    failed_estimate,
    fit_covariance,
    in_pieces,
    pieces_message,
    put_together,
    quiet,
    with_starting_values,
    with_unstable_start,
)
from sim.declaration.model import System
from sim.errors import ModelError
from sim.record import Record

METHOD = "filter-error"
_LJUNG_BOX_LAGS = 25  # lags of the autocorrelation that the whiteness test sums
__all__ = [
    "filter_error_estimate",
    "fit_filter_error",
    "fit_under_held_noise",
    "fit_with_process_noise",
    "noise_levels",
    "noise_start",
    "one_step_prediction",
    "predictive_log_likelihood",
    "turbulence_worth_trying",
]


def fit_filter_error(
    records: Sequence[Record],
    system: System,
    settings: FitSettings | None = None,
    *,
    calm: System | None = None,
    local: Collection[str] = (),
) -> Estimate:
    """Fit the free parameters of a System with process noise to records by the innovations of a
    Kalman filter.

    Parameters
    ----------
    records : one or more; each has its own initial state and its own ``bias_*`` parameters.
    system : not compiled on line; white noise acts on a state, by a noise effect or as declared.
        Free parameters of a noise effect are estimated; declared process noise gets one factor
        on its standard deviation.
    calm : the same model without the noise effect; equation error of it gives a second start.
    local : further parameters of which each record has its own; they are not returned.

    Returns
    -------
    Estimate of the shared free parameters and, for declared process noise, of
    ``process_noise_scale``. ``noise_std`` are the estimated levels of the measurement noise;
    ``log_likelihood`` compares with that of an output-error fit of the same data. ``fitted`` is
    predicted one step ahead: measured minus fitted are the innovations. Outcomes as of
    ``fit_output_error``; ``DEGENERATE`` where the noise of an output has run to its limit, or a
    sigma is smaller than the record can give.

    Raises
    ------
    ModelError : nothing forces a state, a record without any of the outputs, or nothing to
    estimate.
    """
    settings = settings or FitSettings()
    if not has_process_noise(system):
        raise ModelError(
            "no white noise forces a state",
            where=f"model with states {', '.join(system.state_names)}",
            remedy="add a noise effect, declare process noise, or use output-error",
        )
    found, fit = _estimate_and_fit(records, system, settings, calm or system, local)
    # A fit that ends unstable from a stable start used settings for stable motion, and may have
    # stopped early.
    if fit is not None and fit.outcome is Outcome.CONVERGED and quiet(fit.layout, fit.theta):
        return found
    unstable = with_unstable_start(records, calm or system, settings, local)
    if unstable is None:
        return found
    values = dict(
        zip(unstable.parameters.names, unstable.parameters.values().tolist(), strict=True)
    )
    mine = with_starting_values(
        system, {name: value for name, value in values.items() if name in system.parameters}
    )
    again, fit = _estimate_and_fit(records, mine, settings, unstable, local)
    return (
        again
        if fit is not None and fit.outcome is Outcome.CONVERGED and _may_replace(again, found)
        else found
    )


def _may_replace(again: Estimate, found: Estimate) -> bool:
    """Return whether a second estimate of the same records may replace the first: its outcome is
    better, or equal with at least the likelihood.
    """
    if found.outcome is not Outcome.CONVERGED:
        return True
    return again.outcome is Outcome.CONVERGED and again.log_likelihood >= found.log_likelihood


def _estimate_and_fit(
    records: Sequence[Record],
    system: System,
    settings: FitSettings,
    calm: System,
    local: Collection[str],
) -> tuple[Estimate, Fit | None]:
    """Return the estimate from the System's starting values, and its fit; None if no cost is
    finite.
    """
    pieces = in_pieces(records, calm, settings, local)
    layout = lay_out([piece for each in pieces for piece in each], system, settings, local=local)
    if not layout.shared:
        raise ModelError(
            "no parameter is free",
            where=f"model with {', '.join(system.parameters.names)}",
            remedy="release at least one",
        )
    fit = fit_from_best_start(layout, calm)
    found = failed_estimate(layout, METHOD) if fit is None else filter_error_estimate(fit)
    found = replace(
        found, fitted=put_together(found.fitted, pieces), message=pieces_message(pieces)
    )
    return found, fit


def noise_levels(fit: Fit) -> dict[str, float]:
    """Return measurement noise by output, and the scale of declared process noise, of a fit with
    process noise: a warm start for another.
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

    Noise levels and turbulence parameters maximise the adjusted likelihood, and sigmas include
    their uncertainty (Student's quantile): see `ident.process_noise.innovations_model`.
    """
    layout, system, noise_model = fit.layout, fit.layout.system, fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    covariance, determined = fit_covariance(fit)
    levels, own = restricted_levels(fit, covariance), np.diag(covariance)
    theta, factor = levels.theta, levels.factor * student_factor(own, levels.spread * own**2)
    covariance = covariance * np.outer(factor, factor)
    scaled = noise_model.scaled
    exact = without_measurement_noise(fit)
    absurd = not exact and (
        degenerate(fit)
        or bool(absurd_sigmas(fit, np.sqrt(np.diag(covariance))[: len(layout.shared)]))
    )
    outcome = (
        Outcome.DEGENERATE if absurd else fit.outcome if determined else Outcome.NOT_IDENTIFIABLE
    )
    at = [*range(len(layout.shared)), *([len(fit.theta) - 1] if scaled else [])]
    return Estimate(
        METHOD,
        (*layout.shared, *([SCALE] if scaled else [])),
        (*(system.parameters[name].unit for name in layout.shared), *(["1"] if scaled else [])),
        theta[at],
        covariance[np.ix_(at, at)],
        outcome,
        fit.log_likelihood,
        system.output_names,
        noise_model.levels(theta)[0],
        tuple(one_step_prediction(fit, r) for r in range(len(fit.lines))),
        iterations=fit.iterations,
    )


def one_step_prediction(fit: Fit, r: int) -> np.ndarray:
    """Return the outputs ``(m, N)`` of record ``r`` predicted from the samples before each."""
    problem, filter = fit.layout.problems[r], filters_of(fit.weighted)[r]
    motion, state = filter.whitener.motion, filter.residual.state[:, :, None]
    predicted = np.zeros_like(state)
    predicted[1:] = motion.Phi @ state[:-1]
    added = (motion.H @ predicted)[problem.grid.sample // problem.grid.substeps, :, 0]
    return np.asarray(fit.lines[r].y + added.T)


def turbulence_worth_trying(fit: Fit) -> float:
    """Return the p-value of white residuals: the smallest Ljung-Box value over channels and
    records, times their number.
    """
    p_values = [
        ljung_box(residual[i], problem.valid[i], name, _LJUNG_BOX_LAGS).p_value
        for problem, residual in zip(fit.layout.problems, fit.residuals, strict=True)
        for i, name in enumerate(fit.layout.system.output_names)
        if np.any(problem.valid[i])
    ]
    return float(min(1.0, len(p_values) * min(p_values)))


def predictive_log_likelihood(
    records: Sequence[Record],
    system: System,
    values: Mapping[str, float],
    levels: Mapping[str, float],
    settings: FitSettings | None = None,
    *,
    local: Collection[str] = (),
    masks: Sequence[np.ndarray] | None = None,
    begin: Sequence[Mapping[str, float]] = (),
) -> float:
    """Return the log likelihood of one-step predictions of held-out records; -inf where it is not
    finite.

    Parameters
    ----------
    system : with or without process noise; without, the predictions are those of a free simulation.
    values : parameters, held.
    levels : measurement noise by output, and ``process_noise_scale`` where needed, held: see
        ``noise_levels``.
    local : parameters that each record has of its own, fitted again like initial states and
        ``bias_*``.
    masks : ``(m, N)`` a record, False where a sample is set aside.
    begin : where parameters of its own start in each record, by name; those of the system where it
        does not say, which no event elsewhere finds.

    Two models are comparable for the same records, masks and local parameters.
    """
    fit = fit_under_held_noise(
        records, system, values, levels, settings, local=local, masks=masks, begin=begin
    )
    return -np.inf if fit is None else fit.log_likelihood


def fit_under_held_noise(
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
    """Fit the local parameters of each record with fixed noise levels; None where no cost is
    finite. Arguments as of ``predictive_log_likelihood``.

    ``freed`` : further parameters that each record then has of its own, started at ``values``.
    """
    own = {
        name for name in system.parameters.free_names if name.startswith("bias_") or name in local
    }
    parameters = system.parameters.with_values(
        {name: value for name, value in values.items() if name in system.parameters}
    ).only_free(own)
    held = replace(system, parameters=parameters)
    settings = settings or FitSettings()
    if not own and not any(item.free for item in system.initial):
        raise ModelError(
            "no initial state and no bias is free",
            where=f"model with {', '.join(system.parameters.names)}",
            remedy="release at least one",
        )
    layout = lay_out(records, held, settings, local=local, masks=masks)
    for r, known in enumerate(begin):
        for name, position in zip(
            layout.local, layout.columns(r)[len(layout.shared) :], strict=False
        ):
            layout.start[position] = known.get(name, layout.start[position])
    # A first fit without process noise gives a trajectory near the record.
    plain = fit_whole_records(
        FitProblem(replace(layout, settings=replace(settings, tolerance=COARSE_TOLERANCE)))
    )
    if plain is None:
        return None
    noise_model = process_noise(held, levels, (), fixed=True, scale=levels.get(SCALE, 1.0))
    fit = fit_whole_records(
        FitProblem(replace(layout, start=plain.theta), noise_model),
        [line.states for line in plain.lines],
    )
    if fit is None or not freed:
        return fit
    released = replace(held, parameters=parameters.only_free({*own, *freed}))
    whole = lay_out(records, released, settings, local=[*local, *freed], masks=masks)
    known = dict(zip(fit.layout.names, fit.theta.tolist(), strict=True))
    start = np.array(
        [known.get(name, old) for name, old in zip(whole.names, whole.start.tolist(), strict=True)]
    )
    return fit_whole_records(
        FitProblem(replace(whole, start=start), noise_model), [line.states for line in fit.lines]
    )
