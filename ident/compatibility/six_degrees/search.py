"""The search for sensor faults in six degrees of freedom: sets chosen to first order, fitted in full, and chosen again around the fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.compatibility.fault_sets import TIE, charge_of
from ident.compatibility.faults import DRIFT, SensorFault
from ident.compatibility.fitting import Fit
from ident.compatibility.grouping import chance_of
from ident.compatibility.instruments import instrumented
from ident.compatibility.result import CompatibilitySettings
from ident.compatibility.signals import Signals
from ident.compatibility.six_degrees.fitting import fit
from ident.compatibility.six_degrees.linear import LEAST_SECANT, Linear, Normal, by_output_error, linear
from ident.compatibility.six_degrees.selection import best_set, fitted, needed

_ROUNDS = 5
SECANT = 0.05  # s, before anything is known of a time
_LONGEST_SECANT = 0.3
_REPLICATION = 1e-3  # p-value below which the records contradict each other
_DEMANDED = 3.0  # standard deviations


@dataclass(frozen=True, eq=False)
class Searched:
    """What a search has found: the ``lines`` around the joint fit of the ``standing`` faults (places in ``lines.faults``), the ``groups`` of
    each with what is lost with it, faults that were ``refused`` since records disagree. ``early``: a load and by how much it is ahead of its
    time, s, where that explains more than any fault. ``common``: places of the faults that all records may share."""

    lines: Linear
    standing: tuple[int, ...]
    groups: tuple[tuple[tuple[int, float], ...], ...]
    refused: frozenset[int]
    early: tuple[str, float] | None
    widening: float
    output_error: tuple[Normal, ...]
    common: tuple[int, ...]


def search(signals: Sequence[Signals], base: Fit, faults: Sequence[SensorFault], settings: CompatibilitySettings) -> Searched:
    """The set of faults that the records ask for, each with its group; beside the faults of ``base``, which are none."""
    # A drift belongs to one record.
    common = [i for i, fault in enumerate(faults) if len(signals) == 1 or fault.kind != DRIFT]
    charge, early = charge_of(settings.false_alarm, len(common)), not instrumented(signals)
    chance = chance_of(settings.false_alarm, len(common))
    refused: set[int] = set()
    while True:
        lines, members, ahead = _settled(signals, base, faults, [i for i in common if i not in refused], charge, settings.most, early)
        failing = {i for i in members if not _replicates(lines, members, i)}
        if not failing:
            break
        # What looks like it fails with it, and need not be tried one after the other.
        near = {(i, j) for i in failing for j in alike(lines, members, i, chance, common)}
        refused |= failing | {j for i, j in near if not _replicates(lines, _instead(members, i, j), j)}
    sets = fitted(lines.joint, faults, np.array([members], dtype=int).reshape(1, -1), early=False)
    widening = float(np.mean(sets.widening)) if members else 1.0
    among = [i for i in common if i not in refused]
    groups = tuple(_group(lines, members, i, chance, widening, among) for i in members)
    other = tuple(by_output_error(lines, r) for r in range(len(signals)))
    return Searched(lines, members, groups, frozenset(refused), ahead, widening, other, tuple(common))


def _settled(
    signals: Sequence[Signals], base: Fit, faults: Sequence[SensorFault], among: Sequence[int], charge: float, most: int, early: bool
) -> tuple[Linear, tuple[int, ...], tuple[str, float] | None]:
    """Sets chosen and fitted in turn until the same one comes again."""
    found, secants = base, np.full(len(faults), SECANT)
    members: tuple[int, ...] = ()
    ahead = None
    for turn in range(_ROUNDS):
        lines = linear(found, faults, secants)
        normal = lines.joint
        if not turn:
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
        secants[list(chosen)] = [size if abs(size) > 1e-3 else SECANT for size in found.sizes.tolist()]
    else:
        lines = linear(found, faults, secants)
    return lines, members, ahead


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


def _group(lines: Linear, members: Sequence[int], i: int, chance: float, widening: float, among: Sequence[int]) -> tuple[tuple[int, float], ...]:
    """A fault that stands and what does as well in its place: places and losses of log likelihood."""
    near = alike(lines, members, i, chance * widening, among)
    return ((i, 0.0), *((j, lost / widening) for j, lost in near.items() if _replicates(lines, _instead(members, i, j), j)))


def alike(lines: Linear, members: Sequence[int], i: int, chance: float, among: Sequence[int]) -> dict[int, float]:
    """Sound faults that lose no more than ``chance`` of log likelihood in the place of one that stands, the nearest first."""
    rivals = [j for j in among if j not in members]
    sets = fitted(lines.joint, lines.faults, np.array([_instead(members, i, j) for j in rivals]).reshape(len(rivals), -1), early=False)
    own = fitted(lines.joint, lines.faults, np.array([_instead(members, i, i)]), early=False)
    losses = own.gain[0] - sets.gain + TIE * np.array([lines.faults[j].rare for j in rivals])
    return {rivals[k]: float(losses[k]) for k in np.argsort(losses) if losses[k] <= chance and sets.sound[k]}


def _instead(members: Sequence[int], i: int, j: int) -> tuple[int, ...]:
    """The set with j, which comes last, in the place of i."""
    return (*(k for k in members if k != i), j)
