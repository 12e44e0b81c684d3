"""One verdict from the posterior probabilities of sets of effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.process_noise.filter_error import noise_levels
from ident.tracing.diagnosis import Candidate, Step, Verdict
from ident.tracing.evidence import Key, WeighedSet
from ident.tracing.fitted_model import FittedModel
from ident.tracing.names import (
    CLAIM_LEVEL,
    Named,
    inclusion_of,
    is_passing_event,
    look_alikes,
    named_with_rivals,
    passing_events,
    probabilities,
    rivals_of,
    with_shares,
)
from ident.tracing.problem import TraceProblem
from ident.tracing.search import CLEAR_GAIN, FITTED_SINGLES, Search
from ident.tracing.steady_search import (
    CONFUSABLE_SETS_Z,
    is_steady,
    quiet_vuong,
    required_z,
    search_spread_evidence,
    vuong,
)
from ident.tracing.whiteness import FITTED, is_noise, whiteness
from sim.declaration.effect import NoiseEffect, Station, full_name
from sim.declaration.proposal import Traceable

NEGLIGIBLE_RATIO = 1.1  # error over the noise up to which a discrepancy is of no consequence
LARGE_RATIO = 10.0  # error over the noise above which equations of forces prove no cause
OVER_LEAST = 6.0  # times the least noise of a sensor: 1.8 times what high frequencies show
SUPPORTED_Z = 3.0  # z of an effect that brings little
TWO_EVENTS = "two loads or gusts in passing are likelier one cause that the library lacks"
ROUGH_AIR = "its evidence comes from the maneuvers: rough air acts between them as well"
BESIDE_ROUGH_AIR = "it is found beside rough air that follows the maneuvers, which is no rough air"
LITTLE = "it brings little, {:.1f} times its scatter over the record; {:.1f} are required"
BESIDE_GUARD = "it is found beside a term that no effect of the library has"
MUCH_LEFT = "with all that was found the error remains {:.1f} times the noise"


@dataclass(frozen=True, eq=False)
class Decision:
    """What the records say.

    Attributes
    ----------
    best : the set that the verdict rests on. reference : the same noise without what is named.
    named : its effects. hints : effects that may act.
    searches : those that were made, in their order.
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
    def candidates(self) -> tuple[Candidate, ...]:
        """All candidates that were tried at fitted sets, by round."""
        return tuple(each for search in self.searches for each in search.tried)

    @property
    def stopped(self) -> bool:
        """Whether a search ended at its means."""
        return any(search.budget_spent for search in self.searches)


def searched(problem: TraceProblem, discrepancy: Traceable | None = None) -> Search:
    """Return the search without a discrepancy among effects that have a cause of their own.

    ``discrepancy`` : ends the search where it is by far likelier than what is found.
    """
    causes = [each for each in problem.candidates if not each.traits.general]
    return Search(problem, causes, title="white noise", discrepancy=discrepancy).run()


LeavesNoise = Callable[[FittedModel], bool]


def nothing_held_out(fitted: FittedModel) -> bool:
    """Return whether there are no further data to test a set against."""
    return True


def decided(
    search: Search,
    discrepancy: Traceable | None = None,
    leaves_noise: LeavesNoise = nothing_held_out,
    predicts_well: LeavesNoise | None = None,
) -> Decision:
    """Return the decision (``_decided``) without names that stand for a cause outside the library.

    Rough air acts whether or not the aircraft is maneuvered. An event may begin anywhere, and two
    of them imitate much that has another law: one cause that no effect has is likelier.

    Parameters
    ----------
    search : without a discrepancy (``searched``). discrepancy : None decides without one.
    leaves_noise : whether what a fitted set leaves is noise, of data that were not fitted too.
    predicts_well : whether a fitted set leaves hardly more than noise of data not fitted; the same
        as ``leaves_noise`` where it is left out.
    """
    decision = _decided(search, discrepancy, leaves_noise, predicts_well or leaves_noise)
    effects = {each.name: each for each in decision.best.effects}
    names = {each.name for each in decision.named}
    doubted = {
        name: ROUGH_AIR
        for name in names
        if isinstance(effects[name], NoiseEffect) and not _acts_when_quiet(decision, name)
    }
    if doubted:
        # What rough air stands for there is missing from the equations of all other names.
        rest = names - doubted.keys() - search.problem.named_by_kinematics
        doubted |= dict.fromkeys(rest, BESIDE_ROUGH_AIR)
    if len(_events(decision)) > 1:
        return _without_names(decision, dict.fromkeys(names, TWO_EVENTS))
    return _without_names(decision, doubted)


