"""Fits of the kinematics, estimates of faults by both methods, and unobservable faults."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ident.compatibility.kinematics import (
    BIAS,
    DELAY,
    DRIFT,
    LAG,
    SCALE,
    SensorFault,
    Unknown,
    evaluate,
    faults_of,
    linearised,
    start_of,
    unknowns_of,
)
from ident.compatibility.signals import (
    KinematicSignals,
    NoiseEvidence,
    RelationNoise,
    Weigher,
    first_noise,
    part_of_controls,
    settled_noise,
    walk_gains,
    weigher,
    whitener,
)
from ident.statistics.intervals import (
    DIFFERENCED_UNDETERMINED,
    bounded_inverse,
    inverse_information,
)
from ident.statistics.residual_spectrum import corrected_covariance

# ---- Fits of the kinematics to records

_MOST_ITERATIONS = 8
_NEGLIGIBLE_GAIN = 2e-3  # smallest gain of a step, times two


@dataclass(frozen=True, eq=False)
class KinematicFit:
    """A fit of R records.

    Attributes
    ----------
    faults, sizes : fitted in addition to each record's own unknowns.
    own : values of these, one array a record.
    noise : of the residual.
    cost : minus the log likelihood, priors included.
    residuals : ``(m, N)`` a record, zero where a sample is missing.
    jacobians : ``(m, N, own + faults)`` a record, of the reconstruction.
    outputs : ``(m, N)`` expected sensor readings.
    """

    signals: tuple[KinematicSignals, ...]
    faults: tuple[SensorFault, ...]
    sizes: np.ndarray
    own: tuple[np.ndarray, ...]
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
    """Smoother fit: Gauss-Newton in the metric of the noise of outputs and inputs, its variances by
    likelihood in between.

    ``begin`` gives starts for all that it has; ``first`` those of the faults.
    """
    unknowns = [unknowns_of(s) for s in signals]
    own = [
        np.array(begin.own[r]) if begin is not None else start_of(s, unknowns[r])
        for r, s in enumerate(signals)
    ]
    sizes = np.zeros(len(faults))
    if begin is not None:
        sizes_by_fault = dict(zip(begin.faults, begin.sizes.tolist(), strict=True))
        sizes = np.array([sizes_by_fault.get(fault, 0.0) for fault in faults])
    if first is not None:
        sizes = first.astype(float)
    first_levels = first_noise(signals)
    noise = begin.noise if begin is not None else first_levels
    priors = [np.array([1.0 / item.prior**2 for item in u]) for u in unknowns]
    lines = [
        linearised(s, u, faults, o, sizes) for s, u, o in zip(signals, unknowns, own, strict=True)
    ]
    search = KinematicDescent(
        tuple(signals), tuple(unknowns), tuple(faults), tuple(priors), evaluate, linearised
    )
    cost = 0.0
    for turn in range(passes):
        whiteners = [weigher(s, noise) for s in signals]
        own, sizes, lines = descended(search, (own, sizes, lines), whiteners)
        before = noise.logs
        residuals = tuple(residual_of(s, y) for s, (y, _) in zip(signals, lines, strict=True))
        columns = tuple(
            np.where(s.valid[:, :, None], slope[:, :, : len(o)], 0.0)
            for s, (_, slope), o in zip(signals, lines, own, strict=True)
        )
        noise, cost = settled_noise(
            NoiseEvidence(tuple(signals), residuals, columns, tuple(priors), first_levels),
            noise,
            6 if begin is None and turn == 0 else 2,
        )
        if turn and np.all(np.abs(noise.logs - before) < 0.05):
            break
    cost += sum(0.5 * float(np.sum(prior * o**2)) for prior, o in zip(priors, own, strict=True))
    return KinematicFit(
        tuple(signals),
        tuple(faults),
        sizes,
        tuple(own),
        noise,
        cost,
        residuals,
        tuple(slope for _, slope in lines),
        tuple(y for y, _ in lines),
    )


# Unknowns of each record, sizes of the faults, and outputs with slopes there.
Reached = tuple[list[np.ndarray], np.ndarray, list[tuple[np.ndarray, np.ndarray]]]


@dataclass(frozen=True, eq=False)
class KinematicDescent:
    """Functions and settings for Gauss-Newton steps on records, for any kinematics.

    ``evaluate`` and ``linearised`` are those of the kinematics; ``shares`` of a step are tried in
    turn until one gains, at most ``steps`` times, or until a step gained less than ``enough``.
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


