"""A further effect that brings derivatives back to what the vehicle file can be believed to say, where a set explains the records without."""

from __future__ import annotations

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.belief.derivatives import wild
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, is_event
from ident.tracing.candidate_model.quantities import implausible, quantities, stands_out_somewhere
from ident.tracing.diagnosis import Step
from ident.tracing.equivalents import misfit_to_declared
from ident.tracing.selection.ledger import Ledger, fit
from sim.declaration.effect import NoiseEffect
from sim.declaration.proposal import Curve, Traceable


def with_belief_restored(ledger: Ledger, best: FittedModel) -> tuple[Ledger, FittedModel]:
    """The set, or that with the effect beside which its derivatives come nearest to the declared ones.

    Two effects can hide each other behind other derivatives (an accelerometer ahead of the centre of gravity and a late angle of attack are
    less of a late angle of attack and a lift of the elevator of turned sign). The samples say little, so that what is added has to bring
    what any addition has to, together with what the declared derivatives say; it has to stand off its absence by the samples alone.
    """
    if not best.effects or has_process_noise(best.system) or best.guards:
        return ledger, best
    accept, before = ledger.problem.settings.accept, misfit_to_declared(best)
    least, chosen = best.criterion + before - accept, None
    if before < accept + float(np.log(best.fit.counts.sum())):
        return ledger, best
    for effect in ledger.problem.candidates:
        if not _may_hide(effect, best) or ledger.exhausted:
            continue
        ledger, child = fit(ledger, (*best.effects, effect), best)
        if child is None or child.fit.cost > best.fit.cost or wild(child) or implausible(effect, quantities(child, effect), slack=0.0):
            continue
        if not stands_out_somewhere(child, effect, thresholds.CLEARLY_OFF_ABSENCE):
            continue
        total = child.criterion + misfit_to_declared(child)
        if total < least:
            least, chosen = total, child
    if chosen is None:
        return ledger, best
    ledger = ledger.kept(chosen, ledger.score(best) + chosen.criterion - best.criterion)
    sentence = f"{chosen.names[-1]} brings back derivatives that {' and '.join(best.names)} alone moved far from what the vehicle file says"
    return ledger.told(Step(chosen.names, ledger.score(chosen), chosen.fit.log_likelihood, sentence)), ledger.known(chosen)


def _may_hide(effect: Traceable, best: FittedModel) -> bool:
    """Whether an effect is steady, shared by all records, and no other name of one that the set has."""
    traits = effect.traits
    steady = not (belongs_to_record(effect) or is_event(effect) or isinstance(effect, (NoiseEffect, Curve)) or traits.guard or traits.background)
    return steady and effect.name not in best.names and not any(name in best.names for name in traits.twins) and not traits.wrong_samples_of
