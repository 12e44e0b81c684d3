"""Instances of the general form: a parameter that varies with a signal, where no named effect alone explains the records.

There are many of them and none has a cause of its own, so that they stand behind what has: the best of n pays for the choice, must leave noise,
and takes the place of a set that leaves noise, a guard's among them, only where it is clearly better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import log
from typing import cast

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.quantities import stands_out_somewhere
from ident.tracing.diagnosis import Candidate, Step
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding, collinear
from ident.tracing.screening.stacked import Varying, screen_varying
from ident.tracing.selection.acceptance import evidence_of
from ident.tracing.selection.backward import freer_form
from ident.tracing.selection.criterion import gain, is_coloured_throughout, is_white
from ident.tracing.selection.expansion import best_fit, expand
from ident.tracing.selection.ledger import Ledger
from sim.declaration.effect import NoiseEffect


def choice_price(number: int) -> float:
    """What the best of so many candidates has to bring more than one of them, in twice the log likelihood: its p-value times their number."""
    return 2.0 * log(number) if number else 0.0


@dataclass(frozen=True, eq=False)
class Alone:
    """Sets of one instance beside what any record may have, those that bring enough, and what was seen of all instances."""

    fitted: tuple[FittedModel, ...] = ()
    evidence: tuple[Candidate, ...] = ()
    asked: bool = False


def alone(ledger: Ledger, base: FittedModel, first: Sequence[FittedModel] = ()) -> Alone:
    """The best instances beside ``base``, which is the declared model with what any record may have.

    Not asked where there is nothing to explain, or where one of the sets ``first`` leaves noise.
    """
    if not ledger.problem.general or has_process_noise(base.system) or any(is_white(fitted) for fitted in (base, *first)):
        return Alone()
    named = max((base.fit.cost - fitted.fit.cost for fitted in first), default=0.0)
    told, fitted = _added(ledger, base, thresholds.GENERAL_FITTED, named)
    return Alone(tuple(fitted), told.evidence[len(ledger.evidence) :], True)


def with_general_form(ledger: Ledger, base: FittedModel, best: FittedModel, general: Alone) -> tuple[Ledger, FittedModel]:
    """The set that a search ended with, or one with an instance of the general form where no single named effect explains the records.

    Alone first (``general``); where no instance leaves noise, beside the best named effects, unless the residual stays far from noise
    throughout. Where none takes the place of ``best`` the ledger is as it was, but for evidence.
    """
    if not ledger.problem.general or _is_named(ledger, best):
        return ledger, best
    general = general if general.asked else alone(ledger, base)
    told, white = ledger.told(evidence=general.evidence), leaving_noise(ledger, general.fitted)
    if not white and not is_white(best, ledger.problem.settings.white) and not _hopeless(base, general.fitted):
        told, white = _with_named(told, general.fitted)
        for start in _beside(ledger, best) if not white else ():
            told, found = _added(told, start, thresholds.GENERAL_BESIDE)
            white += leaving_noise(ledger, found)
    least = min(white, key=lambda fitted: _total(ledger, fitted), default=None)
    if least is None or not _wins(ledger, least, best):
        return ledger.told(evidence=told.evidence[len(ledger.evidence) :]), best
    for fitted in white:
        score = _total(ledger, fitted)
        if score - _total(ledger, least) < ledger.problem.settings.near:
            varying = " and ".join(effect.name for effect in fitted.effects if effect.traits.general)
            step = Step(fitted.names, score, fitted.fit.log_likelihood, f"{varying} explains what no named effect alone does")
            told = told.kept(fitted, score).told(step)
    return told, told.known(least)


def for_pairs(ledger: Ledger, general: Alone) -> Ledger:
    """The ledger for a search that looks no further than sets of two causes, with part of its means, where an instance alone leaves noise.

    Three causes are no better answer, and process noise, which takes in whatever has a cause, none at all.
    """
    if not leaving_noise(ledger, general.fitted):
        return ledger
    problem = ledger.problem
    settings = replace(problem.settings, depth=min(2, problem.settings.depth))
    causes = tuple(candidate for candidate in problem.candidates if not isinstance(candidate, NoiseEffect))
    spent = max(ledger.spent, (1.0 - thresholds.LEFT_FOR_PAIRS) * settings.budget)
    return replace(ledger, problem=replace(problem, settings=settings, candidates=causes), spent=spent)


def leaving_noise(ledger: Ledger, sets: Sequence[FittedModel]) -> list[FittedModel]:
    """Those of some sets whose residual is noise."""
    return [fitted for fitted in sets if is_white(fitted, ledger.problem.settings.white)]


def _is_named(ledger: Ledger, best: FittedModel) -> bool:
    """Whether noise is left by one named effect, or by none."""
    several = len(best.foreground) > 1 or best.guards or has_process_noise(best.system)
    return not several and is_white(best, ledger.problem.settings.white)


def _added(ledger: Ledger, start: FittedModel, most: int, named: float = 0.0) -> tuple[Ledger, list[FittedModel]]:
    """The best few instances added to a set: those fits that bring enough, in a freer form where that brings enough, too.

    ``named`` is what the best named effect brings beside that set: an instance that is far behind it is given no freer form.
    """
    problem = ledger.problem
    accept, number = problem.settings.accept, len(problem.general)
    findings = screen_varying(start, cast(Sequence[Varying], problem.general), search_context(start, problem.predicted))
    spent, ledger = ledger.spent, ledger.renewed(thresholds.LEFT_FOR_GENERAL)
    found: list[FittedModel] = []
    fitted: dict[int, FittedModel] = {}
    for place, finding in enumerate(findings[:most]):
        price = accept + choice_price(number) + finding.parameters * log(float(start.fit.counts.sum()))
        if 2.0 * finding.gain < thresholds.HALF_ITS_PRICE * price or finding.gain < thresholds.HOPELESS_IN_SEARCH * findings[0].gain:
            break
        ledger, child = best_fit(ledger, start, finding, 1)
        if child is None or not stands_out_somewhere(child, finding.effect):
            continue
        if start.fit.cost - child.fit.cost >= thresholds.RIVAL * named:
            ledger, child = _freer(ledger, start, child)
        fitted[place] = child
        if gain(start, child, accept) > accept + choice_price(number):
            found.append(child)
    ledger = ledger.told(evidence=[_evidence(start, findings, place, fitted) for place in range(len(findings))])
    return ledger.respent(spent), found


def _with_named(ledger: Ledger, sets: Sequence[FittedModel]) -> tuple[Ledger, list[FittedModel]]:
    """The ledger with evidence of named effects beside the best of some sets with an instance, and those of two that leave noise, but for guards."""
    if not sets:
        return ledger, []
    best = min(sets, key=lambda fitted: fitted.criterion)
    borrowed = ledger.renewed(thresholds.LEFT_FOR_GENERAL).kept(best, _total(ledger, best))
    borrowed, children = expand(borrowed, best, len(best.foreground) + 1)
    least = min(children, key=lambda child: child.criterion, default=None)
    if least is not None and not leaving_noise(ledger, children):
        # The curve took part of what the named effect does: only beside it more of its shapes bring enough.
        _, freer = _freer(borrowed, best, least)
        children = [*children, freer]
    return ledger.told(evidence=borrowed.evidence[len(ledger.evidence) :]), [m for m in leaving_noise(ledger, children) if not m.guards]


def _freer(ledger: Ledger, start: FittedModel, child: FittedModel) -> tuple[Ledger, FittedModel]:
    """The child in the freest form that brings enough, kept in no ledger but a borrowed one."""
    borrowed, best = ledger.replaced(child, ledger.score(start) - gain(start, child, ledger.problem.settings.accept)), None
    while best is not child:
        best = child
        borrowed, child = freer_form(borrowed, best)
    return ledger.respent(borrowed.spent), child


def _evidence(start: FittedModel, findings: Sequence[Finding], place: int, fitted: Mapping[int, FittedModel]) -> Candidate:
    finding = findings[place]
    others = tuple(f.effect.name for f in findings if f is not finding and collinear(f, finding) > thresholds.COLLINEAR)
    return evidence_of(len(start.foreground) + 1, start, finding, fitted.get(place), others)


def _hopeless(base: FittedModel, fitted: Sequence[FittedModel]) -> bool:
    """Whether every channel stays far from noise with each instance: a second cause would hardly mend that."""
    return all(is_coloured_throughout(each, thresholds.GROSSLY_COLOURED) for each in (base, *fitted))


def _beside(ledger: Ledger, best: FittedModel) -> list[FittedModel]:
    """Sets beside which an instance is tried: the best named effect alone, and the set that the search ended with."""
    usable = [m for m in ledger.models.values() if m.foreground and not m.guards and not has_process_noise(m.system)]
    one = sorted((m for m in usable if len(m.foreground) == 1), key=ledger.score)[: thresholds.GENERAL_BESIDE]
    whole = [m for m in usable if m.names == best.names and 1 < len(m.foreground) < ledger.problem.settings.depth]
    return [*one, *whole]


def _total(ledger: Ledger, fitted: FittedModel) -> float:
    return fitted.criterion + choice_price(len(ledger.problem.general))


def _wins(ledger: Ledger, general: FittedModel, best: FittedModel) -> bool:
    """Whether a set that leaves noise does so clearly better than one that also does, or where nothing else does."""
    return not is_white(best, ledger.problem.settings.white) or _total(ledger, general) < best.criterion - thresholds.GUARD_TIE
