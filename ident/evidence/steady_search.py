"""Search beside a model discrepancy: which effects act all along, and show it in every part of the records.

Where no set of effects leaves noise the forces of the model are wrong in ways that no library holds. They get a random
history (the discrepancy), and an effect is added only where the evidence for it is spread over the records: Vuong's test
on blocks of time, which holds where neither of two models is true.

References
----------
.. [1] Q. H. Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses", Econometrica 57, 1989.
"""

from __future__ import annotations

import numpy as np

from ident.evidence.search import Search, Weighed
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record
from sim.declaration.effect import NoiseEffect
from sim.declaration.proposal import Traceable

BLOCK = 1.0  # s, of a block of Vuong's test
SPREAD = 3.5  # z of an effect that may be claimed beside a discrepancy
DEEPEST = 4


def is_steady(effect: Traceable) -> bool:
    """Whether an effect acts all along and alike in all records."""
    return not (belongs_to_record(effect) or effect.traits.onset or effect.traits.background)


def log_densities(fitted: FittedModel) -> list[np.ndarray]:
    """Log density of each sample given those before it, all outputs together, ``(N,)`` a record."""
    fit = fitted.fit
    out, total = [], 0.0
    for problem, residual in zip(fit.layout.problems, fit.residuals, strict=True):
        out.append(-0.5 * np.sum(np.where(problem.valid, residual**2 / fit.variance[:, None], 0.0), axis=0))
        total += float(out[-1].sum())
    # The rest (log determinants) is spread evenly: a filter settles within seconds.
    rest = (fit.log_likelihood - total) / sum(len(each) for each in out)
    return [each + rest for each in out]


def vuong(more: Weighed, less: Weighed, interval: float) -> float:
    """Difference of log evidence over the scatter of its parts in blocks of a second."""
    block = max(2, round(BLOCK / interval))
    parts = [
        np.add.reduceat(a - b, np.arange(0, len(a), block))
        for a, b in zip(log_densities(more.fitted), log_densities(less.fitted), strict=True)
    ]
    d = np.concatenate(parts)
    return float((more.evidence - less.evidence) / (np.sqrt(len(d)) * np.std(d) + 1e-12))


def _random(more: Weighed, less: Weighed) -> bool:
    """Whether what one set has more than another is process noise."""
    return any(isinstance(each, NoiseEffect) for each in more.fitted.effects if each.name not in less.names)


def spread_search(search: Search) -> Weighed:
    """The set that is reached by additions of which each is spread over the records, and none can be left out."""
    leader = search.root
    for _ in range(DEEPEST):
        if leader.names not in search.expanded:
            search.expand(leader)
        children = [one for key, one in search.visited.items() if leader.names < key and len(key) == len(leader.names) + 1]
        good = [one for one in children if one.weight > leader.weight and vuong(one, leader, search.context.interval) > SPREAD]
        # Rough air takes in what has a cause: it is added where no cause can be.
        good = [one for one in good if not _random(one, leader)] or good
        if not good:
            break
        leader = max(good, key=lambda one: one.weight)
        search.tell(f"leader {sorted(leader.names)} {leader.weight - search.root.weight:+.1f}")
        for name in sorted(leader.names - search.root.names) if len(leader.names) > len(search.root.names) + 1 else ():
            less = search.without(leader, name)
            if less is not None and (less.weight > leader.weight or vuong(leader, less, search.context.interval) < SPREAD):
                search.tell(f"  without {name}")
                leader = less
    return leader
