"""Fits of the kinematics of six degrees of freedom, in full and to first order.

Slopes with respect to delays and lags are secants: at size zero, the derivatives of a delay and of
a lag are equal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np

from ident.compatibility.fitting import (
    MOST_PASSES,
    KinematicDescent,
    KinematicFit,
    descend,
    instrument_projection,
    instrumented,
    least_misfit,
    misfit,
    projected_whitener,
    reduced_whitener,
    residual_of,
    starting_sizes,
)
from ident.compatibility.kinematics import BIAS, DELAY, LAG, SensorFault
from ident.compatibility.signals import (
    KinematicSignals,
    RelationNoise,
    differences,
    inputs_of,
    roughness,
    rounding_variances,
    walk_gains,
    whitener,
)
from ident.compatibility.six_degrees.kinematics import evaluate, linearised, start_of, unknowns_of
from ident.statistics.intervals import bounded_inverse
from ident.statistics.residual_spectrum import autocovariance

# ---- White noise of the outputs, and random walks by the noise of integrated inputs

# grid of ratios: variance that the walk gains over one step, over the white variance
_WALK_TO_WHITE_RATIOS = np.logspace(-6.0, 4.0, 21)
_ROUNDING_EIGENVALUE_SHARE = 1e-10  # smallest eigenvalue above rounding, relative to the largest
_LEAST_WALK_SHARE = 0.1  # smallest walk, relative to the noise of its inputs by their roughness
# prior of the walk's level: standard deviation of its logarithm below the expected level
_LOG_LEVEL_STD_BELOW = 0.5
_LOG_LEVEL_STD_ABOVE = 3.0  # the same above that level: other errors add to the noise of inputs
_GOLDEN_SECTION, _GOLDEN_SECTION_STEPS = 0.382, 12  # search for the best ratio between grid points
_FEWEST_NOISE_SAMPLES = 5  # fewest samples, less the fitted unknowns, that give a noise level
_LEAST_WHITE_SHARE = 1e-3  # smallest white variance, relative to that from the roughness
_MISSING_VARIANCE = 1e8  # variance of a missing sample, relative to a valid one


def inputs_with_walk(s: KinematicSignals) -> tuple[str, ...]:
    """Return the channels whose noise causes a random walk in an output: the recorded inputs of all
    relations, each listed once.
    """
    return tuple(
        dict.fromkeys(
            name for output in s.outputs for name in inputs_of(output) if name in s.channels
        )
    )


def noise_from_roughness(signals: Sequence[KinematicSignals]) -> RelationNoise:
    """Return starting values of the noise from the roughness of the channels."""
    outputs, inputs = signals[0].outputs, inputs_with_walk(signals[0])
    rough = [
        float(np.mean([roughness(s.channels[name]) for s in signals]))
        for name in (*outputs, *inputs)
    ]
    return RelationNoise(
        outputs, inputs, np.array(rough[: len(outputs)]), np.array(rough[len(outputs) :])
    )


def estimated_noise(
    signals: Sequence[KinematicSignals],
    residuals: Sequence[np.ndarray],
    columns: Sequence[np.ndarray],
    starting_noise: RelationNoise,
) -> RelationNoise:
    """Return the noise variances that maximise the restricted likelihood of each output separately.

    The walk of an output is the integral of the noise of its inputs. A relation with one input
    gives the noise of that input. In the other relations, the walk by inputs of known noise is
    subtracted, and the remaining walk scales the starting values of the other inputs.

    Parameters
    ----------
    residuals : ``(m, N)`` of each record.
    columns : ``(m, N, c)`` of each record, derivatives of the outputs with respect to the fitted
        unknowns.
    starting_noise : noise from the roughness of the channels.
    """
    white, walk = np.empty(len(starting_noise.outputs)), np.empty(len(starting_noise.outputs))
    gains = np.mean([walk_gains(s, starting_noise) for s in signals], axis=0)
    for i in range(len(starting_noise.outputs)):
        white[i], walk[i] = _noise_of_output(
            i,
            signals,
            residuals,
            columns,
            starting_noise.white[i],
            float(gains[i] ** 2 @ starting_noise.density),
        )
    density, alone = starting_noise.density.copy(), np.count_nonzero(gains, axis=1) == 1
    known: set[int] = set()
    for i in np.flatnonzero(alone).tolist():
        j = int(np.flatnonzero(gains[i])[0])
        density[j] = walk[i] / gains[i, j] ** 2
        known.add(j)
    for i in np.flatnonzero(~alone).tolist():
        free = [j for j in np.flatnonzero(gains[i]) if j not in known]
        unexplained = walk[i] - sum(
            gains[i, j] ** 2 * density[j] for j in np.flatnonzero(gains[i]) if j in known
        )
        if free:
            expected = float((gains[i, free] ** 2 * starting_noise.density[free]).sum())
            factor = np.maximum(unexplained / expected, _LEAST_WALK_SHARE)
            density[free] = factor * starting_noise.density[free]
        elif unexplained > 0:
            factor = walk[i] / (walk[i] - unexplained)
            density[np.flatnonzero(gains[i])] *= factor
    # A record cannot show less noise than the resolution of its columns.
    white = np.maximum(white, rounding_variances(signals, starting_noise.outputs))
    density = np.maximum(density, rounding_variances(signals, starting_noise.inputs))
    return RelationNoise(starting_noise.outputs, starting_noise.inputs, white, density)


def _noise_of_output(
    i: int,
    signals: Sequence[KinematicSignals],
    residuals: Sequence[np.ndarray],
    columns: Sequence[np.ndarray],
    rough: float,
    expected: float,
) -> tuple[float, float]:
    """Return the variance of the white noise of output ``i`` in all records, and the variance of
    the noise of its rate. A step of the walk is the noise of the rate times the sampling interval.

    Parameters
    ----------
    rough : white variance from the roughness of the channel, returned where samples are too few.
    expected : variance of the noise of the rate, from the noise of the inputs.
    """
    parts = []
    for s, residual, slopes in zip(signals, residuals, columns, strict=True):
        basis = _orthonormal_basis(np.where(s.valid[i][:, None], slopes[i], 0.0))
        flat = differences(np.concatenate([residual[i][None, :, None], basis[None]], axis=2))
        parts.append((s, s.valid[i], np.asfortranarray(flat)))
    count = sum(int(np.count_nonzero(valid)) - flat.shape[1] + 1 for _, valid, flat in parts)
    if count < _FEWEST_NOISE_SAMPLES:
        return rough, expected
    step = float(np.median(np.concatenate([s.steps for s, _, _ in parts])))

    def cost(ratio: float) -> float:
        likelihood_cost, variance = _restricted_misfit(parts, count, ratio)
        log_excess = math.log(ratio * variance / expected)
        std = _LOG_LEVEL_STD_BELOW if log_excess < 0 else _LOG_LEVEL_STD_ABOVE
        return likelihood_cost + 0.5 * (log_excess / std) ** 2

    ratios = _WALK_TO_WHITE_RATIOS / step**2
    best = int(np.argmin([cost(ratio) for ratio in ratios.tolist()]))
    low, high = math.log(ratios[max(best - 1, 0)]), math.log(ratios[min(best + 1, len(ratios) - 1)])
    for _ in range(_GOLDEN_SECTION_STEPS):
        lower = low + _GOLDEN_SECTION * (high - low)
        upper = low + (1.0 - _GOLDEN_SECTION) * (high - low)
        if cost(math.exp(lower)) < cost(math.exp(upper)):
            high = upper
        else:
            low = lower
    ratio = math.exp(0.5 * (low + high))
    white = max(_restricted_misfit(parts, count, ratio)[1], _LEAST_WHITE_SHARE * rough, 1e-20)
    return white, max(ratio * white, _LEAST_WALK_SHARE * expected)


def _restricted_misfit(
    parts: Sequence[tuple[KinematicSignals, np.ndarray, np.ndarray]], count: int, ratio: float
) -> tuple[float, float]:
    """Return minus the restricted log likelihood, and the white variance that maximises this
    likelihood, for a given ``ratio`` of the variance of rate noise to that of white noise.

    ``parts`` has for each record its signals, the mask ``(N,)`` of valid samples, and the
    differences ``(N, 1 + c)`` of the residual and of the columns. ``count`` is the number of
    degrees of freedom.
    """
    from scipy.linalg.lapack import dpbtrf, dtbtrs

    squares = logs = 0.0
    for s, valid, flat in parts:
        variances = np.where(valid, 1.0, _MISSING_VARIANCE)
        band = np.zeros((2, len(variances)))
        band[0] = variances
        band[0, 1:] += variances[:-1] + ratio * s.steps**2
        band[1, :-1] = -variances[:-1]
        factor, failure = dpbtrf(band, lower=1)
        if failure:
            return math.inf, 1.0
        white = dtbtrs(factor, flat, uplo="L")[0]
        e, q = white[:, 0], white[:, 1:]
        gram, right = q.T @ q, q.T @ e
        squares += float(e @ e) - float(right @ np.linalg.solve(gram, right))
        logs += (
            2.0 * float(np.sum(np.log(factor[0])))
            + float(np.linalg.slogdet(gram)[1])
            - math.log(_MISSING_VARIANCE) * float(np.count_nonzero(~valid))
        )
    variance = max(squares / count, 1e-30)
    return 0.5 * (count * math.log(variance) + logs), variance


def _orthonormal_basis(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis ``(N, r)`` of the columns ``(N, c)``."""
    scale = np.linalg.norm(columns, axis=0)
    columns = columns[:, scale > 0] / scale[scale > 0]
    values, vectors = np.linalg.eigh(columns.T @ columns)
    largest = max(float(values[-1]), 1e-300) if len(values) else 1.0
    determined = values > _ROUNDING_EIGENVALUE_SHARE * largest
    return np.asarray(columns @ (vectors[:, determined] / np.sqrt(values[determined])))


