"""Fits of the kinematics of six degrees of freedom: Gauss-Newton in the metric of the noise, whose variances are settled in between."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.compatibility.faults import SensorFault
from ident.compatibility.fitting import Fit, misfit, residual_of
from ident.compatibility.instruments import Weigher, instrumented, shortened
from ident.compatibility.noise import NoiseModel, whitener
from ident.compatibility.signals import Signals
from ident.compatibility.six_degrees.noise import first_noise, settled_noise
from ident.compatibility.six_degrees.unknowns import evaluate, linearised, start_of, unknowns_of
from ident.statistics.information import bounded_inverse

_PASSES = 4
_STEPS = 4
_SMALL = 2e-3  # twice the gain of a step that is not worth taking
_SETTLED = 0.05  # change of the logarithm of a variance


def fit(signals: Sequence[Signals], faults: Sequence[SensorFault] = (), begin: Fit | None = None) -> Fit:
    """Fit of R records with some faults; ``begin`` gives starts for all that it has, and the noise."""
    unknowns = [unknowns_of(s) for s in signals]
    own = [np.array(begin.own[r]) if begin is not None else start_of(s, unknowns[r]) for r, s in enumerate(signals)]
    known = dict(zip(begin.faults, begin.sizes.tolist(), strict=True)) if begin is not None else {}
    sizes = np.array([known.get(fault, 0.0) for fault in faults])
    begun = first_noise(signals)
    noise = begin.noise if begin is not None else begun
    priors = [np.array([item.prior**-2 for item in u]) for u in unknowns]
    lines = [linearised(s, u, faults, o, sizes) for s, u, o in zip(signals, unknowns, own, strict=True)]
    for _ in range(_PASSES):
        own, sizes, lines = _descended(signals, faults, priors, own, sizes, lines, noise)
        residuals = [residual_of(s, y) for s, (y, _) in zip(signals, lines, strict=True)]
        before, noise = noise, settled_noise(signals, residuals, [slope for _, slope in lines], begun)
        if np.all(np.abs(noise.logs - before.logs) < _SETTLED):
            break
    residuals = [residual_of(s, y) for s, (y, _) in zip(signals, lines, strict=True)]
    whiteners = [shortened(s, noise) for s in signals]
    cost = misfit(signals, priors, own, [y for y, _ in lines], whiteners)
    slopes, outputs = tuple(slope for _, slope in lines), tuple(y for y, _ in lines)
    return Fit(tuple(signals), tuple(faults), sizes, tuple(own), noise, cost, tuple(residuals), slopes, outputs)


def likelihoods(fits: Sequence[Fit]) -> np.ndarray:
    """Minus the log likelihood of each of some fits of the same records, but for a constant; with instruments half their misfit's projection, all
    under the noise of the likeliest."""
    whole = np.array([each.cost + 0.5 * sum(whitener(s, each.noise).log_determinant for s in each.signals) for each in fits])
    if not instrumented(fits[0].signals):
        return whole
    whiteners = [shortened(s, fits[int(np.argmin(whole))].noise) for s in fits[0].signals]
    return np.array([_least_misfit(each, whiteners) for each in fits])


def _least_misfit(found: Fit, whiteners: Sequence[Weigher]) -> float:
    """Half the sum of squares that the unknowns of a fit leave under another noise, priors included; to first order."""
    priors = [np.array([item.prior**-2 for item in unknowns_of(s)]) for s in found.signals]
    lines = list(zip(found.outputs, found.jacobians, strict=True))
    information, gradient = _normal(found.signals, priors, found.own, lines, whiteners)
    return misfit(found.signals, priors, found.own, found.outputs, whiteners) - 0.5 * float(gradient @ bounded_inverse(information) @ gradient)


def _descended(
    signals: Sequence[Signals],
    faults: Sequence[SensorFault],
    priors: Sequence[np.ndarray],
    own: list[np.ndarray],
    sizes: np.ndarray,
    lines: list[tuple[np.ndarray, np.ndarray]],
    noise: NoiseModel,
) -> tuple[list[np.ndarray], np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """Unknowns and sizes of least squares under a given noise, and the lines there."""
    unknowns, largest = [unknowns_of(s) for s in signals], np.array([fault.largest for fault in faults])
    whiteners = [shortened(s, noise) for s in signals]
    here = misfit(signals, priors, own, [y for y, _ in lines], whiteners)
    for _ in range(_STEPS):
        information, gradient = _normal(signals, priors, own, lines, whiteners)
        step = bounded_inverse(information) @ gradient
        if float(gradient @ step) < _SMALL:
            break
        for share in (1.0, 0.5, 0.2, 0.05):
            moved = np.split(share * step, np.cumsum([len(o) for o in own]))
            trial, size = [o + d for o, d in zip(own, moved, strict=False)], np.clip(sizes + moved[-1], -largest, largest)
            shown = [evaluate(s, u, faults, o[None], size[None])[:, 0] for s, u, o in zip(signals, unknowns, trial, strict=True)]
            there = misfit(signals, priors, trial, shown, whiteners)
            if there < here:
                break
        else:
            break
        own, sizes, gained, here = trial, size, here - there, there
        lines = [linearised(s, u, faults, o, sizes) for s, u, o in zip(signals, unknowns, own, strict=True)]
        if gained < _SMALL:
            break
    return own, sizes, lines


def _normal(
    signals: Sequence[Signals],
    priors: Sequence[np.ndarray],
    own: Sequence[np.ndarray],
    lines: Sequence[tuple[np.ndarray, np.ndarray]],
    whiteners: Sequence[Weigher],
) -> tuple[np.ndarray, np.ndarray]:
    """Information ``(n, n)`` and gradient ``(n,)``, own unknowns of each record first."""
    total = sum(len(o) for o in own)
    faults = lines[0][1].shape[2] - len(own[0])
    information, gradient, at = np.zeros((total + faults, total + faults)), np.zeros(total + faults), 0
    for s, prior, o, (y, slope), white in zip(signals, priors, own, lines, whiteners, strict=True):
        columns = np.concatenate([residual_of(s, y)[:, :, None], np.where(s.valid[:, :, None], slope, 0.0)], axis=2)
        flat = white(columns)
        product = flat.T @ flat
        where = np.concatenate([np.arange(at, at + len(o)), total + np.arange(faults)])
        information[np.ix_(where, where)] += product[1:, 1:]
        gradient[where] += product[1:, 0]
        diagonal = np.arange(at, at + len(o))
        gradient[diagonal] -= prior * o
        information[diagonal, diagonal] += prior
        at += len(o)
    return information, gradient
