"""The tracing loop: fit, find what is missing, trace it, add it, refit, and judge on data that were not fitted."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ident.statistics.residuals import ResidualTest
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.quantities import quantities, records_of
from ident.tracing.diagnosis import Claim, Diagnosis, Verdict, Witness, silent
from ident.tracing.replication.between_records import FEWEST, RecordScatter, scatter_between_records
from ident.tracing.replication.partial import Partial, cross_validated
from ident.tracing.result import reported
from ident.tracing.selection.backward import backward_elimination, refined
from ident.tracing.selection.forward import defies, extended, first_round, forward_selection, hopeless
from ident.tracing.selection.search import Search
from ident.tracing.settings import TraceSettings
from ident.tracing.spikes.masks import cleaned_inputs, held_out_masks, measured_masks, mended_inputs, spike_claims, spike_masks
from ident.tracing.validation.held_out import HeldOut, held_out, with_held_out_change
from ident.tracing.validation.whiteness import whiteness
from ident.tracing.verdict import alternatives_of, best_by_held_out, judge, not_noise
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.errors import ModelError
from sim.record import Record


def diagnose(
    records: Sequence[Record],
    model: Model,
    candidates: Sequence[Traceable],
    guards: Sequence[Traceable],
    validation: Sequence[Record],
    settings: TraceSettings | None = None,
    progress: Callable[[str, float], None] = lambda text, share: None,
    witness: Witness = silent,
) -> Diagnosis:
    """Trace what a model lacks.

    Parameters
    ----------
    records : the data to fit. model : the declared model, with its biases; noise levels are estimated.
    candidates : effects that may be claimed. guards : terms that compete like effects but mean ``unexplained``.
    validation : data that are not fitted; empty means that errors are those of the fit.
    progress : told what is being done and how much of the work that is.
    witness : speaks of effects by other means than the model (``Flight``); asked only where a ranking hangs on it.

    Raises
    ------
    ModelError : a record without any output of the model, or a declared model that cannot be fitted at all.
    """
    settings = settings or TraceSettings()
    started = clock.perf_counter()
    seconds: dict[str, float] = {}
    outputs = [signal.name for signal in model.equations.outputs if any(signal.name in record.output_names for record in records)]

    def stage(name: str) -> None:
        seconds[name] = clock.perf_counter() - started - sum(seconds.values())

    progress("fitting the declared model", 0.0)
    search = Search(
        records, model, (*candidates, *guards), outputs, settings, measured_masks(records, outputs), progress, beside=validation, witness=witness
    )
    root = search.fit((), None)
    if root is None:
        raise ModelError("the declared model has no finite cost on these records", where=records[0].name, remedy="check units and starting values")
    search, root, input_claims = cleaned_inputs(search, root)
    search.masks = spike_masks(search, root)
    root = search.fit((), root) or root
    stage("declared model")
    seen, kept, out_before = _apart(root, validation, input_claims, outputs)
    first, partial = first_round(search, root), None
    asked = len(records) + len(validation) >= FEWEST and defies(root, first)
    if asked:
        # What replicates is looked for at once: a search that trusts noise to be white would only add effect upon effect.
        partial = _replicating(search, root, seen, kept, out_before)
    best = partial.fitted if partial is not None else refined(search, backward_elimination(search, forward_selection(search, root, first)))
    stage("search")
    masks, claims = spike_claims(search, best)
    if any(not np.array_equal(a, b) for a, b in zip(masks, search.masks, strict=True)):
        search.masks = masks
        best = search.fit(best.effects, best) or best
        search.keep(best, best.criterion)
        root = search.fit((), root) or root
        seen, kept, out_before = _apart(root, validation, input_claims, outputs)
        if partial is not None:
            partial = replace(partial, fitted=best, out=held_out(best, seen, kept))
    stage("spikes")
    progress("judging on data that were not fitted", 0.9)
    best, out_after = best_by_held_out(search, best, seen, kept)
    if validation:
        search.evidence = with_held_out_change(search.evidence, search.fitted_models, out_before, seen, kept)
    tests_before = tuple(whiteness(root.fit, "fitted"))
    tests_after = tuple(whiteness(best.fit, "fitted"))
    if out_after.informed is not None:
        tests_after += tuple(whiteness(out_after.informed, "held out"))
    spikes = [*input_claims, *claims]
    effects = [*spikes, *_claims(search, best, best.guards)]
    verdict, warnings = judge(search, root, best, effects, tests_after, out_before, out_after, settings)
    record_scatter = scatter_before = RecordScatter()
    if verdict is Verdict.UNEXPLAINED:
        effects = [_hint(effect) for effect in effects]
        if _no_better(out_before, out_after):
            # What does not help on data that were not fitted is not even a hint.
            best, out_after, effects = root, out_before, [_hint(spike) for spike in spikes]
        if not asked:
            partial = _replicating(search, root, seen, kept, out_before)
        if partial is not None:
            again = _judged_again(search, root, partial, [_hint(spike) for spike in spikes], seen, kept, out_before)
            verdict, best, out_after, effects, tests_after, warnings = again
        if verdict in (Verdict.UNEXPLAINED, Verdict.PARTIAL):
            # Where what remains is not noise, records differ by more than any one of them can tell.
            record_scatter = scatter_between_records(search, best, seen, kept)
            scatter_before = record_scatter if best is root else scatter_between_records(search, root, seen, kept)
    stage("held out")
    tests, outs, scatter_both = (tests_before, tests_after), (out_before, out_after), (scatter_before, record_scatter)
    return reported(search, root, best, verdict, effects, warnings, tests, outs, validation, outputs, seconds, scatter_both)


def _apart(
    root: FittedModel, validation: Sequence[Record], input_claims: Sequence[Claim], outputs: Sequence[str]
) -> tuple[list[Record], list[np.ndarray] | None, HeldOut]:
    """Data that are not fitted: their inputs mended, the samples that count, and the declared model there."""
    if not validation:
        return [], None, HeldOut(None, None)
    seen = [mended_inputs(record, [claim.name.partition(":")[2] for claim in input_claims]) for record in validation]
    kept = held_out_masks(held_out(root, validation, None, informed=False), seen, outputs)
    return seen, kept, held_out(root, validation, kept, informed=False)


def _replicating(search: Search, root: FittedModel, seen: Sequence[Record], kept: Sequence[np.ndarray] | None, before: HeldOut) -> Partial | None:
    """Effects that stand by themselves; what replicates on the whole and yet predicts the data held out no better is left unsaid."""
    partial = cross_validated(search, root, seen, kept)
    if partial is None:
        return None
    search.evidence += partial.evidence
    return None if _no_better(before, partial.out) else partial


def _judged_again(
    search: Search,
    root: FittedModel,
    partial: Partial,
    spikes: Sequence[Claim],
    validation: Sequence[Record],
    masks: Sequence[np.ndarray] | None,
    before: HeldOut,
) -> tuple[Verdict, FittedModel, HeldOut, list[Claim], tuple[ResidualTest, ...], list[str]]:
    """The verdict on effects that stand by themselves: with a further one, they may leave noise after all."""
    if not hopeless(search, partial.fitted):
        best, out = best_by_held_out(search, extended(search, root, partial.fitted), validation, masks)
        tests = tuple(whiteness(best.fit, "fitted")) + (tuple(whiteness(out.informed, "held out")) if out.informed is not None else ())
        claims = [*(_claimed(spike) for spike in spikes), *_claims(search, best, best.guards)]
        verdict, warnings = judge(search, root, best, claims, tests, before, out, search.settings)
        if verdict in (Verdict.TRACED, Verdict.AMBIGUOUS):
            return verdict, best, out, claims, tests, warnings
    tests = tuple(whiteness(partial.fitted.fit, "fitted"))
    return Verdict.PARTIAL, partial.fitted, partial.out, [*partial.claims, *spikes], tests, not_noise(tests, search.settings.white)


def _no_better(before: HeldOut, after: HeldOut) -> bool:
    """Whether a free simulation of held-out data is no better, in likelihood, than that of the declared model."""
    return before.frozen is not None and after.frozen is not None and after.frozen.cost >= before.frozen.cost


def _claims(search: Search, best: FittedModel, guarded: Sequence[str]) -> list[Claim]:
    others = alternatives_of(search, best)
    return [
        Claim(effect.name, quantities(best, effect), others.get(effect.name, ()), not guarded, records_of(best, effect), effect.explanation)
        for effect in best.effects
        if not effect.traits.guard
    ]


def _hint(claim: Claim) -> Claim:
    return replace(claim, claimed=False)


def _claimed(claim: Claim) -> Claim:
    return replace(claim, claimed=True)