def _fitted(decision: Decision) -> tuple[Search, WeighedSet]:
    """Return the search of a decision's set, and the set in it."""
    names = frozenset(decision.best.names)
    search = next(each for each in reversed(decision.searches) if names in each.visited)
    return search, search.visited[names]


def _events(decision: Decision) -> set[str]:
    """Return the names, among those of a decision, of loads and gusts in passing."""
    effects = {each.name: each for each in decision.best.effects}
    return {each.name for each in decision.named if is_passing_event(effects[each.name])}


def _without_names(decision: Decision, reasons: Mapping[str, str]) -> Decision:
    """Return a decision that does not name these effects, by the reasons: they are hints."""
    if not reasons:
        return decision
    named = tuple(each for each in decision.named if each.name not in reasons)
    hints = tuple(
        replace(each, reason=reasons[each.name]) for each in decision.named if each.name in reasons
    )
    verdict = decision.verdict
    if not named:
        verdict = Verdict.UNEXPLAINED
    elif verdict is Verdict.TRACED:
        verdict = Verdict.PARTIAL
    return replace(decision, verdict=verdict, named=named, hints=(*decision.hints, *hints))


def _acts_when_quiet(decision: Decision, name: str) -> bool:
    """Return whether the evidence for rough air is also there while the aircraft hardly moves."""
    search, best = _fitted(decision)
    smaller = search.set_without(best, name)
    if smaller is None:
        return True
    declared, interval = decision.searches[0].declared, search.context.interval
    return quiet_vuong(best.fitted, smaller.fitted, declared, interval) >= CONFUSABLE_SETS_Z


def _decided(
    search: Search,
    discrepancy: Traceable | None,
    leaves_noise: LeavesNoise,
    predicts_well: LeavesNoise,
) -> Decision:
    """Decide, with further searches beside a discrepancy where no set of effects leaves noise.

    General forms have no cause of their own: they are tried where nothing with one is named.

    Parameters
    ----------
    search, discrepancy, leaves_noise, predicts_well : see ``decided``.
    """
    problem, best = search.problem, search.best()
    if is_noise(best.fitted.fit):
        found = _decided_under_white_noise(search, best)
        outside = bool(problem.guards & frozenset(found.best.names))
        general = _decided_with_general_forms(search, leaves_noise) if outside else None
        if general is not None:
            return general
        if leaves_noise(found.best):
            return found
        predicting = _decided_by_prediction(search, leaves_noise)
        if predicting is not None:
            return predicting
        if not found.named:
            return replace(found, verdict=Verdict.UNEXPLAINED)
        if predicts_well(found.best):
            return found
    if discrepancy is None:
        return _decided_with_general_forms(search, leaves_noise) or _unexplained(search, best)
    base = (discrepancy, *best.fitted.background)
    acting = [each for each in problem.candidates if is_steady(each)]
    steady = Search(problem, acting, base, title="a model discrepancy")
    beside = _decided_beside_discrepancy(
        search, steady, _other_forms(steady, search_spread_evidence(steady))
    )
    beside = _without_names(beside, _imitating(beside))
    forms = {each.name for each in problem.candidates if each.traits.general}
    if beside.named and not forms & {each.name for each in beside.named}:
        return beside
    return (
        _decided_with_small_misfit(search, best, discrepancy)
        or _decided_with_general_forms(search, leaves_noise)
        or beside
    )


def _decided_by_prediction(search: Search, leaves_noise: LeavesNoise) -> Decision | None:
    """The decision for the likeliest set that leaves noise of held-out data as well; None where
    no set that is nearly as likely as the leading one does.

    Likelier sets are set aside. What brings little to the fitted records may be what others need.
    Motion that any record may have is not taken for what is missing.
    """
    leading = sorted(search.visited.items(), key=lambda item: -item[1].weight)[: 2 * FITTED_SINGLES]
    usual = {each.name for each in search.problem.candidates if each.traits.background}
    failed: list[Key] = []
    for key, one in leading:
        if one.weight < leading[0][1].weight - CLEAR_GAIN:
            break
        if key & usual - leading[0][0]:
            continue
        if is_noise(one.fitted.fit) and leaves_noise(one.fitted):
            visited = dict(search.visited)
            for other in failed:
                search.visited[other] = replace(search.visited[other], weight=-math.inf)
            found = _decided_under_white_noise(search, one, clear=-math.inf)
            # What is decided may be another set than the one that was tested.
            if leaves_noise(found.best):
                return found
            search.visited.update(visited)
        failed.append(key)
    return None


