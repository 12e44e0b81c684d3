"""Other masks, another problem: the sets of a search fitted anew, so that no criterion is compared over different samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Candidate, Step
from ident.tracing.selection.criterion import gain
from ident.tracing.selection.ledger import Key, Ledger, fit

DECLARED: Key = frozenset()


def refitted(ledger: Ledger, masks: Sequence[np.ndarray], best: FittedModel) -> Ledger | None:
    """A ledger of the same sets on other masks, filled from the declared model up; None where that or ``best`` has no finite cost there.

    The declared model and ``best`` are fitted to the end, the others roughly, each from its own values; that spends nothing of what the
    search may. A set's score follows from the best of its parents that is one effect smaller. Steps are kept, with one that says so, and
    the evidence of the search, with gains as they are now; what cross-validation said of the other samples is not.
    """
    fresh = Ledger(ledger.problem.with_masks(masks), steps=ledger.steps)
    exactly = {DECLARED, frozenset(best.names)}
    known = {**ledger.models, frozenset(best.names): best}
    for key in sorted(known, key=lambda key: (len(key), sorted(key))):
        fresh, again = fit(fresh, known[key].effects, known[key], rough=key not in exactly)
        if again is None:
            if key in exactly:
                return None
            continue
        fresh = fresh.replaced(again, _score(fresh, key, again))
    declared = fresh.models[DECLARED]
    step = Step(
        (), declared.criterion, declared.fit.log_likelihood, "other samples are set aside from here on: all sets are fitted anew without them"
    )
    evidence = [_gained_now(candidate, fresh.models) for candidate in ledger.evidence if not candidate.remark]
    return replace(fresh.told(step, evidence=evidence), spent=ledger.spent, ran_out=ledger.ran_out)


def _gained_now(candidate: Candidate, models: Mapping[Key, FittedModel]) -> Candidate:
    """Evidence with the gain on the new samples, where both of its sets were fitted to them."""
    from scipy.special import chdtrc

    within = frozenset(candidate.within)
    base, fitted = models.get(within), models.get(within | {candidate.name})
    if base is None or fitted is None or not candidate.fitted:
        return candidate
    gained = base.fit.cost - fitted.fit.cost
    return replace(candidate, gain=gained, p_value=float(chdtrc(fitted.added - base.added, max(2.0 * gained, 0.0))))


def _score(ledger: Ledger, key: Key, fitted: FittedModel) -> float:
    parents = [ledger.models[other] for other in ledger.models if other < key and len(other) == len(key) - 1] or list(ledger.models.values())[:1]
    if not parents:
        return fitted.criterion
    parent = min(parents, key=ledger.score)
    return ledger.score(parent) - gain(parent, fitted, ledger.problem.settings.accept)
