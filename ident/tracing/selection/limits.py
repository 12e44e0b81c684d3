"""Limits of an input, fitted from the declared values too.

A fit without the limit bends its derivatives to what the limit took away. From there slopes lead to a limit that hardly acts, and what is
left is taken for a further effect; the declared derivatives, however rough, lie on the right side.
"""

from __future__ import annotations

from collections.abc import Sequence

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, free_names
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.ledger import Ledger, fit
from sim.declaration.effect import Regularity, Station, full_name
from sim.declaration.proposal import Traceable


def is_limit(effect: Traceable) -> bool:
    """Whether an effect leaves inputs as they are until they are large or fast enough: no slope leads from its absence to it."""
    return effect.station is Station.INPUT_PATH and effect.regularity is Regularity.INACTIVE


def limits_from_declared_values(
    ledger: Ledger, fitted: FittedModel, findings: Sequence[Finding], children: dict[int, FittedModel], *, rivals: bool = False
) -> tuple[Ledger, dict[int, FittedModel]]:
    """The children of a set, those with a limit from the declared values and each of its probes where that is better.

    Only beside what any record may have; an effect that was added before has values of its own to start from. Ends with the first that
    leaves noise. ``rivals`` : only limits that brought half as much as the best, where something leaves noise already: a curve of many shapes, or
    an event, does nearly what a limit does, and has to be better than the limit at its best.
    """
    found = dict(children)
    if fitted.foreground or is_white(fitted) or has_process_noise(fitted.system):
        return ledger, found
    most = max((fitted.fit.cost - child.fit.cost for child in children.values()), default=0.0)
    tried = [
        place
        for place, finding in enumerate(findings)
        if is_limit(finding.effect) and (not rivals or (place in children and fitted.fit.cost - children[place].fit.cost >= thresholds.RIVAL * most))
    ]
    if not tried:
        return ledger, found
    context = search_context(fitted, ledger.problem.predicted)
    for place in tried:
        finding = findings[place]
        for probe in finding.effect.probes(context):
            if ledger.exhausted:
                return ledger, found
            start = {full_name(finding.effect, name): value for name, value in probe.values.items()}
            ledger, child = fit(ledger, (*fitted.effects, finding.effect), None, start, rough=True)
            if child is None or child.fit.cost >= min(fitted.fit.cost, found[place].fit.cost if place in found else fitted.fit.cost):
                continue
            found[place] = child
            if is_white(child):
                return ledger, found
    return ledger, found


def limit_in_place(
    ledger: Ledger, best: FittedModel, effect: Traceable, limit: Traceable, child: FittedModel | None
) -> tuple[Ledger, FittedModel | None]:
    """The best of ``child`` and fits of ``best`` with a limit in the place of one effect, from the declared derivatives and the limit's probes.

    The other effects begin where they stand: what stood for the limit has bent the derivatives, not them.
    """
    if has_process_noise(best.system):
        return ledger, child
    rest = tuple(other for other in best.effects if other is not effect)
    names, values = {name for other in rest for name in free_names(other)}, best.values
    beside = {name: value for known in (values.own[0], values.shared) for name, value in known.items() if name in names}
    for probe in limit.probes(search_context(best, ledger.problem.predicted)):
        if ledger.exhausted:
            break
        start = {full_name(limit, name): value for name, value in probe.values.items()}
        ledger, again = fit(ledger, (*rest, limit), None, beside | start, rough=True)
        if again is not None and (child is None or again.fit.cost < child.fit.cost):
            child = again
    return ledger, child
