"""Output-error fit: maximum likelihood without process noise; its starts, and failed fits.

Equation error needs no simulation, so that it also works for unstable aircraft; output error may
start from its result.

Maine and Iliff, NASA RP-1138; Jategaonkar, Flight Vehicle System Identification, ch. 4. Parameters
are shared by all records; initial states and the parameters named local belong to one record each.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from math import ceil

import numpy as np

from ident.estimate import LARGEST_NUMBER, Estimate, Outcome
from ident.regression.equation_error import RegressionSettings, run_equation_error
from ident.statistics.intervals import (
    add_normal_equations,
    determined_and_open,
    inverse_information,
)
from ident.statistics.residual_spectrum import corrected_covariance
from ident.statistics.residuals import IMPLAUSIBLE_CHANGE_FACTOR
from ident.whole_record.gauss_newton import Fit, evaluate, fit_whole_records
from ident.whole_record.layout import FitLayout, FitProblem, FitSettings, lay_out
from ident.whole_record.numerical_errors import with_integration_error
from ident.whole_record.unstable_motion import (
    MOST_EFOLDINGS_AT_ONCE,
    fastest,
    fit_unstable,
    growth,
    projected_covariance,
)
from sim.declaration.model import System
from sim.errors import FlightidError, ModelError
from sim.record import Record

# ---- Starts of an output-error fit

# largest growth, in e-foldings, of a record that is fitted whole: with 15 a fit takes 50 steps, in
# two pieces 4
MOST_EFOLDINGS_IN_ONE_FIT = 10.0
# largest growth of a piece, in e-foldings: sigmas grow by at most a tenth, with 6 by half
MOST_EFOLDINGS_PER_PIECE = 8.0
FEWEST_PIECE_SAMPLES = 50  # fewest samples of a piece, which has five or more unknowns of its own
# largest difference of log likelihood between fits in the same minimum
SAME_MINIMUM_LOG_LIKELIHOOD = 0.1
# smallest rms residual of a divergent simulation, over the rms of the channel about its mean; a
# vehicle at rest gives about 1
RUNAWAY_RESIDUAL_RATIO = 10.0


def fit_from_best_start(layout: FitLayout) -> Fit | None:
    """Return the output-error fit of a layout; None where no start has a finite cost.

    It starts from the declared values if their simulation follows the record. If this fit does not
    converge, it also starts from equation error, provided that the record has all states and no
    priors are used. The first converged fit is returned, else the one of least cost.
    """
    first_fit = None
    if layout.shared and layout.prior is None and quiet(layout):
        first_fit = evaluate(FitProblem(layout), layout.start, layout.guesses(layout.start))
    if (
        not layout.shared
        or layout.prior is not None
        or (first_fit is not None and not runs_away(first_fit))
    ):
        first = fit_whole_records(FitProblem(layout), begun=first_fit)
        if (
            (first is not None and first.outcome is Outcome.CONVERGED)
            or not layout.shared
            or layout.prior is not None
        ):
            return first
        return _first_converged([first], from_regression(layout))
    return _first_converged([], from_regression(layout), iter([layout]))


def fits_at_their_least(first: FitLayout, second: FitLayout) -> tuple[Fit | None, Fit | None]:
    """Return the output-error fits of two models to the same records, each at the lowest minimum
    over the starts of both.

    Each starts from the declared values and from the estimate of the other, so that the comparison
    does not depend on the starts. If one has ended in a higher minimum, equation error gives a
    further start to both. None for a model without a finite cost.
    """
    old, new = fit_from_best_start(first), fit_from_best_start(second)
    if not first.shared or first.prior is not None or second.prior is not None:
        return old, new
    begun = old, new
    old = _least(old, [_with_starts(first, _values(new))] if new is not None else [])
    new = _least(new, [_with_starts(second, _values(old))] if old is not None else [])
    if _at_lowest_minimum(begun[0], old) and _at_lowest_minimum(begun[1], new):
        return old, new
    for each in from_regression(first):
        regressed = dict(zip(each.shared, each.start.tolist(), strict=False))
        old, new = (
            _least(old, [_with_starts(first, regressed)]),
            _least(new, [_with_starts(second, regressed)]),
        )
    return old, new


def _at_lowest_minimum(begun: Fit | None, best: Fit | None) -> bool:
    """Return whether a fit was already at its lowest minimum."""
    return begun is best or (
        begun is not None
        and best is not None
        and begun.cost - best.cost <= max(best.layout.settings.enough, SAME_MINIMUM_LOG_LIKELIHOOD)
    )


def _least(found: Fit | None, starts: Sequence[FitLayout]) -> Fit | None:
    """Return the fit of least cost among a fit and those from further starts."""
    fits = [
        found,
        *(
            fit_whole_records(FitProblem(each)) if quiet(each) else fit_unstable(each)
            for each in starts
        ),
    ]
    known = [fit for fit in fits if fit is not None and np.isfinite(fit.cost)]
    return min(known, key=lambda fit: fit.cost, default=None)


def _values(fit: Fit) -> dict[str, float]:
    return dict(zip(fit.layout.shared, fit.theta.tolist(), strict=False))


def _with_starts(layout: FitLayout, values: Mapping[str, float]) -> FitLayout:
    """Return the layout with starting values of some shared parameters replaced."""
    start = layout.start.copy()
    for i, name in enumerate(layout.shared):
        start[i] = np.clip(values.get(name, start[i]), layout.low[i], layout.high[i])
    return replace(layout, start=start)


def in_pieces(
    records: Sequence[Record],
    system: System,
    settings: FitSettings,
    local: Collection[str] = (),
    whole: FitLayout | None = None,
) -> list[list[Record]]:
    """Return each record as one piece, or cut into pieces that are short against the growth of an
    unstable motion.

    Each piece has its own initial state and biases. Records stay whole for models with lags or
    delays of inputs, and for fits with priors. ``whole`` is the layout of the records as they are,
    where there is one already.
    """
    layout = whole or lay_out(records, system, settings, local=local)
    if not layout.shared or layout.prior is not None or system.input_stages or quiet(layout):
        return [[record] for record in records]
    rate = fastest(next(from_regression(layout), layout))
    return [_cut(record, rate * _duration(record)) for record in records]


def started_unstable(
    records: Sequence[Record], system: System, settings: FitSettings, local: Collection[str] = ()
) -> System | None:
    """Return the System started at the derivatives of equation error, where its motion grows at
    these and not at the declared values; else None.

    Used if a fit from the declared values has not converged: these may hide that the aircraft is
    unstable.
    """
    layout = lay_out(records, system, settings, local=local)
    if not layout.shared or layout.prior is not None or not quiet(layout):
        return None
    first_fit = next(from_regression(layout), None)
    if first_fit is None or quiet(first_fit):
        return None
    return started_at(system, dict(zip(first_fit.shared, first_fit.start.tolist(), strict=False)))


def started_at(system: System, values: Mapping[str, float]) -> System:
    """Return the System with other starting values of some parameters."""
    return replace(system, parameters=system.parameters.with_values(values))


def put_together(
    parts: Sequence[np.ndarray], pieces: Sequence[Sequence[Record]]
) -> tuple[np.ndarray, ...]:
    """Return the rows ``(m, N)`` of pieces as those of the records that they were cut from."""
    left = iter(parts)
    return tuple(np.concatenate([next(left) for _ in each], axis=1) for each in pieces)


def said_of_pieces(pieces: Sequence[Sequence[Record]]) -> str:
    """Return a sentence if a record was cut, else an empty text."""
    count = sum(len(each) for each in pieces)
    if count == len(pieces):
        return ""
    return (
        f"the motion is unstable by itself: it is followed in {count} pieces, each with its own "
        "initial state and biases"
    )


def _cut(record: Record, grown: float) -> list[Record]:
    """Return pieces of a record whose motion grows by ``grown`` e-foldings, each with at least
    ``FEWEST_PIECE_SAMPLES`` samples.
    """
    count = min(
        ceil(min(grown, 1e6) / MOST_EFOLDINGS_PER_PIECE), len(record) // FEWEST_PIECE_SAMPLES
    )
    if grown <= MOST_EFOLDINGS_IN_ONE_FIT or count < 2:
        return [record]
    return [
        record.window(record.time[rows[0]], record.time[rows[-1]])
        for rows in np.array_split(np.arange(len(record)), count)
    ]


def _duration(record: Record) -> float:
    return float(record.time[-1] - record.time[0])


def quiet(layout: FitLayout, theta: np.ndarray | None = None) -> bool:
    """Return whether no mode grows enough to need a fit by parts, at ``theta`` (None: the
    start).
    """
    return (
        _start_growth(layout) <= MOST_EFOLDINGS_AT_ONCE
        if theta is None
        else growth(layout, theta) <= MOST_EFOLDINGS_AT_ONCE
    )


@lru_cache(maxsize=2)  # a fit needs its start several times
def _start_growth(layout: FitLayout) -> float:
    return growth(layout)


def runs_away(fit: Fit) -> bool:
    """Return whether the simulation differs from a record by ten times the record's own motion."""
    layout = fit.layout
    for i in np.flatnonzero(layout.used):
        known = [problem.valid[i] for problem in layout.problems]
        rows = [problem.z[i, valid] for problem, valid in zip(layout.problems, known, strict=True)]
        motion = np.concatenate([row - np.mean(row) for row in rows if row.size])
        error = np.concatenate([fit.residuals[r][i, valid] for r, valid in enumerate(known)])
        # a constant offset is a bias, which the first step of the fit removes
        error = error - np.mean(error)
        if np.sqrt(np.mean(error**2)) > RUNAWAY_RESIDUAL_RATIO * np.sqrt(np.mean(motion**2)) > 0.0:
            return True
    return False


