"""Numerical errors of estimates, from integration and sampling.

Residuals as small as the integration error are not noise, and sigmas from them are meaningless.
With y_h the outputs at step h of an order-4 method, y - y_h = 16/15 (y_{h/2} - y_h) to leading
order (Richardson). An error dy of the outputs changes an output-error estimate by (J' W J)^-1 J' W
dy.

Equation error uses slopes over windows and smoothed regressors. A simulation at the estimate,
sampled like the record, has the same errors and a known truth.
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

# largest noise, relative to the motion, at which integration errors matter
QUIET_NOISE_SHARE = 1e-3
RICHARDSON_FACTOR = 16.0 / 15.0  # factor on the difference between steps h and h/2, order 4
# largest residual over that of a simulation without noise: a larger one shows noise in the record
LARGEST_SMOOTHING_RATIO = 3.0


def with_integration_error(estimate: Estimate, fit: Fit) -> Estimate:
    """Return an output-error estimate whose covariance includes the integration error, if a record
    has hardly any noise.

    The message names parameters whose error exceeds the sigma. A fit at its iteration limit is
    included: its last steps are shorter than this error.
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
    """Return the error of all unknowns ``(n,)`` from the finite steps of the integration; None
    where the noise is larger than ``QUIET_NOISE_SHARE`` or it fails.
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
    coarse_fit = evaluate(bare, fit.theta, bare.layout.guesses(fit.theta))
    if coarse_fit is None:
        return None
    better, gradient = with_exact_trajectory(coarse_fit), np.zeros(len(fit.theta))
    for r, problem in enumerate(layout.problems):
        weight = np.where(problem.valid, 1.0 / fit.variance[:, None], 0.0)
        moved = weight * (better.lines[r].y - fit.lines[r].y)
        gradient[layout.columns(r)] -= np.einsum("mnc,mn->c", fit.jacobians[r], moved)
    error = RICHARDSON_FACTOR * (
        inverse_information(fit.normal_equations()[0], fit.theta)[0] @ gradient
    )
    return error if np.all(np.isfinite(error)) else None


def _quiet(fit: Fit) -> bool:
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
    """Return an equation-error estimate whose covariance includes the sampling error, if a record
    has hardly any noise.

    The estimate is unchanged if the records have noise or their simulation overflows. The message
    names parameters whose error exceeds the sigma.
    """
    if estimate.outcome not in (Outcome.CONVERGED, Outcome.MAX_ITERATIONS):
        return estimate
    calm = _simulated(estimate, records, system, settings)
    if calm is None:
        return estimate
    again = run_equation_error(calm, system)
    quiet = np.any(
        (estimate.noise_std < LARGEST_SMOOTHING_RATIO * again.noise_std) & (again.noise_std > 0.0)
    )
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
    """Return an estimate with an error ``(n,)`` added to its covariance, and a sentence if the
    error exceeds a sigma.
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
    """Return the records with outputs simulated at an estimate from their first samples, without
    noise and biases; None where they overflow.
    """
    known = replace(system, parameters=system.parameters.with_values(estimate.as_dict()))
    layout = lay_out(
        records, known, replace(settings, max_step=0.5 * settings.max_step, use_priors=False)
    )
    bare = without_sensitivities(FitProblem(layout))
    first_fit = evaluate(bare, layout.start, layout.guesses(layout.start))
    if first_fit is None:
        return None
    lines = with_exact_trajectory(first_fit).lines
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
