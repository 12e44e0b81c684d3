"""Sets of leads weighed in the linear world: closed form on one Gram matrix, thousands in a second."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ident.evidence.scan import Lead, Prepared, closed_form

DEPTH = 4  # effects in a set, at most
BEAM = 10  # sets of each size that are extended
_WORTH_A_TRY = 30  # leads that take part


@dataclass(frozen=True, eq=False)
class LinearSet:
    """A set of leads: its gain of log evidence, its weight with the prior odds, and the factors of each lead."""

    leads: tuple[Lead, ...]
    gain: float
    weight: float
    factors: tuple[np.ndarray, ...]

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects that it adds."""
        return frozenset(lead.effect.name for lead in self.leads)


@dataclass(frozen=True, eq=False)
class Overlap:
    """Cosines between what leads add to the whitened outputs, projected off the set's own unknowns."""

    names: tuple[str, ...]
    cosines: np.ndarray


def weighed(
    ready: Prepared,
    leads: Sequence[Lead],
    odds: Callable[[Lead], float],
    together: Callable[[Lead, Lead], bool],
    depth: int = DEPTH,
) -> tuple[list[LinearSet], Overlap]:
    """Sets of up to ``depth`` leads, the weightiest first, and how alike the leads are.

    ``odds`` : log prior odds of a lead. ``together`` : whether two may be in one set.
    """
    ranked = sorted(leads, key=lambda lead: -(lead.gain + lead.price + odds(lead)))[:_WORTH_A_TRY]
    if not ranked:
        return [], Overlap((), np.zeros((0, 0)))
    columns = np.concatenate([lead.columns for lead in ranked], axis=1)
    B = ready.root.T @ columns
    gram, with_e = columns.T @ columns - B.T @ B, columns.T @ ready.e
    ends = np.cumsum([lead.columns.shape[1] for lead in ranked])
    at = [np.arange(end - lead.columns.shape[1], end) for end, lead in zip(ends, ranked, strict=True)]
    mean = np.concatenate([lead.mean for lead in ranked])
    sigma = np.concatenate([lead.sigma for lead in ranked])
    prior = [lead.price + odds(lead) for lead in ranked]

    def one(members: tuple[int, ...]) -> LinearSet:
        where = np.concatenate([at[i] for i in members])
        gain, factors = closed_form(gram[np.ix_(where, where)], with_e[where], mean[where], sigma[where])
        cuts = np.cumsum([len(at[i]) for i in members])[:-1]
        weight = gain + sum(prior[i] for i in members)
        return LinearSet(tuple(ranked[i] for i in members), gain, weight, tuple(np.split(factors, cuts)))

    allowed = [[i != j and ranked[i].effect.name != ranked[j].effect.name and together(ranked[i], ranked[j]) for j in range(len(ranked))] for i in range(len(ranked))]
    found: dict[frozenset[int], LinearSet] = {}
    beam: list[tuple[int, ...]] = [()]
    for _ in range(depth):
        level: dict[frozenset[int], tuple[tuple[int, ...], LinearSet]] = {}
        for members in beam:
            for i in range(len(ranked)):
                key = frozenset((*members, i))
                if len(key) > len(members) and key not in level and all(allowed[i][j] for j in members):
                    level[key] = ((*members, i), one((*members, i)))
        best = sorted(level.items(), key=lambda each: -each[1][1].weight)[:BEAM]
        found |= {key: made for key, (_, made) in best}
        beam = [members for _, (members, _) in best]
    sets = sorted(found.values(), key=lambda each: -each.weight)
    single = [one((i,)) for i in range(len(ranked))]
    sides = np.zeros((columns.shape[1], len(ranked)))
    for i, made in enumerate(single):
        sides[at[i], i] = made.factors[0]
    inner = sides.T @ gram @ sides
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    return sets, Overlap(tuple(lead.effect.name for lead in ranked), np.abs(inner / np.outer(size, size)))
