"""Faults that the records do not tell from one that stands: those that gain as much within chance, in its place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.compatibility.fault_sets import TIE, FaultSet, clocks, fault_set, leaves_a_reference, misfits
from ident.compatibility.faults import ARM, BOOM, DELAY, LAG, PACKAGE, SensorFault
from ident.compatibility.fitting import Fit, fit
from ident.compatibility.result import Quantity
from ident.compatibility.trials import Trial, tried

ALIKE = ((BOOM, PACKAGE), ("alpha", "nz", "az"), ("beta", "ny", "ay"))


@dataclass(frozen=True, eq=False)
class Slot:
    """One place of a set: every fault tried in it beside the ``others``, the best first; ``losses (k,)`` of log likelihood against the best."""

    others: Fit
    trials: tuple[Trial, ...]
    losses: np.ndarray

    def within(self, chance: float) -> list[Trial]:
        """The best and those that are not told from it: sound faults that lose no more than ``chance``."""
        pairs = list(zip(self.trials, self.losses.tolist(), strict=True))
        return [self.trials[0], *(t for t, lost in pairs[1:] if lost <= chance and t.told and (t.size > 0 or not t.fault.one_sided))]


def chance_of(false_alarm: float, count: int) -> float:
    """Log likelihood by which the true one of ``count`` faults loses to another in no more than ``false_alarm`` of cases.

    Where one of two faults is true and the traces are a distance d apart, in standard deviations, the other's advantage is normal with mean
    -d^2/2 and variance d^2. It exceeds x with the greatest chance at d = sqrt(2 x): the tail of the normal distribution beyond sqrt(2 x),
    however alike the two are. So 2 x is the square of the quantile, shared among the rivals.
    """
    from scipy.special import ndtri

    return 0.5 * float(ndtri(false_alarm / max(count, 2))) ** 2


def probabilities(among: Sequence[tuple[SensorFault, Quantity, float]]) -> dict[str, float]:
    """Probability of each of some faults, one of which is there, by name: from its estimate and the log likelihood that is lost with it."""
    scores = np.array([-lost - float(fault.surprise(size.value - fault.offset, size.std**2)) for fault, size, lost in among])
    weights = np.exp(scores - np.max(scores))
    return dict(zip((fault.name for fault, _, _ in among), (weights / np.sum(weights)).tolist(), strict=True))


def slots_of(base: Fit, found: FaultSet, faults: Sequence[SensorFault], singles: Sequence[Trial]) -> tuple[FaultSet, list[Slot]]:
    """The places of a set, each with all faults in it; where another does better in one, it takes the place, and all is looked at again.

    ``singles`` : every fault tried beside ``base`` alone.
    """
    for _ in range(3):
        slots = [_slot(base, found, fault, faults, singles) for fault in found.faults]
        better = [(i, slot) for i, slot in enumerate(slots) if slot.trials[0].fault is not found.faults[i]]
        if not better:
            break
        i, slot = max(better, key=lambda pair: pair[1].losses[[t.fault for t in pair[1].trials].index(found.faults[pair[0]])])
        chosen = list(found.found.faults)
        chosen[found.given + i] = slot.trials[0].fault
        changed = fault_set(fit(base.signals, chosen, slot.trials[0].found), found.given)
        before, after = misfits([found.found, changed.found]).tolist()
        before, after = before + found.widening * found.surprise, after + found.widening * changed.surprise
        if not changed.sound or after > before + TIE:
            break
        found = changed
    return found, [_led_by(slot, fault) for slot, fault in zip(slots, found.faults, strict=True)]


def same_lateness(one: SensorFault, other: SensorFault) -> bool:
    """Whether both make the same channel late, in different ways."""
    return one.channel == other.channel and {one.kind, other.kind} <= {DELAY, LAG, ARM} and not (one.rare or other.rare)


def same_trace(one: SensorFault, other: SensorFault) -> bool:
    """Whether two arms ahead leave the same trace, the one where the other is behind: of a vane, and of the accelerometer across its flow."""
    channels = {one.channel, other.channel}
    return one.kind == other.kind == ARM and any(vane in channels and channels & {*loads} for vane, *loads in ALIKE)


def _slot(base: Fit, found: FaultSet, fault: SensorFault, faults: Sequence[SensorFault], singles: Sequence[Trial]) -> Slot:
    rest = [other for other in found.found.faults if other is not fault]
    free = [each for each in faults if each not in rest and leaves_a_reference((*rest, each), clocks(base.signals))]
    if rest == list(base.faults):
        others, trials = base, [trial for trial in singles if trial.fault in free]
    else:
        others = fit(base.signals, rest, base)
        trials = tried(others, free)
    misfit = misfits([others, found.found, *(t.found for t in trials)])
    # The fault that stands has been fitted as long as any: its fit in the set serves.
    here = [misfit[1] if t.fault is fault else value for t, value in zip(trials, misfit[2:].tolist(), strict=True)]
    here = [value + TIE * t.fault.rare for t, value in zip(trials, here, strict=True)]
    usual = [value + found.widening * float(t.fault.surprise(t.size, t.variance)) for t, value in zip(trials, here, strict=True)]
    sound = [t.told and (t.size > 0 or not t.fault.one_sided) for t in trials]
    order = sorted(range(len(trials)), key=lambda i: (not sound[i], usual[i]))
    gains = (misfit[0] - np.array(here)) / found.widening
    led = [replace(trials[i], gain=max(float(gains[i]), 0.0)) for i in order]
    return Slot(others, tuple(led), (gains[order[0]] - gains)[order])


def _led_by(slot: Slot, fault: SensorFault) -> Slot:
    """The slot with a fault in front."""
    at = [t.fault for t in slot.trials].index(fault) if fault in [t.fault for t in slot.trials] else 0
    order = [at, *(i for i in range(len(slot.trials)) if i != at)]
    return Slot(slot.others, tuple(slot.trials[i] for i in order), slot.losses[order] - slot.losses[at])