# ---- Fits of the kinematics of six degrees of freedom

_MOST_STEPS = 4  # most Gauss-Newton steps under one noise
_STEP_SHARES = (1.0, 0.5, 0.2, 0.05)  # shares of a step, tried in turn until one gains
_NEGLIGIBLE_GAIN = 2e-3  # a descent ends after a smaller gain of log likelihood
_SETTLED_LOG_CHANGE = 0.05  # a fit ends when the logarithms of all noise variances change less


def fit(
    signals: Sequence[KinematicSignals],
    faults: Sequence[SensorFault] = (),
    begin: KinematicFit | None = None,
) -> KinematicFit:
    """Return the smoother fit of R records with some faults.

    ``begin`` is a fit of the same records. It gives the noise, and starting values of the unknowns
    and of the faults that it has; other faults start at zero. None starts from `start_of`.
    """
    unknowns = [unknowns_of(s) for s in signals]
    if begin is None:
        unknown_values = [start_of(s, items) for s, items in zip(signals, unknowns, strict=True)]
    else:
        unknown_values = [np.array(values) for values in begin.unknown_values]
    sizes = starting_sizes(faults, begin)
    starting_noise = noise_from_roughness(signals)
    noise = begin.noise if begin is not None else starting_noise
    priors = [np.array([item.prior**-2 for item in u]) for u in unknowns]
    linear = [
        linearised(s, u, faults, o, sizes)
        for s, u, o in zip(signals, unknowns, unknown_values, strict=True)
    ]
    search = KinematicDescent(
        tuple(signals),
        tuple(unknowns),
        tuple(faults),
        tuple(priors),
        evaluate,
        linearised,
        _STEP_SHARES,
        _MOST_STEPS,
        _NEGLIGIBLE_GAIN,
    )
    for _ in range(MOST_PASSES):
        whiteners = [reduced_whitener(s, noise) for s in signals]
        unknown_values, sizes, linear = descend(search, (unknown_values, sizes, linear), whiteners)
        residuals = [residual_of(s, y) for s, (y, _) in zip(signals, linear, strict=True)]
        before, columns = noise, [slope for _, slope in linear]
        noise = estimated_noise(signals, residuals, columns, starting_noise)
        if np.all(np.abs(noise.logs - before.logs) < _SETTLED_LOG_CHANGE):
            break
    residuals = [residual_of(s, y) for s, (y, _) in zip(signals, linear, strict=True)]
    whiteners = [reduced_whitener(s, noise) for s in signals]
    cost = misfit(signals, priors, unknown_values, [y for y, _ in linear], whiteners)
    slopes, outputs = tuple(slope for _, slope in linear), tuple(y for y, _ in linear)
    return KinematicFit(
        tuple(signals),
        tuple(faults),
        sizes,
        tuple(unknown_values),
        noise,
        cost,
        tuple(residuals),
        slopes,
        outputs,
    )


