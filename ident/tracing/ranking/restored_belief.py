"""A further effect that brings derivatives back to what the vehicle file can be believed to say, where a set explains the records without."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.belief.derivatives import wild
from ident.tracing.belief.standing import why_not
from ident.tracing.candidate_model.fitted_model import FittedModel, acts_all_along
from ident.tracing.candidate_model.quantities import implausible, quantities, stands_out_somewhere
from ident.tracing.diagnosis import Step
from ident.tracing.equivalents import misfit_to_declared
from ident.tracing.selection.backward import fitted_without
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.ledger import Ledger, fit
from sim.declaration.proposal import Curve, Traceable


def without_unbelievable(ledger: Ledger, best: FittedModel) -> tuple[Ledger, FittedModel]:
    """The set less an effect whose own numbers cannot be claimed, where what is left is noise without it as well; else the set as it is."""
    for effect in best.effects if len(best.effects) > 1 and not best.guards else ():
        if why_not(effect, quantities(best, effect), best) is None:
            continue
        ledger, rest = fitted_without(ledger, best, effect)
        if rest is not None and is_white(rest, ledger.problem.settings.white):
            sentence = f"{effect.name} is left out: its numbers cannot be claimed, and what is left is noise without it"
            ledger = ledger.kept(rest, ledger.score(best) + rest.criterion - best.criterion)
            return ledger.told(Step(rest.names, ledger.score(rest), rest.fit.log_likelihood, sentence)), ledger.known(rest)
    return ledger, best


def with_belief_restored(ledger: Ledger, best: FittedModel) -> tuple[Ledger, FittedModel]:
    """The set, or one of one effect more whose derivatives come nearest to the declared ones.

    Two effects can hide each other behind other derivatives (an accelerometer ahead of the centre of gravity and a late angle of attack are
    less of a late angle of attack and a lift of the elevator of turned sign). The samples say little, so that what is added has to bring
    what any addition has to, together with what the declared derivatives say; each effect has to stand off its absence by the samples alone.
    Sets that the search has passed, and a single effect in the place of all, are asked first. Where derivatives are wild and no effect
    beside the set mends them, two are put in the place of each of its effects.
    """
    if not best.effects or has_process_noise(best.system) or best.guards:
        return ledger, best
    if misfit_to_declared(best) < ledger.problem.settings.accept + float(np.log(best.fit.counts.sum())):
        return ledger, best
    steady = [effect for effect in ledger.problem.candidates if _is_steady(effect) and effect.name not in best.names]
    chosen = _of_those_passed(ledger, best)
    if chosen is None:
        ledger, chosen = _nearest(ledger, best, [(*best.background, effect) for effect in steady], within=ledger.problem.settings.wide)
    if chosen is None:
        ledger, chosen = _nearest(ledger, best, [(*best.effects, effect) for effect in steady])
    if chosen is None and wild(best):
        ledger, chosen = _nearest(ledger, best, list(_two_for_one(best, steady)))
    if chosen is None:
        return ledger, best
    ledger = ledger.kept(chosen, ledger.score(best) + chosen.criterion - best.criterion)
    sentence = f"{' and '.join(chosen.names)} bring back derivatives that {' and '.join(best.names)} moved far from what the vehicle file says"
    return ledger.told(Step(chosen.names, ledger.score(chosen), chosen.fit.log_likelihood, sentence)), ledger.known(chosen)


def _nearest(ledger: Ledger, best: FittedModel, sets: Sequence[tuple[Traceable, ...]], within: float = 0.0) -> tuple[Ledger, FittedModel | None]:
    """Of sets that leave noise and explain the records as well as ``best``, the one of lowest criterion with the misfit to the declared derivatives.

    ``within`` : how much worse one may be, in twice the log likelihood.
    """
    least, chosen = best.criterion + misfit_to_declared(best) - ledger.problem.settings.accept, None
    for effects in sets:
        ledger, child = fit(ledger, effects, best, rough=True)
        if child is None or not _explains(ledger, best, child, within):
            continue
        total = child.criterion + misfit_to_declared(child)
        if total < least:
            least, chosen = total, child
    return ledger, chosen


def _of_those_passed(ledger: Ledger, best: FittedModel) -> FittedModel | None:
    """The same of the sets that the search has fitted anyway and that have no more effects."""
    least, wide = best.criterion + misfit_to_declared(best) - ledger.problem.settings.accept, ledger.problem.settings.wide
    known = [fitted for fitted in ledger.models.values() if 0 < len(fitted.foreground) <= len(best.foreground)]
    near = [fitted for fitted in known if not fitted.guards and not has_process_noise(fitted.system) and _explains(ledger, best, fitted, wide)]
    chosen = min(near, key=lambda fitted: fitted.criterion + misfit_to_declared(fitted), default=None)
    return chosen if chosen is not None and chosen.criterion + misfit_to_declared(chosen) < least else None


def _explains(ledger: Ledger, best: FittedModel, child: FittedModel, within: float) -> bool:
    """Whether a set leaves noise, is not worse than the best by more than ``within``, and has effects and derivatives to be believed."""
    if 2.0 * (child.fit.cost - best.fit.cost) > within or wild(child) or not is_white(child, ledger.problem.settings.white):
        return False
    return all(_stands(child, effect) for effect in child.foreground)


def _two_for_one(best: FittedModel, steady: Sequence[Traceable]) -> Iterator[tuple[Traceable, ...]]:
    """The set with an effect replaced by two, of which one has an equivalent: what other derivatives make up for can hide another."""
    hidden: list[Traceable] = []
    for effect in steady:
        if effect.traits.equivalents and not any(other.name in effect.traits.equivalents for other in hidden):
            hidden.append(effect)
    for gone in best.foreground:
        rest = tuple(effect for effect in best.effects if effect is not gone)
        for one in hidden:
            yield from ((*rest, one, other) for other in steady if other.name not in (one.name, *one.traits.twins))


def _stands(fitted: FittedModel, effect: Traceable) -> bool:
    own = quantities(fitted, effect)
    return stands_out_somewhere(fitted, effect, thresholds.CLEARLY_OFF_ABSENCE) and not implausible(effect, own, slack=0.0)


def _is_steady(effect: Traceable) -> bool:
    """Whether an effect acts all along and alike in all records: no event, no drift, no curve, no noise, no guard."""
    return acts_all_along(effect) and not isinstance(effect, Curve) and not effect.traits.wrong_samples_of
