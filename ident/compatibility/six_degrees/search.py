"""Search for sensor faults in six degrees of freedom."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from types import MappingProxyType

import numpy as np

from ident.compatibility.fault_sets import (
    TIE_LOG_LIKELIHOOD,
    charge_of,
    confusable_loss,
    same_lateness,
    same_trace,
)
from ident.compatibility.fitting import KinematicFit
from ident.compatibility.instruments import instrumented
from ident.compatibility.kinematics import DELAY, DRIFT, LAG, SensorFault
from ident.compatibility.signals import KinematicSignals
from ident.compatibility.six_degrees.fitting import (
    LEAST_SECANT,
    Linear,
    NormalEquations,
    by_output_error,
    fit,
    likelihoods,
    linear,
)
from ident.compatibility.trials import (
    CONTRADICTION_P_VALUE,
    LEAST_FAULT_SIGMAS,
    CompatibilitySettings,
)

# ---- Sets of faults to first order

LOADS = ("nz", "az", "ny", "ay")
_SLOW = ("airspeed", "height", "altitude")  # change too slowly to show time shifts
# ridge relative to the scaled information: nearly equal columns then give a large variance
_RIDGE_SHARE = 1e-9
# most faults in sets of three besides the best pairs; more would double the cost
_MOST_FAULTS_IN_TRIPLES = 24


@dataclass(frozen=True, eq=False)
class Sets:
    """M sets of s faults each fitted to first order: ``members (M, s)``; ``sizes``, ``white``
    variances and ``widening`` of these ``(M, s)``; ``gain (M,)`` of log likelihood. ``sound``: each
    fault is determined, notable and possible; ``early``: the same except for a load with a negative
    delay.
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
        """Variances corrected for coloured residuals ``(M, s)``."""
        return self.white * self.widening


def fitted(
    normal: NormalEquations, faults: Sequence[SensorFault], members: np.ndarray, *, early: bool
) -> Sets:
    """Fit sets of faults at positions ``members (M, s)``; ``early``: whether a negative delay of a
    load is estimated.
    """
    members = np.atleast_2d(members)
    rows, s = members[:, :, None], members.shape[1]
    if not s:
        none = np.empty((len(members), 0))
        yes = np.ones(len(members), dtype=bool)
        return Sets(members, none, none, none, np.zeros(len(members)), yes, ~yes)
    diagonal = np.diag(normal.information)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))[members]
    both = scale[:, :, None] * scale[:, None, :]
    information = normal.information[rows, members[:, None, :]] * both + _RIDGE_SHARE * np.eye(s)
    inverse = np.linalg.inv(information) * both
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
    plausible, smallest, largest, one_sided, load = (
        np.array(column)[members]
        for column in zip(
            *(
                (f.plausible, f.smallest_finding, 0.99 * f.largest, f.one_sided, _is_load_time(f))
                for f in faults
            ),
            strict=True,
        )
    )
    determined = (
        (diagonal[members] > 0)
        & (white * widening < plausible**2)
        & (np.abs(sizes) > smallest)
        & (np.abs(sizes) < largest)
    )
    possible = (sizes > 0) | ~one_sided
    allowed = _leave_a_clock(faults, members)
    ahead = determined.all(axis=1) & allowed & (possible | load).all(axis=1) & ~possible.all(axis=1)
    sound = determined.all(axis=1) & possible.all(axis=1) & allowed
    gain = 0.5 * np.einsum("mi,mi->m", gradient, sizes)
    return Sets(members, sizes, white, widening, gain, sound, ahead & early)