def _decided_with_small_misfit(
    search: Search, best: WeighedSet, discrepancy: Traceable
) -> Decision | None:
    """The decision under white noise where the best set leaves hardly more than noise; else None.

    The search beside a discrepancy does not look for events, whose evidence is not spread over the
    records. Here they are named by the levels of white noise. None also where nothing is named.
    """
    fitted = search.fit((*best.fitted.effects, discrepancy), best.fitted)
    if fitted is None or _error_over_noise(best.fitted, fitted) > NEGLIGIBLE_RATIO:
        return None
    # What is wrong with a sensor is no matter of loads: beside them it is as large as before.
    tests, levels = whiteness(best.fitted.fit, FITTED), noise_levels(best.fitted.fit)
    left = {test.channel.partition(",")[0] for test in tests if not test.passed}
    least = search.problem.least_noise
    if any(levels[name] > OVER_LEAST * least.get(name, math.inf) for name in left):
        return None
    found = _decided_under_white_noise(search, best, clear=math.inf)
    # The misfit has to stay small without the members that bring little.
    enough = _error_over_noise(found.best, fitted) <= NEGLIGIBLE_RATIO
    return found if found.named and enough else None


def _decided_with_general_forms(search: Search, leaves_noise: LeavesNoise) -> Decision | None:
    """The decision with general forms among the candidates; None where they do not leave noise."""
    problem = search.problem
    if len(problem.candidates) == len(search.candidates):
        return None
    offered = [each for each in problem.candidates if not each.traits.guard]
    general = search.with_candidates(offered, "white noise, general forms as well").run()
    best = general.best()
    # A guard may be the same as a form: it gives way only where that is clearly likelier.
    guarded = search.best().names & problem.guards
    if guarded and best.weight < search.best().weight + CLEAR_GAIN:
        return None
    if not (is_noise(best.fitted.fit) and leaves_noise(best.fitted)):
        return None
    return replace(_decided_under_white_noise(general, best), searches=(search, general))


