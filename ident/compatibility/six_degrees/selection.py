"""Which sets of faults the records ask for: every set of up to three compared by the normal equations, and what would do as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ident.compatibility.fault_sets import TIE
from ident.compatibility.faults import DELAY, LAG, SensorFault
from ident.compatibility.six_degrees.linear import Normal

LOADS = ("nz", "az", "ny", "ay")
_SLOW = ("airspeed", "height", "altitude")  # no clocks: they change too slowly
_RIDGE = 1e-9  # of the scaled information: alike columns give a large variance, not a failure
_PROMISING = 24  # faults that a set of three is made of, beside the best pairs: all of them cost as much as everything else


@dataclass(frozen=True, eq=False)
class Sets:
    """M sets of s faults each fitted to first order: ``members (M, s)``; ``sizes``, ``white`` variances and ``widening`` of these ``(M, s)``;
    ``gain (M,)`` of log likelihood. ``sound``: each fault determined, worth having, possible; ``early``: but for a load ahead of its time."""

    members: np.ndarray
    sizes: np.ndarray
    white: np.ndarray
    widening: np.ndarray
    gain: np.ndarray
    sound: np.ndarray
    early: np.ndarray

    @property
    def variances(self) -> np.ndarray:
        """Variances over the colour of what is left ``(M, s)``."""
        return self.white * self.widening


def fitted(normal: Normal, faults: Sequence[SensorFault], members: np.ndarray, *, early: bool) -> Sets:
    """Sets of faults by their places ``members (M, s)``; ``early``: whether a load ahead of its time is looked for."""
    members = np.atleast_2d(members)
    rows, s = members[:, :, None], members.shape[1]
    if not s:
        none = np.empty((len(members), 0))
        yes = np.ones(len(members), dtype=bool)
        return Sets(members, none, none, none, np.zeros(len(members)), yes, ~yes)
    diagonal = np.diag(normal.information)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))[members]
    both = scale[:, :, None] * scale[:, None, :]
    information = normal.information[rows, members[:, None, :]] * both + _RIDGE * np.eye(s)
    inverse = np.linalg.inv(information) * both
    gradient = normal.gradient[members]
    sizes = np.einsum("mij,mj->mi", inverse, gradient)
    corrected = np.einsum("mij,mjk,mki->mi", inverse, normal.scatter[rows, members[:, None, :]], inverse, optimize=True)
    white = np.einsum("mii->mi", inverse).copy()
    widening = np.maximum(corrected / np.where(white > 0, white, 1.0), 1.0)
    plausible, worth, largest, one_sided, load = (
        np.array(column)[members]
        for column in zip(*((f.plausible, f.worth, 0.99 * f.largest, f.one_sided, _is_load_time(f)) for f in faults), strict=True)
    )
    determined = (diagonal[members] > 0) & (white * widening < plausible**2) & (np.abs(sizes) > worth) & (np.abs(sizes) < largest)
    possible = (sizes > 0) | ~one_sided
    allowed = _leave_a_clock(faults, members)
    ahead = determined.all(axis=1) & allowed & (possible | load).all(axis=1) & ~possible.all(axis=1)
    sound = determined.all(axis=1) & possible.all(axis=1) & allowed
    gain = 0.5 * np.einsum("mi,mi->m", gradient, sizes)
    return Sets(members, sizes, white, widening, gain, sound, ahead & early)


def best_set(normal: Normal, faults: Sequence[SensorFault], among: Sequence[int], charge: float, most: int, *, early: bool) -> tuple[Sets, int]:
    """The set, and its row, of greatest gain over the colour of what is left less ``charge`` for each fault, each of them needed.

    Arms count by how far such sensors usually are from the centre of gravity, too (``SensorFault.surprise``).

    All sets of up to two faults are compared, and those of three that hold one of the better pairs or are made of the better faults.
    """
    found = [fitted(normal, faults, np.zeros((1, 0), dtype=int), early=early)]
    level = np.array([[i] for i in among], dtype=int).reshape(-1, 1)
    for size in range(1, most + 1):
        if not len(level):
            break
        sets = fitted(normal, faults, level, early=early)
        found.append(sets)
        if size < most:
            level = _larger(sets, among, size)
    return _judged(found, faults, charge)


def needed(normal: Normal, faults: Sequence[SensorFault], members: tuple[int, ...], charge: float) -> tuple[int, ...]:
    """A set less every fault that gains no more than ``charge`` beside the others, over its own colour."""
    while members:
        whole = fitted(normal, faults, np.array([members]), early=False)
        less = [fitted(normal, faults, np.array([[j for j in members if j != i]], dtype=int), early=False).gain[0] for i in members]
        gains = (whole.gain[0] - np.array(less)) / whole.widening[0]
        least = int(np.argmin(gains))
        if gains[least] >= charge:
            break
        members = tuple(i for k, i in enumerate(members) if k != least)
    return members


def _larger(sets: Sets, among: Sequence[int], size: int) -> np.ndarray:
    if size == 1:
        return np.array(list(combinations(among, 2)), dtype=int).reshape(-1, 2)
    order = np.argsort(-np.where(np.isfinite(sets.gain), sets.gain, -np.inf))[: 4 * _PROMISING]
    bases = {tuple(row) for row in sets.members[order].tolist()}
    larger = {tuple(sorted((*base, i))) for base in bases for i in among if i not in base}
    return np.array(sorted(larger), dtype=int).reshape(-1, size + 1)


def _judged(found: Sequence[Sets], faults: Sequence[SensorFault], charge: float) -> tuple[Sets, int]:
    best = max(found, key=lambda sets: float(np.max(np.where(sets.sound, sets.gain, 0.0))))
    widening = float(np.mean(best.widening[int(np.argmax(np.where(best.sound, best.gain, 0.0)))])) if best.members.shape[1] else 1.0
    rare = np.array([fault.rare for fault in faults])
    chosen, least = (found[0], 0), 0.0
    for sets in found[1:]:
        score = charge * sets.members.shape[1] - sets.gain / widening + TIE * (sets.early + rare[sets.members].sum(axis=1))
        score = score + surprises(sets, faults)
        score = np.where(sets.sound | sets.early, score, np.inf)
        row = int(np.argmin(score))
        if score[row] < least:
            chosen, least = (sets, row), float(score[row])
    return chosen


def surprises(sets: Sets, faults: Sequence[SensorFault]) -> np.ndarray:
    """Log likelihood ``(M,)`` that each set loses by what is known of the sizes of its faults."""
    spread = np.array([fault.spread for fault in faults])[sets.members]
    return np.asarray(np.sum(0.5 * sets.sizes**2 / (spread**2 + sets.variances), axis=1))


def _is_load_time(fault: SensorFault) -> bool:
    return fault.channel in LOADS and fault.kind in (DELAY, LAG)


def clocks(channels: Sequence[str]) -> tuple[str, ...]:
    """Channels of which one at least has to be on time: those that the relations tie within a fraction of a second."""
    return tuple(name for name in channels if name not in _SLOW)


def _leave_a_clock(faults: Sequence[SensorFault], members: np.ndarray) -> np.ndarray:
    timed = clocks(tuple(dict.fromkeys(fault.channel for fault in faults if fault.kind == DELAY)))
    late = np.array([[fault.kind in (DELAY, LAG) and fault.channel == name for name in timed] for fault in faults])
    if not len(timed):
        return np.ones(len(members), dtype=bool)
    return ~np.any(late[members], axis=1).all(axis=1)
