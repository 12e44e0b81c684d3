"""How probable it is that a claimed name is right: from all sets that were compared, and from what is in none of them.

A set's weight is the likelihood of the data under it, each of its prices a share of what the criterion charges; a set with a guard speaks for
something else, and so does the share of claims that were wrong in random cases and surrogate flights whatever the sets said. The numbers are
calibrated there (``thresholds``), and ``docs/tracing-performance.md`` shows how many of those said to be 90 % right are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.tracing import thresholds
from ident.tracing.diagnosis import Claim, Requirement
from ident.tracing.weighed import Weighed

SOMETHING_ELSE = "something else"


@dataclass(frozen=True)
class Calibration:
    """What random cases and surrogate flights teach.

    ``temperature`` : by ground, of the log likelihood, one where its model of the noise is right. ``share_of_price`` : of what the criterion
    charges. ``against_guards`` : in twice the log likelihood. ``wrong`` : by ground, the share of claims that are wrong whatever the sets say.
    """

    temperature: Mapping[str, float] = field(default_factory=lambda: thresholds.TEMPERATURE)
    share_of_price: float = field(default_factory=lambda: thresholds.SHARE_OF_PRICE)
    against_guards: float = field(default_factory=lambda: thresholds.AGAINST_GUARDS)
    wrong: Mapping[str, float] = field(default_factory=lambda: thresholds.WRONG_WHATEVER)


def weights_of(weighed: Weighed, calibration: Calibration | None = None) -> np.ndarray:
    """Relative weights ``(n,)`` of the n sets that were weighed, the largest one."""
    calibration, sets = calibration or Calibration(), weighed.sets
    behind = np.array([item.misfit + calibration.share_of_price * item.price + item.declared for item in sets])
    behind += np.array([calibration.against_guards if item.guard else 0.0 for item in sets])
    exponent = -0.5 * behind / calibration.temperature[weighed.ground.value]
    return np.asarray(np.exp(exponent - exponent.max()))


def name_probabilities(
    name: str, others: Collection[str], weighed: Weighed, twins: Collection[str], calibration: Calibration | None = None
) -> Mapping[str, float]:
    """Probability that a claimed effect, each name that could take its place, or something else is what acts; together one.

    Parameters
    ----------
    name : the claimed effect. others : the effects in the model beside it.
    twins : other descriptions of the same fault, which count as ``name``.

    A set in which nothing takes its place counts as something else, and so does one with a guard.
    """
    calibration = calibration or Calibration()
    mine, beside = {name, *twins}, set(others)
    found: dict[str, float] = {name: 0.0, SOMETHING_ELSE: 0.0}
    for item, weight in zip(weighed.sets, weights_of(weighed, calibration) if weighed.sets else (), strict=True):
        new = [other for other in item.names if other not in beside and other not in mine]
        if mine & set(item.names):
            at = name
        elif item.guard or len(new) != 1:
            at = SOMETHING_ELSE
        else:
            at = new[0]
        found[at] = found.get(at, 0.0) + float(weight)
    wrong, total = calibration.wrong[weighed.ground.value], sum(found.values())
    told = {key: (1.0 - wrong) * value / total for key, value in found.items()} if total > 0.0 else {name: 1.0 - wrong}
    told[SOMETHING_ELSE] = told.get(SOMETHING_ELSE, 0.0) + wrong
    # Under either name the equations are the same: nothing says which of them is likelier.
    names = (name, *weighed.same)
    return {**told, **dict.fromkeys(names, sum(told.get(each, 0.0) for each in names) / len(names))}


def with_probabilities(claims: Sequence[Claim], twins: Mapping[str, Collection[str]]) -> tuple[Claim, ...]:
    """The claims, each that is no hint with the probabilities of its name, of those that could take its place, and of something else.

    Alternatives are those that are likely enough (``thresholds.LIKELY_ENOUGH``).

    ``twins`` : by name of an effect, other descriptions of the same fault.
    """
    names = [claim.name for claim in claims]
    return tuple(_with_probability(claim, [name for name in names if name != claim.name], twins.get(claim.name, ())) for claim in claims)


def unlikely(claims: Sequence[Claim], twins: Mapping[str, Collection[str]]) -> list[str]:
    """Names of claims that are, with their alternatives, not likely enough beside something that is not named (``thresholds.LIKELY_BAR``)."""
    told = with_probabilities(claims, twins)
    return [c.name for c in told if c.probability and c.weighed and _named(c) < thresholds.LIKELY_BAR[c.weighed.ground.value]]


def likely_requirement(claims: Sequence[Claim], twins: Mapping[str, Collection[str]]) -> Requirement:
    """The requirement that the least likely of ``unlikely`` claims does not meet."""
    told = [c for c in with_probabilities(claims, twins) if c.probability and c.weighed]
    names = unlikely(claims, twins)
    least = min((c for c in told if c.name in names), key=_named)
    assert least.weighed is not None
    asked = f"the probability of {' or '.join((least.name, *least.alternatives))}"
    return Requirement(asked, _named(least), thresholds.LIKELY_BAR[least.weighed.ground.value], at_least=True, effects=tuple(names))


def _named(claim: Claim) -> float:
    return sum(claim.probability.get(name, 0.0) for name in {claim.name, *claim.alternatives})


def _with_probability(claim: Claim, others: Sequence[str], twins: Collection[str]) -> Claim:
    if not claim.claimed or claim.weighed is None:
        return claim
    told = name_probabilities(claim.name, others, claim.weighed, twins)
    weighed = replace(claim.weighed, twins=tuple(twins))
    return replace(claim, probability=told, weighed=weighed, alternatives=_likely_enough(claim, told, {*twins, *claim.weighed.same}))


def _likely_enough(claim: Claim, told: Mapping[str, float], alike: Collection[str]) -> tuple[str, ...]:
    """The alternatives that are likely enough to be named, other words for the same fault first; where it was cross-validated none is added."""
    likely = [name for name, p in sorted(told.items(), key=lambda item: -item[1]) if p > thresholds.LIKELY_ENOUGH]
    known = [name for name in claim.alternatives if name in alike or name in likely]
    further = [name for name in likely if name not in (claim.name, SOMETHING_ELSE) and claim.evidence is None]
    return tuple(dict.fromkeys([*known, *further]))[: thresholds.ALTERNATIVES_NAMED]
