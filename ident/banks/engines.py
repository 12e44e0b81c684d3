"""Iterated extended Kalman filters for many runs, and the two engines that run filters.

The smoothed trajectory of the iterated filter comes from the modified Bryson-Frazier recursion,
which inverts only the covariance of the innovations (Bierman, "Fixed Interval Smoothing with
Discrete Measurements", Int. J. Control 18(1), 1973).

The engines solve the same equations and agree to rounding; docs/decisions/0022-who-runs-the-bank.md
compares their times. By default filterpy filters a single record, and the batched kernel a bank of
delays. ``compare_with_filterpy`` compares the most likely filter of a bank with that of filterpy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import (
    BankEstimate,
    bank_estimate,
    bank_runs,
    filter_alone,
    filter_batched,
    run_bank,
    run_pass,
)
from ident.banks.block_kernels import BankTrace, empty_trace
from ident.estimate import Estimate, Outcome
from ident.filters.ekf import SETTLED_SIGMAS, FilterSettings, OnePass, filter_by_filterpy, run_ekf
from ident.filters.problem import filter_problem
from ident.filters.smoother import smooth
from sim.declaration.model import System
from sim.record import Record

# ---- Iterated extended Kalman filters for many runs at once

MOST_ITERATIONS = 15  # most passes of an iterated filter


def run_iterated_bank(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    *,
    fixed_values: Mapping[str, np.ndarray] | None = None,
    nominal: np.ndarray | None = None,
    iterations: int = MOST_ITERATIONS,
    tolerance: float = SETTLED_SIGMAS,
) -> tuple[BankEstimate, np.ndarray]:
    """Run B filters, each linearised about its own smoothed trajectory, in passes until they
    converge.

    Parameters
    ----------
    record, system, settings, fixed_values : as for ``run_bank``; ``settings.passes`` is not used.
    nominal : ``(n, N, B)`` or ``(n, N, 1)`` trajectories about which the first pass is linearised,
        for example those of a similar run; None takes the means of the filters.
    iterations : largest number of passes. A run that has then not converged, or has broken down, is
        not sound.
    tolerance : a run has converged when no parameter changes by more than this many sigmas.

    Returns
    -------
    The estimates of the last pass, and its smoothed trajectories ``(n, N, B)``.

    Raises
    ------
    ModelError : as for ``run_bank``.
    """
    settings = settings or FilterSettings()
    problem, runs = bank_runs(record, system, settings, fixed_values=fixed_values)
    n_x, count = len(system.states), runs.start.shape[1]
    if nominal is not None:
        nominal = np.array(np.broadcast_to(nominal, (len(problem.names), len(problem.time), count)))
    before, converged, passes = None, np.zeros(count, dtype=bool), 0
    while True:
        passes += 1
        trace = empty_trace(problem, count)
        result = run_pass(problem, settings, runs, False, nominal, trace)
        with np.errstate(all="ignore"):
            nominal = smoothed(trace)
        # Linearise a failed run about its start, so that it does not disturb the others.
        nominal[:, :, ~result.sound] = runs.start[:, None, ~result.sound]
        if before is not None:
            std = np.sqrt(
                np.maximum(
                    np.diagonal(result.covariance, axis1=1, axis2=2).T[n_x:], np.finfo(float).tiny
                )
            )
            converged = (
                np.max(np.abs(result.mean[n_x:] - before) / std, axis=0, initial=0.0) < tolerance
            )
            if np.all(converged | ~result.sound):
                break
        if passes == iterations:
            break
        before = result.mean[n_x:]
    return bank_estimate(
        problem, result, np.full(count, passes), sound=result.sound & converged
    ), nominal


def smoothed(trace: BankTrace) -> np.ndarray:
    """Return the smoothed means ``(n, N, B)`` of the linearised problem of a pass.

    The adjoint recursion is lambda[k] = l[k] - H^T S^-1 (H P l[k] + y), with l[k] = Phi[k+1]^T
    lambda[k+1] and l = 0 at the last sample. The smoothed mean is x - P l[k], with x and P after
    the update.
    """
    N, n, B = trace.mean.shape
    n_x = trace.transition.shape[2]
    inverse = _inverse(trace.S)
    means = np.empty((n, N, B))
    later = np.zeros((B, n, 1))
    for k in range(N - 1, -1, -1):
        means[:, k] = trace.mean[k] - (trace.covariance[k] @ later)[:, :, 0].T
        weighted = inverse[k] @ (trace.HP[k] @ later + trace.y[k][:, :, None])
        adjoint = later - np.swapaxes(trace.H[k], 1, 2) @ weighted
        later = adjoint + np.swapaxes(trace.transition[k], 1, 2) @ adjoint[:, :n_x]
    return means


def _inverse(S: np.ndarray) -> np.ndarray:
    """Return the inverses of covariances ``(N, B, m, m)``; pseudo-inverses if one is singular."""
    try:
        return np.linalg.inv(S)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(np.nan_to_num(S))


# ---- The two engines


@dataclass(frozen=True)
class BankEngine:
    """Functions of an engine that runs an extended Kalman filter, alone or in a bank of delays.

    Attributes
    ----------
    name : key in ``ENGINES``, in scenario files, on the command line and in study files.
    label : name in reports.
    run : function that runs a filter for each value of a fixed parameter, as ``run_bank``.
    iterated : the same with each filter linearised about its own smoothed result, as
        ``run_iterated_bank``.
    alone : function that runs one filter and returns its history, as ``filter_alone``.
    one_pass : function that runs one pass, as ``filter_by_filterpy``.
    """

    name: str
    label: str
    run: Callable[..., BankEstimate]
    iterated: Callable[..., tuple[BankEstimate, np.ndarray]]
    alone: Callable[[Record, System, FilterSettings | None, np.ndarray | None], Estimate]
    one_pass: OnePass


def run_one_by_one(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    *,
    fixed_values: Mapping[str, np.ndarray],
) -> BankEstimate:
    """Return the result of ``run_bank`` by B calls of ``run_ekf`` with filterpy; ``fixed_values``
    maps a parameter to its values ``(B,)``.
    """
    estimates = [
        run_ekf(record, fixed_system, settings, by=filter_by_filterpy)
        for fixed_system in _systems(system, fixed_values)
    ]
    sound = [estimate.outcome is Outcome.CONVERGED for estimate in estimates]
    return _bank(estimates, np.array(sound))


def run_iterated_one_by_one(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    *,
    fixed_values: Mapping[str, np.ndarray],
    nominal: np.ndarray | None = None,
    iterations: int = MOST_ITERATIONS,
    tolerance: float = SETTLED_SIGMAS,
) -> tuple[BankEstimate, np.ndarray]:
    """Return the result of ``run_iterated_bank``, computed with filterpy. Arguments and errors are
    the same.
    """
    settings = settings or FilterSettings()
    problems = [
        filter_problem(record, fixed_system, settings.max_step)
        for fixed_system in _systems(system, fixed_values)
    ]
    count, N = len(problems), len(record)
    points: list[np.ndarray | None] = (
        [None] * count
        if nominal is None
        else list(np.moveaxis(np.broadcast_to(nominal, (*nominal.shape[:2], count)), 2, 0))
    )
    before: np.ndarray | None = None
    converged, passes = np.zeros(count, dtype=bool), 0
    while True:
        passes += 1
        estimates = [
            filter_by_filterpy(problem, settings, nominal=point)
            for problem, point in zip(problems, points, strict=True)
        ]
        sound = np.array([item.outcome is Outcome.CONVERGED for item in estimates])
        # A failed filter is linearised about its start.
        points = [
            smooth(estimate.history).mean
            if finite and estimate.history is not None
            else np.repeat(problem.start[:, None], N, axis=1)
            for problem, estimate, finite in zip(problems, estimates, sound, strict=True)
        ]
        values = np.stack([estimate.values for estimate in estimates], axis=1)
        std = np.stack([estimate.std for estimate in estimates], axis=1)
        if before is not None:
            sigmas = np.abs(values - before) / np.maximum(std, np.finfo(float).tiny)
            converged = np.max(sigmas, axis=0, initial=0.0) < tolerance
        if (np.all(converged | ~sound) and before is not None) or passes == iterations:
            break
        before = values
    trajectories = [point for point in points if point is not None]
    return replace(
        _bank(estimates, sound & converged), iterations=np.full(count, passes)
    ), np.stack(trajectories, axis=2)


def alone_by_filterpy(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    nominal: np.ndarray | None = None,
) -> Estimate:
    """Return the result of ``filter_alone``, computed with filterpy. Arguments are the same."""
    settings = settings or FilterSettings()
    return filter_by_filterpy(
        filter_problem(record, system, settings.max_step), settings, nominal=nominal
    )


BATCHED = BankEngine(
    "batched", "batched kernel", run_bank, run_iterated_bank, filter_alone, filter_batched
)
FILTERPY = BankEngine(
    "filterpy",
    "filterpy ExtendedKalmanFilter",
    run_one_by_one,
    run_iterated_one_by_one,
    alone_by_filterpy,
    filter_by_filterpy,
)
ENGINES: Mapping[str, BankEngine] = {engine.name: engine for engine in (FILTERPY, BATCHED)}


@dataclass(frozen=True)
class FilterpyDifferences:
    """Differences between the batched kernel and filterpy, for the most likely filter of a bank in
    one pass.

    Attributes
    ----------
    delay : delay of this filter, s.
    mean, std : largest differences of states and parameters, and of their standard deviations,
        after the last sample, in sigmas.
    log_likelihood : relative difference of the log likelihoods.
    """

    delay: float
    mean: float
    std: float
    log_likelihood: float

    @property
    def sigmas(self) -> float:
        """The larger of the differences of means and of standard deviations, in sigmas."""
        return max(self.mean, self.std)


def compare_with_filterpy(
    record: Record, system: System, bank: BankEstimate, values: np.ndarray
) -> FilterpyDifferences | None:
    """Compare the most likely filter of a batched bank of one pass with the same filter by
    filterpy.

    Parameters
    ----------
    record, system : record and System of the bank.
    bank : result of the batched bank.
    values : ``(B,)`` delays of its filters, s.

    Returns
    -------
    The differences; None where no filter of the bank is sound.
    """
    best = int(np.argmax(bank.log_likelihood))
    if not bank.sound[best]:
        return None
    best_filter = replace(
        bank,
        mean=bank.mean[:, best : best + 1],
        covariance=bank.covariance[best : best + 1],
        log_likelihood=bank.log_likelihood[best : best + 1],
        sound=bank.sound[best : best + 1],
    )
    single_pass = replace(FilterSettings(), passes=1)
    differences = bank_differences(
        best_filter,
        run_one_by_one(
            record, system, single_pass, fixed_values={"delay": np.atleast_1d(values[best])}
        ),
    )
    if not differences.sound:
        return None
    return FilterpyDifferences(
        float(values[best]), differences.mean, differences.std, differences.log_likelihood
    )


@dataclass(frozen=True)
class BankDifferences:
    """Largest differences between two banks over the same delays, for runs that are sound in both.

    Attributes
    ----------
    mean : difference of states and parameters after the last sample, in sigmas.
    std : relative difference of their standard deviations.
    log_likelihood : relative difference of the log likelihoods.
    sound : whether the same runs are sound in both banks.
    """

    mean: float
    std: float
    log_likelihood: float
    sound: bool

    @property
    def largest(self) -> float:
        """The largest of the three differences."""
        return max(self.mean, self.std, self.log_likelihood)


def bank_differences(first: BankEstimate, second: BankEstimate) -> BankDifferences:
    """Return the differences between two banks of the same runs, in sigmas of the ``first``."""
    both = first.sound & second.sound
    sigma = np.maximum(first.std[:, both], np.finfo(float).tiny)
    likelihood = first.log_likelihood[both]
    return BankDifferences(
        float(np.max(np.abs(second.mean[:, both] - first.mean[:, both]) / sigma, initial=0.0)),
        float(np.max(np.abs(second.std[:, both] / sigma - 1.0), initial=0.0)),
        float(
            np.max(
                np.abs(second.log_likelihood[both] - likelihood) / np.abs(likelihood), initial=0.0
            )
        ),
        bool(np.array_equal(first.sound, second.sound)),
    )


def _systems(system: System, fixed_values: Mapping[str, np.ndarray]) -> list[System]:
    """Return the System of each run: ``system`` with the fixed values of this run."""
    runs = zip(*(np.atleast_1d(values).tolist() for values in fixed_values.values()), strict=True)
    return [
        replace(
            system,
            parameters=system.parameters.with_values(dict(zip(fixed_values, values, strict=True))),
        )
        for values in runs
    ]


def _bank(estimates: list[Estimate], sound: np.ndarray) -> BankEstimate:
    """Return single filters as a bank. A run that is not ``sound (B,)`` has zero likelihood."""
    histories = [item.history for item in estimates if item.history is not None]
    assert len(histories) == len(estimates)
    return BankEstimate(
        histories[0].names,
        np.stack([history.mean[:, -1] for history in histories], axis=1),
        np.stack([history.covariance[-1] for history in histories]),
        np.where(sound, [estimate.log_likelihood for estimate in estimates], -np.inf),
        np.stack([history.nis for history in histories], axis=1),
        sound,
        np.array([estimate.iterations for estimate in estimates]),
    )
