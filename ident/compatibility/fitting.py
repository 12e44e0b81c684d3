"""Fits of the kinematics to records: unknown starts and biases of each record, sensor faults common to all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.compatibility.faults import BIAS, DELAY, LAG, SensorFault
from ident.compatibility.kinematics import reconstructed
from ident.compatibility.noise import NoiseEvidence, NoiseModel, Whitener, first_noise, settled_noise, whitener
from ident.compatibility.signals import Signals

Key = tuple[str, str]
_ITERATIONS = 8
_UNDETERMINED = 1e-9
_SMALL = 2e-3  # twice the gain of a step that is not worth taking


@dataclass(frozen=True)
class Unknown:
    """A quantity of one record that every fit leaves free: its key, the size of a step to differentiate, and a prior sigma (infinite: none)."""

    key: Key
    step: float
    prior: float = float("inf")


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


def unknowns_of(s: Signals) -> tuple[Unknown, ...]:
    """Starts of the states; biases that the relations need; without theta two numbers for gravity's turn; when nz jumps with an input, by how much
    its integral may be off."""
    out = [Unknown(("start", name), 1e-3) for name in s.outputs]
    if "theta" in s.outputs:
        out.append(Unknown(("q", BIAS), 1e-4))
    if "alpha" in s.outputs:
        out.append(Unknown(("nz", BIAS), 1e-3))
        if "theta" not in s.channels:
            out += [Unknown(("turn", "1"), 1e-3, 0.2), Unknown(("turn", "2"), 1e-2, 0.5)]
        if s.jumps.size:
            out.append(Unknown(("jump", "nz"), 1e-2, 1.0))
    if "airspeed" in s.outputs:
        out.append(Unknown(("ax", BIAS), 1e-3))
    return tuple(out)


def start_of(s: Signals, unknowns: Sequence[Unknown]) -> np.ndarray:
    """First values: states as they are first measured, nz incremental or total, whichever is nearer."""
    out = np.zeros(len(unknowns))
    for i, item in enumerate(unknowns):
        channel, kind = item.key
        if channel == "start":
            row = s.outputs.index(kind)
            out[i] = float(np.median(s.channels[kind][np.flatnonzero(s.valid[row])[:5]])) if np.any(s.valid[row]) else 0.0
        elif item.key == ("nz", BIAS):
            level = float(np.mean(s.channels["nz"]))
            out[i] = level if "theta" not in s.channels else (0.0 if level > 0.5 else -1.0)
    return out


def evaluate(s: Signals, unknowns: Sequence[Unknown], faults: Sequence[SensorFault], own: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Outputs for rows of values: ``own (P, n)``, ``sizes (P, k)`` to ``(m, P, N)``."""
    table = {item.key: own[:, i : i + 1] for i, item in enumerate(unknowns)}
    for j, fault in enumerate(faults):
        key = (fault.channel, fault.kind)
        table[key] = table[key] + sizes[:, j : j + 1] if key in table else sizes[:, j : j + 1]
    none = np.zeros((1, 1))
    return reconstructed(s, lambda channel, kind: table.get((channel, kind), none))


def difference_step(fault: SensorFault) -> float:
    """Step of a central difference; a lag's and a delay's are felt over several samples."""
    return 0.004 if fault.kind in (DELAY, LAG) else 1e-3 * fault.plausible


