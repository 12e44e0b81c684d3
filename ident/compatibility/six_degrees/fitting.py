"""Fits of the kinematics of six degrees of freedom, in full and to first order, and their noise.

Times are linearised by secants: at zero a lag is a delay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.compatibility.fitting import (
    MOST_PASSES,
    KinematicDescent,
    KinematicFit,
    descended,
    least_misfit,
    misfit,
    residual_of,
)
from ident.compatibility.instruments import instrumented, part_of_controls, shortened, weigher
from ident.compatibility.kinematics import BIAS, DELAY, LAG, SensorFault
from ident.compatibility.signals import (
    KinematicSignals,
    RelationNoise,
    differences,
    floors,
    inputs_of,
    roughness,
    walk_gains,
    whitener,
)
from ident.compatibility.six_degrees.kinematics import evaluate, linearised, start_of, unknowns_of
from ident.statistics.intervals import bounded_inverse
from ident.statistics.residual_spectrum import autocovariance

# ---- Variances of white noise and walk

# tried ratios of walk variance over one second to white variance, times the step: all possible ones
_WALK_TO_WHITE_RATIOS = np.logspace(-6.0, 4.0, 21)
_ALIKE = 1e-10
_LEAST_WALK_SHARE = 0.1  # smallest walk, relative to the noise of its inputs by their roughness
# standard deviation of the logarithm of the random walk's level, below the level expected
_LOG_LEVEL_STD_BELOW = 0.5
_LOG_LEVEL_STD_ABOVE = 3.0  # the same above it: other errors add to the noise of inputs


def inputs_among(s: KinematicSignals) -> tuple[str, ...]:
    """Return the channels whose noise causes a random walk in an output: the inputs of each
    output's relation.
    """
    return tuple(
        dict.fromkeys(
            name for output in s.outputs for name in inputs_of(output) if name in s.channels
        )
    )


def first_noise(signals: Sequence[KinematicSignals]) -> RelationNoise:
    """Return starting values of the noise from the roughness of the channels."""
    outputs, inputs = signals[0].outputs, inputs_among(signals[0])
    rough = [
        float(np.mean([roughness(s.channels[name]) for s in signals]))
        for name in (*outputs, *inputs)
    ]
    return RelationNoise(
        outputs, inputs, np.array(rough[: len(outputs)]), np.array(rough[len(outputs) :])
    )


def settled_noise(
    signals: Sequence[KinematicSignals],
    residuals: Sequence[np.ndarray],
    columns: Sequence[np.ndarray],
    begun: RelationNoise,
) -> RelationNoise:
    """Return the variances of greatest restricted likelihood, each output by itself.

    residuals ``(m, N)`` and sensitivities ``(m, N, c)`` to what was fitted, of each record. The
    walk of an output comes from its inputs. Inputs whose noise another output determines keep that
    value; the first remaining one gets the rest.
    """
    white, walk = np.empty(len(begun.outputs)), np.empty(len(begun.outputs))
    gains = np.mean([walk_gains(s, begun) for s in signals], axis=0)
    for i in range(len(begun.outputs)):
        white[i], walk[i] = _output_noise(
            i, signals, residuals, columns, begun.white[i], float(gains[i] ** 2 @ begun.density)
        )
    density, alone = begun.density.copy(), np.count_nonzero(gains, axis=1) == 1
    known: set[int] = set()
    for i in np.flatnonzero(alone).tolist():
        j = int(np.flatnonzero(gains[i])[0])
        density[j] = walk[i] / gains[i, j] ** 2
        known.add(j)
    for i in np.flatnonzero(~alone).tolist():
        free = [j for j in np.flatnonzero(gains[i]) if j not in known]
        rest = walk[i] - sum(
            gains[i, j] ** 2 * density[j] for j in np.flatnonzero(gains[i]) if j in known
        )
        if free:
            # Noise of a load causes the least walk: the rest beyond a rate's share is divided by
            # roughness.
            share = gains[i, free] ** 2 * begun.density[free]
            density[free] = (
                np.maximum(rest / float(share.sum()), _LEAST_WALK_SHARE) * begun.density[free]
            )
        elif rest > 0:
            factor = walk[i] / (walk[i] - rest)
            density[np.flatnonzero(gains[i])] *= factor
    # A record cannot show less noise than its columns resolve.
    white, density = (
        np.maximum(white, floors(signals, begun.outputs)),
        np.maximum(density, floors(signals, begun.inputs)),
    )
    return RelationNoise(begun.outputs, begun.inputs, white, density)


def _output_noise(
    i: int,
    signals: Sequence[KinematicSignals],
    residuals: Sequence[np.ndarray],
    columns: Sequence[np.ndarray],
    rough: float,
    expected: float,
) -> tuple[float, float]:
    """Return the white variance, and the walk variance over one second, of one output of all
    records; ``expected``: walk from the noise of its inputs.
    """
    parts = []
    for s, residual, slopes in zip(signals, residuals, columns, strict=True):
        basis = _spanned(np.where(s.valid[i][:, None], slopes[i], 0.0))
        flat = differences(np.concatenate([residual[i][None, :, None], basis[None]], axis=2))
        parts.append((s, s.valid[i], np.asfortranarray(flat)))
    count = sum(int(np.count_nonzero(valid)) - flat.shape[1] + 1 for _, valid, flat in parts)
    if count < 5:
        return rough, expected
    step = float(np.median(np.concatenate([s.steps for s, _, _ in parts])))

    def cost(ratio: float) -> float:
        likelihood, variance = _cost(parts, count, ratio)
        away = math.log(ratio * variance / expected)
        return (
            likelihood
            + 0.5 * (away / (_LOG_LEVEL_STD_BELOW if away < 0 else _LOG_LEVEL_STD_ABOVE)) ** 2
        )

    ratios = _WALK_TO_WHITE_RATIOS / step**2
    best = int(np.argmin([cost(ratio) for ratio in ratios.tolist()]))
    low, high = math.log(ratios[max(best - 1, 0)]), math.log(ratios[min(best + 1, len(ratios) - 1)])
    for _ in range(12):
        one, two = low + 0.382 * (high - low), low + 0.618 * (high - low)
        if cost(math.exp(one)) < cost(math.exp(two)):
            high = two
        else:
            low = one
    ratio = math.exp(0.5 * (low + high))
    white = max(_cost(parts, count, ratio)[1], 1e-3 * rough, 1e-20)
    return white, max(ratio * white, _LEAST_WALK_SHARE * expected)


def _cost(
    parts: Sequence[tuple[KinematicSignals, np.ndarray, np.ndarray]], count: int, ratio: float
) -> tuple[float, float]:
    """Return minus the restricted log likelihood at a ratio of walk to white variance, and the best
    white variance.
    """
    from scipy.linalg.lapack import dpbtrf, dtbtrs

    squares = logs = 0.0
    for s, valid, flat in parts:
        own = np.where(valid, 1.0, 1e8)
        band = np.zeros((2, len(own)))
        band[0] = own
        band[0, 1:] += own[:-1] + ratio * s.steps**2
        band[1, :-1] = -own[:-1]
        factor, fault = dpbtrf(band, lower=1)
        if fault:
            return math.inf, 1.0
        white = dtbtrs(factor, flat, uplo="L")[0]
        e, q = white[:, 0], white[:, 1:]
        gram, right = q.T @ q, q.T @ e
        squares += float(e @ e) - float(right @ np.linalg.solve(gram, right))
        logs += (
            2.0 * float(np.sum(np.log(factor[0])))
            + float(np.linalg.slogdet(gram)[1])
            - 18.42 * float(np.count_nonzero(~valid))
        )
    variance = max(squares / count, 1e-30)
    return 0.5 * (count * math.log(variance) + logs), variance


def _spanned(columns: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the columns ``(N, c)``."""
    scale = np.linalg.norm(columns, axis=0)
    columns = columns[:, scale > 0] / scale[scale > 0]
    values, vectors = np.linalg.eigh(columns.T @ columns)
    determined = values > _ALIKE * max(float(values[-1]), 1e-300) if len(values) else values > 0
    return np.asarray(columns @ (vectors[:, determined] / np.sqrt(values[determined])))