def descended(search: KinematicDescent, at: Reached, whiteners: Sequence[Weigher]) -> Reached:
    """Return the least-squares unknowns and sizes under a given noise, and the
    linearisation there.
    """
    (own, sizes, lines), signals, priors = at, search.signals, search.priors
    largest = np.array([fault.largest for fault in search.faults])
    here = misfit(signals, priors, own, [y for y, _ in lines], whiteners)
    for _ in range(search.steps):
        information, gradient = normal_equations(signals, priors, own, lines, whiteners)
        step = bounded_inverse(information) @ gradient
        if float(gradient @ step) < _NEGLIGIBLE_GAIN:
            break
        for share in search.shares:
            moved = np.split(share * step, np.cumsum([len(o) for o in own]))
            trial = [o + d for o, d in zip(own, moved, strict=False)]
            size = np.clip(sizes + moved[-1], -largest, largest)
            shown = [
                search.evaluate(s, u, search.faults, o[None], size[None])[:, 0]
                for s, u, o in zip(signals, search.unknowns, trial, strict=True)
            ]
            there = misfit(signals, priors, trial, shown, whiteners)
            if there < here:
                break
        else:
            break
        own, sizes, gained, here = trial, size, here - there, there
        lines = [
            search.linearised(s, u, search.faults, o, sizes)
            for s, u, o in zip(signals, search.unknowns, own, strict=True)
        ]
        if gained < search.enough:
            break
    return own, sizes, lines


def misfit(
    signals: Sequence[KinematicSignals],
    priors: Sequence[np.ndarray],
    own: Sequence[np.ndarray],
    outputs: Sequence[np.ndarray],
    whiteners: Sequence[Weigher],
) -> float:
    """Return half the sum of squares under given noise, priors included."""
    total = 0.0
    for s, prior, o, y, white in zip(signals, priors, own, outputs, whiteners, strict=True):
        residual = residual_of(s, y)
        # A divergent reconstruction is no candidate, and its square overflows.
        if not np.all(np.abs(residual) < 1e6):
            return float("inf")
        total += 0.5 * float(np.sum(white(residual[:, :, None]) ** 2)) + 0.5 * float(
            np.sum(prior * o**2)
        )
    return total


def whitened(kinematic_fit: KinematicFit) -> list[tuple[np.ndarray, np.ndarray]]:
    """Residual ``(m, N)`` and jacobian ``(m, N, c)`` of each record whitened to unit variance.

    With instruments the jacobian is projected onto them; its product with the residual is still the
    gradient.
    """
    out = []
    for s, residual, jacobian in zip(
        kinematic_fit.signals, kinematic_fit.residuals, kinematic_fit.jacobians, strict=True
    ):
        e = whitener(s, kinematic_fit.noise)(residual[:, :, None])[:, :, 0]
        out.append(
            (e, weigher(s, kinematic_fit.noise)(np.where(s.valid[:, :, None], jacobian, 0.0)))
        )
    return out


def least_misfit(
    kinematic_fit: KinematicFit,
    whiteners: Sequence[Weigher],
    priors: Sequence[np.ndarray] | None = None,
) -> float:
    """Return half the sum of squares that the unknowns of a fit leave under another noise, priors
    included; to first order.

    ``whiteners`` of that noise, one a record (``ident.compatibility.signals.weigher``).
    ``priors`` : one over the variances of each record's own unknowns; None: of the longitudinal
    kinematics.
    """
    if priors is None:
        priors = [
            np.array([1.0 / item.prior**2 for item in unknowns_of(s)])
            for s in kinematic_fit.signals
        ]
    lines = list(zip(kinematic_fit.outputs, kinematic_fit.jacobians, strict=True))
    information, gradient = normal_equations(
        kinematic_fit.signals, priors, kinematic_fit.own, lines, whiteners
    )
    here = misfit(
        kinematic_fit.signals, priors, kinematic_fit.own, kinematic_fit.outputs, whiteners
    )
    return here - 0.5 * float(gradient @ bounded_inverse(information) @ gradient)


def positions(kinematic_fit: KinematicFit) -> list[np.ndarray]:
    """Return the positions of the columns of each record's Jacobian in the vector of all unknowns:
    own ones first, then the faults.
    """
    total, out, at = sum(len(own) for own in kinematic_fit.own), [], 0
    for own in kinematic_fit.own:
        out.append(
            np.concatenate(
                [np.arange(at, at + len(own)), total + np.arange(len(kinematic_fit.faults))]
            )
        )
        at += len(own)
    return out


def prior_information(kinematic_fit: KinematicFit) -> np.ndarray:
    """Diagonal information of the priors on all unknowns."""
    own = [[1.0 / item.prior**2 for item in unknowns_of(s)] for s in kinematic_fit.signals]
    return np.concatenate([*map(np.array, own), np.zeros(len(kinematic_fit.faults))])


