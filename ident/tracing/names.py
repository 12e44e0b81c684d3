"""Effects of the most probable set that may be named, with their probabilities and alternatives.

An effect may be named if it is certain and physical, and if its evidence is large or spread over
the record.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ident.tracing.evidence import Key, WeighedSet
from ident.tracing.fitted_model import FittedModel
from ident.tracing.search import CLEAR_GAIN, CONFUSABLE_COSINE, Search
from ident.tracing.steady_search import CONFUSABLE_SETS_Z, SUPPORTED_Z, vuong
from ident.tracing.whiteness import is_noise
from sim.declaration.effect import NoiseEffect, StateJumpEffect, Station, full_name
from sim.declaration.proposal import Traceable

CLAIM_LEVEL = 0.95  # smallest probability of a claim
EVENT_ODDS = 200.0  # smallest log posterior odds of a claimed effect that occurs once
WEAK_REASON = (
    "its gain in likelihood is only {:.1f} times the scatter of that gain over the record; "
    "{:.1f} times are required"
)
SMALL_EVENT_REASON = (
    "its log posterior odds are {:.0f}; {:.0f} are required of a load, a gust or a jump that "
    "occurs once, since it can imitate many other causes"
)


@dataclass(frozen=True)
class Named:
    """An effect of the decision, with its probability and those of its alternatives.

    Attributes
    ----------
    name : of the effect.
    probability : of this effect as the cause.
    alternatives : probability of each effect that could take its place, by name.
    spread : z of Vuong's test for the effect, with a discrepancy; None under white noise.
    reason : of a hint, why it is not claimed.
    within : the fitted set with the effect, if this is not the accepted set.
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


def inclusion_probabilities(sets: Mapping[Key, float]) -> dict[str, float]:
    """Return the probability of each effect: the sum over the sets that contain it."""
    inclusion: dict[str, float] = {}
    for key, share in sets.items():
        for name in key:
            inclusion[name] = inclusion.get(name, 0.0) + share
    return inclusion


def named_with_alternatives(
    search: Search, best: WeighedSet, effect: Traceable, sets: Mapping[Key, float]
) -> Named:
    """Return a member of a set with its probability and those of its alternatives.

    ``sets`` : posterior probability of each fitted set.

    Posterior odds assume that the model is true. The odds of an effect that Vuong's test cannot
    distinguish from the member are at least those of this test.
    """
    probability = inclusion_probabilities(sets)[effect.name]
    confusable = confusable_effects(search, best, effect, sets)
    odds = {name: share / probability for name, share in confusable.items()}
    not_causes = {
        each.name
        for each in search.candidates
        if each.traits.guard or (each.traits.general and not effect.traits.general)
    }
    # Nuisance dynamics may replace a likelier effect of small gain.
    least = -math.inf if effect.traits.background else 0.0
    for name, each in alternatives_by_vuong(search, best, effect.name, CLEAR_GAIN, least).items():
        if name not in not_causes:
            odds[name] = max(each, odds.get(name, 0.0))
    return named_from_odds(effect.name, probability + sum(confusable.values()), odds)


def named_from_odds(
    name: str, total: float, odds: Mapping[str, float], spread: float | None = None
) -> Named:
    """Return an effect and its alternatives with their shares of a total probability.

    ``odds`` : of each alternative against the effect. ``spread`` : z of Vuong's test.
    """
    share = total / (1.0 + sum(odds.values()))
    return Named(name, share, {other: each * share for other, each in odds.items()}, spread)


def confusable_effects(
    search: Search, best: WeighedSet, effect: Traceable, sets: Mapping[Key, float]
) -> dict[str, float]:
    """Return the effects that the records cannot distinguish from a member, with their
    probabilities.
    """
    confusable: dict[str, float] = {}
    equivalent: set[str] = set()
    traits = effect.traits
    for key, share in sets.items():
        if effect.name in key:
            continue
        for name in key - best.names:
            similar = search.cosines.get(frozenset((name, effect.name)), 0.0) > CONFUSABLE_COSINE
            if similar or name in (*traits.equivalents, *traits.twins, *effect.aliases):
                confusable[name] = confusable.get(name, 0.0) + share
        new = key - best.names
        cost_difference = abs(search.visited[key].fitted.fit.cost - best.fitted.fit.cost)
        if len(key) == len(best.names) and len(new) == 1 and cost_difference < CONFUSABLE_SETS_Z:
            # equivalent for the data; priors alone differ
            equivalent |= new & set(traits.equivalents)
    least_probability = 0.05 * (1.0 - CLAIM_LEVEL)
    return {
        name: share
        for name, share in confusable.items()
        if share > least_probability or name in equivalent
    }


def event_names(effects: Iterable[Traceable]) -> frozenset[str]:
    """Return the names of the effects that disturb the states at some time: loads, gusts, jumps of
    states such as lost rows. Sensor events and jumps of derivatives are not among them.
    """
    return frozenset(
        each.name
        for each in effects
        if each.traits.onset
        and (each.station is Station.DISTURBANCE or isinstance(each, StateJumpEffect))
    )


def passing_events(white: Search, best: WeighedSet, name: str) -> dict[str, float]:
    """Return the loads and gusts of short duration that the search under white noise cannot
    distinguish from rough air, with their odds against it; none if the effect is not rough air.

    The search with a discrepancy has no events among its candidates, so they come from ``white``.
    """
    (effect,) = [each for each in best.fitted.effects if each.name == name]
    names = best.names & ({each.name for each in white.candidates} | white.base_names)
    same_set = white.visited.get(frozenset(names))
    if not isinstance(effect, NoiseEffect) or same_set is None:
        return {}
    events = event_names(white.candidates)
    alternatives = alternatives_by_vuong(white, same_set, name, least=-math.inf)
    return {other: odds for other, odds in alternatives.items() if other in events}


