"""Two effects that hide each other, or that a third replaces: looked for together, and claimed only where each stands with the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, shared_start
from ident.tracing.replication.by_record import Flight, most_telling
from ident.tracing.replication.coloured_null import coloured_gain
from ident.tracing.replication.comparison import CrossValidatedEffect, CrossValidation, choose
from ident.tracing.replication.error_reduction import reduction
from ident.tracing.replication.one_round import Tried, weigh_all
from ident.tracing.replication.weighing import fitted_change, weigh
from ident.tracing.screening.pairs import likely_pairs
from ident.tracing.screening.score_test import Finding
from sim.declaration.proposal import Traceable

Pair = tuple[list[CrossValidatedEffect] | None, list[CrossValidation]]


def pair_instead(flight: Flight, candidates: Sequence[Traceable], first: Tried, found: Sequence[CrossValidatedEffect]) -> Pair:
    """Two effects in the place of what was ``found`` one after the other, None where that stays; and all that was tried.

    ``first`` : the first step. The two do clearly better by the error, or no worse and clearly better with any colour allowed for.
    """
    names = [item.best.effect.name for item in found]
    pairs = likely_pairs(first.findings, names, float(first.fitted.fit.counts.sum()))
    children = [child for each in pairs if (child := _fit_pair(flight, first.fitted, each)) is not None]
    best = min(children, key=lambda child: child.fit.cost, default=None)
    begun: Tried | None = None
    if best is None or not _promises(flight, first, best, found):
        begun = _beside_the_rival(flight, candidates, first) if len(found) > 1 else None
        best = begun.chosen.best.fitted if begun is not None and begun.chosen is not None else None
    if best is None:
        return None, list(begun.results) if begun is not None else []
    pair, compared = _validated(flight, candidates, first, best, begun)
    better = pair is not None and _better(flight, first, best, pair, found)
    return (pair if better else None), compared


def _promises(flight: Flight, first: Tried, best: FittedModel, found: Sequence[CrossValidatedEffect]) -> bool:
    """Whether a pair does better on the fitted records: what a witness speaks for need not be better by as much."""
    reached = -fitted_change(first.fitted, found[-1].best.fitted) if found else 0.0
    fall = -fitted_change(first.fitted, best)
    least = thresholds.NO_PREFERENCE if len(found) > 1 else thresholds.HALF_OF_IT * thresholds.WORTH
    return fall > reached and (fall >= reached + least or _vouched(flight, first, best))


def _vouched(flight: Flight, first: Tried, best: FittedModel) -> bool:
    return all(flight.witness(effect.name, most_telling(best, effect)) > 0 for effect in best.effects[len(first.fitted.effects) :])


def _validated(flight: Flight, candidates: Sequence[Traceable], first: Tried, best: FittedModel, begun: Tried | None) -> Pair:
    """The two of a fitted model, each cross-validated with the other in it, the stronger first; ``begun`` : the round beside one, if made."""
    pair = best.effects[len(first.fitted.effects) :]
    validated: list[CrossValidatedEffect] = []
    compared: list[CrossValidation] = []
    one = pair[0]
    for _ in range(2):
        # The second may be another than the pair's, where that does better; the first has to come out again with it in the model.
        step = begun or _beside(flight, candidates, first, best, one)
        begun = None
        compared += step.results if step is not None else []
        if step is None or step.chosen is None:
            lone = _alone(flight, first, validated[0].best) if validated else None
            compared += [lone] if lone is not None else []
            stands = choose([*first.results, lone], flight.witness) if lone is not None else None
            return ([stands] if stands is not None and stands.best is lone else None), compared
        validated.append(step.chosen)
        one = step.chosen.best.effect
    came_out = {item.effect.name for item in (validated[1].best, *validated[1].others)}
    return (validated[::-1] if pair[0].name in came_out else None), compared


def _alone(flight: Flight, first: Tried, validated: CrossValidation) -> CrossValidation | None:
    """An effect that stands beside another, of which nothing is left beside it, tried by itself from where the two were fitted.

    No projection leads from its absence to it, as to a limit. None where the first round has tried it, or by itself it brings less than half.
    """
    one = validated.effect
    if any(item.effect.name == one.name for item in first.results):
        return None
    single = flight.beside(first.fitted, one, validated.fitted.values)
    if single is None or fitted_change(first.fitted, single) > thresholds.HALF_OF_IT * fitted_change(first.fitted, validated.fitted):
        return None
    return weigh(flight, first.fitted, replace(validated.finding, starts=(shared_start(single, one),)), first.before)


def _beside(flight: Flight, candidates: Sequence[Traceable], first: Tried, best: FittedModel, one: Traceable) -> Tried | None:
    """The round beside one effect of a pair."""
    alone = flight.beside(first.fitted, one, best.values)
    return weigh_all(flight, candidates, alone) if alone is not None else None


def _better(flight: Flight, first: Tried, best: FittedModel, pair: Sequence[CrossValidatedEffect], found: Sequence[CrossValidatedEffect]) -> bool:
    """Whether the error on records left out falls by what is worth it, beyond its scatter; or does not rise, and one-step predictions gain much."""
    last = found[-1].best.predictions if found else first.before
    common = sorted(last.keys() & pair[0].best.predictions.keys())
    before, after = [last[r] for r in common], [pair[0].best.predictions[r] for r in common]
    lowered = reduction(before, after)
    if len(found) > 1 and lowered.total < 0.0 and coloured_gain(before, after) > thresholds.BY_ONE_STEP:
        return True
    least = 0.0 if _vouched(flight, first, best) else thresholds.NO_PREFERENCE if len(found) > 1 else thresholds.WORTH
    return lowered.total < -max(least, thresholds.BEYOND_ITS_SCATTER * lowered.scatter)


def _beside_the_rival(flight: Flight, candidates: Sequence[Traceable], first: Tried) -> Tried | None:
    """The round beside an effect that was not chosen although, with any colour allowed for, it brings more than what was; None without one."""
    if first.chosen is None:
        return None
    best = first.chosen.best
    taken = {id(item) for item in (best, *first.chosen.others)}
    rivals = [item for item in first.results if item.stands and id(item) not in taken and not item.effect.traits.guard and item.gain > best.gain]
    return weigh_all(flight, candidates, max(rivals, key=lambda item: item.gain).fitted) if rivals else None


def _fit_pair(flight: Flight, fitted: FittedModel, pair: tuple[Finding, Finding]) -> FittedModel | None:
    effects = (*fitted.effects, *(finding.effect for finding in pair))
    return flight.fit(effects, range(len(flight.records)), fitted.values, {**pair[0].starts[0], **pair[1].starts[0]})
