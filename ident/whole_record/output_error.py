"""Output-error fit: maximum likelihood without process noise. Starts of the fit, and tests for
failed fits.

See Maine and Iliff, NASA RP-1138, and Jategaonkar, Flight Vehicle System Identification, ch. 4.
All records share the parameters. Each record has its own initial states and local parameters.

A fit may start from the result of equation error. This works for an unstable aircraft too, since
equation error simulates nothing.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import chain
from math import ceil

import numpy as np

from ident.estimate import LARGEST_NUMBER, Estimate, Outcome
from ident.regression.equation_error import RegressionSettings, run_equation_error
from ident.statistics.intervals import (
    add_normal_equations,
    inverse_information,
    split_covariance,
)
from ident.statistics.residual_spectrum import corrected_covariance
from ident.statistics.residuals import IMPLAUSIBLE_CHANGE_FACTOR
from ident.whole_record.gauss_newton import Fit, evaluate, fit_whole_records
from ident.whole_record.layout import FitLayout, FitProblem, FitSettings, lay_out
from ident.whole_record.numerical_errors import with_integration_error
from ident.whole_record.unstable_motion import (
    MOST_EFOLDINGS_AT_ONCE,
    fastest_growth_rate,
    fit_unstable,
    growth,
    projected_covariance,
)
from sim.declaration.model import System
from sim.errors import FlightidError, ModelError
from sim.record import Record

# ---- Starts of an output-error fit

# largest growth of the motion, in e-foldings, along a record that is not cut: with 15 e-foldings, a
# fit takes 50 steps for the whole record and 4 steps for two pieces
MOST_EFOLDINGS_IN_ONE_FIT = 10.0
# largest growth along a piece, in e-foldings: cutting then raises sigmas by at most a tenth; pieces
# with 6 e-foldings would raise them by half
MOST_EFOLDINGS_PER_PIECE = 8.0
FEWEST_PIECE_SAMPLES = 50  # fewest samples of a piece, which adds five or more unknowns
# largest difference of log likelihood between fits in the same minimum
SAME_MINIMUM_LOG_LIKELIHOOD = 0.1
# a simulation diverges where the rms residual of a channel exceeds this times the rms of the
# channel about its mean; a constant output gives a ratio of about 1
RUNAWAY_RESIDUAL_RATIO = 10.0


def fit_from_best_start(layout: FitLayout) -> Fit | None:
    """Return the output-error fit of a layout; None where no start has a finite cost.

    The fit starts from the declared values, provided that the simulation with these follows the
    record. If it does not converge, a second fit starts from equation error. This needs a record
    with all states, and no priors. The first converged fit is returned, else the fit of least cost.
    """
    if not layout.shared or layout.prior is not None:
        return fit_whole_records(FitProblem(layout))
    start_fit = None
    if grows_little(layout):
        start_fit = evaluate(FitProblem(layout), layout.start, layout.guesses(layout.start))
    if start_fit is None or simulation_diverges(start_fit):
        return _first_converged([], regression_starts(layout), iter([layout]))
    fit = fit_whole_records(FitProblem(layout), start_fit=start_fit)
    if fit is not None and fit.outcome is Outcome.CONVERGED:
        return fit
    return _first_converged([fit], regression_starts(layout))


def fits_at_lowest_minimum(first: FitLayout, second: FitLayout) -> tuple[Fit | None, Fit | None]:
    """Return the output-error fits of two models to the same records, each at the lowest minimum
    over the starts of both; None for a model without a finite cost.

    Each model is fitted from its declared values and from the estimate of the other model, so that
    the comparison does not depend on the starts. If this lowers the minimum of one of them, both
    are also fitted from equation error.
    """
    first_fit, second_fit = fit_from_best_start(first), fit_from_best_start(second)
    if not first.shared or first.prior is not None or second.prior is not None:
        return first_fit, second_fit
    from_declared = first_fit, second_fit
    if second_fit is not None:
        first_fit = _least_cost(first_fit, _with_starts(first, _values(second_fit)))
    if first_fit is not None:
        second_fit = _least_cost(second_fit, _with_starts(second, _values(first_fit)))
    if _same_minimum(from_declared[0], first_fit) and _same_minimum(from_declared[1], second_fit):
        return first_fit, second_fit
    for started in regression_starts(first):
        regressed = dict(zip(started.shared, started.start.tolist(), strict=False))
        first_fit = _least_cost(first_fit, _with_starts(first, regressed))
        second_fit = _least_cost(second_fit, _with_starts(second, regressed))
    return first_fit, second_fit


def _same_minimum(fit: Fit | None, best: Fit | None) -> bool:
    """Return whether two fits are in the same minimum: ``best`` has hardly less cost than
    ``fit``.
    """
    if fit is best:
        return True
    if fit is None or best is None:
        return False
    return fit.cost - best.cost <= max(best.layout.settings.enough, SAME_MINIMUM_LOG_LIKELIHOOD)


def _least_cost(fit: Fit | None, started: FitLayout) -> Fit | None:
    """Return the fit of least cost: ``fit``, or the fit from the further start ``started``."""
    fits = [candidate for candidate in (fit, _fit_from(started)) if candidate is not None]
    return min(
        (candidate for candidate in fits if np.isfinite(candidate.cost)),
        key=lambda candidate: candidate.cost,
        default=None,
    )


def _fit_from(layout: FitLayout) -> Fit | None:
    """Return the fit from the start of a layout; where the motion is unstable, by fits of longer
    and longer parts of the records.
    """
    return fit_whole_records(FitProblem(layout)) if grows_little(layout) else fit_unstable(layout)


def _values(fit: Fit) -> dict[str, float]:
    """Return name -> estimate of the shared parameters."""
    return dict(zip(fit.layout.shared, fit.theta.tolist(), strict=False))


def _with_starts(layout: FitLayout, values: Mapping[str, float]) -> FitLayout:
    """Return the layout with other starting values of shared parameters, within the bounds."""
    start = layout.start.copy()
    for i, name in enumerate(layout.shared):
        start[i] = np.clip(values.get(name, start[i]), layout.low[i], layout.high[i])
    return replace(layout, start=start)


def cut_into_pieces(
    records: Sequence[Record],
    system: System,
    settings: FitSettings,
    local: Collection[str] = (),
    whole: FitLayout | None = None,
) -> list[list[Record]]:
    """Return the list of pieces of each record: the record itself, or short pieces where an
    unstable motion grows too much along it.

    A fit gives each piece its own initial state and biases. Records are not cut for models with
    lags or delays of inputs, nor for fits with priors. ``whole`` is the layout of the uncut
    records; None makes it.
    """
    layout = whole or lay_out(records, system, settings, local=local)
    if not layout.shared or layout.prior is not None or system.input_stages or grows_little(layout):
        return [[record] for record in records]
    rate = fastest_growth_rate(next(regression_starts(layout), layout))
    return [_cut(record, rate * _duration(record)) for record in records]


def with_unstable_start(
    records: Sequence[Record], system: System, settings: FitSettings, local: Collection[str] = ()
) -> System | None:
    """Return the System with the estimates of equation error as starting values, if the aircraft is
    unstable at these and stable at the declared values; else None.

    A fit starts from it after a fit from the declared values has not converged.
    """
    layout = lay_out(records, system, settings, local=local)
    if not layout.shared or layout.prior is not None or not grows_little(layout):
        return None
    started = next(regression_starts(layout), None)
    if started is None or grows_little(started):
        return None
    values = dict(zip(started.shared, started.start.tolist(), strict=False))
    return with_starting_values(system, values)


def with_starting_values(system: System, values: Mapping[str, float]) -> System:
    """Return the System with other starting values of some parameters."""
    return replace(system, parameters=system.parameters.with_values(values))


def join_pieces(
    rows: Sequence[np.ndarray], pieces: Sequence[Sequence[Record]]
) -> tuple[np.ndarray, ...]:
    """Return one array ``(m, N)`` for each record, joined from the arrays ``rows`` of all
    ``pieces`` in turn.
    """
    remaining = iter(rows)
    return tuple(
        np.concatenate([next(remaining) for _ in record_pieces], axis=1) for record_pieces in pieces
    )


def pieces_message(pieces: Sequence[Sequence[Record]]) -> str:
    """Return a sentence that reports the pieces if a record was cut, else an empty text."""
    count = sum(len(record_pieces) for record_pieces in pieces)
    if count == len(pieces):
        return ""
    return (
        f"the motion is unstable: the records are cut into {count} pieces, each with its own "
        "initial state and biases"
    )


def _cut(record: Record, efoldings: float) -> list[Record]:
    """Return the pieces of a record along which the motion grows by ``efoldings``. Each piece has
    at least ``FEWEST_PIECE_SAMPLES`` samples.
    """
    count = min(
        ceil(min(efoldings, 1e6) / MOST_EFOLDINGS_PER_PIECE), len(record) // FEWEST_PIECE_SAMPLES
    )
    if efoldings <= MOST_EFOLDINGS_IN_ONE_FIT or count < 2:
        return [record]
    return [
        record.window(record.time[rows[0]], record.time[rows[-1]])
        for rows in np.array_split(np.arange(len(record)), count)
    ]


def _duration(record: Record) -> float:
    """Return the time from the first to the last sample, s."""
    return float(record.time[-1] - record.time[0])


def grows_little(layout: FitLayout, theta: np.ndarray | None = None) -> bool:
    """Return whether the motion at ``theta (n,)`` (None: at the start) grows so little along the
    records that they can be fitted at once.
    """
    efoldings = _start_growth(layout) if theta is None else growth(layout, theta)
    return efoldings <= MOST_EFOLDINGS_AT_ONCE


@lru_cache(maxsize=2)  # a fit needs its start several times
def _start_growth(layout: FitLayout) -> float:
    """Return the growth of the motion at the start of a layout, in e-foldings."""
    return growth(layout)


def simulation_diverges(fit: Fit) -> bool:
    """Return whether the simulation diverges from the record: the rms residual of an output exceeds
    ``RUNAWAY_RESIDUAL_RATIO`` times the rms of its motion.
    """
    layout = fit.layout
    for i in np.flatnonzero(layout.used):
        masks = [problem.valid[i] for problem in layout.problems]
        rows = [problem.z[i, valid] for problem, valid in zip(layout.problems, masks, strict=True)]
        motion = np.concatenate([row - np.mean(row) for row in rows if row.size])
        error = np.concatenate([fit.residuals[r][i, valid] for r, valid in enumerate(masks)])
        # a constant offset is a bias, which the first step of the fit removes
        error = error - np.mean(error)
        if np.sqrt(np.mean(error**2)) > RUNAWAY_RESIDUAL_RATIO * np.sqrt(np.mean(motion**2)) > 0.0:
            return True
    return False


def regression_starts(layout: FitLayout) -> Iterator[FitLayout]:
    """Yield the layout with the estimates of equation error as starting values; nothing if the
    record lacks states or the regression fails.
    """
    try:
        records = [problem.record for problem in layout.problems]
        estimate = run_equation_error(
            records, layout.system, RegressionSettings(tolerance=0.1, coloured=False)
        )
    except FlightidError:
        return
    if (
        estimate.outcome is not Outcome.CONVERGED
        or estimate.names != layout.shared
        or not np.all(np.isfinite(estimate.values))
    ):
        return
    n, start = len(layout.shared), layout.start.copy()
    start[:n] = np.clip(estimate.values, layout.low[:n], layout.high[:n])
    yield replace(layout, start=start)


def _first_converged(earlier: list[Fit | None], *starts: Iterator[FitLayout]) -> Fit | None:
    """Return the fit from the first of the ``starts`` with which it converges at the lowest cost so
    far; else the fit of least cost. The ``earlier`` fits are included in both comparisons.
    """
    fits = list(earlier)
    for start in chain(*starts):
        fit = _fit_from(start)
        if (
            fit is not None
            and fit.outcome is Outcome.CONVERGED
            and all(fit.cost <= other.cost for other in fits if other is not None)
        ):
            return fit
        fits.append(fit)
    finished = [fit for fit in fits if fit is not None]
    return min(finished, key=lambda fit: fit.cost, default=None)


# ---- Output-error fit

METHOD = "output-error"
_LEAST_NOISE_ROUNDINGS = 1e3  # a residual of more than this times the rounding error is noise
__all__ = ["FitSettings", "fit_output_error"]


def fit_output_error(
    records: Sequence[Record],
    system: System,
    settings: FitSettings | None = None,
    *,
    local: Collection[str] = (),
) -> Estimate:
    """Return the output-error estimate of the free parameters of a System from records.

    Parameters
    ----------
    records : one or more; each has its own initial state and its own ``bias_*`` parameters.
    system : model in its form for whole records; its declaration has the bounds and priors.
    settings : settings of the fit; None takes the defaults.
    local : names of further parameters of which each record has its own value.

    Returns
    -------
    Estimate of the shared free parameters. Biases, initial states and local parameters are nuisance
    parameters: they are projected out of the covariance. The outcome is ``NOT_IDENTIFIABLE`` where
    a direction of the parameters has no influence, ``DIVERGED`` where no start has a finite cost,
    ``MAX_ITERATIONS`` where the fit has not converged, and ``DEGENERATE`` where one output is
    fitted exactly and another is not. Where records of an unstable motion were cut into pieces, the
    ``message`` reports it.

    Raises
    ------
    ModelError : where a record has none of the outputs, or nothing is free.
    """
    settings = settings or FitSettings()
    estimate = _fit_in_pieces(records, system, settings, local)
    if estimate.outcome in (Outcome.CONVERGED, Outcome.DEGENERATE):
        return estimate
    unstable = with_unstable_start(records, system, settings, local)
    if unstable is None:
        return estimate
    second = _fit_in_pieces(records, unstable, settings, local)
    return second if second.outcome is Outcome.CONVERGED else estimate


def _fit_in_pieces(
    records: Sequence[Record], system: System, settings: FitSettings, local: Collection[str]
) -> Estimate:
    """Return the estimate from records that are cut where an unstable motion grows too much."""
    layout = lay_out(records, system, settings, local=local)
    pieces = cut_into_pieces(records, system, settings, local, layout)
    all_pieces = list(chain(*pieces))
    if len(all_pieces) > len(records):
        layout = lay_out(all_pieces, system, settings, local=local)
    if not layout.shared:
        raise ModelError(
            "no parameter is free",
            where=f"model with {', '.join(system.parameters.names)}",
            remedy="release at least one",
        )
    fit = fit_from_best_start(layout)
    estimate = failed_estimate(layout) if fit is None else estimate_of(fit)
    sentences = (pieces_message(pieces), estimate.message)
    message = "; ".join(sentence for sentence in sentences if sentence)
    return replace(estimate, fitted=join_pieces(estimate.fitted, pieces), message=message)


def shared_covariance(fit: Fit) -> tuple[np.ndarray, bool]:
    """Return the covariance of the shared parameters ``(s, s)`` and whether all are determined.

    For an unstable motion the other unknowns are projected out of the sensitivities, since all
    digits would be lost in the information matrix.
    """
    n = len(fit.layout.shared)
    if fit.layout.prior is None and n and not grows_little(fit.layout, fit.theta):
        return projected_covariance(fit)
    covariance, determined = fit_covariance(fit)
    return covariance[:n, :n], determined


def degenerate(fit: Fit) -> bool:
    """Return whether a fit is degenerate: an output is fitted to rounding and another is not. The
    weight of the exact output is then unlimited.
    """
    roundings = np.sqrt(fit.variance / fit.layout.smallest)[fit.layout.used]
    return bool(np.any(roundings <= 1.0) and np.any(roundings > _LEAST_NOISE_ROUNDINGS))


def fit_covariance(fit: Fit) -> tuple[np.ndarray, bool]:
    """Return the covariance of all unknowns ``(n, n)`` and whether all are determined. With the
    setting ``coloured``, the covariance is corrected for coloured residuals.
    """
    normal, _ = fit.normal_equations()
    inverse, determined = inverse_information(normal, fit.theta)
    if not fit.layout.settings.coloured:
        return inverse, determined
    layout = fit.layout
    parts = [
        (layout.columns(r), fit.jacobians[r], fit.residuals[r], problem.valid)
        for r, problem in enumerate(layout.problems)
    ]
    fixed_information = prior_information(fit)
    if fit.noise_model.names:
        # The information that coloured residuals do not change (from innovation covariances and
        # priors) is all information minus the information from the residuals.
        fixed_information = np.array(normal)
        for r, problem in enumerate(layout.problems):
            weight = np.where(problem.valid, -1.0 / fit.variance[:, None], 0.0)
            add_normal_equations(
                fixed_information,
                np.zeros(len(fixed_information)),
                layout.columns(r),
                fit.jacobians[r],
                fit.residuals[r],
                weight,
            )
    if determined:
        return corrected_covariance(inverse, parts, fit.variance, fixed_information), True
    resolved, undetermined_part = split_covariance(normal, fit.theta)
    return corrected_covariance(
        resolved, parts, fit.variance, fixed_information
    ) + undetermined_part, False


def prior_information(fit: Fit) -> np.ndarray | None:
    """Return the information ``(n, n)`` that the priors add; None for a fit without priors."""
    prior = fit.layout.prior
    if prior is None:
        return None
    information = np.zeros((len(fit.theta), len(fit.theta)))
    information[np.ix_(prior.positions, prior.positions)] = prior.information
    return information


def estimate_of(fit: Fit) -> Estimate:
    """Return the shared parameters of a fit as an Estimate. The covariance includes the integration
    error where the record has hardly any noise.
    """
    layout, n = fit.layout, len(fit.layout.shared)
    covariance, determined = shared_covariance(fit)
    outcome = fit.outcome if determined else Outcome.NOT_IDENTIFIABLE
    if degenerate(fit):
        outcome = Outcome.DEGENERATE
    estimate = Estimate(
        METHOD,
        layout.shared,
        tuple(layout.system.parameters[name].unit for name in layout.shared),
        fit.theta[:n].copy(),
        covariance,
        outcome,
        fit.log_likelihood,
        layout.system.output_names,
        np.sqrt(fit.variance),
        tuple(linearisation.y for linearisation in fit.linearisations),
        iterations=fit.iterations,
    )
    return with_integration_error(estimate, fit) if grows_little(layout, fit.theta) else estimate


def failed_estimate(layout: FitLayout, method: str = METHOD) -> Estimate:
    """Return the estimate of a fit without a finite cost: the start of its layout, with sigmas as
    large as the values and at least 1.
    """
    theta = layout.start[: len(layout.shared)]
    return Estimate(
        method,
        layout.shared,
        tuple(layout.system.parameters[name].unit for name in layout.shared),
        theta.copy(),
        np.diag(np.maximum(1.0, theta**2)),
        Outcome.DIVERGED,
        -LARGEST_NUMBER,
        layout.system.output_names,
        np.ones(len(layout.used)),
        tuple(np.zeros_like(problem.z) for problem in layout.problems),
    )


# ---- Tests for failed fits

UNDETERMINED = "the records determine none of the derivatives"


def failed_simulation(
    channels: Mapping[str, str], measured: Sequence[np.ndarray], residuals: Sequence[np.ndarray]
) -> str:
    """Return the reason why simulated outputs do not fit the measurement; empty if they do.

    A simulation has diverged where the rms residual of a channel exceeds
    ``RUNAWAY_RESIDUAL_RATIO`` times the rms of its motion. A fit has also failed where constant
    outputs would have a higher likelihood.

    Parameters
    ----------
    channels : name of each channel -> its unit.
    measured : ``(K,)`` of each channel: valid samples of all records, minus the mean over each
        record.
    residuals : ``(K,)`` of each channel: residuals of these samples.
    """
    moving = []
    for (name, unit), values, residual in zip(channels.items(), measured, residuals, strict=True):
        motion, error = float(np.sqrt(np.mean(values**2))), float(np.sqrt(np.mean(residual**2)))
        if motion > 0.0:
            moving.append((name, unit, motion, error, len(values)))
    if not moving:
        return ""
    name, unit, motion, error, _ = max(moving, key=lambda channel: channel[3] / channel[2])
    worst_error = f"{name} error {error:.2g} {unit}, of a motion of {motion:.2g} {unit}"
    if not error <= RUNAWAY_RESIDUAL_RATIO * motion:
        return f"the free simulation diverges from the record ({worst_error})"
    gain_of_constants = sum(
        count * math.log(max(error, 1e-300) / motion) for _, _, motion, error, count in moving
    )
    if gain_of_constants > 0.0:
        return f"the fit is worse than constant outputs ({worst_error})"
    return ""


def none_determined(sigmas: Iterable[tuple[float, float]]) -> bool:
    """Return whether the sigma of every derivative exceeds three times its declared size.

    Declared values may be 30 % wrong. An estimate with a sigma of ten times that adds no
    information. Derivatives declared as zero are left out. ``sigmas`` are pairs of a sigma and the
    declared value.
    """
    pairs = [(std, abs(declared)) for std, declared in sigmas if declared != 0.0]
    return bool(pairs) and all(not std <= IMPLAUSIBLE_CHANGE_FACTOR * size for std, size in pairs)


def failed_fit(fit: Fit, declared: Mapping[str, float]) -> tuple[str, str]:
    """Return the reason why an output-error fit has failed, and a remedy; both are empty if it has
    not failed. ``declared`` maps the name of a parameter to its declared value.
    """
    layout = fit.layout
    names, problems = layout.system.output_names, layout.problems
    units = {output.name: output.unit for output in layout.system.outputs}
    used = [i for i in range(len(names)) if any(np.any(problem.valid[i]) for problem in problems)]
    measured, residuals = [], []
    for i in used:
        rows = [problem.z[i, problem.valid[i]] for problem in problems]
        measured.append(np.concatenate([row - np.mean(row) for row in rows if row.size]))
        masks = [problem.valid[i] for problem in problems]
        residuals.append(
            np.concatenate([fit.residuals[r][i, valid] for r, valid in enumerate(masks)])
        )
    channels = {names[i]: units[names[i]] for i in used}
    reason = failed_simulation(channels, measured, residuals)
    if not reason:
        with np.errstate(all="ignore"):
            covariance, _ = fit_covariance(fit)
        sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        pairs = [
            (float(sigmas[i]), declared[name])
            for i, name in enumerate(layout.shared)
            if name in declared
        ]
        reason = UNDETERMINED if none_determined(pairs) else ""
    return (reason, _remedy(fit)) if reason else ("", "")


def _remedy(fit: Fit) -> str:
    """Return the remedy for a failed fit. For an unstable motion it includes the longest possible
    record.
    """
    layout = fit.layout
    rate = max(fastest_growth_rate(layout), fastest_growth_rate(layout, fit.theta))
    longest = max(_duration(problem.record) for problem in layout.problems)
    if MOST_EFOLDINGS_AT_ONCE < rate * longest < math.inf:
        longest_fit = MOST_EFOLDINGS_IN_ONE_FIT / rate
        cut = f"cut the records to single maneuvers of at most {longest_fit:.2g} s (--from, --to)"
        return (
            f"the motion is unstable and grows e-fold every {1.0 / rate:.2g} s, as of an aircraft "
            "that a controller holds: estimate with "
            "flightid identify --method filter-error or equation-error, which simulate nothing "
            f"freely, or {cut}"
        )
    return (
        "check units, signs and the declared values; use records or maneuvers that are shorter or "
        "smaller; an unstable aircraft that a controller holds needs flightid identify --method "
        "filter-error or equation-error"
    )
