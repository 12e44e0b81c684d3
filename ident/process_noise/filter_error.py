"""Filter-error fit: maximum likelihood with process noise, over one or several whole records.

Maine and Iliff, NASA RP-1168 (1985); Jategaonkar, Flight Vehicle System Identification, ch. 5. Measurement noise levels, the
parameters of the process noise (turbulence's intensity and length) and those of the vehicle are estimated together.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.process_noise.discretised import Variation, discretised_noise
from ident.process_noise.innovations_model import SCALE, ProcessNoise, filters_of, has_process_noise, process_noise
from ident.process_noise.restricted_likelihood import restricted_levels
from ident.process_noise.whitener import whitener
from ident.statistics.residuals import ljung_box
from ident.whole_record.fit_problem import FitProblem
from ident.whole_record.gauss_newton import Fit, fit_whole_records
from ident.whole_record.layout import FitLayout, FitSettings, lay_out
from ident.whole_record.output_error import failed_estimate, fit_covariance
from sim.declaration.system import System
from sim.errors import ModelError
from sim.record import Record

METHOD = "filter-error"
_STENCIL = np.array([-1.0, 3.0, -3.0, 1.0])
_LEAST = 1e-3  # smallest intensity, relative to its start
_COARSE = 0.1  # tolerance, in sigmas, of the output-error fit that only gives a start


def fit_filter_error(records: Sequence[Record], system: System, settings: FitSettings | None = None) -> Estimate:
    """Fit the free parameters of a System with process noise to records by the innovations of a Kalman filter.

    Parameters
    ----------
    records : one or more; each has its own initial state and its own ``bias_*`` parameters.
    system : not compiled on line; white noise forces a state, by a noise effect or as declared. The parameters of a noise
        effect are estimated where they are free; of declared process noise a common factor on its standard deviation.

    Returns
    -------
    Estimate of the shared free parameters and, for declared process noise, of ``process_noise_scale``. ``noise_std`` are the
    estimated levels of the measurement noise; ``log_likelihood`` compares with that of an output-error fit of the same data.
    ``fitted`` is predicted one step ahead: measured minus fitted are the innovations. Outcomes as of ``fit_output_error``.

    Raises
    ------
    ModelError : nothing forces a state, a record without any of the outputs, or nothing to estimate.
    """
    settings = settings or FitSettings()
    if not has_process_noise(system):
        raise ModelError(
            "no white noise forces a state",
            where=f"model with states {', '.join(system.state_names)}",
            remedy="add a noise effect, declare process noise, or use output-error",
        )
    layout = lay_out(records, system, settings)
    if not layout.shared:
        raise ModelError("no parameter is free", where=f"model with {', '.join(system.parameters.names)}", remedy="release at least one")
    fit = fit_with_process_noise(layout)
    return failed_estimate(layout, METHOD) if fit is None else filter_error_estimate(fit)


def fit_with_process_noise(layout: FitLayout, guesses: list[np.ndarray] | None = None, levels: Mapping[str, float] | None = None) -> Fit | None:
    """Fit a layout's unknowns and the noise levels together; None where no finite cost was found.

    Parameters
    ----------
    layout : of a System with process noise.
    guesses : trajectories to begin with. levels : measurement noise by output, and ``process_noise_scale`` if wanted, of a
        fit of nearly the same model: a warm start. When None they come from an output-error fit, which also
        moves the other unknowns' start.
    """
    layout = _never_still(layout)
    if levels is None:
        coarse = replace(layout.settings, tolerance=max(_COARSE, layout.settings.tolerance))
        first = fit_whole_records(FitProblem(replace(layout, settings=coarse)), guesses)
        if first is None:
            return None
        start, guesses, noise = first.theta.copy(), [line.states for line in first.lines], noise_start(first)
        factor = _size_of_motion(first, noise)
        for position, value in _amplitudes(layout).items():
            start[position] = np.clip(factor * value, layout.low[position], layout.high[position])
        layout = replace(layout, start=start)
        levels = {**dict(zip(layout.system.output_names, noise.tolist(), strict=True)), SCALE: factor}
    present = [name for name, used in zip(layout.system.output_names, layout.used, strict=True) if used]
    noise_model = process_noise(layout.system, {**dict.fromkeys(layout.system.output_names, 1.0), **levels}, present, scale=levels.get(SCALE, 1.0))
    return fit_whole_records(FitProblem(layout, noise_model), guesses)


def _amplitudes(layout: FitLayout) -> dict[int, float]:
    """Unknowns that nothing forces a state without (intensities): positions in theta and starting values."""
    found = {}
    for r in range(len(layout.problems)):
        p, _ = layout.split(layout.start, r)
        for q, index in enumerate(layout.order):
            position = int(layout.columns(r)[q])
            if layout.low[position] == 0.0 < p[index] and not np.any(np.array(layout.system.noise([*p[:index], 0.0, *p[index + 1 :]])[0]) > 0):
                found[position] = float(p[index])
    return found


def _never_still(layout: FitLayout) -> FitLayout:
    """The same layout with intensities kept off zero, where the likelihood is flat and a fit would stay for ever."""
    low = layout.low.copy()
    for position, value in _amplitudes(layout).items():
        low[position] = _LEAST * value
    return replace(layout, low=low)


def _size_of_motion(fit: Fit, noise: np.ndarray) -> float:
    """Factor on the start's forcing that makes the process noise as large as what the residuals hold beyond noise ``(m,)``."""
    layout = fit.layout
    expected, beyond = np.zeros(len(noise)), np.maximum(fit.variance - noise**2, 1e-4 * noise**2)
    for r, (problem, line) in enumerate(zip(layout.problems, fit.lines, strict=True)):
        motion = discretised_noise(problem, line.states, Variation(layout.split(layout.start, r)[0], 1.0))
        # A filter that trusts no measurement propagates the covariance of the motion itself.
        spread = whitener(motion, 1e12 * noise**2, np.zeros((len(problem.grid.nodes), len(noise)), dtype=bool)).predicted
        expected += np.mean(np.einsum("tij,tjk,tik->ti", motion.H, spread, motion.H, optimize=True), axis=0) / len(layout.problems)
    at = np.flatnonzero(layout.used & (expected > 0))
    ratio = float(np.sqrt(np.median(beyond[at] / expected[at]))) if at.size else 1.0
    return float(np.clip(ratio, 0.01, 100.0)) if np.isfinite(ratio) else 1.0


