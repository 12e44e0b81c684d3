"""The sets that a judged one was weighed against, as ``name_probability`` asks for them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.belief.evenness import behind_gaps, is_uneven, what_is_uneven, what_lies_behind_gaps
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, is_event
from ident.tracing.ranking.choice import Choice
from ident.tracing.selection.ledger import Key, Ledger
from ident.tracing.validation.held_out import HeldOutData, predicted_by
from ident.tracing.weighed import ComparedSet
from ident.whole_record.gauss_newton import Fit
from sim.declaration.effect import NoiseEffect
from sim.declaration.proposal import Traceable


def weighed(ledger: Ledger, choice: Choice, held: HeldOutData) -> Choice:
    """The choice with all that it was compared with, what its process noise stands for (``uneven``, ``behind_gaps``), its idle effects and the
    events that bring little."""
    sets, left = sets_compared(ledger, choice), _left_by_causes(ledger, choice.best, held)
    uneven, gaps = bool(left) and is_uneven(left), behind_gaps(left)
    return replace(
        choice,
        sets=sets,
        uneven=uneven,
        behind_gaps=gaps,
        idle=_idle(ledger, choice, held),
        slight=_slight(ledger, choice.best),
        least=_least_of_each(ledger, choice.best),
        unevenness=what_is_uneven(left) if uneven else None,
        gap_share=what_lies_behind_gaps(left) if gaps else None,
    )


def _least_of_each(ledger: Ledger, best: FittedModel) -> float:
    """The log likelihood that each effect of a set has to bring on data that were not fitted."""
    return ledger.problem.settings.accept if len(best.foreground) >= thresholds.MANY_CAUSES else 0.0


def _idle(ledger: Ledger, choice: Choice, held: HeldOutData) -> dict[str, float]:
    """Effects that all records share and without which a free simulation of data that were not fitted is better, with what they bring there.

    Asked of sets of several: of one alone the verdict asks it. Three causes at once are rare, and three small ones imitate one that the
    library does not have: each of so many has to raise the log likelihood of those data by what a cross-validated one has to.
    """
    best, out = choice.best, choice.out.frozen
    if out is None or len(best.effects) < 2 or best.guards or has_process_noise(best.system):
        return {}
    least = _least_of_each(ledger, best)
    found = {}
    for effect in best.foreground:
        rest = tuple(other for other in best.effects if other is not effect)
        if belongs_to_record(effect):
            continue
        plain = _known_or_fitted(ledger, rest, best)
        frozen = predicted_by(plain, held, informed=False).frozen if plain is not None else None
        if frozen is not None and frozen.cost < out.cost + least:
            found[effect.name] = frozen.cost - out.cost
    return found


def _slight(ledger: Ledger, best: FittedModel) -> dict[str, float]:
    """Events of one record that bring little of what a set of three causes or more brings in all, with the share that each brings.

    What any record may have is among the causes.

    An event has a place of its own choice and no other record that could deny it: it takes what the others do not get quite right.
    """
    root = ledger.models.get(frozenset())
    if root is None or len(best.effects) < thresholds.MANY_CAUSES or best.guards or has_process_noise(best.system):
        return {}
    found, whole = {}, root.fit.cost - best.fit.cost
    for effect in best.foreground:
        if not (is_event(effect) and belongs_to_record(effect)):
            continue
        rest = tuple(other for other in best.effects if other is not effect)
        plain = _known_or_fitted(ledger, rest, best)
        if plain is not None and plain.fit.cost - best.fit.cost < thresholds.LITTLE * whole:
            found[effect.name] = (plain.fit.cost - best.fit.cost) / whole if whole > 0.0 else 0.0
    return found


def _known_or_fitted(ledger: Ledger, effects: Sequence[Traceable], start: FittedModel) -> FittedModel | None:
    """A set as the search has fitted it, else roughly fitted from where another stands; None where it cannot be."""
    return ledger.models.get(frozenset(effect.name for effect in effects)) or ledger.problem.fit(effects, start, None, rough=True)


def _left_by_causes(ledger: Ledger, best: FittedModel, held: HeldOutData) -> list[Fit]:
    """What a set leaves without its process noise, of the fitted records and of others; empty where it has none.

    Rough air does not know where the aircraft moves, nor which rows a recorder lost.
    """
    if not has_process_noise(best.system):
        return []
    rest = tuple(effect for effect in best.effects if not isinstance(effect, NoiseEffect))
    plain = _known_or_fitted(ledger, rest, best)
    if plain is None or has_process_noise(plain.system):
        return []
    frozen = predicted_by(plain, held, informed=False).frozen
    return [plain.fit, *([frozen] if frozen is not None else [])]


def sets_compared(ledger: Ledger, choice: Choice) -> tuple[ComparedSet, ...]:
    """All sets that were compared on the data that take part, and of the search's others those that differ from the judged one in one effect.

    The latter by the fitted records alone: one effect fewer, or another, a guard's among them, in its place.
    """
    best, mine = choice.best, frozenset(choice.best.names)
    return (ComparedSet(best.names, 0.0), *_compared(ledger, choice, mine), *_passed(ledger, choice, best, mine))


def _compared(ledger: Ledger, choice: Choice, mine: Key) -> Iterator[ComparedSet]:
    for key, misfit in choice.misfits.items():
        if key == mine or key not in ledger.models or not math.isfinite(choice.totals[key] - choice.totals[mine]):
            continue
        behind, price = misfit - choice.misfits[mine], _price(ledger.models[key]) - _price(choice.best)
        declared = choice.totals[key] - choice.totals[mine] - behind - price
        yield ComparedSet(tuple(sorted(key)), behind, price, declared, bool(key & ledger.problem.guards))


def _passed(ledger: Ledger, choice: Choice, best: FittedModel, mine: Key) -> Iterator[ComparedSet]:
    for key, other in ledger.models.items():
        gone, come = mine - key, key - mine
        if key in choice.misfits or key == mine or len(gone) != 1 or len(come) > 1:
            continue
        behind = 2.0 * (other.fit.cost - best.fit.cost)
        yield ComparedSet(tuple(sorted(key)), behind, _price(other) - _price(best), 0.0, bool(key & ledger.problem.guards))


def _price(fitted: FittedModel) -> float:
    """What the criterion charges beyond twice the cost."""
    return fitted.criterion - 2.0 * fitted.fit.cost