def best_set(
    normal: NormalEquations,
    faults: Sequence[SensorFault],
    among: Sequence[int],
    charge: float,
    most: int,
    *,
    early: bool,
) -> tuple[Sets, int]:
    """Return the set, and its row, of greatest gain under coloured residuals, less ``charge`` for
    each fault; each fault is needed.

    Arms also have a prior of usual distances from the centre of gravity (``SensorFault.surprise``).

    All sets of up to two faults are compared, and those of three with one of the best pairs or of
    the best faults.
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
    return _assessed(found, faults, charge)


def needed(
    normal: NormalEquations, faults: Sequence[SensorFault], members: tuple[int, ...], charge: float
) -> tuple[int, ...]:
    """Return a set without the faults whose gain with the others, under coloured residuals, is at
    most ``charge``.
    """
    while members:
        whole = fitted(normal, faults, np.array([members]), early=False)
        less = [
            fitted(
                normal, faults, np.array([[j for j in members if j != i]], dtype=int), early=False
            ).gain[0]
            for i in members
        ]
        gains = (whole.gain[0] - np.array(less)) / whole.widening[0]
        least = int(np.argmin(gains))
        if gains[least] >= charge:
            break
        members = tuple(i for k, i in enumerate(members) if k != least)
    return members


def _larger(sets: Sets, among: Sequence[int], size: int) -> np.ndarray:
    if size == 1:
        return np.array(list(combinations(among, 2)), dtype=int).reshape(-1, 2)
    order = np.argsort(-np.where(np.isfinite(sets.gain), sets.gain, -np.inf))[
        : 4 * _MOST_FAULTS_IN_TRIPLES
    ]
    bases = {tuple(row) for row in sets.members[order].tolist()}
    larger = {tuple(sorted((*base, i))) for base in bases for i in among if i not in base}
    return np.array(sorted(larger), dtype=int).reshape(-1, size + 1)


def _assessed(
    fault_sets: Sequence[Sets], faults: Sequence[SensorFault], charge: float
) -> tuple[Sets, int]:
    best = max(fault_sets, key=lambda sets: float(np.max(np.where(sets.sound, sets.gain, 0.0))))
    widening = (
        float(np.mean(best.widening[int(np.argmax(np.where(best.sound, best.gain, 0.0)))]))
        if best.members.shape[1]
        else 1.0
    )
    rare = np.array([fault.rare for fault in faults])
    chosen, least = (fault_sets[0], 0), 0.0
    for sets in fault_sets[1:]:
        score = (
            charge * sets.members.shape[1]
            - sets.gain / widening
            + TIE_LOG_LIKELIHOOD * (sets.early + rare[sets.members].sum(axis=1))
        )
        score = score + surprises(sets, faults)
        score = np.where(sets.sound | sets.early, score, np.inf)
        row = int(np.argmin(score))
        if score[row] < least:
            chosen, least = (sets, row), float(score[row])
    return chosen


def surprises(sets: Sets, faults: Sequence[SensorFault]) -> np.ndarray:
    """Log likelihood ``(M,)`` that each set loses by the priors of its faults' sizes."""
    spread = np.array([fault.spread for fault in faults])[sets.members]
    return np.asarray(np.sum(0.5 * sets.sizes**2 / (spread**2 + sets.variances), axis=1))


def _is_load_time(fault: SensorFault) -> bool:
    return fault.channel in LOADS and fault.kind in (DELAY, LAG)


def clocks(channels: Sequence[str]) -> tuple[str, ...]:
    """Return the channels with comparable times, related within a fraction of a second; at least
    one must have no delay.
    """
    return tuple(name for name in channels if name not in _SLOW)


def _leave_a_clock(faults: Sequence[SensorFault], members: np.ndarray) -> np.ndarray:
    timed = clocks(tuple(dict.fromkeys(fault.channel for fault in faults if fault.kind == DELAY)))
    late = np.array(
        [
            [fault.kind in (DELAY, LAG) and fault.channel == name for name in timed]
            for fault in faults
        ]
    )
    if not len(timed):
        return np.ones(len(members), dtype=bool)
    return ~np.any(late[members], axis=1).all(axis=1)


# ---- The search for sensor faults in six degrees of freedom

_MOST_ROUNDS = 5
NOTHING_LATE: Mapping[tuple[int, int], float] = MappingProxyType({})
SECANT_STEP = 0.05  # s, step for a time shift that is not known yet
_LONGEST_SECANT = 0.3


