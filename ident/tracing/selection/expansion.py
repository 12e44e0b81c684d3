"""One node of the search extended: candidates screened, the best fitted in full, what is accepted and why."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ident.process_noise.filter_error import turbulence_worth_trying
from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.candidate_model.fitted_model import FittedModel, free_names, is_event
from ident.tracing.candidate_model.quantities import _quantities_by_record, _stands_out, quantities
from ident.tracing.diagnosis import Candidate, Quantity, Step
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import COLLINEAR, Finding, collinear, screen
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.search import Search
from sim.declaration.effect import Effect, NoiseEffect, full_name
from sim.declaration.proposal import Traceable

SHIFTS = (-0.6, -0.3, 0.3, 0.6)  # s
WORTH = 1e-2  # p-value of the innovations being white below which process noise is offered
HOPELESS, RIVAL = 0.2, 0.5  # of the best gain so far
CHEAP = 2  # parameters of a candidate that is fitted even though its projected gain is small


def expand(search: Search, fitted: FittedModel, number: int) -> list[FittedModel]:
    """Accepted children of a fitted model; all that was looked at is kept as evidence.

    The best few by projected gain are fitted in full. Where none of them leaves noise, the candidates with few parameters are
    fitted too: a base fit that bent far hides what bent it from a linear look.
    """
    key = frozenset(fitted.names)
    if key in search.expanded or search.exhausted:
        return []
    search.expanded.add(key)
    findings = [
        finding
        for finding in screen(fitted, search.candidates, search_context(fitted, search.beside))
        if not (_excluded(fitted, finding.effect) or isinstance(finding.effect, NoiseEffect))
    ]
    search.progress(f"round {number}: {' + '.join(fitted.names) or 'declared model'}", number / (search.settings.depth + 1))
    children: dict[int, FittedModel] = {}
    most, explained = 0.0, None
    limit = search.settings.tried if not fitted.effects else search.settings.tried // 2
    starts = search.settings.starts if not fitted.effects else 1
    for place, finding in enumerate(findings):
        # A projected gain errs where an effect is not linear; one that is far below what another really brought is hopeless.
        worth = 2.0 * finding.gain > 0.5 * _price(search, fitted, finding) and (len(children) < 2 or finding.gain > HOPELESS * most)
        if explained is not None:
            # Nothing is missing any more: only what might explain it as well is still of interest.
            worth = worth and (finding.gain > RIVAL * most or collinear(finding, explained) > COLLINEAR)
        if not worth or len(children) >= limit or search.exhausted:
            continue
        child = best_fit(search, fitted, finding, starts)
        if child is not None:
            children[place] = child
            most = max(most, fitted.fit.cost - child.fit.cost)
            if explained is None and is_white(child):
                explained = finding
    if explained is None and not is_white(fitted) and not has_process_noise(fitted.system):
        for place, finding in enumerate(findings):
            if place not in children and finding.parameters <= CHEAP and not search.exhausted:
                child = best_fit(search, fitted, finding, 1)
                if child is not None:
                    children[place] = child
    return _accepted(search, fitted, number, findings, children)


def with_process_noise(search: Search, fitted: FittedModel, number: int) -> list[FittedModel]:
    """The node with turbulence, offered only where its innovations are not white."""
    effects = [effect for effect in search.candidates if isinstance(effect, NoiseEffect)]
    if not effects or has_process_noise(fitted.system) or search.exhausted or turbulence_worth_trying(fitted.fit) > WORTH:
        return []
    findings: list[Finding] = []
    children: dict[int, FittedModel] = {}
    for effect in effects:
        child = search.fit((*fitted.effects, effect), fitted, rough=True)
        if child is not None:
            children[len(findings)] = child
            findings.append(Finding(effect, 0.0, len(free_names(effect)), ({},), (0.0,), np.zeros(1)))
    return _accepted(search, fitted, number, findings, children)


def _accepted(search: Search, fitted: FittedModel, number: int, findings: list[Finding], children: dict[int, FittedModel]) -> list[FittedModel]:
    """Keep evidence on all findings, and the children that lower the score enough."""
    accepted: list[FittedModel] = []
    most = max((fitted.fit.cost - child.fit.cost for child in children.values()), default=0.0)
    for place, finding in enumerate(findings):
        child = children.get(place)
        gain = finding.gain if child is None else fitted.fit.cost - child.fit.cost
        others = tuple(f.effect.name for f in findings if f is not finding and collinear(f, finding) > COLLINEAR)
        search.evidence.append(_candidate(number, fitted, finding, child, gain, others))
        lowered = 0.0 if child is None else search.gain(fitted, child)
        if child is None or lowered <= search.settings.accept:
            continue
        if not _present(child, finding.effect):
            # What it brought is a better optimum of the set without it.
            better = search.fit(fitted.effects, child)
            if better is not None and better.fit.cost < fitted.fit.cost:
                search.keep(better, search.score(fitted) - 2.0 * (fitted.fit.cost - better.fit.cost))
            continue
        parent = fitted
        if gain > RIVAL * most:
            # One that brings less than half of another will not be the best of its size: no need to know exactly what it brings.
            child = _placed_better(search, child, finding.effect)
            parent = _from_child(search, fitted, child)
            lowered = search.gain(parent, child)
        if lowered <= search.settings.accept:
            continue
        search.keep(child, search.score(parent) - lowered)
        sentence = f"{finding.effect.name} lowers the criterion by {lowered:.1f}"
        search.steps.append(Step(child.names, search.score(child), child.fit.log_likelihood, sentence))
        accepted.append(search.fitted_models[frozenset(child.names)])
    return accepted


def best_fit(search: Search, fitted: FittedModel, finding: Finding, starts: int) -> FittedModel | None:
    """A fitted model with one more effect, fitted from the best few of its starts; None where none comes out better than the fitted model itself."""
    best: FittedModel | None = None
    for start in finding.starts[:starts]:
        child = search.fit((*fitted.effects, finding.effect), fitted, start, rough=True)
        if child is not None and (best is None or child.fit.cost < best.fit.cost):
            best = child
    if best is None or best.fit.cost > fitted.fit.cost:
        # The projection, which knows slopes only, led astray: from near absence no fit can fail.
        again = search.fit((*fitted.effects, finding.effect), fitted, near_absence(finding.effect, finding.starts[0]), rough=True)
        best = again if again is not None and again.fit.cost <= fitted.fit.cost else None
    return best


def near_absence(effect: Effect, start: Mapping[str, float]) -> dict[str, float]:
    """A start with a hundredth of its distance from the effect's absence."""
    absent = {full_name(effect, local): value for local, value in effect.absent.items()}
    near = {name: absent.get(name, value) + (0.01 * (value - absent[name]) if name in absent else 0.0) for name, value in start.items()}
    return {name: value if np.isfinite(value) else start[name] for name, value in near.items()}


