"""Sets of leads: their evidence in closed form, and the sets that are worth a fit.

The model is linear-Gaussian, as in ``scan.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.tracing.evidence import set_prior
from ident.tracing.fitted_model import FittedModel
from ident.tracing.scan import (
    Lead,
    WhitenedFit,
    closed_form_gains,
    leads_of,
    start_values,
    whitened_fit,
)
from ident.tracing.signatures import candidate_signatures
from sim.declaration.proposal import SearchContext, Traceable

BEAM_WIDTH = 10  # sets of each size that are extended by a further lead
MOST_LEADS = 30  # most probable leads of which sets are built


@dataclass(frozen=True, eq=False)
class LinearSet:
    """A set of leads that may be added to a fitted set of effects, with its linearised evidence.

    Attributes
    ----------
    gain : gain of log evidence against the fitted set.
    weight : gain plus the log prior odds of the leads and of their placements.
    coefficients : for each lead, the posterior means ``(k,)`` of its coefficients.
    """

    leads: tuple[Lead, ...]
    gain: float
    weight: float
    coefficients: tuple[np.ndarray, ...]

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects that the set adds."""
        return frozenset(lead.effect.name for lead in self.leads)


def most_probable_sets(
    whitened: WhitenedFit,
    leads: Sequence[Lead],
    log_odds: Callable[[Lead], float],
    compatible: Callable[[Lead, Lead], bool],
    depth: int,
) -> tuple[list[LinearSet], Mapping[frozenset[str], float]]:
    """Return sets of up to ``depth`` leads and the cosines between the signatures of effects.

    Parameters
    ----------
    whitened : the fitted set at which the leads were found.
    log_odds : function that returns the log prior odds of a lead.
    compatible : function that returns whether two leads may be in one set.

    Returns
    -------
    The sets, the most probable first; the largest cosine between the signatures of two effects, by
    the pair of their names.
    """
    ranked = sorted(
        leads, key=lambda lead: -(lead.gain + lead.log_placement_prior + log_odds(lead))
    )[:MOST_LEADS]
    if not ranked:
        return [], {}
    columns = np.concatenate([lead.columns for lead in ranked], axis=1)
    B = whitened.hat_root.T @ columns
    gram, residual_products = columns.T @ columns - B.T @ B, columns.T @ whitened.residual
    ends = np.cumsum([lead.columns.shape[1] for lead in ranked])
    lead_columns = [
        np.arange(end - lead.columns.shape[1], end) for end, lead in zip(ends, ranked, strict=True)
    ]
    prior = [lead.log_placement_prior + log_odds(lead) for lead in ranked]

    def linear_set(members: tuple[int, ...]) -> LinearSet:
        columns_in_set = np.concatenate([lead_columns[i] for i in members])
        mean = np.concatenate([ranked[i].mean for i in members])
        sigma = np.concatenate([ranked[i].sigma for i in members])
        gains, coefficients = closed_form_gains(
            gram[np.ix_(columns_in_set, columns_in_set)][None],
            residual_products[columns_in_set][None],
            mean,
            sigma,
        )
        cuts = np.cumsum([len(lead_columns[i]) for i in members])[:-1]
        gain = float(gains[0])
        weight = gain + sum(prior[i] for i in members)
        chosen = tuple(ranked[i] for i in members)
        return LinearSet(chosen, gain, weight, tuple(np.split(coefficients[0], cuts)))

    count = range(len(ranked))
    allowed = [[compatible(ranked[i], ranked[j]) for j in count] for i in count]
    singles = [linear_set((i,)) for i in count]
    sets_by_members: dict[frozenset[int], LinearSet] = {frozenset((i,)): singles[i] for i in count}
    beam: list[tuple[int, ...]] = [(i,) for i in list(count)[:BEAM_WIDTH]]
    for _ in range(depth - 1):
        level: dict[frozenset[int], tuple[tuple[int, ...], LinearSet]] = {}
        for members in beam:
            for i in count:
                key = frozenset((*members, i))
                if key not in level and all(allowed[i][j] for j in members):
                    level[key] = ((*members, i), linear_set((*members, i)))
        best = sorted(level.items(), key=lambda each: -each[1][1].weight)[:BEAM_WIDTH]
        sets_by_members |= {key: one for key, (_, one) in best}
        beam = [members for _, (members, _) in best]
    sets = sorted(sets_by_members.values(), key=lambda each: -each.weight)
    return sets, _cosines(ranked, singles, lead_columns, gram)


def _cosines(
    ranked: Sequence[Lead],
    singles: Sequence[LinearSet],
    lead_columns: Sequence[np.ndarray],
    gram: np.ndarray,
) -> dict[frozenset[str], float]:
    """Return the largest cosine between the fitted output changes of two effects, by the pair of
    their names.

    Parameters
    ----------
    ranked : ``l`` leads. singles : the sets of each lead alone.
    lead_columns : for each lead, the positions of its columns in ``gram``.
    gram : ``(K, K)`` products of the columns of all leads, the unknowns of the set projected out.
    """
    fitted_changes = np.zeros((len(gram), len(ranked)))
    for i, single in enumerate(singles):
        fitted_changes[lead_columns[i], i] = single.coefficients[0]
    inner = fitted_changes.T @ gram @ fitted_changes
    norms = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    cosines = np.abs(inner / np.outer(norms, norms))
    largest_cosines: dict[frozenset[str], float] = {}
    for i, a in enumerate(ranked):
        for j, b in enumerate(ranked[:i]):
            key = frozenset((a.effect.name, b.effect.name))
            if len(key) == 2:
                largest_cosines[key] = max(largest_cosines.get(key, 0.0), float(cosines[i, j]))
    return largest_cosines


def leading_sets(
    sets: Sequence[LinearSet], singles: Collection[LinearSet], largest: int, most: int
) -> list[LinearSet]:
    """Return the sets to fit: the most probable single leads, and larger sets that are more
    probable than all smaller ones.

    Parameters
    ----------
    sets : the most probable first. singles : the best set of each effect alone.
    largest : largest number of effects in a set.
    most : number of single leads that are returned; half as many of each larger size.
    """
    chosen: list[LinearSet] = []
    least_weight = 0.0
    for size in range(1, largest + 1):
        best: dict[frozenset[str], LinearSet] = {}
        for each in sets:
            if len(each.leads) == size and each.weight > least_weight:
                best.setdefault(each.names, each)
        chosen += list(best.values())[: most if size == 1 else most // 2]
        if size == 1:
            # Nuisance dynamics are always tried: drifts and steps imitate them, and their gain
            # grows in a fit.
            nuisance = [one for one in singles if one.leads[0].effect.traits.background]
            chosen += [each for each in nuisance if each not in chosen]
        least_weight = max([least_weight, *(each.weight for each in chosen)])
    return chosen


def likely_starts(
    fitted: FittedModel, effect: Traceable, context: SearchContext
) -> list[tuple[Traceable, list[dict[str, float]]]]:
    """Return the starts from which to fit a set with one more effect, the likeliest first.

    Returns
    -------
    For each start the effect in the form that suits these records, and the starting values of its
    parameters by full name, one mapping a record.
    """
    whitened = whitened_fit(fitted, set_prior(fitted, context))
    signatures = [*candidate_signatures(fitted, [effect], context).values()]
    leads = leads_of(fitted, whitened, signatures, context)
    singles, _ = most_probable_sets(whitened, leads, lambda lead: 0.0, lambda one, other: False, 1)
    count = len(fitted.values.own)
    return [
        (
            one.leads[0].effect,
            start_values(one.leads[0], one.coefficients[0], count, context.interval),
        )
        for one in singles
    ]
