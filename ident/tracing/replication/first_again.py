"""The first of two effects asked again with the second in the model: it was chosen when it stood for both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.comparison import CrossValidatedEffect, CrossValidation
from ident.tracing.replication.one_round import Tried, weigh_all
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import screen
from sim.declaration.proposal import Traceable

Again = tuple[list[CrossValidatedEffect], list[CrossValidation]]


def first_again(flight: Flight, candidates: Sequence[Traceable], first: Tried, found: Sequence[CrossValidatedEffect]) -> Again:
    """What was ``found``, where it is two, with what does as well or better in the place of the first beside the second; and what was tried.

    ``first`` : the first step. All channels late against the input and one of them later still leave nearly what two late channels do.
    """
    if len(found) != 2:
        return list(found), []
    one, two = found
    alone = flight.beside(first.fitted, two.best.effect, two.best.fitted.values)
    if alone is None:
        return list(found), []
    members = [member.effect for member in (one.best, *one.others)]
    rivals = _rivals(alone, candidates, members)
    step = weigh_all(flight, [*members, *rivals], alone) if rivals else None
    if step is None or step.chosen is None:
        return list(found), list(step.results) if step is not None else []
    if step.chosen.best.effect.name == one.best.effect.name:
        known = {effect.name for effect in members}
        further = tuple(item for item in step.chosen.others if item.effect.name not in known)
        return [replace(one, others=(*one.others, *further)), two], list(step.results)
    # What takes the place of the first has the second come out again beside it.
    only = flight.beside(first.fitted, step.chosen.best.effect, step.chosen.best.fitted.values)
    last = weigh_all(flight, [member.effect for member in (two.best, *two.others)], only) if only is not None else None
    tried = [*step.results, *(last.results if last is not None else ())]
    return ([step.chosen, last.chosen] if last is not None and last.chosen is not None else list(found)), tried


def _rivals(alone: FittedModel, candidates: Sequence[Traceable], members: Sequence[Traceable]) -> list[Traceable]:
    """Candidates whose signature explains as much of what the second effect leaves as that of the first, or half of it."""
    names = {effect.name for effect in members}
    screened = screen(alone, candidates, search_context(alone))
    mine = max((finding.gain for finding in screened if finding.effect.name in names), default=0.0)
    return [f.effect for f in screened if f.effect.name not in names and f.gain >= thresholds.RIVAL * mine > 0.0]