# ---- Fits of the kinematics of six degrees of freedom

_MOST_STEPS = 4
_NEGLIGIBLE_GAIN = 2e-3  # smallest gain of a step, times two
_SETTLED_LOG_VARIANCE = 0.05  # change of the logarithm of a variance


def fit(
    signals: Sequence[KinematicSignals],
    faults: Sequence[SensorFault] = (),
    begin: KinematicFit | None = None,
) -> KinematicFit:
    """Fit of R records with some faults; ``begin`` gives starts for all that it has, and the
    noise.
    """
    unknowns = [unknowns_of(s) for s in signals]
    own = [
        np.array(begin.own[r]) if begin is not None else start_of(s, unknowns[r])
        for r, s in enumerate(signals)
    ]
    sizes_by_fault = (
        dict(zip(begin.faults, begin.sizes.tolist(), strict=True)) if begin is not None else {}
    )
    sizes = np.array([sizes_by_fault.get(fault, 0.0) for fault in faults])
    first_levels = first_noise(signals)
    noise = begin.noise if begin is not None else first_levels
    priors = [np.array([item.prior**-2 for item in u]) for u in unknowns]
    lines = [
        linearised(s, u, faults, o, sizes) for s, u, o in zip(signals, unknowns, own, strict=True)
    ]
    search = KinematicDescent(
        tuple(signals),
        tuple(unknowns),
        tuple(faults),
        tuple(priors),
        evaluate,
        linearised,
        (1.0, 0.5, 0.2, 0.05),
        _MOST_STEPS,
        _NEGLIGIBLE_GAIN,
    )
    for _ in range(MOST_PASSES):
        whiteners = [shortened(s, noise) for s in signals]
        own, sizes, lines = descended(search, (own, sizes, lines), whiteners)
        residuals = [residual_of(s, y) for s, (y, _) in zip(signals, lines, strict=True)]
        before, noise = (
            noise,
            settled_noise(signals, residuals, [slope for _, slope in lines], first_levels),
        )
        if np.all(np.abs(noise.logs - before.logs) < _SETTLED_LOG_VARIANCE):
            break
    residuals = [residual_of(s, y) for s, (y, _) in zip(signals, lines, strict=True)]
    whiteners = [shortened(s, noise) for s in signals]
    cost = misfit(signals, priors, own, [y for y, _ in lines], whiteners)
    slopes, outputs = tuple(slope for _, slope in lines), tuple(y for y, _ in lines)
    return KinematicFit(
        tuple(signals),
        tuple(faults),
        sizes,
        tuple(own),
        noise,
        cost,
        tuple(residuals),
        slopes,
        outputs,
    )


