"""The search for sensor faults in six degrees of freedom: sets chosen to first order, fitted in full, and chosen again around the fit."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from ident.compatibility.fault_sets import TIE, charge_of
from ident.compatibility.faults import DRIFT, SensorFault
from ident.compatibility.fitting import Fit
from ident.compatibility.grouping import chance_of, same_lateness, same_trace
from ident.compatibility.instruments import instrumented
from ident.compatibility.result import CompatibilitySettings
from ident.compatibility.signals import Signals
from ident.compatibility.six_degrees.fitting import fit, likelihoods
from ident.compatibility.six_degrees.linear import LEAST_SECANT, Linear, Normal, by_output_error, linear
from ident.compatibility.six_degrees.selection import best_set, fitted, needed

_ROUNDS = 5
NOTHING_LATE: Mapping[tuple[int, int], float] = MappingProxyType({})
SECANT = 0.05  # s, before anything is known of a time
_LONGEST_SECANT = 0.3
_REPLICATION = 1e-3  # p-value below which the records contradict each other
_DEMANDED = 3.0  # standard deviations


@dataclass(frozen=True, eq=False)
class Searched:
    """What a search has found: the ``lines`` around the joint fit of the ``standing`` faults (places in ``lines.faults``), the ``groups`` of
    each with what is lost with it, faults that were ``refused`` since records disagree. ``early``: a load and by how much it is ahead of its
    time, s, where that explains more than any fault. ``common``: places of the faults that all records may share. ``lateness``: what is lost
    with another way for a channel to be late in the place of one that stands, by both places, each fitted in full."""

    lines: Linear
    standing: tuple[int, ...]
    groups: tuple[tuple[tuple[int, float], ...], ...]
    refused: frozenset[int]
    early: tuple[str, float] | None
    widening: float
    output_error: tuple[Normal, ...]
    common: tuple[int, ...]
    lateness: Mapping[tuple[int, int], float] = field(default_factory=dict)


def search(signals: Sequence[Signals], base: Fit, faults: Sequence[SensorFault], settings: CompatibilitySettings) -> Searched:
    """The set of faults that the records ask for, each with its group; beside the faults of ``base``, which are none."""
    # A drift belongs to one record.
    common = [i for i, fault in enumerate(faults) if len(signals) == 1 or fault.kind != DRIFT]
    charge, early = charge_of(settings.false_alarm, len(common)), not instrumented(signals)
    chance = chance_of(settings.false_alarm, len(common))
    refused: set[int] = set()
    while True:
        lines, members, ahead, lateness = _settled(signals, base, faults, [i for i in common if i not in refused], charge, settings.most, early)
        failing = {i for i in members if not _replicates(lines, members, i)}
        if not failing:
            break
        # What looks like it fails with it, and need not be tried one after the other.
        near = {(i, j) for i in failing for j in alike(lines, members, i, chance, common, lateness)}
        refused |= failing | {j for i, j in near if not _replicates(lines, _instead(members, i, j), j)}
    sets = fitted(lines.joint, faults, np.array([members], dtype=int).reshape(1, -1), early=False)
    widening = float(np.mean(sets.widening)) if members else 1.0
    among = [i for i in common if i not in refused]
    groups = tuple(_group(lines, members, i, chance, widening, among, lateness) for i in members)
    other = tuple(by_output_error(lines, r) for r in range(len(signals)))
    return Searched(lines, members, groups, frozenset(refused), ahead, widening, other, tuple(common), lateness)


def _settled(
    signals: Sequence[Signals], base: Fit, faults: Sequence[SensorFault], among: Sequence[int], charge: float, most: int, early: bool
) -> tuple[Linear, tuple[int, ...], tuple[str, float] | None, Mapping[tuple[int, int], float]]:
    """Sets chosen and fitted in turn until the same one comes again, and once more from another way to be late where that is likelier; with what is
    lost with each such way (``_late_instead``)."""
    lines, members, ahead = _in_turn(signals, base, (), faults, among, charge, most, early)
    likeliest, lateness = _late_instead(signals, lines, members, among)
    if likeliest[1] != members:
        lines, members, ahead = _in_turn(signals, *likeliest, faults, among, charge, most, early)
        _, lateness = _late_instead(signals, lines, members, among)
    return lines, members, ahead, lateness


def _in_turn(
    signals: Sequence[Signals],
    found: Fit,
    members: tuple[int, ...],
    faults: Sequence[SensorFault],
    among: Sequence[int],
    charge: float,
    most: int,
    early: bool,
) -> tuple[Linear, tuple[int, ...], tuple[str, float] | None]:
    """Sets chosen and fitted in turn, from a fit of the faults ``members`` on."""
    secants, ahead = np.full(len(faults), SECANT), None
    secants[list(members)] = [_secant(size) for size in found.sizes.tolist()[: len(members)]]
    for turn in range(_ROUNDS):
        lines = linear(found, faults, secants)
        normal = lines.joint
        if not turn and not members:
            # What a fault leaves of the record is not the colour of what is left with it.
            normal = replace(normal, scatter=normal.information)
        sets, row = best_set(normal, faults, among, charge, most, early=early)
        chosen, ahead = tuple(int(i) for i in sets.members[row]), None
        if sets.early[row]:
            late = [k for k, i in enumerate(chosen) if sets.sizes[row, k] < 0 and faults[i].one_sided]
            ahead = (faults[chosen[late[0]]].channel, float(sets.sizes[row, late[0]]))
            chosen = tuple(i for k, i in enumerate(chosen) if k not in late)
        chosen = needed(normal, faults, chosen, charge)
        if set(chosen) == set(members) and (turn > 1 or not members):
            break
        if set(chosen) != set(members):
            found = fit(signals, [faults[i] for i in chosen], found)
        members = chosen
        secants = _secants(lines, chosen)
        secants[list(chosen)] = [_secant(size) for size in found.sizes.tolist()]
    else:
        lines = linear(found, faults, secants)
    return lines, members, ahead


def _secant(size: float) -> float:
    return size if abs(size) > 1e-3 else SECANT


def _late_instead(
    signals: Sequence[Signals], lines: Linear, members: Sequence[int], among: Sequence[int]
) -> tuple[tuple[Fit, tuple[int, ...]], dict[tuple[int, int], float]]:
    """The likeliest of a set and of those with another way to be late, or the arm of the same trace, in the place of one, and what is lost with
    each of these: by the two places. What is known of sizes beforehand counts.

    To first order they would be compared under the noise of the one that stands, which has taken for noise what it does not explain, and as if
    both acted: a late reading of what an arm adds is no small thing.
    """
    found, faults = lines.found, lines.faults
    places = [(place, i, j) for place, i in enumerate(members) for j in among if j not in members]
    pairs = [(place, j) for place, i, j in places if same_lateness(faults[i], faults[j]) or same_trace(faults[i], faults[j])]
    sets = [tuple(members), *((*members[:place], j, *members[place + 1 :]) for place, j in pairs)]
    fits = [found, *(fit(signals, [faults[k] for k in chosen], found) for chosen in sets[1:])]
    left = likelihoods(fits) if pairs else np.zeros(1)
    widening = float(np.mean(fitted(lines.joint, faults, np.array([list(members)]), early=False).widening)) if pairs else 1.0
    known = [sum(float(fault.surprise(size, 0.0)) for fault, size in zip(each.faults, each.sizes.tolist(), strict=True)) for each in fits]
    best = int(np.argmin(left + widening * np.array(known)))
    return (fits[best], sets[best]), {(members[place], j): float(lost) for (place, j), lost in zip(pairs, left[1:] - left[0], strict=True)}


def _secants(lines: Linear, members: Sequence[int]) -> np.ndarray:
    """The size of each time as it stands, or as it would in the best place of a set."""
    out, best = np.full(len(lines.faults), SECANT), np.full(len(lines.faults), -math.inf)
    for place in members or (None,):
        rest = [i for i in members if i != place]
        rows = np.array([[*rest, i] for i in range(len(lines.faults)) if i not in rest])
        sets = fitted(lines.joint, lines.faults, rows, early=False)
        for row, gain, size in zip(rows[:, -1], sets.gain, sets.sizes[:, -1], strict=True):
            if gain > best[row]:
                best[row], out[row] = gain, size
    return np.copysign(np.clip(np.abs(out), LEAST_SECANT, _LONGEST_SECANT), out)


def _replicates(lines: Linear, members: Sequence[int], i: int) -> bool:
    """Whether the records by themselves agree on a fault, the others as they stand, and demand it together."""
    from scipy.special import chdtrc

    if len(lines.smoother) < 2:
        return True
    values, weights = _alone(lines, members, i)
    told = weights > lines.faults[i].plausible ** -2
    if np.count_nonzero(told) < 2:
        return False
    v, w = values[told], weights[told]
    mean = float(np.sum(w * v) / np.sum(w))
    joint = fitted(lines.joint, lines.faults, np.array([members]), early=False).sizes[0, list(members).index(i)]
    agree = float(chdtrc(len(v) - 1.0, float(np.sum(w * (v - mean) ** 2)))) > _REPLICATION
    return agree and mean * math.copysign(1.0, joint) > _DEMANDED / math.sqrt(float(np.sum(w)))


def _alone(lines: Linear, members: Sequence[int], i: int) -> tuple[np.ndarray, np.ndarray]:
    """A fault by each record, the others at their joint sizes: values and inverse variances."""
    sizes = fitted(lines.joint, lines.faults, np.array([members]), early=False).sizes[0]
    values, weights = [], []
    for normal in lines.smoother:
        own = normal.information[i, i]
        others = sum(normal.information[i, j] * size for j, size in zip(members, sizes.tolist(), strict=True) if j != i)
        wide = max(normal.scatter[i, i] / own, 1.0) if own > 0 else 1.0
        values.append((normal.gradient[i] - others) / own if own > 0 else 0.0)
        weights.append(own / wide)
    return np.array(values), np.array(weights)


def _group(
    lines: Linear, members: Sequence[int], i: int, chance: float, widening: float, among: Sequence[int], lateness: Mapping[tuple[int, int], float]
) -> tuple[tuple[int, float], ...]:
    """A fault that stands and what does as well in its place: places and losses of log likelihood."""
    near = alike(lines, members, i, chance * widening, among, lateness)
    return ((i, 0.0), *((j, lost / widening) for j, lost in near.items() if _replicates(lines, _instead(members, i, j), j)))


def alike(
    lines: Linear, members: Sequence[int], i: int, chance: float, among: Sequence[int], lateness: Mapping[tuple[int, int], float] = NOTHING_LATE
) -> dict[int, float]:
    """Sound faults that lose no more than ``chance`` of log likelihood in the place of one that stands, the nearest first; ``lateness``: what is
    known of such losses by fits in full."""
    rivals = [j for j in among if j not in members]
    sets = fitted(lines.joint, lines.faults, np.array([_instead(members, i, j) for j in rivals]).reshape(len(rivals), -1), early=False)
    own = fitted(lines.joint, lines.faults, np.array([_instead(members, i, i)]), early=False)
    losses = own.gain[0] - sets.gain + TIE * np.array([lines.faults[j].rare for j in rivals])
    full = {j: lateness[i, j] for j in rivals if (i, j) in lateness}
    # Of two arms of one trace the records may prefer the less common one.
    least = [-np.inf if same_trace(lines.faults[i], lines.faults[j]) else 0.0 for j in rivals]
    losses = np.array([max(full.get(j, lost), low if j in full else lost) for j, lost, low in zip(rivals, losses.tolist(), least, strict=True)])
    return {rivals[k]: float(losses[k]) for k in np.argsort(losses) if losses[k] <= chance and sets.sound[k]}


def _instead(members: Sequence[int], i: int, j: int) -> tuple[int, ...]:
    """The set with j, which comes last, in the place of i."""
    return (*(k for k in members if k != i), j)
