"""Forward search with a beam, then a look back: which set of effects explains the records best.

An addition counts only if it lowers the score by more than the best of all candidates does on noise. At the end each
effect has to show that it is still needed.
"""

from __future__ import annotations

from collections.abc import Sequence

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.candidate_model.fitted_model import FittedModel, Values, fit_set
from ident.tracing.selection.backward import GROSSLY, freer_form
from ident.tracing.selection.criterion import is_coloured_throughout, is_white
from ident.tracing.selection.expansion import expand, with_process_noise
from ident.tracing.selection.search import Search
from sim.declaration.effect import NoiseEffect

DOMINANT = 3.0  # times what the best single cause brings: process noise that brings so much is no stand-in for a cause


def first_round(search: Search, root: FittedModel) -> list[FittedModel]:
    """The best sets of one effect, a beam of them."""
    search.keep(root, root.criterion)
    return [freer_form(search, fitted) for fitted in _best(search, expand(search, root, 1))]


def defies(root: FittedModel, first: Sequence[FittedModel]) -> bool:
    """Whether neither the declared model nor any single effect comes anywhere near noise in any channel of any record."""
    return all(is_coloured_throughout(fitted, GROSSLY) for fitted in (root, *first))


def forward_selection(search: Search, root: FittedModel, first: Sequence[FittedModel]) -> FittedModel:
    """Add effects round by round to the sets of the first one; returns the best node found.

    The best set is extended first. Where nothing can be added to it and its residual is white the search is over: a
    second-best set is looked at only as long as something is missing from the best. Process noise takes in whatever has
    a cause, so it is offered only where no single cause leaves noise.
    """
    beam = list(first)
    moving: list[FittedModel] = []
    if not any(is_white(fitted) for fitted in beam):
        moving = with_process_noise(search, root, 1)
        most = max((search.score(root) - search.score(fitted) for fitted in beam), default=0.0)
        plain = [fitted for fitted in moving if is_white(fitted) or search.score(root) - search.score(fitted) > DOMINANT * most]
        beam = _best(search, [*beam, *plain])
    for number in range(2, search.settings.depth + 1):
        children: list[FittedModel] = []
        for place, fitted in enumerate(beam):
            found = expand(search, fitted, number)
            children += found
            if place == 0 and (is_white(fitted) if not found else has_process_noise(fitted.system) and any(is_white(child) for child in found)):
                break
        beam = [freer_form(search, fitted) for fitted in _best(search, children)]
        if number == 2 and not any(is_white(fitted) for fitted in (*first, *beam)):
            # Process noise with one cause: only where no pair of causes does better. A cause that it hides shows once it is there.
            together = _moving(search, first, 2) or [child for fitted in moving for child in expand(search, fitted, 2)]
            beam = _best(search, [*beam, *together])
        if not beam:
            break
    return _best_found(search)


def _best_found(search: Search) -> FittedModel:
    """The set of lowest score; where that leaves no noise, the best of those that do.

    Scores of events and of process noise do not compare: unevenness is charged to the one only.
    """
    best = min(search.fitted_models.values(), key=search.score)
    if is_white(best, search.settings.white):
        return best
    white = [fitted for fitted in search.fitted_models.values() if is_white(fitted, search.settings.white) and not fitted.guards]
    return min(white, key=search.score, default=best)


def hopeless(search: Search, fitted: FittedModel) -> bool:
    """Whether a set leaves colour throughout several records, which process noise does not take in either.

    That is asked of the shortest record alone: what it does not explain there it does not explain anywhere.
    """
    if len(search.records) < 2 or has_process_noise(fitted.system) or not is_coloured_throughout(fitted, GROSSLY):
        return False
    values = fitted.values
    shortest = min(range(len(search.records)), key=lambda r: len(search.records[r]))
    records, masks = [search.records[shortest]], [search.masks[shortest]]
    start = Values(values.shared, (values.own[shortest],), (values.states[shortest],))
    for effect in search.candidates:
        if isinstance(effect, NoiseEffect):
            moved = fit_set(records, search.model, (*fitted.effects, effect), search.outputs, search.roughly, masks, 0.0, start)
            if moved is not None and is_white(moved, GROSSLY):
                return False
    return True


def extended(search: Search, root: FittedModel, fitted: FittedModel) -> FittedModel:
    """A set that was found by other means, extended like those of the search, with half of its means anew."""
    search.spent = min(search.spent, 0.5 * search.settings.budget)
    search.keep(fitted, search.score(root) - search.gain(root, fitted))
    best = freer_form(search, search.fitted_models[frozenset(fitted.names)])
    while len(best.effects) < search.settings.depth and not is_white(best):
        number = len(best.effects) + 1
        # Process noise first: one fit tells whether it is all that is missing.
        children = _moving(search, [best], number) or expand(search, best, number)
        if not children:
            break
        best = freer_form(search, min(children, key=search.score))
    return best


def _moving(search: Search, fitted_models: Sequence[FittedModel], number: int) -> list[FittedModel]:
    """The nodes with process noise, as far as that leaves noise."""
    return [moved for fitted in fitted_models for moved in with_process_noise(search, fitted, number) if is_white(moved)]


def _best(search: Search, fitted_models: list[FittedModel]) -> list[FittedModel]:
    """The best different sets, as many as the beam is wide."""
    unique = {frozenset(fitted.names): fitted for fitted in fitted_models}
    return sorted(unique.values(), key=search.score)[: search.settings.beam]
