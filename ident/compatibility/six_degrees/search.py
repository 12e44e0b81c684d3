"""The search for sensor faults in six degrees of freedom: sets chosen to first order, fitted in full, and chosen again around the fit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.compatibility.estimates import difference_in_sigmas
from ident.compatibility.fault_sets import TIE, charge_of
from ident.compatibility.faults import DELAY, DRIFT, LAG, SensorFault
from ident.compatibility.fitting import Fit
from ident.compatibility.grouping import chance_of, same_lateness
from ident.compatibility.instruments import instrumented
from ident.compatibility.result import CompatibilitySettings, Quantity, SensorEstimate, SensorFinding
from ident.compatibility.signals import Signals
from ident.compatibility.six_degrees.fitting import fit
from ident.compatibility.six_degrees.linear import LEAST_SECANT, Linear, Normal, added, by_output_error, linear
from ident.compatibility.six_degrees.selection import best_set, fitted
from ident.compatibility.trials import p_value

_ROUNDS = 5
_SECANT = 0.05  # s, before anything is known of a time
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
    refused: set[int] = set()
    while True:
        lines, members, ahead = _settled(signals, base, faults, [i for i in common if i not in refused], charge, settings.most, early)
        failing = {i for i in members if not _replicates(lines, members, i)}
        if not failing:
            break
        refused |= failing
    sets = fitted(lines.joint, faults, np.array([members], dtype=int).reshape(1, -1), early=False)
    widening = float(np.mean(sets.widening)) if members else 1.0
    chance = chance_of(settings.false_alarm, len(common))
    among = [i for i in common if i not in refused]
    groups = tuple(_group(lines, members, i, chance, widening, among) for i in members)
    other = tuple(by_output_error(lines, r) for r in range(len(signals)))
    return Searched(lines, members, groups, frozenset(refused), ahead, widening, other, tuple(common))


def _settled(
    signals: Sequence[Signals], base: Fit, faults: Sequence[SensorFault], among: Sequence[int], charge: float, most: int, early: bool
) -> tuple[Linear, tuple[int, ...], tuple[str, float] | None]:
    """Sets chosen and fitted in turn until the same one comes again."""
    found, secants = base, np.full(len(faults), _SECANT)
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
        if set(chosen) == set(members) and (turn > 1 or not members):
            break
        if set(chosen) != set(members):
            found = fit(signals, [faults[i] for i in chosen], found)
        members = chosen
        secants = _secants(lines, chosen)
        secants[list(chosen)] = [size if abs(size) > 1e-3 else _SECANT for size in found.sizes.tolist()]
    return lines, members, ahead


def _secants(lines: Linear, members: Sequence[int]) -> np.ndarray:
    """The size of each time as it stands, or as it would in the best place of a set."""
    out, best = np.full(len(lines.faults), _SECANT), np.full(len(lines.faults), -math.inf)
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
    rest = [j for j in members if j != i]
    rivals = [j for j in among if j not in members]
    sets = fitted(lines.joint, lines.faults, np.array([[*rest, j] for j in rivals]).reshape(len(rivals), -1), early=False)
    own = fitted(lines.joint, lines.faults, np.array([[*rest, i]]), early=False)
    losses = (own.gain[0] - sets.gain) / widening + TIE * np.array([lines.faults[j].rare for j in rivals])
    order = [k for k in np.argsort(losses) if losses[k] <= chance and sets.sound[k]]
    return ((i, 0.0), *((rivals[k], float(losses[k])) for k in order if _replicates(lines, (*rest, rivals[k]), rivals[k])))


def estimates_and_findings(found: Searched) -> tuple[tuple[SensorEstimate, ...], tuple[SensorFinding, ...]]:
    """Every fault by both methods, and the findings, those that stand first."""
    lines, faults = found.lines, found.lines.faults
    stood = {j: (i, lost) for i, group in reversed(list(zip(found.standing, found.groups, strict=True))) for j, lost in group}
    stood |= {i: (i, 0.0) for i in found.standing}
    by_other = added(found.output_error)
    estimates: dict[int, SensorEstimate] = {}
    lost: dict[int, float | None] = {}
    for j in found.common:
        context, lost[j] = _context(found, j, stood)
        estimates[j] = _estimate(lines.joint, by_other, faults, context, j)
    findings, said = [], set()
    for group in found.groups:
        names = [faults[j].name for j, _ in group]
        for j, loss in group:
            if j not in said and stood[j][0] == group[0][0]:
                others = tuple(name for name in names if name != faults[j].name)
                findings.append(_finding(estimates[j], faults[j], others, loss, stands=True))
                said.add(j)
    rest = sorted((j for j in found.common if j not in said), key=lambda j: estimates[j].p_value)
    findings += [replace(_finding(estimates[j], faults[j], (), lost[j], stands=False), replicates=j not in found.refused) for j in rest]
    return tuple(estimates.values()), tuple(findings)


def _context(found: Searched, j: int, stood: dict[int, tuple[int, float]]) -> tuple[list[int], float | None]:
    """The set in which a fault is judged, itself last: in the place of what it could stand for, else beside all; and what is lost in place."""
    faults = found.lines.faults
    in_place = [
        (i, (found.lines.joint, [*(k for k in found.standing if k != i), j]))
        for i in found.standing
        if j in (member for member, _ in found.groups[found.standing.index(i)]) or same_lateness(faults[i], faults[j])
    ]
    if j in stood:
        return [*(k for k in found.standing if k != stood[j][0] and k != j), j], stood[j][1]
    if in_place:
        i, (_, members) = in_place[0]
        pair = fitted(found.lines.joint, faults, np.array([[*members[:-1], i], members]), early=False)
        return members, float(pair.gain[0] - pair.gain[1]) / found.widening
    return [*found.standing, j], None


def _estimate(smoother: Normal, output_error: Normal, faults: Sequence[SensorFault], context: Sequence[int], j: int) -> SensorEstimate:
    fault, members = faults[j], np.array([context])
    one = fitted(smoother, faults, members, early=False)
    less = fitted(smoother, faults, members[:, :-1], early=False)
    other = fitted(output_error, faults, members, early=False)
    size, variance = float(one.sizes[0, -1]), float(one.variances[0, -1])
    told = 0.0 < variance < fault.plausible**2 and smoother.information[j, j] > 0
    wide = float(one.widening[0, -1])
    own = max(_sandwich(output_error, context), 0.0) * wide
    gain = max(float(one.gain[0] - less.gain[0]), 0.0) / wide
    by_other = float(np.clip(other.sizes[0, -1], -fault.largest, fault.largest))
    size = float(np.clip(size, -fault.largest, fault.largest))
    apart = difference_in_sigmas(by_other, own, size, variance) if told else 0.0
    quantities = Quantity(by_other + fault.offset, math.sqrt(own)), Quantity(size + fault.offset, math.sqrt(max(variance, 0.0)))
    return SensorEstimate(fault.name, fault.channel, fault.kind, fault.unit, *quantities, apart, gain, p_value(gain, size, fault), told)


def _sandwich(normal: Normal, context: Sequence[int]) -> float:
    """Variance of the last of a set from the scatter of the gradient."""
    at = np.ix_(context, context)
    diagonal = np.diag(normal.information[at])
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    inverse = np.linalg.inv(normal.information[at] * np.outer(scale, scale) + 1e-9 * np.eye(len(scale))) * np.outer(scale, scale)
    return float(inverse[-1] @ normal.scatter[at] @ inverse[-1])


def _finding(item: SensorEstimate, fault: SensorFault, group: tuple[str, ...], lost: float | None, *, stands: bool) -> SensorFinding:
    size = item.smoother
    return SensorFinding(fault.channel, fault.kind, size.value, size.std, fault.unit, item.gain, stands, group, fault.name, True, lost)


def by_itself(found: Searched, r: int) -> tuple[SensorEstimate, ...]:
    """Every fault by one record of several, beside the same others as in all."""
    lines = found.lines
    stood = {j: (i, lost) for i, group in zip(found.standing, found.groups, strict=True) for j, lost in group}
    one, other = lines.smoother[r], found.output_error[r]
    return tuple(_estimate(one, other, lines.faults, _context(found, j, stood)[0], j) for j in found.common)


def drift_of(found: Searched, r: int, false_alarm: float) -> tuple[SensorFinding, ...]:
    """The drift that one record of several has, if any, beside all that stands; ``false_alarm``: of this record."""
    lines, normal = found.lines, found.lines.smoother[r]
    members = list(found.standing)
    sizes = fitted(lines.joint, lines.faults, np.array([members], dtype=int).reshape(1, -1), early=False).sizes[0]
    beside = replace(normal, gradient=normal.gradient - normal.information[:, members] @ sizes)
    drifts = [j for j, fault in enumerate(lines.faults) if fault.kind == DRIFT]
    sets, row = best_set(beside, lines.faults, drifts, charge_of(false_alarm, len(drifts)), 1, early=False)
    out = []
    for j in sets.members[row].tolist():
        item = _estimate(beside, found.output_error[r], lines.faults, [j], j)
        rivals = fitted(beside, lines.faults, np.array([[k] for k in drifts if k != j]), early=False)
        near = (sets.gain[row] - rivals.gain) / float(sets.widening[row, 0]) <= chance_of(false_alarm, len(drifts))
        group = tuple(lines.faults[k].name for k in rivals.members[near & rivals.sound, 0].tolist())
        out.append(_finding(item, lines.faults[j], group, 0.0, stands=True))
    return tuple(out)


def late(faults: Sequence[SensorFault]) -> set[str]:
    """Channels that some of these faults make late."""
    return {fault.channel for fault in faults if fault.kind in (DELAY, LAG)}
