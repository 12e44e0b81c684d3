"""Forward search with a beam, then a look back: which set of effects explains the records best.

At each set the candidates are screened, the best few are fitted in full from several starts, and an addition counts
only if it lowers the score by more than the best of all candidates does on noise. At the end each effect has
to show that it is still needed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ident.filter_error import turbulence_worth_trying
from ident.fit_layout import FitSettings
from ident.information import inverse_information
from ident.process_noise import is_forced
from ident.residuals import ljung_box
from ident.tracing.diagnosis import Candidate, Quantity, Step
from ident.tracing.node import Node, fit_set, free_names, is_event, levels_of
from ident.tracing.occasion import occasion_at
from ident.tracing.screening import Finding, collinear, screen
from ident.tracing.settings import TraceSettings
from sim.effect import Effect, NoiseEffect, full_name
from sim.model import Model
from sim.record import Record
from sim.tracing import Refinable

COLLINEAR = 0.9
FEW = 3  # samples
WORTH = 1e-2  # p-value of the innovations being white below which random motion is offered
SHIFTS = (-0.6, -0.3, 0.3, 0.6)  # s
HOPELESS, RIVAL = 0.2, 0.5


@dataclass(eq=False)
class Search:
    """What one search knows and gathers on its way: fitted nodes, their scores, steps and evidence.

    A node's score is that of its parent less the gain, see ``gain``; the root's is its criterion. ``beside`` are records that will be
    predicted: only the ranges they fly through are used.
    """

    records: Sequence[Record]
    model: Model
    candidates: Sequence[Effect]
    outputs: Sequence[str]
    settings: TraceSettings
    masks: Sequence[np.ndarray]
    progress: Callable[[str, float], None]
    nodes: dict[frozenset[str], Node] = field(default_factory=dict)
    scores: dict[frozenset[str], float] = field(default_factory=dict)
    expanded: set[frozenset[str]] = field(default_factory=set)
    steps: list[Step] = field(default_factory=list)
    evidence: list[Candidate] = field(default_factory=list)
    totals: dict[frozenset[str], float] = field(default_factory=dict)
    beside: Sequence[Record] = ()

    def fit(self, effects: Sequence[Effect], start: Node | None, added: Mapping[str, float] | None = None, *, rough: bool = False) -> Node | None:
        """Fit a set from another node's values; roughly while searching, to the end for what is kept."""
        settings = FitSettings(
            max_step=self.settings.max_step, iterations=20 if rough else 60, tolerance=0.03 if rough else 1e-3, enough=0.2 if rough else 0.0
        )
        values, levels = (None, None) if start is None else (start.values, levels_of(start))
        return fit_set(self.records, self.model, effects, self.outputs, settings, self.masks, self.settings.event, values, added, levels)

    def gain(self, parent: Node, child: Node) -> float:
        """By how much an addition lowers the score: twice the log-likelihood gain over the unevenness, less its price."""
        price = (child.criterion - 2.0 * child.fit.cost) - (parent.criterion - 2.0 * parent.fit.cost)
        brought = 2.0 * (parent.fit.cost - child.fit.cost)
        if is_forced(child.system) and not is_forced(parent.system):
            return brought - price
        return min(brought / unevenness(parent, child), brought - few_samples(parent, child) + 0.5 * self.settings.accept) - price

    def keep(self, node: Node, score: float) -> None:
        """Remember a node, the better one where a set was fitted twice."""
        key = frozenset(node.names)
        if key not in self.nodes or score < self.scores[key]:
            self.nodes[key], self.scores[key] = node, score

    def score(self, node: Node) -> float:
        return self.scores[frozenset(node.names)]


def unevenness(parent: Node, child: Node) -> float:
    """sum(c^2 e^2)/sum(c^2), c the change of the fitted output and e the innovation, both in sigmas; at least 1.

    Noise that happens to be large just where an addition acts is no evidence for it.
    """
    top = bottom = 0.0
    for r in range(len(child.fit.layout.problems)):
        change = child.fit.lines[r].y - parent.fit.lines[r].y
        c = child.fit.whiten(r, change[:, :, None])[:, :, 0]
        e = _standard(child, r)
        top += float(np.sum(c**2 * e**2))
        bottom += float(np.sum(c**2))
    return max(1.0, top / bottom) if bottom > 0 else 1.0


def _standard(node: Node, r: int) -> np.ndarray:
    """Independent residuals of variance one, ``(m, N)``."""
    return node.fit.residuals[r] / np.sqrt(node.fit.variance)[:, None]


