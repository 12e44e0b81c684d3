"""Every fault by both methods beside what a search has found, and the findings; what one record of several says by itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.compatibility.estimates import difference_in_sigmas
from ident.compatibility.fault_sets import charge_of
from ident.compatibility.faults import DELAY, DRIFT, LAG, SensorFault
from ident.compatibility.grouping import chance_of, probabilities, same_lateness
from ident.compatibility.result import Quantity, SensorEstimate, SensorFinding
from ident.compatibility.six_degrees.fitting import fit
from ident.compatibility.six_degrees.linear import Normal, added, by_output_error, linear
from ident.compatibility.six_degrees.search import SECANT, Searched, alike
from ident.compatibility.six_degrees.selection import fitted
from ident.compatibility.trials import p_value


def estimates_and_findings(found: Searched) -> tuple[tuple[SensorEstimate, ...], tuple[SensorFinding, ...]]:
    """Every fault by both methods, and the findings, those that stand first."""
    lines, faults = found.lines, found.lines.faults
    stood = _stood(found)
    by_other = added(found.output_error)
    estimates: dict[int, SensorEstimate] = {}
    lost: dict[int, float | None] = {}
    for j in found.common:
        context, lost[j] = _context(found, j, stood)
        estimates[j] = _estimate(lines.joint, by_other, faults, context, j)
    findings, said = [], set()
    for group in found.groups:
        names = [faults[j].name for j, _ in group]
        shares = probabilities([(faults[j], estimates[j].smoother, loss) for j, loss in group])
        for j, loss in group:
            if j not in said and stood[j][0] == group[0][0]:
                others = tuple(name for name in names if name != faults[j].name)
                findings.append(replace(_finding(estimates[j], faults[j], others, loss, stands=True), probabilities=shares))
                said.add(j)
    rest = sorted((j for j in found.common if j not in said), key=lambda j: estimates[j].p_value)
    findings += [replace(_finding(estimates[j], faults[j], (), lost[j], stands=False), replicates=j not in found.refused) for j in rest]
    return tuple(estimates.values()), tuple(findings)


def _stood(found: Searched) -> dict[int, tuple[int, float]]:
    """For each fault that stands, or would in its place, the one that stands and what is lost; of two such places the first."""
    stood = {j: (i, lost) for i, group in reversed(list(zip(found.standing, found.groups, strict=True))) for j, lost in group}
    return stood | {i: (i, 0.0) for i in found.standing}


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
        if (i, j) in found.lateness:
            return members, max(found.lateness[i, j], 0.0) / found.widening
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
    stood = _stood(found)
    one, other = lines.smoother[r], found.output_error[r]
    return tuple(_estimate(one, other, lines.faults, _context(found, j, stood)[0], j) for j in found.common)


def drift_of(found: Searched, r: int, false_alarm: float) -> tuple[SensorFinding, ...]:
    """The drift that one record of several has, if any, beside all that stands, which this record is asked again for; ``false_alarm``: its own."""
    lines, faults, members = found.lines, found.lines.faults, found.standing
    drifts = [j for j, fault in enumerate(faults) if fault.kind == DRIFT]
    # Without the colour that the drift itself makes, to begin with.
    sets = fitted(replace(lines.smoother[r], scatter=lines.smoother[r].information), faults, np.array([[*members, j] for j in drifts]), early=False)
    j = drifts[int(np.argmax(np.where(sets.sound, sets.gain, 0.0)))]
    charge = charge_of(false_alarm, len(drifts))
    if float(np.max(np.where(sets.sound, sets.gain, 0.0))) - _gain_of(lines.smoother[r], faults, members) < charge:
        return ()
    begin = replace(lines.found, signals=(lines.found.signals[r],), own=(lines.found.own[r],))
    beside = linear(fit(begin.signals, [faults[i] for i in (*members, j)], begin), faults, np.full(len(faults), SECANT))
    item = _estimate(beside.joint, by_output_error(beside, 0), faults, [*members, j], j)
    if not item.told or item.gain < charge or abs(item.smoother.value) < faults[j].worth:
        return ()
    rivals = alike(beside, (*members, j), j, chance_of(false_alarm, len(drifts)), drifts)
    return (_finding(item, faults[j], tuple(faults[k].name for k in rivals), 0.0, stands=True),)


def _gain_of(normal: Normal, faults: Sequence[SensorFault], members: Sequence[int]) -> float:
    return float(fitted(normal, faults, np.array([members], dtype=int).reshape(1, -1), early=False).gain[0])


def late(faults: Sequence[SensorFault]) -> set[str]:
    """Channels that some of these faults make late."""
    return {fault.channel for fault in faults if fault.kind in (DELAY, LAG)}
