"""The sets that a judged one was weighed against, as ``name_probability`` asks for them."""

from __future__ import annotations

from collections.abc import Iterator

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.ranking import Choice
from ident.tracing.selection.ledger import Key, Ledger
from ident.tracing.weighed import ComparedSet


def sets_compared(ledger: Ledger, choice: Choice) -> tuple[ComparedSet, ...]:
    """All sets that were compared on the data that take part, and of the search's others those that differ from the judged one in one effect.

    The latter by the fitted records alone: one effect fewer, or another, a guard's among them, in its place.
    """
    best, mine = choice.best, frozenset(choice.best.names)
    return (ComparedSet(best.names, 0.0), *_compared(ledger, choice, mine), *_passed(ledger, choice, best, mine))


def _compared(ledger: Ledger, choice: Choice, mine: Key) -> Iterator[ComparedSet]:
    for key, misfit in choice.misfits.items():
        if key == mine or key not in ledger.models:
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
