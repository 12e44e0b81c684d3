"""Two effects added at once: where no effect alone comes near noise, the best alone need not be one of the best two."""

from __future__ import annotations

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, acts_all_along
from ident.tracing.diagnosis import Step
from ident.tracing.screening.context import search_context
from ident.tracing.screening.pairs import likely_pairs
from ident.tracing.screening.score_test import screen
from ident.tracing.selection.criterion import gain
from ident.tracing.selection.expansion import only_beside_another
from ident.tracing.selection.ledger import Ledger, fit
from ident.tracing.selection.near_aliases import near_aliases
from sim.declaration.proposal import Traceable


def pairs_at_once(ledger: Ledger, base: FittedModel) -> tuple[Ledger, list[FittedModel]]:
    """Sets of two steady effects more than ``base`` that their projections promise to explain most together, and that the search has not fitted."""
    settings, problem = ledger.problem.settings, ledger.problem
    candidates = [candidate for candidate in problem.candidates if _can_pair(candidate) and candidate.name not in base.names]
    findings = screen(base, candidates, search_context(base, problem.predicted))
    found: list[FittedModel] = []
    for one, other in likely_pairs(findings, (), float(base.fit.counts.sum()), thresholds.PAIRS_AT_ONCE):
        effects = (*base.effects, one.effect, other.effect)
        if ledger.exhausted or frozenset(effect.name for effect in effects) in ledger.models:
            continue
        ledger, child = fit(ledger, effects, base, {**one.starts[0], **other.starts[0]}, rough=True)
        brought = gain(base, child, settings.accept) if child is not None else 0.0
        if child is None or brought <= 2.0 * settings.accept:
            continue
        ledger = ledger.kept(child, ledger.score(base) - brought)
        sentence = f"{one.effect.name} and {other.effect.name} together lower the criterion by {brought:.1f}"
        ledger = ledger.told(Step(child.names, ledger.score(child), child.fit.log_likelihood, sentence))
        found.append(ledger.known(child))
    if found:
        # The projection of two takes the likest of one kind; another of that kind may be what acts.
        ledger, alike = near_aliases(ledger, min(found, key=ledger.score), settings.near)
        found += alike
    return ledger, found


def _can_pair(effect: Traceable) -> bool:
    return acts_all_along(effect) and not only_beside_another(effect)