def few_samples(parent: Node, child: Node) -> float:
    """What the three most improved samples alone bring, in units of twice the log likelihood: evidence must not hang on so few."""
    best: list[float] = []
    for r in range(len(child.fit.layout.problems)):
        before = parent.fit.residuals[r] / np.sqrt(child.fit.variance)[:, None]
        gained = np.sum(before**2 - _standard(child, r) ** 2, axis=0)
        best += np.sort(gained)[-FEW:].tolist()
    return float(sum(value for value in sorted(best)[-FEW:] if value > 0))


def grow(search: Search, root: Node) -> Node:
    """Add effects round by round; returns the best node found.

    The best set is extended first. Where nothing can be added to it and its residual is white the search is over: a
    second-best set is looked at only as long as something is missing from the best.
    """
    search.keep(root, root.criterion)
    beam = [root]
    for number in range(1, search.settings.depth + 1):
        children: dict[frozenset[str], Node] = {}
        for place, node in enumerate(beam):
            found = expand(search, node, number)
            children |= {frozenset(child.names): child for child in found}
            if place == 0 and not found and is_white(node):
                break
        if not children:
            break
        beam = sorted(children.values(), key=search.score)[: search.settings.beam]
    return min(search.nodes.values(), key=search.score)


def is_white(node: Node) -> bool:
    """Whether no channel's residual shows correlation, at one in a thousand each."""
    names = node.system.output_names
    return all(
        ljung_box(residual[i], problem.valid[i], name).p_value > 1e-3
        for problem, residual in zip(node.fit.layout.problems, node.fit.residuals, strict=True)
        for i, name in enumerate(names)
    )


def expand(search: Search, node: Node, number: int) -> list[Node]:
    """Accepted children of a node; all that was looked at is kept as evidence."""
    key = frozenset(node.names)
    if key in search.expanded:
        return []
    search.expanded.add(key)
    findings = screen(node, search.candidates, occasion_at(node, search.beside))
    search.progress(f"round {number}: {' + '.join(node.names) or 'declared model'}", number / (search.settings.depth + 1))
    accepted: list[Node] = []
    tried, most, explained = 0, 0.0, None
    for finding in findings:
        if _excluded(node, finding.effect) or isinstance(finding.effect, NoiseEffect):
            continue
        # A projected gain errs where an effect is not linear; one that is far below what another really brought is hopeless.
        worth = 2.0 * finding.gain > 0.5 * _price(search, node, finding) and (tried < 2 or finding.gain > HOPELESS * most)
        if explained is not None:
            # Nothing is missing any more: only what might explain it as well is still of interest.
            worth = worth and (finding.gain > RIVAL * most or collinear(finding, explained) > COLLINEAR)
        child = _best_fit(search, node, finding) if tried < search.settings.tried and worth else None
        tried += child is not None
        gain = finding.gain if child is None else node.fit.cost - child.fit.cost
        most = most if child is None else max(most, gain)
        others = tuple(f.effect.name for f in findings if f is not finding and collinear(f, finding) > COLLINEAR)
        search.evidence.append(_candidate(number, node, finding, child, gain, others))
        if child is None:
            continue
        lowered = search.gain(node, child)
        if lowered > search.settings.accept:
            child = _placed_better(search, child, finding.effect)
            lowered = search.gain(node, child)
            search.keep(child, search.score(node) - lowered)
            search.steps.append(
                Step(child.names, search.score(child), child.fit.log_likelihood, f"{finding.effect.name} lowers the criterion by {lowered:.1f}")
            )
            accepted.append(search.nodes[frozenset(child.names)])
            if explained is None and is_white(child):
                explained = finding
    if not any(is_white(child) for child in accepted):
        accepted += _with_random_motion(search, node, number)
    return accepted


def _with_random_motion(search: Search, node: Node, number: int) -> list[Node]:
    """The node with turbulence, offered only where the innovations are not white and nothing else makes them so."""
    effects = [effect for effect in search.candidates if isinstance(effect, NoiseEffect)]
    if not effects or is_forced(node.system) or turbulence_worth_trying(node.fit) > WORTH:
        return []
    accepted = []
    for effect in effects:
        child = search.fit((*node.effects, effect), node, rough=True)
        if child is None:
            continue
        finding = Finding(effect, 0.0, len(free_names(effect)), ({},), (0.0,), np.zeros(1))
        search.evidence.append(_candidate(number, node, finding, child, node.fit.cost - child.fit.cost, ()))
        lowered = search.gain(node, child)
        if lowered > search.settings.accept:
            search.keep(child, search.score(node) - lowered)
            sentence = f"{effect.name} lowers the criterion by {lowered:.1f}"
            search.steps.append(Step(child.names, search.score(child), child.fit.log_likelihood, sentence))
            accepted.append(search.nodes[frozenset(child.names)])
    return accepted


