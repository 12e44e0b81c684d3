"""Search over sets of effects: proposed by linearised signatures, fitted, compared by their
evidence.

A round scans all candidates at one fitted set, computes the evidence of sets of them in closed
form, and fits the few with the largest. The fitted sets are the support of the posterior.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from ident.estimate import Outcome
from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.diagnosis import Candidate, Step
from ident.tracing.evidence import Key, WeighedSet, evidence_of, family_sizes, log_odds, set_prior
from ident.tracing.fitted_model import (
    FittedModel,
    Start,
    Values,
    absent_values,
    belongs_to_record,
    fit_set,
    levels_of,
    quantities,
    together,
)
from ident.tracing.linear_sets import LinearSet, leading_sets, most_probable_sets
from ident.tracing.problem import TraceProblem, search_context
from ident.tracing.scan import leads_of, start_values, whitened_fit
from ident.tracing.signatures import CandidateSignatures, candidate_signatures
from ident.tracing.whiteness import is_noise
from sim.declaration.effect import NoiseEffect, full_name
from sim.declaration.proposal import Refinable, SearchContext, Traceable
from sim.errors import ModelError

MOST_ROUNDS = 6
FITTED_SINGLES = 4  # single effects fitted in a round; half as many sets of each larger size
# alternatives fitted for a member; single effects at which further candidates are scanned
FITTED_RIVALS = 3
# shares of the linearised step from which a fit starts, tried until one improves
SHARES = (1.0, 0.3, 0.1)
LEAST_REALISED_GAIN_SHARE = 0.3  # smallest gain of a fit, relative to the predicted gain
SHIFTS = (-0.6, -0.3, 0.3, 0.6)  # s, changes of an event's time that are tried
CONFUSABLE_COSINE = 0.95  # smallest cosine of two confusable signatures
CLEAR_GAIN = 30.0  # gain of log likelihood that exceeds the effect of any prior
WORTH_GOING_ON = 1.0  # smallest gain of log likelihood worth further iterations of a fit
PROCESS_NOISE_OFFERED = 1e-2  # largest p-value of the residual tests at which rough air is tried


@dataclass(eq=False)
class Search:
    """A search over sets of effects.

    Attributes
    ----------
    problem : records and declared model.
    candidates : effects and catch-all terms to add.
    base : effects of every set that are never claimed, such as a model discrepancy.
    title : the noise, in words.
    discrepancy : of the loads; the search ends if it alone is by far likelier than the best set.
    visited : the fitted sets by the names of their effects, ``base`` included.
    expanded : sets at which all candidates were scanned.
    refined : sets tried in refined forms, by their parameters.
    repeated : sets whose failed fit was repeated.
    left_out : fits from which a set without the named effect was fitted.
    steps, tried : log of the search.
    alike : by pairs of names, the largest cosine of their signatures.
    fits : number of fits.
    shown, rivals : last simulated signatures of all candidates, weights of a discrepancy alone.
    last_gain : gain of weight by the last round; a search that continues another one has its gain.

    Raises
    ------
    ModelError : the declared model cannot be fitted to the records.
    """

    problem: TraceProblem
    candidates: Sequence[Traceable]
    base: tuple[Traceable, ...] = ()
    title: str = "white noise"
    discrepancy: Traceable | None = None
    visited: dict[Key, WeighedSet] = field(default_factory=dict)
    expanded: set[Key] = field(default_factory=set)
    refined: set[Key] = field(default_factory=set)
    repeated: set[Key] = field(default_factory=set)
    left_out: set[tuple[FittedModel, str]] = field(default_factory=set)
    alike: dict[Key, float] = field(default_factory=dict)
    shown: dict[int, CandidateSignatures] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)
    tried: list[Candidate] = field(default_factory=list)
    fits: int = 0
    rivals: dict[Key, float] = field(default_factory=dict)
    last_gain: float = math.inf

    def __post_init__(self) -> None:
        declared = self.problem.fit((), None)
        if declared is None:
            raise ModelError(
                "the declared model has no finite cost on these records",
                where=self.problem.records[0].name,
                remedy="check units and starting values",
            )
        self.declared = declared
        self.context: SearchContext = search_context(declared, self.problem.predicted)
        self.families = family_sizes(self.candidates)

    @cached_property
    def root(self) -> WeighedSet:
        """The set with the base alone; the declared model if there is no base or it cannot be
        fitted.
        """
        if not self.base:
            return self.store(self.declared)
        fitted = self.problem.fit(self.base, self.declared, rough=True)
        return self.store(fitted if fitted is not None else self.declared)

    @property
    def base_names(self) -> Key:
        """Names of the effects in every set."""
        return frozenset(effect.name for effect in self.base)

    def added(self, one: WeighedSet) -> Key:
        """Return the names of the effects of a set beyond the base."""
        return one.names - self.base_names

    @property
    def budget_spent(self) -> bool:
        """Whether the budget of fits is used up."""
        return self.fits > self.problem.settings.budget

    def store(self, fitted: FittedModel) -> WeighedSet:
        """Evaluate a fit and store it; of two optima of a set the better one.

        The fit of a likely set that ended early is continued, so that speed of convergence does not
        decide between alternatives.
        """
        self.fits += 1
        found = self._weighed(fitted)
        best = max((one.weight for one in self.visited.values()), default=-math.inf)
        while (
            found.fitted.fit.outcome is Outcome.MAX_ITERATIONS and found.weight > best - CLEAR_GAIN
        ):
            further = self.fit(found.fitted.effects, found.fitted)
            if further is None or further.fit.cost > found.fitted.fit.cost - WORTH_GOING_ON:
                break
            found = self._weighed(further)
        old = self.visited.get(found.names)
        if old is None or found.weight > old.weight:
            self.visited[found.names] = found
            self._set_aside_failed(found)
        return self._fitted_from_part(self.visited[found.names])

    def _set_aside_failed(self, new: WeighedSet) -> None:
        """Exclude sets that fit worse than one of their subsets, ``new`` or because of it: their
        fits missed the optimum.
        """
        for one in [*self.visited.values()]:
            for part, whole in ((one, new), (new, one)):
                lost = part.fitted.fit.log_likelihood - whole.fitted.fit.log_likelihood
                if part.names < whole.names and lost > CLEAR_GAIN:
                    self.visited[whole.names] = replace(whole, weight=-math.inf)

    def _weighed(self, fitted: FittedModel) -> WeighedSet:
        evidence, offset, covariance = evidence_of(fitted, self.context)
        return self.weighed_by_own_odds(WeighedSet(fitted, evidence, 0.0, offset, covariance))

    def fit(
        self,
        effects: Sequence[Traceable],
        parent: FittedModel,
        added: Sequence[Mapping[str, float]] = (),
        values: Values | None = None,
    ) -> FittedModel | None:
        """Fit a set coarsely from the values of another; ``added`` are new values of each
        record.
        """
        values = values or parent.values
        start = Start(values.with_added(added) if added else values, {}, levels_of(parent))
        return fit_set(self.problem.data, tuple(effects), self.problem.roughly, start)

    def fit_proposed(self, parent: WeighedSet, proposed: LinearSet) -> WeighedSet | None:
        """Fit the parent's set with the leads of a proposed one.

        If the linearised step does not improve the fit, a shorter one is tried.
        """
        effects = (*parent.fitted.effects, *(lead.effect for lead in proposed.leads))
        best: FittedModel | None = None
        before: list[dict[str, float]] = []
        for share in SHARES:
            added: list[dict[str, float]] = [{} for _ in parent.fitted.values.own]
            for lead, coefficients in zip(proposed.leads, proposed.coefficients, strict=True):
                starts = start_values(lead, share * coefficients, len(added), self.context.interval)
                for record, one in zip(added, starts, strict=True):
                    record |= one
            if added == before:  # no lead has an amplitude
                break
            before = added
            fitted = self.fit(effects, parent.fitted, added)
            if fitted is not None and (best is None or fitted.fit.cost < best.fit.cost):
                best = fitted
            brought = parent.fitted.fit.cost - best.fit.cost if best is not None else -math.inf
            if brought > LEAST_REALISED_GAIN_SHARE * proposed.gain:
                break
        return None if best is None else self.store(best)

    def fit_without(self, parent: WeighedSet, name: str) -> WeighedSet | None:
        """Return the set without one of its effects, fitted from the values of the others, and if
        that loses much also with the derivatives of the first set: the effect may have moved them.
        """
        if (parent.fitted, name) in self.left_out:
            return self.set_without(parent, name)
        effects = tuple(effect for effect in parent.fitted.effects if effect.name != name)
        tries = [self.fit(effects, parent.fitted)]
        if tries[0] is None or tries[0].fit.cost > parent.fitted.fit.cost + CLEAR_GAIN:
            values = parent.fitted.values.with_shared(self.root.fitted.values.shared)
            tries.append(self.fit(effects, parent.fitted, values=values))
        best = min((each for each in tries if each), key=lambda each: each.fit.cost, default=None)
        if best is None:
            return None
        self.left_out.add((parent.fitted, name))
        return self.store(best)

    def _fitted_from_part(self, one: WeighedSet) -> WeighedSet:
        """Return a set; if it fits worse than a part of it, fitted again from the best part, with
        its other effects absent.
        """
        if one.weight > -math.inf or one.names in self.repeated:
            return one
        self.repeated.add(one.names)
        parts = [each for key, each in self.visited.items() if key < one.names]
        part = max(parts, key=lambda each: each.fitted.fit.log_likelihood)
        absent = absent_values(each for each in one.fitted.effects if each.name not in part.names)
        own = part.fitted.values.own
        again = self.fit(one.fitted.effects, part.fitted, [absent] * len(own))
        return one if again is None else self.store(again)

    def set_without(self, parent: WeighedSet, name: str) -> WeighedSet | None:
        """Return the set without one of its effects, stored or fitted now."""
        found = self.visited.get(parent.names - {name})
        return self.fit_without(parent, name) if found is None else self._fitted_from_part(found)

    def run(self) -> Search:
        """Run rounds until the best set has been scanned and no set is better.

        Then each of its members is left out, and alternatives are tried. The search ends at once
        if a discrepancy is by far likelier.
        """
        _ = self.root
        if self._discrepancy_is_likelier():
            return self
        for _ in range(MOST_ROUNDS):
            best = self.best()
            if best.names in self.expanded or self.budget_spent:
                break
            self.expand(best)
            self.last_gain = self.best().weight - best.weight
            if not self._discrepancy_is_likelier():
                self._in_finer_forms()
                self._with_look_alikes()
                self.last_gain = self.best().weight - best.weight
            if self._discrepancy_is_likelier():
                return self
        for _ in range(2):
            top = self.best()
            members = sorted(self.added(top))
            # Pairs are found by scans of single effects; larger sets may have replaced another
            # pair, and an event has another place beside another effect.
            if len(members) > 2 or not is_noise(top.fitted.fit):
                self._scan_beside_single_effects()
            for name in members if len(members) > 1 else ():
                smaller = self.fit_without(top, name)
                new = smaller is not None and smaller.names not in self.expanded
                if smaller is not None and new and not self.budget_spent:
                    self.expand(smaller, most=2)
            if self.best() is top or self.budget_spent:
                break
            if self.best().names not in self.expanded:
                self.expand(self.best())
            self._in_finer_forms()
        self._with_look_alikes()
        self._with_equivalents()
        return self

    def _discrepancy_is_likelier(self) -> bool:
        """Return whether a discrepancy alone exceeds the best set by more than the gain of the last
        round.
        """
        best = self.best()
        if self.discrepancy is None or self.last_gain == math.inf or is_noise(best.fitted.fit):
            return False
        base = (self.discrepancy, *best.fitted.background)
        key = frozenset(each.name for each in base)
        if key not in self.rivals:
            self.rivals[key] = Search(self.problem, (), base).root.weight
        return self.rivals[key] - best.weight > self.last_gain

    def rerun_in(self, problem: TraceProblem, data: str) -> Search:
        """Return the search with other masks or records; it continues if another set is then the
        most probable of those fitted again. ``data`` names the data for the log.
        """
        other = self.refitted(problem, data)
        return other if other.best().names == self.best().names else other.run()

    def refitted(self, problem: TraceProblem, data: str) -> Search:
        """Return a search of other data, or another reading of the same, with the leading sets
        fitted again. ``data`` names the data for the log.
        """
        other = Search(problem, self.candidates, self.base, self.title, self.discrepancy)
        other.alike, other.steps, other.tried = dict(self.alike), [*self.steps], [*self.tried]
        other.last_gain = self.last_gain
        found = [other.root]
        leading = sorted(self.visited.values(), key=lambda one: -one.weight)[: 2 * FITTED_SINGLES]
        for one in leading:
            fitted = other.fit(one.fitted.effects, one.fitted) if self.added(one) else None
            if fitted is not None:
                found.append(other.store(fitted))
        other.expanded = self.expanded & {one.names for one in found} - {other.best().names}
        other._log_best(f"{self.title}, {data}: the leading sets fitted again")
        return other

    def with_candidates(self, candidates: Sequence[Traceable], title: str) -> Search:
        """Return a search among other candidates, with those sets of this one that they allow."""
        other = Search(self.problem, candidates, self.base, title, self.discrepancy)
        other.alike = dict(self.alike)
        offered = {each.name for each in candidates} | self.base_names
        for key, one in self.visited.items():
            if key <= offered:
                other.visited[key] = other.weighed_by_own_odds(one)
        if other.root.names in self.expanded:
            other.expand(other.root)
        return other

    def weighed_by_own_odds(self, one: WeighedSet) -> WeighedSet:
        """Return a fitted set with the prior odds of this search; an excluded one stays
        excluded.
        """
        if one.weight == -math.inf:
            return one
        named = [effect for effect in one.fitted.effects if effect not in self.base]
        odds = log_odds(named, self.families, self.problem.named_by_kinematics)
        return replace(one, weight=one.evidence + odds)

    def with_kinematics(self, groups: Sequence[tuple[str, ...]]) -> Search:
        """Return the search with effects that have kinematic evidence.

        The prior odds of its sets change; it continues if another set is then the most probable.
        """
        self.problem = self.problem.with_kinematics(groups)
        for key, one in self.visited.items():
            self.visited[key] = self.weighed_by_own_odds(one)
        named = self.set_named_by_kinematics()
        if self._discrepancy_is_likelier():
            return self
        if named is not None and named.names not in self.expanded and not self.budget_spent:
            self.expand(named)  # further effects were searched for at other sets only
        return self if self.best().names in self.expanded else self.run()

    def set_named_by_kinematics(self) -> WeighedSet | None:
        """Return the likeliest set of all effects with kinematic evidence, one of each group of
        confusable ones.

        The first of each group is tried, then the others in its place; None without a candidate.
        """
        offered = {each.name: each for each in self.candidates}
        chosen: list[Traceable] = []
        others: dict[str, list[Traceable]] = {}
        for group in self.problem.kinematic:
            mine = [offered[name] for name in group if name in offered]
            if mine and all(together(mine[0], each) for each in chosen):
                chosen.append(mine[0])
                others[mine[0].name] = mine[1:]
        fitted = self.fit((*self.base, *chosen), self.root.fitted) if chosen else None
        if fitted is None:
            return None
        best = self.store(fitted)
        for one in chosen:
            rest = [each for each in chosen if each is not one]
            for other in others[one.name]:
                if all(together(other, each) for each in rest):
                    swapped = self.fit((*self.base, *rest, other), fitted)
                    if swapped is not None:
                        best = max(best, self.store(swapped), key=lambda one: one.weight)
        return best

    def _in_finer_forms(self) -> None:
        """Try the leading set of each size in refined forms of its effects."""
        leading: dict[int, tuple[Key, WeighedSet]] = {}
        for key, one in self.visited.items():
            best = leading.get(len(key))
            if not key & self.problem.guards and (best is None or one.weight > best[1].weight):
                leading[len(key)] = (key, one)
        for _, one in [*leading.values()]:
            while (finer := self._refined_set(one)) is not None and finer.weight > one.weight:
                one = finer

    def _refined_set(self, one: WeighedSet) -> WeighedSet | None:
        """Return a set with the refined forms of its effects; None if there are none."""
        fitted = one.fitted
        forms = [each.finer() if isinstance(each, Refinable) else each for each in fitted.effects]
        names = frozenset(full_name(each, item.name) for each in forms for item in each.parameters)
        if forms == list(fitted.effects) or names in self.refined or self.budget_spent:
            return None
        self.refined.add(names)
        known = {*fitted.values.shared, *fitted.values.own[0]}
        absent = {name: v for name, v in absent_values(forms).items() if name not in known}
        other = self.fit(forms, fitted, [absent] * len(fitted.values.own))
        return None if other is None else self.store(other)

    def _with_look_alikes(self) -> None:
        """Try the best set with each member replaced by each confusable effect."""
        best = self.best()
        for effect in [each for each in best.fitted.effects if each.name in self.added(best)]:
            wanted = {
                name
                for name in (*self._confusable_names(effect.name), *effect.traits.twins)
                if best.names - {effect.name} | {name} not in self.visited
            }
            if not wanted:
                continue
            smaller = self.visited.get(best.names - {effect.name})
            smaller = smaller or self.fit_without(best, effect.name)
            if smaller is not None:
                self.sets_with_replacement(smaller, wanted)

    def sets_with_replacement(
        self, smaller: WeighedSet, wanted: Collection[str]
    ) -> list[WeighedSet]:
        """Return the fitted sets of ``smaller`` with one of the ``wanted`` effects: those with the
        largest predicted gain.
        """
        proposed = self._proposed(smaller, 1, 0, wanted)[:FITTED_RIVALS]
        made = (self.fit_proposed(smaller, each) for each in proposed)
        return [each for each in made if each is not None]

    def _with_equivalents(self) -> None:
        """Try the best set with each member replaced by each observationally equivalent effect."""
        best = self.best()
        offered = {each.name: each for each in self.candidates}
        for effect in [each for each in best.fitted.effects if each.name in self.added(best)]:
            rest = [each for each in best.fitted.effects if each is not effect]
            for name in effect.traits.equivalents:
                names = best.names - {effect.name} | {name}
                if name in offered and name not in best.names and names not in self.visited:
                    fitted = self.fit((*rest, offered[name]), best.fitted)
                    if fitted is not None:
                        self.store(fitted)

    def _scan_beside_single_effects(self) -> None:
        """Scan at the best single effects: the one in the best set may have replaced two."""
        singles = [one for one in self.visited.values() if len(self.added(one)) == 1]
        for one in sorted(singles, key=lambda each: -each.weight)[:FITTED_RIVALS]:
            if one.names not in self.expanded and not self.budget_spent:
                self.expand(one, most=2)

    def best(self, without: Collection[str] = ()) -> WeighedSet:
        """Return the set of largest posterior probability without the excluded effects."""
        found = [one for key, one in self.visited.items() if key.isdisjoint(without)]
        return max(found, key=lambda one: one.weight)

    def expand(
        self, parent: WeighedSet, most: int = FITTED_SINGLES, deepest: int | None = None
    ) -> None:
        """Scan at a set, evaluate sets of leads (up to ``deepest``), fit the best ones."""
        self.expanded.add(parent.names)
        beside = " + ".join(sorted(self.added(parent))) or "the declared model"
        doing, share = f"{self.title}: what is missing beside {beside}", self.fits / 100.0
        self.problem.progress(doing, min(0.1 + 0.7 * share, 0.85))
        made: list[WeighedSet] = []
        causes = [
            each
            for each in parent.fitted.effects
            if not (each.traits.background or each in self.base)
        ]
        deeper = self.problem.settings.depth - len(causes) if deepest is None else deepest
        if deeper > 0:
            made = [
                child
                for proposed in self._proposed(parent, deeper, most)
                if parent.names | proposed.names not in self.visited
                and (child := self.fit_proposed(parent, proposed)) is not None
            ]
            leading = max(made, key=lambda one: one.weight, default=None)
            if leading is not None and leading.weight >= self.best().weight:
                # The order of sets depends on the times of their events.
                made.append(self._with_events_moved(leading))
        rough = has_process_noise(parent.fitted.system)
        offered = self.base or not (rough or is_noise(parent.fitted.fit, PROCESS_NOISE_OFFERED))
        if offered and most == FITTED_SINGLES:
            made += self._with_process_noise(parent)
        self._log_round(parent, beside, made)

    def _log_round(self, parent: WeighedSet, beside: str, made: Sequence[WeighedSet]) -> None:
        """Log the candidates tried at a set, for the report."""
        number, within = len(self.steps) + 1, tuple(sorted(parent.names))
        for child in (each for each in made if each.weight > -math.inf):
            gains = child.evidence - parent.evidence, child.weight - parent.weight
            for effect in child.fitted.effects:
                if child.names - parent.names == {effect.name}:
                    found = quantities(child.fitted, effect)
                    like = self._confusable_names(effect.name)
                    self.tried.append(
                        Candidate(number, within, effect.name, *gains, True, found, like)
                    )
        self._log_best(
            f"{self.title}, effects added to {beside}: {len(self.candidates)} candidates scanned, "
            f"{len(made)} set{'s' * (len(made) != 1)} fitted"
        )

    def _log_best(self, what: str) -> None:
        """Log what was done, with the most probable set after it."""
        best = self.best()
        names = " + ".join(sorted(self.added(best))) or "nothing"
        sentence = (
            f"{what}; most probable so far is {names}, log posterior odds "
            f"{best.weight - self.root.weight:+.1f} against the declared model"
        )
        found = best.fitted.fit.log_likelihood
        self.steps.append(Step(tuple(sorted(best.names)), best.evidence, found, sentence))

    def _confusable_names(self, name: str) -> tuple[str, ...]:
        """Return the names of effects with nearly the same signature."""
        pairs = [
            key for key, cosine in self.alike.items() if name in key and cosine > CONFUSABLE_COSINE
        ]
        return tuple(sorted(other for key in pairs for other in key - {name}))

    def _proposed(
        self, parent: WeighedSet, deeper: int, most: int, wanted: Collection[str] = ()
    ) -> list[LinearSet]:
        """Return the most probable single leads, and larger sets that exceed all smaller ones.

        With ``most`` zero, single leads of ``wanted`` names alone. Signatures come from the last
        scan at a leading set: at other sets they are nearly equal.
        """
        ready = whitened_fit(parent.fitted, set_prior(parent.fitted, self.context))
        if most == FITTED_SINGLES or not self.shown:
            self.shown |= candidate_signatures(parent.fitted, self.candidates, self.context)
        shown = [one for one in self.shown.values() if most or one[0].name in wanted]
        leads = [
            lead
            for lead in leads_of(parent.fitted, ready, shown, self.context)
            if all(together(lead.effect, other) for other in parent.fitted.effects)
        ]
        sets, overlap = most_probable_sets(
            ready,
            leads,
            lambda lead: log_odds([lead.effect], self.families, self.problem.named_by_kinematics),
            lambda a, b: together(a.effect, b.effect),
            deeper,
        )
        for key, cosine in overlap.items():
            self.alike[key] = max(self.alike.get(key, 0.0), cosine)
        number, within = len(self.steps) + 1, tuple(sorted(parent.names))
        singles = {one.leads[0].effect.name: one for one in reversed(sets) if len(one.leads) == 1}
        for name, one in singles.items():
            like = self._confusable_names(name)
            self.tried.append(
                Candidate(number, within, name, one.gain, one.weight, False, {}, like)
            )
        if not most:
            named = [singles[name] for name in wanted if name in singles]
            return sorted(named, key=lambda one: -one.weight)
        return leading_sets(sets, singles.values(), deeper, most)

    def _with_process_noise(self, parent: WeighedSet) -> list[WeighedSet]:
        made = [
            self.fit((*parent.fitted.effects, effect), parent.fitted)
            for effect in self.candidates
            if isinstance(effect, NoiseEffect) and parent.names | {effect.name} not in self.visited
        ]
        return [self.store(fitted) for fitted in made if fitted is not None]

    def _with_events_moved(self, one: WeighedSet) -> WeighedSet:
        """Try the events of a set at earlier and later times, which have local optima."""
        for effect in [each for each in one.fitted.effects if each.traits.onset]:
            records = len(one.fitted.values.own) if belongs_to_record(effect) else 1
            for r in range(records):
                one = self._event_moved(one, effect, r)
        return one

    def _event_moved(self, one: WeighedSet, effect: Traceable, r: int) -> WeighedSet:
        """Return the best of the sets with an event of record ``r`` moved to other times."""
        name = full_name(effect, effect.traits.onset)
        best: FittedModel | None = None
        for shift in SHIFTS:
            moved = one.fitted.values.with_shifted(name, r, shift)
            self.fits += 1
            fitted = self.fit(one.fitted.effects, one.fitted, values=moved)
            if fitted is not None and (best is None or fitted.fit.cost < best.fit.cost):
                best = fitted
        return one if best is None or best.fit.cost >= one.fitted.fit.cost else self.store(best)
