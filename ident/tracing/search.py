"""Search over sets of effects: linearised signatures propose sets, which are fitted and compared by
their evidence.

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
    compatible,
    fit_set,
    levels_of,
)
from ident.tracing.linear_sets import LinearSet, leading_sets, most_probable_sets
from ident.tracing.problem import TraceProblem, search_context
from ident.tracing.scan import leads_of, start_values, whitened_fit
from ident.tracing.search_log import fitted_candidates, logged_step, scanned_candidates
from ident.tracing.signatures import CandidateSignatures, candidate_signatures
from ident.tracing.whiteness import is_noise
from sim.declaration.effect import NoiseEffect, full_name
from sim.declaration.proposal import Refinable, SearchContext, Traceable
from sim.errors import ModelError

MOST_ROUNDS = 6
FITTED_SINGLES = 4  # single effects fitted in a round; half as many sets of each larger size
# alternatives fitted for a member; also single effects at which further candidates are scanned
FITTED_ALTERNATIVES = 3
# A fit starts at these shares of the linearised step, tried in turn until one improves.
STEP_SHARES = (1.0, 0.3, 0.1)
LEAST_REALISED_GAIN_SHARE = 0.3  # smallest gain of a fit, relative to the predicted gain
EVENT_SHIFTS = (-0.6, -0.3, 0.3, 0.6)  # s, changes of an event's time that are tried
CONFUSABLE_COSINE = 0.95  # smallest cosine of two confusable signatures
CLEAR_GAIN = 30.0  # gain of log likelihood that exceeds the effect of any prior
LEAST_FURTHER_GAIN = 1.0  # smallest gain of log likelihood worth further iterations of a fit
PROCESS_NOISE_P_VALUE = 1e-2  # largest p-value of the residual tests at which rough air is tried


@dataclass(eq=False)
class Search:
    """A search over sets of effects.

    Attributes
    ----------
    problem : records and declared model.
    candidates : effects and catch-all terms to add.
    base : effects of every set that are never claimed, such as a model discrepancy.
    title : the noise of the search in words, for the log.
    discrepancy : random loads that stand for model errors; the search ends if a set of this term
        alone is by far likelier than the best set.
    visited : the fitted sets by the names of their effects, ``base`` included.
    expanded : sets at which all candidates were scanned.
    refined : sets tried in refined forms, by their parameters.
    repeated : sets that fitted worse than a subset and were fitted again.
    fitted_without : pairs of a fit and a member that was left out: the set without this member was
        fitted from this fit.
    steps, tried : log: what was done, and the candidates that were tried.
    cosines : largest cosine between the signatures of two effects, by the pair of their names.
    fits : number of fits.
    signatures : last simulated signatures of each candidate, by its position.
    discrepancy_weights : weights of sets of the discrepancy and nuisance dynamics alone.
    last_gain : increase of the largest weight in the last round; a continued search starts with
        the value of the previous one.

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
    fitted_without: set[tuple[FittedModel, str]] = field(default_factory=set)
    cosines: dict[Key, float] = field(default_factory=dict)
    signatures: dict[int, CandidateSignatures] = field(default_factory=dict)
    steps: list[Step] = field(default_factory=list)
    tried: list[Candidate] = field(default_factory=list)
    fits: int = 0
    discrepancy_weights: dict[Key, float] = field(default_factory=dict)
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
    def base_set(self) -> WeighedSet:
        """Set of the base alone; the declared model if the base is empty or cannot be fitted."""
        if not self.base:
            return self.store(self.declared)
        fitted = self.problem.fit(self.base, self.declared, rough=True)
        return self.store(fitted if fitted is not None else self.declared)

    @property
    def base_names(self) -> Key:
        """Names of the effects in every set."""
        return frozenset(effect.name for effect in self.base)

    def added(self, one: WeighedSet) -> Key:
        """Return the names of the effects that a set has in addition to the base."""
        return one.names - self.base_names

    @property
    def budget_spent(self) -> bool:
        """Whether the budget of fits is used up."""
        return self.fits > self.problem.settings.budget

    def store(self, fitted: FittedModel) -> WeighedSet:
        """Store a fit with its evidence and return the stored set; of two optima the better one is
        kept.

        The fit of a likely set that ended early is continued, so that speed of convergence does not
        decide between alternatives.
        """
        self.fits += 1
        new = self._evaluated(fitted)
        best = max((one.weight for one in self.visited.values()), default=-math.inf)
        while new.fitted.fit.outcome is Outcome.MAX_ITERATIONS and new.weight > best - CLEAR_GAIN:
            further = self.fit(new.fitted.effects, new.fitted)
            if further is None or further.fit.cost > new.fitted.fit.cost - LEAST_FURTHER_GAIN:
                break
            new = self._evaluated(further)
        old = self.visited.get(new.names)
        if old is None or new.weight > old.weight:
            self.visited[new.names] = new
            self._exclude_failed(new)
        return self._refitted_from_subset(self.visited[new.names])

    def _exclude_failed(self, new: WeighedSet) -> None:
        """Exclude ``new`` if it fits worse than one of its subsets, and sets that fit worse than
        their subset ``new``: these fits missed the optimum.
        """
        for one in [*self.visited.values()]:
            for part, whole in ((one, new), (new, one)):
                lost = part.fitted.fit.log_likelihood - whole.fitted.fit.log_likelihood
                if part.names < whole.names and lost > CLEAR_GAIN:
                    self.visited[whole.names] = replace(whole, weight=-math.inf)

    def _evaluated(self, fitted: FittedModel) -> WeighedSet:
        """Return a fit with its evidence and its prior odds in this search."""
        evidence, offset, covariance = evidence_of(fitted, self.context)
        return self.with_prior_odds(WeighedSet(fitted, evidence, 0.0, offset, covariance))

    def fit(
        self,
        effects: Sequence[Traceable],
        parent: FittedModel,
        added: Sequence[Mapping[str, float]] = (),
        values: Values | None = None,
    ) -> FittedModel | None:
        """Return a coarse fit of a set from the values of ``parent``, or from ``values``; ``added``
        has the values of further parameters, one mapping a record.
        """
        values = values or parent.values
        start = Start(values.with_added(added) if added else values, {}, levels_of(parent))
        return fit_set(self.problem.data, tuple(effects), self.problem.roughly, start)

    def fit_proposed(self, parent: WeighedSet, proposed: LinearSet) -> WeighedSet | None:
        """Return the set of the parent with the effects of the proposed leads, fitted.

        If the linearised step does not improve the fit, a shorter one is tried.
        """
        effects = (*parent.fitted.effects, *(lead.effect for lead in proposed.leads))
        best: FittedModel | None = None
        previous: list[dict[str, float]] = []
        for share in STEP_SHARES:
            added: list[dict[str, float]] = [{} for _ in parent.fitted.values.own]
            for lead, coefficients in zip(proposed.leads, proposed.coefficients, strict=True):
                starts = start_values(lead, share * coefficients, len(added), self.context.interval)
                for record, one in zip(added, starts, strict=True):
                    record |= one
            if added == previous:  # no lead has an amplitude
                break
            previous = added
            fitted = self.fit(effects, parent.fitted, added)
            if fitted is not None and (best is None or fitted.fit.cost < best.fit.cost):
                best = fitted
            gain = parent.fitted.fit.cost - best.fit.cost if best is not None else -math.inf
            if gain > LEAST_REALISED_GAIN_SHARE * proposed.gain:
                break
        return None if best is None else self.store(best)

    def fit_without(self, parent: WeighedSet, name: str) -> WeighedSet | None:
        """Return the set without one of its effects, fitted from the values of the others.

        If the fit is much worse, it is repeated from the derivatives of the base set, since the
        effect may have shifted them.
        """
        if (parent.fitted, name) in self.fitted_without:
            return self.set_without(parent, name)
        effects = tuple(effect for effect in parent.fitted.effects if effect.name != name)
        fits = [self.fit(effects, parent.fitted)]
        if fits[0] is None or fits[0].fit.cost > parent.fitted.fit.cost + CLEAR_GAIN:
            values = parent.fitted.values.with_shared(self.base_set.fitted.values.shared)
            fits.append(self.fit(effects, parent.fitted, values=values))
        best = min((each for each in fits if each), key=lambda each: each.fit.cost, default=None)
        if best is None:
            return None
        self.fitted_without.add((parent.fitted, name))
        return self.store(best)

    def _refitted_from_subset(self, one: WeighedSet) -> WeighedSet:
        """Return the set; if it was excluded, fitted again from its best subset, with the other
        effects at their absent values.
        """
        if one.weight > -math.inf or one.names in self.repeated:
            return one
        self.repeated.add(one.names)
        subsets = [each for key, each in self.visited.items() if key < one.names]
        part = max(subsets, key=lambda each: each.fitted.fit.log_likelihood)
        absent = absent_values(each for each in one.fitted.effects if each.name not in part.names)
        own = part.fitted.values.own
        refitted = self.fit(one.fitted.effects, part.fitted, [absent] * len(own))
        return one if refitted is None else self.store(refitted)

    def set_without(self, parent: WeighedSet, name: str) -> WeighedSet | None:
        """Return the set without one of its effects, as stored, or fitted if it is not stored."""
        old = self.visited.get(parent.names - {name})
        return self.fit_without(parent, name) if old is None else self._refitted_from_subset(old)

    def run(self) -> Search:
        """Run rounds until the best set has been scanned and no set is better; return the search.

        Then each member of the best set is left out, and alternatives to it are tried. The search
        ends at once if a discrepancy is by far likelier.
        """
        _ = self.base_set
        if self._discrepancy_is_likelier():
            return self
        for _ in range(MOST_ROUNDS):
            best = self.best()
            if best.names in self.expanded or self.budget_spent:
                break
            self.expand(best)
            self.last_gain = self.best().weight - best.weight
            if not self._discrepancy_is_likelier():
                self._try_refined_forms()
                self._try_confusable_effects()
                self.last_gain = self.best().weight - best.weight
            if self._discrepancy_is_likelier():
                return self
        for _ in range(2):
            top = self.best()
            members = sorted(self.added(top))
            # Pairs are found by scans of single effects; larger sets may have replaced another
            # pair, and an event has another place in the presence of another effect.
            if len(members) > 2 or not is_noise(top.fitted.fit):
                self._scan_at_single_effects()
            for name in members if len(members) > 1 else ():
                smaller = self.fit_without(top, name)
                if smaller is None or smaller.names in self.expanded or self.budget_spent:
                    continue
                self.expand(smaller, fitted_singles=2)
            if self.best() is top or self.budget_spent:
                break
            if self.best().names not in self.expanded:
                self.expand(self.best())
            self._try_refined_forms()
        self._try_confusable_effects()
        self._try_equivalent_effects()
        return self

    def _discrepancy_is_likelier(self) -> bool:
        """Return whether a discrepancy alone outweighs the best set by more than the last gain."""
        best = self.best()
        if self.discrepancy is None or self.last_gain == math.inf or is_noise(best.fitted.fit):
            return False
        base = (self.discrepancy, *best.fitted.background)
        key = frozenset(each.name for each in base)
        if key not in self.discrepancy_weights:
            self.discrepancy_weights[key] = Search(self.problem, (), base).base_set.weight
        return self.discrepancy_weights[key] - best.weight > self.last_gain

    def rerun_in(self, problem: TraceProblem, data: str) -> Search:
        """Return the search on other masks or records; it continues if another of the sets fitted
        again is the most probable there. ``data`` names the data for the log.
        """
        other = self.refitted(problem, data)
        return other if other.best().names == self.best().names else other.run()

    def refitted(self, problem: TraceProblem, data: str) -> Search:
        """Return a search on other masks, records or hold of inputs, with the leading sets fitted
        again. ``data`` names the data for the log.
        """
        other = Search(problem, self.candidates, self.base, self.title, self.discrepancy)
        other.cosines, other.steps, other.tried = dict(self.cosines), [*self.steps], [*self.tried]
        other.last_gain = self.last_gain
        found = [other.base_set]
        leading = sorted(self.visited.values(), key=lambda one: -one.weight)[: 2 * FITTED_SINGLES]
        for one in leading:
            fitted = other.fit(one.fitted.effects, one.fitted) if self.added(one) else None
            if fitted is not None:
                found.append(other.store(fitted))
        other.expanded = self.expanded & {one.names for one in found} - {other.best().names}
        other._log_best(f"{self.title}, {data}: the leading sets fitted again")
        return other

    def with_candidates(self, candidates: Sequence[Traceable], title: str) -> Search:
        """Return a search among other candidates, with the fitted sets that contain only these."""
        other = Search(self.problem, candidates, self.base, title, self.discrepancy)
        other.cosines = dict(self.cosines)
        offered = {each.name for each in candidates} | self.base_names
        for key, one in self.visited.items():
            if key <= offered:
                other.visited[key] = other.with_prior_odds(one)
        if other.base_set.names in self.expanded:
            other.expand(other.base_set)
        return other

    def with_prior_odds(self, one: WeighedSet) -> WeighedSet:
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
            self.visited[key] = self.with_prior_odds(one)
        named = self.set_named_by_kinematics()
        if self._discrepancy_is_likelier():
            return self
        if named is not None and named.names not in self.expanded and not self.budget_spent:
            self.expand(named)  # so far, further effects were searched for at other sets only
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
            members = [offered[name] for name in group if name in offered]
            if members and all(compatible(members[0], each) for each in chosen):
                chosen.append(members[0])
                others[members[0].name] = members[1:]
        fitted = self.fit((*self.base, *chosen), self.base_set.fitted) if chosen else None
        if fitted is None:
            return None
        best = self.store(fitted)
        for one in chosen:
            rest = [each for each in chosen if each is not one]
            for other in others[one.name]:
                if all(compatible(other, each) for each in rest):
                    swapped = self.fit((*self.base, *rest, other), fitted)
                    if swapped is not None:
                        best = max(best, self.store(swapped), key=lambda one: one.weight)
        return best

    def _try_refined_forms(self) -> None:
        """Try the leading set of each size in refined forms of its effects."""
        leading: dict[int, tuple[Key, WeighedSet]] = {}
        for key, one in self.visited.items():
            best = leading.get(len(key))
            if not key & self.problem.guards and (best is None or one.weight > best[1].weight):
                leading[len(key)] = (key, one)
        for _, one in [*leading.values()]:
            while (
                refined_set := self._refined_set(one)
            ) is not None and refined_set.weight > one.weight:
                one = refined_set

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

    def _try_confusable_effects(self) -> None:
        """Try the best set with each member replaced by each confusable effect."""
        best = self.best()
        for effect in [each for each in best.fitted.effects if each.name in self.added(best)]:
            names = {
                name
                for name in (*self._confusable_names(effect.name), *effect.traits.twins)
                if best.names - {effect.name} | {name} not in self.visited
            }
            if not names:
                continue
            smaller = self.visited.get(best.names - {effect.name})
            smaller = smaller or self.fit_without(best, effect.name)
            if smaller is not None:
                self.sets_with_replacement(smaller, names)

    def sets_with_replacement(
        self, smaller: WeighedSet, names: Collection[str]
    ) -> list[WeighedSet]:
        """Return the fitted sets of ``smaller`` with one more effect of these ``names``, for those
        with the largest predicted gain.
        """
        proposed = self._proposed_sets(smaller, 1, 0, names)[:FITTED_ALTERNATIVES]
        children = (self.fit_proposed(smaller, each) for each in proposed)
        return [each for each in children if each is not None]

    def _try_equivalent_effects(self) -> None:
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

    def _scan_at_single_effects(self) -> None:
        """Scan at the best single effects: an effect of the best set may stand for two others."""
        singles = [one for one in self.visited.values() if len(self.added(one)) == 1]
        for one in sorted(singles, key=lambda each: -each.weight)[:FITTED_ALTERNATIVES]:
            if one.names not in self.expanded and not self.budget_spent:
                self.expand(one, fitted_singles=2)

    def best(self, without: Collection[str] = ()) -> WeighedSet:
        """Return the set of largest posterior probability without the excluded effects."""
        found = [one for key, one in self.visited.items() if key.isdisjoint(without)]
        return max(found, key=lambda one: one.weight)

    def expand(
        self,
        parent: WeighedSet,
        fitted_singles: int = FITTED_SINGLES,
        largest_addition: int | None = None,
    ) -> None:
        """Scan at a set and fit the best sets of leads.

        Parameters
        ----------
        fitted_singles : number of single effects to fit; half as many sets of each larger size.
        largest_addition : most effects that are added at once; default by the depth of the search.
        """
        self.expanded.add(parent.names)
        parent_name = " + ".join(sorted(self.added(parent))) or "the declared model"
        doing, share = f"{self.title}: what is missing beside {parent_name}", self.fits / 100.0
        self.problem.progress(doing, min(0.1 + 0.7 * share, 0.85))
        children: list[WeighedSet] = []
        causes = [
            each
            for each in parent.fitted.effects
            if not (each.traits.background or each in self.base)
        ]
        most_effects = (
            self.problem.settings.depth - len(causes)
            if largest_addition is None
            else largest_addition
        )
        if most_effects > 0:
            children = [
                child
                for proposed in self._proposed_sets(parent, most_effects, fitted_singles)
                if parent.names | proposed.names not in self.visited
                and (child := self.fit_proposed(parent, proposed)) is not None
            ]
            leading = max(children, key=lambda one: one.weight, default=None)
            if leading is not None and leading.weight >= self.best().weight:
                # The order of sets depends on the times of their events.
                children.append(self._with_moved_events(leading))
        rough = has_process_noise(parent.fitted.system)
        offered = self.base or not (rough or is_noise(parent.fitted.fit, PROCESS_NOISE_P_VALUE))
        if offered and fitted_singles == FITTED_SINGLES:
            children += self._try_process_noise(parent)
        number = len(self.steps) + 1
        self.tried += fitted_candidates(number, parent, children, self._confusable_names)
        self._log_best(
            f"{self.title}, effects added to {parent_name}: {len(self.candidates)} candidates "
            f"scanned, {len(children)} set{'s' * (len(children) != 1)} fitted"
        )

    def _log_best(self, what: str) -> None:
        """Log what was done, with the most probable set after it."""
        best = self.best()
        odds = best.weight - self.base_set.weight
        self.steps.append(logged_step(what, best, self.added(best), odds))

    def _confusable_names(self, name: str) -> tuple[str, ...]:
        """Return the names of the effects whose signature is nearly that of the named effect."""
        pairs = [
            key
            for key, cosine in self.cosines.items()
            if name in key and cosine > CONFUSABLE_COSINE
        ]
        return tuple(sorted(other for key in pairs for other in key - {name}))

    def _proposed_sets(
        self,
        parent: WeighedSet,
        most_effects: int,
        fitted_singles: int,
        names: Collection[str] = (),
    ) -> list[LinearSet]:
        """Return the sets of leads to fit at a set (``leading_sets``).

        With ``fitted_singles`` zero, single leads of these ``names`` alone. Signatures come from
        the last scan at a leading set: at other sets they are nearly equal.
        """
        whitened = whitened_fit(parent.fitted, set_prior(parent.fitted, self.context))
        if fitted_singles == FITTED_SINGLES or not self.signatures:
            self.signatures |= candidate_signatures(parent.fitted, self.candidates, self.context)
        signatures = [
            one for one in self.signatures.values() if fitted_singles or one[0].name in names
        ]
        leads = [
            lead
            for lead in leads_of(parent.fitted, whitened, signatures, self.context)
            if all(compatible(lead.effect, other) for other in parent.fitted.effects)
        ]
        sets, new_cosines = most_probable_sets(
            whitened,
            leads,
            lambda lead: log_odds([lead.effect], self.families, self.problem.named_by_kinematics),
            lambda a, b: compatible(a.effect, b.effect),
            most_effects,
        )
        for key, cosine in new_cosines.items():
            self.cosines[key] = max(self.cosines.get(key, 0.0), cosine)
        singles = {one.leads[0].effect.name: one for one in reversed(sets) if len(one.leads) == 1}
        number = len(self.steps) + 1
        self.tried += scanned_candidates(number, parent, singles, self._confusable_names)
        if not fitted_singles:
            named = [singles[name] for name in names if name in singles]
            return sorted(named, key=lambda one: -one.weight)
        return leading_sets(sets, singles.values(), most_effects, fitted_singles)

    def _try_process_noise(self, parent: WeighedSet) -> list[WeighedSet]:
        """Return the fitted sets of the parent with each noise effect among the candidates."""
        children = [
            self.fit((*parent.fitted.effects, effect), parent.fitted)
            for effect in self.candidates
            if isinstance(effect, NoiseEffect) and parent.names | {effect.name} not in self.visited
        ]
        return [self.store(fitted) for fitted in children if fitted is not None]

    def _with_moved_events(self, one: WeighedSet) -> WeighedSet:
        """Return the best set with its events at earlier or later times, where local optima are."""
        for effect in [each for each in one.fitted.effects if each.traits.onset]:
            records = len(one.fitted.values.own) if belongs_to_record(effect) else 1
            for r in range(records):
                one = self._with_moved_event(one, effect, r)
        return one

    def _with_moved_event(self, one: WeighedSet, effect: Traceable, r: int) -> WeighedSet:
        """Return the best set with an event of record ``r`` moved to other times."""
        name = full_name(effect, effect.traits.onset)
        best: FittedModel | None = None
        for shift in EVENT_SHIFTS:
            moved = one.fitted.values.with_shifted(name, r, shift)
            self.fits += 1
            fitted = self.fit(one.fitted.effects, one.fitted, values=moved)
            if fitted is not None and (best is None or fitted.fit.cost < best.fit.cost):
                best = fitted
        return one if best is None or best.fit.cost >= one.fitted.fit.cost else self.store(best)
