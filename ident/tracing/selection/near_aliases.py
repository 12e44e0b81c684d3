"""What could stand in the place of each effect of a set: its near-aliases, fitted beside the rest.

The search keeps the cheapest of causes that look alike in the fitted record; another maneuver may tell them apart, so each of
them has to be put to the data that were not fitted.
"""

from __future__ import annotations

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Step
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import screen
from ident.tracing.selection.expansion import best_fit
from ident.tracing.selection.search import Search
from sim.declaration.effect import Effect, NoiseEffect
from sim.declaration.proposal import Refinable

LOOKS_ALIKE = 0.5  # projected gain over what the effect itself brought, below which nothing is worth a fit


def near_aliases(search: Search, best: FittedModel, within: float) -> list[FittedModel]:
    """Sets of equal size that differ from ``best`` in one effect, of nearly equal likelihood whatever their number of parameters.

    ``within`` in units of twice the log likelihood. Candidates are those that evidence or the effect itself calls alike.
    """
    found: list[FittedModel] = []
    for effect in best.effects:
        names = _alike(search, best, effect)
        base = _without(search, best, effect) if names else None
        if base is None:
            continue
        brought = base.fit.cost - best.fit.cost
        for finding in screen(base, [c for c in search.candidates if c.name in names], search_context(base, search.beside)):
            if finding.gain < LOOKS_ALIKE * brought or search.exhausted:
                continue
            child = best_fit(search, base, finding, 1)
            child = _freely(search, child, best, finding.effect)
            if child is None or 2.0 * (child.fit.cost - best.fit.cost) > within:
                continue
            search.keep(child, search.score(best) + child.criterion - best.criterion)
            search.steps.append(
                Step(
                    child.names,
                    search.score(child),
                    child.fit.log_likelihood,
                    f"{finding.effect.name} in the place of {effect.name} fits nearly as well",
                )
            )
            found.append(search.fitted_models[frozenset(child.names)])
    return found


def _alike(search: Search, best: FittedModel, effect: Effect) -> set[str]:
    """Names of candidates that look like one effect of a set, those that the search has fitted in its place already left out."""
    rest = {other.name for other in best.effects} - {effect.name}
    names = set(effect.aliases)
    for seen in search.evidence:
        if seen.name == effect.name and set(seen.within) <= rest:
            names |= set(seen.collinear_with)
        elif effect.name in seen.collinear_with and set(seen.within) <= rest:
            names.add(seen.name)
    known = {name for name in names if frozenset({*rest, name}) in search.fitted_models}
    candidates = {c.name for c in search.candidates if not (isinstance(c, NoiseEffect) or c.traits.guard)}
    twins = {name for other in best.effects if other.name in rest for name in other.traits.twins}
    return (names & candidates) - rest - known - twins - {effect.name}


def _without(search: Search, best: FittedModel, effect: Effect) -> FittedModel | None:
    rest = tuple(other for other in best.effects if other.name != effect.name)
    # From the set's own values: the fitted model kept from the way up may stand in a worse optimum.
    known = [
        search.fitted_models.get(frozenset(other.name for other in rest)),
        None if has_process_noise(best.system) else search.fit(rest, best, rough=True),
    ]
    return min((fitted for fitted in known if fitted is not None), key=lambda fitted: fitted.fit.cost, default=None)


def _freely(search: Search, child: FittedModel | None, best: FittedModel, effect: Effect) -> FittedModel | None:
    """The child, in its freer form where the plain one is not quite as good as the set it stands in for."""
    if child is None or not isinstance(effect, Refinable) or child.fit.cost <= best.fit.cost:
        return child
    finer = search.fit((*child.effects[:-1], effect.finer()), child)
    return finer if finer is not None and search.gain(child, finer) > search.settings.accept else child
