"""Search for sensor faults in six degrees of freedom."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from types import MappingProxyType

import numpy as np

from ident.compatibility.fault_sets import (
    TIE_LOG_LIKELIHOOD,
    delay_same_channel,
    equivalent_to_arm,
    largest_chance_loss,
    penalty_per_fault,
)
from ident.compatibility.fitting import KinematicFit, instrumented
from ident.compatibility.kinematics import DELAY, DRIFT, LAG, SensorFault
from ident.compatibility.signals import KinematicSignals
from ident.compatibility.six_degrees.fitting import (
    LEAST_SECANT,
    FaultLinearisation,
    NormalEquations,
    fit,
    linearise_faults,
    negative_log_likelihoods,
    output_error_equations,
)
from ident.compatibility.trials import (
    CONTRADICTION_P_VALUE,
    LEAST_FAULT_SIGMAS,
    CompatibilitySettings,
)

# ---- Sets of sensor faults, fitted to first order

LOADS = ("nz", "az", "ny", "ay")
_SLOW = ("airspeed", "height", "altitude")  # channels that change too slowly to show time shifts
# added to the unit diagonal of scaled information: nearly equal columns then give a large variance
_RIDGE = 1e-9
_BOUND_SHARE = 0.99  # a size above this share of its bound is at the bound
_MOST_PAIRS = 96  # most pairs to which a third fault is added; more would double the cost


@dataclass(frozen=True, eq=False)
class FittedSets:
    """M sets of s faults each, fitted to first order.

    Attributes
    ----------
    members : ``(M, s)`` positions of the faults.
    sizes : ``(M, s)``.
    white : ``(M, s)`` variances of the sizes for white residuals.
    widening : ``(M, s)`` factors of the variances for coloured residuals.
    gain : ``(M,)`` gain of log likelihood for white residuals.
    sound : ``(M,)`` whether every fault is determined, notable, within its bounds and of a possible
        sign.
    early : ``(M,)`` whether the set would be sound if a load could have a negative delay.
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
        """``(M, s)`` variances corrected for coloured residuals."""
        return self.white * self.widening


def fit_sets(
    normal: NormalEquations,
    faults: Sequence[SensorFault],
    members: np.ndarray | Sequence[Sequence[int]],
    *,
    early: bool = False,
) -> FittedSets:
    """Return the fits of sets of faults to first order.

    Parameters
    ----------
    members : ``(M, s)`` positions of the faults of each set.
    early : whether sets with a negative delay of a load are marked; else `FittedSets.early` is
        False.
    """
    members = np.atleast_2d(np.asarray(members, dtype=int))
    rows, s = members[:, :, None], members.shape[1]
    if not s:
        empty = np.empty((len(members), 0))
        sound = np.ones(len(members), dtype=bool)
        return FittedSets(members, empty, empty, empty, np.zeros(len(members)), sound, ~sound)
    diagonal = np.diag(normal.information)
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))[members]
    scales = scale[:, :, None] * scale[:, None, :]
    information = normal.information[rows, members[:, None, :]] * scales + _RIDGE * np.eye(s)
    inverse = np.linalg.inv(information) * scales
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
    plausible = np.array([fault.plausible for fault in faults])[members]
    smallest = np.array([fault.smallest_finding for fault in faults])[members]
    largest = np.array([_BOUND_SHARE * fault.largest for fault in faults])[members]
    one_sided = np.array([fault.one_sided for fault in faults])[members]
    load_time = np.array(
        [fault.channel in LOADS and fault.kind in (DELAY, LAG) for fault in faults]
    )[members]
    determined = (diagonal[members] > 0) & (white * widening < plausible**2)
    notable = (np.abs(sizes) > smallest) & (np.abs(sizes) < largest)
    possible_sign = (sizes > 0) | ~one_sided
    allowed = (determined & notable).all(axis=1) & _leaves_time_reference(faults, members)
    sound = allowed & possible_sign.all(axis=1)
    early_load = allowed & ~sound & (possible_sign | load_time).all(axis=1)
    gain = 0.5 * np.einsum("mi,mi->m", gradient, sizes)
    return FittedSets(members, sizes, white, widening, gain, sound, early_load & early)


