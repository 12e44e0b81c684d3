"""One step of cross-validation: everything that promises something is tried beside a set, and the best of it is chosen or none."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.statistics.coloured_covariance import effective_share
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record
from ident.tracing.equivalents import guard_is_likelier
from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.comparison import CrossValidatedEffect, CrossValidation, choose
from ident.tracing.replication.weighing import left_out, weigh
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding, screen
from ident.tracing.selection.expansion import only_beside_another
from ident.whole_record.gauss_newton import Fit
from sim.declaration.proposal import Traceable


@dataclass(frozen=True, eq=False)
class Tried:
    """All that was tried at a fitted model, and what was chosen; ``before`` the fitted model's own predictions by record."""

    fitted: FittedModel
    before: Mapping[int, Fit]
    findings: Sequence[Finding]
    results: Sequence[CrossValidation]
    chosen: CrossValidatedEffect | None


def weigh_all(
    flight: Flight, candidates: Sequence[Traceable], fitted: FittedModel, searched: tuple[FittedModel, Collection[FittedModel]] | None = None
) -> Tried | None:
    """One step. ``searched`` : the same set as a search fitted it, and what it fitted beyond."""
    before = left_out(flight, fitted)
    if before is None:
        return None
    usable = [candidate for candidate in candidates if not only_beside_another(candidate)]
    findings = screen(fitted, usable, search_context(fitted))
    findings = _promising(fitted, _in_full(findings, *searched) if searched is not None else findings)
    guards = [finding for finding in findings if finding.effect.traits.guard]
    tried = [finding for finding in findings if finding not in guards][: thresholds.CANDIDATES_FITTED] + guards[: thresholds.GUARDS_FITTED]
    results = [item for item in (weigh(flight, fitted, finding, before) for finding in tried) if item is not None]
    chosen = choose(results, flight.witness)

    def fit(effect: Traceable, start: Mapping[str, float]) -> FittedModel | None:
        return flight.fit((*fitted.effects, effect), range(len(flight.records)), fitted.values, start)

    if chosen is not None and guard_is_likelier(fitted, chosen.best.effect, chosen.best.fitted, candidates, fit):
        chosen = None
    return Tried(fitted, before, findings, results, chosen)


def _in_full(findings: Sequence[Finding], base: FittedModel, known: Collection[FittedModel]) -> list[Finding]:
    """Findings at ``base``, in the place of a projection what a fit of the same effect brings, where that is more; the largest first."""
    fits = {child.names[-1]: child for child in known if child.names and child.names[:-1] == base.names}
    out = []
    for finding in findings:
        child = fits.get(finding.effect.name)
        brought = base.fit.cost - child.fit.cost if child is not None else 0.0
        if child is not None and brought > finding.gain and not belongs_to_record(finding.effect):
            start = {name: child.values.shared[name] for name in finding.starts[0] if name in child.values.shared}
            finding = replace(finding, gain=brought, starts=({**finding.starts[0], **start}, *finding.starts), gains=(brought, *finding.gains))
        out.append(finding)
    return sorted(out, key=lambda finding: -finding.gain)


def _promising(fitted: FittedModel, findings: Sequence[Finding]) -> list[Finding]:
    """Findings whose gain, in effective samples, pays for their parameters; the largest first."""
    share = _effective(fitted)
    twins = {twin for effect in fitted.effects for twin in (*effect.traits.twins, *effect.traits.never_beside)}
    samples = share * float(fitted.fit.counts.sum())
    findings = [finding for finding in findings if finding.effect.name not in twins]
    most = findings[0].gain if findings else 0.0
    return [
        finding
        for finding in findings
        if finding.gain > thresholds.HOPELESS_IN_REPLICATION * most and 2.0 * share * finding.gain > finding.parameters * np.log(max(samples, np.e))
    ]


def _effective(fitted: FittedModel) -> float:
    return effective_share(fitted.fit.residuals, [problem.valid for problem in fitted.fit.layout.problems])
