"""Sets of sensor faults fitted jointly: which are sound, how they compare, which one the records ask for, and what their times count from.

The kinematics see differences of times only, so that one channel has to stand for the time of all.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ident.compatibility.estimates import smoother_sigmas
from ident.compatibility.faults import DELAY, LAG, SensorFault
from ident.compatibility.fitting import Fit, fit, least_misfit
from ident.compatibility.instruments import instrumented, weigher
from ident.compatibility.signals import Signals
from ident.compatibility.trials import one_step

_BREADTH = 5  # sets of one size that are kept, and faults that are tried beside each of them
TIE = 0.5  # of log likelihood: what two fits of the same thing may differ by
_WORTH = 2.5  # first-order gain from which a fault is fitted in full
_TIMED = ("alpha", "q", "nz", "theta")  # what the relations tie within a fraction of a second; speed changes too slowly to be a clock


@dataclass(frozen=True, eq=False)
class FaultSet:
    """A joint fit of some faults. ``widening`` of variances by the colour of what is left, the mean over its faults. ``sound``: each fault is
    ``determined``, of a size worth having, within its bounds, and of a sign that can be. ``early``: its last is a load ahead of its time.
    ``given``: how many faults of the fit, its first ones, are no choice of the set. ``surprise``: log likelihood lost by its sizes a priori.
    """

    found: Fit
    widening: float
    sound: bool
    determined: bool = True
    early: bool = False
    given: int = 0
    surprise: float = 0.0

    @property
    def faults(self) -> tuple[SensorFault, ...]:
        return self.found.faults[self.given :]


def charge_of(false_alarm: float, count: int) -> float:
    """What a fault has to gain in log likelihood: ln of how many there are to choose from, and -ln of the share of false alarms.

    A gain has an exponential tail or a shorter one where the fault is absent, so that the best of ``count`` exceeds this in fewer than
    ``false_alarm`` of clean sets of records.
    """
    return math.log(max(count, 1)) - math.log(false_alarm)


def fault_set(found: Fit, given: int = 0, *, early: bool = False) -> FaultSet:
    """A fit judged as a set of faults, of which the first few are ``given``."""
    k = len(found.faults) - given
    if not k:
        return FaultSet(found, 1.0, sound=True, given=given)
    sigmas = smoother_sigmas(found)
    widening = sigmas.widening[-k:]
    variances = np.diag(sigmas.covariance)[-k:] * widening
    determined = all(0.0 < variance < fault.plausible**2 for fault, variance in zip(found.faults[given:], variances.tolist(), strict=True))
    possible = all(_possible(fault, size) for fault, size in zip(found.faults[given:], found.sizes[given:].tolist(), strict=True))
    sized = zip(found.faults[given:], found.sizes[given:].tolist(), variances.tolist(), strict=True)
    surprise = float(sum(fault.surprise(size, variance) for fault, size, variance in sized))
    return FaultSet(found, float(np.mean(widening)), determined and possible, determined, early, given, surprise)


def _possible(fault: SensorFault, size: float) -> bool:
    return fault.worth < abs(size) < 0.99 * fault.largest and (size > 0 or not fault.one_sided)


def misfits(fits: Sequence[Fit]) -> np.ndarray:
    """Minus the log likelihood of each fit of the same records; with instruments the projected misfit, all under the noise of the best."""
    if not instrumented(fits[0].signals):
        return np.array([each.cost for each in fits])
    noise = min(fits, key=lambda each: each.cost).noise
    whiteners = [weigher(s, noise) for s in fits[0].signals]
    return np.array([least_misfit(each, whiteners) for each in fits])


def grow(base: Fit, singles: Sequence[Fit], faults: Sequence[SensorFault], charge: float, most: int) -> list[FaultSet]:
    """Sets of 0, 1, ... ``most`` faults, a few of each size, begun with the best of ``singles``: forward selection that keeps several ways open.

    It ends where the best set of one more fault does not gain ``charge`` over the best without. Where no control is recorded, sets with a load
    ahead of its time are among them, marked.
    """
    given = len(base.faults)
    out = [fault_set(base, given)]
    level = _kept(singles, given)
    before, blind = base, not instrumented(base.signals)
    for count in range(1, most + 1):
        if not level:
            break
        if blind:
            out += _early(before, faults, given)
        out += level
        best = level[0]
        here, there = misfits([before, best.found]).tolist()
        if count == most or here - there < charge * best.widening:
            break
        before = best.found
        fits: dict[frozenset[SensorFault], Fit] = {}
        for each in level:
            for found in _extended(each.found, faults, fits):
                fits[frozenset(found.faults)] = found
        level = _kept(list(fits.values()), given)
    return out


def chosen(sets: Sequence[FaultSet], charge: float) -> FaultSet:
    """The set of greatest likelihood less ``charge`` for each of its faults; a load ahead of its time has to do better than what can be."""
    misfit = misfits([each.found for each in sets])
    widening = sets[int(np.argmin(misfit))].widening
    # Alpha and q late by as much are an early load, to rounding.
    score = [
        value / widening + charge * len(each.faults) + TIE * each.early + each.surprise for each, value in zip(sets, misfit.tolist(), strict=True)
    ]
    return sets[int(np.argmin(score))]


def needed(base: Fit, found: FaultSet, charge: float) -> FaultSet:
    """The set less every fault without which the others do nearly as well."""
    while len(found.faults) > 1:
        less = [fit(base.signals, [other for other in found.found.faults if other is not fault], base) for fault in found.faults]
        misfit = misfits([found.found, *less])
        losses = (misfit[1:] - misfit[0]) / found.widening
        least = int(np.argmin(losses))
        if losses[least] >= charge:
            break
        found = fault_set(less[least], found.given)
    return found


def _kept(fits: Sequence[Fit], given: int) -> list[FaultSet]:
    """The best few sound ones, best first."""
    if not fits:
        return []
    out: list[FaultSet] = []
    for i in np.argsort(misfits(fits), kind="stable"):
        judged = fault_set(fits[i], given)
        if judged.sound:
            out.append(judged)
        if len(out) == _BREADTH:
            break
    return out


def _extended(found: Fit, faults: Sequence[SensorFault], done: dict[frozenset[SensorFault], Fit]) -> list[Fit]:
    """Fits of a set with one more fault each: those that promise most to first order."""
    timed = clocks(found.signals)
    free = [fault for fault in faults if fault not in found.faults and leaves_a_reference((*found.faults, fault), timed)]
    quick = sorted(zip(free, one_step(found, free), strict=True), key=lambda pair: pair[1].cost)
    worth = [fault for fault, first in quick[:_BREADTH] if found.cost - first.cost > _WORTH]
    return [fit(found.signals, (*found.faults, fault), found) for fault in worth if frozenset((*found.faults, fault)) not in done]


def _early(found: Fit, faults: Sequence[SensorFault], given: int) -> list[FaultSet]:
    """A load recorded before it happens, beside a set; which no sensor does.

    A gust moves the vane and the load at once, the path only later: the load then seems early, and alpha and q late.
    """
    ahead = [fault for fault in faults if fault.channel == "nz" and fault.kind in (DELAY, LAG) and fault not in found.faults]
    sets = [fault_set(fit(found.signals, (*found.faults, fault), found), given, early=True) for fault in ahead]
    return [each for each in sets if each.determined and each.found.sizes[-1] < 0]


def clocks(signals: Sequence[Signals]) -> tuple[str, ...]:
    """Channels of which one at least has to be on time.

    Where no control is recorded the load is none of them: a gust moves it before the path, and alpha and q then seem late by as much.
    """
    return tuple(name for name in _TIMED if name in signals[0].channels and (name != "nz" or instrumented(signals)))


def late_channels(faults: Iterable[SensorFault]) -> set[str]:
    """Channels that these faults make late."""
    return {fault.channel for fault in faults if fault.kind in (DELAY, LAG) and fault.channel in _TIMED}


def leaves_a_reference(faults: Sequence[SensorFault], timed: Sequence[str]) -> bool:
    """Whether one of the clocks ``timed`` is on time beside these faults: with all of them late, only differences of times are there to be fitted.

    Nothing is recorded before it happens, so that what remains is the channel that is least late.
    """
    # An accelerometer ahead is a lag of q.
    late = late_channels(faults) | {"q" for fault in faults if fault.rare}
    return not timed or not set(timed) <= late


def reference_sentence(faults: Sequence[SensorFault], timed: Sequence[str]) -> str:
    """Which of the clocks ``timed`` the times of these faults count from; nothing where no channel is late."""
    late = late_channels(faults)
    on_time = [name for name in timed if name not in late]
    if not late or not on_time:
        return ""
    if len(on_time) == 1:
        first = f"times count from {on_time[0]}, the channel that is least late"
    else:
        first = f"times count from {', '.join(on_time[:-1])} and {on_time[-1]}, which agree"
    return f"{first}: what all channels are late by against the inputs, kinematics cannot see"