def negative_log_likelihoods(fits: Sequence[KinematicFit]) -> np.ndarray:
    """Return minus the log likelihood of each of some fits of the same records, up to a constant.

    If the records have instruments, the results are the projected misfits, all under the noise of
    the likeliest fit.
    """
    costs = np.array(
        [
            candidate.cost
            + 0.5 * sum(whitener(s, candidate.noise).log_determinant for s in candidate.signals)
            for candidate in fits
        ]
    )
    if not instrumented(fits[0].signals):
        return costs
    likeliest = fits[int(np.argmin(costs))]
    whiteners = [reduced_whitener(s, likeliest.noise) for s in likeliest.signals]
    priors = [np.array([item.prior**-2 for item in unknowns_of(s)]) for s in likeliest.signals]
    return np.array([least_misfit(candidate, whiteners, priors) for candidate in fits])


# ---- All faults, linearised at a fit

_FEWEST_LAGS, _SAMPLES_PER_LAG = 10, 5  # lags of the autocovariance of a residual
LEAST_SECANT = 0.02  # s: the slope of a time shift is a secant over at least this size


class NormalEquations(NamedTuple):
    """Normal equations of k faults, with the unknowns of each record projected out.

    Attributes
    ----------
    information : ``(k, k)``.
    gradient : ``(k,)`` of the log likelihood at sensors without a fault.
    scatter : ``(k, k)`` covariance of the gradient; with white residuals it equals ``information``.
    """

    information: np.ndarray
    gradient: np.ndarray
    scatter: np.ndarray


