"""Sets of leads weighed in the linear world: closed form on one Gram matrix."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.evidence.priors import set_prior
from ident.tracing.evidence.scan import (
    Lead,
    Prepared,
    closed_forms,
    leads_of,
    prepared,
    shown_by,
    starts_of,
)
from sim.declaration.proposal import SearchContext, Traceable

BEAM = 10  # sets of each size that are extended
TRIED = 30  # leads that take part


@dataclass(frozen=True, eq=False)
class LinearSet:
    """A set of leads.

    Attributes
    ----------
    gain : of log evidence. weight : the same with the prior odds of the leads and their places.
    factors : of each lead's columns, at the posterior's mean.
    """

    leads: tuple[Lead, ...]
    gain: float
    weight: float
    factors: tuple[np.ndarray, ...]

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects that it adds."""
        return frozenset(lead.effect.name for lead in self.leads)


def weighed_sets(
    ready: Prepared,
    leads: Sequence[Lead],
    odds: Callable[[Lead], float],
    together: Callable[[Lead, Lead], bool],
    depth: int,
) -> tuple[list[LinearSet], Mapping[frozenset[str], float]]:
    """Sets of up to ``depth`` leads, the weightiest first, and how alike pairs of effects are.

    Parameters
    ----------
    ready : the fitted set at which the leads were found. odds : log prior odds of a lead.
    together : whether two leads may be in one set.

    Returns
    -------
    The sets, and the largest cosine between what two effects would add, by their names.
    """
    ranked = sorted(leads, key=lambda lead: -(lead.gain + lead.price + odds(lead)))[:TRIED]
    if not ranked:
        return [], {}
    columns = np.concatenate([lead.columns for lead in ranked], axis=1)
    B = ready.root.T @ columns
    gram, with_e = columns.T @ columns - B.T @ B, columns.T @ ready.e
    ends = np.cumsum([lead.columns.shape[1] for lead in ranked])
    at = [
        np.arange(end - lead.columns.shape[1], end) for end, lead in zip(ends, ranked, strict=True)
    ]
    prior = [lead.price + odds(lead) for lead in ranked]

    def made(members: tuple[int, ...]) -> LinearSet:
        where = np.concatenate([at[i] for i in members])
        mean = np.concatenate([ranked[i].mean for i in members])
        sigma = np.concatenate([ranked[i].sigma for i in members])
        gains, factors = closed_forms(
            gram[np.ix_(where, where)][None], with_e[where][None], mean, sigma
        )
        cuts = np.cumsum([len(at[i]) for i in members])[:-1]
        gain = float(gains[0])
        weight = gain + sum(prior[i] for i in members)
        chosen = tuple(ranked[i] for i in members)
        return LinearSet(chosen, gain, weight, tuple(np.split(factors[0], cuts)))

    count = range(len(ranked))
    allowed = [[together(ranked[i], ranked[j]) for j in count] for i in count]
    singles = [made((i,)) for i in count]
    found: dict[frozenset[int], LinearSet] = {frozenset((i,)): singles[i] for i in count}
    beam: list[tuple[int, ...]] = [(i,) for i in list(count)[:BEAM]]
    for _ in range(depth - 1):
        level: dict[frozenset[int], tuple[tuple[int, ...], LinearSet]] = {}
        for members in beam:
            for i in count:
                key = frozenset((*members, i))
                if key not in level and all(allowed[i][j] for j in members):
                    level[key] = ((*members, i), made((*members, i)))
        best = sorted(level.items(), key=lambda each: -each[1][1].weight)[:BEAM]
        found |= {key: one for key, (_, one) in best}
        beam = [members for _, (members, _) in best]
    sets = sorted(found.values(), key=lambda each: -each.weight)
    return sets, _cosines(ranked, singles, at, gram)


def starts_at(
    fitted: FittedModel, effect: Traceable, context: SearchContext
) -> list[tuple[Traceable, list[dict[str, float]]]]:
    """An effect's best places at a fitted set, to begin fits with; the likeliest first.

    Returns
    -------
    The effect in its form for these records, and the values of its parameters by full name, one
    mapping a record.
    """
    ready = prepared(fitted, set_prior(fitted, context))
    shown = [*shown_by(fitted, [effect], context).values()]
    leads = leads_of(fitted, ready, shown, context)
    singles, _ = weighed_sets(ready, leads, lambda lead: 0.0, lambda one, other: False, 1)
    count = len(fitted.values.own)
    return [
        (one.leads[0].effect, starts_of(one.leads[0], one.factors[0], count, context.interval))
        for one in singles
    ]


def _cosines(
    ranked: Sequence[Lead],
    singles: Sequence[LinearSet],
    at: Sequence[np.ndarray],
    gram: np.ndarray,
) -> dict[frozenset[str], float]:
    sides = np.zeros((len(gram), len(ranked)))
    for i, single in enumerate(singles):
        sides[at[i], i] = single.factors[0]
    inner = sides.T @ gram @ sides
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    cosines = np.abs(inner / np.outer(size, size))
    found: dict[frozenset[str], float] = {}
    for i, a in enumerate(ranked):
        for j, b in enumerate(ranked[:i]):
            key = frozenset((a.effect.name, b.effect.name))
            if len(key) == 2:
                found[key] = max(found.get(key, 0.0), float(cosines[i, j]))
    return found
