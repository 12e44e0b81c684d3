"""One candidate added to a fitted set and tried on records that were left out: does it stand, and why not?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.statistics.normal_equations import add_normal_equations
from ident.tracing import thresholds
from ident.tracing.belief.standing import why_not
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, is_event
from ident.tracing.replication.by_record import Flight, Replication, distance_from_absence, most_telling, recordings, replicate
from ident.tracing.replication.coloured_null import coloured_gain, explained_share
from ident.tracing.replication.comparison import DIFFERING, CrossValidation
from ident.tracing.replication.each_its_own import own_values, predicted_gains, stands_by_prediction
from ident.tracing.replication.error_reduction import Reduction, reduction
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding
from ident.tracing.selection.expansion import near_absence
from ident.tracing.validation.held_out import held_out
from ident.tracing.validation.improvement import changes
from ident.whole_record.gauss_newton import Fit
from sim.declaration.proposal import Curve, Traceable


def left_out(flight: Flight, fitted: FittedModel, which: Sequence[int] | None = None) -> dict[int, Fit] | None:
    """Each record, or ``which``, predicted by the set fitted to the others, only its own initial state and biases free; None where one fails."""
    fits = {}
    for r in range(len(flight.records)) if which is None else which:
        trained = trained_without(flight, fitted, r)
        frozen = held_out(trained, [flight.records[r]], [flight.masks[r]], informed=False).frozen if trained is not None else None
        if frozen is None:
            return None
        fits[r] = frozen
    return fits


def trained_without(flight: Flight, fitted: FittedModel, r: int) -> FittedModel | None:
    """The set fitted to all records but one; None where it cannot be."""
    if len(flight.records) > thresholds.WHOLE_REFIT_UP_TO:
        return without_record(fitted, r)
    return flight.fit(fitted.effects, [other for other in range(len(flight.records)) if other != r], fitted.values)


def within_reach(fitted: FittedModel, effect: Traceable) -> list[int]:
    """Records that fly where the others do, too: beyond their range a curve fitted to the others is not known."""
    count = len(fitted.fit.layout.problems)
    if not isinstance(effect, Curve):
        return list(range(count))
    inside = []
    for r in range(count):
        others = effect.fitted_to(search_context(fitted, which=[other for other in range(count) if other != r]))
        beyond = max(others.low - effect.low, effect.high - others.high)
        if beyond <= thresholds.BEYOND_RANGE * (effect.high - effect.low):
            inside.append(r)
    return inside


def without_record(fitted: FittedModel, r: int) -> FittedModel:
    """The set as fitted to all records but one: a Gauss-Newton step from the fit of all of them, which is near where there are many."""
    fit, layout = fitted.fit, fitted.fit.layout
    normal, gradient = (part.copy() for part in fit.normal_equations())
    problem = layout.problems[r]
    weight = np.where(problem.valid, -1.0 / fit.variance[:, None], 0.0)
    add_normal_equations(normal, gradient, layout.columns(r), fit.jacobians[r], fit.residuals[r], weight)
    scale = np.sqrt(np.maximum(np.diag(normal), 0.0))
    moving = np.flatnonzero(scale > 1e-9 * np.sqrt(np.maximum(np.diag(fit.normal_equations()[0]), 1e-300)))
    inside = normal[np.ix_(moving, moving)] / np.outer(scale[moving], scale[moving])
    step = np.zeros(len(fit.theta))
    step[moving] = np.linalg.lstsq(inside, gradient[moving] / scale[moving], rcond=1e-10)[0] / scale[moving]
    return replace(fitted, fit=replace(fit, theta=np.clip(fit.theta + step, fit.problem.low, fit.problem.high)))


@dataclass(frozen=True, eq=False)
class Trial:
    """One candidate fitted beside a set, and what both predict of the records that were left out and could be asked."""

    finding: Finding
    fitted: FittedModel
    asked: Sequence[int]
    before: Sequence[Fit]
    after: Mapping[int, Fit]
    reduction: Reduction
    gain: float

    @property
    def effect(self) -> Traceable:
        return self.finding.effect

    @property
    def pairs(self) -> tuple[Sequence[Fit], Sequence[Fit]]:
        return self.before, list(self.after.values())


def weigh(flight: Flight, fitted: FittedModel, finding: Finding, before: Mapping[int, Fit]) -> CrossValidation | None:
    """One candidate tried and judged; None where it cannot be fitted, or lowers the error of the records it is fitted to by next to nothing."""
    trial = try_out(flight, fitted, finding, before)
    return judged(flight, trial) if trial is not None else None


def try_out(flight: Flight, fitted: FittedModel, finding: Finding, before: Mapping[int, Fit]) -> Trial | None:
    """One candidate beside a set: fitted to all records, and to all but each; a witness is not asked. Else as ``weigh``."""
    tries = [flight.beside(fitted, finding.effect, fitted.values, start) for start in finding.starts[:2]]
    child = min((t for t in tries if t is not None), key=lambda t: t.fit.cost, default=None)
    if child is None or child.fit.cost > fitted.fit.cost:
        child = flight.beside(fitted, finding.effect, fitted.values, near_absence(finding.effect, finding.starts[0]))
    if child is None:
        return None
    if fitted_change(fitted, child) > -thresholds.HALF_OF_IT * thresholds.WORTH:
        return None
    asked = within_reach(fitted, finding.effect)
    after = left_out(flight, child, asked) if asked else None
    if after is None:
        return None
    pairs = [before[r] for r in asked], [after[r] for r in asked]
    return Trial(finding, child, asked, pairs[0], after, reduction(*pairs), coloured_gain(*pairs))


def judged(flight: Flight, trial: Trial) -> CrossValidation:
    """Does it stand, and why not? The witness of the flight is heard."""
    effect, child, lowered, gain = trial.effect, trial.fitted, trial.reduction, trial.gain
    if lowered.total > -_worth(flight, child, effect, lowered):
        why = "it does not lower the error on records left out enough"
        return CrossValidation(effect, trial.finding, child, lowered, Replication((), False), gain, False, why, trial.after)
    if belongs_to_record(effect):
        each, copies = predicted_gains(*trial.pairs, effect), own_values(child, effect)
        gain = float(np.sum(each))
        stands, why = stands_by_prediction(each, lowered, copies)
        if recordings(flight.records) < thresholds.FEWEST_RECORDS and not effect.traits.background:
            stands, why = False, "of two records, each with its own value, nothing replicates"
    else:
        copies = replicate(flight, child, effect)
        stands, why = _replicates(lowered, copies)
    few = recordings(flight.records) < thresholds.FEWEST_RECORDS
    if stands and few and (len(trial.asked) < len(flight.records) or not _explains_most(*trial.pairs)):
        stands, why = False, "with two records it has to explain three quarters of what they leave, and half of what each does"
    if stands and distance_from_absence(child, effect) < thresholds.CLEARLY_OFF_ABSENCE:
        stands, why = False, "its parameters are not determined"
    if stands and gain < flight.settings.accept:
        stands, why = False, "a colour of the residual does as well"
    if stands and flight.witness.evidence(effect.name, most_telling(child, effect)) < -thresholds.STRONG_WITNESS:
        stands, why = False, "the kinematics speak against it"
    if stands and why_not(effect, most_telling(child, effect), child) is not None:
        stands, why = False, "its parameters are beyond belief, or open"
    return CrossValidation(effect, trial.finding, child, lowered, copies, gain, stands, why, trial.after)


def _explains_most(before: Sequence[Fit], after: Sequence[Fit]) -> bool:
    """Whether most of what could be explained of two records is, and half of each."""
    each = [explained_share([one], [two]) for one, two in zip(before, after, strict=True)]
    return explained_share(before, after) >= thresholds.MOST_OF_IT and min(each) >= thresholds.HALF_OF_IT


def _worth(flight: Flight, child: FittedModel, effect: Traceable, lowered: Reduction) -> float:
    """By how much the error has to fall: by half as much where the kinematics alone find the effect, asked only where that would matter.

    By twice as much where a record has values of its own, fitted to it also when it is left out: half of what they bring says nothing.
    """
    learnt_there = belongs_to_record(effect) and not (effect.traits.background or is_event(effect))
    whole = (thresholds.STRONGLY if learnt_there else 1.0) * thresholds.WORTH
    least = thresholds.HALF_OF_IT * whole
    asked = -whole < lowered.total <= -least
    strong = asked and flight.witness.evidence(effect.name, most_telling(child, effect)) > thresholds.STRONG_WITNESS
    return least if strong else whole


def fitted_change(fitted: FittedModel, child: FittedModel) -> float:
    """Mean over the channels of ln(rms after / rms before) on the fitted records: what is not there will not be on others."""
    change = changes(fitted.fit, child.fit)
    return float(np.mean(change)) if change.size else 0.0


def _replicates(lowered: Reduction, copies: Replication) -> tuple[bool, str]:
    """Whether it passes, and why not."""
    if lowered.total > -thresholds.BEYOND_ITS_SCATTER * lowered.scatter:
        return False, "the fall of the error on records left out is within its scatter"
    if np.any(lowered.by_channel > max(thresholds.TOLERATED_RISE, -0.5 * lowered.total) + thresholds.BEYOND_ITS_SCATTER * lowered.channel_scatter):
        return False, "one channel gets worse"
    # A short record, or one that hardly moves what the effect needs, says little by its sign: it speaks against beyond its own scatter only.
    rises = [total - thresholds.BEYOND_ITS_SCATTER * scatter for total, scatter in zip(lowered.by_record, lowered.record_scatter, strict=True)]
    if max(rises) > thresholds.TOLERATED_RISE:
        return False, "it makes a record worse"
    if 2 * sum(total < 0.0 for total in lowered.by_record) <= len(lowered.by_record):
        return False, "it helps on too few records"
    if not copies.agrees:
        return False, DIFFERING
    return True, "cross-validated"
