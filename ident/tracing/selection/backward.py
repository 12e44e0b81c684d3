"""Backward elimination: each effect of a set has to show that it is still needed; and the freer forms of curves."""

from __future__ import annotations

from ident.tracing.candidate_model.fitted_model import Node
from ident.tracing.diagnosis import Step
from ident.tracing.selection.criterion import is_coloured_throughout, is_white
from ident.tracing.selection.expansion import expand
from ident.tracing.selection.search import Search
from sim.declaration.proposal import Refinable

GROSSLY = 1e-20  # p-value of whiteness that no fit to the end mends


def look_back(search: Search, node: Node) -> Node:
    """Drop each effect whose removal costs less than an addition has to bring; try to extend once more after a drop."""
    best = node
    while len(best.effects) > 1:
        smaller = []
        for effect in best.effects:
            rest = tuple(other for other in best.effects if other.name != effect.name)
            key = frozenset(other.name for other in rest)
            # From the set's own values: the node kept from the way up may stand in a worse optimum.
            again, kept = search.fit(rest, best), search.nodes.get(key)
            known = [node for node in (again, kept) if node is not None]
            if not known:
                continue
            without = min(known, key=lambda node: node.fit.cost)
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
    """The same set fitted to the end, in its freer form where that brings enough; as it is where no channel is anywhere near noise."""
    if is_coloured_throughout(node, GROSSLY):
        return node
    again = search.fit(node.effects, node)
    best = again if again is not None and again.fit.cost <= node.fit.cost + 1e-6 else node
    score = search.score(node) - 2.0 * (node.fit.cost - best.fit.cost)
    search.nodes[frozenset(best.names)], search.scores[frozenset(best.names)] = best, score
    return freer_form(search, best, least=0.0)


def freer_form(search: Search, node: Node, least: float = 1e-3) -> Node:
    """The set with an effect in its freer form, of the same name, where that brings as much as an addition has to.

    Tried before anything is added to a set whose residual is not white (whose whiteness has a p-value below ``least``,
    always where that is zero): what a plain form leaves would be taken for a further effect.
    """
    if search.exhausted or (least > 0.0 and is_white(node, least)):
        return node
    best, score = node, search.score(node)
    for position, effect in enumerate(node.effects):
        if not isinstance(effect, Refinable):
            continue
        finer = search.fit((*best.effects[:position], effect.finer(), *best.effects[position + 1 :]), best)
        if finer is not None and search.gain(best, finer) > search.settings.accept:
            gain = search.gain(best, finer)
            search.steps.append(Step(finer.names, score - gain, finer.fit.log_likelihood, f"a freer form of {effect.name} brings {gain:.1f}"))
            best, score = finer, score - gain
    search.nodes[frozenset(best.names)], search.scores[frozenset(best.names)] = best, score
    return best
