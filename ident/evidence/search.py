"""Search of sets of effects: proposed in the linear world, fitted, weighed by their evidence."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.evidence.priors import half_normal_factor, log_mass, log_odds, set_prior
from ident.evidence.scan import Lead, prepared, scan
from ident.evidence.set_search import LinearSet, weighed
from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.candidate_model.fitted_model import FittedModel, Start, Values, fit_set, belongs_to_record, levels_of, never_together
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.screening.context import search_context
from ident.tracing.selection.criterion import is_white
from sim.declaration.effect import NoiseEffect, full_name
from sim.declaration.proposal import Edged, SearchContext, Traceable

Key = frozenset[str]
DEPTH = 3
EDGES = (16, 4, 1)  # times the width of an event's edges, while its time is looked for
LEADERS = 4  # sets of a round that are fitted
BUDGET = 40  # fits of a search
LEAST_NOISE = 0.3  # of the noise that high frequencies show: logged signals are filtered
PROCESS_NOISE_OFFERED = 1e-2
WORTH = 0.0  # log weight against the parent above which a set is fitted


@dataclass(frozen=True, eq=False)
class Weighed:
    """A fitted set: ``evidence`` ln p(data | set), ``weight`` with the prior odds; ``offset``, ``covariance`` of the posterior about the fit."""

    fitted: FittedModel
    evidence: float
    weight: float
    offset: np.ndarray
    covariance: np.ndarray

    @property
    def names(self) -> Key:
        return frozenset(self.fitted.names)


def evidence_of(fitted: FittedModel, context: SearchContext) -> tuple[float, np.ndarray, np.ndarray]:
    """Laplace's approximation about a fit: log evidence, offset of the posterior's mode from the fit, its covariance."""
    fit = fitted.fit
    prior = set_prior(fitted, context)
    normal, gradient = fit.normal_equations()
    normal, gradient = normal.copy(), gradient.copy()
    likelihood = fit.log_likelihood
    if fit.layout.prior is not None:  # what the fit itself knew is counted once, by the priors here
        known = fit.layout.prior
        away = fit.theta[known.positions] - known.mean
        likelihood += 0.5 * float(away @ known.information @ away)
        normal[np.ix_(known.positions, known.positions)] -= known.information
        gradient[known.positions] += known.information @ away
    precision = normal + np.diag(prior.precision)
    right = gradient + prior.precision * prior.mean
    scale = 1.0 / np.sqrt(np.maximum(np.diag(precision), 1e-300))
    inside = precision * np.outer(scale, scale)
    inside = 0.5 * (inside + inside.T)
    values, vectors = np.linalg.eigh(inside)
    values = np.maximum(values, 1e-10)
    inverse = (vectors / values) @ vectors.T
    offset = scale * (inverse @ (scale * right))
    covariance = inverse * np.outer(scale, scale)
    logdet = float(np.sum(np.log(values))) - 2.0 * float(np.sum(np.log(scale)))
    quadratic = float(gradient @ offset - 0.5 * offset @ normal @ offset)
    away = offset - prior.mean
    total = likelihood + quadratic - 0.5 * float(away @ (prior.precision * away)) + prior.constant - 0.5 * logdet
    flat = len(fit.theta) - int(np.count_nonzero(prior.precision))
    total += 0.5 * flat * math.log(2.0 * math.pi)
    if not has_process_noise(fitted.system):
        # The noise levels are unknowns too, concentrated out: curvature 2 N in ln(sigma).
        total += sum(0.5 * math.log(2.0 * math.pi / (2.0 * n)) for n in fit.counts.tolist() if n)
    else:
        levels = fit.theta[len(fit.layout.names) :]
        total -= float(np.sum(np.log(np.maximum(levels, 1e-300))))  # flat in ln(level)
    for place, low, high in prior.ranges:
        total += log_mass(float(offset[place]), math.sqrt(max(covariance[place, place], 1e-300)), low, high)
    for place, side, bound in prior.one_sided:
        total += half_normal_factor(side * (float(offset[place]) - bound), math.sqrt(max(covariance[place, place], 1e-300)))
    return float(total), offset, covariance


def measured_noise(fitted: FittedModel) -> dict[str, float]:
    """Standard deviation of each output's noise from third differences of its residual, which motion hardly reaches."""
    found: dict[str, float] = {}
    for i, name in enumerate(fitted.system.output_names):
        each = []
        for problem, residual in zip(fitted.fit.layout.problems, fitted.fit.residuals, strict=True):
            if np.count_nonzero(problem.valid[i]) > 4:
                each.append(np.median(np.abs(np.diff(residual[i][problem.valid[i]], 3))) / 0.6745 / math.sqrt(20.0))
        if each:
            found[name] = float(np.mean(each))
    return found


def _silent(text: str) -> None:
    """A progress that nobody follows."""