@dataclass(frozen=True, eq=False)
class SixDegreeSearch:
    """Result of a search: the linearisation ``lines`` at the joint fit of the accepted faults
    (``standing``: positions in ``lines.faults``). ``groups``: the alternatives of each, with their
    losses of log likelihood. ``refused``: faults on which records disagree. ``early``: a load and
    the time, s, by which it is early, if that explains more than any fault. ``common``: positions
    of the faults that all records may share. ``lateness``: loss with a fault of the same lateness
    or trace in place of an accepted one, by both positions, from full fits.
    """

    lines: Linear
    standing: tuple[int, ...]
    groups: tuple[tuple[tuple[int, float], ...], ...]
    refused: frozenset[int]
    early: tuple[str, float] | None
    widening: float
    output_error: tuple[NormalEquations, ...]
    common: tuple[int, ...]
    lateness: Mapping[tuple[int, int], float] = field(default_factory=dict)


def search(
    signals: Sequence[KinematicSignals],
    base: KinematicFit,
    faults: Sequence[SensorFault],
    settings: CompatibilitySettings,
) -> SixDegreeSearch:
    """Find the set of faults that the records require, each with its alternatives, in addition to
    the faults of ``base``.
    """
    # A drift belongs to one record.
    common = [i for i, fault in enumerate(faults) if len(signals) == 1 or fault.kind != DRIFT]
    charge, early = charge_of(settings.false_alarm, len(common)), not instrumented(signals)
    chance = confusable_loss(settings.false_alarm, len(common))
    refused: set[int] = set()
    while True:
        lines, members, ahead, lateness = _converged_sets(
            signals,
            base,
            faults,
            [i for i in common if i not in refused],
            charge,
            settings.most,
            early,
        )
        failing = {i for i in members if not _replicates(lines, members, i)}
        if not failing:
            break
        # Confusable faults fail together and are not tried one by one.
        near = {(i, j) for i in failing for j in alike(lines, members, i, chance, common, lateness)}
        refused |= failing | {
            j for i, j in near if not _replicates(lines, _with_replacement(members, i, j), j)
        }
    sets = fitted(lines.joint, faults, np.array([members], dtype=int).reshape(1, -1), early=False)
    widening = float(np.mean(sets.widening)) if members else 1.0
    among = [i for i in common if i not in refused]
    groups = tuple(_group(lines, members, i, chance, widening, among, lateness) for i in members)
    other = tuple(by_output_error(lines, r) for r in range(len(signals)))
    return SixDegreeSearch(
        lines, members, groups, frozenset(refused), ahead, widening, other, tuple(common), lateness
    )


def _converged_sets(
    signals: Sequence[KinematicSignals],
    base: KinematicFit,
    faults: Sequence[SensorFault],
    among: Sequence[int],
    charge: float,
    most: int,
    early: bool,
) -> tuple[Linear, tuple[int, ...], tuple[str, float] | None, Mapping[tuple[int, int], float]]:
    """Choose and fit sets in turn until one repeats, then exchange kinds of delay where that is
    likelier; return the sets with the losses of ``_best_delay_exchange``.
    """
    lines, members, ahead = _choose_and_fit(signals, base, (), faults, among, charge, most, early)
    likeliest, lateness = _best_delay_exchange(signals, lines, members, among)
    if likeliest[1] != members:
        lines, members, ahead = _choose_and_fit(
            signals, *likeliest, faults, among, charge, most, early
        )
        _, lateness = _best_delay_exchange(signals, lines, members, among)
    return lines, members, ahead, lateness


