"""Rounds of the search: propose sets in the linear world, judge them at their posterior mode."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ident.evidence.histories import force_histories
from ident.evidence.linear_world import LinearWorld
from ident.evidence.noise_law import NoiseLaw
from ident.evidence.posterior_mode import Assessed, Key, assess, begun, first_laws
from ident.evidence.priors import log_odds
from ident.evidence.scan import Lead, prepared, scan
from ident.evidence.set_search import DEPTH, LinearSet, weighed
from ident.tracing.candidate_model.fitted_model import belongs_to_record, free_names, never_together
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.screening.context import search_context
from sim.declaration.effect import NoiseEffect, full_name
from sim.declaration.proposal import SearchContext

LEADERS = 5  # sets of a round that are fitted
ROUNDS = 4
QUIETER = 1.0 / 3.0  # share of the discrepancy under which candidates are scanned a second time
WORTH = -3.0  # log weight against the parent below which a set is not fitted
ALIKE = 0.95  # cosine above which two effects are not told apart


def _is_steady(effect) -> bool:
    """Whether an effect acts alike in all records, or may be in any record."""
    return effect.traits.background or not (belongs_to_record(effect) or effect.traits.onset)


def _silent(text: str) -> None:
    """A progress that nobody follows."""


@dataclass(eq=False)
class Search:
    """All sets that were assessed, by the names of their effects."""

    problem: TraceProblem
    tell: Callable[[str], None] = _silent
    steady: bool = False  # only effects that act alike in all records
    visited: dict[Key, Assessed] = field(default_factory=dict)
    scanned: set[Key] = field(default_factory=set)
    refined: set[Key] = field(default_factory=set)
    alike: dict[frozenset[str], float] = field(default_factory=dict)
    fits: int = 0

    def __post_init__(self) -> None:
        root = self.problem.fit((), None)
        assert root is not None
        self.context: SearchContext = search_context(root, self.problem.predicted)
        self.candidates = tuple(each for each in self.problem.candidates if not self.steady or _is_steady(each))
        self.root = self.kept(*self._with_histories(root), sweeps=1)

    def _with_histories(self, root):
        """The declared model in its linear world, with force histories and noise as the evidence has them."""
        plain = LinearWorld(root, self.context)
        histories = force_histories(root, self.problem.candidates, self.context)
        laws = tuple(law.smaller(QUIETER) for law in first_laws(root))
        if histories is None:
            return plain, first_laws(root)
        found = []
        # The sensors' discrepancy and the forces are rivals: begun from either side, the likelier is kept.
        for quiet, share in ((0.1, 0.3), (1.0, 0.03)):
            world = LinearWorld(root, self.context, histories.with_sigma([share * each for each in histories.sigma]))
            laws = tuple(NoiseLaw((0.3 if quiet < 1.0 else 1.0) * law.white, quiet * law.discrepancy, law.time) for law in first_laws(root))
            for _ in range(3):
                world = self._scaled(world, laws)
                laws = world.best_laws(laws, 1, 16)
            found.append((world.solution(laws).evidence + world.log_prior(laws), world, laws))
        _, world, laws = max(found, key=lambda each: each[0])
        self.tell(f"  evidence {[round(each[0], 1) for each in found]} histories {[float('%.2g' % s) for s in world.beside.sigma]} shares {[round(law.share, 2) for law in laws]}")
        return world, laws

    def _scaled(self, world, laws, factors=(0.1, 0.3, 3.0, 10.0)):
        """The standard deviations of the histories of largest evidence, one after the other."""
        best = world.solution(laws).evidence
        for k in range(len(world.beside.sigma)):
            for factor in factors:
                sigma = list(world.beside.sigma)
                sigma[k] *= factor
                trial = world.like(world.beside.with_sigma(sigma))
                value = trial.solution(laws).evidence
                if value > best + 0.1:
                    best, better = value, trial
                    found = True
                else:
                    found = False
                if found:
                    chosen = better
            try:
                world = chosen
            except UnboundLocalError:
                pass
        return world

    # ------------------------------------------------------------------ assessing
    def kept(self, world: LinearWorld, laws, extra=(), *, sweeps: int = 0, prior: float = 0.0) -> Assessed | None:
        """Assess a set and keep it, the better of two optima where it was met before."""
        try:
            found = assess(world, laws, self.candidates, extra, sweeps=sweeps, prior=prior)
        except np.linalg.LinAlgError:
            return None
        self.fits += 1
        old = self.visited.get(found.names)
        if old is None or found.weight > old.weight:
            self.visited[found.names] = found
        return self.visited[found.names]

    def child(self, parent: Assessed, proposed: LinearSet) -> Assessed | None:
        """The parent's set with the leads of a proposed one, at its posterior mode."""
        values = parent.fitted.values
        added: list[dict[str, float]] = [{} for _ in values.own]
        for lead, factors in zip(proposed.leads, proposed.factors, strict=True):
            for record, one in zip(added, _starts(lead, factors, len(added), self.context.interval), strict=True):
                record |= one
        effects = (*parent.fitted.effects, *(lead.effect for lead in proposed.leads))
        fitted = begun(self.problem, effects, values, added)
        if fitted is None:
            return None
        world = LinearWorld(fitted, self.context, parent.world.beside)
        return self.kept(world, parent.laws, parent.extra)

    def without(self, parent: Assessed, name: str) -> Assessed | None:
        """The set without one of its effects."""
        names = parent.names - {name}
        if names in self.visited:
            return self.visited[names]
        if False:
            pass
        effects = tuple(effect for effect in parent.fitted.effects if effect.name != name)
        fitted = begun(self.problem, effects, parent.fitted.values, [{} for _ in parent.fitted.values.own])
        if fitted is None:
            return None
        return self.kept(LinearWorld(fitted, self.context, parent.world.beside), parent.laws, parent.extra)

    # ------------------------------------------------------------------ rounds
    def run(self) -> Search:
        """Rounds until the leader has been scanned and nothing outdoes it; then its members are left out."""
        for number in range(ROUNDS):
            leader = self.best()
            if leader.names in self.scanned:
                break
            self.tell(f"round {number + 1}: {sorted(leader.names)} {leader.weight - self.root.weight:+.1f}")
            self.extend(leader)
        for _ in range(2):
            top = self.best()
            for name in sorted(top.names):
                less = self.without(top, name)
                less = less if less is None or less.names in self.refined else self.refine(less)
                if less is not None and len(top.names) > 1 and less.names not in self.scanned:
                    self.extend(less, most=3)
            if self.best() is top:
                break
            if self.best().names not in self.scanned:
                self.extend(self.best())
        return self

    def best(self) -> Assessed:
        """The set of largest weight, its noise estimated anew; again where another has become the best."""
        for _ in range(8):
            top = max(self.visited.values(), key=lambda one: one.weight)
            if top.names in self.refined:
                return top
            self.refine(top)
        return max(self.visited.values(), key=lambda one: one.weight)

    def refine(self, one: Assessed) -> Assessed:
        """The same set with its noise laws and the sizes of its histories estimated anew."""
        self.refined.add(one.names)
        world = self._scaled(one.world, one.laws, (0.3, 3.0)) if one.world.beside is not None else one.world
        return self.kept(world, one.laws, one.extra, sweeps=1)

    def extend(self, parent: Assessed, most: int = LEADERS) -> None:
        """Scan at a set under two noise laws, weigh sets of leads there, fit the leaders."""
        self.scanned.add(parent.names)
        if len([each for each in parent.effects if not each.traits.background]) >= DEPTH:
            return
        laws = [parent.laws, tuple(law.smaller(QUIETER) for law in parent.laws)]
        several = [prepared(parent.world, each) for each in laws]
        chosen: list[LinearSet] = []
        for ready, leads in zip(several, scan(parent.world.fitted, several, self.candidates, self.context), strict=True):
            possible = [lead for lead in leads if all(self._together(lead.effect, other) for other in parent.effects)]
            deeper = max(1, DEPTH - len([each for each in parent.effects if not each.traits.background]))
            sets, overlap = weighed(ready, possible, self._odds, lambda a, b: self._together(a.effect, b.effect), deeper)
            for i, a in enumerate(overlap.names):
                for j, b in enumerate(overlap.names[:i]):
                    if a != b:
                        key = frozenset((a, b))
                        self.alike[key] = max(self.alike.get(key, 0.0), float(overlap.cosines[i, j]))
            chosen += self._leaders(sets, chosen, most)
        for proposed in chosen:
            if parent.names | proposed.names in self.visited:
                continue
            made = self.child(parent, proposed)
            if made is not None:
                text = f"  {sorted(made.names)} linear {proposed.weight:.1f} weight {made.weight - self.root.weight:+.1f}"
                self.tell(text)

    def _leaders(self, sets: Sequence[LinearSet], before: Sequence[LinearSet], most: int) -> list[LinearSet]:
        """The weightiest sets, one of each choice of names, with each single effect of the best set among them."""
        chosen, seen = [], {each.names for each in before}
        top = max((each.weight for each in sets), default=0.0)
        for each in sets:
            if each.weight < WORTH or (chosen and each.weight < top - 0.5 * abs(top) - 20.0):
                break
            if each.names not in seen:
                seen.add(each.names)
                chosen.append(each)
            if len(chosen) == most:
                break
        singles = [each for each in sets if len(each.leads) == 1 and each.weight > WORTH and each.names not in seen]
        return chosen + singles[:2]

    def _odds(self, lead: Lead) -> float:
        return log_odds([lead.effect], self.candidates)

    def _together(self, one, other) -> bool:
        return one.name != other.name and not never_together(one, other) and not never_together(other, one)


def _starts(lead: Lead, factors: np.ndarray, records: int, interval: float) -> list[dict[str, float]]:
    """Values of a lead's parameters to begin a fit with, by full name, one mapping a record."""
    effect = lead.effect
    bounds = {item.name: item.bounds for item in effect.parameters}
    absent = {item.name: effect.absent.get(item.name, item.value) for item in effect.parameters}
    out = []
    for r in range(records):
        probe = lead.probes[r]
        values = dict(absent)
        if probe is not None:
            mine = factors if not belongs_to_record(effect) else factors[lead.own == r]
            values |= dict(probe.values)
            if probe.shifts:
                values[effect.traits.onset] = values[effect.traits.onset] + lead.shifts[r] * interval
            for local, change in zip(probe.slopes, mine.tolist(), strict=False):
                values[local] = values[local] + change
        out.append({full_name(effect, local): float(np.clip(value, *bounds[local])) for local, value in values.items()})
    return out
