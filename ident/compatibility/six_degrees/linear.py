"""All faults of all sensors beside a fit, to first order: Gram matrices from which any set of faults is fitted without another look at the record.

Times are linearised by secants: at zero a lag is a delay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.compatibility.faults import BIAS, DELAY, LAG, SensorFault
from ident.compatibility.fitting import Fit
from ident.compatibility.instruments import part_of_controls, weigher
from ident.compatibility.noise import walk_gains, whitener
from ident.compatibility.signals import Signals
from ident.compatibility.six_degrees.unknowns import evaluate, linearised, unknowns_of
from ident.statistics.coloured_covariance import autocovariance
from ident.statistics.information import bounded_inverse

LEAST_SECANT = 0.02  # s


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations of k faults where each record's own unknowns are free.

    ``information (k, k)`` and ``gradient (k,)`` count from sensors without a fault; ``scatter (k, k)`` is the covariance of the gradient.
    """

    information: np.ndarray
    gradient: np.ndarray
    scatter: np.ndarray

    def plus(self, other: Normal) -> Normal:
        """Of two records together."""
        return Normal(self.information + other.information, self.gradient + other.gradient, self.scatter + other.scatter)


@dataclass(frozen=True, eq=False)
class Linear:
    """First order of all ``faults`` beside a fit, of each record: ``smoother`` in the metric of its noise.

    ``free``: the smoother's information ``(k + b, k + b)`` of faults and of biases (``biases``), whose priors do not count, starts and levels free.
    ``whole``: of each record information and gradient of its own unknowns, then the faults, priors included; from no fault, own unknowns as found.
    """

    found: Fit
    faults: tuple[SensorFault, ...]
    smoother: tuple[Normal, ...]
    biases: tuple[SensorFault, ...]
    free: np.ndarray
    whole: tuple[tuple[np.ndarray, np.ndarray], ...]
    columns: tuple[np.ndarray, ...]

    @property
    def joint(self) -> Normal:
        """Of all records together."""
        return added(self.smoother)


def linear(found: Fit, faults: Sequence[SensorFault], secants: np.ndarray) -> Linear:
    """All ``faults`` beside a fit; ``secants (k,)``: the size to which the secant of a time is drawn, s."""
    smoother, free, whole, kept = [], [], [], []
    biases: tuple[SensorFault, ...] = ()
    for r, s in enumerate(found.signals):
        unknowns = unknowns_of(s)
        slopes, at_rest = _slopes(found, r, faults, secants)
        own, extra = found.own[r], slopes[:, :, len(found.own[r]) :]
        at = [faults.index(fault) for fault in found.faults]
        residual = np.where(s.valid, found.residuals[r] + extra[:, :, at] @ found.sizes, 0.0)
        prior = np.array([item.prior**-2 for item in unknowns])
        columns = np.concatenate([np.where(s.valid[:, :, None], slopes, 0.0), residual[:, :, None]], axis=2)
        more = np.where(s.valid[:, :, None], at_rest, 0.0)
        white, other = np.split(weigher(s, found.noise)(np.concatenate([columns, more], axis=2)), [columns.shape[2]], axis=2)
        left = whitener(s, found.noise)(found.residuals[r][:, :, None])[:, :, 0]
        smoother.append(_normal(white, prior, own, left))
        kept.append(columns)
        named = [i for i, item in enumerate(unknowns) if item.key[1] == BIAS]
        biases = tuple(SensorFault(unknowns[i].key[0], BIAS) for i in named)
        flat = white.reshape(-1, white.shape[2])
        gram = flat.T @ flat
        flat[:, [len(own) + j for j, fault in enumerate(faults) if fault.kind == DELAY]] = other.reshape(len(flat), -1)
        free.append(_without(flat[:, :-1].T @ flat[:, :-1], prior, named))
        extended = np.append(prior, np.zeros(len(faults)))
        whole.append((gram[:-1, :-1] + np.diag(extended), gram[:-1, -1] - extended * np.append(own, np.zeros(len(faults)))))
    return Linear(found, tuple(faults), tuple(smoother), biases, np.sum(free, axis=0), tuple(whole), tuple(kept))