def from_regression(layout: FitLayout) -> Iterator[FitLayout]:
    """Yield the layout started at the values of equation error; nothing if the record lacks states
    or the regression fails.
    """
    try:
        records = [problem.record for problem in layout.problems]
        found = run_equation_error(
            records, layout.system, RegressionSettings(tolerance=0.1, coloured=False)
        )
    except FlightidError:
        return
    if (
        found.outcome is not Outcome.CONVERGED
        or found.names != layout.shared
        or not np.all(np.isfinite(found.values))
    ):
        return
    n, start = len(layout.shared), layout.start.copy()
    start[:n] = np.clip(found.values, layout.low[:n], layout.high[:n])
    yield replace(layout, start=start)


def _first_converged(found: list[Fit | None], *starts: Iterator[FitLayout]) -> Fit | None:
    """Return the first converged fit over the starts, else the best of all, ``found`` included."""
    fits = list(found)
    for start in (each for some in starts for each in some):
        fit = fit_whole_records(FitProblem(start)) if quiet(start) else fit_unstable(start)
        if (
            fit is not None
            and fit.outcome is Outcome.CONVERGED
            and all(fit.cost <= other.cost for other in fits if other is not None)
        ):
            return fit
        fits.append(fit)
    known = [fit for fit in fits if fit is not None]
    return min(known, key=lambda fit: fit.cost, default=None)