def normal_equations(
    signals: Sequence[KinematicSignals],
    priors: Sequence[np.ndarray],
    own: Sequence[np.ndarray],
    lines: Sequence[tuple[np.ndarray, np.ndarray]],
    whiteners: Sequence[Weigher],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the information ``(n, n)`` and gradient ``(n,)`` of the log likelihood, own unknowns
    of each record first.
    """
    total = sum(len(o) for o in own)
    faults = lines[0][1].shape[2] - len(own[0])
    information = np.zeros((total + faults, total + faults))
    gradient, at = np.zeros(total + faults), 0
    for s, prior, o, (y, slope), white in zip(signals, priors, own, lines, whiteners, strict=True):
        columns = np.concatenate(
            [residual_of(s, y)[:, :, None], np.where(s.valid[:, :, None], slope, 0.0)], axis=2
        )
        all_columns = white(columns).reshape(-1, columns.shape[2])
        product = all_columns.T @ all_columns
        where = np.concatenate([np.arange(at, at + len(o)), total + np.arange(faults)])
        information[np.ix_(where, where)] += product[1:, 1:]
        gradient[where] += product[1:, 0]
        gradient[at : at + len(o)] -= prior * o
        information[np.arange(at, at + len(o)), np.arange(at, at + len(o))] += prior
        at += len(o)
    return information, gradient


def residual_of(s: KinematicSignals, y: np.ndarray) -> np.ndarray:
    """Measured less reconstructed ``(m, N)``, zero where a sample is missing."""
    measured = np.array([s.channels[name] for name in s.outputs])
    return np.where(s.valid, measured - y, 0.0)


# ---- Output error and smoother compared

MOST_PASSES = 4


@dataclass(frozen=True, eq=False)
class Sigmas:
    """Uncertainty of a smoother fit: covariance of all unknowns under its noise, and the factor of
    each variance for coloured residuals.
    """

    covariance: np.ndarray
    widening: np.ndarray


def smoother_sigmas(kinematic_fit: KinematicFit) -> Sigmas:
    """Return the covariance of a fit, corrected for innovations that are not white
    (``ident.statistics.residual_spectrum``).
    """
    white, at = whitened(kinematic_fit), positions(kinematic_fit)
    information = np.diag(prior_information(kinematic_fit))
    for (_, jacobian), where in zip(white, at, strict=True):
        J = jacobian.reshape(-1, jacobian.shape[2])
        information[np.ix_(where, where)] += J.T @ J
    inverse, _ = inverse_information(information, floor=DIFFERENCED_UNDETERMINED)
    parts = [
        (where, jacobian, e, s.valid)
        for (e, jacobian), where, s in zip(white, at, kinematic_fit.signals, strict=True)
    ]
    corrected = corrected_covariance(inverse, parts, np.ones(len(kinematic_fit.noise.outputs)))
    own, wide = np.diag(inverse), np.diag(corrected)
    return Sigmas(
        inverse, np.maximum(np.divide(wide, own, out=np.ones_like(wide), where=own > 0), 1.0)
    )


def output_error(kinematic_fit: KinematicFit) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of all unknowns by output error, begun at a smoother fit, and their
    covariance with the inputs' noise accounted for.

    Residuals are weighed by their own mean square, as if they were white; the covariance is that
    which such weights give under the noise of outputs and inputs of the smoother fit.
    """
    own, sizes, at = (
        [o.copy() for o in kinematic_fit.own],
        kinematic_fit.sizes.copy(),
        positions(kinematic_fit),
    )
    prior = prior_information(kinematic_fit)
    unknowns = [unknowns_of(s) for s in kinematic_fit.signals]
    largest = np.array([fault.largest for fault in kinematic_fit.faults])
    total = len(prior) - len(sizes)
    lines = list(zip(kinematic_fit.outputs, kinematic_fit.jacobians, strict=True))
    parts = [part_of_controls(s) for s in kinematic_fit.signals]
    for turn in range(MOST_PASSES):
        if turn:
            lines = [
                linearised(s, u, kinematic_fit.faults, o, sizes)
                for s, u, o in zip(kinematic_fit.signals, unknowns, own, strict=True)
            ]
        measured = [
            np.array([s.channels[name] for name in s.outputs]) for s in kinematic_fit.signals
        ]
        residuals = [
            np.where(s.valid, z - y, 0.0)
            for s, z, (y, _) in zip(kinematic_fit.signals, measured, lines, strict=True)
        ]
        counts = np.sum([s.valid.sum(axis=1) for s in kinematic_fit.signals], axis=0)
        variance = np.maximum(
            np.sum([(e**2).sum(axis=1) for e in residuals], axis=0) / np.maximum(counts, 1), 1e-30
        )
        information, gradient = np.diag(prior), np.zeros(len(prior))
        columns = []
        for s, part, e, (_, slope), where in zip(
            kinematic_fit.signals, parts, residuals, lines, at, strict=True
        ):
            J = part(np.where(s.valid[:, :, None], slope, 0.0)) / variance[:, None, None]
            columns.append(J)
            information[np.ix_(where, where)] += np.einsum("mnc,mnd->cd", J, slope)
            gradient[where] += np.einsum("mnc,mn->c", J, e)
        gradient[:total] -= prior[:total] * np.concatenate(own)
        inverse = bounded_inverse(information)
        step = inverse @ gradient
        place = 0
        for r in range(len(own)):
            own[r] = own[r] + step[place : place + len(own[r])]
            place += len(own[r])
        sizes = np.clip(sizes + step[place:], -largest, largest)
        if np.all(np.abs(step) <= 0.1 * np.sqrt(np.maximum(np.diag(inverse), 1e-300))):
            break
    spread = np.diag(prior)
    for s, J, where in zip(kinematic_fit.signals, columns, at, strict=True):
        spread[np.ix_(where, where)] += np.einsum("mnc,m,mnd->cd", J, kinematic_fit.noise.white, J)
        ahead = np.cumsum(J[:, ::-1], axis=1)[:, ::-1][:, 1:]
        walk = (
            np.einsum("mi,mnc->inc", walk_gains(s, kinematic_fit.noise), ahead)
            * s.steps[None, :, None]
        )
        spread[np.ix_(where, where)] += np.einsum(
            "inc,i,ind->cd", walk, kinematic_fit.noise.density, walk
        )
    inverse, _ = inverse_information(information, floor=DIFFERENCED_UNDETERMINED)
    return np.concatenate([*own, sizes]), _sandwich(inverse, spread)


def _sandwich(inverse: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return inverse spread inverse' as a product of a matrix with its transpose, so that rounding
    makes no variance negative.
    """
    scale = np.sqrt(np.maximum(np.diag(spread), 1e-300))
    values, vectors = np.linalg.eigh(spread / np.outer(scale, scale))
    half = inverse @ (scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
    return np.asarray(half @ half.T)


def difference_in_sigmas(one: float, var_one: float, other: float, var_other: float) -> float:
    """``one - other`` over its standard deviation where ``other`` is efficient: the variances
    subtract (Hausman, Econometrica 46(6), 1978).
    """
    # If both variances are nearly equal, nonlinear terms exceed their difference.
    variance = max(var_one - var_other, 0.2 * max(var_one, var_other))
    return (one - other) / math.sqrt(variance) if variance > 0 else 0.0


# ---- Unobservable faults

_LEAST_PART = 0.2  # smallest part of a fault in a named combination, relative to the largest
_LEAST_PIVOT = 0.3
_CONFUSABLE_CORRELATION = 0.95
FAMILIES = ((DELAY,), (SCALE,), (BIAS, DRIFT))


def unobservable_sentences(
    base: KinematicFit, noise: RelationNoise, channels: Sequence[str]
) -> tuple[str, ...]:
    """Return the sentences for records fitted without a fault. Sizes are in units of common sizes
    (``SensorFault.plausible``).

    A fault, or a combination of faults of one family (times, scales, biases and drifts), is
    unobservable if its standard deviation exceeds one such unit; two faults are confusable if their
    projected signatures have a cosine of 0.95.
    """
    faults = faults_of(channels, drifts=True, biases=True)
    return unobservable_faults(fault_information(base, noise, faults), faults, channels)


def unobservable_faults(
    information: np.ndarray, faults: Sequence[SensorFault], channels: Sequence[str]
) -> tuple[str, ...]:
    """Return the sentences on combinations of ``faults`` that ``information (k, k)`` does not
    determine, in units of plausible sizes.
    """
    silent = np.diag(information) < 1.0
    out = []
    for channel in channels:
        kinds = [
            fault.kind
            for fault, lost in zip(faults, silent, strict=True)
            if fault.channel == channel and lost
        ]
        if kinds:
            be = "is" if len(kinds) == 1 else "are"
            out.append(f"{channel}: {_listed(kinds)} {be} not observable")
    seen = np.flatnonzero(~silent)
    for family in FAMILIES:
        members = [i for i in seen.tolist() if faults[i].kind in family]
        if len(members) > 1:
            named = [faults[i] for i in members]
            values, vectors = np.linalg.eigh(information[np.ix_(members, members)])
            out += [
                _combination_sentence(row, named)
                for row in _simple_rows(vectors[:, values < 1.0].T, named)
            ]
    return (
        *dict.fromkeys(out),
        *(
            f"{_listed([f.name for f in group])} cannot be told apart"
            for group in _alike(information, faults, seen.tolist())
        ),
    )


def fault_information(
    base: KinematicFit, noise: RelationNoise, faults: Sequence[SensorFault]
) -> np.ndarray:
    """Return the information on the faults, each in units of its plausible size, when starts,
    gravity's turn and jumps are free: ``(k, k)``.

    A lag is linearised at its plausible size, since at zero it equals a delay.
    """
    k = len(faults)
    total = np.zeros((k, k))
    sizes = np.zeros(k)
    for s, own in zip(base.signals, base.own, strict=True):
        unknowns = unknowns_of(s)
        free = [i for i, item in enumerate(unknowns) if item.key[1] != BIAS]
        y, slopes = linearised(s, unknowns, faults, own, sizes)
        columns = slopes[:, :, [*free, *range(len(unknowns), len(unknowns) + k)]]
        for j, fault in enumerate(faults):
            columns[:, :, len(free) + j] *= fault.plausible
            if fault.kind == LAG:
                last_fault = sizes.copy()
                last_fault[j] = fault.plausible
                columns[:, :, len(free) + j] = (
                    evaluate(s, unknowns, faults, own[None], last_fault[None])[:, 0] - y
                )
        white = weigher(s, noise)(np.where(s.valid[:, :, None], columns, 0.0)).reshape(
            -1, columns.shape[2]
        )
        whole = white.T @ white
        for i, place in enumerate(free):
            whole[i, i] += 1.0 / unknowns[place].prior ** 2
        n = len(free)
        total += whole[n:, n:] - whole[n:, :n] @ bounded_inverse(whole[:n, :n]) @ whole[:n, n:]
    return total


def _simple_rows(rows: np.ndarray, named: Sequence[SensorFault]) -> list[np.ndarray]:
    """Return rows with few members that span the same space: Gauss-Jordan, with drifts expressed by
    biases.
    """
    rows, out, done = rows.copy(), [], np.zeros(len(rows), dtype=bool)
    order = sorted(range(len(named)), key=lambda i: named[i].kind != DRIFT)
    for column in order:
        left = np.flatnonzero(~done)
        if not left.size:
            break
        best = left[np.argmax(np.abs(rows[left, column]))]
        if abs(rows[best, column]) < _LEAST_PIVOT * np.abs(rows[best]).max():
            continue
        rows[best] /= rows[best, column]
        for other in range(len(rows)):
            if other != best:
                rows[other] -= rows[other, column] * rows[best]
        done[best] = True
    for row in rows:
        out.append(row / np.abs(row).max())
    return out


def _alike(
    information: np.ndarray, faults: Sequence[SensorFault], seen: Sequence[int]
) -> list[list[SensorFault]]:
    """Return groups of confusable faults; biases and drifts are described by their combinations."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    left, out = [i for i in seen if faults[i].kind not in (BIAS, DRIFT)], []
    while left:
        group = [left.pop(0)]
        for i in list(left):
            if all(
                abs(information[i, j]) >= _CONFUSABLE_CORRELATION * size[i] * size[j] for j in group
            ):
                group.append(i)
                left.remove(i)
        if len(group) > 1:
            out.append([faults[i] for i in group])
    return out


def _combination_sentence(row: np.ndarray, named: Sequence[SensorFault]) -> str:
    members = [(named[i], row[i]) for i in np.argsort(-np.abs(row)) if abs(row[i]) >= _LEAST_PART]
    kinds = {fault.kind for fault, _ in members}
    lateness = all(fault.kind in (DELAY, LAG) for fault, _ in members)
    channels = sorted(
        {fault.channel for fault, _ in members}, key=[fault.channel for fault in named].index
    )
    same = all(part * members[0][1] > 0 for _, part in members)
    if lateness and same and len(channels) > 1:
        return f"a delay common to {_listed(channels)} is not observable, only relative delays are"
    if kinds == {SCALE} and same:
        return f"a scale common to {_listed(channels)} is not observable, only ratios are"
    names = sorted(fault.name for fault, _ in members)
    if len(names) == 1:
        return f"{names[0]} is not determined beside the others"
    return f"{_listed(names)}: only combinations are observable"


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