def _choose_and_fit(
    signals: Sequence[KinematicSignals],
    kinematic_fit: KinematicFit,
    members: tuple[int, ...],
    faults: Sequence[SensorFault],
    among: Sequence[int],
    charge: float,
    most: int,
    early: bool,
) -> tuple[Linear, tuple[int, ...], tuple[str, float] | None]:
    """Choose and fit sets in turn, starting from a fit of the faults ``members``."""
    secants, ahead = np.full(len(faults), SECANT_STEP), None
    secants[list(members)] = [
        _secant(size) for size in kinematic_fit.sizes.tolist()[: len(members)]
    ]
    for turn in range(_MOST_ROUNDS):
        lines = linear(kinematic_fit, faults, secants)
        normal = lines.joint
        if not turn and not members:
            # The residual without a fault does not have the noise colour of the one with it.
            normal = replace(normal, scatter=normal.information)
        sets, row = best_set(normal, faults, among, charge, most, early=early)
        chosen, ahead = tuple(int(i) for i in sets.members[row]), None
        if sets.early[row]:
            late = [
                k for k, i in enumerate(chosen) if sets.sizes[row, k] < 0 and faults[i].one_sided
            ]
            ahead = (faults[chosen[late[0]]].channel, float(sets.sizes[row, late[0]]))
            chosen = tuple(i for k, i in enumerate(chosen) if k not in late)
        chosen = needed(normal, faults, chosen, charge)
        if set(chosen) == set(members) and (turn > 1 or not members):
            break
        if set(chosen) != set(members):
            kinematic_fit = fit(signals, [faults[i] for i in chosen], kinematic_fit)
        members = chosen
        secants = _secants(lines, chosen)
        secants[list(chosen)] = [_secant(size) for size in kinematic_fit.sizes.tolist()]
    else:
        lines = linear(kinematic_fit, faults, secants)
    return lines, members, ahead


def _secant(size: float) -> float:
    return size if abs(size) > 1e-3 else SECANT_STEP


def _best_delay_exchange(
    signals: Sequence[KinematicSignals], lines: Linear, members: Sequence[int], among: Sequence[int]
) -> tuple[tuple[KinematicFit, tuple[int, ...]], dict[tuple[int, int], float]]:
    """Return the likeliest of a set and its variants with one fault replaced by another one of the
    same lateness or trace, and the loss of each variant by both positions. The likeliest is chosen
    with the priors of sizes, the losses are those of the data alone.

    Full fits are needed: a first-order comparison uses the noise of the accepted variant, which
    includes its own misfit, and neglects the delay of the arm's contribution.
    """
    kinematic_fit, faults = lines.fit, lines.faults
    places = [(place, i, j) for place, i in enumerate(members) for j in among if j not in members]
    pairs = [
        (place, j)
        for place, i, j in places
        if same_lateness(faults[i], faults[j]) or same_trace(faults[i], faults[j])
    ]
    sets = [tuple(members), *((*members[:place], j, *members[place + 1 :]) for place, j in pairs)]
    fits = [
        kinematic_fit,
        *(fit(signals, [faults[k] for k in chosen], kinematic_fit) for chosen in sets[1:]),
    ]
    left = likelihoods(fits) if pairs else np.zeros(1)
    widening = (
        float(np.mean(fitted(lines.joint, faults, np.array([list(members)]), early=False).widening))
        if pairs
        else 1.0
    )
    known = [
        sum(
            float(fault.surprise(size, 0.0))
            for fault, size in zip(each.faults, each.sizes.tolist(), strict=True)
        )
        for each in fits
    ]
    best = int(np.argmin(left + widening * np.array(known)))
    return (fits[best], sets[best]), {
        (members[place], j): float(lost)
        for (place, j), lost in zip(pairs, left[1:] - left[0], strict=True)
    }


def _secants(lines: Linear, members: Sequence[int]) -> np.ndarray:
    """Return the size of each time shift in the set, or in the best variant of it."""
    out, best = np.full(len(lines.faults), SECANT_STEP), np.full(len(lines.faults), -math.inf)
    for place in members or (None,):
        rest = [i for i in members if i != place]
        rows = np.array([[*rest, i] for i in range(len(lines.faults)) if i not in rest])
        sets = fitted(lines.joint, lines.faults, rows, early=False)
        for row, gain, size in zip(rows[:, -1], sets.gain, sets.sizes[:, -1], strict=True):
            if gain > best[row]:
                best[row], out[row] = gain, size
    return np.copysign(np.clip(np.abs(out), LEAST_SECANT, _LONGEST_SECANT), out)


