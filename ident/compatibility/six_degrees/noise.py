"""Noise of the relations in six degrees of freedom: white noise of the outputs, and random walks
caused by the noise of integrated inputs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.compatibility.signals import (
    KinematicSignals,
    RelationNoise,
    differences,
    inputs_of,
    roughness,
    rounding_variances,
    walk_gains,
)

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
    white, density = (
        np.maximum(white, rounding_variances(signals, starting_noise.outputs)),
        np.maximum(density, rounding_variances(signals, starting_noise.inputs)),
    )
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
