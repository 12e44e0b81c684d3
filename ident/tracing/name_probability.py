"""How probable it is that a claimed name is right: from all sets that were compared, and from what is in none of them.

A set's weight is the likelihood of the data under it, each of its prices a share of what the criterion charges; a set with a guard speaks for
something else, and so does the share of claims that were wrong in simulated papers and stand-ins whatever the sets said. The numbers are
calibrated there (``thresholds``), and ``docs/tracing-performance.md`` shows how many of those said to be 90 % right are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.tracing import thresholds
from ident.tracing.diagnosis import Claim
from ident.tracing.weighed import ComparedSet, Weighed

SOMETHING_ELSE = "something else"


def weights_of(sets: Sequence[ComparedSet]) -> np.ndarray:
    """Relative weights ``(len(sets),)`` of sets, the largest one."""
    behind = np.array([item.misfit + thresholds.SHARE_OF_PRICE * item.price + item.declared for item in sets])
    behind += np.array([thresholds.AGAINST_GUARDS if item.guard else 0.0 for item in sets])
    exponent = -0.5 * behind / thresholds.TEMPERATURE
    return np.asarray(np.exp(exponent - exponent.max()))


def name_probabilities(name: str, others: Collection[str], weighed: Weighed, twins: Collection[str]) -> Mapping[str, float]:
    """Probability that a claimed effect, each name that could take its place, or something else is what acts; together one.

    Parameters
    ----------
    name : the claimed effect. others : the effects in the model beside it.
    twins : other descriptions of the same fault, which count as ``name``.

    A set in which nothing takes its place counts as something else, and so does one with a guard.
    """
    mine, beside = {name, *twins}, set(others)
    found: dict[str, float] = {name: 0.0, SOMETHING_ELSE: 0.0}
    for item, weight in zip(weighed.sets, weights_of(weighed.sets) if weighed.sets else (), strict=True):
        new = [other for other in item.names if other not in beside and other not in mine]
        if mine & set(item.names):
            at = name
        elif item.guard or len(new) != 1:
            at = SOMETHING_ELSE
        else:
            at = new[0]
        found[at] = found.get(at, 0.0) + float(weight)
    wrong, total = thresholds.WRONG_WHATEVER[weighed.ground.value], sum(found.values())
    told = {key: (1.0 - wrong) * value / total for key, value in found.items()} if total > 0.0 else {name: 1.0 - wrong}
    told[SOMETHING_ELSE] = told.get(SOMETHING_ELSE, 0.0) + wrong
    return told


def with_probabilities(claims: Sequence[Claim], twins: Mapping[str, Collection[str]]) -> tuple[Claim, ...]:
    """The claims, each that is no hint with the probabilities of its name, of those that could take its place, and of something else.

    ``twins`` : by name of an effect, other descriptions of the same fault.
    """
    names = [claim.name for claim in claims]
    return tuple(_with_probability(claim, [name for name in names if name != claim.name], twins.get(claim.name, ())) for claim in claims)


def _with_probability(claim: Claim, others: Sequence[str], twins: Collection[str]) -> Claim:
    if not claim.claimed or claim.weighed is None:
        return claim
    return replace(claim, probability=name_probabilities(claim.name, others, claim.weighed, twins))