def likelihoods(fits: Sequence[KinematicFit]) -> np.ndarray:
    """Minus the log likelihood of each of some fits of the same records, but for a constant; with
    instruments half their misfit's projection, all under the noise of the likeliest."""
    whole = np.array(
        [
            each.cost + 0.5 * sum(whitener(s, each.noise).log_determinant for s in each.signals)
            for each in fits
        ]
    )
    if not instrumented(fits[0].signals):
        return whole
    whiteners = [shortened(s, fits[int(np.argmin(whole))].noise) for s in fits[0].signals]
    priors = [np.array([item.prior**-2 for item in unknowns_of(s)]) for s in fits[0].signals]
    return np.array([least_misfit(each, whiteners, priors) for each in fits])


# ---- All faults, linearised at a fit

LEAST_SECANT = 0.02  # s


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of k faults where each record's own unknowns are free.

    ``information (k, k)`` and ``gradient (k,)`` count from sensors without a fault; ``scatter (k,
    k)`` is the covariance of the gradient.
    """

    information: np.ndarray
    gradient: np.ndarray
    scatter: np.ndarray

    def plus(self, other: NormalEquations) -> NormalEquations:
        """Normal equations of two records together."""
        return NormalEquations(
            self.information + other.information,
            self.gradient + other.gradient,
            self.scatter + other.scatter,
        )


@dataclass(frozen=True, eq=False)
class Linear:
    """Linearisation by all ``faults`` at a fit, of each record: ``smoother`` under its noise.

    ``free``: the smoother's information ``(k + b, k + b)`` of faults and of biases (``biases``),
    whose priors do not count, starts and levels free. ``whole``: of each record information and
    gradient of its own unknowns, then the faults, priors included; from no fault, own unknowns as
    found.
    """

    fit: KinematicFit
    faults: tuple[SensorFault, ...]
    smoother: tuple[NormalEquations, ...]
    biases: tuple[SensorFault, ...]
    free: np.ndarray
    whole: tuple[tuple[np.ndarray, np.ndarray], ...]
    columns: tuple[np.ndarray, ...]

    @property
    def joint(self) -> NormalEquations:
        """Normal equations of all records together."""
        return added(self.smoother)


def linear(
    kinematic_fit: KinematicFit, faults: Sequence[SensorFault], secants: np.ndarray
) -> Linear:
    """Linearise all ``faults`` about a fit; ``secants (k,)``: s, over which the slope of a time
    shift is taken.
    """
    smoother, free, whole, projected = [], [], [], []
    biases: tuple[SensorFault, ...] = ()
    for r, s in enumerate(kinematic_fit.signals):
        unknowns = unknowns_of(s)
        slopes, at_rest = _slopes(kinematic_fit, r, faults, secants)
        own, extra = kinematic_fit.own[r], slopes[:, :, len(kinematic_fit.own[r]) :]
        at = [faults.index(fault) for fault in kinematic_fit.faults]
        residual = np.where(
            s.valid, kinematic_fit.residuals[r] + extra[:, :, at] @ kinematic_fit.sizes, 0.0
        )
        prior = np.array([item.prior**-2 for item in unknowns])
        columns = np.concatenate(
            [np.where(s.valid[:, :, None], slopes, 0.0), residual[:, :, None]], axis=2
        )
        more = np.where(s.valid[:, :, None], at_rest, 0.0)
        white, other = np.split(
            weigher(s, kinematic_fit.noise)(np.concatenate([columns, more], axis=2)),
            [columns.shape[2]],
            axis=2,
        )
        left = whitener(s, kinematic_fit.noise)(kinematic_fit.residuals[r][:, :, None])[:, :, 0]
        smoother.append(_linear_normal(white, prior, own, left))
        projected.append(columns)
        named = [i for i, item in enumerate(unknowns) if item.key[1] == BIAS]
        biases = tuple(SensorFault(unknowns[i].key[0], BIAS) for i in named)
        flat = white.reshape(-1, white.shape[2])
        gram = flat.T @ flat
        flat[:, [len(own) + j for j, fault in enumerate(faults) if fault.kind == DELAY]] = (
            other.reshape(len(flat), -1)
        )
        free.append(_without(flat[:, :-1].T @ flat[:, :-1], prior, named))
        extended = np.append(prior, np.zeros(len(faults)))
        whole.append(
            (
                gram[:-1, :-1] + np.diag(extended),
                gram[:-1, -1] - extended * np.append(own, np.zeros(len(faults))),
            )
        )
    return Linear(
        kinematic_fit,
        tuple(faults),
        tuple(smoother),
        biases,
        np.sum(free, axis=0),
        tuple(whole),
        tuple(projected),
    )


def _slopes(
    kinematic_fit: KinematicFit, r: int, faults: Sequence[SensorFault], secants: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the slopes ``(m, N, n + k)`` with secants of times, and of the delays by themselves
    those at what stands: secants of a common delay differ.
    """
    s, own = kinematic_fit.signals[r], kinematic_fit.own[r]
    unknowns = unknowns_of(s)
    sizes = np.zeros(len(faults))
    for fault, size in zip(kinematic_fit.faults, kinematic_fit.sizes.tolist(), strict=True):
        sizes[list(faults).index(fault)] = size
    _, slopes = linearised(s, unknowns, faults, own, sizes)
    n = len(own)
    at_rest = slopes[:, :, [n + j for j, fault in enumerate(faults) if fault.kind == DELAY]]
    for j, fault in enumerate(faults):
        if fault.kind in (DELAY, LAG):
            # From none to its size, the others as they stand but for other ways in which the same
            # channel is late.
            ends = np.where(
                [other.channel == fault.channel and other.kind in (DELAY, LAG) for other in faults],
                0.0,
                np.stack([sizes, sizes]),
            )
            ends[1, j] = secants[j]
            y = evaluate(s, unknowns, faults, np.repeat(own[None], 2, axis=0), ends)
            slopes[:, :, n + j] = (y[:, 1] - y[:, 0]) / secants[j]
    return slopes, at_rest


