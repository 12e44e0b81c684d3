"""Fits of the kinematics to records: unknown starts and biases of each record, sensor faults common to all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.compatibility.faults import SensorFault
from ident.compatibility.instruments import Weigher, weigher
from ident.compatibility.noise import NoiseEvidence, NoiseModel, first_noise, settled_noise, whitener
from ident.compatibility.signals import Signals
from ident.compatibility.unknowns import evaluate, linearised, start_of, unknowns_of
from ident.statistics.information import bounded_inverse

_ITERATIONS = 8
_SMALL = 2e-3  # twice the gain of a step that is not worth taking


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit of R records.

    Attributes
    ----------
    faults, sizes : what was fitted beside each record's own unknowns. own : values of these, one array a record.
    noise : of the residual. cost : minus the log likelihood, priors included.
    residuals : ``(m, N)`` a record, zero where a sample is missing. jacobians : ``(m, N, own + faults)`` a record, of the reconstruction.
    outputs : ``(m, N)`` what the sensors should read.
    """

    signals: tuple[Signals, ...]
    faults: tuple[SensorFault, ...]
    sizes: np.ndarray
    own: tuple[np.ndarray, ...]
    noise: NoiseModel
    cost: float
    residuals: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]
    outputs: tuple[np.ndarray, ...]


def fit(
    signals: Sequence[Signals], faults: Sequence[SensorFault] = (), begin: Fit | None = None, first: np.ndarray | None = None, passes: int = 3
) -> Fit:
    """Smoother fit: Gauss-Newton in the metric of the noise of outputs and inputs, its variances by likelihood in between.

    ``begin`` gives starts for all that it has; ``first`` those of the faults.
    """
    unknowns = [unknowns_of(s) for s in signals]
    own = [np.array(begin.own[r]) if begin is not None else start_of(s, unknowns[r]) for r, s in enumerate(signals)]
    sizes = np.zeros(len(faults))
    if begin is not None:
        known = dict(zip(begin.faults, begin.sizes.tolist(), strict=True))
        sizes = np.array([known.get(fault, 0.0) for fault in faults])
    if first is not None:
        sizes = first.astype(float)
    begun = first_noise(signals)
    noise = begin.noise if begin is not None else begun
    largest = np.array([fault.largest for fault in faults])
    priors = [np.array([1.0 / item.prior**2 for item in u]) for u in unknowns]
    lines = [linearised(s, u, faults, o, sizes) for s, u, o in zip(signals, unknowns, own, strict=True)]
    cost = 0.0
    for turn in range(passes):
        whiteners = [weigher(s, noise) for s in signals]
        for _ in range(_ITERATIONS):
            information, gradient = _normal(signals, priors, own, lines, whiteners)
            step = bounded_inverse(information) @ gradient
            if float(gradient @ step) < _SMALL:
                break
            here = misfit(signals, priors, own, [y for y, _ in lines], whiteners)
            for share in (1.0, 0.5, 0.2, 0.05, 0.01):
                moved = np.split(share * step, np.cumsum([len(o) for o in own]))
                trial, size = [o + d for o, d in zip(own, moved, strict=False)], np.clip(sizes + moved[-1], -largest, largest)
                shown = [evaluate(s, u, faults, o[None], size[None])[:, 0] for s, u, o in zip(signals, unknowns, trial, strict=True)]
                if misfit(signals, priors, trial, shown, whiteners) < here:
                    break
            else:
                break
            own, sizes = trial, size
            lines = [linearised(s, u, faults, o, sizes) for s, u, o in zip(signals, unknowns, own, strict=True)]
        before = noise.logs
        residuals = tuple(residual_of(s, y) for s, (y, _) in zip(signals, lines, strict=True))
        columns = tuple(np.where(s.valid[:, :, None], slope[:, :, : len(o)], 0.0) for s, (_, slope), o in zip(signals, lines, own, strict=True))
        noise, cost = settled_noise(
            NoiseEvidence(tuple(signals), residuals, columns, tuple(priors), begun), noise, 6 if begin is None and turn == 0 else 2
        )
        if turn and np.all(np.abs(noise.logs - before) < 0.05):
            break
    cost += sum(0.5 * float(np.sum(prior * o**2)) for prior, o in zip(priors, own, strict=True))
    return Fit(
        tuple(signals), tuple(faults), sizes, tuple(own), noise, cost, residuals, tuple(slope for _, slope in lines), tuple(y for y, _ in lines)
    )


