"""The tracing loop: fit, find what is missing, trace it, add it, refit, and judge on data that were not fitted."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import belongs_to_record
from ident.tracing.candidate_model.problem import TraceProblem, untold
from ident.tracing.claims_beside_noise import helpful, replicating, what_replicates, without_unlikely
from ident.tracing.compared_sets import weighed
from ident.tracing.diagnosis import Diagnosis, Verdict
from ident.tracing.found import Declared, Found
from ident.tracing.ranking.near_sets import believable_choice
from ident.tracing.replication.between_records import RecordScatter, scatter_between_records
from ident.tracing.replication.partial import on_other_samples
from ident.tracing.result import Before, Outcome, reported
from ident.tracing.selection.background import with_known_background
from ident.tracing.selection.backward import backward_elimination, refined
from ident.tracing.selection.criterion import is_white
from ident.tracing.selection.forward import defies, first_round, forward_selection
from ident.tracing.selection.general_forms import alone, for_pairs, leaving_noise, with_general_form
from ident.tracing.selection.ledger import Ledger, fit
from ident.tracing.selection.refitting import refitted
from ident.tracing.settings import TraceSettings
from ident.tracing.spikes.masks import cleaned_inputs, held_out_masks, measured_masks, mended_inputs, spike_claims, spike_masks
from ident.tracing.validation.held_out import HeldOut, HeldOutData, held_out, with_held_out_change
from ident.tracing.verdict import Judgement, judge, residual_tests
from ident.tracing.witness import Witness, silent
from ident.whole_record.failed_fit import failed_fit
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
    progress: Callable[[str, float], None] = untold,
    witness: Witness = silent,
    outlook: Callable[[Diagnosis], None] | None = None,
) -> Diagnosis:
    """Trace what a model lacks.

    Parameters
    ----------
    records : the data to fit. model : the declared model, with its biases; noise levels are estimated.
    candidates : effects that may be claimed. guards : terms that compete like effects but mean ``unexplained``.
    validation : data that are not fitted; empty means that errors are those of the fit. They take part in choosing effects where a single
        record is fitted. Else they decide the verdict, and what is told beside it (hints, the inflation of sigmas, the range of a curve).
    progress : told what is being done and how much of the work that is.
    witness : says by other means than the model whether an effect is there; asked only where a ranking depends on it.
    outlook : told before the search, where the declared model leaves white noise, what there is to report if nothing is found.

    Raises
    ------
    ModelError : a record without any output of the model, or a declared model that cannot be fitted at all.
    """
    watch = Stopwatch()
    outputs = [signal.name for signal in model.equations.outputs if any(signal.name in record.output_names for record in records)]
    masks = measured_masks(records, outputs)
    named, general = (tuple(c for c in (*candidates, *guards) if c.traits.general is wanted) for wanted in (False, True))
    problem = TraceProblem(records, masks, model, named, outputs, settings or TraceSettings(), validation, witness, progress, general)
    declared = fit_declared(problem)
    watch.stage("declared model")
    held = held_out_data(declared, validation)
    if outlook is not None and is_white(declared.root):
        outlook(if_nothing_is_found(declared, held, validation))
    found = search(declared, held)
    watch.stage("search")
    found = with_final_masks(found)
    watch.stage("spikes")
    problem.progress("judging on data that were not fitted", 0.9)
    ledger, choice = believable_choice(found.ledger, found.best, found.held)
    if validation:
        ledger = replace(ledger, evidence=tuple(with_held_out_change(ledger.evidence, ledger.models, found.held)))
    choice = weighed(ledger, choice, found.held)
    judgement = judge(ledger.problem, found.root, choice, found.spikes, found.held)
    if judgement.verdict is Verdict.UNEXPLAINED:
        ledger, judgement = what_replicates(replace(found, ledger=ledger), judgement)
    judgement = without_unlikely(ledger.problem, judgement)
    scatter = record_scatter(ledger.problem, found, judgement)
    watch.stage("held out")
    before = Before(found.root, residual_tests(found.root, HeldOut(None, None), found.held).all, scatter[0])
    return reported(ledger, before, Outcome(judgement, scatter[1]), found.held, validation, watch.seconds)


@dataclass(eq=False)
class Stopwatch:
    """Time spent by stage, s."""

    started: float = field(default_factory=clock.perf_counter)
    seconds: dict[str, float] = field(default_factory=dict)

    def stage(self, name: str) -> None:
        """What passed since the last stage is this one's."""
        self.seconds[name] = clock.perf_counter() - self.started - sum(self.seconds.values())