def best_set(
    normal: NormalEquations,
    faults: Sequence[SensorFault],
    candidates: Sequence[int],
    penalty: float,
    most: int,
    *,
    early: bool,
) -> tuple[FittedSets, int]:
    """Return the fits of all compared sets with the same number of faults as the best set, and the
    row of the best set in them.

    The best set has the greatest gain of log likelihood under coloured residuals, less ``penalty``
    for each fault and less the loss by the priors of the sizes (`SensorFault.prior_loss`). All sets
    of up to two faults are compared, and larger sets that contain one of the best smaller sets.

    Parameters
    ----------
    candidates : positions of the faults that a set may contain.
    penalty : gain of log likelihood that is required of each fault.
    most : largest number of faults of a set.
    early : whether a set may have a negative delay of a load.
    """
    fits = [fit_sets(normal, faults, [()], early=early)]
    members: list[tuple[int, ...]] = [(i,) for i in candidates]
    for size in range(1, most + 1):
        if not members:
            break
        sets = fit_sets(normal, faults, members, early=early)
        fits.append(sets)
        if size == 1:
            members = [*combinations(candidates, 2)]
        elif size < most:
            order = np.argsort(-np.where(np.isfinite(sets.gain), sets.gain, -np.inf))[:_MOST_PAIRS]
            bases = {tuple(row) for row in sets.members[order].tolist()}
            members = sorted(
                {tuple(sorted((*base, i))) for base in bases for i in candidates if i not in base}
            )
    return _best_by_score(fits, faults, penalty)


def without_weak_faults(
    normal: NormalEquations, faults: Sequence[SensorFault], members: tuple[int, ...], penalty: float
) -> tuple[int, ...]:
    """Return a set without its weak faults. A fault is weak if it adds less than ``penalty`` to the
    gain of the others, under coloured residuals. The weakest fault is removed first.
    """
    while members:
        whole = fit_sets(normal, faults, [members])
        # one fault less in each row
        smaller = np.array([[j for j in members if j != i] for i in members], dtype=int)
        gains_without = [fit_sets(normal, faults, row[None]).gain[0] for row in smaller]
        gains = (whole.gain[0] - np.array(gains_without)) / whole.widening[0]
        weakest = int(np.argmin(gains))
        if gains[weakest] >= penalty:
            break
        members = tuple(i for k, i in enumerate(members) if k != weakest)
    return members


def _best_by_score(
    fault_sets: Sequence[FittedSets], faults: Sequence[SensorFault], penalty: float
) -> tuple[FittedSets, int]:
    """Return the fits that contain the set with the lowest score, and its row. The score is the
    penalty of a set minus its gain; the empty set has the score zero.

    All gains are divided by the variance factor (``widening``) of the sound set with the greatest
    gain.
    """
    sound_gains = [np.where(sets.sound, sets.gain, 0.0) for sets in fault_sets]
    best = int(np.argmax([np.max(gains) for gains in sound_gains]))
    widening = 1.0
    if fault_sets[best].members.shape[1]:
        widening = float(np.mean(fault_sets[best].widening[int(np.argmax(sound_gains[best]))]))
    rare = np.array([fault.rare for fault in faults])
    chosen, least = (fault_sets[0], 0), 0.0
    for sets in fault_sets[1:]:
        score = (
            penalty * sets.members.shape[1]
            - sets.gain / widening
            + TIE_LOG_LIKELIHOOD * (sets.early + rare[sets.members].sum(axis=1))
        )
        score = score + prior_losses(sets, faults)
        score = np.where(sets.sound | sets.early, score, np.inf)
        row = int(np.argmin(score))
        if score[row] < least:
            chosen, least = (sets, row), float(score[row])
    return chosen


