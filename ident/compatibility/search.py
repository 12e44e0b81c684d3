"""Which sensor faults the kinematics demand: sets of them fitted jointly, of which each is needed beside the others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ident.compatibility.fault_sets import FaultSet, charge_of, chosen, clocks, fault_set, grow, leaves_a_reference, needed
from ident.compatibility.faults import SensorFault
from ident.compatibility.fitting import Fit, fit
from ident.compatibility.grouping import Slot, chance_of, probabilities, same_lateness, slots_of
from ident.compatibility.result import CompatibilitySettings, Quantity, SensorFinding
from ident.compatibility.trials import Trial, replicates, tried


@dataclass(frozen=True, eq=False)
class Searched:
    """Findings, the standing ones first; of every fault the trial that counts: of what stands and of its group that beside everything else that
    stands, of what shares a sensor's lateness with it that in its place, of all others that beside everything that stands. ``found`` is the
    joint fit of the best of each group. ``early``: s by which a load would be ahead of its time, which no sensor can show, where that explains
    more than any fault: nothing further stands then.
    """

    findings: tuple[SensorFinding, ...]
    trials: tuple[Trial, ...]
    found: Fit
    early: float | None = None


def search(base: Fit, faults: Sequence[SensorFault], bases: Sequence[Fit], settings: CompatibilitySettings) -> Searched:
    """The set of faults that the records ask for, each with its group.

    Forward selection that keeps several sets of each size; each fault has to bring what ``charge_of`` says, over the colour of what is left,
    beside all the others, and the records by themselves have to agree on it. ``bases`` are the base fits of each record alone.
    """
    charge, chance = charge_of(settings.false_alarm, len(faults)), chance_of(settings.false_alarm, len(faults))
    singles = tried(base, faults)
    refused: dict[SensorFault, Trial] = {}
    while True:
        left = [fault for fault in faults if fault not in refused]
        best, early = _selected(base, [t.found for t in singles if t.fault not in refused], left, charge, settings.most)
        best, slots = slots_of(base, best, left, singles)
        failing = [slot.trials[0] for slot in slots if not replicates(bases, slot.others, slot.trials[0])]
        if not failing:
            break
        refused |= {trial.fault: trial for trial in failing}
    groups = [_group(slot, bases, chance) for slot in slots]
    return _searched(faults, groups, slots, singles, refused, best.found, early)


def _selected(base: Fit, singles: Sequence[Fit], faults: Sequence[SensorFault], charge: float, most: int) -> tuple[FaultSet, float | None]:
    """The best set, each of whose faults is needed; and by how much a load would be early where that belongs to what is best."""
    best = chosen(grow(base, singles, faults, charge, most), charge)
    early = float(best.found.sizes[-1]) if best.early else None
    if best.early:
        best = fault_set(fit(base.signals, best.found.faults[:-1], base), best.given)
    return needed(base, best, charge), early


def _group(slot: Slot, bases: Sequence[Fit], chance: float) -> list[Trial]:
    best, *rivals = slot.within(chance)
    return [best, *(t for t in rivals if replicates(bases, slot.others, t))]


def _searched(
    faults: Sequence[SensorFault],
    groups: Sequence[Sequence[Trial]],
    slots: Sequence[Slot],
    singles: Sequence[Trial],
    refused: dict[SensorFault, Trial],
    current: Fit,
    early: float | None,
) -> Searched:
    lost, instead = _in_place(slots)
    # What would do in the place of two is told once: where it is the best, else in the first.
    grouped = {t.fault: t for group in reversed(groups) for t in group} | {group[0].fault: group[0] for group in groups}
    stand, timed = current.faults, clocks(current.signals)
    besides = [f for f in faults if f not in grouped and leaves_a_reference((*stand, f), timed) and not any(same_lateness(f, s) for s in stand)]
    beside = {t.fault: t for t in (tried(current, besides) if stand else singles)}
    trials = {fault: grouped.get(fault) or beside.get(fault) or instead.get(fault) or _alone(singles, fault) for fault in faults}
    findings = []
    for group in groups:
        names = [trial.fault.name for trial in group]
        mine = [t for t in group if grouped[t.fault] is t]
        sized = [(t.fault, Quantity(t.size + t.fault.offset, math.sqrt(max(t.variance, 0.0))), lost.get(t.fault, 0.0)) for t in group]
        shares = probabilities(sized)
        for t in mine:
            others = tuple(name for name in names if name != t.fault.name)
            findings.append(replace(_finding(t, others, lost.get(t.fault, 0.0), stands=True), probabilities=shares))
    rest = sorted((trials[fault] for fault in faults if fault not in grouped), key=lambda trial: trial.p_value)
    findings += [_finding(t, (), lost.get(t.fault), stands=False, replicates=t.fault not in refused) for t in rest]
    return Searched(tuple(findings), tuple(trials.values()), current, early)


def _in_place(slots: Sequence[Slot]) -> tuple[dict[SensorFault, float], dict[SensorFault, Trial]]:
    """Of each fault what it loses in the place of what stands, and its trial there, where it loses least."""
    lost: dict[SensorFault, float] = {}
    instead: dict[SensorFault, Trial] = {}
    for slot in slots:
        for trial, loss in zip(slot.trials, slot.losses.tolist(), strict=True):
            if loss < lost.get(trial.fault, math.inf):
                lost[trial.fault], instead[trial.fault] = loss, trial
    return lost, instead


def _alone(singles: Sequence[Trial], fault: SensorFault) -> Trial:
    return next(trial for trial in singles if trial.fault == fault)


def _finding(trial: Trial, group: tuple[str, ...], lost: float | None, *, stands: bool, replicates: bool = True) -> SensorFinding:
    fault = trial.fault
    return SensorFinding(
        fault.channel,
        fault.kind,
        trial.size + fault.offset,
        math.sqrt(max(trial.variance, 0.0)),
        fault.unit,
        trial.gain,
        stands,
        group,
        fault.name,
        replicates,
        lost,
    )