@dataclass(frozen=True, eq=False)
class FaultLinearisation:
    """Linearisation of the outputs with respect to k faults at a fit.

    Attributes
    ----------
    fit : the fit at which the outputs are linearised.
    faults : the k faults, among them those of the fit.
    smoother : normal equations of each record under the noise of the fit.
    biases : the b biases of a record.
    information_with_biases : ``(k + b, k + b)`` information of the faults, then of the biases
        without their priors. All other unknowns of the records are projected out.
    full_equations : information ``(n + k, n + k)`` and gradient ``(n + k,)`` of each record, of its
        unknowns, then of the faults, with priors. The gradient is taken at the unknowns of the fit
        and at sensors without a fault.
    columns : ``(m, N, n + k + 1)`` of each record: derivatives with respect to its unknowns and to
        the faults, then the residual without faults.
    """

    fit: KinematicFit
    faults: tuple[SensorFault, ...]
    smoother: tuple[NormalEquations, ...]
    biases: tuple[SensorFault, ...]
    information_with_biases: np.ndarray
    full_equations: tuple[tuple[np.ndarray, np.ndarray], ...]
    columns: tuple[np.ndarray, ...]

    @property
    def joint(self) -> NormalEquations:
        """The normal equations of all records together."""
        return sum_of_equations(self.smoother)


def linearise_faults(
    kinematic_fit: KinematicFit, faults: Sequence[SensorFault], secants: np.ndarray
) -> FaultLinearisation:
    """Linearise the outputs with respect to all ``faults`` at a fit.

    ``secants (k,)`` are the sizes, s, over which the slopes of time shifts are taken.
    """
    smoother, bias_information, full_equations, all_columns = [], [], [], []
    biases: tuple[SensorFault, ...] = ()
    for r, s in enumerate(kinematic_fit.signals):
        unknowns = unknowns_of(s)
        slopes, delay_slopes = _fault_slopes(kinematic_fit, r, faults, secants)
        unknown_values, fault_slopes = (
            kinematic_fit.unknown_values[r],
            slopes[:, :, len(kinematic_fit.unknown_values[r]) :],
        )
        members = [faults.index(fault) for fault in kinematic_fit.faults]
        fault_part = fault_slopes[:, :, members] @ kinematic_fit.sizes
        residual = np.where(s.valid, kinematic_fit.residuals[r] + fault_part, 0.0)
        prior = np.array([item.prior**-2 for item in unknowns])
        columns = np.concatenate(
            [np.where(s.valid[:, :, None], slopes, 0.0), residual[:, :, None]], axis=2
        )
        delay_columns = np.where(s.valid[:, :, None], delay_slopes, 0.0)
        white, white_delays = np.split(
            projected_whitener(s, kinematic_fit.noise)(
                np.concatenate([columns, delay_columns], axis=2)
            ),
            [columns.shape[2]],
            axis=2,
        )
        innovations = whitener(s, kinematic_fit.noise)(kinematic_fit.residuals[r][:, :, None])
        smoother.append(_fault_equations(white, prior, unknown_values, innovations[:, :, 0]))
        all_columns.append(columns)
        bias_places = [i for i, item in enumerate(unknowns) if item.key[1] == BIAS]
        biases = tuple(SensorFault(unknowns[i].key[0], BIAS) for i in bias_places)
        flat = white.reshape(-1, white.shape[2])
        gram = flat.T @ flat
        extended_prior = np.append(prior, np.zeros(len(faults)))
        full_equations.append(
            (
                gram[:-1, :-1] + np.diag(extended_prior),
                gram[:-1, -1] - extended_prior * np.append(unknown_values, np.zeros(len(faults))),
            )
        )
        # A delay common to all channels is unobservable. Only derivatives show this exactly:
        # secants of the channels over different times would not cancel.
        delays = [len(unknown_values) + j for j, fault in enumerate(faults) if fault.kind == DELAY]
        flat[:, delays] = white_delays.reshape(len(flat), -1)
        bias_information.append(
            _information_with_biases(flat[:, :-1].T @ flat[:, :-1], prior, bias_places)
        )
    return FaultLinearisation(
        kinematic_fit,
        tuple(faults),
        tuple(smoother),
        biases,
        np.sum(bias_information, axis=0),
        tuple(full_equations),
        tuple(all_columns),
    )


