"""Search for the set of sensor faults that the kinematics require.

The kinematics determine differences of delays only, so that one channel must be the time reference.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.compatibility.fitting import (
    KinematicFit,
    fit,
    instrumented,
    least_misfit,
    projected_whitener,
    smoother_sigmas,
)
from ident.compatibility.kinematics import ARM, BOOM, DELAY, LAG, PACKAGE, SensorFault
from ident.compatibility.trials import (
    LEAST_PROJECTED_GAIN,
    CompatibilitySettings,
    FaultQuantity,
    FaultTrial,
    SensorFinding,
    leaves_time_reference,
    linearised_fits,
    records_agree,
    time_references,
    try_faults,
)

# ---- Sets of sensor faults fitted jointly

_BEAM_WIDTH = 5  # number of sets of each size that are kept, and of faults tried with each of them
TIE_LOG_LIKELIHOOD = 0.5  # fits with a smaller difference of log likelihood count as equal
_BOUND_SHARE = 0.99  # a size above this share of its bound is at the bound
_MOST_EXCHANGES = 3  # most exchanges of one fault of a set for a better one


@dataclass(frozen=True, eq=False)
class FaultSet:
    """A joint fit of some faults.

    Attributes
    ----------
    widening : factor of the variances for coloured residuals, as a mean over the faults.
    sound : whether every fault is determined, notable, within its bounds and of a possible sign.
    determined : whether every sigma is smaller than a plausible size of its fault.
    early : whether the last fault is a negative delay of the load.
    given : number of prescribed faults, which are the first ones of the fit.
    prior_loss : loss of log likelihood by the priors of the sizes.
    """

    fit: KinematicFit
    widening: float
    sound: bool
    determined: bool = True
    early: bool = False
    given: int = 0
    prior_loss: float = 0.0

    @property
    def faults(self) -> tuple[SensorFault, ...]:
        """The faults without the prescribed ones."""
        return self.fit.faults[self.given :]


def penalty_per_fault(false_alarm: float, count: int) -> float:
    """Return the log likelihood that a fault must gain: ln of the number of candidates minus ln of
    the probability of a false alarm.

    Where no fault is present, the tail of the gain is exponential or shorter. The best of ``count``
    gains then exceeds this limit with a probability below ``false_alarm``.
    """
    return math.log(max(count, 1)) - math.log(false_alarm)


def fault_set(kinematic_fit: KinematicFit, given: int = 0, *, early: bool = False) -> FaultSet:
    """Return the set of faults of a fit, whose first ``given`` faults are prescribed."""
    k = len(kinematic_fit.faults) - given
    if not k:
        return FaultSet(kinematic_fit, 1.0, sound=True, given=given)
    sigmas = smoother_sigmas(kinematic_fit)
    widening = sigmas.widening[-k:]
    variances = np.diag(sigmas.covariance)[-k:] * widening
    faults, sizes = kinematic_fit.faults[given:], kinematic_fit.sizes[given:].tolist()
    estimates = list(zip(faults, sizes, variances.tolist(), strict=True))
    determined = all(0.0 < variance < fault.plausible**2 for fault, _, variance in estimates)
    possible = all(_possible_size(fault, size) for fault, size, _ in estimates)
    prior_loss = float(sum(fault.prior_loss(size, variance) for fault, size, variance in estimates))
    return FaultSet(
        kinematic_fit,
        float(np.mean(widening)),
        determined and possible,
        determined,
        early,
        given,
        prior_loss,
    )


def _possible_size(fault: SensorFault, size: float) -> bool:
    """Return whether a size is notable, within its bounds and of a possible sign."""
    possible_sign = size > 0 or not fault.one_sided
    return fault.smallest_finding < abs(size) < _BOUND_SHARE * fault.largest and possible_sign


def misfits(fits: Sequence[KinematicFit]) -> np.ndarray:
    """Return minus the log likelihood of each of some fits to the same records. With instruments,
    return the projected misfits instead, all under the noise of the best fit.
    """
    if not instrumented(fits[0].signals):
        return np.array([candidate.cost for candidate in fits])
    noise = min(fits, key=lambda candidate: candidate.cost).noise
    whiteners = [projected_whitener(s, noise) for s in fits[0].signals]
    return np.array([least_misfit(candidate, whiteners) for candidate in fits])


def grow_sets(
    base: KinematicFit,
    singles: Sequence[KinematicFit],
    faults: Sequence[SensorFault],
    penalty: float,
    max_faults: int,
) -> list[FaultSet]:
    """Return sets of 0, 1, ... ``max_faults`` faults by forward selection with a beam, several
    sets of each size.

    The sets of one fault are the best of ``singles``, the fits of each fault alone. The selection
    ends where the best set with one more fault gains less than ``penalty``. Without recorded
    controls, sets with an early load are included and marked.
    """
    given = len(base.faults)
    sets = [fault_set(base, given)]
    largest_sets = _best_sound(singles, given)
    best_smaller, without_controls = base, not instrumented(base.signals)
    for count in range(1, max_faults + 1):
        if not largest_sets:
            break
        if without_controls:
            sets += _with_early_load(best_smaller, faults, given)
        sets += largest_sets
        best = largest_sets[0]
        smaller_misfit, best_misfit = misfits([best_smaller, best.fit]).tolist()
        if count == max_faults or smaller_misfit - best_misfit < penalty * best.widening:
            break
        best_smaller = best.fit
        fits: dict[frozenset[SensorFault], KinematicFit] = {}
        for smaller in largest_sets:
            for kinematic_fit in _extended(smaller.fit, faults, fits):
                fits[frozenset(kinematic_fit.faults)] = kinematic_fit
        largest_sets = _best_sound(list(fits.values()), given)
    return sets


def best_set_of(sets: Sequence[FaultSet], penalty: float) -> FaultSet:
    """Return the set with the greatest log likelihood minus ``penalty`` for each fault. A set with
    an early load must be better by more than ``TIE_LOG_LIKELIHOOD``.
    """
    misfit = misfits([candidate.fit for candidate in sets])
    widening = sets[int(np.argmin(misfit))].widening
    # An early load has nearly the same likelihood as equal delays of alpha and q.
    score = [
        value / widening
        + penalty * len(candidate.faults)
        + TIE_LOG_LIKELIHOOD * candidate.early
        + candidate.prior_loss
        for candidate, value in zip(sets, misfit.tolist(), strict=True)
    ]
    return sets[int(np.argmin(score))]


def without_superfluous_faults(
    base: KinematicFit, chosen_set: FaultSet, penalty: float
) -> FaultSet:
    """Return the set without the faults whose removal loses less than ``penalty``."""
    while len(chosen_set.faults) > 1:
        smaller = [
            fit(base.signals, [kept for kept in chosen_set.fit.faults if kept is not removed], base)
            for removed in chosen_set.faults
        ]
        misfit = misfits([chosen_set.fit, *smaller])
        losses = (misfit[1:] - misfit[0]) / chosen_set.widening
        least = int(np.argmin(losses))
        if losses[least] >= penalty:
            break
        chosen_set = fault_set(smaller[least], chosen_set.given)
    return chosen_set


def _best_sound(fits: Sequence[KinematicFit], given: int) -> list[FaultSet]:
    """Return the sets of the best sound fits, at most ``_BEAM_WIDTH``, the best first."""
    if not fits:
        return []
    sets: list[FaultSet] = []
    for i in np.argsort(misfits(fits), kind="stable"):
        candidate = fault_set(fits[i], given)
        if candidate.sound:
            sets.append(candidate)
        if len(sets) == _BEAM_WIDTH:
            break
    return sets


def _extended(
    kinematic_fit: KinematicFit,
    faults: Sequence[SensorFault],
    fitted: dict[frozenset[SensorFault], KinematicFit],
) -> list[KinematicFit]:
    """Return fits with one more fault, those of the largest gains, without those ``fitted``."""
    timed = time_references(kinematic_fit.signals)
    candidates = [
        fault
        for fault in faults
        if fault not in kinematic_fit.faults
        and leaves_time_reference((*kinematic_fit.faults, fault), timed)
    ]
    first_order = sorted(
        zip(candidates, linearised_fits(kinematic_fit, candidates), strict=True),
        key=lambda pair: pair[1].cost,
    )
    promising = [
        fault
        for fault, projected in first_order[:_BEAM_WIDTH]
        if kinematic_fit.cost - projected.cost > LEAST_PROJECTED_GAIN
    ]
    return [
        fit(kinematic_fit.signals, (*kinematic_fit.faults, fault), kinematic_fit)
        for fault in promising
        if frozenset((*kinematic_fit.faults, fault)) not in fitted
    ]


def _with_early_load(
    kinematic_fit: KinematicFit, faults: Sequence[SensorFault], given: int
) -> list[FaultSet]:
    """Return the fit with a negative delay of the load as a further fault, where it is determined.

    No sensor fault causes this. A gust does: it changes the vane and the load at once and the
    flight path later, so that the load seems early, or alpha and q late.
    """
    load_faults = [
        fault
        for fault in faults
        if fault.channel == "nz"
        and fault.kind in (DELAY, LAG)
        and fault not in kinematic_fit.faults
    ]
    fits = [
        fit(kinematic_fit.signals, (*kinematic_fit.faults, fault), kinematic_fit)
        for fault in load_faults
    ]
    sets = [fault_set(with_load, given, early=True) for with_load in fits]
    return [candidate for candidate in sets if candidate.determined and candidate.fit.sizes[-1] < 0]


# ---- Faults that an accepted one may be confused with

# for each plane of motion: its accelerometers, then its vane and its rate
PLANES = (((PACKAGE,), (BOOM,)), (("nz", "az"), ("alpha", "q")), (("ny", "ay"), ("beta", "r")))


@dataclass(frozen=True, eq=False)
class Slot:
    """One position of a set, with every fault that was tried in it.

    Attributes
    ----------
    others : fit with only the other faults of the set.
    trials : trial of each fault in this position, the best first.
    losses : ``(k,)`` loss of log likelihood of each trial against the first one.
    """

    others: KinematicFit
    trials: tuple[FaultTrial, ...]
    losses: np.ndarray

    def within(self, chance_loss: float) -> list[FaultTrial]:
        """Return the best trial, and sound ones that lose at most ``chance_loss`` against it."""
        rivals = zip(self.trials[1:], self.losses[1:].tolist(), strict=True)
        confusable = [trial for trial, loss in rivals if loss <= chance_loss and _sound(trial)]
        return [self.trials[0], *confusable]


def _sound(trial: FaultTrial) -> bool:
    """Return whether a tried fault is determined and of a possible sign."""
    return trial.determined and (trial.size > 0 or not trial.fault.one_sided)


def largest_chance_loss(false_alarm: float, count: int) -> float:
    """Return the largest loss of log likelihood that may be due to chance: the true one of
    ``count`` faults loses more against another one with a probability of at most ``false_alarm``.

    If the effects of the two differ by d standard deviations, the gain of the wrong one is normal
    with mean -d^2/2 and variance d^2. It exceeds x with the largest probability at d = sqrt(2 x).
    """
    from scipy.special import ndtri

    return 0.5 * float(ndtri(false_alarm / max(count, 2))) ** 2


def probabilities(among: Sequence[tuple[SensorFault, FaultQuantity, float]]) -> dict[str, float]:
    """Return the probability of each fault by name, where exactly one of them is present.

    ``among`` has for each fault its estimated size and its loss of log likelihood.
    """
    scores = np.array(
        [
            -loss - float(fault.prior_loss(size.value - fault.offset, size.std**2))
            for fault, size, loss in among
        ]
    )
    weights = np.exp(scores - np.max(scores))
    names = [fault.name for fault, _, _ in among]
    return dict(zip(names, (weights / np.sum(weights)).tolist(), strict=True))


def slots_with_trials(
    base: KinematicFit,
    chosen_set: FaultSet,
    faults: Sequence[SensorFault],
    singles: Sequence[FaultTrial],
) -> tuple[FaultSet, list[Slot]]:
    """Return a set, and its positions with all faults tried in them. Where another fault is better
    in a position, it replaces the present one, and all positions are tried again.

    ``singles`` are the trials of each fault in addition to those of ``base`` only.
    """
    for _ in range(_MOST_EXCHANGES):
        slots = [_slot(base, chosen_set, fault, faults, singles) for fault in chosen_set.faults]
        better = [
            (i, slot)
            for i, slot in enumerate(slots)
            if slot.trials[0].fault is not chosen_set.faults[i]
        ]
        if not better:
            break
        gains = [slot.losses[_trial_index(slot, chosen_set.faults[i])] for i, slot in better]
        i, slot = better[int(np.argmax(gains))]
        exchanged = list(chosen_set.fit.faults)
        exchanged[chosen_set.given + i] = slot.trials[0].fault
        changed = fault_set(fit(base.signals, exchanged, slot.trials[0].fit), chosen_set.given)
        before, after = misfits([chosen_set.fit, changed.fit]).tolist()
        before += chosen_set.widening * chosen_set.prior_loss
        after += chosen_set.widening * changed.prior_loss
        if not changed.sound or after > before + TIE_LOG_LIKELIHOOD:
            break
        chosen_set = changed
    return chosen_set, [
        _slot_with_first(slot, fault) for slot, fault in zip(slots, chosen_set.faults, strict=True)
    ]


def _trial_index(slot: Slot, fault: SensorFault) -> int:
    """Return the place of a fault among the trials of a position."""
    return [trial.fault for trial in slot.trials].index(fault)


def delay_same_channel(first: SensorFault, second: SensorFault) -> bool:
    """Return whether both faults delay the same channel: by a delay, a lag or an arm."""
    return (
        first.channel == second.channel
        and {first.kind, second.kind} <= {DELAY, LAG, ARM}
        and not (first.rare or second.rare)
    )


def equivalent_to_arm(first: SensorFault, second: SensorFault) -> bool:
    """Return whether one of two faults is the arm of an accelerometer, and the other one has the
    same effect at one airspeed. A delay or lag of the rate of the plane acts like an arm ahead; an
    arm, delay or lag of the vane acts like an arm behind.
    """
    return any(
        load.kind == ARM
        and load.channel in loads
        and other.kind in (DELAY, LAG, ARM)
        and other.channel in others
        for loads, others in PLANES
        for load, other in ((first, second), (second, first))
    )


def _slot(
    base: KinematicFit,
    chosen_set: FaultSet,
    fault: SensorFault,
    faults: Sequence[SensorFault],
    singles: Sequence[FaultTrial],
) -> Slot:
    """Return the position of a fault in a set, with all faults tried in it."""
    other_faults = [other for other in chosen_set.fit.faults if other is not fault]
    candidates = [
        candidate
        for candidate in faults
        if candidate not in other_faults
        and leaves_time_reference((*other_faults, candidate), time_references(base.signals))
    ]
    if other_faults == list(base.faults):
        others, trials = base, [trial for trial in singles if trial.fault in candidates]
    else:
        others = fit(base.signals, other_faults, base)
        trials = try_faults(others, candidates)
    misfit = misfits([others, chosen_set.fit, *(t.fit for t in trials)])
    trial_misfits, with_priors = [], []
    for trial, value in zip(trials, misfit[2:].tolist(), strict=True):
        # The accepted fault is fitted already: its trial is the set itself.
        trial_misfit = misfit[1] if trial.fault is fault else value
        trial_misfit += TIE_LOG_LIKELIHOOD * trial.fault.rare
        prior_loss = float(trial.fault.prior_loss(trial.size, trial.variance))
        trial_misfits.append(trial_misfit)
        with_priors.append(trial_misfit + chosen_set.widening * prior_loss)
    order = sorted(range(len(trials)), key=lambda i: (not _sound(trials[i]), with_priors[i]))
    gains = (misfit[0] - np.array(trial_misfits)) / chosen_set.widening
    ordered = [replace(trials[i], gain=max(float(gains[i]), 0.0)) for i in order]
    return Slot(others, tuple(ordered), (gains[order[0]] - gains)[order])


def _slot_with_first(slot: Slot, fault: SensorFault) -> Slot:
    """Return the position with the trial of a fault first, if the fault was tried there."""
    first = _trial_index(slot, fault) if fault in [trial.fault for trial in slot.trials] else 0
    order = [first, *(i for i in range(len(slot.trials)) if i != first)]
    trials = tuple(slot.trials[i] for i in order)
    return Slot(slot.others, trials, slot.losses[order] - slot.losses[first])


# ---- Search for the required sensor faults


@dataclass(frozen=True, eq=False)
class FaultSearch:
    """Result of a search.

    Attributes
    ----------
    findings : accepted faults first.
    trials : one for every fault. An accepted fault, and those that may be confused with it, are
        tried with the other accepted faults. Another delay of a delayed channel is tried in place
        of the accepted one. Any further fault is tried in addition to all accepted faults.
    fit : joint fit of the best fault of each group.
    early : time (s) by which a load would be early, where this explains more than any fault; no
        further fault is then accepted.
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
    """Return the set of faults that the records require, each with the faults that it may be
    confused with.

    Forward selection keeps several sets of each size. Each fault must gain at least
    `penalty_per_fault` under coloured residuals, and single records must agree on it. ``base`` is
    the fit of all records without faults, and ``bases`` are those of each record alone.
    """
    penalty = penalty_per_fault(settings.false_alarm, len(faults))
    chance_loss = largest_chance_loss(settings.false_alarm, len(faults))
    singles = try_faults(base, faults)
    refused: dict[SensorFault, FaultTrial] = {}
    while True:
        candidates = [fault for fault in faults if fault not in refused]
        single_fits = [t.fit for t in singles if t.fault not in refused]
        sets = grow_sets(base, single_fits, candidates, penalty, settings.max_faults)
        best = best_set_of(sets, penalty)
        early = float(best.fit.sizes[-1]) if best.early else None
        if best.early:
            best = fault_set(fit(base.signals, best.fit.faults[:-1], base), best.given)
        best = without_superfluous_faults(base, best, penalty)
        best, slots = slots_with_trials(base, best, candidates, singles)
        failing = [
            slot.trials[0]
            for slot in slots
            if not records_agree(bases, slot.others, slot.trials[0])
        ]
        if not failing:
            break
        refused |= {trial.fault: trial for trial in failing}
    groups = []
    for slot in slots:
        first, *rivals = slot.within(chance_loss)
        groups.append([first, *(t for t in rivals if records_agree(bases, slot.others, t))])
    return _search_result(faults, groups, slots, singles, refused, best.fit, early)


