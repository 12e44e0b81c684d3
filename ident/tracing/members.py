"""Which effects of the most probable set may be named: those that are certain, physical, and whose
evidence is large or spread over the record.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

import numpy as np

from ident.tracing.evidence import Key, WeighedSet
from ident.tracing.names import CLAIM_LEVEL, event_names, inclusion_of, look_alikes
from ident.tracing.search import Search
from ident.tracing.steady_search import SUPPORTED_Z, vuong
from ident.tracing.whiteness import is_noise
from sim.declaration.effect import full_name
from sim.declaration.proposal import Traceable

EVENT_GAIN = 200.0  # least gain of log evidence of an effect that passes once
WEAK_REASON = (
    "its gain in likelihood is only {:.1f} times the scatter of that gain over the record; "
    "{:.1f} times are required"
)
SMALL_EVENT_REASON = (
    "its gain in log evidence is {:.0f}; {:.0f} are required of a load, a gust or a jump that "
    "occurs once, since it can imitate many other causes"
)


def is_physical_effect(effect: Traceable, found: WeighedSet, interval: float) -> bool:
    """Return False for an effect that only corrects the interpolation of inputs between samples:
    a time within the interval, or a frequency above half the sampling rate.
    """
    local, values = effect.traits.within_interval, found.fitted.values.shared
    if any(
        values.get(full_name(effect, name), 0.0) > np.pi / interval
        for name in effect.traits.oscillates
    ):
        return False
    return not local or values.get(full_name(effect, local), np.inf) > interval


def certain_part(search: Search, best: WeighedSet, sets: Mapping[Key, float]) -> WeighedSet:
    """Return the most probable part of the set, or the set itself, in which every effect is certain
    together with those confusable with it; the set itself if there is none.

    Two effects of a set may be alternatives of each other, so that neither is certain beside the
    other. A less probable part is not taken: the uncertain effect is likely to act as well.
    """
    parts = [
        key
        for key, share in sets.items()
        if key < best.names and search.base_names <= key and share > 1.0 - CLAIM_LEVEL
    ]
    parts.sort(key=lambda key: -sets[key])
    inclusion = inclusion_of(sets)
    for one in (best, *(search.visited[key] for key in parts)):
        if all(
            inclusion[effect.name] + sum(look_alikes(search, one, effect, sets).values())
            >= CLAIM_LEVEL
            for effect in one.fitted.effects
            if effect.name not in search.base_names
        ):
            return one
    return best


def without_weak_members(
    search: Search, best: WeighedSet, clear: float
) -> tuple[WeighedSet, dict[str, str], set[str]]:
    """Return the likeliest set without weak members, and the names left out.

    Returns
    -------
    The set; the reason by name for the members of ``best`` that were left out; the names of all
    effects left out but events: these take no part in probabilities.
    """
    events = event_names(best.fitted.effects)
    best, slight = _drop_weak_members(search, best, clear)
    out = {*slight} - events
    # A small event stays the most probable cause: no other takes its place.
    while out and events.isdisjoint(slight):
        top = search.best(out)
        if top.weight <= best.weight:
            break
        best, more = _drop_weak_members(search, top, clear)
        if not more:
            break
        out |= more.keys()
    return best, slight, out


def _drop_weak_members(
    search: Search, best: WeighedSet, clear: float
) -> tuple[WeighedSet, dict[str, str]]:
    """Return the set without weak members, and the reason by name for each that is left out.

    Every model has small errors, which the probabilities ignore: an effect needs evidence that is
    spread over the record (Vuong's test). That of an event never is: it must be large instead.
    Effects with kinematic evidence are kept, since they do not depend on the force model.
    """
    left_out: dict[str, str] = {}
    usual = search.problem.background
    events = event_names(best.fitted.effects)
    while causes := search.added(best) - usual:
        slight = []
        for name in sorted(causes - search.problem.named_by_kinematics):
            smaller = _likeliest_without(search, best, name, usual)
            gain = math.inf if smaller is None else best.weight - smaller.weight
            if smaller is None or gain >= (EVENT_GAIN if name in events else clear):
                continue
            z = vuong(best, smaller, search.context.interval)
            # A sole effect is kept if the residual without it is not noise.
            acts = len(causes) == 1 and not is_noise(smaller.fitted.fit)
            if name in events:
                slight.append((z, name, smaller, SMALL_EVENT_REASON.format(gain, EVENT_GAIN)))
            elif z < SUPPORTED_Z and not acts:
                slight.append((z, name, smaller, WEAK_REASON.format(z, SUPPORTED_Z)))
        if not slight:
            break
        _, name, best, left_out[name] = min(slight, key=lambda each: each[0])
    return best, left_out


def _likeliest_without(
    search: Search, best: WeighedSet, name: str, usual: Collection[str]
) -> WeighedSet | None:
    """Return the likeliest set without a member, with or without nuisance dynamics (``usual``),
    which the member may have replaced.
    """
    search.set_without(best, name)  # fits this set if it is new
    rest = best.names - {name} - frozenset(usual)
    found = [one for key, one in search.visited.items() if key - frozenset(usual) == rest]
    return max(found, key=lambda one: one.weight, default=None)