def linearised(
    s: Signals, unknowns: Sequence[Unknown], faults: Sequence[SensorFault], own: np.ndarray, sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs ``(m, N)`` and their slopes ``(m, N, n + k)`` in one call: one-sided differences for a record's own, central ones for faults."""
    n, k = len(unknowns), len(faults)
    step = np.array([item.step for item in unknowns] + [difference_step(fault) for fault in faults])
    centre = np.concatenate([own, sizes])
    points = np.concatenate([centre[None], centre + np.diag(step), (centre - np.diag(step))[n:]])
    y = np.broadcast_to(evaluate(s, unknowns, faults, points[:, :n], points[:, n:]), (len(s.outputs), n + 2 * k + 1, len(s.time)))
    slope = np.empty((len(s.outputs), n + k, len(s.time)))
    slope[:, :n] = (y[:, 1 : n + 1] - y[:, :1]) / step[:n, None]
    slope[:, n:] = (y[:, n + 1 : n + k + 1] - y[:, n + k + 1 :]) / (2.0 * step[n:, None])
    return y[:, 0], slope.transpose(0, 2, 1)


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
        whiteners = [whitener(s, noise) for s in signals]
        for _ in range(_ITERATIONS):
            information, gradient = _normal(signals, priors, own, lines, whiteners)
            step = bounded_inverse(information) @ gradient
            if float(gradient @ step) < _SMALL:
                break
            here = _misfit(signals, priors, own, [y for y, _ in lines], whiteners)
            for share in (1.0, 0.5, 0.2, 0.05, 0.01):
                moved = np.split(share * step, np.cumsum([len(o) for o in own]))
                trial, size = [o + d for o, d in zip(own, moved, strict=False)], np.clip(sizes + moved[-1], -largest, largest)
                shown = [evaluate(s, u, faults, o[None], size[None])[:, 0] for s, u, o in zip(signals, unknowns, trial, strict=True)]
                if _misfit(signals, priors, trial, shown, whiteners) < here:
                    break
            else:
                break
            own, sizes = trial, size
            lines = [linearised(s, u, faults, o, sizes) for s, u, o in zip(signals, unknowns, own, strict=True)]
        before = noise.logs
        residuals = tuple(_residual(s, y) for s, (y, _) in zip(signals, lines, strict=True))
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


def one_step(base: Fit, faults: Sequence[SensorFault]) -> list[Fit]:
    """For each fault the fit in which it is added to ``base``, to first order and with the noise of ``base``: one linear solve each."""
    white, at, slopes = whitened(base), positions(base), []
    information, gradient = np.diag(prior_information(base)), np.zeros(sum(len(own) for own in base.own) + len(base.faults))
    for s, own, (e, jacobian), where in zip(base.signals, base.own, white, at, strict=True):
        J = jacobian.reshape(-1, jacobian.shape[2])
        information[np.ix_(where, where)] += J.T @ J
        gradient[where] += J.T @ e.ravel()
        sizes = np.append(base.sizes, np.zeros(len(faults)))
        slopes.append(linearised(s, unknowns_of(s), (*base.faults, *faults), own, sizes)[1][:, :, len(own) + len(base.faults) :])
    total = sum(len(own) for own in base.own)
    gradient[:total] -= prior_information(base)[:total] * np.concatenate(base.own)
    added = [whitener(s, base.noise)(np.where(s.valid[:, :, None], slope, 0.0)) for s, slope in zip(base.signals, slopes, strict=True)]
    return [_with_step(base, fault, j, white, at, slopes, added, information, gradient) for j, fault in enumerate(faults)]


def _with_step(
    base: Fit,
    fault: SensorFault,
    j: int,
    white: Sequence[tuple[np.ndarray, np.ndarray]],
    at: Sequence[np.ndarray],
    slopes: Sequence[np.ndarray],
    added: Sequence[np.ndarray],
    information: np.ndarray,
    gradient: np.ndarray,
) -> Fit:
    n = len(gradient)
    whole, right = np.zeros((n + 1, n + 1)), np.append(gradient, 0.0)
    whole[:n, :n] = information
    for (e, jacobian), where, columns in zip(white, at, added, strict=True):
        column = columns[:, :, j].ravel()
        whole[n, n] += column @ column
        whole[where, n] += jacobian.reshape(-1, jacobian.shape[2]).T @ column
        right[n] += column @ e.ravel()
    whole[n, :n] = whole[:n, n]
    step = bounded_inverse(whole) @ right
    step[n] = float(np.clip(step[n], -fault.largest, fault.largest))
    own, residuals, jacobians, outputs = [], [], [], []
    for r, (s, where, slope) in enumerate(zip(base.signals, at, slopes, strict=True)):
        jacobian = np.concatenate([base.jacobians[r], slope[:, :, j : j + 1]], axis=2)
        change = jacobian @ np.append(step[where], step[n])
        own.append(base.own[r] + step[where[: len(base.own[r])]])
        residuals.append(np.where(s.valid, base.residuals[r] - change, 0.0))
        jacobians.append(jacobian)
        outputs.append(base.outputs[r] + change)
    total = sum(len(o) for o in own)
    sizes = np.append(base.sizes + step[total:n], step[n])
    cost = base.cost - 0.5 * max(float(right @ step), 0.0)
    return Fit(base.signals, (*base.faults, fault), sizes, tuple(own), base.noise, cost, tuple(residuals), tuple(jacobians), tuple(outputs))


def _misfit(
    signals: Sequence[Signals],
    priors: Sequence[np.ndarray],
    own: Sequence[np.ndarray],
    outputs: Sequence[np.ndarray],
    whiteners: Sequence[Whitener],
) -> float:
    """Half the sum of squares under given noise, priors included."""
    total = 0.0
    for s, prior, o, y, white in zip(signals, priors, own, outputs, whiteners, strict=True):
        residual = _residual(s, y)
        # What runs away is no candidate, and its square no number.
        if not np.all(np.abs(residual) < 1e6):
            return float("inf")
        total += 0.5 * float(np.sum(white(residual[:, :, None]) ** 2)) + 0.5 * float(np.sum(prior * o**2))
    return total


def whitened(found: Fit) -> list[tuple[np.ndarray, np.ndarray]]:
    """Residual ``(m, N)`` and jacobian ``(m, N, c)`` of each record as those of independent samples of variance one."""
    out = []
    for s, residual, jacobian in zip(found.signals, found.residuals, found.jacobians, strict=True):
        white = whitener(s, found.noise)(np.concatenate([residual[:, :, None], np.where(s.valid[:, :, None], jacobian, 0.0)], axis=2))
        out.append((white[:, :, 0], white[:, :, 1:]))
    return out


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
    whiteners: Sequence[Whitener],
) -> tuple[np.ndarray, np.ndarray]:
    """Information ``(n, n)`` and gradient ``(n,)`` of the log likelihood, own unknowns of each record first."""
    total = sum(len(o) for o in own)
    faults = lines[0][1].shape[2] - len(own[0])
    information, gradient, at = np.zeros((total + faults, total + faults)), np.zeros(total + faults), 0
    for s, prior, o, (y, slope), white in zip(signals, priors, own, lines, whiteners, strict=True):
        columns = np.concatenate([_residual(s, y)[:, :, None], np.where(s.valid[:, :, None], slope, 0.0)], axis=2)
        all_columns = white(columns).reshape(-1, columns.shape[2])
        product = all_columns.T @ all_columns
        where = np.concatenate([np.arange(at, at + len(o)), total + np.arange(faults)])
        information[np.ix_(where, where)] += product[1:, 1:]
        gradient[where] += product[1:, 0]
        gradient[at : at + len(o)] -= prior * o
        information[np.arange(at, at + len(o)), np.arange(at, at + len(o))] += prior
        at += len(o)
    return information, gradient


def covariance_of(information: np.ndarray) -> np.ndarray:
    """Inverse in which a direction that is not determined keeps a variance far beyond all others."""
    scale = 1.0 / np.sqrt(np.where(np.diag(information) > 0, np.diag(information), 1.0))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    return np.asarray(np.outer(scale, scale) * ((vectors / np.maximum(values, _UNDETERMINED * max(float(values[-1]), 1e-300))) @ vectors.T))


def bounded_inverse(information: np.ndarray) -> np.ndarray:
    """Inverse without directions that hold less than 1e-12 of the scaled information."""
    scale = 1.0 / np.sqrt(np.where(np.diag(information) > 0, np.diag(information), 1.0))
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    told = values > 1e-12 * max(float(values[-1]), 1e-300)
    return np.asarray(np.outer(scale, scale) * ((vectors * np.where(told, 1.0 / np.where(told, values, 1.0), 0.0)) @ vectors.T))


def _residual(s: Signals, y: np.ndarray) -> np.ndarray:
    measured = np.array([s.channels[name] for name in s.outputs])
    return np.where(s.valid, measured - y, 0.0)