def _slopes(found: Fit, r: int, faults: Sequence[SensorFault], secants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Slopes ``(m, N, n + k)`` with secants of times, and of the delays by themselves those at what stands: secants of a common delay differ."""
    s, own = found.signals[r], found.own[r]
    unknowns = unknowns_of(s)
    sizes = np.zeros(len(faults))
    for fault, size in zip(found.faults, found.sizes.tolist(), strict=True):
        sizes[list(faults).index(fault)] = size
    _, slopes = linearised(s, unknowns, faults, own, sizes)
    n = len(own)
    at_rest = slopes[:, :, [n + j for j, fault in enumerate(faults) if fault.kind == DELAY]]
    for j, fault in enumerate(faults):
        if fault.kind in (DELAY, LAG):
            # From none to its size, the others as they stand but for other ways in which the same channel is late.
            ends = np.where([other.channel == fault.channel and other.kind in (DELAY, LAG) for other in faults], 0.0, np.stack([sizes, sizes]))
            ends[1, j] = secants[j]
            y = evaluate(s, unknowns, faults, np.repeat(own[None], 2, axis=0), ends)
            slopes[:, :, n + j] = (y[:, 1] - y[:, 0]) / secants[j]
    return slopes, at_rest


def _normal(white: np.ndarray, prior: np.ndarray, own: np.ndarray, left: np.ndarray) -> Normal:
    """Normal equations of the faults from whitened columns ``(m, N, n + k + 1)``, the last one the residual; own unknowns projected out."""
    n = len(prior)
    flat = white.reshape(-1, white.shape[2])
    gram = flat.T @ flat
    k = gram.shape[0] - n - 1
    gradient = gram[: n + k, -1].copy()
    gradient[:n] -= prior * own
    onto = _onto(gram[: n + k, : n + k], prior)
    scatter = np.sum([coloured(white[i, :, : n + k], left[i]) for i in range(len(left))], axis=0)
    scatter[np.arange(n), np.arange(n)] += prior
    return _projected(gram[: n + k, : n + k], gradient, scatter, onto)


def _onto(gram: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """``(k, n + k)``: the faults' columns less what the own unknowns make of them."""
    n = len(prior)
    inverse = bounded_inverse(gram[:n, :n] + np.diag(prior))
    return np.hstack([-gram[n:, :n] @ inverse, np.eye(len(gram) - n)])


def _projected(gram: np.ndarray, gradient: np.ndarray, scatter: np.ndarray, onto: np.ndarray) -> Normal:
    n = gram.shape[0] - onto.shape[0]
    information = gram[n:, n:] + onto[:, :n] @ gram[:n, n:]
    return Normal(0.5 * (information + information.T), onto @ gradient, onto @ scatter @ onto.T)


def coloured(columns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Covariance of the gradient of one output for a residual of this colour: ``(c, c)``, as ``corrected_covariance`` has it."""
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


def by_output_error(lines: Linear, r: int) -> Normal:
    """Normal equations of record r for residuals that are taken as white."""
    s, own = lines.found.signals[r], lines.found.own[r]
    prior, n = np.array([item.prior**-2 for item in unknowns_of(s)]), len(own)
    gram, gradient, scatter = output_error_gram(s, lines.found, r, lines.columns[r])
    gradient[:n] -= prior * own
    scatter[np.arange(n), np.arange(n)] += prior
    return _projected(gram, gradient, scatter, _onto(gram, prior))


def output_error_gram(s: Signals, found: Fit, r: int, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Information, gradient and its covariance with each output's residual weighed by its mean square, without priors.

    ``columns (m, N, c + 1)``: slopes and, last, the residual. The covariance is that which such weights give under the smoother's noise.
    """
    part = part_of_controls(s)
    count = np.maximum(s.valid.sum(axis=1), 1)
    weight = 1.0 / np.maximum((found.residuals[r] ** 2).sum(axis=1) / count, 1e-30)
    slopes, residual = columns[:, :, :-1], columns[:, :, -1]
    weighed = part(slopes) * weight[:, None, None]
    flat, c = weighed.reshape(-1, weighed.shape[2]), weighed.shape[2]
    gram, gradient = flat.T @ slopes.reshape(-1, c), flat.T @ residual.ravel()
    scatter = flat.T @ (weighed * found.noise.white[:, None, None]).reshape(-1, c)
    ahead = np.cumsum(weighed[:, ::-1], axis=1)[:, ::-1][:, 1:] * s.steps[None, :, None]
    for gains, density in zip(walk_gains(s, found.noise).T, found.noise.density.tolist(), strict=True):
        walk = np.tensordot(gains, ahead, axes=1)
        scatter += density * walk.T @ walk
    return gram, gradient, scatter


def _without(gram: np.ndarray, prior: np.ndarray, named: Sequence[int]) -> np.ndarray:
    """Information of faults and biases, faults first, with all other own unknowns free."""
    n = len(prior)
    kept = [*range(n, len(gram)), *named]
    gone = [i for i in range(n) if i not in named]
    inner = gram[np.ix_(gone, gone)] + np.diag(prior[gone])
    return np.asarray(gram[np.ix_(kept, kept)] - gram[np.ix_(kept, gone)] @ bounded_inverse(inner) @ gram[np.ix_(gone, kept)])


def added(parts: Sequence[Normal]) -> Normal:
    """Normal equations of several records together."""
    total = parts[0]
    for part in parts[1:]:
        total = total.plus(part)
    return total