def fit_declared(problem: TraceProblem) -> Declared:
    """Fit the declared model, mend recorded inputs, set provisional spikes aside.

    Raises
    ------
    ModelError : no finite cost, or a fit that has failed (``ident.whole_record.failed_fit``).
    """
    problem.progress("fitting the declared model", 0.0)
    ledger, root = fit(Ledger(problem), (), None)
    if root is None:
        raise ModelError(
            "the declared model has no finite cost on these records", where=problem.records[0].name, remedy="check units and starting values"
        )
    values = {item.name: item.value for item in problem.model.parameters if item.free}
    why, remedy = failed_fit(root.fit, values)
    if why:  # a second attempt from where the first one ended
        ledger, further = fit(ledger, (), root)
        root = further or root
        why, remedy = failed_fit(root.fit, values)
    if why:
        names = ", ".join(dict.fromkeys(record.name for record in problem.records))
        raise ModelError(f"the fit of the declared model has failed: {why}", where=names, remedy=remedy)
    problem, root, spikes, steps = cleaned_inputs(problem, root)
    masked = Ledger(problem.with_masks(spike_masks(problem, root)), steps=tuple(steps), spent=ledger.spent)
    masked, again = fit(masked, (), root)
    if again is None:
        return Declared(replace(masked, problem=problem), root, tuple(spikes))
    return Declared(masked, again, tuple(spikes))


def held_out_data(declared: Declared, validation: Sequence[Record]) -> HeldOutData:
    """Data that are not fitted: their inputs mended, the samples that count, and the declared model there."""
    if not validation:
        return HeldOutData()
    records = [mended_inputs(declared.ledger.problem, record, declared.spikes) for record in validation]
    first = held_out(declared.root, validation, None, informed=False)
    masks = held_out_masks(first, records, declared.ledger.problem.outputs)
    before = held_out(declared.root, records, masks, informed=False)
    return HeldOutData(records, masks, before, choosing=len(declared.ledger.problem.records) == 1)


def if_nothing_is_found(declared: Declared, held: HeldOutData, validation: Sequence[Record]) -> Diagnosis:
    """What there is to report of the declared model alone, called consistent without a search; tests of the fitted records alone."""
    tests, scatter = residual_tests(declared.root, HeldOut(None, None), held), RecordScatter()
    judgement = Judgement(Verdict.CONSISTENT, declared.root, held.declared, declared.spikes, tests, ())
    return reported(declared.ledger, Before(declared.root, tests.all, scatter), Outcome(judgement, scatter), held, validation, {})


def search(declared: Declared, held: HeldOutData) -> Found:
    """Forward selection and backward elimination; cross-validation before them where no single effect comes anywhere near noise."""
    root = declared.root
    if not is_white(root):
        declared.ledger.problem.witness.prepare()
    ledger, first = first_round(declared.ledger, root)
    base = root if first and not first[0].background else with_known_background(ledger, root)
    # What all records share has to be cross-validated like any other effect: only what belongs to each is taken as it is.
    base = base if all(belongs_to_record(effect) for effect in base.background) else root
    several = len(ledger.problem.records) + len(held.records) >= thresholds.FEWEST_RECORDS
    asked, partial = several and defies(base, first), None
    general = alone(ledger, base, first)
    if asked and not leaving_noise(ledger, general.fitted):
        # A search that trusts noise to be white would only add effect upon effect.
        ledger, partial = replicating(ledger, base, held)
    if partial is None:
        problem = ledger.problem
        ledger, best = forward_selection(for_pairs(ledger, general), base, first)
        ledger, best = with_general_form(replace(ledger, problem=problem), base, best, general)
        ledger, best = backward_elimination(ledger, best)
        ledger, best = refined(ledger, best)
    return Found(ledger, root, base, best if partial is None else partial.fitted, held, partial, asked, declared.spikes)


def with_final_masks(found: Found) -> Found:
    """The final spikes with their claims; where they differ from the provisional ones, all sets of the search fitted anew without them."""
    problem = found.ledger.problem
    masks, claims = spike_claims(problem, found.best)
    told = replace(found, spikes=(*found.spikes, *claims))
    if all(np.array_equal(a, b) for a, b in zip(masks, problem.masks, strict=True)):
        return told
    fresh = refitted(found.ledger, masks, found.best)
    if fresh is None:
        # Without them nothing can be fitted: they stay in every fit, and are not claimed.
        return found
    root, best, partial = fresh.models[frozenset()], fresh.known(found.best), None
    base = fresh.models.get(frozenset(found.base.names), root)
    held = held_out_data(Declared(fresh, root, told.spikes), problem.predicted)
    if found.partial is not None:
        changed = sum(np.count_nonzero(a != b) for a, b in zip(masks, problem.masks, strict=True)) / sum(mask.size for mask in masks)
        few = changed < thresholds.FEW_OTHER_SAMPLES
        fresh, partial = helpful(held, *on_other_samples(fresh, base, held, found.partial.validated)) if few else replicating(fresh, base, held)
    return replace(told, ledger=fresh, root=root, base=base, best=best if partial is None else partial.fitted, held=held, partial=partial)


def record_scatter(problem: TraceProblem, found: Found, judgement: Judgement) -> tuple[RecordScatter, RecordScatter]:
    """By how much records differ, before and after: asked where what remains is not noise, and one record cannot tell."""
    if judgement.verdict not in (Verdict.UNEXPLAINED, Verdict.PARTIAL):
        return RecordScatter(), RecordScatter()
    after = scatter_between_records(problem, judgement.best, found.held)
    before = after if judgement.best is found.root else scatter_between_records(problem, found.root, found.held)
    return before, after
