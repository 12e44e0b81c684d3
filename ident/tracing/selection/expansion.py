"""One fitted model extended: candidates screened, and the best of them fitted in full."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.process_noise.filter_error import turbulence_worth_trying
from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, free_names, is_event, never_together, shared_start
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding, collinear, screen
from ident.tracing.selection.acceptance import accepted
from ident.tracing.selection.background import with_background
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.ledger import Ledger, fit
from ident.tracing.selection.limits import limits_from_declared_values
from sim.declaration.effect import NoiseEffect, full_name
from sim.declaration.proposal import Curve, Traceable


def expand(ledger: Ledger, fitted: FittedModel, number: int) -> tuple[Ledger, list[FittedModel]]:
    """Accepted children of a fitted model, in round ``number``; all that was looked at is kept as evidence.

    The best few by projected gain are fitted in full. Where none of them leaves noise, the candidates with few parameters are
    fitted too: a base fit that bent far hides what bent it from a linear look. What any record may have comes first, and stays in all
    children, unless another cause dwarfs it: then it is offered again beside that cause.
    """
    key, problem = frozenset(fitted.names), ledger.problem
    if key in ledger.expanded or ledger.exhausted:
        return ledger, []
    ledger, fuller = with_background(ledger.marked(key), fitted, number)
    findings = [
        finding
        for finding in screen(fitted, problem.candidates, search_context(fitted, problem.predicted))
        if not (
            any(never_together(other, finding.effect) for other in fitted.effects)
            or isinstance(finding.effect, NoiseEffect)
            or finding.effect.traits.background
        )
        and not only_beside_another(finding.effect)
    ]
    if fuller is not fitted and not _waits(findings, fitted.fit.cost - fuller.fit.cost):
        ledger, instead = _instead_of_motion(ledger, fitted, fuller, findings, number)
        ledger, further = expand(ledger, fuller, number)
        return ledger, [fuller, *instead, *further]
    sets = f"{len(ledger.models)} {'set' if len(ledger.models) == 1 else 'sets'} fitted"
    doing = f"round {number}: {' + '.join(fitted.names) or 'declared model'}, {sets}"
    problem.progress(doing, number / (problem.settings.depth + 1))
    ledger, children, explained = _fit_promising(ledger, fitted, findings)
    if explained is None and not is_white(fitted) and not has_process_noise(fitted.system):
        for place, finding in enumerate(findings):
            cheap = finding.parameters <= thresholds.CHEAP and not _spoken_for(findings, children, finding)
            if place not in children and cheap and not ledger.exhausted:
                ledger, child = best_fit(ledger, fitted, finding, 1)
                if child is not None:
                    children[place] = child
    ledger, children = limits_from_declared_values(ledger, fitted, findings, children, rivals=explained is not None)
    ledger, kept = accepted(ledger, fitted, number, findings, children)
    return ledger, [*([fuller] if fuller is not fitted else []), *kept]


def _instead_of_motion(
    ledger: Ledger, fitted: FittedModel, fuller: FittedModel, findings: Sequence[Finding], number: int
) -> tuple[Ledger, list[FittedModel]]:
    """Sets with one cause in the place of what any record may have, which that imitates: those that leave noise or bring twice as much."""
    if is_white(fuller):
        return ledger, []
    children: dict[int, FittedModel] = {}
    brought = fitted.fit.cost - fuller.fit.cost
    for place, finding in enumerate(findings[: thresholds.INSTEAD_OF_MOTION]):
        if finding.gain <= brought or ledger.exhausted:
            break
        ledger, child = best_fit(ledger, fitted, finding, 1)
        if child is not None and (is_white(child) or fitted.fit.cost - child.fit.cost > thresholds.OUTDONE * brought):
            children[place] = child
    return accepted(ledger, fitted, number, findings, children) if children else (ledger, [])


def _waits(findings: Sequence[Finding], brought: float) -> bool:
    """Whether what any record may have waits, since another cause brings more.

    Of what can imitate slow motion (what belongs to one record, events, curves, guards) it takes far more than of a steady cause.
    """
    steady = [finding.gain for finding in findings if not _imitates(finding.effect)]
    every = [finding.gain for finding in findings]
    return max(steady, default=0.0) > thresholds.OUTDONE * brought or max(every, default=0.0) > thresholds.DWARFED * brought


def _imitates(effect: Traceable) -> bool:
    return belongs_to_record(effect) or is_event(effect) or isinstance(effect, Curve) or effect.traits.guard


def with_process_noise(ledger: Ledger, fitted: FittedModel, number: int) -> tuple[Ledger, list[FittedModel]]:
    """The fitted model with turbulence, offered only where its innovations are not white."""
    effects = [effect for effect in ledger.problem.candidates if isinstance(effect, NoiseEffect)]
    if not effects or has_process_noise(fitted.system) or ledger.exhausted:
        return ledger, []
    if turbulence_worth_trying(fitted.fit) > thresholds.PROCESS_NOISE_OFFERED:
        return ledger, []
    findings: list[Finding] = []
    children: dict[int, FittedModel] = {}
    for effect in effects:
        ledger, child = fit(ledger, (*fitted.effects, effect), fitted, rough=True)
        if child is not None:
            children[len(findings)] = child
            findings.append(Finding(effect, 0.0, len(free_names(effect)), ({},), (0.0,), np.zeros(1)))
    return accepted(ledger, fitted, number, findings, children)


def best_fit(ledger: Ledger, fitted: FittedModel, finding: Finding, starts: int) -> tuple[Ledger, FittedModel | None]:
    """A set with one more effect, fitted from the best few of its starts; None where none comes out better than without it."""
    ledger, best = _lowest(ledger, fitted, finding.effect, finding.starts[:starts])
    brought = fitted.fit.cost - best.fit.cost if best is not None else 0.0
    elsewhere = _where_it_was_found(ledger, fitted, finding) if brought < thresholds.RIVAL * finding.gain else None
    if elsewhere is not None:
        # Slopes point the wrong way across a limit: where another set has it is a start as good.
        ledger, best = _lowest(ledger, fitted, finding.effect, [elsewhere], best)
    if best is not None and best.fit.cost <= fitted.fit.cost:
        return ledger, best
    # The projection, which knows slopes only, led astray: a part of its step is shorter than where they hold, and from near absence no fit can fail.
    for share in thresholds.SHORTER_STEPS:
        ledger, again = fit(ledger, (*fitted.effects, finding.effect), fitted, near_absence(finding.effect, finding.starts[0], share), rough=True)
        if again is not None and again.fit.cost <= fitted.fit.cost:
            return ledger, again
    return ledger, None


def _lowest(
    ledger: Ledger, fitted: FittedModel, effect: Traceable, starts: Sequence[Mapping[str, float]], best: FittedModel | None = None
) -> tuple[Ledger, FittedModel | None]:
    """The set with one more effect from each start: the fit of lowest cost, ``best`` among them."""
    for start in starts:
        ledger, child = fit(ledger, (*fitted.effects, effect), fitted, start, rough=True)
        if child is not None and (best is None or child.fit.cost < best.fit.cost):
            best = child
    return ledger, best


def _where_it_was_found(ledger: Ledger, fitted: FittedModel, finding: Finding) -> dict[str, float] | None:
    """An effect's values in the set in which it stands alone, beside what any record may have; None where that was not fitted."""
    alone = ledger.models.get(frozenset(effect.name for effect in fitted.background) | {finding.effect.name})
    if alone is None or len(alone.names) > len(fitted.names):
        return None
    start = shared_start(alone, finding.effect)
    return start if len(start) == len(free_names(finding.effect)) else None