def _search_result(
    faults: Sequence[SensorFault],
    groups: Sequence[Sequence[FaultTrial]],
    slots: Sequence[Slot],
    singles: Sequence[FaultTrial],
    refused: dict[SensorFault, FaultTrial],
    current: KinematicFit,
    early: float | None,
) -> FaultSearch:
    """Return the result of a search from its last set, whose positions are ``slots``."""
    losses, in_place, replaced = _replacements(slots)
    # A fault that is in two groups is reported once: where it is best, else in the first group.
    grouped = {t.fault: t for group in reversed(groups) for t in group} | {
        group[0].fault: group[0] for group in groups
    }
    accepted, timed = current.faults, time_references(current.signals)
    further = [
        fault
        for fault in faults
        if fault not in grouped
        and leaves_time_reference((*accepted, fault), timed)
        and not any(delay_same_channel(fault, other) for other in accepted)
    ]
    added = {t.fault: t for t in (try_faults(current, further) if accepted else singles)}
    alone = {t.fault: t for t in singles}
    trials = {fault: {**alone, **in_place, **added, **grouped}[fault] for fault in faults}
    findings = []
    for group in groups:
        names = [trial.fault.name for trial in group]
        shares = probabilities([(t.fault, t.quantity, losses.get(t.fault, 0.0)) for t in group])
        for t in group:
            if grouped[t.fault] is t:
                finding = SensorFinding.of(
                    t.fault,
                    t.quantity,
                    t.gain,
                    supported=True,
                    group=tuple(name for name in names if name != t.fault.name),
                    lost=losses.get(t.fault, 0.0),
                    probabilities=shares,
                    instead_of="" if t is group[0] else names[0],
                )
                findings.append(finding)
    rejected = [trials[fault] for fault in faults if fault not in grouped]
    for t in sorted(rejected, key=lambda trial: trial.p_value):
        in_place_only = t.fault in replaced and t.fault not in added
        finding = SensorFinding.of(
            t.fault,
            t.quantity,
            t.gain,
            supported=False,
            group=(),
            lost=losses.get(t.fault),
            replicates=t.fault not in refused,
            instead_of=replaced[t.fault].name if in_place_only else "",
        )
        findings.append(finding)
    return FaultSearch(tuple(findings), tuple(trials.values()), current, early)


def _replacements(
    slots: Sequence[Slot],
) -> tuple[dict[SensorFault, float], dict[SensorFault, FaultTrial], dict[SensorFault, SensorFault]]:
    """Return three mappings from each fault that was tried in place of an accepted one: its least
    loss of log likelihood, the trial with this loss, and the accepted fault.
    """
    losses: dict[SensorFault, float] = {}
    trials: dict[SensorFault, FaultTrial] = {}
    replaced: dict[SensorFault, SensorFault] = {}
    for slot in slots:
        for trial, loss in zip(slot.trials, slot.losses.tolist(), strict=True):
            if loss < losses.get(trial.fault, math.inf):
                losses[trial.fault], trials[trial.fault] = loss, trial
                replaced[trial.fault] = slot.trials[0].fault
    return losses, trials, replaced