def noise_levels(fit: Fit) -> dict[str, float]:
    """Measurement noise by output, and the scale of declared process noise, of a fit with process noise: a warm start for another."""
    noise_model = fit.noise_model
    if not isinstance(noise_model, ProcessNoise):
        return dict(zip(fit.layout.system.output_names, np.sqrt(fit.variance).tolist(), strict=True))
    std, scale = noise_model.levels(fit.theta)
    return {**dict(zip(noise_model.outputs, std.tolist(), strict=True)), SCALE: scale}


def noise_start(fit: Fit) -> np.ndarray:
    """Measurement noise ``(m,)`` read off the residuals of an output-error fit, of which the slow part is process noise.

    Scatter of third differences of samples in a row, which pass white noise and hardly anything slow; not more than the residual.
    """
    std = np.sqrt(fit.variance)
    out = std.copy()
    for i in range(len(out)):
        rows = []
        for problem, residual in zip(fit.layout.problems, fit.residuals, strict=True):
            whole = np.convolve(~problem.valid[i], np.ones(len(_STENCIL)), mode="valid") < 0.5
            rows.append(np.convolve(residual[i], _STENCIL[::-1], mode="valid")[whole])
        scatter = np.concatenate(rows)
        if scatter.size >= 20:
            out[i] = np.sqrt(np.mean(scatter**2) / np.sum(_STENCIL**2))
    return np.clip(out, 0.02 * std, std)


def filter_error_estimate(fit: Fit) -> Estimate:
    """The shared parameters of a fit with process noise, and the scale of declared process noise, as an Estimate.

    Noise levels, turbulence's parameters among them, are those of the adjusted likelihood: see `ident.process_noise.restricted_likelihood`.
    """
    layout, system, noise_model = fit.layout, fit.layout.system, fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    covariance, determined = fit_covariance(fit)
    theta, factor = restricted_levels(fit, covariance)
    covariance = covariance * np.outer(factor, factor)
    scaled = noise_model.scaled
    at = [*range(len(layout.shared)), *([len(fit.theta) - 1] if scaled else [])]
    return Estimate(
        METHOD,
        (*layout.shared, *([SCALE] if scaled else [])),
        (*(system.parameters[name].unit for name in layout.shared), *(["1"] if scaled else [])),
        theta[at],
        covariance[np.ix_(at, at)],
        fit.outcome if determined else Outcome.NOT_IDENTIFIABLE,
        fit.log_likelihood,
        system.output_names,
        noise_model.levels(theta)[0],
        tuple(one_step_prediction(fit, r) for r in range(len(fit.lines))),
        iterations=fit.iterations,
    )


def one_step_prediction(fit: Fit, r: int) -> np.ndarray:
    """Outputs ``(m, N)`` of record ``r`` that a fit with process noise expects from the samples before each."""
    problem, filter = fit.layout.problems[r], filters_of(fit.weighted)[r]
    motion, state = filter.whitener.motion, filter.residual.state[:, :, None]
    predicted = np.zeros_like(state)
    predicted[1:] = motion.Phi @ state[:-1]
    added = (motion.H @ predicted)[problem.grid.sample // problem.grid.substeps, :, 0]
    return np.asarray(fit.lines[r].y + added.T)


def turbulence_worth_trying(fit: Fit, lags: int = 25) -> float:
    """p-value of the residuals of a fit being white: the smallest of Ljung and Box's over channels and records, times their number."""
    p_values = [
        ljung_box(residual[i], problem.valid[i], name, lags).p_value
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
) -> float:
    """Log likelihood of one-step predictions of records that were not fitted; -inf where it is not finite.

    Parameters
    ----------
    system : with or without process noise; without, the predictions are those of a free simulation.
    values : parameters, held. levels : measurement noise by output, and ``process_noise_scale`` where needed, held: see ``noise_levels``.
    local : parameters that each record has of its own, fitted again like initial states and ``bias_*``.
    masks : ``(m, N)`` a record, False where a sample is set aside.

    Two models compare when both see the same records, masks and local parameters.
    """
    own = {name for name in system.parameters.free_names if name.startswith("bias_") or name in local}
    parameters = system.parameters.with_values({name: value for name, value in values.items() if name in system.parameters}).only_free(own)
    held = replace(system, parameters=parameters)
    settings = settings or FitSettings()
    if not own and not any(item.free for item in system.initial):
        raise ModelError(
            "no initial state and no bias is free", where=f"model with {', '.join(system.parameters.names)}", remedy="release at least one"
        )
    layout = lay_out(records, held, settings, local=local, masks=masks)
    # A first fit without process noise brings the trajectory near the record.
    plain = fit_whole_records(FitProblem(replace(layout, settings=replace(settings, tolerance=_COARSE))))
    if plain is None:
        return -np.inf
    noise_model = process_noise(held, levels, (), fixed=True, scale=levels.get(SCALE, 1.0))
    fit = fit_whole_records(FitProblem(replace(layout, start=plain.theta), noise_model), [line.states for line in plain.lines])
    return -np.inf if fit is None else fit.log_likelihood