def prior_losses(sets: FittedSets, faults: Sequence[SensorFault]) -> np.ndarray:
    """Return the loss of log likelihood ``(M,)`` by the priors of the sizes, for each set."""
    spread = np.array([fault.spread for fault in faults])[sets.members]
    return np.asarray(np.sum(0.5 * sets.sizes**2 / (spread**2 + sets.variances), axis=1))


def timed_channels(channels: Sequence[str]) -> tuple[str, ...]:
    """Return the channels that change fast enough to show a delay of a fraction of a second. One of
    them must be on time: it is the time reference.
    """
    return tuple(name for name in channels if name not in _SLOW)


def _leaves_time_reference(faults: Sequence[SensorFault], members: np.ndarray) -> np.ndarray:
    """Return ``(M,)`` True where a set leaves at least one timed channel without delay and lag."""
    delayable = tuple(dict.fromkeys(fault.channel for fault in faults if fault.kind == DELAY))
    timed = timed_channels(delayable)
    late = np.array(
        [
            [fault.kind in (DELAY, LAG) and fault.channel == name for name in timed]
            for fault in faults
        ]
    )
    if not len(timed):
        return np.ones(len(members), dtype=bool)
    return ~np.any(late[members], axis=1).all(axis=1)


_MOST_ROUNDS = 5  # most repetitions of the choice of a set and its fit
NO_LOSSES: Mapping[tuple[int, int], float] = MappingProxyType({})
SECANT_STEP = 0.05  # s, secant of a time shift without an estimate
_LONGEST_SECANT = 0.3  # s
_LEAST_SHIFT = 1e-3  # s, a smaller estimate of a time shift gives no secant


@dataclass(frozen=True, eq=False)
class SixDegreeSearch:
    """Result of a search. All positions are those of faults in ``linear.faults``.

    Attributes
    ----------
    linear : linearisation at the joint fit of the accepted faults.
    accepted : positions of the accepted faults.
    groups : for each accepted fault, the positions of it and of its alternatives, each with the
        loss of log likelihood.
    refused : positions of the faults on which records disagree.
    early : name of a load and its negative delay, s, if this explains more than any fault; else
        None.
    widening : factor of the variances for coloured residuals, as a mean over the accepted faults.
    output_error : normal equations of each record by output error.
    common : positions of the faults that all records may share.
    exchange_losses : (accepted fault, replacement) -> loss of log likelihood by the exchange, from
        full fits, for the replacements of `_best_delay_exchange`.
    """

    linear: FaultLinearisation
    accepted: tuple[int, ...]
    groups: tuple[tuple[tuple[int, float], ...], ...]
    refused: frozenset[int]
    early: tuple[str, float] | None
    widening: float
    output_error: tuple[NormalEquations, ...]
    common: tuple[int, ...]
    exchange_losses: Mapping[tuple[int, int], float] = field(default_factory=dict)