# ---- Output-error fit

METHOD = "output-error"
_LEAST_NOISE_ROUNDINGS = 1e3  # largest residual, in roundings, of an exact fit
__all__ = ["FitSettings", "fit_output_error"]


def fit_output_error(
    records: Sequence[Record],
    system: System,
    settings: FitSettings | None = None,
    *,
    local: Collection[str] = (),
) -> Estimate:
    """Fit the free parameters of a System to records by whole-record simulation.

    Parameters
    ----------
    records : one or more; each has its own initial state and its own ``bias_*`` parameters.
    system : not compiled on line; bounds, and with ``use_priors`` priors, from its declaration.
    local : further parameters of which each record has its own; they are not returned.

    Returns
    -------
    Estimate of the shared free parameters; biases and initial states are nuisances, projected out
    of the covariance. Outcome ``NOT_IDENTIFIABLE`` when a direction of the parameters has no
    influence, ``DIVERGED`` when no finite cost was found, ``MAX_ITERATIONS`` when it had not
    settled, ``DEGENERATE`` when an output is met exactly and another is not. Where the start is
    unstable or its simulation runs away, or a fit from it does not settle, the fit begins from
    equation error, and a motion that grows beyond what can be followed is cut, which ``message``
    tells: see `ident.whole_record.output_error`.

    Raises
    ------
    ModelError : a record without any of the outputs, or nothing to estimate.
    """
    settings = settings or FitSettings()
    found = _fitted(records, system, settings, local)
    if found.outcome in (Outcome.CONVERGED, Outcome.DEGENERATE):
        return found
    unstable = started_unstable(records, system, settings, local)
    again = found if unstable is None else _fitted(records, unstable, settings, local)
    return again if again.outcome is Outcome.CONVERGED else found


