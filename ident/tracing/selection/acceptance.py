"""Children of a fitted model: which of them are kept, as what, and what is told of all that were looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.quantities import implausible, quantities, stands_out_somewhere
from ident.tracing.diagnosis import Candidate, Quantity, Step
from ident.tracing.screening.score_test import Finding, collinear
from ident.tracing.selection.criterion import gain
from ident.tracing.selection.event_times import placed_better
from ident.tracing.selection.ledger import Ledger, fit
from ident.tracing.selection.plain_forms import child_in_plain_form
from sim.declaration.effect import full_name
from sim.declaration.proposal import Traceable


def accepted(
    ledger: Ledger, fitted: FittedModel, number: int, findings: Sequence[Finding], children: Mapping[int, FittedModel]
) -> tuple[Ledger, list[FittedModel]]:
    """Keep evidence on all findings, and the children that lower the score enough."""
    kept: list[FittedModel] = []
    most = max((fitted.fit.cost - child.fit.cost for child in children.values()), default=0.0)
    for place, finding in enumerate(findings):
        child = children.get(place)
        others = tuple(f.effect.name for f in findings if f is not finding and collinear(f, finding) > thresholds.COLLINEAR)
        ledger = ledger.told(evidence=[evidence_of(number, fitted, finding, child, others)])
        # A child before may have shown a better optimum of the set without it: its score is lowered once, not by every child that finds it.
        parent = ledger.known(fitted)
        if child is None or gain(parent, child, ledger.problem.settings.accept) <= ledger.problem.settings.accept:
            continue
        if not stands_out_somewhere(child, finding.effect):
            # What it brought is a better optimum of the set without it.
            ledger, better = fit(ledger, parent.effects, child)
            if better is not None and better.fit.cost < parent.fit.cost:
                ledger = ledger.kept(better, ledger.score(parent) - 2.0 * (parent.fit.cost - better.fit.cost))
            continue
        ledger, taken = _taken(ledger, parent, child, finding.effect, exactly=fitted.fit.cost - child.fit.cost > thresholds.RIVAL * most)
        if taken is not None:
            kept.append(taken)
    return ledger, kept


def _taken(ledger: Ledger, fitted: FittedModel, child: FittedModel, effect: Traceable, *, exactly: bool) -> tuple[Ledger, FittedModel | None]:
    """The child as it is kept, with the step that says so; None where it brings too little after all.

    ``exactly`` : whether to know what it brings. One that brings less than half of another will not be the best of its size.
    """
    accept, parent = ledger.problem.settings.accept, fitted
    if exactly:
        ledger, child = placed_better(ledger, child, effect)
        ledger, child = child_in_plain_form(ledger, fitted, child)
        ledger, parent = _from_child(ledger, fitted, child)
    lowered = gain(parent, child, accept)
    if lowered <= accept:
        return ledger, None
    ledger = ledger.kept(child, ledger.score(parent) - lowered)
    sentence = f"{effect.name} lowers the criterion by {lowered:.1f}"
    ledger = ledger.told(Step(child.names, ledger.score(child), child.fit.log_likelihood, sentence))
    return ledger, ledger.known(child)


def _from_child(ledger: Ledger, fitted: FittedModel, child: FittedModel) -> tuple[Ledger, FittedModel]:
    """The parent, fitted again from the child's values where it has effects: part of a gain may be a better optimum of its own."""
    if not fitted.effects or has_process_noise(fitted.system):
        return ledger, fitted
    ledger, again = fit(ledger, fitted.effects, child, rough=True)
    if again is None or again.fit.cost >= fitted.fit.cost - thresholds.BETTER_PLACE:
        return ledger, fitted
    return ledger.kept(again, ledger.score(fitted) - 2.0 * (fitted.fit.cost - again.fit.cost)), again


def evidence_of(number: int, fitted: FittedModel, finding: Finding, child: FittedModel | None, others: tuple[str, ...]) -> Candidate:
    """What is kept of a finding of round ``number`` at a fitted model; ``child`` is the fit with it, ``others`` names of what looks alike."""
    from scipy.special import chdtrc

    effect = finding.effect
    brought = finding.gain if child is None else fitted.fit.cost - child.fit.cost
    if child is None:
        local = {full_name(effect, item.name): item for item in effect.parameters}
        found = {
            local[name].name: Quantity(value, abs(value) or 1.0, local[name].unit) for name, value in finding.starts[0].items() if local[name].free
        }
    else:
        found = quantities(child, effect)
    p_value = float(chdtrc(finding.parameters, max(2.0 * brought, 0.0)))
    believed = not implausible(effect, found, slack=0.0)
    return Candidate(number, fitted.names, effect.name, float(brought), p_value, child is not None, believed, found, None, others)
