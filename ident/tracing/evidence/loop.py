"""The tracing loop by evidence: fit, search, decide, and report on data that were not fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.problem import TraceProblem, untold
from ident.tracing.candidate_model.quantities import quantities, records_of
from ident.tracing.diagnosis import (
    Caution,
    Claim,
    Concern,
    Diagnosis,
    Requirement,
    Trained,
    Verdict,
)
from ident.tracing.evidence.decision import NOISE, Decision, Named, decided
from ident.tracing.loop import Stopwatch, fit_declared, held_out_data, if_nothing_is_found
from ident.tracing.replication.between_records import RecordScatter
from ident.tracing.result import Before, Outcome, reported
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.ledger import Ledger
from ident.tracing.settings import TraceSettings
from ident.tracing.spikes.masks import measured_masks, spike_claims
from ident.tracing.validation.held_out import HeldOut, HeldOutData, predicted_by
from ident.tracing.verdict import Judgement, not_noise, residual_tests
from ident.tracing.witness import Witness, silent
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.record import Record

LIKELY = 0.05  # probability from which an alternative is named
ALTERNATIVES = 2  # fixed by the format of a diagnosis


def diagnose_by_evidence(
    records: Sequence[Record],
    model: Model,
    candidates: Sequence[Traceable],
    guards: Sequence[Traceable],
    validation: Sequence[Record],
    settings: TraceSettings | None = None,
    progress: Callable[[str, float], None] = untold,
    witness: Witness = silent,
    outlook: Callable[[Diagnosis], None] | None = None,
    *,
    discrepancy: Traceable | None = None,
) -> Diagnosis:
    """Trace what a model lacks.

    Parameters
    ----------
    records : the data to fit. model : the declared model, with its biases.
    candidates : effects that may be named. guards : terms that compete and mean ``unexplained``.
    validation : data that are not fitted; with none, errors are those of the fit.
    progress : told what is being done and how much of the work that is. witness : not asked yet.
    outlook : told before the search what there is to report if nothing is found, where the declared
        model leaves white noise.
    discrepancy : what stands for the errors of the model's forces where no set leaves noise.

    Raises
    ------
    ModelError : a record without any output of the model, or a model that cannot be fitted at all.
    """
    watch = Stopwatch()
    outputs = [
        signal.name
        for signal in model.equations.outputs
        if any(signal.name in record.output_names for record in records)
    ]
    problem = TraceProblem(
        records,
        measured_masks(records, outputs),
        model,
        (*candidates, *guards),
        outputs,
        settings or TraceSettings(),
        validation,
        witness,
        progress,
    )
    declared = fit_declared(problem)
    watch.stage("declared model")
    held = held_out_data(declared, validation)
    if outlook is not None and is_white(declared.root):
        outlook(if_nothing_is_found(declared, held, validation))
    problem, root = declared.ledger.problem, declared.root
    found = decided(problem, discrepancy)
    watch.stage("search")
    masks, spikes = spike_claims(problem, found.best)
    if any(not np.array_equal(a, b) for a, b in zip(masks, problem.masks, strict=True)):
        problem = problem.with_masks(masks)
        root = problem.fit((), root) or root
        found = decided(problem, discrepancy)
    watch.stage("spikes")
    progress("judging on data that were not fitted", 0.9)
    best = problem.fit(found.best.effects, found.best) or found.best
    out = predicted_by(best, held)
    judgement = _judged(problem, replace(found, best=best), out, held, (*declared.spikes, *spikes))
    watch.stage("held out")
    before = Before(root, residual_tests(root, HeldOut(None, None), held).all, RecordScatter())
    ledger = Ledger(problem, {frozenset(): root, frozenset(best.names): best}, {})
    told = reported(
        ledger, before, Outcome(judgement, RecordScatter()), held, validation, watch.seconds
    )
    return replace(told, trained_after=_without(told, discrepancy))


def _without(told: Diagnosis, discrepancy: Traceable | None) -> Trained | None:
    """What another record is predicted with: a discrepancy adds nothing to a free simulation."""
    trained = told.trained_after
    if trained is None or discrepancy is None:
        return trained
    kept = tuple(effect for effect in trained.effects if effect.name != discrepancy.name)
    return replace(trained, effects=kept)


def _judged(
    problem: TraceProblem,
    found: Decision,
    out: HeldOut,
    held: HeldOutData,
    spikes: Sequence[Claim],
) -> Judgement:
    """The decision with its residual tests, claims and cautions."""
    best, verdict = found.best, found.verdict
    tests = residual_tests(best, out, held)
    claims = [_claim(best, each, claimed=True) for each in found.named]
    claims += [_claim(best, each, claimed=False) for each in found.hints]
    cautions: list[Caution] = []
    guards = sorted(problem.guards & {each.name for each in found.hints})
    claims = [claim for claim in claims if claim.name not in problem.guards]
    if guards:
        sentence = (
            f"what is missing behaves like {', '.join(guards)}, which is no effect of the library"
        )
        cautions.append(Caution(Concern.GUARD, sentence))
    left = not_noise(tests.all, NOISE)
    if verdict in (Verdict.TRACED, Verdict.AMBIGUOUS, Verdict.CONSISTENT) and left:
        if found.named and verdict is not Verdict.CONSISTENT:
            verdict = Verdict.PARTIAL
        cautions += left
    elif verdict in (Verdict.UNEXPLAINED, Verdict.PARTIAL):
        cautions += left
    worse = _does_not_help(found, out, held)
    if worse is not None and verdict in (Verdict.TRACED, Verdict.PARTIAL, Verdict.AMBIGUOUS):
        verdict, claims = Verdict.UNEXPLAINED, [replace(claim, claimed=False) for claim in claims]
        cautions.append(worse)
    if verdict is Verdict.CONSISTENT and spikes:
        verdict = Verdict.TRACED
    return Judgement(verdict, best, out, (*spikes, *claims), tests, tuple(cautions))


def _does_not_help(found: Decision, out: HeldOut, held: HeldOutData) -> Caution | None:
    """The caution where what is named does not lower the error on data that were not fitted."""
    before, after = held.declared.frozen, out.frozen
    if not found.named or before is None:
        return None
    random = has_process_noise(found.best.system)
    if not found.best.foreground or (random and found.verdict is Verdict.TRACED):
        return None
    raised = before.cost - after.cost if after is not None else -np.inf
    if raised > 0.0:
        return None
    asked = "the rise of the log likelihood of data that were not fitted"
    requirement = Requirement(asked, float(raised), 0.0, at_least=True)
    sentence = "the effects found do not lower the error on data that were not fitted"
    finite = requirement if np.isfinite(raised) else None
    return Caution(Concern.NO_IMPROVEMENT, sentence, requirement=finite)


def _claim(best: FittedModel, named: Named, *, claimed: bool) -> Claim:
    (effect,) = [each for each in best.effects if each.name == named.name]
    likely = sorted(named.alternatives.items(), key=lambda item: -item[1])
    others = [name for name, share in likely if share > LIKELY][:ALTERNATIVES]
    told = {named.name: named.probability, **{name: named.alternatives[name] for name in others}}
    return Claim(
        named.name,
        quantities(best, effect),
        tuple(others),
        claimed,
        records_of(best, effect),
        effect.explanation,
        probability=told if claimed else {},
    )