def alternatives_by_vuong(
    search: Search,
    best: WeighedSet,
    name: str,
    clear: float = math.inf,
    least: float = 0.0,
) -> dict[str, float]:
    """Return the effects that Vuong's test cannot distinguish from a member of a set, with their
    odds against it by the normal distribution of the test.

    Sets with and without nuisance dynamics are compared. A set with an alternative counts if the
    weight of ``best`` exceeds its weight by more than ``least`` and less than ``clear``.
    """
    from scipy.special import ndtr

    rest = best.names - {name}
    nuisance = search.problem.background
    odds: dict[str, float] = {}
    for key, other in search.visited.items():
        new = key - rest
        new = new - nuisance if len(new) > 1 else new
        if name in key or len(new) != 1 or not rest - nuisance <= key:
            continue
        z = vuong(best, other, search.context.interval)
        if z < CONFUSABLE_SETS_Z and least < best.weight - other.weight < clear:
            p, alternative = float(ndtr(z)), next(iter(new))
            # Kinematic evidence is independent of the force model, and decides.
            least_odds = 1.0 if alternative in search.problem.named_by_kinematics else 0.0
            odds[alternative] = max((1.0 - p) / p, least_odds, odds.get(alternative, 0.0))
    return odds


# ---- Members of the most probable set


def is_physical_effect(effect: Traceable, found: WeighedSet, interval: float) -> bool:
    """Return whether an effect is more than a correction of the inputs between samples.

    Such a correction has a time shorter than the interval, or a frequency above half the sampling
    rate.
    """
    local, values = effect.traits.within_interval, found.fitted.values.shared
    if any(
        values.get(full_name(effect, name), 0.0) > np.pi / interval
        for name in effect.traits.oscillates
    ):
        return False
    return not local or values.get(full_name(effect, local), np.inf) > interval


def certain_subset(search: Search, best: WeighedSet, sets: Mapping[Key, float]) -> WeighedSet:
    """Return ``best``, or its most probable subset, in which every effect is certain together with
    those confusable with it; ``best`` if there is none.

    Two effects of a set may be alternatives of each other, so that neither is certain in the
    presence of the other. An improbable subset does not count: the uncertain effect probably acts.
    """
    subsets = [
        key
        for key, share in sets.items()
        if key < best.names and search.base_names <= key and share > 1.0 - CLAIM_LEVEL
    ]
    subsets.sort(key=lambda key: -sets[key])
    inclusion = inclusion_probabilities(sets)
    for one in (best, *(search.visited[key] for key in subsets)):
        if all(
            inclusion[effect.name] + sum(confusable_effects(search, one, effect, sets).values())
            >= CLAIM_LEVEL
            for effect in one.fitted.effects
            if effect.name not in search.base_names
        ):
            return one
    return best


def without_weak_members(
    search: Search, best: WeighedSet, clear: float
) -> tuple[WeighedSet, dict[str, str], set[str]]:
    """Return the most probable set without weak members, and the names left out.

    Returns
    -------
    The set; the reason by name for each member of ``best`` that was left out; the names of all
    effects left out except events, which are excluded from probabilities.
    """
    events = event_names(best.fitted.effects)
    best, weak = _drop_weak_members(search, best, clear)
    out = {*weak} - events
    # A small event stays the most probable cause: no other takes its place.
    while out and events.isdisjoint(weak):
        top = search.best(out)
        if top.weight <= best.weight:
            break
        best, more = _drop_weak_members(search, top, clear)
        if not more:
            break
        out |= more.keys()
    return best, weak, out


def _drop_weak_members(
    search: Search, best: WeighedSet, clear: float
) -> tuple[WeighedSet, dict[str, str]]:
    """Return the set without weak members, and the reason by name for each that is left out.

    Every model has small errors, which the probabilities ignore: an effect needs evidence that is
    spread over the record (Vuong's test). The evidence of an event is local: it must be large.
    Effects with kinematic evidence are kept, since they do not depend on the force model.
    """
    left_out: dict[str, str] = {}
    nuisance = search.problem.background
    events = event_names(best.fitted.effects)
    while causes := search.added(best) - nuisance:
        weak = []
        for name in sorted(causes - search.problem.named_by_kinematics):
            smaller = _likeliest_without(search, best, name, nuisance)
            log_odds = math.inf if smaller is None else best.weight - smaller.weight
            if smaller is None or log_odds >= (EVENT_ODDS if name in events else clear):
                continue
            z = vuong(best, smaller, search.context.interval)
            # A sole effect is kept if the residual without it is not noise.
            acts = len(causes) == 1 and not is_noise(smaller.fitted.fit)
            if name in events:
                weak.append((z, name, smaller, SMALL_EVENT_REASON.format(log_odds, EVENT_ODDS)))
            elif z < SUPPORTED_Z and not acts:
                weak.append((z, name, smaller, WEAK_REASON.format(z, SUPPORTED_Z)))
        if not weak:
            break
        _, name, best, left_out[name] = min(weak, key=lambda each: each[0])
    return best, left_out


def _likeliest_without(
    search: Search, best: WeighedSet, name: str, nuisance: Collection[str]
) -> WeighedSet | None:
    """Return the likeliest set without a member, with or without nuisance dynamics (``nuisance``),
    which the member may have replaced.
    """
    search.set_without(best, name)  # fits this set if it is new
    rest = best.names - {name} - frozenset(nuisance)
    found = [one for key, one in search.visited.items() if key - frozenset(nuisance) == rest]
    return max(found, key=lambda one: one.weight, default=None)
