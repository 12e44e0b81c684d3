"""Which of the cross-validated effects is chosen, which would do as well, and when a guard forbids any."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record
from ident.tracing.equivalents import misfit_to_declared
from ident.tracing.replication.by_record import Replication, most_telling
from ident.tracing.replication.error_reduction import Reduction, reduction
from ident.tracing.screening.score_test import Finding, collinear
from ident.tracing.weighed import ComparedSet
from ident.tracing.witness import Witness, silent
from ident.whole_record.gauss_newton import Fit
from sim.declaration.proposal import Traceable

DIFFERING = "the records give different values"


@dataclass(frozen=True, eq=False)
class CrossValidation:
    """One candidate added to a set and tried on records that were not fitted; ``gain`` of log likelihood there with any colour allowed for.

    ``stands`` : it passed; ``why`` it did not. ``predictions`` by record (from 0): the frozen fit of each that could be asked.
    """

    effect: Traceable
    finding: Finding
    fitted: FittedModel
    reduction: Reduction
    replication: Replication
    gain: float
    stands: bool
    why: str
    predictions: Mapping[int, Fit]


@dataclass(frozen=True, eq=False)
class CrossValidatedEffect:
    """An effect that passed, and those that would do as well in its place; ``sets`` : all that were weighed against it, itself among them."""

    best: CrossValidation
    others: tuple[CrossValidation, ...]
    sets: tuple[ComparedSet, ...] = ()


def choose(results: Sequence[CrossValidation], witness: Witness = silent) -> CrossValidatedEffect | None:
    """The best of those that passed, with those that would do as well; None where none passed or a guard forbids it."""
    standing = [item for item in results if item.stands and not item.effect.traits.guard]
    if not standing:
        return None
    lowest = min(standing, key=lambda item: item.reduction.total)
    guards = [item for item in results if item.effect.traits.guard]
    if any(_better_guard(item, lowest) for item in guards):
        return None
    equals = [item for item in standing if _as_good(item, lowest)]
    # Among equals the one that a witness speaks for, then that with fewest parameters, then the best.
    said = {id(item): witness(item.effect.name, most_telling(item.fitted, item.effect)) for item in equals} if len(equals) > 1 else {}
    best = min(equals, key=lambda item: (-said.get(id(item), 0), item.finding.parameters, item.reduction.total))
    # Between those that no record tells apart the declared derivatives choose, which is beyond any witness of the same record.
    best = min((item for item in equals if item is best or item.effect.name in best.effect.traits.equivalents), key=_from_declared)
    standing, equals, results = (_one_form_each(items, best) for items in (standing, equals, results))
    # One and the same signature does as well under another name, too, where only its values by record differ, or where it falls just short
    # of what is worth a claim.
    tried = [item for item in results if not item.stands and (item.replication.values or _falls_just_short(item))]
    alike = [item for item in tried if _same_trace(item, best) and _as_good(item, best)]
    # The best of those that are equal may have equals of its own, beside the one that predicts best.
    close = [item for item in standing if item not in equals and _as_good(item, best)]
    others = sorted((item for item in (*equals, *close, *alike) if item is not best), key=lambda item: item.reduction.total)
    rivals = [item for item in (*standing, *alike, *guards) if item is not best and item.reduction.total < 0.0]
    return CrossValidatedEffect(best, tuple(others), (_compared(best, best), *(_compared(item, best) for item in rivals)))


def outdone(results: Sequence[CrossValidation], best: CrossValidation) -> bool:
    """Whether an effect on which the records differ predicts what was left out clearly better: what stands imitates a cause that does not.

    Guards have been heard when the best was chosen; what belongs to one record has values of its own there, which predict better for nothing.
    """
    for item in results:
        if item.why != DIFFERING or item.effect.traits.guard or belongs_to_record(item.effect):
            continue
        behind, scatter = _behind(item, best)
        if behind < -thresholds.BEYOND_ITS_SCATTER * max(scatter, 0.5 * thresholds.NO_PREFERENCE):
            return True
    return False


def _one_form_each(items: Sequence[CrossValidation], best: CrossValidation) -> list[CrossValidation]:
    """Of several forms of one effect the one that does best, and of ``best`` itself no other: forms are no alternatives to each other."""
    kept: dict[str, CrossValidation] = {}
    for item in sorted(items, key=lambda item: (item is not best, not item.stands, item.reduction.total)):
        kept.setdefault(item.effect.name, item)
    return [item for item in items if kept[item.effect.name] is item]


def _compared(item: CrossValidation, best: CrossValidation) -> ComparedSet:
    """An effect in the place of the best: how far it is behind in scatters, squared."""
    behind, scatter = _behind(item, best)
    away = max(behind, 0.0) / max(scatter, 0.5 * thresholds.NO_PREFERENCE) if item is not best else 0.0
    return ComparedSet((item.effect.name,), away**2, guard=item.effect.traits.guard)


def _falls_just_short(item: CrossValidation) -> bool:
    """Whether an effect lowers the error by less than is worth a claim, and by more than half of that."""
    return -thresholds.WORTH <= item.reduction.total < -thresholds.HALF_OF_IT * thresholds.WORTH


def _from_declared(item: CrossValidation) -> float:
    return misfit_to_declared(item.fitted)


def _better_guard(guard: CrossValidation, best: CrossValidation) -> bool:
    """Whether a guard does better than the best by more than scatter, or replicates and does as well with no more parameters.

    A guard that an effect contains is that effect in a narrower form, and speaks for it.
    """
    if best.effect.name in guard.effect.traits.within:
        return False
    behind, scatter = _behind(guard, best)
    tie = guard.stands and guard.finding.parameters <= best.finding.parameters and behind <= max(scatter, 0.5 * thresholds.NO_PREFERENCE)
    return tie or behind < -thresholds.BEYOND_ITS_SCATTER * scatter


def _as_good(item: CrossValidation, best: CrossValidation) -> bool:
    """Whether an effect would do in the place of the best: as good on held-out data but for scatter, or nearly so and of like signature."""
    behind, scatter = _behind(item, best)
    return behind <= (thresholds.SAME_TRACE_SCATTER if _same_trace(item, best) else thresholds.BEYOND_ITS_SCATTER) * max(
        scatter, 0.5 * thresholds.NO_PREFERENCE
    )


def _same_trace(item: CrossValidation, best: CrossValidation) -> bool:
    return not item.effect.traits.guard and collinear(item.finding, best.finding) > thresholds.COLLINEAR


def _behind(item: CrossValidation, best: CrossValidation) -> tuple[float, float]:
    """Mean of ln(rms of one / rms of another) over the channels of the records that both predict, and its scatter under resampling of blocks."""
    common = sorted(item.predictions.keys() & best.predictions.keys())
    if item is best or not common:
        return item.reduction.total - best.reduction.total, float(np.hypot(item.reduction.scatter, best.reduction.scatter))
    difference = reduction([best.predictions[r] for r in common], [item.predictions[r] for r in common])
    return difference.total, difference.scatter
