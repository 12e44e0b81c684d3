"""Other masks, another problem: the sets of a search fitted anew, so that no criterion is compared over different samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.selection.criterion import gain
from ident.tracing.selection.ledger import Key, Ledger, fit

DECLARED: Key = frozenset()


def refitted(ledger: Ledger, masks: Sequence[np.ndarray], best: FittedModel) -> Ledger | None:
    """A ledger of the same sets on other masks, filled from the declared model up; None where that or ``best`` has no finite cost there.

    The declared model and ``best`` are fitted to the end, the others roughly, each from its own values. Steps and evidence are kept: they
    tell how the search went. A set's score follows from the best of its parents that is one effect smaller.
    """
    fresh = Ledger(ledger.problem.with_masks(masks), steps=ledger.steps, evidence=ledger.evidence, spent=ledger.spent)
    exactly = {DECLARED, frozenset(best.names)}
    known = {**ledger.models, frozenset(best.names): best}
    for key in sorted(known, key=lambda key: (len(key), sorted(key))):
        fresh, again = fit(fresh, known[key].effects, known[key], rough=key not in exactly)
        if again is None:
            if key in exactly:
                return None
            continue
        fresh = fresh.replaced(again, _score(fresh, key, again))
    return fresh


def _score(ledger: Ledger, key: Key, fitted: FittedModel) -> float:
    parents = [ledger.models[other] for other in ledger.models if other < key and len(other) == len(key) - 1] or list(ledger.models.values())[:1]
    if not parents:
        return fitted.criterion
    parent = min(parents, key=ledger.score)
    return ledger.score(parent) - gain(parent, fitted, ledger.problem.settings.accept)