def search(
    signals: Sequence[KinematicSignals],
    base: KinematicFit,
    faults: Sequence[SensorFault],
    settings: CompatibilitySettings,
) -> SixDegreeSearch:
    """Return the set of faults that the records require, each with its alternatives. ``base`` is
    the fit without faults.
    """
    # A drift belongs to one record.
    common = [i for i, fault in enumerate(faults) if len(signals) == 1 or fault.kind != DRIFT]
    penalty, early = penalty_per_fault(settings.false_alarm, len(common)), not instrumented(signals)
    chance_loss = largest_chance_loss(settings.false_alarm, len(common))
    refused: set[int] = set()
    while True:
        linear, members, early_load, exchange_losses = _converged_sets(
            signals,
            base,
            faults,
            [i for i in common if i not in refused],
            penalty,
            settings.max_faults,
            early,
        )
        failing = {i for i in members if not _records_agree(linear, members, i)}
        if not failing:
            break
        # Confusable faults fail together, so that they are refused together.
        refused |= failing
        for i in failing:
            for j in confusable_faults(linear, members, i, chance_loss, common, exchange_losses):
                if not _records_agree(linear, _with_replacement(members, i, j), j):
                    refused.add(j)
    sets = fit_sets(linear.joint, faults, [members])
    widening = float(np.mean(sets.widening)) if members else 1.0
    candidates = [i for i in common if i not in refused]
    groups = tuple(
        _group(linear, members, i, chance_loss, widening, candidates, exchange_losses)
        for i in members
    )
    return SixDegreeSearch(
        linear,
        members,
        groups,
        frozenset(refused),
        early_load,
        widening,
        tuple(output_error_equations(linear, r) for r in range(len(signals))),
        tuple(common),
        exchange_losses,
    )


def _converged_sets(
    signals: Sequence[KinematicSignals],
    base: KinematicFit,
    faults: Sequence[SensorFault],
    candidates: Sequence[int],
    penalty: float,
    most: int,
    early: bool,
) -> tuple[
    FaultLinearisation, tuple[int, ...], tuple[str, float] | None, Mapping[tuple[int, int], float]
]:
    """Choose and fit sets in turn until one repeats, then replace faults by others with nearly the
    same effect where that is likelier.

    Return the results of `_choose_and_fit`, and the losses of `_best_delay_exchange`.
    """
    linear, members, early_load = _choose_and_fit(
        signals, base, (), faults, candidates, penalty, most, early
    )
    likeliest, exchange_losses = _best_delay_exchange(signals, linear, members, candidates)
    if likeliest[1] != members:
        linear, members, early_load = _choose_and_fit(
            signals, *likeliest, faults, candidates, penalty, most, early
        )
        _, exchange_losses = _best_delay_exchange(signals, linear, members, candidates)
    return linear, members, early_load, exchange_losses


def _choose_and_fit(
    signals: Sequence[KinematicSignals],
    kinematic_fit: KinematicFit,
    members: tuple[int, ...],
    faults: Sequence[SensorFault],
    candidates: Sequence[int],
    penalty: float,
    most: int,
    early: bool,
) -> tuple[FaultLinearisation, tuple[int, ...], tuple[str, float] | None]:
    """Choose and fit sets in turn, starting from a fit of the faults ``members``.

    Return the linearisation at the last fit, the faults of this fit, and the name of a load with
    its negative delay, s, if the last choice has one; else None.
    """
    secants, early_load = np.full(len(faults), SECANT_STEP), None
    secants[list(members)] = [
        _secant(size) for size in kinematic_fit.sizes.tolist()[: len(members)]
    ]
    for turn in range(_MOST_ROUNDS):
        linear = linearise_faults(kinematic_fit, faults, secants)
        normal = linear.joint
        if not turn and not members:
            # Without fitted faults the residual contains their effects: its colour is not that of
            # the noise.
            normal = normal._replace(scatter=normal.information)
        sets, row = best_set(normal, faults, candidates, penalty, most, early=early)
        chosen, early_load = tuple(int(i) for i in sets.members[row]), None
        if sets.early[row]:
            negative = [
                k for k, i in enumerate(chosen) if sets.sizes[row, k] < 0 and faults[i].one_sided
            ]
            first = negative[0]
            early_load = (faults[chosen[first]].channel, float(sets.sizes[row, first]))
            chosen = tuple(i for k, i in enumerate(chosen) if k not in negative)
        chosen = without_weak_faults(normal, faults, chosen, penalty)
        if set(chosen) == set(members) and (turn > 1 or not members):
            break
        if set(chosen) != set(members):
            kinematic_fit = fit(signals, [faults[i] for i in chosen], kinematic_fit)
        members = chosen
        secants = _secants_of_variants(linear, chosen)
        secants[list(chosen)] = [_secant(size) for size in kinematic_fit.sizes.tolist()]
    else:
        linear = linearise_faults(kinematic_fit, faults, secants)
    return linear, members, early_load


