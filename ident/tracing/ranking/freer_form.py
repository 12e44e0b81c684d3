"""A set in freer forms of its effects, where data that were not fitted ask for them."""

from __future__ import annotations

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Step
from ident.tracing.screening.context import search_context
from ident.tracing.selection.ledger import Ledger, fit
from ident.tracing.validation.held_out import HeldOut, HeldOutData, doubted, predicted_by
from sim.declaration.effect import full_name
from sim.declaration.proposal import Refinable, Traceable, fitted_to


def in_freer_form(ledger: Ledger, best: FittedModel, out: HeldOut, held: HeldOutData) -> tuple[Ledger, FittedModel, HeldOut]:
    """The same causes in their freer forms, where data that were not fitted ask for it: other levels of input show more of a curve."""
    if not doubted(out):
        return ledger, best, out
    effects = tuple(_freer(ledger, best, effect) for effect in best.effects)
    if all(one is other for one, other in zip(effects, best.effects, strict=True)):
        return ledger, best, out
    known = {*best.values.shared, *best.values.own[0]}
    absent = {full_name(effect, local): value for effect in effects for local, value in effect.absent.items()}
    ledger, finer = fit(ledger, effects, best, {name: value for name, value in absent.items() if name not in known})
    if finer is None:
        return ledger, best, out
    other = predicted_by(finer, held)
    if other.informed is None or out.informed is None or other.informed.cost >= out.informed.cost or doubted(other):
        return ledger, best, out
    score = ledger.score(best)
    ledger = ledger.replaced(finer, score)
    sentence = "freer forms, for what the records that were not fitted show of them"
    return ledger.told(Step(finer.names, score, finer.fit.log_likelihood, sentence)), finer, other


def _freer(ledger: Ledger, best: FittedModel, effect: Traceable) -> Traceable:
    """The freer form of an effect; of one that has none the form of its name that has, over the ranges flown; else itself."""
    if isinstance(effect, Refinable):
        return effect.finer()
    others = [other for other in ledger.problem.candidates if other.name == effect.name and isinstance(other, Refinable)]
    return fitted_to(others[0], search_context(best, ledger.problem.predicted)) if others else effect