def _fitted(
    records: Sequence[Record], system: System, settings: FitSettings, local: Collection[str]
) -> Estimate:
    layout = lay_out(records, system, settings, local=local)
    pieces = in_pieces(records, system, settings, local, layout)
    if sum(len(each) for each in pieces) > len(records):
        layout = lay_out(
            [piece for each in pieces for piece in each], system, settings, local=local
        )
    if not layout.shared:
        raise ModelError(
            "no parameter is free",
            where=f"model with {', '.join(system.parameters.names)}",
            remedy="release at least one",
        )
    fit = fit_from_best_start(layout)
    found = failed_estimate(layout) if fit is None else estimate_of(fit)
    message = "; ".join(
        sentence for sentence in (said_of_pieces(pieces), found.message) if sentence
    )
    return replace(found, fitted=put_together(found.fitted, pieces), message=message)


def shared_covariance(fit: Fit) -> tuple[np.ndarray, bool]:
    """Return the covariance of the shared parameters ``(s, s)`` and whether all are determined; for
    unstable motion the sensitivities are not squared.
    """
    n = len(fit.layout.shared)
    if fit.layout.prior is None and n and not quiet(fit.layout, fit.theta):
        return projected_covariance(fit)
    covariance, determined = fit_covariance(fit)
    return covariance[:n, :n], determined


def degenerate(fit: Fit) -> bool:
    """Return whether an output is fitted to rounding while another is not: the exact one then has
    unlimited weight.
    """
    above = np.sqrt(fit.variance / fit.layout.smallest)[fit.layout.used]
    return bool(np.any(above <= 1.0) and np.any(above > _LEAST_NOISE_ROUNDINGS))


def fit_covariance(fit: Fit) -> tuple[np.ndarray, bool]:
    """Return the covariance of all unknowns ``(n, n)``, corrected for coloured residuals as the
    settings say, and whether all are determined.
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
    known = prior_information(fit)
    if fit.noise_model.names:
        # Information from innovation covariances and priors: coloured residuals do not change it.
        known = np.array(normal)
        for r, problem in enumerate(layout.problems):
            weight = np.where(problem.valid, -1.0 / fit.variance[:, None], 0.0)
            add_normal_equations(
                known,
                np.zeros(len(known)),
                layout.columns(r),
                fit.jacobians[r],
                fit.residuals[r],
                weight,
            )
    if determined:
        return corrected_covariance(inverse, parts, fit.variance, known), True
    resolved, unknown = determined_and_open(normal, fit.theta)
    return corrected_covariance(resolved, parts, fit.variance, known) + unknown, False


def prior_information(fit: Fit) -> np.ndarray | None:
    """Return the information ``(n, n)`` of the priors about the unknowns of a fit; None if it has
    no priors.
    """
    prior = fit.layout.prior
    if prior is None:
        return None
    out = np.zeros((len(fit.theta), len(fit.theta)))
    out[np.ix_(prior.positions, prior.positions)] = prior.information
    return out


def estimate_of(fit: Fit) -> Estimate:
    """Return the shared parameters of a fit as an Estimate; its covariance includes the integration
    error where it matters.
    """
    layout, n = fit.layout, len(fit.layout.shared)
    covariance, determined = shared_covariance(fit)
    outcome = (
        Outcome.DEGENERATE
        if degenerate(fit)
        else fit.outcome
        if determined
        else Outcome.NOT_IDENTIFIABLE
    )
    found = Estimate(
        METHOD,
        layout.shared,
        tuple(layout.system.parameters[name].unit for name in layout.shared),
        fit.theta[:n].copy(),
        covariance,
        outcome,
        fit.log_likelihood,
        layout.system.output_names,
        np.sqrt(fit.variance),
        tuple(line.y for line in fit.lines),
        iterations=fit.iterations,
    )
    return with_integration_error(found, fit) if quiet(layout, fit.theta) else found


def failed_estimate(layout: FitLayout, method: str = METHOD) -> Estimate:
    """Return the start of a layout with sigmas equal to the values, for a fit without
    finite cost.
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