def _placed_better(search: Search, child: FittedModel, effect: Traceable) -> FittedModel:
    """An event moved a little to both sides: its time has local optima where the motion has died out."""
    if not is_event(effect):
        return child
    name = full_name(effect, effect.traits.onset)
    values = child.values
    at = values.own[0].get(name, values.shared.get(name))
    if at is None:
        return child
    for shift in SHIFTS:
        moved = search.fit(child.effects, child, {name: at + shift}, rough=True)
        if moved is not None and moved.fit.cost < child.fit.cost - 0.5:
            child = moved
    return child


def _from_child(search: Search, fitted: FittedModel, child: FittedModel) -> FittedModel:
    """The parent, fitted again from the child's values where it has effects: part of a gain may be a better optimum of its own."""
    if not fitted.effects or has_process_noise(fitted.system):
        return fitted
    again = search.fit(fitted.effects, child, rough=True)
    if again is None or again.fit.cost >= fitted.fit.cost - 0.5:
        return fitted
    search.keep(again, search.score(fitted) - 2.0 * (fitted.fit.cost - again.fit.cost))
    return again


def _present(fitted: FittedModel, effect: Traceable) -> bool:
    """Whether an effect stands out in a record, an event inside it: one that begins with the record, or after it, is a constant or nothing."""
    onset = effect.traits.onset
    for problem, found in zip(fitted.fit.layout.problems, _quantities_by_record(fitted, effect), strict=True):
        inside = onset not in found or problem.record.time[3] < found[onset].value < problem.record.time[-4]
        if inside and _stands_out(effect, found):
            return True
    return False


def _price(search: Search, fitted: FittedModel, finding: Finding) -> float:
    return search.settings.accept + finding.parameters * float(np.log(fitted.fit.counts.sum()))


def _excluded(fitted: FittedModel, effect: Traceable) -> bool:
    """One late effect per sensor: a lag and a delay of the same channel are one thing described twice."""
    return any(twin in fitted.names for twin in effect.traits.twins)


def _candidate(number: int, fitted: FittedModel, finding: Finding, child: FittedModel | None, gain: float, others: tuple[str, ...]) -> Candidate:
    from scipy.special import chdtrc

    effect = finding.effect
    if child is None:
        local = {full_name(effect, item.name): item for item in effect.parameters}
        found = {
            local[name].name: Quantity(value, abs(value) or 1.0, local[name].unit) for name, value in finding.starts[0].items() if local[name].free
        }
    else:
        found = quantities(child, effect)
    plausible = effect.traits.plausible
    believed = all(plausible[name][0] <= quantity.value <= plausible[name][1] for name, quantity in found.items() if name in plausible)
    p_value = float(chdtrc(finding.parameters, max(2.0 * gain, 0.0)))
    return Candidate(number, fitted.names, effect.name, float(gain), p_value, child is not None, believed, found, None, others)
