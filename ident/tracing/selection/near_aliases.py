"""Near-aliases: what could take the place of each effect of a set, fitted together with the rest.

The search keeps the cheapest of causes that look alike in the fitted record; another maneuver may tell them apart, so each of
them has to be put to the data that were not fitted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, is_event
from ident.tracing.diagnosis import Step
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding, screen
from ident.tracing.selection.backward import fitted_without
from ident.tracing.selection.criterion import gain
from ident.tracing.selection.event_times import in_freer_form
from ident.tracing.selection.expansion import best_fit
from ident.tracing.selection.ledger import Ledger, fit
from ident.tracing.selection.limits import is_limit, limit_in_place
from sim.declaration.effect import NoiseEffect
from sim.declaration.proposal import Refinable, Traceable


def near_aliases(ledger: Ledger, best: FittedModel, within: float) -> tuple[Ledger, list[FittedModel]]:
    """Sets of equal size that differ from ``best`` in one effect, of nearly equal likelihood whatever their number of parameters.

    ``within`` in units of twice the log likelihood. Candidates are those that evidence or the effect itself calls alike.
    """
    found: list[FittedModel] = []
    for effect in best.effects:
        ledger, alike = _in_the_place_of(ledger, best, effect, _alike(ledger, best, effect), within)
        found += alike
    return ledger, found


def guards_for_events(ledger: Ledger, best: FittedModel, within: float) -> Ledger:
    """With sets fitted that have a guard in the place of an event, where that brought half as much, or more, at a set that both were tried at.

    A search that is content with an event does not come to the guard that does as well.
    """
    guards = ledger.problem.guards
    for effect in best.effects:
        if not is_event(effect):
            continue
        tries = sorted((seen for seen in ledger.evidence if seen.name == effect.name and seen.fitted), key=lambda seen: seen.gain)
        brought = {seen.within: seen.gain for seen in tries}
        rivals = {seen.name for seen in ledger.evidence if seen.name in guards and seen.gain > thresholds.RIVAL * brought.get(seen.within, np.inf)}
        rest = frozenset(best.names) - {effect.name}
        ledger, _ = _in_the_place_of(ledger, best, effect, {name for name in rivals if rest | {name} not in ledger.models}, within)
    return ledger


def equivalent_sets(ledger: Ledger, fitted: FittedModel, within: float) -> tuple[Ledger, list[FittedModel]]:
    """Sets with one effect replaced by another that no record tells from it: those that were fitted already, and the others."""
    found: list[FittedModel] = []
    for effect in fitted.effects:
        rest = frozenset(fitted.names) - {effect.name}
        known = {name for name in effect.traits.equivalents if rest | {name} in ledger.models}
        found += [ledger.models[rest | {name}] for name in sorted(known)]
        ledger, others = _in_the_place_of(ledger, fitted, effect, {*effect.traits.equivalents} - known - rest, within)
        found += others
    return ledger, found


def _in_the_place_of(ledger: Ledger, best: FittedModel, effect: Traceable, names: set[str], within: float) -> tuple[Ledger, list[FittedModel]]:
    if not names:
        return ledger, []
    ledger, base = _without(ledger, best, effect)
    if base is None:
        return ledger, []
    found: list[FittedModel] = []
    brought = base.fit.cost - best.fit.cost
    candidates = [candidate for candidate in (*ledger.problem.candidates, *ledger.problem.general) if candidate.name in names]
    there = _where_the_rest_stands(ledger, best, effect, candidates)
    for finding in screen(base, candidates, search_context(base, ledger.problem.predicted)):
        # What no record tells apart is shown whatever the search has spent; it, and what is known to look alike, whatever a base fit that
        # bent far says of it.
        twin, alias = finding.effect.name in effect.traits.equivalents, finding.effect.name in effect.aliases
        least = thresholds.HOPELESS_IN_SEARCH if is_event(effect) else thresholds.LOOKS_ALIKE
        seen = there.get(finding.effect.name)
        promising = alias or max(finding.gain, seen.gain if seen is not None else 0.0) >= least * brought
        if not twin and (ledger.exhausted or not promising):
            continue
        ledger, child = best_fit(ledger, base, finding, 1)
        if child is None or 2.0 * (child.fit.cost - best.fit.cost) > within:
            ledger, child = _from_there(ledger, best, effect, seen, child)
        if is_limit(finding.effect) and (child is None or 2.0 * (child.fit.cost - best.fit.cost) > within):
            ledger, child = limit_in_place(ledger, best, effect, finding.effect, child)
        ledger, child = _freely(ledger, child, best, finding.effect)
        if child is None:
            continue
        behind = 2.0 * (child.fit.cost - best.fit.cost)
        # An event has many parameters and a place: what acts all along may fit worse by what those cost.
        if (min(behind, child.criterion - best.criterion) if is_event(effect) else behind) > within:
            continue
        ledger = ledger.kept(child, ledger.score(best) + child.criterion - best.criterion)
        sentence = f"{finding.effect.name} in the place of {effect.name} fits nearly as well"
        ledger = ledger.told(Step(child.names, ledger.score(child), child.fit.log_likelihood, sentence))
        found.append(ledger.known(child))
    return ledger, found


def _where_the_rest_stands(ledger: Ledger, best: FittedModel, effect: Traceable, candidates: Sequence[Traceable]) -> dict[str, Finding]:
    """Candidates for the place of an effect, screened with all else as it is in ``best``: a fit without the effect bends to what that did."""
    if has_process_noise(best.system):
        return {}
    held = ledger.problem.at_values(tuple(other for other in best.effects if other is not effect), best)
    return (
        {} if held is None else {finding.effect.name: finding for finding in screen(held, candidates, search_context(held, ledger.problem.predicted))}
    )


def _from_there(
    ledger: Ledger, best: FittedModel, effect: Traceable, finding: Finding | None, child: FittedModel | None
) -> tuple[Ledger, FittedModel | None]:
    """The better of ``child`` and a fit from the values of ``best`` with a finding in the place of its effect."""
    if finding is None:
        return ledger, child
    rest = tuple(other for other in best.effects if other is not effect)
    ledger, again = fit(ledger, (*rest, finding.effect), best, finding.starts[0], rough=True)
    return ledger, min((fitted for fitted in (child, again) if fitted is not None), key=lambda fitted: fitted.fit.cost, default=None)


def _alike(ledger: Ledger, best: FittedModel, effect: Traceable) -> set[str]:
    """Names of candidates that look like one effect of a set, those that the search has fitted in its place already left out."""
    rest = {other.name for other in best.effects} - {effect.name}
    names = {*effect.aliases, *effect.traits.equivalents}
    if is_event(effect):
        # The place of an event was searched for: whatever acts all along and does as well is likelier.
        names |= {c.name for c in ledger.problem.candidates if not (is_event(c) or belongs_to_record(c))}
    if effect.traits.background:
        # Slow motion takes in what goes slowly wrong in a record, be it in all of its outputs or in one.
        names |= {c.name for c in ledger.problem.candidates if belongs_to_record(c) and not is_event(c)}
    # What any record may have has no part in it: a set may have been left by it since.
    known_motion = {c.name for c in ledger.problem.candidates if c.traits.background}
    for seen in ledger.evidence:
        if seen.name == effect.name and set(seen.within) - known_motion <= rest:
            names |= set(seen.collinear_with)
        elif effect.name in seen.collinear_with and set(seen.within) - known_motion <= rest:
            names.add(seen.name)
    known = {name for name in names if frozenset({*rest, name}) in ledger.models}
    if is_event(effect):
        # Of another event the search may have met a place that is none: it is put where this one stands.
        names |= {c.name for c in ledger.problem.candidates if is_event(c)}
    candidates = {c.name for c in ledger.problem.candidates if not (isinstance(c, NoiseEffect) or c.traits.guard)} | {*effect.traits.equivalents}
    if effect.traits.general:
        candidates |= {c.name for c in ledger.problem.general}
    twins = {name for other in best.effects if other.name in rest for name in other.traits.twins}
    return (names & candidates) - rest - known - twins - {effect.name}


def _without(ledger: Ledger, best: FittedModel, effect: Traceable) -> tuple[Ledger, FittedModel | None]:
    if has_process_noise(best.system):
        return ledger, ledger.models.get(frozenset(name for name in best.names if name != effect.name))
    return fitted_without(ledger, best, effect, rough=True)


def _freely(ledger: Ledger, child: FittedModel | None, best: FittedModel, effect: Traceable) -> tuple[Ledger, FittedModel | None]:
    """The child, in its freer form where the plain one is not quite as good as the set that it would replace."""
    if child is None or not isinstance(effect, Refinable) or child.fit.cost <= best.fit.cost:
        return ledger, child
    ledger, finer = in_freer_form(ledger, child, len(child.effects) - 1)
    accept = ledger.problem.settings.accept
    return ledger, finer if finer is not None and gain(child, finer, accept) > accept else child
