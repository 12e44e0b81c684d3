"""What can be said where the search leaves no noise: effects that stand by themselves, with their groups and what follows for the derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Candidate, Claim, Evidence, Quantity, Step
from ident.tracing.replication.between_records import FEWEST
from ident.tracing.replication.by_record import Flight, own_quantities
from ident.tracing.replication.comparison import CrossValidatedEffect, CrossValidation
from ident.tracing.replication.cross_validation import cross_validate
from ident.tracing.selection.search import Search
from ident.tracing.validation.held_out import HeldOut, held_out
from ident.whole_record.output_error import estimate_of
from sim.record import Record

ALTERNATIVES = 2


@dataclass(frozen=True, eq=False)
class Partial:
    """Effects that stand: the claims, the set fitted to the training records, and what it does on held-out ones."""

    claims: tuple[Claim, ...]
    fitted: FittedModel
    out: HeldOut
    evidence: tuple[Candidate, ...]


def cross_validated(search: Search, root: FittedModel, validation: Sequence[Record], masks: Sequence[np.ndarray] | None) -> Partial | None:
    """Effects of the library that replicate and lower the held-out error although what remains is not noise; None where none does."""
    if masks is None or has_process_noise(root.system) or len(search.records) + len(validation) < 2:
        return None
    flight = Flight((*search.records, *validation), (*search.masks, *masks), search.model, tuple(search.outputs), search.settings, search.witness)
    search.progress("looking for what replicates", 0.92)
    validated, weighed = cross_validate(flight, search.candidates, root)
    if not validated:
        search.evidence += [_candidate(item, chosen=False) for item in weighed]
        return None
    fitted = search.fit(tuple(item.best.effect for item in validated), root, _starts(validated))
    if fitted is None:
        return None
    search.keep(fitted, fitted.criterion)
    for item in validated:
        search.steps.append(Step(item.best.fitted.names, item.best.fitted.criterion, item.best.fitted.fit.log_likelihood, _sentence(item)))
    claims = tuple(_claim(fitted, item) for item in validated)
    members = {id(member) for item in validated for member in (item.best, *item.others)}
    evidence = tuple(_candidate(item, chosen=id(item) in members) for item in weighed)
    return Partial(claims, fitted, held_out(fitted, validation, masks), evidence)


def _starts(validated: Sequence[CrossValidatedEffect]) -> dict[str, float]:
    fitted_models = [item.best.fitted for item in validated]
    return {name: value for fitted in fitted_models for name, value in fitted.values.shared.items() if name not in fitted.declared.parameters}


def _claim(fitted: FittedModel, item: CrossValidatedEffect) -> Claim:
    best = item.best
    members = (best, *item.others[:ALTERNATIVES])
    evidence = Evidence(
        best.reduction.share,
        float(best.reduction.share * best.reduction.scatter),
        best.replication.values,
        {member.effect.name: _derivatives(member.fitted) for member in members},
        best.fitted.names[:-1],
    )
    alternatives = tuple(other.effect.name for other in item.others[:ALTERNATIVES])
    found = {
        name: _scattered(quantity, [own[name].value for own in best.replication.values])
        for name, quantity in own_quantities(fitted, best.effect).items()
    }
    return Claim(best.effect.name, found, alternatives, True, (), best.effect.explanation, evidence)


def _scattered(quantity: Quantity, values: Sequence[float]) -> Quantity:
    """A quantity with a sigma not below what the scatter between records leaves of their mean."""
    floor = float(np.std(values, ddof=1)) / np.sqrt(len(values)) if len(values) >= FEWEST else 0.0
    return Quantity(quantity.value, max(quantity.std, floor), quantity.unit)


def _derivatives(fitted: FittedModel) -> dict[str, Quantity]:
    estimate, declared = estimate_of(fitted.fit), set(fitted.declared.parameters.names)
    rows = zip(estimate.names, estimate.units, estimate.values, estimate.std, strict=True)
    return {name: Quantity(float(value), max(float(std), 1e-300), unit) for name, unit, value, std in rows if name in declared}


def _candidate(item: CrossValidation, *, chosen: bool) -> Candidate:
    from scipy.special import chdtrc

    names = item.fitted.names
    p_value = float(chdtrc(item.finding.parameters, max(2.0 * item.gain, 0.0)))
    found = own_quantities(item.fitted, item.effect)
    plausible = item.effect.traits.plausible
    believed = all(plausible[name][0] <= q.value <= plausible[name][1] for name, q in found.items() if name in plausible)
    why = "stands, but another does better" if item.stands and not chosen else item.why
    return Candidate(len(names), names[:-1], names[-1], item.gain, p_value, True, believed, found, item.reduction.share - 1.0, (), why)


def _sentence(item: CrossValidatedEffect) -> str:
    best = item.best
    each = ", ".join(f"{100.0 * (np.exp(total) - 1.0):+.0f} %" for total in best.reduction.by_record)
    also = f"; {', '.join(other.effect.name for other in item.others)} would do as well" if item.others else ""
    beside = f" beside {', '.join(best.fitted.names[:-1])}" if len(best.fitted.names) > 1 else ""
    return f"{best.effect.name}{beside} replicates and changes the error on records not fitted by {each}{also}"