def near_absence(effect: Traceable, start: Mapping[str, float], share: float = thresholds.NEAR_ABSENCE) -> dict[str, float]:
    """A start with a share of its distance from the effect's absence, a hundredth unless told."""
    absent = {full_name(effect, local): value for local, value in effect.absent.items()}
    near = {name: absent.get(name, value) + (share * (value - absent[name]) if name in absent else 0.0) for name, value in start.items()}
    return {name: value if np.isfinite(value) else start[name] for name, value in near.items()}


def _fit_promising(ledger: Ledger, fitted: FittedModel, findings: Sequence[Finding]) -> tuple[Ledger, dict[int, FittedModel], Finding | None]:
    """The findings worth a fit, fitted, by place; and the first that leaves noise."""
    settings = ledger.problem.settings
    children: dict[int, FittedModel] = {}
    most, explained = 0.0, None
    limit = settings.tried if not fitted.effects else settings.tried // 2
    starts = settings.starts if not fitted.effects else 1
    for place, finding in enumerate(findings):
        price = settings.accept + finding.parameters * float(np.log(fitted.fit.counts.sum()))
        # A projected gain errs where an effect is not linear; one that is far below what another really brought is hopeless.
        worth = 2.0 * finding.gain > thresholds.HALF_ITS_PRICE * price and (len(children) < 2 or finding.gain > thresholds.HOPELESS_IN_SEARCH * most)
        if explained is not None:
            # Nothing is missing any more: only what might explain it as well is still of interest.
            worth = worth and (finding.gain > thresholds.RIVAL * most or collinear(finding, explained) > thresholds.COLLINEAR)
        if not worth or len(children) >= limit or ledger.exhausted or _spoken_for(findings, children, finding):
            continue
        # Of an oscillation one place is a peak over frequency, the next may be where it hardly oscillates.
        ledger, child = best_fit(ledger, fitted, finding, max(starts, thresholds.PLACES_OF_A_MODE) if finding.effect.traits.oscillates else starts)
        if child is not None:
            children[place] = child
            most = max(most, fitted.fit.cost - child.fit.cost)
            if explained is None and is_white(child):
                explained = finding
    return ledger, children, explained


def only_beside_another(effect: Traceable) -> bool:
    """Whether a candidate is put beside its equivalents alone, when these are ranked."""
    return effect.traits.guard and bool(effect.traits.equivalents)


def _spoken_for(findings: Sequence[Finding], children: Mapping[int, FittedModel], finding: Finding) -> bool:
    """Whether an effect that no record tells from it is fitted already: the ranking puts the other beside it in the end."""
    return any(findings[place].effect.name in finding.effect.traits.equivalents for place in children)