def misfit(
    signals: Sequence[Signals],
    priors: Sequence[np.ndarray],
    own: Sequence[np.ndarray],
    outputs: Sequence[np.ndarray],
    whiteners: Sequence[Weigher],
) -> float:
    """Half the sum of squares under given noise, priors included."""
    total = 0.0
    for s, prior, o, y, white in zip(signals, priors, own, outputs, whiteners, strict=True):
        residual = residual_of(s, y)
        # What runs away is no candidate, and its square no number.
        if not np.all(np.abs(residual) < 1e6):
            return float("inf")
        total += 0.5 * float(np.sum(white(residual[:, :, None]) ** 2)) + 0.5 * float(np.sum(prior * o**2))
    return total


def whitened(found: Fit) -> list[tuple[np.ndarray, np.ndarray]]:
    """Residual ``(m, N)`` and jacobian ``(m, N, c)`` of each record as those of independent samples of variance one.

    With instruments the jacobian is their part of it: its product with the residual is the gradient all the same.
    """
    out = []
    for s, residual, jacobian in zip(found.signals, found.residuals, found.jacobians, strict=True):
        e = whitener(s, found.noise)(residual[:, :, None])[:, :, 0]
        out.append((e, weigher(s, found.noise)(np.where(s.valid[:, :, None], jacobian, 0.0))))
    return out


def least_misfit(found: Fit, whiteners: Sequence[Weigher]) -> float:
    """Half the sum of squares that the unknowns of a fit leave under another noise, priors included; to first order.

    ``whiteners`` of that noise, one a record (``ident.compatibility.instruments.weigher``).
    """
    lines = list(zip(found.outputs, found.jacobians, strict=True))
    priors = [np.array([1.0 / item.prior**2 for item in unknowns_of(s)]) for s in found.signals]
    information, gradient = _normal(found.signals, priors, found.own, lines, whiteners)
    here = misfit(found.signals, priors, found.own, found.outputs, whiteners)
    return here - 0.5 * float(gradient @ bounded_inverse(information) @ gradient)


def positions(found: Fit) -> list[np.ndarray]:
    """For each record, where the columns of its jacobian stand in the vector of all unknowns: own ones first, then the faults."""
    total, out, at = sum(len(own) for own in found.own), [], 0
    for own in found.own:
        out.append(np.concatenate([np.arange(at, at + len(own)), total + np.arange(len(found.faults))]))
        at += len(own)
    return out


def prior_information(found: Fit) -> np.ndarray:
    """Diagonal information of the priors on all unknowns."""
    own = [[1.0 / item.prior**2 for item in unknowns_of(s)] for s in found.signals]
    return np.concatenate([*map(np.array, own), np.zeros(len(found.faults))])


def _normal(
    signals: Sequence[Signals],
    priors: Sequence[np.ndarray],
    own: Sequence[np.ndarray],
    lines: Sequence[tuple[np.ndarray, np.ndarray]],
    whiteners: Sequence[Weigher],
) -> tuple[np.ndarray, np.ndarray]:
    """Information ``(n, n)`` and gradient ``(n,)`` of the log likelihood, own unknowns of each record first."""
    total = sum(len(o) for o in own)
    faults = lines[0][1].shape[2] - len(own[0])
    information, gradient, at = np.zeros((total + faults, total + faults)), np.zeros(total + faults), 0
    for s, prior, o, (y, slope), white in zip(signals, priors, own, lines, whiteners, strict=True):
        columns = np.concatenate([residual_of(s, y)[:, :, None], np.where(s.valid[:, :, None], slope, 0.0)], axis=2)
        all_columns = white(columns).reshape(-1, columns.shape[2])
        product = all_columns.T @ all_columns
        where = np.concatenate([np.arange(at, at + len(o)), total + np.arange(faults)])
        information[np.ix_(where, where)] += product[1:, 1:]
        gradient[where] += product[1:, 0]
        gradient[at : at + len(o)] -= prior * o
        information[np.arange(at, at + len(o)), np.arange(at, at + len(o))] += prior
        at += len(o)
    return information, gradient


def residual_of(s: Signals, y: np.ndarray) -> np.ndarray:
    """Measured less reconstructed ``(m, N)``, zero where a sample is missing."""
    measured = np.array([s.channels[name] for name in s.outputs])
    return np.where(s.valid, measured - y, 0.0)