# ---- Failed fits by free simulation

UNDETERMINED = "the records determine none of the derivatives"


def failed_simulation(
    channels: Mapping[str, str], measured: Sequence[np.ndarray], residuals: Sequence[np.ndarray]
) -> str:
    """Return why simulated outputs do not fit the measurement; empty if they do.

    A simulation diverged if it differs from a channel by ten times the channel's motion. A fit also
    failed if constant channels would be likelier: a model at rest is always possible, so that such
    a fit is in no minimum.

    Parameters
    ----------
    channels : units by name.
    measured, residuals : of each channel the valid samples of all records, ``(K,)``; measured ones
        about each record's mean.
    """
    apart = []
    for values, left in zip(measured, residuals, strict=True):
        motion, error = float(np.sqrt(np.mean(values**2))), float(np.sqrt(np.mean(left**2)))
        apart.append((motion, error, len(values)))
    known = [
        (name, unit, *each)
        for (name, unit), each in zip(channels.items(), apart, strict=True)
        if each[0] > 0.0
    ]
    worst = max(known, key=lambda each: each[3] / each[2], default=None)
    if worst is None:
        return ""
    name, unit, motion, error, _ = worst
    worst_error = f"{name} error {error:.2g} {unit}, of a motion of {motion:.2g} {unit}"
    if not error <= RUNAWAY_RESIDUAL_RATIO * motion:
        return f"the free simulation runs away from the record ({worst_error})"
    likelier = sum(
        count * math.log(max(error, 1e-300) / motion) for _, _, motion, error, count in known
    )
    return (
        f"the fit explains nothing: constant levels are likelier ({worst_error})"
        if likelier > 0.0
        else ""
    )


def none_determined(sigmas: Iterable[tuple[float, float]]) -> bool:
    """Return whether no derivative is known within three times its declared size, from pairs of a
    standard deviation and the declared value.

    A vehicle file may be 30 % wrong; a sigma of ten times that adds no information. Values declared
    as zero do not count.
    """
    known = [(std, abs(declared)) for std, declared in sigmas if declared != 0.0]
    return bool(known) and all(not std <= IMPLAUSIBLE_CHANGE_FACTOR * size for std, size in known)


def failed_fit(fit: Fit, declared: Mapping[str, float]) -> tuple[str, str]:
    """Return why an output-error fit has failed, and a remedy; both empty if it has not.
    ``declared`` values by parameter.
    """
    layout = fit.layout
    names, problems = layout.system.output_names, layout.problems
    units = {output.name: output.unit for output in layout.system.outputs}
    used = [i for i in range(len(names)) if any(np.any(problem.valid[i]) for problem in problems)]
    known = [
        [
            (problem.z[i, row] - np.mean(problem.z[i, row]))
            for problem in problems
            if np.any(row := problem.valid[i])
        ]
        for i in used
    ]
    left = [
        [fit.residuals[r][i, problem.valid[i]] for r, problem in enumerate(problems)] for i in used
    ]
    channels = {names[i]: units[names[i]] for i in used}
    why = failed_simulation(
        channels, [np.concatenate(each) for each in known], [np.concatenate(each) for each in left]
    )
    if not why:
        with np.errstate(all="ignore"):
            covariance, _ = fit_covariance(fit)
        sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        pairs = [
            (float(sigmas[i]), declared[name])
            for i, name in enumerate(layout.shared)
            if name in declared
        ]
        why = UNDETERMINED if none_determined(pairs) else ""
    return (why, _remedy(fit)) if why else ("", "")


def _remedy(fit: Fit) -> str:
    """Return the remedy for a failed fit; for an unstable motion, the longest usable record."""
    layout = fit.layout
    rate = max(fastest(layout), fastest(layout, fit.theta))
    longest = max(
        float(problem.record.time[-1] - problem.record.time[0]) for problem in layout.problems
    )
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
