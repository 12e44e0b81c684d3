"""Sentences on the sensor faults that records do not determine."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from ident.compatibility.fitting import KinematicFit, projected_whitener
from ident.compatibility.kinematics import (
    BIAS,
    DELAY,
    DRIFT,
    LAG,
    SCALE,
    SensorFault,
    evaluate,
    faults_of,
    linearised,
    unknowns_of,
)
from ident.compatibility.signals import RelationNoise
from ident.statistics.intervals import bounded_inverse

_LEAST_COEFFICIENT = 0.2  # smallest coefficient of a named fault, relative to the largest
_LEAST_PIVOT = 0.3  # smallest pivot, relative to the largest entry of its row
_CONFUSABLE_CORRELATION = 0.95  # faults whose signatures have a larger cosine are confusable
# kinds of faults whose combinations may be unobservable
FAMILIES = ((DELAY,), (SCALE,), (BIAS, DRIFT))


def unobservable_sentences(
    base: KinematicFit,
    noise: RelationNoise,
    channels: Sequence[str],
    chance_loss: float,
    supported: Collection[str] = (),
) -> tuple[str, ...]:
    """Return sentences on faults that the records of a fit without faults do not determine.

    A fault is unobservable if its standard deviation exceeds its plausible size
    (`SensorFault.plausible`). So is a combination of faults of one family (delays, scales, biases
    and drifts). Two faults are confusable if the cosine of their projected signatures is large, and
    one of plausible size loses at most ``chance_loss`` of log likelihood if the other one replaces
    it. ``supported`` are the names of faults that the check of these records has compared with
    their alternatives already; they are left out.
    """
    faults = faults_of(channels, drifts=True, biases=True)
    information = fault_information(base, noise, faults)
    return unobservable_faults(information, faults, channels, chance_loss, supported)


def unobservable_faults(
    information: np.ndarray,
    faults: Sequence[SensorFault],
    channels: Sequence[str],
    chance_loss: float,
    supported: Collection[str] = (),
) -> tuple[str, ...]:
    """Return sentences on the ``faults`` and their combinations that ``information (k, k)``, in
    units of plausible sizes, does not determine. ``chance_loss`` and ``supported`` are those of
    `unobservable_sentences`.
    """
    unobservable = np.diag(information) < 1.0
    sentences = []
    for channel in channels:
        kinds = [
            fault.kind
            for fault, unobserved in zip(faults, unobservable, strict=True)
            if fault.channel == channel and unobserved
        ]
        if kinds:
            be = "is" if len(kinds) == 1 else "are"
            sentences.append(f"{channel}: {_joined(kinds)} {be} not observable")
    observable = np.flatnonzero(~unobservable)
    for family in FAMILIES:
        members = [i for i in observable.tolist() if faults[i].kind in family]
        if len(members) > 1:
            family_faults = [faults[i] for i in members]
            values, vectors = np.linalg.eigh(information[np.ix_(members, members)])
            sentences += [
                _combination_sentence(row, family_faults)
                for row in _sparse_combinations(vectors[:, values < 1.0].T, family_faults)
            ]
    compared = [i for i in observable.tolist() if faults[i].name not in supported]
    return (
        *dict.fromkeys(sentences),
        *(
            f"{_joined([f.name for f in group])} cannot be distinguished"
            for group in _confusable_groups(information, faults, compared, chance_loss)
        ),
    )


def fault_information(
    base: KinematicFit, noise: RelationNoise, faults: Sequence[SensorFault]
) -> np.ndarray:
    """Return the information ``(k, k)`` on the faults, each in units of its plausible size. All
    unknowns of each record except its biases are projected out.

    The column of a lag is the finite effect of its plausible size, since to first order a lag
    equals a delay.
    """
    k = len(faults)
    total = np.zeros((k, k))
    sizes = np.zeros(k)
    for s, unknown_values in zip(base.signals, base.unknown_values, strict=True):
        unknowns = unknowns_of(s)
        free = [i for i, item in enumerate(unknowns) if item.key[1] != BIAS]
        y, slopes = linearised(s, unknowns, faults, unknown_values, sizes)
        columns = slopes[:, :, [*free, *range(len(unknowns), len(unknowns) + k)]]
        for j, fault in enumerate(faults):
            columns[:, :, len(free) + j] *= fault.plausible
            if fault.kind == LAG:
                lag_alone = sizes.copy()
                lag_alone[j] = fault.plausible
                columns[:, :, len(free) + j] = (
                    evaluate(s, unknowns, faults, unknown_values[None], lag_alone[None])[:, 0] - y
                )
        white = projected_whitener(s, noise)(np.where(s.valid[:, :, None], columns, 0.0)).reshape(
            -1, columns.shape[2]
        )
        whole = white.T @ white
        for i, place in enumerate(free):
            whole[i, i] += 1.0 / unknowns[place].prior ** 2
        n = len(free)
        total += whole[n:, n:] - whole[n:, :n] @ bounded_inverse(whole[:n, :n]) @ whole[:n, n:]
    return total


def _sparse_combinations(rows: np.ndarray, faults: Sequence[SensorFault]) -> list[np.ndarray]:
    """Return combinations of few faults that span the same space as ``rows``, by Gauss-Jordan
    elimination with drifts as the first pivots. Columns are those of ``faults``.
    """
    rows, done = rows.copy(), np.zeros(len(rows), dtype=bool)
    order = sorted(range(len(faults)), key=lambda i: faults[i].kind != DRIFT)
    for column in order:
        remaining = np.flatnonzero(~done)
        if not remaining.size:
            break
        best = remaining[np.argmax(np.abs(rows[remaining, column]))]
        if abs(rows[best, column]) < _LEAST_PIVOT * np.abs(rows[best]).max():
            continue
        rows[best] /= rows[best, column]
        for other in range(len(rows)):
            if other != best:
                rows[other] -= rows[other, column] * rows[best]
        done[best] = True
    return [row / np.abs(row).max() for row in rows]


def _confusable_groups(
    information: np.ndarray,
    faults: Sequence[SensorFault],
    observable: Sequence[int],
    chance_loss: float,
) -> list[list[SensorFault]]:
    """Return groups of confusable faults; a fault may be in several groups. Biases and drifts are
    left out: `unobservable_faults` names their unobservable combinations instead.

    ``observable`` are positions in ``faults``; the other arguments are those of
    `unobservable_faults`.
    """
    # twice the gain of log likelihood by each fault at its plausible size
    gains = np.maximum(np.diag(information), 1e-300)
    cosines = np.clip(information / np.outer(np.sqrt(gains), np.sqrt(gains)), -1.0, 1.0)
    # Where both sizes must be positive, effects of opposite sign cannot be confused.
    one_sided = np.array([fault.one_sided for fault in faults])
    similarity = np.where(np.logical_and.outer(one_sided, one_sided), cosines, np.abs(cosines))
    losses = 0.5 * np.maximum.outer(gains, gains) * (1.0 - cosines**2)
    confusable = (similarity >= _CONFUSABLE_CORRELATION) & (losses <= chance_loss)
    candidates = [i for i in observable if faults[i].kind not in (BIAS, DRIFT)]
    groups: list[list[int]] = []
    for first in candidates:
        if not any(first in group for group in groups):
            group = [first]
            for i in candidates:
                if i != first and all(confusable[i, j] for j in group):
                    group.append(i)
            if len(group) > 1:
                groups.append(sorted(group))
    return [[faults[i] for i in group] for group in groups]


def _combination_sentence(row: np.ndarray, faults: Sequence[SensorFault]) -> str:
    """Return the sentence on an unobservable combination with the coefficients ``row``."""
    members = [
        (faults[i], row[i]) for i in np.argsort(-np.abs(row)) if abs(row[i]) >= _LEAST_COEFFICIENT
    ]
    kinds = {fault.kind for fault, _ in members}
    only_delays = all(fault.kind in (DELAY, LAG) for fault, _ in members)
    channels = sorted(
        {fault.channel for fault, _ in members}, key=[fault.channel for fault in faults].index
    )
    same_sign = all(coefficient * members[0][1] > 0 for _, coefficient in members)
    if only_delays and same_sign and len(channels) > 1:
        return f"a delay common to {_joined(channels)} is not observable, only relative delays are"
    if kinds == {SCALE} and same_sign:
        return f"a scale common to {_joined(channels)} is not observable, only ratios are"
    names = sorted(fault.name for fault, _ in members)
    if len(names) == 1:
        return f"{names[0]} is not determined together with the others"
    return f"{_joined(names)}: only combinations are observable"


def _joined(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
