"""Variances of white noise and walk, output by output: the profile likelihood has one unknown, the ratio of the two."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.compatibility.noise import NoiseModel, floors, inputs_of, roughness, walk_gains
from ident.compatibility.signals import Signals, differences

_RATIOS = np.logspace(-6.0, 4.0, 21)  # walk over one second squared to white variance, times the step: the whole range there can be
_ALIKE = 1e-10
_LEAST = 0.1  # of what a channel's roughness says: no walk is smaller than its inputs' own noise by more
_BELOW, _ABOVE = 0.5, 3.0  # standard deviations of the walk's logarithm about that: noise of the inputs adds, and more may come on top


def inputs_among(s: Signals) -> tuple[str, ...]:
    """Channels whose noise walks in some output: those of which each output's relation is an integral."""
    return tuple(dict.fromkeys(name for output in s.outputs for name in inputs_of(output) if name in s.channels))


def first_noise(signals: Sequence[Signals]) -> NoiseModel:
    """A start from the roughness of the channels."""
    outputs, inputs = signals[0].outputs, inputs_among(signals[0])
    rough = [float(np.mean([roughness(s.channels[name]) for s in signals])) for name in (*outputs, *inputs)]
    return NoiseModel(outputs, inputs, np.array(rough[: len(outputs)]), np.array(rough[len(outputs) :]))


def settled_noise(signals: Sequence[Signals], residuals: Sequence[np.ndarray], columns: Sequence[np.ndarray], begun: NoiseModel) -> NoiseModel:
    """Variances of greatest restricted likelihood, each output by itself.

    residuals ``(m, N)`` and sensitivities ``(m, N, c)`` to what was fitted, of each record. The walk of an output is laid to its inputs: those
    that another output shows by itself keep that value, the first other one has the rest.
    """
    white, walk = np.empty(len(begun.outputs)), np.empty(len(begun.outputs))
    gains = np.mean([walk_gains(s, begun) for s in signals], axis=0)
    for i in range(len(begun.outputs)):
        white[i], walk[i] = _of_output(i, signals, residuals, columns, begun.white[i], float(gains[i] ** 2 @ begun.density))
    density, alone = begun.density.copy(), np.count_nonzero(gains, axis=1) == 1
    known: set[int] = set()
    for i in np.flatnonzero(alone).tolist():
        j = int(np.flatnonzero(gains[i])[0])
        density[j] = walk[i] / gains[i, j] ** 2
        known.add(j)
    for i in np.flatnonzero(~alone).tolist():
        free = [j for j in np.flatnonzero(gains[i]) if j not in known]
        rest = walk[i] - sum(gains[i, j] ** 2 * density[j] for j in np.flatnonzero(gains[i]) if j in known)
        if free:
            # The load's noise walks least of all: what is left beyond a rate's is shared as the channels are rough.
            share = gains[i, free] ** 2 * begun.density[free]
            density[free] = np.maximum(rest / float(share.sum()), _LEAST) * begun.density[free]
        elif rest > 0:
            factor = walk[i] / (walk[i] - rest)
            density[np.flatnonzero(gains[i])] *= factor
    # A record cannot show less noise than its columns resolve.
    white, density = np.maximum(white, floors(signals, begun.outputs)), np.maximum(density, floors(signals, begun.inputs))
    return NoiseModel(begun.outputs, begun.inputs, white, density)


def _of_output(
    i: int, signals: Sequence[Signals], residuals: Sequence[np.ndarray], columns: Sequence[np.ndarray], rough: float, expected: float
) -> tuple[float, float]:
    """White variance and walk variance over one second, of one output of all records; what its inputs' roughness makes is ``expected``."""
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
        return likelihood + 0.5 * (away / (_BELOW if away < 0 else _ABOVE)) ** 2

    ratios = _RATIOS / step**2
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
    return white, max(ratio * white, _LEAST * expected)


def _cost(parts: Sequence[tuple[Signals, np.ndarray, np.ndarray]], count: int, ratio: float) -> tuple[float, float]:
    """Minus the restricted log likelihood at a ratio of walk to white variance, and the white variance that is best there."""
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
        logs += 2.0 * float(np.sum(np.log(factor[0]))) + float(np.linalg.slogdet(gram)[1]) - 18.42 * float(np.count_nonzero(~valid))
    variance = max(squares / count, 1e-30)
    return 0.5 * (count * math.log(variance) + logs), variance


def _spanned(columns: np.ndarray) -> np.ndarray:
    """Orthonormal columns that span what columns ``(N, c)`` span."""
    scale = np.linalg.norm(columns, axis=0)
    columns = columns[:, scale > 0] / scale[scale > 0]
    values, vectors = np.linalg.eigh(columns.T @ columns)
    told = values > _ALIKE * max(float(values[-1]), 1e-300) if len(values) else values > 0
    return np.asarray(columns @ (vectors[:, told] / np.sqrt(values[told])))
