"""Which sensor faults the kinematics demand: each alone, then beside those that stand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.compatibility.estimates import difference_in_sigmas, output_error, smoother_sigmas
from ident.compatibility.faults import ARM, BIAS, DELAY, LAG, SensorFault
from ident.compatibility.fitting import Fit, bounded_inverse, evaluate, fit, one_step, positions, unknowns_of
from ident.compatibility.noise import whitener
from ident.compatibility.result import CompatibilitySettings, Quantity, SensorEstimate, SensorFinding

_NEAR = 6.0  # of log likelihood: a fault that gains as much as another within this is not told from it
_RIVAL = 0.5  # share of the best gain below which a collinear fault is ruled out all the same
_REPLICATION = 1e-3
_WORTH = 2.5  # first-order gain from which a fault is fitted in full
_DEMANDED = 3.0  # standard deviations


@dataclass(frozen=True, eq=False)
class Trial:
    """A fault fitted beside others: the fit, its variance (white noise and corrected), gain and p-value over the colour of what is left."""

    fault: SensorFault
    found: Fit
    size: float
    white: float
    variance: float
    gain: float
    p_value: float

    @property
    def told(self) -> bool:
        return 0.0 < self.variance < self.fault.plausible**2


def tried(base: Fit, faults: Sequence[SensorFault]) -> list[Trial]:
    """Each fault beside those of ``base``: to first order, and fitted in full where it may come to matter."""
    out = []
    for fault, quick in zip(faults, one_step(base, faults), strict=True):
        first = _trial(base, fault, quick)
        worth = first.gain > _WORTH or abs(first.size) > 0.5 * fault.plausible
        out.append(_trial(base, fault, fit(base.signals, (*base.faults, fault), base)) if worth else first)
    return out


def _trial(base: Fit, fault: SensorFault, found: Fit) -> Trial:
    sigmas = smoother_sigmas(found)
    white = float(sigmas.covariance[-1, -1])
    widening = float(sigmas.widening[-1])
    gain = max(base.cost - found.cost, 0.0) / widening
    return Trial(fault, found, float(found.sizes[-1]), white, white * widening, gain, p_value(gain, found.sizes[-1], fault))


def p_value(gain: float, size: float, fault: SensorFault) -> float:
    """Chance of such a gain of the log likelihood where the fault is absent."""
    from scipy.special import chdtrc

    if fault.one_sided:
        return 0.5 * float(chdtrc(1.0, 2.0 * gain)) if size > 0 else 1.0 - 0.5 * float(chdtrc(1.0, 2.0 * gain))
    return float(chdtrc(1.0, 2.0 * gain))


def estimate_of(trial: Trial) -> SensorEstimate:
    """A fault by both methods."""
    values, covariance = output_error(trial.found)
    widening = trial.variance / trial.white if trial.white > 0 else 1.0
    own = float(covariance[-1, -1]) * widening
    difference = difference_in_sigmas(float(values[-1]), own, trial.size, trial.variance)
    fault = trial.fault
    return SensorEstimate(
        fault.name,
        fault.channel,
        fault.kind,
        fault.unit,
        Quantity(float(values[-1]) + fault.offset, math.sqrt(max(own, 0.0))),
        Quantity(trial.size + fault.offset, math.sqrt(max(trial.variance, 0.0))),
        difference if trial.told else 0.0,
        trial.gain,
        trial.p_value,
        trial.told,
    )


def bias_estimates(base: Fit) -> tuple[SensorEstimate, ...]:
    """The biases that every fit of one record leaves free."""
    sigmas, (values, covariance) = smoother_sigmas(base), output_error(base)
    out = []
    for i, item in enumerate(unknowns_of(base.signals[0])):
        if item.key[1] != BIAS:
            continue
        fault = SensorFault(item.key[0], BIAS)
        wide = float(sigmas.widening[i])
        one, other = float(covariance[i, i]) * wide, float(sigmas.covariance[i, i]) * wide
        value = float(base.own[0][i])
        out.append(
            SensorEstimate(
                fault.name,
                fault.channel,
                BIAS,
                fault.unit,
                Quantity(float(values[i]), math.sqrt(one)),
                Quantity(value, math.sqrt(other)),
                difference_in_sigmas(float(values[i]), one, value, other),
                0.0,
                1.0,
                True,
            )
        )
    return tuple(out)


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
        early = _early(left)
        if best is not None and early is not None and early.gain > best.gain:
            stopped = early
        if best is None or stopped is not None:
            break
        if not replicates(bases, current, best):
            refused.append(best)
            continue
        group = [t for t in _group(current, best, left, settings.collinear) if t is best or replicates(bases, current, t)]
        groups.append(group)
        current = best.found
        if len(groups) > 1:
            groups, current = _rearranged(base, groups, settings.collinear, level)
        closed = {trial.fault for group in groups for trial in group}
        chosen = [group[0].fault for group in groups]
        left = tried(current, [fault for fault in faults if fault not in closed and not any(_same_lateness(fault, one) for one in chosen)])
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
            out[i] = _group(others, best, trials, collinear)
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


def beside(base: Fit, faults: Sequence[SensorFault], sizes: np.ndarray) -> Fit:
    """The fit of one record with faults that stand in all."""
    return fit(base.signals, faults, base, sizes) if faults else base


def replicates(bases: Sequence[Fit], current: Fit, trial: Trial) -> bool:
    """Whether the records by themselves agree on a fault, beside those that stand, and demand it together with the sign that it has in all."""
    from scipy.special import chdtrc

    if len(bases) < 2:
        return True
    alone = [tried(beside(base, current.faults, current.sizes), [trial.fault])[0] for base in bases]
    v, w = np.array([t.size for t in alone if t.told]), np.array([1.0 / t.variance for t in alone if t.told])
    if len(v) < 2:
        return False
    mean = float(np.sum(w * v) / np.sum(w))
    agree = float(chdtrc(len(v) - 1.0, float(np.sum(w * (v - mean) ** 2)))) > _REPLICATION
    return agree and mean * math.copysign(1.0, trial.size) > _DEMANDED / math.sqrt(float(np.sum(w)))


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


def _group(current: Fit, best: Trial, trials: Sequence[Trial], collinear: float) -> list[Trial]:
    """The best fault and those that explain nearly the same change of the reconstruction, or gain nearly as much."""
    rivals = [t for t in trials if t is not best and t.gain > 0 and not (t.fault.one_sided and t.size <= 0) and t.told]
    changes = {t.fault: _change(current, best, t) for t in (best, *rivals)}
    out = [best]
    for t in sorted(rivals, key=lambda t: -t.gain):
        cosine = abs(float(changes[t.fault] @ changes[best.fault]))
        alike = cosine >= collinear or _same_lateness(t.fault, best.fault)
        if (alike and t.gain >= _RIVAL * best.gain) or t.gain >= best.gain - _NEAR:
            out.append(t)
    return out


def _change(current: Fit, best: Trial, trial: Trial) -> np.ndarray:
    """What a fault of its fitted size changes, as independent samples under the best fit's noise, less what the other unknowns can do."""
    parts, columns = [], []
    at = positions(current)
    for r, s in enumerate(current.signals):
        sizes = np.append(current.sizes, trial.size)[None]
        after = evaluate(s, unknowns_of(s), (*current.faults, trial.fault), current.own[r][None], sizes)[:, 0]
        before = evaluate(s, unknowns_of(s), current.faults, current.own[r][None], current.sizes[None])[:, 0]
        change = np.where(s.valid, after - before, 0.0)[:, :, None]
        white = whitener(s, best.found.noise)(np.concatenate([change, np.where(s.valid[:, :, None], current.jacobians[r], 0.0)], axis=2))
        wide = np.zeros((white.shape[0] * white.shape[1], int(at[-1].max()) + 1 if len(at[-1]) else 0))
        wide[:, at[r]] = white[:, :, 1:].reshape(len(wide), -1)
        parts.append(white[:, :, 0].ravel())
        columns.append(wide)
    y, J = np.concatenate(parts), np.concatenate(columns)
    y = y - J @ (bounded_inverse(J.T @ J) @ (J.T @ y))
    size = float(np.linalg.norm(y))
    return y / size if size > 0 else y


def _same_lateness(one: SensorFault, other: SensorFault) -> bool:
    return one.channel == other.channel and {one.kind, other.kind} <= {DELAY, LAG, ARM}


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
