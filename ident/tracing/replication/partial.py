"""What can be said where the search leaves no noise: cross-validated effects, with their groups and what follows for the derivatives."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.belief.standing import why_no_set, why_not
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, is_event, never_together
from ident.tracing.candidate_model.quantities import implausible, quantities, records_of
from ident.tracing.diagnosis import Candidate, Claim, Evidence, Quantity, Step
from ident.tracing.equivalents import same_by_value
from ident.tracing.replication.by_record import choosing_records, most_telling, recordings
from ident.tracing.replication.comparison import CrossValidatedEffect, CrossValidation
from ident.tracing.replication.cross_validation import cross_validate, weighed_again
from ident.tracing.selection.ledger import Ledger, fit
from ident.tracing.validation.held_out import HeldOut, HeldOutData, predicted_by
from ident.tracing.weighed import Ground, Weighed
from ident.whole_record.output_error import estimate_of
from sim.declaration.proposal import Traceable


@dataclass(frozen=True, eq=False)
class Validated:
    """Effects that replicate, and all that were tried."""

    chosen: Sequence[CrossValidatedEffect]
    compared: Sequence[CrossValidation]


@dataclass(frozen=True, eq=False)
class Partial:
    """Cross-validated effects: the claims, their set fitted to the training records, what it predicts of the others.

    ``events_alone`` : whether all are events. ``learnt_there`` : whether one has values in those other records that are fitted to them.
    """

    claims: tuple[Claim, ...]
    fitted: FittedModel
    out: HeldOut
    validated: Validated
    events_alone: bool = False
    learnt_there: bool = False


def cross_validated(ledger: Ledger, base: FittedModel, held: HeldOutData) -> tuple[Ledger, Partial | None]:
    """Effects of the library that replicate and lower the held-out error although what remains is not noise; None where none does."""
    problem = ledger.problem
    flight = choosing_records(problem, held)
    if held.masks is None or has_process_noise(base.system) or recordings(flight.records) < 2:
        return ledger, None
    problem.progress("looking for what replicates", 0.92)
    validated = cross_validate(flight, problem.candidates, base, len(problem.records), ledger.models.values())
    return as_partial(ledger, base, held, Validated(*validated))


def as_partial(ledger: Ledger, base: FittedModel, held: HeldOutData, validated: Validated) -> tuple[Ledger, Partial | None]:
    """What was cross-validated, fitted to the training records and judged as it is printed; None where nothing of it stands."""
    compared = validated.compared
    ledger, chosen, fitted = _as_printed(ledger, base, validated.chosen)
    if fitted is None:
        return ledger.told(evidence=[_candidate(item, chosen=False) for item in compared]), None
    ledger = ledger.kept(fitted, fitted.criterion)
    ledger = ledger.told(
        *(Step(item.best.fitted.names, item.best.fitted.criterion, item.best.fitted.fit.log_likelihood, _sentence(item)) for item in chosen)
    )
    members = {id(member) for item in chosen for member in (item.best, *item.others)}
    ledger = ledger.told(evidence=[_candidate(item, chosen=id(item) in members) for item in compared])
    said = {item.best.effect.name for item in chosen}
    claims = (
        *(_of_background(fitted, effect) for effect in base.effects if effect.name in fitted.names and effect.name not in said),
        *(_claim(fitted, item, said - {item.best.effect.name}) for item in chosen),
    )
    events_alone = all(is_event(item.best.effect) for item in chosen)
    learnt_there = any(belongs_to_record(item.best.effect) for item in chosen)
    return ledger, Partial(claims, fitted, predicted_by(fitted, held), validated, events_alone, learnt_there)


def on_other_samples(ledger: Ledger, base: FittedModel, held: HeldOutData, before: Validated) -> tuple[Ledger, Partial | None]:
    """What was cross-validated, weighed again on samples of which a few others are set aside; what was not is not looked for anew."""
    flight = choosing_records(ledger.problem, held)
    return as_partial(
        ledger, base, held, Validated(*weighed_again(flight, ledger.problem.candidates, base, before.chosen, len(ledger.problem.records)))
    )


def _as_printed(
    ledger: Ledger, base: FittedModel, chosen: Sequence[CrossValidatedEffect]
) -> tuple[Ledger, list[CrossValidatedEffect], FittedModel | None]:
    """The effects fitted to the training records, less those whose numbers there do not stand; None where none is left.

    What was cross-validated was fitted to other records, each time beside fewer effects: what is printed is judged anew.
    """
    left = list(chosen)
    while left:
        added = [item.best.effect for item in left if item.best.effect.name not in base.names]
        kept = [effect for effect in base.effects if not any(never_together(effect, other) for other in added)]
        # The place of an event is where it was found, which no start that records share can say.
        begin = left[-1].best.fitted if is_event(left[-1].best.effect) else base
        ledger, fitted = fit(ledger, (*kept, *added), begin, _starts(left))
        if fitted is None:
            break
        own = [why_not(item.best.effect, most_telling(fitted, item.best.effect), fitted) for item in left]
        if not any(own) and not why_no_set(ledger.models.get(frozenset(), base), fitted):
            return ledger, left, fitted
        # Where the set as a whole ruins a derivative, what came last goes first.
        left = [item for item, why in zip(left, own, strict=True) if why is None] if any(own) else left[:-1]
    return ledger, [], None


def _starts(validated: Sequence[CrossValidatedEffect]) -> dict[str, float]:
    fitted_models = [item.best.fitted for item in validated]
    return {name: value for fitted in fitted_models for name, value in fitted.values.shared.items() if name not in fitted.declared.parameters}


def _claim(fitted: FittedModel, item: CrossValidatedEffect, beside: Collection[str]) -> Claim:
    """The claim of one effect; what is claimed ``beside`` it was weighed against it before both were in the model, and does not speak against it."""
    best = item.best
    members = (best, *[other for other in item.others if other.effect.name not in beside][: thresholds.ALTERNATIVES_NAMED])
    evidence = Evidence(
        best.reduction.share,
        float(best.reduction.share * best.reduction.scatter),
        best.replication.values,
        {member.effect.name: _derivatives(member.fitted) for member in members},
        best.fitted.names[:-1],
        belongs_to_record(best.effect),
    )
    alternatives = tuple(other.effect.name for other in item.others if other.effect.name not in beside)[: thresholds.ALTERNATIVES_NAMED]
    weighed = Weighed(Ground.CROSS_VALIDATED, tuple(each for each in item.sets if not set(each.names) & set(beside)))
    if belongs_to_record(best.effect):
        # Each record has its own value: there is no mean of them to be known.
        own = most_telling(fitted, best.effect)
        weighed = replace(weighed, same=same_by_value(best.effect, own))
        alternatives = tuple(dict.fromkeys([*weighed.same, *alternatives]))[: thresholds.ALTERNATIVES_NAMED]
        acts_on = tuple(best.predictions) if is_event(best.effect) else records_of(fitted, best.effect)
        return Claim(best.effect.name, own, alternatives, True, acts_on, best.effect.explanation, evidence, weighed=weighed)
    found = {
        name: _scattered(quantity, [own[name].value for own in best.replication.values])
        for name, quantity in most_telling(fitted, best.effect).items()
    }
    return Claim(best.effect.name, found, alternatives, True, (), best.effect.explanation, evidence, weighed=weighed)


def _of_background(fitted: FittedModel, effect: Traceable) -> Claim:
    """What any record may have: it belongs to each record by itself, so that there is nothing to replicate. A hint where nobody believes it."""
    found = quantities(fitted, effect)
    same, acts_on, believed = same_by_value(effect, found), records_of(fitted, effect), why_not(effect, found, fitted) is None
    return Claim(effect.name, found, same, believed, acts_on, effect.explanation, weighed=Weighed(Ground.CROSS_VALIDATED, same=same))


def _scattered(quantity: Quantity, values: Sequence[float]) -> Quantity:
    """A quantity with a sigma not below what the scatter between records leaves of their mean."""
    floor = float(np.std(values, ddof=1)) / np.sqrt(len(values)) if len(values) >= thresholds.FEWEST_RECORDS else 0.0
    return Quantity(quantity.value, max(quantity.std, floor), quantity.unit)


def _derivatives(fitted: FittedModel) -> dict[str, Quantity]:
    estimate, declared = estimate_of(fitted.fit), set(fitted.declared.parameters.names)
    rows = zip(estimate.names, estimate.units, estimate.values, estimate.std, strict=True)
    return {name: Quantity(float(value), max(float(std), 1e-300), unit) for name, unit, value, std in rows if name in declared}


def _candidate(item: CrossValidation, *, chosen: bool) -> Candidate:
    from scipy.special import chdtrc

    names = item.fitted.names
    p_value = float(chdtrc(item.finding.parameters, max(2.0 * item.gain, 0.0)))
    found = most_telling(item.fitted, item.effect)
    believed = not implausible(item.effect, found, slack=0.0)
    why = "cross-validated, but another does better" if item.stands and not chosen else item.why
    left = item.reduction.share
    scatter = left * item.reduction.scatter
    return Candidate(len(names), names[:-1], names[-1], item.gain, p_value, True, believed, found, left - 1.0, (), why, scatter)


def _sentence(item: CrossValidatedEffect) -> str:
    best = item.best
    each = ", ".join(f"{100.0 * (np.exp(total) - 1.0):+.0f} %" for total in best.reduction.by_record)
    also = f"; {', '.join(other.effect.name for other in item.others)} would do as well" if item.others else ""
    already = f", with {', '.join(best.fitted.names[:-1])} already in the model," if len(best.fitted.names) > 1 else ""
    return f"{best.effect.name}{already} replicates and changes the error on records not fitted by {each}{also}"
