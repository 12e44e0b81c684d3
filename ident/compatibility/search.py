"""Which sensor faults the kinematics demand: each alone, then beside those that stand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ident.compatibility.faults import DELAY, LAG, SensorFault
from ident.compatibility.fitting import Fit, fit
from ident.compatibility.grouping import grouped, same_lateness
from ident.compatibility.result import CompatibilitySettings, SensorFinding
from ident.compatibility.trials import Trial, instrumented, replicates, tried


@dataclass(frozen=True, eq=False)
class Searched:
    """Findings, the standing ones first; of every fault the trial that counts: of what stands that beside everything else that stands, of what was
    ruled out with it that in its place, of all others that beside everything that stands. ``found`` is the fit with the best of each group.
    ``early``: a load ahead of its time, which no sensor can show, where it explains more than any fault: nothing further stands then.
    """

    findings: tuple[SensorFinding, ...]
    trials: tuple[Trial, ...]
    found: Fit
    early: Trial | None = None


def search(base: Fit, faults: Sequence[SensorFault], bases: Sequence[Fit], settings: CompatibilitySettings) -> Searched:
    """Add the best fault that is significant and replicates, with its group, until none is left.

    Each time the members of earlier groups are tried in the place of what stands for them: what was best alone need not be beside another.
    ``bases`` are the base fits of each record alone, for replication.
    """
    level = settings.false_alarm / max(len(faults), 1)
    left, current = tried(base, faults), base
    groups: list[list[Trial]] = []
    refused: list[Trial] = []
    stopped: Trial | None = None
    seen = {trial.fault: trial for trial in left}
    for _ in range(2 * settings.most):
        if len(groups) == settings.most:
            break
        best = _best([trial for trial in left if trial.fault not in {t.fault for t in refused}], level)
        early = None if instrumented(base) else _early(left)
        if best is not None and early is not None and early.gain > best.gain:
            stopped = early
        if best is None or stopped is not None:
            break
        if not replicates(bases, current, best):
            refused.append(best)
            continue
        group = [t for t in grouped(current, best, left, settings.collinear) if t is best or replicates(bases, current, t)]
        groups.append(group)
        current = best.found
        if len(groups) > 1:
            groups, current = _rearranged(base, groups, settings.collinear, level)
        closed = {trial.fault for group in groups for trial in group}
        chosen = [group[0].fault for group in groups]
        left = tried(current, [fault for fault in faults if fault not in closed and not any(same_lateness(fault, one) for one in chosen)])
        seen |= {trial.fault: trial for trial in left}
    here = {trial.fault for trial in [*left, *(trial for group in groups for trial in group)]}
    left = [*left, *(trial for fault, trial in seen.items() if fault not in here)]
    return _searched(faults, groups, left, refused, current, stopped)


def _rearranged(base: Fit, groups: Sequence[list[Trial]], collinear: float, level: float) -> tuple[list[list[Trial]], Fit]:
    """Every group anew beside the best of the others, its members in the order of what they gain there; a group that is no longer needed is
    dropped. And the fit with the best of each."""
    chosen, out = [group[0].fault for group in groups], [list(group) for group in groups]
    for _ in range(2):
        before = list(chosen)
        for i, group in enumerate(groups):
            others = fit(base.signals, [fault for k, fault in enumerate(chosen) if k != i], base)
            trials = sorted(tried(others, [trial.fault for trial in group]), key=lambda trial: -trial.gain)
            best = next((t for t in trials if t.size > 0 or not t.fault.one_sided), trials[0])
            out[i] = grouped(others, best, trials, collinear)
            chosen[i] = best.fault
        if chosen == before:
            break
    out = [group for group in out if _best(group[:1], level) is not None]
    return out, fit(base.signals, [group[0].fault for group in out], base)


def _searched(
    faults: Sequence[SensorFault],
    groups: Sequence[Sequence[Trial]],
    left: Sequence[Trial],
    refused: Sequence[Trial],
    current: Fit,
    early: Trial | None,
) -> Searched:
    findings = []
    for group in groups:
        names = [trial.fault.name for trial in group]
        findings += [_finding(trial, tuple(name for name in names if name != trial.fault.name), stands=True) for trial in group]
    disagreeing = {trial.fault for trial in refused}
    rest = sorted(left, key=lambda trial: trial.p_value)
    findings += [_finding(trial, (), stands=False, replicates=trial.fault not in disagreeing) for trial in rest]
    order = {fault: i for i, fault in enumerate(faults)}
    trials = sorted([*(trial for group in groups for trial in group), *left], key=lambda trial: order[trial.fault])
    return Searched(tuple(findings), tuple(trials), current, early)


def _best(trials: Sequence[Trial], level: float) -> Trial | None:
    """The fault of greatest gain among those that are significant, of a size worth having, and within their bounds."""
    sized = [trial for trial in trials if trial.told and trial.fault.worth < abs(trial.size) < 0.99 * trial.fault.largest]
    standing = [trial for trial in sized if trial.p_value < level]
    return max(standing, key=lambda trial: trial.gain, default=None)


def _early(trials: Sequence[Trial]) -> Trial | None:
    """The load recorded before it happens, where that gains anything, which no sensor does.

    A gust moves the vane and the load at once, the path only later: the load then seems early, and alpha and q late.
    """
    ahead = [trial for trial in trials if trial.told and trial.fault.channel == "nz" and trial.fault.kind in (DELAY, LAG) and trial.size < 0]
    return max(ahead, key=lambda trial: trial.gain, default=None)


def _finding(trial: Trial, group: tuple[str, ...], *, stands: bool, replicates: bool = True) -> SensorFinding:
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
    )
