"""Pairs among the effects of the first round: the best two together need not hold the best one alone, nor the second best."""

from __future__ import annotations

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, never_together
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding, screen
from ident.tracing.selection.acceptance import accepted
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.expansion import best_fit
from ident.tracing.selection.ledger import Ledger


def crossed_pairs(ledger: Ledger, base: FittedModel) -> tuple[Ledger, list[FittedModel]]:
    """Accepted sets of two effects of which each was accepted alone, beside the background of ``base``, and the beam kept neither.

    Each of the best of them is screened for the others, events too, and the few pairs that promise most are fitted. Ends with one that leaves noise.
    """
    singles = _singles(ledger, base)
    names = {fitted.foreground[0].name for fitted in singles}
    promised: list[tuple[float, FittedModel, Finding]] = []
    for fitted in singles[: thresholds.SINGLES_CROSSED]:
        mine = fitted.foreground[0]
        others = [c for c in ledger.problem.candidates if c.name in names - {mine.name} and not never_together(mine, c)]
        others = [c for c in others if frozenset((*fitted.names, c.name)) not in ledger.models]
        for finding in screen(fitted, others, search_context(fitted, ledger.problem.predicted)):
            price = finding.parameters * float(np.log(fitted.fit.counts.sum()))
            promised.append((fitted.criterion - 2.0 * finding.gain + price, fitted, finding))
    found: list[FittedModel] = []
    for _, fitted, finding in sorted(promised, key=lambda one: one[0])[: thresholds.PAIRS_CROSSED]:
        if ledger.exhausted or frozenset((*fitted.names, finding.effect.name)) in ledger.models:
            continue
        ledger, child = best_fit(ledger, fitted, finding, 1)
        if child is not None:
            ledger, children = accepted(ledger, fitted, 2, [finding], {0: child})
            found += children
        if any(is_white(child) for child in found):
            break
    return ledger, found


def _singles(ledger: Ledger, base: FittedModel) -> list[FittedModel]:
    """Sets of one effect of the library beside the background of ``base``, the best first; none with process noise."""
    background = {effect.name for effect in base.background}
    found = [
        fitted
        for fitted in ledger.models.values()
        if len(fitted.foreground) == 1
        and {effect.name for effect in fitted.background} == background
        and not fitted.guards
        and not has_process_noise(fitted.system)
    ]
    return sorted(found, key=ledger.score)
