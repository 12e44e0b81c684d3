"""Sets of sensor faults in six degrees of freedom, fitted to first order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ident.compatibility.fault_sets import TIE_LOG_LIKELIHOOD
from ident.compatibility.kinematics import DELAY, LAG, SensorFault
from ident.compatibility.six_degrees.fitting import NormalEquations

LOADS = ("nz", "az", "ny", "ay")
_SLOW = ("airspeed", "height", "altitude")  # channels that change too slowly to show time shifts
# added to the unit diagonal of scaled information: nearly equal columns then give a large variance
_RIDGE = 1e-9
_BOUND_SHARE = 0.99  # a size above this share of its bound is at the bound
_MOST_PAIRS = 96  # most pairs to which a third fault is added; more would double the cost


@dataclass(frozen=True, eq=False)
class FittedSets:
    """M sets of s faults each, fitted to first order.

    Attributes
    ----------
    members : ``(M, s)`` positions of the faults.
    sizes : ``(M, s)``.
    white : ``(M, s)`` variances of the sizes for white residuals.
    widening : ``(M, s)`` factors of the variances for coloured residuals.
    gain : ``(M,)`` gain of log likelihood for white residuals.
    sound : ``(M,)`` whether every fault is determined, notable, within its bounds and of a possible
        sign.
    early : ``(M,)`` whether the set would be sound if a load could have a negative delay.
    """

    members: np.ndarray
    sizes: np.ndarray
    white: np.ndarray
    widening: np.ndarray
    gain: np.ndarray
    sound: np.ndarray
    early: np.ndarray

    @property
    def variances(self) -> np.ndarray:
        """``(M, s)`` variances corrected for coloured residuals."""
        return self.white * self.widening


def fit_sets(
    normal: NormalEquations, faults: Sequence[SensorFault], members: np.ndarray, *, early: bool
) -> FittedSets:
    """Return the fits of sets of faults to first order.

    Parameters
    ----------
    members : ``(M, s)`` positions of the faults of each set.
    early : whether sets with a negative delay of a load are marked; else `FittedSets.early` is
        False.
    """
    members = np.atleast_2d(members)
    rows, s = members[:, :, None], members.shape[1]
    if not s:
        empty = np.empty((len(members), 0))
        sound = np.ones(len(members), dtype=bool)
        return FittedSets(members, empty, empty, empty, np.zeros(len(members)), sound, ~sound)
    diagonal = np.diag(normal.information)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))[members]
    scales = scale[:, :, None] * scale[:, None, :]
    information = normal.information[rows, members[:, None, :]] * scales + _RIDGE * np.eye(s)
    inverse = np.linalg.inv(information) * scales
    gradient = normal.gradient[members]
    sizes = np.einsum("mij,mj->mi", inverse, gradient)
    corrected = np.einsum(
        "mij,mjk,mki->mi",
        inverse,
        normal.scatter[rows, members[:, None, :]],
        inverse,
        optimize=True,
    )
    white = np.einsum("mii->mi", inverse).copy()
    widening = np.maximum(corrected / np.where(white > 0, white, 1.0), 1.0)
    plausible = np.array([fault.plausible for fault in faults])[members]
    smallest = np.array([fault.smallest_finding for fault in faults])[members]
    largest = np.array([_BOUND_SHARE * fault.largest for fault in faults])[members]
    one_sided = np.array([fault.one_sided for fault in faults])[members]
    load_time = np.array([_is_load_time(fault) for fault in faults])[members]
    determined = (diagonal[members] > 0) & (white * widening < plausible**2)
    notable = (np.abs(sizes) > smallest) & (np.abs(sizes) < largest)
    possible_sign = (sizes > 0) | ~one_sided
    allowed = (determined & notable).all(axis=1) & _leaves_time_reference(faults, members)
    sound = allowed & possible_sign.all(axis=1)
    early_load = allowed & ~sound & (possible_sign | load_time).all(axis=1)
    gain = 0.5 * np.einsum("mi,mi->m", gradient, sizes)
    return FittedSets(members, sizes, white, widening, gain, sound, early_load & early)


def best_set(
    normal: NormalEquations,
    faults: Sequence[SensorFault],
    candidates: Sequence[int],
    penalty: float,
    most: int,
    *,
    early: bool,
) -> tuple[FittedSets, int]:
    """Return the fits of all compared sets with the same number of faults as the best set, and the
    row of the best set in them.

    The best set has the greatest gain of log likelihood under coloured residuals, less ``penalty``
    for each fault and less the loss by the priors of the sizes (`SensorFault.prior_loss`). All sets
    of up to two faults are compared, and larger sets that contain one of the best smaller sets.

    Parameters
    ----------
    candidates : positions of the faults that a set may contain.
    penalty : gain of log likelihood that is required of each fault.
    most : largest number of faults of a set.
    early : whether a set may have a negative delay of a load.
    """
    fits = [fit_sets(normal, faults, np.zeros((1, 0), dtype=int), early=early)]
    members = np.array([[i] for i in candidates], dtype=int).reshape(-1, 1)
    for size in range(1, most + 1):
        if not len(members):
            break
        sets = fit_sets(normal, faults, members, early=early)
        fits.append(sets)
        if size < most:
            members = _larger_sets(sets, candidates, size)
    return _best_by_score(fits, faults, penalty)


def without_weak_faults(
    normal: NormalEquations, faults: Sequence[SensorFault], members: tuple[int, ...], penalty: float
) -> tuple[int, ...]:
    """Return a set without its weak faults. A fault is weak if it adds less than ``penalty`` to the
    gain of the others, under coloured residuals. The weakest fault is removed first.
    """
    while members:
        whole = fit_sets(normal, faults, np.array([members]), early=False)
        # one fault less in each row
        smaller = np.array([[j for j in members if j != i] for i in members], dtype=int)
        gains_without = [
            fit_sets(normal, faults, row[None], early=False).gain[0] for row in smaller
        ]
        gains = (whole.gain[0] - np.array(gains_without)) / whole.widening[0]
        weakest = int(np.argmin(gains))
        if gains[weakest] >= penalty:
            break
        members = tuple(i for k, i in enumerate(members) if k != weakest)
    return members


def _larger_sets(sets: FittedSets, candidates: Sequence[int], size: int) -> np.ndarray:
    """Return sets of ``size + 1`` faults, ``(M, size + 1)``: all pairs, or the best of ``sets``,
    which have ``size`` faults, with each further fault.
    """
    if size == 1:
        return np.array(list(combinations(candidates, 2)), dtype=int).reshape(-1, 2)
    order = np.argsort(-np.where(np.isfinite(sets.gain), sets.gain, -np.inf))[:_MOST_PAIRS]
    bases = {tuple(row) for row in sets.members[order].tolist()}
    larger = {tuple(sorted((*base, i))) for base in bases for i in candidates if i not in base}
    return np.array(sorted(larger), dtype=int).reshape(-1, size + 1)


def _best_by_score(
    fault_sets: Sequence[FittedSets], faults: Sequence[SensorFault], penalty: float
) -> tuple[FittedSets, int]:
    """Return the fits that contain the set with the lowest score, and its row. The score is the
    penalty of a set minus its gain; the empty set has the score zero.

    All gains are divided by the variance factor (``widening``) of the sound set with the greatest
    gain.
    """
    sound_gains = [np.where(sets.sound, sets.gain, 0.0) for sets in fault_sets]
    best = int(np.argmax([np.max(gains) for gains in sound_gains]))
    widening = 1.0
    if fault_sets[best].members.shape[1]:
        widening = float(np.mean(fault_sets[best].widening[int(np.argmax(sound_gains[best]))]))
    rare = np.array([fault.rare for fault in faults])
    chosen, least = (fault_sets[0], 0), 0.0
    for sets in fault_sets[1:]:
        score = (
            penalty * sets.members.shape[1]
            - sets.gain / widening
            + TIE_LOG_LIKELIHOOD * (sets.early + rare[sets.members].sum(axis=1))
        )
        score = score + prior_losses(sets, faults)
        score = np.where(sets.sound | sets.early, score, np.inf)
        row = int(np.argmin(score))
        if score[row] < least:
            chosen, least = (sets, row), float(score[row])
    return chosen


def prior_losses(sets: FittedSets, faults: Sequence[SensorFault]) -> np.ndarray:
    """Return the loss of log likelihood ``(M,)`` by the priors of the sizes, for each set."""
    spread = np.array([fault.spread for fault in faults])[sets.members]
    return np.asarray(np.sum(0.5 * sets.sizes**2 / (spread**2 + sets.variances), axis=1))


def _is_load_time(fault: SensorFault) -> bool:
    """Return whether the fault is a delay or lag of a load."""
    return fault.channel in LOADS and fault.kind in (DELAY, LAG)


def timed_channels(channels: Sequence[str]) -> tuple[str, ...]:
    """Return the channels that change fast enough to show a delay of a fraction of a second. One of
    them must be on time: it is the time reference.
    """
    return tuple(name for name in channels if name not in _SLOW)


def _leaves_time_reference(faults: Sequence[SensorFault], members: np.ndarray) -> np.ndarray:
    """Return ``(M,)`` True where a set leaves at least one timed channel without delay and lag."""
    delayable = tuple(dict.fromkeys(fault.channel for fault in faults if fault.kind == DELAY))
    timed = timed_channels(delayable)
    late = np.array(
        [
            [fault.kind in (DELAY, LAG) and fault.channel == name for name in timed]
            for fault in faults
        ]
    )
    if not len(timed):
        return np.ones(len(members), dtype=bool)
    return ~np.any(late[members], axis=1).all(axis=1)
