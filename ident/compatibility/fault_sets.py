"""Search for the set of sensor faults that the kinematics require.

Kinematics show differences of delays only, so that one channel must be the time reference.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.compatibility.fitting import KinematicFit, fit, least_misfit, smoother_sigmas
from ident.compatibility.kinematics import ARM, BOOM, DELAY, LAG, PACKAGE, SensorFault
from ident.compatibility.signals import KinematicSignals, instrumented, weigher
from ident.compatibility.trials import (
    LEAST_PROJECTED_GAIN,
    CompatibilitySettings,
    FaultQuantity,
    FaultTrial,
    SensorFinding,
    one_step,
    replicates,
    tried,
)

# ---- Sets of sensor faults fitted jointly

_BEAM_WIDTH = 5  # sets of each size kept, and faults tried with each of them
TIE_LOG_LIKELIHOOD = 0.5  # difference of log likelihood below which two fits are equal
# channels whose relations show delays of a fraction of a second; speed changes too slowly
_TIMED = ("alpha", "q", "nz", "theta")


@dataclass(frozen=True, eq=False)
class FaultSet:
    """A joint fit of some faults. ``widening``: factor of variances by coloured residuals, mean
    over its faults. ``sound``: each fault is ``determined``, notable, within bounds and of a
    possible sign. ``early``: the last fault is a load with a negative delay. ``given``: number of
    leading faults that were prescribed. ``surprise``: log likelihood lost by priors of sizes.
    """

    fit: KinematicFit
    widening: float
    sound: bool
    determined: bool = True
    early: bool = False
    given: int = 0
    surprise: float = 0.0

    @property
    def faults(self) -> tuple[SensorFault, ...]:
        return self.fit.faults[self.given :]


def charge_of(false_alarm: float, count: int) -> float:
    """Return the log likelihood that a fault must gain: ln of the number of candidates, minus ln of
    the share of false alarms.

    Without the fault, the gain has an exponential tail or a shorter one: the best of ``count``
    gains exceeds this in fewer than ``false_alarm`` of sound sets of records.
    """
    return math.log(max(count, 1)) - math.log(false_alarm)


def fault_set(kinematic_fit: KinematicFit, given: int = 0, *, early: bool = False) -> FaultSet:
    """Return a fit evaluated as a set of faults, the first few of them ``given``."""
    k = len(kinematic_fit.faults) - given
    if not k:
        return FaultSet(kinematic_fit, 1.0, sound=True, given=given)
    sigmas = smoother_sigmas(kinematic_fit)
    widening = sigmas.widening[-k:]
    variances = np.diag(sigmas.covariance)[-k:] * widening
    determined = all(
        0.0 < variance < fault.plausible**2
        for fault, variance in zip(kinematic_fit.faults[given:], variances.tolist(), strict=True)
    )
    possible = all(
        _possible_size(fault, size)
        for fault, size in zip(
            kinematic_fit.faults[given:], kinematic_fit.sizes[given:].tolist(), strict=True
        )
    )
    sized = zip(
        kinematic_fit.faults[given:],
        kinematic_fit.sizes[given:].tolist(),
        variances.tolist(),
        strict=True,
    )
    surprise = float(sum(fault.surprise(size, variance) for fault, size, variance in sized))
    return FaultSet(
        kinematic_fit,
        float(np.mean(widening)),
        determined and possible,
        determined,
        early,
        given,
        surprise,
    )


def _possible_size(fault: SensorFault, size: float) -> bool:
    return fault.smallest_finding < abs(size) < 0.99 * fault.largest and (
        size > 0 or not fault.one_sided
    )


def misfits(fits: Sequence[KinematicFit]) -> np.ndarray:
    """Minus the log likelihood of each fit of the same records; with instruments the projected
    misfit, all under the noise of the best.
    """
    if not instrumented(fits[0].signals):
        return np.array([each.cost for each in fits])
    noise = min(fits, key=lambda each: each.cost).noise
    whiteners = [weigher(s, noise) for s in fits[0].signals]
    return np.array([least_misfit(each, whiteners) for each in fits])


def grow(
    base: KinematicFit,
    singles: Sequence[KinematicFit],
    faults: Sequence[SensorFault],
    charge: float,
    most: int,
) -> list[FaultSet]:
    """Return the sets of 0, 1, ... ``most`` faults, a few of each size, starting with the best of
    ``singles`` (forward selection with a beam).

    It ends where the best set of one more fault does not gain ``charge`` over the best without.
    Without recorded controls, sets with an early load are included and marked.
    """
    given = len(base.faults)
    out = [fault_set(base, given)]
    level = _best_sound(singles, given)
    before, blind = base, not instrumented(base.signals)
    for count in range(1, most + 1):
        if not level:
            break
        if blind:
            out += _early(before, faults, given)
        out += level
        best = level[0]
        here, there = misfits([before, best.fit]).tolist()
        if count == most or here - there < charge * best.widening:
            break
        before = best.fit
        fits: dict[frozenset[SensorFault], KinematicFit] = {}
        for each in level:
            for kinematic_fit in _extended(each.fit, faults, fits):
                fits[frozenset(kinematic_fit.faults)] = kinematic_fit
        level = _best_sound(list(fits.values()), given)
    return out


def chosen(sets: Sequence[FaultSet], charge: float) -> FaultSet:
    """Return the set of greatest likelihood minus ``charge`` for each fault; a negative delay of a
    load must be better than any possible fault.
    """
    misfit = misfits([each.fit for each in sets])
    widening = sets[int(np.argmin(misfit))].widening
    # Alpha and q that are equally late have nearly the same likelihood as a load that is early.
    score = [
        value / widening
        + charge * len(each.faults)
        + TIE_LOG_LIKELIHOOD * each.early
        + each.surprise
        for each, value in zip(sets, misfit.tolist(), strict=True)
    ]
    return sets[int(np.argmin(score))]


def without_superfluous(base: KinematicFit, chosen_set: FaultSet, charge: float) -> FaultSet:
    """Return the set without the faults whose removal loses less than ``charge``."""
    while len(chosen_set.faults) > 1:
        less = [
            fit(
                base.signals, [other for other in chosen_set.fit.faults if other is not fault], base
            )
            for fault in chosen_set.faults
        ]
        misfit = misfits([chosen_set.fit, *less])
        losses = (misfit[1:] - misfit[0]) / chosen_set.widening
        least = int(np.argmin(losses))
        if losses[least] >= charge:
            break
        chosen_set = fault_set(less[least], chosen_set.given)
    return chosen_set


def _best_sound(fits: Sequence[KinematicFit], given: int) -> list[FaultSet]:
    """Return the best few sound ones, best first."""
    if not fits:
        return []
    out: list[FaultSet] = []
    for i in np.argsort(misfits(fits), kind="stable"):
        judged = fault_set(fits[i], given)
        if judged.sound:
            out.append(judged)
        if len(out) == _BEAM_WIDTH:
            break
    return out


def _extended(
    kinematic_fit: KinematicFit,
    faults: Sequence[SensorFault],
    done: dict[frozenset[SensorFault], KinematicFit],
) -> list[KinematicFit]:
    """Fits of a set with one more fault each: those with the largest first-order gain."""
    timed = clocks(kinematic_fit.signals)
    free = [
        fault
        for fault in faults
        if fault not in kinematic_fit.faults
        and leaves_a_reference((*kinematic_fit.faults, fault), timed)
    ]
    quick = sorted(
        zip(free, one_step(kinematic_fit, free), strict=True), key=lambda pair: pair[1].cost
    )
    promising = [
        fault
        for fault, first in quick[:_BEAM_WIDTH]
        if kinematic_fit.cost - first.cost > LEAST_PROJECTED_GAIN
    ]
    return [
        fit(kinematic_fit.signals, (*kinematic_fit.faults, fault), kinematic_fit)
        for fault in promising
        if frozenset((*kinematic_fit.faults, fault)) not in done
    ]


def _early(
    kinematic_fit: KinematicFit, faults: Sequence[SensorFault], given: int
) -> list[FaultSet]:
    """Return the set with an early load, which no sensor fault can cause.

    A gust changes vane and load at once and the path later: the load then seems early, alpha and q
    late.
    """
    ahead = [
        fault
        for fault in faults
        if fault.channel == "nz"
        and fault.kind in (DELAY, LAG)
        and fault not in kinematic_fit.faults
    ]
    sets = [
        fault_set(
            fit(kinematic_fit.signals, (*kinematic_fit.faults, fault), kinematic_fit),
            given,
            early=True,
        )
        for fault in ahead
    ]
    return [each for each in sets if each.determined and each.fit.sizes[-1] < 0]


def clocks(signals: Sequence[KinematicSignals]) -> tuple[str, ...]:
    """Return the channels of which at least one must have no delay.

    Without recorded controls the load is not among them: a gust changes it before the path, so that
    alpha and q seem late.
    """
    return tuple(
        name
        for name in _TIMED
        if name in signals[0].channels and (name != "nz" or instrumented(signals))
    )


def delayed_channels(faults: Iterable[SensorFault]) -> set[str]:
    """Return the channels that these faults delay."""
    return {
        fault.channel for fault in faults if fault.kind in (DELAY, LAG) and fault.channel in _TIMED
    }


def leaves_a_reference(faults: Sequence[SensorFault], timed: Sequence[str]) -> bool:
    """Return whether one of the channels ``timed`` has no delay among these faults: otherwise only
    differences of delays are determined.

    The reference is the channel with the least delay.
    """
    # An accelerometer ahead of the centre of gravity has the effect of a lag of q.
    delayed = delayed_channels(faults) | {"q" for fault in faults if fault.rare}
    return not timed or not set(timed) <= delayed


def reference_sentence(faults: Sequence[SensorFault], timed: Sequence[str]) -> str:
    """Return a sentence that names the clock in ``timed`` to which the times of these faults refer;
    empty without a delay.
    """
    delayed = delayed_channels(faults)
    on_time = [name for name in timed if name not in delayed]
    if not delayed or not on_time:
        return ""
    if len(on_time) == 1:
        first = f"times count from {on_time[0]}, the channel that is least late"
    else:
        first = f"times count from {', '.join(on_time[:-1])} and {on_time[-1]}, which agree"
    return f"{first}: a delay common to all channels cannot be detected from kinematics"


# ---- Faults that an accepted one may be confused with

SAME_PLANE = ((BOOM, PACKAGE), ("alpha", "nz", "az"), ("beta", "ny", "ay"))


@dataclass(frozen=True, eq=False)
class Slot:
    """One position of a set: every fault tried in it with the ``others``, the best first; ``losses
    (k,)`` of log likelihood against the best.
    """

    others: KinematicFit
    trials: tuple[FaultTrial, ...]
    losses: np.ndarray

    def within(self, chance: float) -> list[FaultTrial]:
        """Return the best fault and those confusable with it: sound faults that lose at most
        ``chance``.
        """
        pairs = list(zip(self.trials, self.losses.tolist(), strict=True))
        return [
            self.trials[0],
            *(
                t
                for t, lost in pairs[1:]
                if lost <= chance and t.determined and (t.size > 0 or not t.fault.one_sided)
            ),
        ]


def confusable_loss(false_alarm: float, count: int) -> float:
    """Log likelihood by which the true one of ``count`` faults loses to another in no more than
    ``false_alarm`` of cases.

    Where one of two faults is true and the traces are a distance d apart, in standard deviations,
    the other's advantage is normal with mean -d^2/2 and variance d^2. It exceeds x with the
    greatest chance at d = sqrt(2 x): the tail of the normal distribution beyond sqrt(2 x), however
    alike the two are. So 2 x is the square of the quantile, shared among the rivals.
    """
    from scipy.special import ndtri

    return 0.5 * float(ndtri(false_alarm / max(count, 2))) ** 2


def probabilities(among: Sequence[tuple[SensorFault, FaultQuantity, float]]) -> dict[str, float]:
    """Return the probability of each of some faults, exactly one of which is present, by name: from
    its estimate and loss of log likelihood.
    """
    scores = np.array(
        [
            -lost - float(fault.surprise(size.value - fault.offset, size.std**2))
            for fault, size, lost in among
        ]
    )
    weights = np.exp(scores - np.max(scores))
    return dict(
        zip(
            (fault.name for fault, _, _ in among), (weights / np.sum(weights)).tolist(), strict=True
        )
    )


def slots_of(
    base: KinematicFit,
    chosen_set: FaultSet,
    faults: Sequence[SensorFault],
    singles: Sequence[FaultTrial],
) -> tuple[FaultSet, list[Slot]]:
    """Return the positions of a set, each with all faults tried in it; a better fault replaces the
    present one, and the search repeats.

    ``singles`` : every fault tried beside ``base`` alone.
    """
    for _ in range(3):
        slots = [_slot(base, chosen_set, fault, faults, singles) for fault in chosen_set.faults]
        better = [
            (i, slot)
            for i, slot in enumerate(slots)
            if slot.trials[0].fault is not chosen_set.faults[i]
        ]
        if not better:
            break
        i, slot = max(
            better,
            key=lambda pair: pair[1].losses[
                [t.fault for t in pair[1].trials].index(chosen_set.faults[pair[0]])
            ],
        )
        chosen = list(chosen_set.fit.faults)
        chosen[chosen_set.given + i] = slot.trials[0].fault
        changed = fault_set(fit(base.signals, chosen, slot.trials[0].fit), chosen_set.given)
        before, after = misfits([chosen_set.fit, changed.fit]).tolist()
        before, after = (
            before + chosen_set.widening * chosen_set.surprise,
            after + chosen_set.widening * changed.surprise,
        )
        if not changed.sound or after > before + TIE_LOG_LIKELIHOOD:
            break
        chosen_set = changed
    return chosen_set, [
        _slot_with_first(slot, fault) for slot, fault in zip(slots, chosen_set.faults, strict=True)
    ]


def same_lateness(one: SensorFault, other: SensorFault) -> bool:
    """Return whether both delay the same channel by different laws."""
    return (
        one.channel == other.channel
        and {one.kind, other.kind} <= {DELAY, LAG, ARM}
        and not (one.rare or other.rare)
    )


def same_trace(one: SensorFault, other: SensorFault) -> bool:
    """Return whether two arms have the same effect with opposite signs: of a vane, and of the
    accelerometer of the same plane.
    """
    channels = {one.channel, other.channel}
    return one.kind == other.kind == ARM and any(
        vane in channels and channels & {*loads} for vane, *loads in SAME_PLANE
    )


def _slot(
    base: KinematicFit,
    chosen_set: FaultSet,
    fault: SensorFault,
    faults: Sequence[SensorFault],
    singles: Sequence[FaultTrial],
) -> Slot:
    rest = [other for other in chosen_set.fit.faults if other is not fault]
    free = [
        each
        for each in faults
        if each not in rest and leaves_a_reference((*rest, each), clocks(base.signals))
    ]
    if rest == list(base.faults):
        others, trials = base, [trial for trial in singles if trial.fault in free]
    else:
        others = fit(base.signals, rest, base)
        trials = tried(others, free)
    misfit = misfits([others, chosen_set.fit, *(t.fit for t in trials)])
    # The accepted fault is fitted already: its fit in the set is used.
    here = [
        misfit[1] if t.fault is fault else value
        for t, value in zip(trials, misfit[2:].tolist(), strict=True)
    ]
    here = [
        value + TIE_LOG_LIKELIHOOD * t.fault.rare for t, value in zip(trials, here, strict=True)
    ]
    with_priors = [
        value + chosen_set.widening * float(t.fault.surprise(t.size, t.variance))
        for t, value in zip(trials, here, strict=True)
    ]
    sound = [t.determined and (t.size > 0 or not t.fault.one_sided) for t in trials]
    order = sorted(range(len(trials)), key=lambda i: (not sound[i], with_priors[i]))
    gains = (misfit[0] - np.array(here)) / chosen_set.widening
    ordered = [replace(trials[i], gain=max(float(gains[i]), 0.0)) for i in order]
    return Slot(others, tuple(ordered), (gains[order[0]] - gains)[order])


def _slot_with_first(slot: Slot, fault: SensorFault) -> Slot:
    """Return the slot with a given fault first."""
    at = (
        [t.fault for t in slot.trials].index(fault)
        if fault in [t.fault for t in slot.trials]
        else 0
    )
    order = [at, *(i for i in range(len(slot.trials)) if i != at)]
    return Slot(
        slot.others, tuple(slot.trials[i] for i in order), slot.losses[order] - slot.losses[at]
    )


# ---- Search for the required sensor faults


@dataclass(frozen=True, eq=False)
class FaultSearch:
    """Findings, accepted ones first, and the relevant trial of every fault. An accepted fault and
    its group are tried with the other accepted ones; another law of the same delay in place of the
    accepted one; any further fault in addition to all accepted ones. ``fit`` is the joint fit of
    the best of each group. ``early``: s by which a load would be early, if that explains more than
    any fault; then no further fault is accepted.
    """

    findings: tuple[SensorFinding, ...]
    trials: tuple[FaultTrial, ...]
    fit: KinematicFit
    early: float | None = None


def search(
    base: KinematicFit,
    faults: Sequence[SensorFault],
    bases: Sequence[KinematicFit],
    settings: CompatibilitySettings,
) -> FaultSearch:
    """Return the set of faults that the records ask for, each with its group.

    Forward selection that keeps several sets of each size; each fault must gain ``charge_of`` under
    coloured residuals with all the others, and single records must agree on it. ``bases`` are the
    base fits of each record alone.
    """
    charge = charge_of(settings.false_alarm, len(faults))
    chance = confusable_loss(settings.false_alarm, len(faults))
    singles = tried(base, faults)
    refused: dict[SensorFault, FaultTrial] = {}
    while True:
        left = [fault for fault in faults if fault not in refused]
        best, early = _selected(
            base, [t.fit for t in singles if t.fault not in refused], left, charge, settings.most
        )
        best, slots = slots_of(base, best, left, singles)
        failing = [
            slot.trials[0] for slot in slots if not replicates(bases, slot.others, slot.trials[0])
        ]
        if not failing:
            break
        refused |= {trial.fault: trial for trial in failing}
    groups = [_group(slot, bases, chance) for slot in slots]
    return _searched(faults, groups, slots, singles, refused, best.fit, early)


def _selected(
    base: KinematicFit,
    singles: Sequence[KinematicFit],
    faults: Sequence[SensorFault],
    charge: float,
    most: int,
) -> tuple[FaultSet, float | None]:
    """Return the best set, each of whose faults is needed, and the time by which a load would be
    early if that is in the best set.
    """
    best = chosen(grow(base, singles, faults, charge, most), charge)
    early = float(best.fit.sizes[-1]) if best.early else None
    if best.early:
        best = fault_set(fit(base.signals, best.fit.faults[:-1], base), best.given)
    return without_superfluous(base, best, charge), early


def _group(slot: Slot, bases: Sequence[KinematicFit], chance: float) -> list[FaultTrial]:
    best, *rivals = slot.within(chance)
    return [best, *(t for t in rivals if replicates(bases, slot.others, t))]


def _searched(
    faults: Sequence[SensorFault],
    groups: Sequence[Sequence[FaultTrial]],
    slots: Sequence[Slot],
    singles: Sequence[FaultTrial],
    refused: dict[SensorFault, FaultTrial],
    current: KinematicFit,
    early: float | None,
) -> FaultSearch:
    lost, instead = _in_place(slots)
    # An alternative of two faults is reported once: where it is best, else first.
    grouped = {t.fault: t for group in reversed(groups) for t in group} | {
        group[0].fault: group[0] for group in groups
    }
    stand, timed = current.faults, clocks(current.signals)
    besides = [
        f
        for f in faults
        if f not in grouped
        and leaves_a_reference((*stand, f), timed)
        and not any(same_lateness(f, s) for s in stand)
    ]
    beside = {t.fault: t for t in (tried(current, besides) if stand else singles)}
    trials = {
        fault: grouped.get(fault)
        or beside.get(fault)
        or instead.get(fault)
        or _alone(singles, fault)
        for fault in faults
    }
    findings = []
    for group in groups:
        names = [trial.fault.name for trial in group]
        mine = [t for t in group if grouped[t.fault] is t]
        sized = [
            (
                t.fault,
                FaultQuantity(t.size + t.fault.offset, math.sqrt(max(t.variance, 0.0))),
                lost.get(t.fault, 0.0),
            )
            for t in group
        ]
        shares = probabilities(sized)
        for t in mine:
            others = tuple(name for name in names if name != t.fault.name)
            findings.append(
                replace(
                    _finding(t, others, lost.get(t.fault, 0.0), stands=True), probabilities=shares
                )
            )
    rest = sorted(
        (trials[fault] for fault in faults if fault not in grouped), key=lambda trial: trial.p_value
    )
    findings += [
        _finding(t, (), lost.get(t.fault), stands=False, replicates=t.fault not in refused)
        for t in rest
    ]
    return FaultSearch(tuple(findings), tuple(trials.values()), current, early)


def _in_place(
    slots: Sequence[Slot],
) -> tuple[dict[SensorFault, float], dict[SensorFault, FaultTrial]]:
    """Find the position at which each fault loses least in place of an accepted one, and return
    loss and trial.
    """
    lost: dict[SensorFault, float] = {}
    instead: dict[SensorFault, FaultTrial] = {}
    for slot in slots:
        for trial, loss in zip(slot.trials, slot.losses.tolist(), strict=True):
            if loss < lost.get(trial.fault, math.inf):
                lost[trial.fault], instead[trial.fault] = loss, trial
    return lost, instead


def _alone(singles: Sequence[FaultTrial], fault: SensorFault) -> FaultTrial:
    return next(trial for trial in singles if trial.fault == fault)


def _finding(
    trial: FaultTrial,
    group: tuple[str, ...],
    lost: float | None,
    *,
    stands: bool,
    replicates: bool = True,
) -> SensorFinding:
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
