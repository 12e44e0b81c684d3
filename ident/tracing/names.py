"""Probabilities of the effects of a decision, and of their alternatives."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ident.tracing.evidence import Key, WeighedSet
from ident.tracing.fitted_model import FittedModel
from ident.tracing.search import CLEAR_GAIN, CONFUSABLE_COSINE, Search
from ident.tracing.steady_search import CONFUSABLE_SETS_Z, vuong
from sim.declaration.effect import NoiseEffect, StateJumpEffect, Station
from sim.declaration.proposal import Traceable

CLAIM_LEVEL = 0.95  # smallest probability of a claim


@dataclass(frozen=True)
class Named:
    """An effect of the decision, with its probability and those of its alternatives.

    ``spread`` : z of Vuong's test, with a discrepancy; None under white noise. ``reason`` : of a
    hint, why it is not claimed. ``within`` : the fitted set with the effect, if not the accepted
    one.
    """

    name: str
    probability: float
    alternatives: Mapping[str, float]
    spread: float | None = None
    reason: str = ""
    within: FittedModel | None = None


def probabilities(search: Search, without: Collection[str] = ()) -> dict[Key, float]:
    """Return the posterior probability of each fitted set without the excluded effects."""
    keys = [key for key in search.visited if key.isdisjoint(without)]
    weights = np.array([search.visited[key].weight for key in keys])
    share = np.exp(weights - weights.max())
    return dict(zip(keys, (share / share.sum()).tolist(), strict=True))


def inclusion_of(sets: Mapping[Key, float]) -> dict[str, float]:
    """Return the probability of each effect: the sum over the sets that contain it."""
    found: dict[str, float] = {}
    for key, share in sets.items():
        for name in key:
            found[name] = found.get(name, 0.0) + share
    return found


def named_with_rivals(
    search: Search, best: WeighedSet, effect: Traceable, sets: Mapping[Key, float]
) -> Named:
    """Return a member with its probability and those of its alternatives.

    Posterior odds assume that the model is true. The odds of an effect that Vuong's test cannot
    distinguish from the member are at least those of this test.
    """
    mine, alike = inclusion_of(sets)[effect.name], look_alikes(search, best, effect, sets)
    odds = {name: share / mine for name, share in alike.items()}
    formless = {
        each.name
        for each in search.candidates
        if each.traits.guard or (each.traits.general and not effect.traits.general)
    }
    # Nuisance dynamics may replace a likelier effect of small gain.
    least = -math.inf if effect.traits.background else 0.0
    for name, each in rivals_of(search, best, effect.name, CLEAR_GAIN, least).items():
        if name not in formless:
            odds[name] = max(each, odds.get(name, 0.0))
    return with_shares(effect.name, mine + sum(alike.values()), odds)


def with_shares(
    name: str, together: float, odds: Mapping[str, float], spread: float | None = None
) -> Named:
    """Return an effect and its alternatives with their shares of the total probability, from the
    ``odds`` of each alternative against the effect.
    """
    share = together / (1.0 + sum(odds.values()))
    return Named(name, share, {other: each * share for other, each in odds.items()}, spread)


def look_alikes(
    search: Search, best: WeighedSet, effect: Traceable, sets: Mapping[Key, float]
) -> dict[str, float]:
    """Return the effects that the records cannot distinguish from a member, with their
    probabilities.
    """
    found: dict[str, float] = {}
    equal: set[str] = set()
    traits = effect.traits
    for key, share in sets.items():
        if effect.name in key:
            continue
        for name in key - best.names:
            alike = search.alike.get(frozenset((name, effect.name)), 0.0) > CONFUSABLE_COSINE
            if alike or name in (*traits.equivalents, *traits.twins, *effect.aliases):
                found[name] = found.get(name, 0.0) + share
        new = key - best.names
        apart = abs(search.visited[key].fitted.fit.cost - best.fitted.fit.cost)
        if len(key) == len(best.names) and len(new) == 1 and apart < CONFUSABLE_SETS_Z:
            equal |= new & set(traits.equivalents)  # equivalent for the data; priors alone differ
    least = 0.05 * (1.0 - CLAIM_LEVEL)
    return {name: share for name, share in found.items() if share > least or name in equal}


def event_names(effects: Iterable[Traceable]) -> frozenset[str]:
    """Return the names of the effects that move the states from some time on, whatever they are, as
    a load, a gust or lost rows do; sensor events and jumps of derivatives do not.
    """
    return frozenset(
        each.name
        for each in effects
        if each.traits.onset
        and (each.station is Station.DISTURBANCE or isinstance(each, StateJumpEffect))
    )


def passing_events(white: Search, best: WeighedSet, name: str) -> dict[str, float]:
    """Return the passing loads and gusts that the search under white noise cannot distinguish from
    rough air, with their odds; none for another effect. The search with a discrepancy has no
    events.
    """
    (effect,) = [each for each in best.fitted.effects if each.name == name]
    names = best.names & ({each.name for each in white.candidates} | white.base_names)
    found = white.visited.get(frozenset(names))
    if not isinstance(effect, NoiseEffect) or found is None:
        return {}
    events = event_names(white.candidates)
    rivals = rivals_of(white, found, name, least=-math.inf)
    return {other: odds for other, odds in rivals.items() if other in events}


def rivals_of(
    search: Search,
    best: WeighedSet,
    name: str,
    clear: float = math.inf,
    least: float = 0.0,
) -> dict[str, float]:
    """Return the effects that Vuong's test cannot distinguish from one, with their odds by its
    normal distribution.

    Nuisance dynamics may be added or not. Only rivals less likely by more than ``least`` and less
    than ``clear`` (logarithms) count.
    """
    from scipy.special import ndtr

    rest = best.names - {name}
    usual = search.problem.background
    found: dict[str, float] = {}
    for key, other in search.visited.items():
        new = key - rest
        new = new - usual if len(new) > 1 else new
        if name in key or len(new) != 1 or not rest - usual <= key:
            continue
        z = vuong(best, other, search.context.interval)
        if z < CONFUSABLE_SETS_Z and least < best.weight - other.weight < clear:
            p, rival = float(ndtr(z)), next(iter(new))
            # Kinematic evidence is independent of the force model, and decides.
            even = 1.0 if rival in search.problem.named_by_kinematics else 0.0
            found[rival] = max((1.0 - p) / p, even, found.get(rival, 0.0))
    return found