def _secant(size: float) -> float:
    """Return the secant, s, for a time shift of estimated size, s."""
    return size if abs(size) > _LEAST_SHIFT else SECANT_STEP


def _best_delay_exchange(
    signals: Sequence[KinematicSignals],
    linear: FaultLinearisation,
    members: Sequence[int],
    candidates: Sequence[int],
) -> tuple[tuple[KinematicFit, tuple[int, ...]], dict[tuple[int, int], float]]:
    """Compare a set with its variants. In a variant, another fault that delays the same channel
    (`delay_same_channel`), or that is equivalent to the arm of an accelerometer
    (`equivalent_to_arm`), replaces one fault.

    Return the fit and the faults of the likeliest of these sets, with the priors of sizes; and a
    mapping (replaced fault, replacement) -> loss of log likelihood without these priors.

    Full fits are needed: a first-order comparison uses the noise of the accepted variant, which
    includes its own misfit, and neglects that a delay also acts on the contribution of an arm.
    """
    kinematic_fit, faults = linear.fit, linear.faults
    places = [
        (place, i, j) for place, i in enumerate(members) for j in candidates if j not in members
    ]
    pairs = [
        (place, j)
        for place, i, j in places
        if delay_same_channel(faults[i], faults[j]) or equivalent_to_arm(faults[i], faults[j])
    ]
    sets = [tuple(members), *((*members[:place], j, *members[place + 1 :]) for place, j in pairs)]
    fits = [
        kinematic_fit,
        *(fit(signals, [faults[k] for k in chosen], kinematic_fit) for chosen in sets[1:]),
    ]
    if not pairs:
        return (kinematic_fit, sets[0]), {}
    costs = negative_log_likelihoods(fits)
    accepted = fit_sets(linear.joint, faults, [members])
    widening = float(np.mean(accepted.widening))
    losses_by_priors = [
        sum(
            float(fault.prior_loss(size, 0.0))
            for fault, size in zip(variant.faults, variant.sizes.tolist(), strict=True)
        )
        for variant in fits
    ]
    best = int(np.argmin(costs + widening * np.array(losses_by_priors)))
    return (fits[best], sets[best]), {
        (members[place], j): float(loss)
        for (place, j), loss in zip(pairs, costs[1:] - costs[0], strict=True)
    }


def _secants_of_variants(linear: FaultLinearisation, members: Sequence[int]) -> np.ndarray:
    """Return the secants ``(k,)`` of all faults. The secant of a fault is its size where it
    replaces a member of the set; of several replacements, that with the greatest gain counts.
    """
    secants = np.full(len(linear.faults), SECANT_STEP)
    greatest_gains = np.full(len(linear.faults), -math.inf)
    for replaced in members or (None,):
        others = [i for i in members if i != replaced]
        rows = np.array([[*others, i] for i in range(len(linear.faults)) if i not in others])
        sets = fit_sets(linear.joint, linear.faults, rows)
        for i, gain, size in zip(rows[:, -1], sets.gain, sets.sizes[:, -1], strict=True):
            if gain > greatest_gains[i]:
                greatest_gains[i], secants[i] = gain, size
    return np.copysign(np.clip(np.abs(secants), LEAST_SECANT, _LONGEST_SECANT), secants)