def look_back(search: Search, node: Node) -> Node:
    """Drop each effect whose removal costs less than an addition has to bring; try to extend once more after a drop."""
    best = node
    while len(best.effects) > 1:
        smaller = []
        for effect in best.effects:
            rest = tuple(other for other in best.effects if other.name != effect.name)
            key = frozenset(other.name for other in rest)
            without = search.nodes.get(key) or search.fit(rest, best)
            if without is None:
                continue
            loss = search.gain(without, best)
            if loss < search.settings.accept:
                smaller.append((loss, without, effect.name))
        if not smaller:
            return best
        loss, without, name = min(smaller, key=lambda item: item[0])
        search.keep(without, search.score(best) + loss)
        search.steps.append(
            Step(without.names, search.score(without), without.fit.log_likelihood, f"{name} is no longer needed (it brings {loss:.1f})")
        )
        best = without
        for child in expand(search, best, len(best.effects) + 1):
            if search.score(child) < search.score(best):
                best = child
    return best


def refined(search: Search, node: Node) -> Node:
    """The same set fitted to the end, with the freer form of an effect where that brings as much as an addition has to."""
    again = search.fit(node.effects, node)
    best = again if again is not None and again.fit.cost <= node.fit.cost + 1e-6 else node
    score = search.score(node) - 2.0 * (node.fit.cost - best.fit.cost)
    for position, effect in enumerate(best.effects):
        if isinstance(effect, Refinable):
            finer = search.fit((*best.effects[:position], effect.finer(), *best.effects[position + 1 :]), best)
            if finer is not None and search.gain(best, finer) > search.settings.accept:
                gain = search.gain(best, finer)
                search.steps.append(Step(finer.names, score - gain, finer.fit.log_likelihood, f"a freer form of {effect.name} brings {gain:.1f}"))
                best, score = finer, score - gain
    search.nodes[frozenset(best.names)], search.scores[frozenset(best.names)] = best, score
    return best


def quantities(node: Node, effect: Effect) -> dict[str, Quantity]:
    """An effect's free parameters in a node, by local name; of the first record it acts on where each has its own."""
    normal, _ = node.fit.normal_equations()
    covariance, _ = inverse_information(normal, node.fit.theta)
    names = node.fit.layout.names
    out = {}
    for item in effect.parameters:
        full = full_name(effect, item.name)
        at = next((i for i, name in enumerate(names) if name == full or name.startswith(f"{full}, record")), None)
        if at is not None:
            out[item.name] = Quantity(float(node.fit.theta[at]), float(np.sqrt(max(covariance[at, at], 1e-300))), item.unit)
    return out


def _best_fit(search: Search, node: Node, finding: Finding) -> Node | None:
    best: Node | None = None
    for start in finding.starts[: search.settings.starts]:
        child = search.fit((*node.effects, finding.effect), node, start, rough=True)
        if child is not None and (best is None or child.fit.cost < best.fit.cost):
            best = child
    return best


def _placed_better(search: Search, child: Node, effect: Effect) -> Node:
    """An event moved a little to both sides: its time has local optima where the motion has died out."""
    if not is_event(effect):
        return child
    name = full_name(effect, effect.onset)  # type: ignore[attr-defined]
    values = child.values
    at = values.own[0].get(name, values.shared.get(name))
    if at is None:
        return child
    for shift in SHIFTS:
        moved = search.fit(child.effects, child, {name: at + shift}, rough=True)
        if moved is not None and moved.fit.cost < child.fit.cost - 0.5:
            child = moved
    return child


def _price(search: Search, node: Node, finding: Finding) -> float:
    return search.settings.accept + finding.parameters * float(np.log(node.fit.counts.sum()))


def _excluded(node: Node, effect: Effect) -> bool:
    """One late effect per sensor: a lag and a delay of the same channel are one thing described twice."""
    kind, _, channel = effect.name.partition(":")
    twin = {"sensor-lag": "sensor-delay", "sensor-delay": "sensor-lag"}.get(kind)
    return twin is not None and f"{twin}:{channel}" in node.names


def _candidate(number: int, node: Node, finding: Finding, child: Node | None, gain: float, others: tuple[str, ...]) -> Candidate:
    from scipy.special import chdtrc

    effect = finding.effect
    if child is None:
        local = {full_name(effect, item.name): item for item in effect.parameters}
        found = {
            local[name].name: Quantity(value, abs(value) or 1.0, local[name].unit) for name, value in finding.starts[0].items() if local[name].free
        }
    else:
        found = quantities(child, effect)
    plausible = getattr(effect, "plausible", {})
    believed = all(plausible[name][0] <= quantity.value <= plausible[name][1] for name, quantity in found.items() if name in plausible)
    p_value = float(chdtrc(finding.parameters, max(2.0 * gain, 0.0)))
    return Candidate(number, node.names, effect.name, float(gain), p_value, child is not None, believed, found, None, others)
