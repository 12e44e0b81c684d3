"""One round of cross-validation: everything that promises something is tried beside a set, and the best of it is chosen or none."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.statistics.coloured_covariance import effective_share
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, acts_all_along, never_together, shared_start
from ident.tracing.equivalents import guard_is_likelier
from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.comparison import CrossValidatedEffect, CrossValidation, choose
from ident.tracing.replication.weighing import judged, left_out, try_out
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding, screen
from ident.tracing.selection.expansion import only_beside_another
from ident.tracing.selection.ledger import form_of
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
    """One round. ``searched`` : the same set as a search fitted it, and what it fitted beyond; None where the set predicts no record."""
    before = left_out(flight, fitted)
    if before is None:
        return None
    usable = [candidate for candidate in candidates if not only_beside_another(candidate)]
    screened = screen(fitted, usable, search_context(fitted))
    findings = _promising(fitted, screened)
    guards = [finding for finding in findings if finding.effect.traits.guard]
    tried = [finding for finding in findings if finding not in guards][: thresholds.CANDIDATES_FITTED]
    if searched is not None:
        tried = _with_fitted(fitted, screened, tried, *searched)
    tried += guards[: thresholds.GUARDS_FITTED]
    trials = [trial for trial in (try_out(flight, fitted, finding, before) for finding in tried) if trial is not None]
    # Judged when all are fitted: a witness makes its own computation meanwhile.
    results = [judged(flight, trial) for trial in trials]
    chosen = choose(results, flight.witness)

    def fit(effect: Traceable, start: Mapping[str, float]) -> FittedModel | None:
        return flight.beside(fitted, effect, fitted.values, start)

    if chosen is not None and guard_is_likelier(fitted, chosen.best.effect, chosen.best.fitted, candidates, fit):
        chosen = None
    return Tried(fitted, before, findings, results, chosen)


def _with_fitted(
    fitted: FittedModel, screened: Sequence[Finding], tried: Sequence[Finding], base: FittedModel, known: Collection[FittedModel]
) -> list[Finding]:
    """What is tried, and the best of what a search found to bring more in full than the least of these: from where it found it.

    ``base`` is the search's fit of the same set, ``known`` has one effect more.
    """
    least = tried[-1].gain if tried else 0.0
    here = {form_of(f.effect): f for f in screened if not any(never_together(effect, f.effect) for effect in fitted.effects)}
    out, further = {form_of(finding.effect): finding for finding in tried}, []
    for child in known:
        added = [effect for effect in child.effects if effect.name not in base.names]
        if len(added) != 1 or len(child.effects) != len(base.effects) + 1 or not acts_all_along(added[0]):
            continue
        form, brought = form_of(added[0]), base.fit.cost - child.fit.cost
        if form not in here:  # a freer form than those that are candidates begins as the likeliest of its name
            form = max((each for each in here if each[0] == added[0].name), key=lambda each: here[each].gain, default=form)
        if form in here and brought > here[form].gain:
            finding = replace(here[form], starts=(shared_start(child, added[0]), *here[form].starts))
            if form in out:
                out[form] = finding
            elif brought > least:
                further.append((brought, finding))
    best = sorted(further, key=lambda item: -item[0])[: thresholds.FOUND_IN_FULL]
    return [*out.values(), *(finding for _, finding in best)]


def _promising(fitted: FittedModel, findings: Sequence[Finding]) -> list[Finding]:
    """Findings whose projected gain, in effective samples, pays for their parameters; the largest first."""
    share = _effective(fitted)
    samples = share * float(fitted.fit.counts.sum())
    findings = [finding for finding in findings if not any(never_together(effect, finding.effect) for effect in fitted.effects)]
    most = findings[0].gain if findings else 0.0
    return [
        finding
        for finding in findings
        if finding.gain > thresholds.HOPELESS_IN_REPLICATION * most and 2.0 * share * finding.gain > finding.parameters * np.log(max(samples, math.e))
    ]


def _effective(fitted: FittedModel) -> float:
    return effective_share(fitted.fit.residuals, [problem.valid for problem in fitted.fit.layout.problems])
