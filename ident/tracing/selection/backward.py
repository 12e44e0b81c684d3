"""Backward elimination: each effect of a set has to show that it is still needed; and the freer forms of curves."""

from __future__ import annotations

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Step
from ident.tracing.selection.criterion import is_coloured_throughout, is_white
from ident.tracing.selection.expansion import expand
from ident.tracing.selection.search import Search
from sim.declaration.proposal import Refinable

GROSSLY = 1e-20  # p-value of whiteness that no fit to the end mends


def backward_elimination(search: Search, fitted: FittedModel) -> FittedModel:
    """Drop each effect whose removal costs less than an addition has to bring; try to extend once more after a drop."""
    best = fitted
    while len(best.effects) > 1:
        smaller = []
        for effect in best.effects:
            rest = tuple(other for other in best.effects if other.name != effect.name)
            key = frozenset(other.name for other in rest)
            # From the set's own values: the fitted model kept from the way up may stand in a worse optimum.
            again, kept = search.fit(rest, best), search.fitted_models.get(key)
            known = [fitted for fitted in (again, kept) if fitted is not None]
            if not known:
                continue
            without = min(known, key=lambda fitted: fitted.fit.cost)
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


def refined(search: Search, fitted: FittedModel) -> FittedModel:
    """The same set fitted to the end, in its freer form where that brings enough; as it is where no channel is anywhere near noise."""
    if is_coloured_throughout(fitted, GROSSLY):
        return fitted
    again = search.fit(fitted.effects, fitted)
    best = again if again is not None and again.fit.cost <= fitted.fit.cost + 1e-6 else fitted
    score = search.score(fitted) - 2.0 * (fitted.fit.cost - best.fit.cost)
    search.fitted_models[frozenset(best.names)], search.scores[frozenset(best.names)] = best, score
    return freer_form(search, best, least=0.0)


def freer_form(search: Search, fitted: FittedModel, least: float = 1e-3) -> FittedModel:
    """The set with an effect in its freer form, of the same name, where that brings as much as an addition has to.

    Tried before anything is added to a set whose residual is not white (whose whiteness has a p-value below ``least``,
    always where that is zero): what a plain form leaves would be taken for a further effect.
    """
    if search.exhausted or (least > 0.0 and is_white(fitted, least)):
        return fitted
    best, score = fitted, search.score(fitted)
    for position, effect in enumerate(fitted.effects):
        if not isinstance(effect, Refinable):
            continue
        finer = search.fit((*best.effects[:position], effect.finer(), *best.effects[position + 1 :]), best)
        if finer is not None and search.gain(best, finer) > search.settings.accept:
            gain = search.gain(best, finer)
            search.steps.append(Step(finer.names, score - gain, finer.fit.log_likelihood, f"a freer form of {effect.name} brings {gain:.1f}"))
            best, score = finer, score - gain
    search.fitted_models[frozenset(best.names)], search.scores[frozenset(best.names)] = best, score
    return best
