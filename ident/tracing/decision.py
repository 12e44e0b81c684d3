"""Verdict on a set of records, from the posterior probabilities of sets of effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from copy import copy
from dataclasses import dataclass, replace

from ident.tracing.diagnosis import Candidate, FittedSet, Step, Verdict
from ident.tracing.evidence import Key, WeighedSet
from ident.tracing.fitted_model import FittedModel
from ident.tracing.names import (
    CLAIM_LEVEL,
    Named,
    alternatives_by_vuong,
    certain_subset,
    event_names,
    inclusion_probabilities,
    is_physical_effect,
    named_from_odds,
    named_with_alternatives,
    passing_events,
    probabilities,
    without_weak_members,
)
from ident.tracing.problem import TraceProblem
from ident.tracing.search import CLEAR_GAIN, FITTED_SINGLES, Search
from ident.tracing.search_log import fitted_sets
from ident.tracing.steady_search import (
    CONFUSABLE_SETS_Z,
    is_steady,
    quiet_vuong,
    required_z,
    search_spread_evidence,
    vuong,
)
from ident.tracing.whiteness import is_noise
from sim.declaration.effect import NoiseEffect, Station
from sim.declaration.proposal import Traceable

ROUGH_AIR_REASON = "its evidence comes from the maneuvers alone: turbulence acts between them too"
CATCH_ALL_REASON = "the model also needs a term that stands for a cause outside the library"
LOCAL_REASON = (
    "its gain comes from a few places of the records: Vuong's z is {:.1f}, required is at least {}"
)


@dataclass(frozen=True, eq=False)
class Decision:
    """Verdict on a set of records.

    Attributes
    ----------
    best : the accepted set.
    reference : the fit without the named effects, under the same noise.
    named : claimed effects of ``best``. hints : effects that may act and are not claimed.
    searches : in the order in which they were run.
    """

    verdict: Verdict
    best: FittedModel
    reference: FittedModel
    named: tuple[Named, ...]
    hints: tuple[Named, ...]
    searches: tuple[Search, ...]

    @property
    def steps(self) -> tuple[Step, ...]:
        """Steps of the search, in order."""
        return tuple(step for search in self.searches for step in search.steps)

    @property
    def fits(self) -> dict[frozenset[str], FittedModel]:
        """Fits of the last search by the names of their effects."""
        return {key: one.fitted for key, one in self.searches[-1].visited.items()}

    @property
    def sets(self) -> tuple[FittedSet, ...]:
        """Fitted sets of all searches without failed ones, the most probable of each first."""
        return tuple(
            entry
            for search in self.searches
            for entry in fitted_sets(search.title, search.visited.values())
        )

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """All candidates that were tried at fitted sets; rounds count on from search to search."""
        candidates: list[Candidate] = []
        rounds_before = 0
        for search in self.searches:
            candidates += [replace(each, round=rounds_before + each.round) for each in search.tried]
            rounds_before += len(search.steps)
        return tuple(candidates)

    @property
    def stopped(self) -> bool:
        """Whether a search used up its budget of fits."""
        return any(search.budget_spent for search in self.searches)


def search_white_noise(problem: TraceProblem, discrepancy: Traceable | None = None) -> Search:
    """Run the search under white noise, without general forms, and return it.

    ``discrepancy`` : term for errors of the modelled forces. The search ends once this term is by
    far likelier than the effects found.
    """
    causes = [each for each in problem.candidates if not each.traits.general]
    return Search(problem, causes, title="white noise", discrepancy=discrepancy).run()


FitTest = Callable[[FittedModel], bool]


def nothing_held_out(fitted: FittedModel) -> bool:
    """Return True for any fit: the test to use if there are no held-out data."""
    return True


def decide(
    search: Search,
    discrepancy: Traceable | None = None,
    leaves_noise: FitTest = nothing_held_out,
    predicts_well: FitTest | None = None,
) -> Decision:
    """Return the decision under white noise; if no set of effects leaves noise, or only one with
    turbulence that follows the maneuvers, search again with a discrepancy.

    General forms are tried last: they name no cause.

    Parameters
    ----------
    search : the search without a discrepancy (``search_white_noise``).
    discrepancy : term for the errors of the forces; None leaves it out.
    leaves_noise : function that returns whether the residual of a fitted set on held-out data is
        noise.
    predicts_well : function that returns whether this residual is hardly larger than noise; the
        default is ``leaves_noise``.
    """
    best = search.best()
    found = _decide_by_white_noise(search, best, leaves_noise, predicts_well or leaves_noise)
    if found is not None and _turbulence_acts_throughout(found):
        return found
    found = None
    if discrepancy is not None:
        problem = search.problem
        base = (discrepancy, *best.fitted.background)
        acting = [each for each in problem.candidates if is_steady(each)]
        steady = Search(problem, acting, base, title="a model discrepancy")
        found = _decide_with_discrepancy(
            search, steady, _exchange_fault_forms(steady, search_spread_evidence(steady))
        )
        forms = {each.name for each in problem.candidates if each.traits.general}
        if found.named and not forms & {each.name for each in found.named}:
            return found
    general = _decide_with_general_forms(search, leaves_noise)
    if general is not None and _turbulence_acts_throughout(general):
        return general
    return found or _no_claims(search, best)


def _decide_by_white_noise(
    search: Search, best: WeighedSet, leaves_noise: FitTest, predicts_well: FitTest
) -> Decision | None:
    """Return the decision under white noise; None if no set leaves noise on fitted and held-out
    data, or hardly more than noise on the held-out ones.
    """
    if not is_noise(best.fitted.fit):
        return None
    found = _decide_under_white_noise(search, best)
    outside = bool(search.problem.guards & frozenset(found.best.names))
    general = _decide_with_general_forms(search, leaves_noise) if outside else None
    if general is not None:
        return general
    if leaves_noise(found.best):
        return found
    predicting = _decide_by_prediction(search, leaves_noise, best.names - {*found.best.names})
    if predicting is not None:
        return predicting
    if not found.named:
        return replace(found, verdict=Verdict.UNEXPLAINED)
    return found if predicts_well(found.best) else None


def _turbulence_acts_throughout(decision: Decision) -> bool:
    """Return whether claimed turbulence, if any, has evidence in steady flight as well.

    Turbulence that follows the maneuvers stands for an error of the modelled forces.
    """
    names = frozenset(decision.best.names)
    search = next(each for each in reversed(decision.searches) if names in each.visited)
    claimed = {each.name for each in decision.named}
    return all(
        _acts_when_quiet(search, search.visited[names], effect.name, decision.searches[0])
        for effect in decision.best.effects
        if effect.name in claimed and isinstance(effect, NoiseEffect)
    )


def _acts_when_quiet(search: Search, best: WeighedSet, name: str, white: Search) -> bool:
    """Return whether turbulence has evidence in the half of the record with the least motion.

    ``name`` : of the turbulence. ``white`` : search under white noise; its declared model gives
    the motion.
    """
    smaller = search.set_without(best, name)
    if smaller is None:
        return True
    interval = search.context.interval
    z = quiet_vuong(best.fitted, smaller.fitted, white.declared, interval)
    return z >= CONFUSABLE_SETS_Z


def _decide_by_prediction(
    search: Search, leaves_noise: FitTest, out: Collection[str]
) -> Decision | None:
    """Decide for the likeliest set whose residual on held-out data is noise as well; None if no set
    that is nearly as likely as the first one passes.

    The likelier sets that failed are excluded. A weak effect in the fitted records may be strong in
    others, but no set takes the place of one with a small event. Nuisance dynamics are not added
    here.

    Parameters
    ----------
    out : names of the members of the likeliest set that were left out, such as small events.
    """
    events = event_names(search.candidates) & {*out}
    leading = sorted(search.visited.items(), key=lambda item: -item[1].weight)[: 2 * FITTED_SINGLES]
    nuisance = search.problem.background
    failed: list[Key] = []
    for key, one in leading:
        if one.weight < leading[0][1].weight - CLEAR_GAIN:
            break
        if key & nuisance - leading[0][0] or not events <= key:
            continue
        if is_noise(one.fitted.fit) and leaves_noise(one.fitted):
            narrowed = copy(search)
            excluded = {other: replace(search.visited[other], weight=-math.inf) for other in failed}
            narrowed.visited = search.visited | excluded
            narrowed.repeated = search.repeated | {*failed}
            found = _decide_under_white_noise(narrowed, one, clear=-math.inf)
            # The decided set may differ from the tested one.
            if leaves_noise(found.best):
                return found
        failed.append(key)
    return None


def _decide_with_general_forms(search: Search, leaves_noise: FitTest) -> Decision | None:
    """Return the decision with general forms among the candidates; None if no set leaves noise."""
    problem = search.problem
    if len(problem.candidates) == len(search.candidates):
        return None
    offered = [each for each in problem.candidates if not each.traits.guard]
    general = search.with_candidates(offered, "white noise, general forms as well").run()
    best = general.best()
    # A general form may equal a catch-all term; it must be clearly likelier to replace it.
    guarded = search.best().names & problem.guards
    if guarded and best.weight < search.best().weight + CLEAR_GAIN:
        return None
    if not (is_noise(best.fitted.fit) and leaves_noise(best.fitted)):
        return None
    return replace(_decide_under_white_noise(general, best), searches=(search, general))


def _exchange_fault_forms(search: Search, best: WeighedSet) -> WeighedSet:
    """Return the set, each sensor fault with kinematic evidence replaced by another fault of the
    same sensor if this is clearly likelier.

    Kinematic evidence covers few forms of a fault (scale, delay, sensor position) and names the
    nearest of them; thresholds and backlash are not among them.
    """
    for name in sorted(search.added(best) & search.problem.named_by_kinematics):
        (effect,) = [each for each in best.fitted.effects if each.name == name]
        channel = getattr(effect, "channel", None)
        others = {
            each.name
            for each in search.candidates
            if each.station is Station.SENSOR_PATH and getattr(each, "channel", None) == channel
        }
        smaller = search.set_without(best, name)
        if channel is None or smaller is None:
            continue
        found = search.sets_with_replacement(smaller, others - {name})
        other = max(found, key=lambda one: one.weight, default=None)
        if other is not None and other.weight > best.weight + CLEAR_GAIN:
            best = other
    return best


def _group_probability(named: Named) -> float:
    """Return the probability of an effect together with those confusable with it."""
    return named.probability + sum(named.alternatives.values())


def _decide_under_white_noise(
    search: Search, best: WeighedSet, clear: float = CLEAR_GAIN
) -> Decision:
    """Return the decision under white noise: the certain effects of the best set are claimed.

    ``clear`` : gain of log evidence above which a member is not weak.
    """
    sets = probabilities(search)
    inclusion = inclusion_probabilities(sets)
    whole = best = certain_subset(search, best, sets)
    best, weak, out = without_weak_members(search, best, clear)
    if out:
        sets = probabilities(search, out)
        best = certain_subset(search, best, sets)
    named = [
        named_with_alternatives(search, best, effect, sets)
        for effect in best.fitted.effects
        if is_physical_effect(effect, best, search.context.interval)
    ]
    if any(name not in out for name in weak):
        # A phugoid that took the place of a small event is uncertain: it stays in the fit, unnamed.
        nuisance = search.problem.background
        named = [
            each
            for each in named
            if each.name not in nuisance or _group_probability(each) >= CLAIM_LEVEL
        ] or named
    # Keep the declared model if it leaves noise and only uncertain nuisance dynamics were found.
    slow_alone = all(each.traits.background for each in best.fitted.effects)
    uncertain = min(map(_group_probability, named), default=1.0) < CLAIM_LEVEL
    if slow_alone and uncertain and is_noise(search.base_set.fitted.fit):
        named = [replace(each, within=best.fitted) for each in named]
        best = search.base_set
    if not named or best is search.base_set:
        verdict = Verdict.CONSISTENT
    elif search.problem.guards & best.names or min(map(_group_probability, named)) < CLAIM_LEVEL:
        verdict = Verdict.UNEXPLAINED
    else:
        alone = min(each.probability for each in named) >= CLAIM_LEVEL
        verdict = Verdict.TRACED if alone else Verdict.AMBIGUOUS
    claimed = verdict in (Verdict.TRACED, Verdict.AMBIGUOUS)
    likely = [
        each
        for each in named
        if each.probability > 1.0 - CLAIM_LEVEL or each.name in search.problem.guards
    ]
    claims, hints = (tuple(named), ()) if claimed else ((), tuple(likely))
    if not search.problem.guards & set(weak):
        hints += tuple(
            Named(each.name, inclusion[each.name], {}, reason=weak[each.name], within=whole.fitted)
            for each in whole.fitted.effects
            if each.name in weak and is_physical_effect(each, whole, search.context.interval)
        )
    return Decision(verdict, best.fitted, search.base_set.fitted, claims, hints, (search,))


def _no_claims(search: Search, best: WeighedSet) -> Decision:
    """Return a decision without claims: the residual of the best set is not noise."""
    inclusion = inclusion_probabilities(probabilities(search))
    where = " of data that were not fitted" if is_noise(best.fitted.fit) else ""
    why = f"with all that was found the residual{where} is not noise"
    hints = tuple(Named(name, inclusion[name], {}, reason=why) for name in sorted(best.names))
    reference = search.base_set.fitted
    return Decision(Verdict.UNEXPLAINED, best.fitted, reference, (), hints, (search,))


def _decide_with_discrepancy(white: Search, search: Search, best: WeighedSet) -> Decision:
    """Return the decision with a discrepancy in the model: effects whose evidence is spread over
    the records are claimed, with their alternatives.
    """
    guards, reference = search.problem.guards, search.base_set.fitted
    searches = (white, search)
    best, spread = _drop_local_evidence(search, best)
    best, spread, rough = _drop_turbulence_of_maneuvers(white, search, best, spread)
    best, spread = _prefer_kinematic_names(search, best, spread)
    interval = search.context.interval
    effects = {each.name: each for each in best.fitted.effects}
    named = [
        named_from_odds(
            name,
            1.0,
            alternatives_by_vuong(search, best, name) | passing_events(white, best, name),
            z,
        )
        for name, z in spread.items()
        if is_physical_effect(effects[name], best, interval)
    ]
    if not named:
        return Decision(Verdict.UNEXPLAINED, reference, reference, (), rough, searches)
    if guards & set(spread):
        hints = tuple(replace(each, reason=CATCH_ALL_REASON) for each in named)
        return Decision(Verdict.UNEXPLAINED, best.fitted, reference, (), hints, searches)
    verdict = (
        Verdict.PARTIAL if all(each.probability >= 0.5 for each in named) else Verdict.AMBIGUOUS
    )
    hints = (*rough, *_local_hints(search, best))
    return Decision(verdict, best.fitted, reference, tuple(named), hints, searches)


def _prefer_kinematic_names(
    search: Search, best: WeighedSet, spread: dict[str, float]
) -> tuple[WeighedSet, dict[str, float]]:
    """Return the set, members replaced by effects with kinematic evidence if Vuong's test cannot
    distinguish the two, and z of its members.

    Kinematic evidence is preferred because it does not depend on the modelled forces.
    """
    known, names = search.problem.named_by_kinematics, best.names
    for name in sorted(set(spread) - known):
        others = [
            search.visited[best.names - {name} | {other}]
            for other in alternatives_by_vuong(search, best, name)
            if other in known - best.names and best.names - {name} | {other} in search.visited
        ]
        best = max(others, key=lambda one: one.weight, default=best)
    return (best, spread) if best.names == names else _drop_local_evidence(search, best)


def _drop_turbulence_of_maneuvers(
    white: Search, search: Search, best: WeighedSet, spread: dict[str, float]
) -> tuple[WeighedSet, dict[str, float], tuple[Named, ...]]:
    """Return the set without turbulence whose evidence is absent in steady flight, z of its other
    members, and the turbulence as a hint. The discrepancy takes its place.
    """
    hints: tuple[Named, ...] = ()
    for effect in best.fitted.effects:
        if effect.name not in spread or not isinstance(effect, NoiseEffect):
            continue
        smaller = search.set_without(best, effect.name)
        if smaller is None or _acts_when_quiet(search, best, effect.name, white):
            continue
        hints += (Named(effect.name, 0.0, {}, reason=ROUGH_AIR_REASON, within=best.fitted),)
        best, spread = _drop_local_evidence(search, smaller)
    return best, spread, hints


def _local_hints(search: Search, best: WeighedSet) -> tuple[Named, ...]:
    """Return as a hint the effect that would make the accepted set more probable, but whose
    evidence is local in time; an empty tuple if there is none.
    """
    larger = [
        one
        for key, one in search.visited.items()
        if best.names < key and len(key) == len(best.names) + 1 and one.weight > best.weight
    ]
    one = max(larger, key=lambda one: one.weight, default=None)
    if one is None:
        return ()
    (effect,) = [each for each in one.fitted.effects if each.name not in best.names]
    interval = search.context.interval
    z = vuong(one, best, interval)
    guard, least = effect.name in search.problem.guards, required_z(search, effect.name)
    if guard or not (0.0 < z < least and is_physical_effect(effect, one, interval)):
        return ()
    reason = LOCAL_REASON.format(z, least)
    return (Named(effect.name, 0.0, {}, reason=reason, within=one.fitted),)


def _drop_local_evidence(search: Search, best: WeighedSet) -> tuple[WeighedSet, dict[str, float]]:
    """Return the set without members whose evidence is local in time, and z of the others."""
    while True:
        without = {name: search.fit_without(best, name) for name in sorted(search.added(best))}
        spread = {
            name: math.inf if smaller is None else vuong(best, smaller, search.context.interval)
            for name, smaller in without.items()
        }
        # The member furthest below its required z is dropped first.
        least = min(spread, key=lambda name: spread[name] - required_z(search, name), default="")
        smaller = without.get(least)
        if smaller is None or spread[least] >= required_z(search, least):
            return best, spread
        best = smaller