def _other_forms(search: Search, best: WeighedSet) -> WeighedSet:
    """Replace a member, beside a discrepancy, by another fault of the same sensor if that is
    clearly likelier.

    The relations between the sensors know few forms of a fault (a scale, a delay, an arm) and name
    the nearest of them. A threshold or a play is none of these.
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


def _is_cause(effect: Traceable, found: WeighedSet, interval: float) -> bool:
    """Return whether an effect is more than how inputs are to be read between samples: no time
    within the interval, and no frequency above half the sampling rate.
    """
    local, values = effect.traits.within_interval, found.fitted.values.shared
    if any(
        values.get(full_name(effect, name), 0.0) > np.pi / interval
        for name in effect.traits.oscillates
    ):
        return False
    return not local or values.get(full_name(effect, local), np.inf) > interval


def _group_probability(named: Named) -> float:
    """Return the probability of an effect or of one that the records do not tell from it."""
    return named.probability + sum(named.alternatives.values())


def _decided_under_white_noise(
    search: Search, best: WeighedSet, clear: float = CLEAR_GAIN
) -> Decision:
    """Decide under white noise: claim the certain effects, unless more effects leave noise; else
    the best set, by groups.
    """
    sets = probabilities(search)
    inclusion = inclusion_of(sets)
    whole = best = _certain_part(search, best, sets)
    best, slight, out = _without_weak_members(search, best, clear)
    guarded, best = best, _drop_guards(search, best)
    if best is not guarded:
        # A guard had chosen between effects that the records do not tell apart without it.
        out |= search.problem.guards
        top = search.best(out)
        if top.weight > best.weight and is_noise(top.fitted.fit):
            best, _, out = _without_weak_members(search, top, clear, out)
    if out:
        sets = probabilities(search, out)
        best = _certain_part(search, best, sets)
    named = [
        named_with_rivals(search, best, effect, sets)
        for effect in best.fitted.effects
        if _is_cause(effect, best, search.context.interval)
    ]
    # Where motion that any record may have is all, and uncertain, a declared model that leaves
    # noise stands.
    usual = all(each.traits.background for each in best.fitted.effects)
    uncertain = min(map(_group_probability, named), default=1.0) < CLAIM_LEVEL
    if usual and uncertain and is_noise(search.root.fitted.fit):
        named = [replace(each, within=best.fitted) for each in named]
        best = search.root
    if not named or best is search.root:
        verdict = Verdict.CONSISTENT
    elif search.problem.guards & best.names or min(map(_group_probability, named)) < CLAIM_LEVEL:
        verdict = Verdict.UNEXPLAINED
    else:
        alone = min(each.probability for each in named) >= CLAIM_LEVEL
        verdict = Verdict.TRACED if alone else Verdict.AMBIGUOUS
    claimed = verdict in (Verdict.TRACED, Verdict.AMBIGUOUS)
    claims, hints = (tuple(named), ()) if claimed else ((), tuple(named))
    if not search.problem.guards & set(slight):
        hints += tuple(
            Named(
                each.name, inclusion[each.name], {}, reason=slight[each.name], within=whole.fitted
            )
            for each in whole.fitted.effects
            if each.name in slight and _is_cause(each, whole, search.context.interval)
        )
    return Decision(verdict, best.fitted, search.root.fitted, claims, hints, (search,))


def _certain_part(search: Search, best: WeighedSet, sets: Mapping[Key, float]) -> WeighedSet:
    """Return the set without what is not certain in it, unless something that is not known
    certainly acts in addition to the rest.
    """
    inclusion = inclusion_of(sets)
    certain = frozenset(
        effect.name
        for effect in best.fitted.effects
        if inclusion[effect.name] + sum(look_alikes(search, best, effect, sets).values())
        >= CLAIM_LEVEL
    )
    return search.visited[certain] if sets.get(certain, 0.0) > 1.0 - CLAIM_LEVEL else best


def _without_weak_members(
    search: Search, best: WeighedSet, clear: float, before: Collection[str] = ()
) -> tuple[WeighedSet, dict[str, str], set[str]]:
    """Return the likeliest set without weak members (``_drop_weak_members``), those of ``best``
    with the reasons, and the names of all that are left out, ``before`` as well: they take no part
    in probabilities.
    """
    best, slight = _drop_weak_members(search, best, clear)
    out = {*before, *slight}
    while out:
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
    """Return the set without members that bring little and not all along.

    The equations of any model are a little wrong, and probabilities suppose that they are not. What
    the relations between the sensors name as well rests on no equation of forces, and stays.
    Also why those that are left out are, by name.
    """
    left_out: dict[str, str] = {}
    usual = {each.name for each in search.problem.candidates if each.traits.background}
    while causes := search.added(best) - usual:
        slight = []
        for name in sorted(causes - search.problem.named_by_kinematics):
            smaller = _likeliest_without(search, best, name, usual)
            if smaller is None or best.weight - smaller.weight >= clear:
                continue
            z = vuong(best, smaller, search.context.interval)
            # Where the declared model leaves more than noise something acts, and it is the sole.
            acts = len(causes) == 1 and not is_noise(smaller.fitted.fit)
            if z < SUPPORTED_Z and not acts:
                slight.append((z, name, smaller))
        if not slight:
            break
        z, name, best = min(slight, key=lambda each: each[0])
        left_out[name] = LITTLE.format(z, SUPPORTED_Z)
    return best, left_out


def _likeliest_without(
    search: Search, best: WeighedSet, name: str, usual: Collection[str]
) -> WeighedSet | None:
    """Return the set without a member, with or without the ``usual`` motion that any record may
    have, which an effect may stand for: whichever is likelier.
    """
    search.set_without(best, name)  # fitted now where it was not before
    rest = best.names - {name} - frozenset(usual)
    found = [one for key, one in search.visited.items() if key - frozenset(usual) == rest]
    return max(found, key=lambda one: one.weight, default=None)


def _drop_guards(search: Search, best: WeighedSet) -> WeighedSet:
    """Return the set without its guards, where it leaves noise that is hardly larger.

    A guard says that a cause outside the library acts; one that does so little changes nothing.
    """
    guards = search.problem.guards & best.names
    names = best.names - guards
    if not guards:
        return best
    plain = search.visited.get(names)
    if plain is None:
        effects = [each for each in best.fitted.effects if each.name in names]
        fitted = search.fit(effects, best.fitted)
        plain = None if fitted is None else search.store(fitted)
    if plain is None or not is_noise(plain.fitted.fit):
        return best
    return plain if _error_over_noise(plain.fitted, best.fitted) <= NEGLIGIBLE_RATIO else best


def _unexplained(search: Search, best: WeighedSet) -> Decision:
    """No name: what the best set leaves is not noise."""
    inclusion = inclusion_of(probabilities(search))
    where = " of data that were not fitted" if is_noise(best.fitted.fit) else ""
    why = f"with all that was found the residual{where} is not noise"
    hints = tuple(Named(name, inclusion[name], {}, reason=why) for name in sorted(best.names))
    root = search.root.fitted
    return Decision(Verdict.UNEXPLAINED, best.fitted, root, (), hints, (search,))


def _decided_beside_discrepancy(white: Search, search: Search, best: WeighedSet) -> Decision:
    """Decide beside a discrepancy: claim the effects that are spread over the records, with the
    rivals of each.
    """
    guards, root = search.problem.guards, search.root.fitted
    searches = (white, search)
    best, spread = _prefer_named_by_kinematics(search, *_drop_local_evidence(search, best))
    interval = search.context.interval
    named = [
        with_shares(name, 1.0, rivals_of(search, best, name) | passing_events(white, best, name), z)
        for name, z in spread.items()
        if _is_cause(next(e for e in best.fitted.effects if e.name == name), best, interval)
    ]
    if not named:
        return Decision(Verdict.UNEXPLAINED, root, root, (), (), searches)
    if guards & set(spread):
        hints = tuple(replace(each, reason=BESIDE_GUARD) for each in named)
        return Decision(Verdict.UNEXPLAINED, best.fitted, root, (), hints, searches)
    verdict = (
        Verdict.PARTIAL if all(each.probability >= 0.5 for each in named) else Verdict.AMBIGUOUS
    )
    return Decision(verdict, best.fitted, root, tuple(named), (), searches)


def _drop_local_evidence(search: Search, best: WeighedSet) -> tuple[WeighedSet, dict[str, float]]:
    """A set without the members whose evidence is not spread over the records; z of the others."""
    while True:
        without = {name: search.fit_without(best, name) for name in sorted(search.added(best))}
        spread = {
            name: math.inf if smaller is None else vuong(best, smaller, search.context.interval)
            for name, smaller in without.items()
        }
        # What lacks most of what it needs goes first.
        least = min(spread, key=lambda name: spread[name] - required_z(search, name), default="")
        smaller = without.get(least)
        if smaller is None or spread[least] >= required_z(search, least):
            return best, spread
        best = smaller


def _prefer_named_by_kinematics(
    search: Search, best: WeighedSet, spread: dict[str, float]
) -> tuple[WeighedSet, dict[str, float]]:
    """Prefer, of effects that the records do not tell apart, those that the relations between the
    sensors name: their prior odds are larger. Also return z of the members.
    """
    known = search.problem.named_by_kinematics
    for name in sorted(set(spread) - known):
        rest = best.names - {name}
        rivals = [
            one
            for key, one in search.visited.items()
            if rest < key
            and len(key) == len(best.names)
            and key - rest <= known
            and vuong(best, one, search.context.interval) < CONFUSABLE_SETS_Z
        ]
        if rivals:
            return _drop_local_evidence(search, max(rivals, key=lambda one: one.weight))
    return best, spread


def _imitating(decision: Decision) -> dict[str, str]:
    """Return the names, beside a discrepancy, that may stand for what the library lacks, with the
    reason: the set by itself leaves an error that is far above the noise.

    What kinematics name rests on no equation of forces, and rough air does not move the mean.
    """
    known = decision.searches[0].problem.named_by_kinematics
    names = {each.name for each in decision.named} - known
    names -= {each.name for each in decision.best.effects if isinstance(each, NoiseEffect)}
    if not names:
        return {}
    search, best = _fitted(decision)
    effects = [each for each in best.fitted.effects if each.name not in search.base_names]
    plain = decision.searches[0].fit(effects, best.fitted)
    ratio = math.inf if plain is None else _error_over_noise(plain, best.fitted)
    if ratio <= LARGE_RATIO:
        return {}
    return dict.fromkeys(names, MUCH_LEFT.format(ratio))


def _error_over_noise(plain: FittedModel, beside: FittedModel) -> float:
    """Largest ratio, over the outputs, of a fit's noise to that beside the discrepancy."""
    without, levels = noise_levels(plain.fit), noise_levels(beside.fit)
    return max(std / max(levels[name], 1e-300) for name, std in without.items())