@dataclass(eq=False)
class Search:
    """All sets that were fitted, by the names of their effects.

    ``base`` : what stands in every set and is never claimed (the model discrepancy); none for a search under white noise.
    ``candidates`` : effects and guards that may be added.
    """

    problem: TraceProblem
    candidates: Sequence[Traceable]
    base: tuple[Traceable, ...] = ()
    tell: Callable[[str], None] = _silent
    visited: dict[Key, Weighed] = field(default_factory=dict)
    expanded: set[Key] = field(default_factory=set)
    alike: dict[Key, float] = field(default_factory=dict)
    fits: int = 0
    scans: int = 0

    def __post_init__(self) -> None:
        root = self.problem.fit((), None)
        assert root is not None
        self.context = search_context(root, self.problem.predicted)
        self.floor = {} if not self.base else {name: LEAST_NOISE * std for name, std in measured_noise(root).items()}
        if self.base:
            root = self.problem.fit(self.base, root, rough=True)
            assert root is not None
        self.root = self.kept(root)

    def kept(self, fitted: FittedModel) -> Weighed:
        """Weigh a fit and keep it, the better of two optima where the set was met before."""
        self.fits += 1
        evidence, offset, covariance = evidence_of(fitted, self.context)
        found = Weighed(fitted, evidence, evidence + log_odds([each for each in fitted.effects if each not in self.base], self.candidates), offset, covariance)
        old = self.visited.get(found.names)
        if old is None or found.weight > old.weight:
            self.visited[found.names] = found
        return self.visited[found.names]

    def fit(self, effects: Sequence[Traceable], values: Values, added: Sequence[Mapping[str, float]], parent: FittedModel) -> FittedModel | None:
        """A set fitted roughly from given values."""
        shared = {name: value for one in added for name, value in one.items()}
        own = tuple({**mine, **one} for mine, one in zip(values.own, added, strict=True))
        start = Start(Values({**shared, **values.shared}, own, values.states), {}, self._levels(parent))
        return fit_set(self.problem.data, tuple(effects), self.problem.roughly, start)

    def _levels(self, parent: FittedModel) -> Mapping[str, float] | None:
        """Noise levels to begin with: none below what the records' high frequencies show."""
        levels = levels_of(parent)
        return levels if levels is None else {name: max(std, self.floor.get(name, 0.0)) for name, std in levels.items()}

    def child(self, parent: Weighed, proposed: LinearSet) -> Weighed | None:
        """The parent's set with the leads of a proposed one, fitted; from nearer absence where the step leads astray."""
        values = parent.fitted.values
        effects = (*parent.fitted.effects, *(lead.effect for lead in proposed.leads))
        best = None
        for share in (1.0, 0.3, 0.1):
            added: list[dict[str, float]] = [{} for _ in values.own]
            for lead, factors in zip(proposed.leads, proposed.factors, strict=True):
                for record, one in zip(added, _starts(lead, share * factors, len(added), self.context.interval), strict=True):
                    record |= one
            fitted = self.fit(effects, values, added, parent.fitted)
            if fitted is not None and (best is None or fitted.fit.cost < best.fit.cost):
                best = fitted
            if best is not None and parent.fitted.fit.cost - best.fit.cost > 0.3 * proposed.gain:
                break
        return None if best is None else self.kept(best)

    def placed_better(self, one: Weighed) -> Weighed:
        """Events of a set looked for a little earlier and later, with wide edges first: their times have local optima."""
        for effect in [each for each in one.fitted.effects if each.traits.onset]:
            for r in range(len(one.fitted.values.own) if belongs_to_record(effect) else 1):
                one = self._event_moved(one, effect, r)
        return one

    def _event_moved(self, one: Weighed, effect: Traceable, r: int) -> Weighed:
        name = full_name(effect, effect.traits.onset)
        wide = effect.blunted(EDGES[0]) if isinstance(effect, Edged) else effect
        best: FittedModel | None = None
        for shift in (-0.6, -0.3, 0.0, 0.3, 0.6) if wide is not effect else (-0.6, -0.3, 0.3, 0.6):
            moved = self._again(one.fitted, wide, name, r, shift)
            if moved is not None and (best is None or moved.fit.cost < best.fit.cost):
                best = moved
        for width in EDGES[1:] if wide is not effect else ():
            form = effect.blunted(width) if width > 1 else effect
            best = self._again(best, form, name, r, 0.0) if best is not None else None
        return one if best is None or best.fit.cost >= one.fitted.fit.cost else self.kept(best)

    def _again(self, fitted: FittedModel, form: Traceable, name: str, r: int, shift: float) -> FittedModel | None:
        """A set with one effect in a form of it, its onset in record ``r`` moved, fitted again."""
        self.fits += 1
        effects = tuple(form if each.name == form.name else each for each in fitted.effects)
        values = fitted.values
        if name in values.shared:
            values = replace(values, shared={**values.shared, name: values.shared[name] + shift})
        else:
            own = tuple({**mine, name: mine[name] + shift} if i == r else mine for i, mine in enumerate(values.own))
            values = replace(values, own=own)
        return self.fit(effects, values, [{} for _ in values.own], fitted)

    def without(self, parent: Weighed, name: str) -> Weighed | None:
        """The set without one of its effects."""
        effects = tuple(effect for effect in parent.fitted.effects if effect.name != name)
        fitted = self.fit(effects, parent.fitted.values, [{} for _ in parent.fitted.values.own], parent.fitted)
        return None if fitted is None else self.kept(fitted)

    def run(self) -> Search:
        """Rounds until the best set has been scanned and nothing outdoes it; then its members are left out and replaced."""
        for _ in range(6):
            best = self.best()
            if best.names in self.expanded or self.fits > BUDGET:
                break
            self.tell(f"expand {sorted(best.names)} {best.weight - self.root.weight:+.1f}")
            self.expand(best)
        for _ in range(2 if self.fits < BUDGET else 0):
            top = self.best()
            for name in sorted(top.names - {each.name for each in self.base}) if len(top.names) > 1 + len(self.base) else ():
                less = self.without(top, name)
                if less is not None and less.names not in self.expanded and self.fits < BUDGET:
                    self.expand(less, most=2)
            if self.best() is top:
                break
            if self.best().names not in self.expanded:
                self.expand(self.best())
        return self

    def best(self) -> Weighed:
        return max(self.visited.values(), key=lambda one: one.weight)

    def expand(self, parent: Weighed, most: int = LEADERS) -> None:
        """Scan at a set, weigh sets of leads, fit the leaders."""
        self.expanded.add(parent.names)
        self.scans += 1
        present = [each for each in parent.fitted.effects if not each.traits.background and each not in self.base]
        deeper = DEPTH - len(present)
        if deeper > 0:
            ready = prepared(parent.fitted, set_prior(parent.fitted, self.context))
            (leads,) = scan(parent.fitted, [ready], self.candidates, self.context)
            possible = [lead for lead in leads if all(self._together(lead.effect, other) for other in parent.fitted.effects)]
            sets, overlap = weighed(ready, possible, self._odds, lambda a, b: self._together(a.effect, b.effect), deeper)
            for i, a in enumerate(overlap.names):
                for j, b in enumerate(overlap.names[:i]):
                    if a != b:
                        key = frozenset((a, b))
                        self.alike[key] = max(self.alike.get(key, 0.0), float(overlap.cosines[i, j]))
            made_here: list[Weighed] = []
            for proposed in self._leaders(sets, most):
                if parent.names | proposed.names in self.visited:
                    continue
                made = self.child(parent, proposed)
                if made is not None:
                    made_here.append(made)
                    self.tell(f"  {sorted(made.names)} linear {proposed.weight:.1f} weight {made.weight - self.root.weight:+.1f}")
            # Which of them leads hangs on where their events are.
            for made in sorted(made_here, key=lambda one: -one.weight)[:1]:
                better = self.placed_better(made)
                if better is not made:
                    self.tell(f"  {sorted(made.names)} placed better {better.weight - made.weight:+.1f}")
        if self.base or not (has_process_noise(parent.fitted.system) or is_white(parent.fitted, PROCESS_NOISE_OFFERED)):
            self.with_process_noise(parent)

    def with_process_noise(self, parent: Weighed) -> None:
        for effect in self.candidates:
            if isinstance(effect, NoiseEffect) and parent.names | {effect.name} not in self.visited:
                fitted = self.fit((*parent.fitted.effects, effect), parent.fitted.values, [{} for _ in parent.fitted.values.own], parent.fitted)
                if fitted is not None:
                    made = self.kept(fitted)
                    self.tell(f"  {sorted(made.names)} weight {made.weight - self.root.weight:+.1f}")

    def _leaders(self, sets: Sequence[LinearSet], most: int) -> list[LinearSet]:
        """The weightiest single effects, and larger sets where they promise more than any smaller one."""
        chosen: list[LinearSet] = []
        bar = WORTH
        for size in range(1, DEPTH + 1):
            seen: set[Key] = set()
            for each in sets:
                if len(each.leads) == size and each.weight > (WORTH if size == 1 else bar) and each.names not in seen:
                    seen.add(each.names)
                    chosen.append(each)
                    if len(seen) == (most if size == 1 else most // 2):
                        break
            bar = max([bar, *(each.weight for each in chosen)])
        return chosen

    def _odds(self, lead: Lead) -> float:
        return log_odds([lead.effect], self.candidates)

    def _together(self, one: Traceable, other: Traceable) -> bool:
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