def _linear_normal(
    white: np.ndarray, prior: np.ndarray, own: np.ndarray, left: np.ndarray
) -> NormalEquations:
    """Normal equations of the faults from whitened columns ``(m, N, n + k + 1)``, the last one the
    residual; own unknowns projected out.
    """
    n = len(prior)
    flat = white.reshape(-1, white.shape[2])
    gram = flat.T @ flat
    k = gram.shape[0] - n - 1
    gradient = gram[: n + k, -1].copy()
    gradient[:n] -= prior * own
    onto = _projected_columns(gram[: n + k, : n + k], prior)
    scatter = np.sum([coloured(white[i, :, : n + k], left[i]) for i in range(len(left))], axis=0)
    scatter[np.arange(n), np.arange(n)] += prior
    return _projected(gram[: n + k, : n + k], gradient, scatter, onto)


def _projected_columns(gram: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """Return the faults' columns after projection onto the record's own unknowns, ``(k, n +
    k)``.
    """
    n = len(prior)
    inverse = bounded_inverse(gram[:n, :n] + np.diag(prior))
    return np.hstack([-gram[n:, :n] @ inverse, np.eye(len(gram) - n)])


def _projected(
    gram: np.ndarray, gradient: np.ndarray, scatter: np.ndarray, onto: np.ndarray
) -> NormalEquations:
    n = gram.shape[0] - onto.shape[0]
    information = gram[n:, n:] + onto[:, :n] @ gram[:n, n:]
    return NormalEquations(
        0.5 * (information + information.T), onto @ gradient, onto @ scatter @ onto.T
    )


def coloured(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return the covariance of the gradient of one output for a residual of this colour: ``(c,
    c)``, as ``corrected_covariance`` has it.
    """
    lags = min(max(10, len(residual) // 5), len(residual) - 1)
    covariance = autocovariance(residual, lags) * (1.0 - np.arange(lags + 1) / (lags + 1.0))
    n = len(columns)
    size = 1 << int(np.ceil(np.log2(n + 2 * lags + 1)))
    kernel = np.zeros(size)
    kernel[: lags + 1] = covariance
    kernel[size - lags :] = covariance[:0:-1]
    spectrum = np.fft.rfft(columns, size, axis=0)
    smooth = np.fft.irfft(spectrum * np.fft.rfft(kernel)[:, None], size, axis=0)[:n]
    return np.asarray(columns.T @ smooth)


def by_output_error(lines: Linear, r: int) -> NormalEquations:
    """Normal equations of record r for residuals taken as white."""
    s, own = lines.fit.signals[r], lines.fit.own[r]
    prior, n = np.array([item.prior**-2 for item in unknowns_of(s)]), len(own)
    gram, gradient, scatter = output_error_gram(s, lines.fit, r, lines.columns[r])
    gradient[:n] -= prior * own
    scatter[np.arange(n), np.arange(n)] += prior
    return _projected(gram, gradient, scatter, _projected_columns(gram, prior))


def output_error_gram(
    s: KinematicSignals, kinematic_fit: KinematicFit, r: int, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the information, gradient and its covariance with each output's residual weighed by
    its mean square, without priors.

    ``columns (m, N, c + 1)``: slopes and, last, the residual. The covariance is that which such
    weights give under the smoother's noise.
    """
    part = part_of_controls(s)
    count = np.maximum(s.valid.sum(axis=1), 1)
    weight = 1.0 / np.maximum((kinematic_fit.residuals[r] ** 2).sum(axis=1) / count, 1e-30)
    slopes, residual = columns[:, :, :-1], columns[:, :, -1]
    weighed = part(slopes) * weight[:, None, None]
    flat, c = weighed.reshape(-1, weighed.shape[2]), weighed.shape[2]
    gram, gradient = flat.T @ slopes.reshape(-1, c), flat.T @ residual.ravel()
    scatter = flat.T @ (weighed * kinematic_fit.noise.white[:, None, None]).reshape(-1, c)
    ahead = np.cumsum(weighed[:, ::-1], axis=1)[:, ::-1][:, 1:] * s.steps[None, :, None]
    for gains, density in zip(
        walk_gains(s, kinematic_fit.noise).T, kinematic_fit.noise.density.tolist(), strict=True
    ):
        walk = np.tensordot(gains, ahead, axes=1)
        scatter += density * walk.T @ walk
    return gram, gradient, scatter


def _without(gram: np.ndarray, prior: np.ndarray, named: Sequence[int]) -> np.ndarray:
    """Information of faults and biases, faults first, with all other own unknowns free."""
    n = len(prior)
    kept = [*range(n, len(gram)), *named]
    eliminated = [i for i in range(n) if i not in named]
    inner = gram[np.ix_(eliminated, eliminated)] + np.diag(prior[eliminated])
    return np.asarray(
        gram[np.ix_(kept, kept)]
        - gram[np.ix_(kept, eliminated)] @ bounded_inverse(inner) @ gram[np.ix_(eliminated, kept)]
    )


def added(parts: Sequence[NormalEquations]) -> NormalEquations:
    """Normal equations of several records together."""
    total = parts[0]
    for part in parts[1:]:
        total = total.plus(part)
    return total
