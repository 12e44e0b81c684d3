"""Fits of the kinematics, and estimates of faults by output error and by a smoother.

A gust w immediately changes the reading of the vane by w/V, and the load. The residual of the
kinematics is then correlated with nz and the rate of alpha, so that a regression on these is
biased. The controls are independent of the gust, so that filtered controls serve as instrumental
variables, here called instruments. A regression after projection onto them is unbiased for any
response of the aircraft (two-stage least squares; Sargan, Econometrica 26(3), 1958).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from ident.compatibility.kinematics import (
    SensorFault,
    Unknown,
    evaluate,
    linearised,
    start_of,
    unknowns_of,
)
from ident.compatibility.signals import (
    KinematicSignals,
    NoiseEvidence,
    RelationNoise,
    differences,
    estimated_noise,
    noise_from_roughness,
    walk_gains,
    whitener,
)
from ident.statistics.intervals import (
    DIFFERENCED_UNDETERMINED,
    bounded_inverse,
    inverse_information,
)
from ident.statistics.residual_spectrum import corrected_covariance
from sim.record import Record

# ---- Instruments: filtered controls, which distinguish a gust from a sensor fault

# bounds (s before the sample) of the intervals over which controls are averaged: the means
# represent an impulse response in steps
_INTERVAL_BOUNDS = (0.0, 0.08, 0.16, 0.28, 0.4, 0.55, 0.75, 1.0, 1.3, 1.7, 2.2, 2.8, 3.5, 4.5)
_SAMPLES_PER_INSTRUMENT = 6  # fewest samples for each instrument
_ROUNDING_EIGENVALUE_SHARE = 1e-9  # smallest eigenvalue above rounding, relative to the largest

ColumnMap = Callable[[np.ndarray], np.ndarray]


def instruments_of(record: Record, every: int = 1) -> np.ndarray:
    """Return the instruments ``(N, L)``: the mean of each control over past intervals, its first
    two integrals, and the terms of a parabola in time. L is 0 without a moving control.

    ``every`` : use only each ``every``-th bound of the intervals.
    """
    t = record.time - record.time[0]
    moved = [
        channel.values - channel.values[0]
        for channel in record.inputs
        if np.ptp(channel.values) > 0
    ]
    if not moved:
        return np.empty((len(t), 0))
    bounds: tuple[float, ...] = _INTERVAL_BOUNDS[::every]
    while len(moved) * len(bounds) * _SAMPLES_PER_INSTRUMENT > len(t) and len(bounds) > 3:
        bounds = bounds[::2]
    columns = [np.ones(len(t)), t, t**2]
    for u in moved:
        integral = _integral(u, t)
        past = [np.interp(t - bound, t, integral) for bound in bounds]
        columns += [newer - older for newer, older in pairwise(past)]
        columns += [integral, _integral(integral, t)]
    return np.array([column / max(float(np.abs(column).max()), 1e-300) for column in columns]).T


def instrumented(signals: Sequence[KinematicSignals]) -> bool:
    """Return whether every record has controls, which distinguish a gust from a fault."""
    return all(s.instruments.shape[1] for s in signals)


# Many faults are tried under one noise: the cache holds whiteners of the records of a check for a
# few noises.
@lru_cache(maxsize=24)
def projected_whitener(s: KinematicSignals, noise: RelationNoise) -> ColumnMap:
    """Return the function that whitens columns ``(m, N, c)`` to unit variance, and with instruments
    also projects them onto these. Columns are zero where a sample is missing.
    """
    white = whitener(s, noise)
    if not s.instruments.shape[1]:
        return white
    m, n = s.valid.shape
    flat = white.of_differences(s.instrument_differences).reshape(n, m, -1)
    project = _projection(_orthonormal(flat.transpose(1, 0, 2).reshape(m * n, -1)))
    return lambda columns: project(white(columns))


@lru_cache(maxsize=24)
def reduced_whitener(
    s: KinematicSignals, noise: RelationNoise
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function that maps columns ``(m, N, c)`` to fewer rows ``(K, c)`` with the same
    scalar products as the columns after `projected_whitener`.
    """
    white = whitener(s, noise)
    if not s.instruments.shape[1]:
        return lambda columns: white.of_differences(differences(columns))
    basis = _orthonormal(white.of_differences(s.instrument_differences))
    return lambda columns: basis.T @ white.of_differences(differences(columns))


