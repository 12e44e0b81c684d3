"""Numerical errors of estimates, from integration and sampling.

Residuals as small as the integration error are not noise, and sigmas from them are meaningless.
Let y_h be the outputs of an integrator of order 4 with step h. Its error is y - y_h = 16/15
(y_{h/2} - y_h) to leading order (Richardson extrapolation). An error dy of the outputs changes an
output-error estimate by (J' W J)^-1 J' W dy.

Equation error has sampling errors, since it takes slopes and means over windows of samples. To find
these errors, the records are simulated at the estimate with the same sampling, and the simulation
is identified again. The second estimate differs from the first by the sampling error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.regression.equation_error import run_equation_error
from ident.statistics.intervals import inverse_information
from ident.whole_record.gauss_newton import (
    Fit,
    evaluate,
    with_exact_trajectory,
    without_sensitivities,
)
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.record_problem import record_problem
from sim.declaration.model import System
from sim.record import Channel, Record

# integration errors matter where the noise is less than this share of the motion
QUIET_NOISE_SHARE = 1e-3
RICHARDSON_FACTOR = 16.0 / 15.0  # factor on the difference between steps h and h/2, order 4
# a record has hardly any noise where the equation-error residuals are below this times the
# residuals of a simulation without noise
LARGEST_SMOOTHING_RATIO = 3.0


def with_integration_error(estimate: Estimate, fit: Fit) -> Estimate:
    """Return an output-error estimate whose covariance includes the integration error, where the
    record has hardly any noise.

    The estimate has a message where the error of a parameter exceeds its sigma. A fit at its
    iteration limit is treated in the same way, since its last steps are shorter than the
    integration error.
    """
    error = None
    if estimate.outcome in (Outcome.CONVERGED, Outcome.MAX_ITERATIONS):
        error = integration_error(fit)
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
    """Return the error ``(n,)`` of all unknowns due to the finite steps of the integration; None
    where every output has noise, the fit has priors, or the error is not finite.
    """
    layout = fit.layout
    if not _has_quiet_output(fit) or layout.prior is not None:
        return None
    finer = tuple(
        record_problem(
            problem.record,
            problem.system,
            0.5 * float(np.max(problem.grid.steps)),
            problem.free,
            problem.free_initial,
            valid=problem.valid,
            at=layout.split(fit.theta, r)[0],
            exact=problem.exact,
        )
        for r, problem in enumerate(layout.problems)
    )
    bare = without_sensitivities(FitProblem(replace(layout, problems=finer), fit.noise_model))
    half_step_fit = evaluate(bare, fit.theta, bare.layout.guesses(fit.theta))
    if half_step_fit is None:
        return None
    half_step_fit, gradient = with_exact_trajectory(half_step_fit), np.zeros(len(fit.theta))
    for r, problem in enumerate(layout.problems):
        weight = np.where(problem.valid, 1.0 / fit.variance[:, None], 0.0)
        difference = weight * (half_step_fit.linearisations[r].y - fit.linearisations[r].y)
        gradient[layout.columns(r)] -= np.einsum("mnc,mn->c", fit.jacobians[r], difference)
    error = RICHARDSON_FACTOR * (
        inverse_information(fit.normal_equations()[0], fit.theta)[0] @ gradient
    )
    return error if np.all(np.isfinite(error)) else None


def _has_quiet_output(fit: Fit) -> bool:
    """Return whether some output has less noise than ``QUIET_NOISE_SHARE`` of its motion."""
    for i in np.flatnonzero(fit.layout.used):
        rows = [problem.z[i, problem.valid[i]] for problem in fit.layout.problems]
        motion = np.concatenate([row - np.mean(row) for row in rows if row.size])
        if np.sqrt(fit.variance[i]) < QUIET_NOISE_SHARE * np.sqrt(np.mean(motion**2)):
            return True
    return False


def with_sampling_error(
    estimate: Estimate, records: Sequence[Record], system: System, settings: FitSettings
) -> Estimate:
    """Return an equation-error estimate whose covariance includes the sampling error, where the
    records have hardly any noise.

    The estimate is unchanged where the records have noise or their simulation overflows. It has a
    message where the error of a parameter exceeds its sigma.
    """
    if estimate.outcome not in (Outcome.CONVERGED, Outcome.MAX_ITERATIONS):
        return estimate
    simulated = _simulated(estimate, records, system, settings)
    if simulated is None:
        return estimate
    second = run_equation_error(simulated, system)
    hardly_noisy = np.any(
        (estimate.noise_std < LARGEST_SMOOTHING_RATIO * second.noise_std) & (second.noise_std > 0.0)
    )
    error = second.values - estimate.values
    if (
        second.outcome not in (Outcome.CONVERGED, Outcome.MAX_ITERATIONS)
        or not hardly_noisy
        or not np.all(np.isfinite(error))
    ):
        return estimate
    return _widened(
        estimate,
        error,
        "slopes of samples leave larger errors than the noise of the record: sigmas are those of "
        "sampling",
    )


def _widened(estimate: Estimate, error: np.ndarray, warning: str) -> Estimate:
    """Return the estimate with the ``error (n,)`` of its parameters added to its covariance. The
    ``warning`` becomes its message where the error of a parameter exceeds its sigma.
    """
    message = warning if np.any(np.abs(error) > estimate.std) else ""
    return replace(
        estimate,
        covariance=estimate.covariance + np.outer(error, error),
        message=message or estimate.message,
    )


def _simulated(
    estimate: Estimate, records: Sequence[Record], system: System, settings: FitSettings
) -> list[Record] | None:
    """Return the records with their outputs replaced by a simulation at the estimate, from their
    first samples, without noise and biases; None on overflow.
    """
    fitted_system = replace(system, parameters=system.parameters.with_values(estimate.as_dict()))
    layout = lay_out(
        records,
        fitted_system,
        replace(settings, max_step=0.5 * settings.max_step, use_priors=False),
    )
    bare = without_sensitivities(FitProblem(layout))
    simulation = evaluate(bare, layout.start, layout.guesses(layout.start))
    if simulation is None:
        return None
    linearisations = with_exact_trajectory(simulation).linearisations
    simulated = []
    for record, linearisation in zip(records, linearisations, strict=True):
        rows = dict(zip(fitted_system.output_names, linearisation.y, strict=True))
        outputs = tuple(
            _replaced(channel, rows[channel.name]) if channel.name in rows else channel
            for channel in record.outputs
        )
        simulated.append(replace(record, outputs=outputs))
    return simulated


def _replaced(channel: Channel, values: np.ndarray) -> Channel:
    """Return a channel with other values ``(N,)`` at its valid samples."""
    return Channel.of(channel.name, channel.unit, np.where(channel.valid, values, np.nan))
