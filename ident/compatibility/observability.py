"""What the channels can and cannot tell: directions of the sensor faults without a trace, from the information matrix, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.compatibility.faults import BIAS, DELAY, DRIFT, LAG, SCALE, SensorFault, faults_of
from ident.compatibility.fitting import Fit
from ident.compatibility.instruments import weigher
from ident.compatibility.noise import NoiseModel
from ident.compatibility.unknowns import evaluate, linearised, unknowns_of
from ident.statistics.information import bounded_inverse

_MEMBER = 0.2  # of the largest part: what takes less part in a combination is not named
_PIVOT = 0.3
_CLOSE = 0.95
FAMILIES = ((DELAY,), (SCALE,), (BIAS, DRIFT))


def cannot_tell(base: Fit, noise: NoiseModel, channels: Sequence[str]) -> tuple[str, ...]:
    """Sentences for records fitted without a fault. Sizes count in units of what is common in practice (``SensorFault.plausible``).

    A fault, or a combination of faults of one family (times, scales, biases and drifts), has no trace where its standard
    deviation is above one such unit; two faults look alike where what they change has a projected cosine of 0.95.
    """
    faults = faults_of(channels, drifts=True, biases=True)
    return untold(fault_information(base, noise, faults), faults, channels)


def untold(information: np.ndarray, faults: Sequence[SensorFault], channels: Sequence[str]) -> tuple[str, ...]:
    """What ``information (k, k)`` on ``faults`` of ``channels``, in units of their plausible sizes, leaves open, in sentences."""
    silent = np.diag(information) < 1.0
    out = []
    for channel in channels:
        kinds = [fault.kind for fault, lost in zip(faults, silent, strict=True) if fault.channel == channel and lost]
        if kinds:
            out.append(f"{channel}: {_listed(kinds)} leave{'s' if len(kinds) == 1 else ''} no trace")
    seen = np.flatnonzero(~silent)
    for family in FAMILIES:
        members = [i for i in seen.tolist() if faults[i].kind in family]
        if len(members) > 1:
            named = [faults[i] for i in members]
            values, vectors = np.linalg.eigh(information[np.ix_(members, members)])
            out += [_combination_sentence(row, named) for row in _simple_rows(vectors[:, values < 1.0].T, named)]
    return (*dict.fromkeys(out), *(f"{_listed([f.name for f in group])} look alike" for group in _alike(information, faults, seen.tolist())))


def fault_information(base: Fit, noise: NoiseModel, faults: Sequence[SensorFault]) -> np.ndarray:
    """Information on the faults, each in units of its plausible size, when starts, gravity's turn and jumps are free: ``(k, k)``.

    A lag's trace is that of its plausible size: at zero it is a delay's.
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
                late = sizes.copy()
                late[j] = fault.plausible
                columns[:, :, len(free) + j] = evaluate(s, unknowns, faults, own[None], late[None])[:, 0] - y
        white = weigher(s, noise)(np.where(s.valid[:, :, None], columns, 0.0)).reshape(-1, columns.shape[2])
        whole = white.T @ white
        for i, place in enumerate(free):
            whole[i, i] += 1.0 / unknowns[place].prior ** 2
        n = len(free)
        total += whole[n:, n:] - whole[n:, :n] @ bounded_inverse(whole[:n, :n]) @ whole[:n, n:]
    return total


def _simple_rows(rows: np.ndarray, named: Sequence[SensorFault]) -> list[np.ndarray]:
    """The same space by rows of few members: Gauss-Jordan, drifts expressed by biases."""
    rows, out, done = rows.copy(), [], np.zeros(len(rows), dtype=bool)
    order = sorted(range(len(named)), key=lambda i: named[i].kind != DRIFT)
    for column in order:
        left = np.flatnonzero(~done)
        if not left.size:
            break
        best = left[np.argmax(np.abs(rows[left, column]))]
        if abs(rows[best, column]) < _PIVOT * np.abs(rows[best]).max():
            continue
        rows[best] /= rows[best, column]
        for other in range(len(rows)):
            if other != best:
                rows[other] -= rows[other, column] * rows[best]
        done[best] = True
    for row in rows:
        out.append(row / np.abs(row).max())
    return out


def _alike(information: np.ndarray, faults: Sequence[SensorFault], seen: Sequence[int]) -> list[list[SensorFault]]:
    """Groups of faults of which each looks like each other one; biases and drifts are told by their combinations."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    left, out = [i for i in seen if faults[i].kind not in (BIAS, DRIFT)], []
    while left:
        group = [left.pop(0)]
        for i in list(left):
            if all(abs(information[i, j]) >= _CLOSE * size[i] * size[j] for j in group):
                group.append(i)
                left.remove(i)
        if len(group) > 1:
            out.append([faults[i] for i in group])
    return out


def _combination_sentence(row: np.ndarray, named: Sequence[SensorFault]) -> str:
    members = [(named[i], row[i]) for i in np.argsort(-np.abs(row)) if abs(row[i]) >= _MEMBER]
    kinds = {fault.kind for fault, _ in members}
    lateness = all(fault.kind in (DELAY, LAG) for fault, _ in members)
    channels = sorted({fault.channel for fault, _ in members}, key=[fault.channel for fault in named].index)
    same = all(part * members[0][1] > 0 for _, part in members)
    if lateness and same and len(channels) > 1:
        return f"a delay common to {_listed(channels)} leaves no trace: only relative timing shows"
    if kinds == {SCALE} and same:
        return f"a scale common to {_listed(channels)} leaves no trace: only ratios show"
    names = sorted(fault.name for fault, _ in members)
    if len(names) == 1:
        return f"{names[0]} is not determined beside the others"
    return f"{_listed(names)}: only combinations of them show"


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