def _fault_slopes(
    kinematic_fit: KinematicFit, r: int, faults: Sequence[SensorFault], secants: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return two arrays of slopes of the outputs of record ``r`` at the fit.

    The first, ``(m, N, n + k)``, is with respect to the unknowns of the record and to the faults;
    for delays and lags it has secants. The second, ``(m, N, d)``, has the derivatives with respect
    to the d delays.
    """
    s, unknown_values = kinematic_fit.signals[r], kinematic_fit.unknown_values[r]
    unknowns = unknowns_of(s)
    sizes = np.zeros(len(faults))
    for fault, size in zip(kinematic_fit.faults, kinematic_fit.sizes.tolist(), strict=True):
        sizes[list(faults).index(fault)] = size
    _, slopes = linearised(s, unknowns, faults, unknown_values, sizes)
    n = len(unknown_values)
    delay_slopes = slopes[:, :, [n + j for j, fault in enumerate(faults) if fault.kind == DELAY]]
    for j, fault in enumerate(faults):
        if fault.kind in (DELAY, LAG):
            # The secant begins without any time shift of this channel.
            shifts_channel = [
                item.channel == fault.channel and item.kind in (DELAY, LAG) for item in faults
            ]
            ends = np.where(shifts_channel, 0.0, np.stack([sizes, sizes]))
            ends[1, j] = secants[j]
            y = evaluate(s, unknowns, faults, np.repeat(unknown_values[None], 2, axis=0), ends)
            slopes[:, :, n + j] = (y[:, 1] - y[:, 0]) / secants[j]
    return slopes, delay_slopes


def _fault_equations(
    white: np.ndarray, prior: np.ndarray, unknown_values: np.ndarray, innovations: np.ndarray
) -> NormalEquations:
    """Return the normal equations of the faults from the whitened columns of one record.

    Parameters
    ----------
    white : ``(m, N, n + k + 1)`` whitened ``columns`` of `FaultLinearisation`.
    prior : ``(n,)`` one over the prior variances of the unknowns of the record.
    own : ``(n,)`` values of these unknowns.
    innovations : ``(m, N)`` whitened residuals of the fit.
    """
    n = len(prior)
    flat = white.reshape(-1, white.shape[2])
    gram = flat.T @ flat
    k = gram.shape[0] - n - 1
    gradient = gram[: n + k, -1].copy()
    gradient[:n] -= prior * unknown_values
    projection = _projection_matrix(gram[: n + k, : n + k], prior)
    scatter = np.sum(
        [
            gradient_covariance(columns[:, : n + k], innovation)
            for columns, innovation in zip(white, innovations, strict=True)
        ],
        axis=0,
    )
    scatter[np.arange(n), np.arange(n)] += prior
    return _projected(gram[: n + k, : n + k], gradient, scatter, projection)


def _projection_matrix(gram: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Return the matrix ``(k, n + k)`` that projects n unknowns out of ``gram (n + k, n + k)``."""
    n = len(prior)
    inverse = bounded_inverse(gram[:n, :n] + np.diag(prior))
    return np.hstack([-gram[n:, :n] @ inverse, np.eye(len(gram) - n)])


def _projected(
    gram: np.ndarray, gradient: np.ndarray, scatter: np.ndarray, projection: np.ndarray
) -> NormalEquations:
    n = gram.shape[0] - projection.shape[0]
    information = gram[n:, n:] + projection[:, :n] @ gram[:n, n:]
    return NormalEquations(
        0.5 * (information + information.T),
        projection @ gradient,
        projection @ scatter @ projection.T,
    )


def gradient_covariance(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return the covariance ``(c, c)`` of the gradient of one output, if its noise has the
    autocovariance of the residual, as `corrected_covariance` assumes.

    ``columns (N, c)`` and ``residual (N,)`` are those of the output.
    """
    lags = min(max(_FEWEST_LAGS, len(residual) // _SAMPLES_PER_LAG), len(residual) - 1)
    covariance = autocovariance(residual, lags) * (1.0 - np.arange(lags + 1) / (lags + 1.0))
    n = len(columns)
    size = 1 << int(np.ceil(np.log2(n + 2 * lags + 1)))
    kernel = np.zeros(size)
    kernel[: lags + 1] = covariance
    kernel[size - lags :] = covariance[:0:-1]
    spectrum = np.fft.rfft(columns, size, axis=0)
    smooth = np.fft.irfft(spectrum * np.fft.rfft(kernel)[:, None], size, axis=0)[:n]
    return np.asarray(columns.T @ smooth)


def output_error_equations(linearisation: FaultLinearisation, r: int) -> NormalEquations:
    """Return the normal equations of record ``r`` by output error (white residuals)."""
    s, unknown_values = linearisation.fit.signals[r], linearisation.fit.unknown_values[r]
    prior, n = np.array([item.prior**-2 for item in unknowns_of(s)]), len(unknown_values)
    gram, gradient, scatter = output_error_gram(s, linearisation.fit, r, linearisation.columns[r])
    gradient[:n] -= prior * unknown_values
    scatter[np.arange(n), np.arange(n)] += prior
    return _projected(gram, gradient, scatter, _projection_matrix(gram, prior))


def output_error_gram(
    s: KinematicSignals, kinematic_fit: KinematicFit, r: int, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the information ``(c, c)``, the gradient ``(c,)`` and its covariance ``(c, c)`` by
    output error, without priors. The weight of each output is one over its mean square residual.

    ``columns (m, N, c + 1)`` are the slopes and, last, the residual. The covariance has these
    weights and the noise of the smoother fit.
    """
    project = instrument_projection(s)
    count = np.maximum(s.valid.sum(axis=1), 1)
    weight = 1.0 / np.maximum((kinematic_fit.residuals[r] ** 2).sum(axis=1) / count, 1e-30)
    slopes, residual = columns[:, :, :-1], columns[:, :, -1]
    weighed = project(slopes) * weight[:, None, None]
    flat, c = weighed.reshape(-1, weighed.shape[2]), weighed.shape[2]
    gram, gradient = flat.T @ slopes.reshape(-1, c), flat.T @ residual.ravel()
    scatter = flat.T @ (weighed * kinematic_fit.noise.white[:, None, None]).reshape(-1, c)
    # A step of the walk acts on all later samples.
    later_sums = np.cumsum(weighed[:, ::-1], axis=1)[:, ::-1][:, 1:] * s.steps[None, :, None]
    for gains, density in zip(
        walk_gains(s, kinematic_fit.noise).T, kinematic_fit.noise.density.tolist(), strict=True
    ):
        walk = np.tensordot(gains, later_sums, axes=1)
        scatter += density * walk.T @ walk
    return gram, gradient, scatter


def _information_with_biases(
    gram: np.ndarray, prior: np.ndarray, bias_places: Sequence[int]
) -> np.ndarray:
    """Return the information on faults and biases, in this order, with all other unknowns of the
    record projected out.

    ``bias_places`` are the positions of the biases among these n unknowns. ``gram (n + k, n + k)``
    has the unknowns first, and ``prior (n,)`` is one over their prior variances.
    """
    n = len(prior)
    kept = [*range(n, len(gram)), *bias_places]
    eliminated = [i for i in range(n) if i not in bias_places]
    inner = gram[np.ix_(eliminated, eliminated)] + np.diag(prior[eliminated])
    return np.asarray(
        gram[np.ix_(kept, kept)]
        - gram[np.ix_(kept, eliminated)] @ bounded_inverse(inner) @ gram[np.ix_(eliminated, kept)]
    )


def sum_of_equations(parts: Sequence[NormalEquations]) -> NormalEquations:
    """Return the normal equations of several records together."""
    return NormalEquations(*(reduce(np.add, arrays) for arrays in zip(*parts, strict=True)))