def _replicates(lines: Linear, members: Sequence[int], i: int) -> bool:
    """Return whether single records agree on a fault, the others fixed, and require it together."""
    from scipy.special import chdtrc

    if len(lines.smoother) < 2:
        return True
    values, weights = _values_by_record(lines, members, i)
    determined = weights > lines.faults[i].plausible ** -2
    if np.count_nonzero(determined) < 2:
        return False
    v, w = values[determined], weights[determined]
    mean = float(np.sum(w * v) / np.sum(w))
    joint = fitted(lines.joint, lines.faults, np.array([members]), early=False).sizes[
        0, list(members).index(i)
    ]
    agree = float(chdtrc(len(v) - 1.0, float(np.sum(w * (v - mean) ** 2)))) > CONTRADICTION_P_VALUE
    return agree and mean * math.copysign(1.0, joint) > LEAST_FAULT_SIGMAS / math.sqrt(
        float(np.sum(w))
    )


def _values_by_record(
    lines: Linear, members: Sequence[int], i: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return a fault's value and inverse variance in each record, with the others at their joint
    sizes.
    """
    sizes = fitted(lines.joint, lines.faults, np.array([members]), early=False).sizes[0]
    values, weights = [], []
    for normal in lines.smoother:
        own = normal.information[i, i]
        others = sum(
            normal.information[i, j] * size
            for j, size in zip(members, sizes.tolist(), strict=True)
            if j != i
        )
        wide = max(normal.scatter[i, i] / own, 1.0) if own > 0 else 1.0
        values.append((normal.gradient[i] - others) / own if own > 0 else 0.0)
        weights.append(own / wide)
    return np.array(values), np.array(weights)


def _group(
    lines: Linear,
    members: Sequence[int],
    i: int,
    chance: float,
    widening: float,
    among: Sequence[int],
    lateness: Mapping[tuple[int, int], float],
) -> tuple[tuple[int, float], ...]:
    """Return an accepted fault and its alternatives: positions and losses of log likelihood."""
    near = alike(lines, members, i, chance * widening, among, lateness)
    return (
        (i, 0.0),
        *(
            (j, lost / widening)
            for j, lost in near.items()
            if _replicates(lines, _with_replacement(members, i, j), j)
        ),
    )


def alike(
    lines: Linear,
    members: Sequence[int],
    i: int,
    chance: float,
    among: Sequence[int],
    lateness: Mapping[tuple[int, int], float] = NOTHING_LATE,
) -> dict[int, float]:
    """Sound faults that lose no more than ``chance`` of log likelihood in place of an accepted one,
    the nearest first; ``lateness``: such losses from full fits.
    """
    rivals = [j for j in among if j not in members]
    sets = fitted(
        lines.joint,
        lines.faults,
        np.array([_with_replacement(members, i, j) for j in rivals]).reshape(len(rivals), -1),
        early=False,
    )
    own = fitted(
        lines.joint, lines.faults, np.array([_with_replacement(members, i, i)]), early=False
    )
    losses = (
        own.gain[0]
        - sets.gain
        + TIE_LOG_LIKELIHOOD * np.array([lines.faults[j].rare for j in rivals])
    )
    full = {j: lateness[i, j] for j in rivals if (i, j) in lateness}
    # Of two faults with equal effect, the data may prefer the less common one.
    least = [-np.inf if same_trace(lines.faults[i], lines.faults[j]) else 0.0 for j in rivals]
    losses = np.array(
        [
            max(full.get(j, lost), low if j in full else lost)
            for j, lost, low in zip(rivals, losses.tolist(), least, strict=True)
        ]
    )
    return {
        rivals[k]: float(losses[k])
        for k in np.argsort(losses)
        if losses[k] <= chance and sets.sound[k]
    }


def _with_replacement(members: Sequence[int], i: int, j: int) -> tuple[int, ...]:
    """Return the set with i replaced by j, which comes last."""
    return (*(k for k in members if k != i), j)