def instrument_projection(s: KinematicSignals) -> ColumnMap:
    """Return the function that projects columns ``(m, N, c)`` onto the instruments; without
    instruments it leaves them as they are.
    """
    if not s.instruments.shape[1]:
        return lambda columns: columns
    wide = s.instruments_by_output
    return _projection(_orthonormal(wide.reshape(-1, wide.shape[2])))


def _projection(basis: np.ndarray) -> ColumnMap:
    """Return the projection of columns ``(m, N, c)`` onto an orthonormal ``basis (m N, r)``."""

    def project(columns: np.ndarray) -> np.ndarray:
        flat = columns.reshape(-1, columns.shape[2])
        return np.asarray((basis @ (basis.T @ flat)).reshape(columns.shape))

    return project


def _orthonormal(flat: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis ``(m N, r)`` of the columns ``flat (m N, c)``."""
    gram = flat.T @ flat
    scale = 1.0 / np.sqrt(np.where(np.diag(gram) > 0, np.diag(gram), 1.0))
    values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
    determined = values > _ROUNDING_EIGENVALUE_SHARE * values[-1]
    return np.asarray(
        flat @ (scale[:, None] * vectors[:, determined] / np.sqrt(values[determined]))
    )


def _integral(u: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the integral ``(N,)`` of ``u (N,)`` over time by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (u[1:] + u[:-1]))])


# ---- Fits of the kinematics to records

_MOST_ITERATIONS = 8  # most Gauss-Newton steps under one noise
_NEGLIGIBLE_GAIN = 2e-3  # twice the smallest expected gain of log likelihood by a step
_NEGLIGIBLE_LOG_CHANGE = 0.05  # a fit ends when the logarithms of all noise variances change less
_FIRST_NOISE_PASSES, _NOISE_PASSES = 6, 2  # Newton steps on the noise: in a first fit, and later
_LARGEST_RESIDUAL = 1e6  # a reconstruction with larger residuals has diverged


@dataclass(frozen=True, eq=False)
class KinematicFit:
    """A fit of the kinematics to records.

    Attributes
    ----------
    faults : the k fitted faults.
    sizes : ``(k,)`` their sizes.
    own : ``(n,)`` of each record, values of the unknowns that belong to it alone.
    noise : noise of the relations.
    cost : minus the log likelihood, with the terms of the priors.
    residuals : ``(m, N)`` of each record, zero where a sample is missing.
    jacobians : ``(m, N, n + k)`` of each record, derivatives of ``outputs`` with respect to
        ``unknown_values`` and ``sizes``.
    outputs : ``(m, N)`` of each record, expected sensor readings.
    """

    signals: tuple[KinematicSignals, ...]
    faults: tuple[SensorFault, ...]
    sizes: np.ndarray
    unknown_values: tuple[np.ndarray, ...]
    noise: RelationNoise
    cost: float
    residuals: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]
    outputs: tuple[np.ndarray, ...]


def fit(
    signals: Sequence[KinematicSignals],
    faults: Sequence[SensorFault] = (),
    begin: KinematicFit | None = None,
    first: np.ndarray | None = None,
    passes: int = 3,
) -> KinematicFit:
    """Return the smoother fit. It alternates between Gauss-Newton steps, weighted by the noise of
    outputs and inputs, and Newton steps on the noise variances.

    Parameters
    ----------
    begin : fit of the same records that gives the starting values; None takes those of `start_of`.
    first : ``(k,)`` starting sizes of the faults; None takes those of ``begin``, or zero.
    passes : most repetitions of both kinds of steps.
    """
    unknowns = [unknowns_of(s) for s in signals]
    if begin is None:
        unknown_values = [start_of(s, items) for s, items in zip(signals, unknowns, strict=True)]
    else:
        unknown_values = [np.array(values) for values in begin.unknown_values]
    sizes = starting_sizes(faults, begin) if first is None else first.astype(float)
    rough_noise = noise_from_roughness(signals)
    noise = begin.noise if begin is not None else rough_noise
    priors = [np.array([1.0 / item.prior**2 for item in u]) for u in unknowns]
    linear = [
        linearised(s, u, faults, o, sizes)
        for s, u, o in zip(signals, unknowns, unknown_values, strict=True)
    ]
    search = KinematicDescent(
        tuple(signals), tuple(unknowns), tuple(faults), tuple(priors), evaluate, linearised
    )
    cost = 0.0
    for turn in range(passes):
        whiteners = [projected_whitener(s, noise) for s in signals]
        unknown_values, sizes, linear = descend(search, (unknown_values, sizes, linear), whiteners)
        before = noise.logs
        residuals = tuple(residual_of(s, y) for s, (y, _) in zip(signals, linear, strict=True))
        columns = tuple(
            np.where(s.valid[:, :, None], slope[:, :, : len(o)], 0.0)
            for s, (_, slope), o in zip(signals, linear, unknown_values, strict=True)
        )
        noise, cost = estimated_noise(
            NoiseEvidence(tuple(signals), residuals, columns, tuple(priors), rough_noise),
            noise,
            _FIRST_NOISE_PASSES if begin is None and turn == 0 else _NOISE_PASSES,
        )
        if turn and np.all(np.abs(noise.logs - before) < _NEGLIGIBLE_LOG_CHANGE):
            break
    cost += sum(
        0.5 * float(np.sum(prior * o**2)) for prior, o in zip(priors, unknown_values, strict=True)
    )
    return KinematicFit(
        tuple(signals),
        tuple(faults),
        sizes,
        tuple(unknown_values),
        noise,
        cost,
        residuals,
        tuple(slope for _, slope in linear),
        tuple(y for y, _ in linear),
    )


# values of the unknowns of each record, sizes of the faults, and for each record the outputs and
# their derivatives
DescentPoint = tuple[list[np.ndarray], np.ndarray, list[tuple[np.ndarray, np.ndarray]]]


@dataclass(frozen=True, eq=False)
class KinematicDescent:
    """Functions and settings of Gauss-Newton steps, for any kinematics.

    ``evaluate`` returns the outputs of the kinematics, and ``linearised`` also their derivatives.
    ``priors (n,)`` of each record are one over the prior variances of its unknowns. The ``shares``
    of a step are tried in turn until one gains. The descent ends after ``steps`` steps, or after a
    gain of less than ``enough``.
    """

    signals: tuple[KinematicSignals, ...]
    unknowns: tuple[Sequence[Unknown], ...]
    faults: tuple[SensorFault, ...]
    priors: tuple[np.ndarray, ...]
    evaluate: Callable[..., np.ndarray]
    linearised: Callable[..., tuple[np.ndarray, np.ndarray]]
    shares: tuple[float, ...] = (1.0, 0.5, 0.2, 0.05, 0.01)
    steps: int = _MOST_ITERATIONS
    enough: float = 0.0


def descend(
    search: KinematicDescent, start: DescentPoint, whiteners: Sequence[ColumnMap]
) -> DescentPoint:
    """Return the least-squares point under the noise of the ``whiteners`` of the records."""
    (unknown_values, sizes, linear), signals, priors = start, search.signals, search.priors
    largest = np.array([fault.largest for fault in search.faults])
    cost = misfit(signals, priors, unknown_values, [y for y, _ in linear], whiteners)
    for _ in range(search.steps):
        information, gradient = normal_equations(signals, priors, unknown_values, linear, whiteners)
        step = bounded_inverse(information) @ gradient
        if float(gradient @ step) < _NEGLIGIBLE_GAIN:
            break
        for share in search.shares:
            changes = np.split(share * step, np.cumsum([len(o) for o in unknown_values]))
            trial_own = [o + change for o, change in zip(unknown_values, changes, strict=False)]
            trial_sizes = np.clip(sizes + changes[-1], -largest, largest)
            outputs = [
                search.evaluate(s, u, search.faults, o[None], trial_sizes[None])[:, 0]
                for s, u, o in zip(signals, search.unknowns, trial_own, strict=True)
            ]
            trial_cost = misfit(signals, priors, trial_own, outputs, whiteners)
            if trial_cost < cost:
                break
        else:
            break
        unknown_values, sizes, gain, cost = trial_own, trial_sizes, cost - trial_cost, trial_cost
        linear = [
            search.linearised(s, u, search.faults, o, sizes)
            for s, u, o in zip(signals, search.unknowns, unknown_values, strict=True)
        ]
        if gain < search.enough:
            break
    return unknown_values, sizes, linear


def starting_sizes(faults: Sequence[SensorFault], begin: KinematicFit | None) -> np.ndarray:
    """Return the sizes ``(k,)`` of faults in the fit ``begin``; a fault that the fit does not have
    starts at zero. None means no fit.
    """
    known = {} if begin is None else dict(zip(begin.faults, begin.sizes.tolist(), strict=True))
    return np.array([known.get(fault, 0.0) for fault in faults], dtype=float)


def misfit(
    signals: Sequence[KinematicSignals],
    priors: Sequence[np.ndarray],
    unknown_values: Sequence[np.ndarray],
    outputs: Sequence[np.ndarray],
    whiteners: Sequence[ColumnMap],
) -> float:
    """Return half the sum of squares of whitened residuals and of unknowns over their prior sigmas;
    infinite if the reconstruction diverges.
    """
    total = 0.0
    for s, prior, o, y, white in zip(
        signals, priors, unknown_values, outputs, whiteners, strict=True
    ):
        residual = residual_of(s, y)
        # the square of a divergent reconstruction overflows
        if not np.all(np.abs(residual) < _LARGEST_RESIDUAL):
            return float("inf")
        total += 0.5 * float(np.sum(white(residual[:, :, None]) ** 2))
        total += 0.5 * float(np.sum(prior * o**2))
    return total


def whitened(kinematic_fit: KinematicFit) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the residual ``(m, N)`` and Jacobian ``(m, N, c)`` of each record, whitened to unit
    variance.

    With instruments only the Jacobian is projected onto them, which suffices: the gradient is the
    product of Jacobian and residual.
    """
    pairs = []
    for s, residual, jacobian in zip(
        kinematic_fit.signals, kinematic_fit.residuals, kinematic_fit.jacobians, strict=True
    ):
        e = whitener(s, kinematic_fit.noise)(residual[:, :, None])[:, :, 0]
        columns = np.where(s.valid[:, :, None], jacobian, 0.0)
        pairs.append((e, projected_whitener(s, kinematic_fit.noise)(columns)))
    return pairs


def least_misfit(
    kinematic_fit: KinematicFit,
    whiteners: Sequence[ColumnMap],
    priors: Sequence[np.ndarray] | None = None,
) -> float:
    """Return the least misfit under another noise than that of the fit. The outputs are linearised
    at the fit.

    Parameters
    ----------
    whiteners : `projected_whitener` of the other noise, one for each record.
    priors : ``(n,)`` of each record, one over the prior variances of its unknowns; None takes those
        of the longitudinal kinematics.
    """
    if priors is None:
        priors = [
            np.array([1.0 / item.prior**2 for item in unknowns_of(s)])
            for s in kinematic_fit.signals
        ]
    linear = list(zip(kinematic_fit.outputs, kinematic_fit.jacobians, strict=True))
    information, gradient = normal_equations(
        kinematic_fit.signals, priors, kinematic_fit.unknown_values, linear, whiteners
    )
    misfit_of_fit = misfit(
        kinematic_fit.signals,
        priors,
        kinematic_fit.unknown_values,
        kinematic_fit.outputs,
        whiteners,
    )
    return misfit_of_fit - 0.5 * float(gradient @ bounded_inverse(information) @ gradient)


def positions(kinematic_fit: KinematicFit) -> list[np.ndarray]:
    """Return for each record the positions of the columns of its Jacobian among all unknowns of the
    fit. These are the unknowns of each record in turn, then the sizes of the faults.
    """
    total, columns, begin = (
        sum(len(unknown_values) for unknown_values in kinematic_fit.unknown_values),
        [],
        0,
    )
    sizes = total + np.arange(len(kinematic_fit.faults))
    for unknown_values in kinematic_fit.unknown_values:
        columns.append(np.concatenate([np.arange(begin, begin + len(unknown_values)), sizes]))
        begin += len(unknown_values)
    return columns


def prior_information(kinematic_fit: KinematicFit) -> np.ndarray:
    """Return the diagonal ``(n,)`` of the information that the priors give on all unknowns."""
    unknown_values = [
        [1.0 / item.prior**2 for item in unknowns_of(s)] for s in kinematic_fit.signals
    ]
    return np.concatenate([*map(np.array, unknown_values), np.zeros(len(kinematic_fit.faults))])


def normal_equations(
    signals: Sequence[KinematicSignals],
    priors: Sequence[np.ndarray],
    unknown_values: Sequence[np.ndarray],
    linear: Sequence[tuple[np.ndarray, np.ndarray]],
    whiteners: Sequence[ColumnMap],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the information ``(n, n)`` and gradient ``(n,)`` of the log likelihood, in the order
    of `positions`.
    """
    total = sum(len(o) for o in unknown_values)
    faults = linear[0][1].shape[2] - len(unknown_values[0])
    information = np.zeros((total + faults, total + faults))
    gradient, begin = np.zeros(total + faults), 0
    for s, prior, o, (y, slope), white in zip(
        signals, priors, unknown_values, linear, whiteners, strict=True
    ):
        columns = np.concatenate(
            [residual_of(s, y)[:, :, None], np.where(s.valid[:, :, None], slope, 0.0)], axis=2
        )
        all_columns = white(columns).reshape(-1, columns.shape[2])
        product = all_columns.T @ all_columns
        unknowns = np.concatenate([np.arange(begin, begin + len(o)), total + np.arange(faults)])
        information[np.ix_(unknowns, unknowns)] += product[1:, 1:]
        gradient[unknowns] += product[1:, 0]
        gradient[begin : begin + len(o)] -= prior * o
        information[np.arange(begin, begin + len(o)), np.arange(begin, begin + len(o))] += prior
        begin += len(o)
    return information, gradient


def residual_of(s: KinematicSignals, y: np.ndarray) -> np.ndarray:
    """Return measured minus reconstructed outputs ``(m, N)``, zero where a sample is missing."""
    measured = np.array([s.channels[name] for name in s.outputs])
    return np.where(s.valid, measured - y, 0.0)


# ---- Output error and smoother compared

_SMALL_STEP = 0.1  # an output-error fit ends when a step is shorter, in sigmas
# smallest variance of a difference of two estimates, over the larger one of their variances
_LEAST_VARIANCE_SHARE = 0.2
MOST_PASSES = 4  # most steps of an output-error fit


@dataclass(frozen=True, eq=False)
class Sigmas:
    """Covariance ``(n, n)`` of all unknowns under the noise of a smoother fit, and the ``widening
    (n,)`` factors on the variances for coloured residuals.
    """

    covariance: np.ndarray
    widening: np.ndarray


def smoother_sigmas(kinematic_fit: KinematicFit) -> Sigmas:
    """Return the uncertainty of a fit. The factors for coloured innovations are those of
    `ident.statistics.residual_spectrum`.
    """
    white, places = whitened(kinematic_fit), positions(kinematic_fit)
    information = np.diag(prior_information(kinematic_fit))
    for (_, jacobian), where in zip(white, places, strict=True):
        J = jacobian.reshape(-1, jacobian.shape[2])
        information[np.ix_(where, where)] += J.T @ J
    inverse, _ = inverse_information(information, floor=DIFFERENCED_UNDETERMINED)
    parts = [
        (where, jacobian, e, s.valid)
        for (e, jacobian), where, s in zip(white, places, kinematic_fit.signals, strict=True)
    ]
    corrected = corrected_covariance(inverse, parts, np.ones(len(kinematic_fit.noise.outputs)))
    white_variance, variance = np.diag(inverse), np.diag(corrected)
    known = white_variance > 0
    widening = np.divide(variance, white_variance, out=np.ones_like(variance), where=known)
    return Sigmas(inverse, np.maximum(widening, 1.0))


def output_error(kinematic_fit: KinematicFit) -> tuple[np.ndarray, np.ndarray]:
    """Return the values ``(n,)`` of all unknowns by output error, and their covariance ``(n, n)``.
    The iteration starts at a smoother fit.

    The weights of the residuals are one over their mean squares, as for white residuals. The
    covariance also includes the noise of the inputs, which the smoother fit gives.
    """
    unknown_values, sizes, places = (
        list(kinematic_fit.unknown_values),
        kinematic_fit.sizes,
        positions(kinematic_fit),
    )
    prior = prior_information(kinematic_fit)
    unknowns = [unknowns_of(s) for s in kinematic_fit.signals]
    largest = np.array([fault.largest for fault in kinematic_fit.faults])
    total = len(prior) - len(sizes)
    linear = list(zip(kinematic_fit.outputs, kinematic_fit.jacobians, strict=True))
    projections = [instrument_projection(s) for s in kinematic_fit.signals]
    for turn in range(MOST_PASSES):
        if turn:
            linear = [
                linearised(s, u, kinematic_fit.faults, o, sizes)
                for s, u, o in zip(kinematic_fit.signals, unknowns, unknown_values, strict=True)
            ]
        residuals = [
            residual_of(s, y) for s, (y, _) in zip(kinematic_fit.signals, linear, strict=True)
        ]
        counts = np.sum([s.valid.sum(axis=1) for s in kinematic_fit.signals], axis=0)
        variance = np.maximum(
            np.sum([(e**2).sum(axis=1) for e in residuals], axis=0) / np.maximum(counts, 1), 1e-30
        )
        information, gradient = np.diag(prior), np.zeros(len(prior))
        columns = []
        for s, project, e, (_, slope), where in zip(
            kinematic_fit.signals, projections, residuals, linear, places, strict=True
        ):
            J = project(np.where(s.valid[:, :, None], slope, 0.0)) / variance[:, None, None]
            columns.append(J)
            information[np.ix_(where, where)] += np.einsum("mnc,mnd->cd", J, slope)
            gradient[where] += np.einsum("mnc,mn->c", J, e)
        gradient[:total] -= prior[:total] * np.concatenate(unknown_values)
        inverse = bounded_inverse(information)
        step = inverse @ gradient
        *own_steps, size_step = np.split(step, np.cumsum([len(o) for o in unknown_values]))
        unknown_values = [
            o + own_step for o, own_step in zip(unknown_values, own_steps, strict=True)
        ]
        sizes = np.clip(sizes + size_step, -largest, largest)
        if np.all(np.abs(step) <= _SMALL_STEP * np.sqrt(np.maximum(np.diag(inverse), 1e-300))):
            break
    gradient_covariance = np.diag(prior)
    for s, J, where in zip(kinematic_fit.signals, columns, places, strict=True):
        gradient_covariance[np.ix_(where, where)] += np.einsum(
            "mnc,m,mnd->cd", J, kinematic_fit.noise.white, J
        )
        later_sums = np.cumsum(J[:, ::-1], axis=1)[:, ::-1][:, 1:]
        walk = (
            np.einsum("mi,mnc->inc", walk_gains(s, kinematic_fit.noise), later_sums)
            * s.steps[None, :, None]
        )
        gradient_covariance[np.ix_(where, where)] += np.einsum(
            "inc,i,ind->cd", walk, kinematic_fit.noise.density, walk
        )
    inverse, _ = inverse_information(information, floor=DIFFERENCED_UNDETERMINED)
    return np.concatenate([*unknown_values, sizes]), _sandwich(inverse, gradient_covariance)


def _sandwich(inverse: np.ndarray, gradient_covariance: np.ndarray) -> np.ndarray:
    """Return ``inverse gradient_covariance inverse`` as a product that has no negative variance."""
    scale = np.sqrt(np.maximum(np.diag(gradient_covariance), 1e-300))
    values, vectors = np.linalg.eigh(gradient_covariance / np.outer(scale, scale))
    half = inverse @ (scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
    return np.asarray(half @ half.T)


def difference_in_sigmas(
    value: float, variance: float, efficient_value: float, efficient_variance: float
) -> float:
    """Return the difference of an estimate and an efficient one, over its standard deviation.

    The variance of the difference is the difference of both variances (Hausman, Econometrica 46(6),
    1978).
    """
    # Where both variances are nearly equal, nonlinear terms exceed their difference.
    least = _LEAST_VARIANCE_SHARE * max(variance, efficient_variance)
    difference_variance = max(variance - efficient_variance, least)
    if difference_variance <= 0:
        return 0.0
    return (value - efficient_value) / math.sqrt(difference_variance)