def _records_agree(linear: FaultLinearisation, members: Sequence[int], i: int) -> bool:
    """Return whether single records agree on the size of fault ``i``, and their weighted mean is
    significant with the sign of the joint fit. The other faults keep their joint sizes.
    """
    from scipy.special import chdtrc

    if len(linear.smoother) < 2:
        return True
    values, weights = _values_by_record(linear, members, i)
    determined = weights > linear.faults[i].plausible ** -2
    if np.count_nonzero(determined) < 2:
        return False
    v, w = values[determined], weights[determined]
    mean, std = float(np.sum(w * v) / np.sum(w)), 1.0 / math.sqrt(float(np.sum(w)))
    joint = fit_sets(linear.joint, linear.faults, [members])
    sign = math.copysign(1.0, joint.sizes[0, list(members).index(i)])
    agree = float(chdtrc(len(v) - 1.0, float(np.sum(w * (v - mean) ** 2)))) > CONTRADICTION_P_VALUE
    return agree and mean * sign > LEAST_FAULT_SIGMAS * std


def _values_by_record(
    linear: FaultLinearisation, members: Sequence[int], i: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the size of fault ``i`` in each of R records, ``(R,)``, and its inverse variances."""
    sizes = fit_sets(linear.joint, linear.faults, [members]).sizes[0]
    values, weights = [], []
    for normal in linear.smoother:
        information = normal.information[i, i]
        if information <= 0:
            values.append(0.0)
            weights.append(information)
            continue
        part_of_others = sum(
            normal.information[i, j] * size
            for j, size in zip(members, sizes.tolist(), strict=True)
            if j != i
        )
        widening = max(normal.scatter[i, i] / information, 1.0)
        values.append((normal.gradient[i] - part_of_others) / information)
        weights.append(information / widening)
    return np.array(values), np.array(weights)


def _group(
    linear: FaultLinearisation,
    members: Sequence[int],
    i: int,
    chance_loss: float,
    widening: float,
    candidates: Sequence[int],
    exchange_losses: Mapping[tuple[int, int], float],
) -> tuple[tuple[int, float], ...]:
    """Return fault ``i`` and its alternatives, each with its loss under coloured residuals."""
    losses = confusable_faults(
        linear, members, i, chance_loss * widening, candidates, exchange_losses
    )
    return (
        (i, 0.0),
        *(
            (j, loss / widening)
            for j, loss in losses.items()
            if _records_agree(linear, _with_replacement(members, i, j), j)
        ),
    )


def confusable_faults(
    linear: FaultLinearisation,
    members: Sequence[int],
    i: int,
    chance_loss: float,
    candidates: Sequence[int],
    exchange_losses: Mapping[tuple[int, int], float] = NO_LOSSES,
) -> dict[int, float]:
    """Return the faults that may be confused with accepted fault ``i``: position -> loss of log
    likelihood where the fault replaces it, the smallest loss first.

    Parameters
    ----------
    chance_loss : largest loss that may be due to chance.
    candidates : positions of the faults that are tried.
    exchange_losses : (accepted fault, replacement) -> loss from full fits.
    """
    rivals = [j for j in candidates if j not in members]
    if not rivals:
        return {}
    replaced = np.array([_with_replacement(members, i, j) for j in rivals])
    sets = fit_sets(linear.joint, linear.faults, replaced)
    accepted = fit_sets(linear.joint, linear.faults, np.array([_with_replacement(members, i, i)]))
    losses = (
        accepted.gain[0]
        - sets.gain
        + TIE_LOG_LIKELIHOOD * np.array([linear.faults[j].rare for j in rivals])
    )
    for k, j in enumerate(rivals):
        if (i, j) in exchange_losses:
            # Of two faults with equal effect, the data may prefer the less common one.
            least = -np.inf if equivalent_to_arm(linear.faults[i], linear.faults[j]) else 0.0
            losses[k] = max(exchange_losses[i, j], least)
    return {
        rivals[k]: float(losses[k])
        for k in np.argsort(losses)
        if losses[k] <= chance_loss and sets.sound[k]
    }


def _with_replacement(members: Sequence[int], i: int, j: int) -> tuple[int, ...]:
    """Return the set with fault ``i`` replaced by fault ``j``, which is the last one."""
    return (*(k for k in members if k != i), j)
