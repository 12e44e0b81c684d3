"""Errors of estimates that numerical methods leave: of the integration, and of sampling.

A residual at the size of the integration error is no noise, and sigmas made of it say nothing. With
y_h the outputs of steps h and order-4 integration, y - y_h = 16/15 (y_{h/2} - y_h) to leading order
(Richardson), and an error dy of the outputs moves an output-error estimate by (J' W J)^-1 J' W dy.

Equation error takes slopes over windows and smoothed regressors. A simulation at the estimate,
sampled as the record is, has the same errors and a known truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.regression.equation_error import run_equation_error
from ident.statistics.intervals import inverse_information
from ident.whole_record.gauss_newton import Fit, evaluate, joined_up, without_sensitivities
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.record_problem import record_problem
from sim.declaration.model import System
from sim.record import Channel, Record

# of an output's motion: with more noise than that, integration errors are far below a sigma
QUIET_NOISE_SHARE = 1e-3
RICHARDSON_FACTOR = 16.0 / 15.0  # of the difference of steps h and h/2, order 4
# times what smoothing leaves of a record without noise: a record that leaves more has noise of its
# own
LARGEST_SMOOTHING_RATIO = 3.0


def with_integration_error(estimate: Estimate, fit: Fit) -> Estimate:
    """Return an output-error estimate whose covariance holds the error of the integration where a
    record has hardly any noise.

    The message says where that error is larger than the sigma. A fit that stopped at its limit has
    it too: at the level of rounding the last steps are shorter than this error.
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
    begun = evaluate(bare, fit.theta, bare.layout.guesses(fit.theta))
    if begun is None:
        return None
    better, gradient = joined_up(begun), np.zeros(len(fit.theta))
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
    """Return an estimate by equation error whose covariance holds the error of sampling where a
    record has hardly any noise.

    The estimate itself where the records have noise, or where their simulation leaves the range of
    numbers. The message says where the error is larger than the sigma.
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
    """Return an estimate with an error ``(n,)`` added to its covariance, and a sentence where that
    is larger than a sigma.
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
    begun = evaluate(bare, layout.start, layout.guesses(layout.start))
    if begun is None:
        return None
    lines = joined_up(begun).lines
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
