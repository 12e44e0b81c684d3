"""The tracing loop: fit, find what is missing, trace it, add it, refit, and judge on data that were not fitted."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from ident.estimate import Estimate
from ident.filter_error import filter_error_estimate, noise_levels
from ident.fit import Fit
from ident.modal import modal_estimate
from ident.output_error import estimate_of
from ident.process_noise import is_forced
from ident.residuals import ResidualTest
from ident.tracing.acceptance import HeldOut, error_figures, held_out, prediction, whiteness, with_held_out_change
from ident.tracing.between import Between, between_records
from ident.tracing.cleaning import cleaned_inputs, held_out_masks, measured_masks, mended_inputs, spike_claims, spike_masks
from ident.tracing.diagnosis import Claim, Diagnosis, FittedRecord, Prediction, Quantity, Verdict
from ident.tracing.expansion import quantities, records_of
from ident.tracing.form import form_spread
from ident.tracing.node import Node, guards_among
from ident.tracing.outliers import final_spikes
from ident.tracing.partial import Partial, stand_by_themselves
from ident.tracing.search import extended, grow, look_back, refined
from ident.tracing.search_state import Search
from ident.tracing.settings import TraceSettings
from ident.tracing.verdict import alternatives_of, best_by_held_out, judge, not_noise
from sim.effect import Effect
from sim.errors import ModelError
from sim.model import Model
from sim.record import Record

_NONE: Mapping[str, float] = MappingProxyType({})


def diagnose(
    records: Sequence[Record],
    model: Model,
    candidates: Sequence[Effect],
    guards: Sequence[Effect],
    validation: Sequence[Record],
    settings: TraceSettings | None = None,
    progress: Callable[[str, float], None] = lambda text, share: None,
) -> Diagnosis:
    """Trace what a model lacks.

    Parameters
    ----------
    records : the data to fit. model : the declared model, with its biases; noise levels are estimated.
    candidates : effects that may be claimed. guards : terms that compete like effects but mean ``unexplained``.
    validation : data that are not fitted; empty means that errors are those of the fit.
    progress : told what is being done and how much of the work that is.

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
    search = Search(records, model, (*candidates, *guards), outputs, settings, measured_masks(records, outputs), progress, beside=validation)
    root = search.fit((), None)
    if root is None:
        raise ModelError("the declared model has no finite cost on these records", where=records[0].name, remedy="check units and starting values")
    search, root, input_claims = cleaned_inputs(search, root)
    search.masks = spike_masks(search, root)
    root = search.fit((), root) or root
    stage("declared model")
    best = refined(search, look_back(search, grow(search, root)))
    stage("search")
    masks, claims = spike_claims(search, best)
    if any(not np.array_equal(a, b) for a, b in zip(masks, search.masks, strict=True)):
        search.masks = masks
        best = search.fit(best.effects, best) or best
        search.keep(best, best.criterion)
        root = search.fit((), root) or root
    stage("spikes")
    progress("judging on data that were not fitted", 0.9)
    out_before, seen, kept = HeldOut(None, None), list(validation), None
    if validation:
        seen = [mended_inputs(record, [claim.name for claim in input_claims]) for record in validation]
        kept = held_out_masks(held_out(root, validation, None, informed=False), seen, outputs)
        out_before = held_out(root, validation, kept, informed=False)
    best, out_after = best_by_held_out(search, best, seen, kept)
    if validation:
        search.evidence = with_held_out_change(search.evidence, search.nodes, out_before, seen, kept)
    tests_before = tuple(whiteness(root.fit, "fitted"))
    tests_after = tuple(whiteness(best.fit, "fitted"))
    if out_after.informed is not None:
        tests_after += tuple(whiteness(out_after.informed, "held out"))
    guarded = guards_among(best.names)
    effects = [*input_claims, *claims, *_claims(search, best, guarded)]
    verdict, warnings = judge(search, root, best, effects, tests_after, out_before, out_after, settings)
    between = Between()
    if verdict is Verdict.UNEXPLAINED:
        effects = [_hint(effect) for effect in effects]
        if _no_better(out_before, out_after):
            # What does not help on data that were not fitted is not even a hint.
            best, out_after, effects = root, out_before, [effect for effect in effects if effect.name.startswith("sensor-spikes")]
        partial = stand_by_themselves(search, root, seen, kept)
        if partial is not None and _no_better(out_before, partial.out):
            # What replicates on the whole and yet predicts the data held out no better is left unsaid.
            search.evidence, partial = [*search.evidence, *partial.evidence], None
        if partial is not None:
            search.evidence += partial.evidence
            spikes = [effect for effect in effects if effect.name.startswith("sensor-spikes")]
            again = _judged_again(search, root, partial, spikes, seen, kept, out_before)
            verdict, best, out_after, effects, tests_after, warnings = again
        if verdict in (Verdict.UNEXPLAINED, Verdict.PARTIAL):
            # Where what remains is not noise, records differ by more than any one of them can tell.
            between = between_records(search, best, seen, kept)
    stage("held out")
    return _diagnosis(
        search, root, best, verdict, effects, warnings, (tests_before, tests_after), (out_before, out_after), validation, outputs, seconds, between
    )


def _judged_again(
    search: Search,
    root: Node,
    partial: Partial,
    spikes: Sequence[Claim],
    validation: Sequence[Record],
    masks: Sequence[np.ndarray] | None,
    before: HeldOut,
) -> tuple[Verdict, Node, HeldOut, list[Claim], tuple[ResidualTest, ...], list[str]]:
    """The verdict on effects that stand by themselves: with a further one, they may leave noise after all."""
    best, out = best_by_held_out(search, extended(search, root, partial.node), validation, masks)
    tests = tuple(whiteness(best.fit, "fitted")) + (tuple(whiteness(out.informed, "held out")) if out.informed is not None else ())
    claims = [*(_claimed(spike) for spike in spikes), *_claims(search, best, guards_among(best.names))]
    verdict, warnings = judge(search, root, best, claims, tests, before, out, search.settings)
    if verdict in (Verdict.TRACED, Verdict.AMBIGUOUS):
        return verdict, best, out, claims, tests, warnings
    tests = tuple(whiteness(partial.node.fit, "fitted"))
    return Verdict.PARTIAL, partial.node, partial.out, [*partial.claims, *spikes], tests, not_noise(tests, search.settings.white)


def _no_better(before: HeldOut, after: HeldOut) -> bool:
    """Whether a free simulation of held-out data is no better, in likelihood, than that of the declared model."""
    return before.frozen is not None and after.frozen is not None and after.frozen.cost >= before.frozen.cost


def _claims(search: Search, best: Node, guarded: Sequence[str]) -> list[Claim]:
    others = alternatives_of(search, best)
    return [
        Claim(effect.name, quantities(best, effect), others.get(effect.name, ()), not guarded, records_of(best, effect), effect.explanation)
        for effect in best.effects
        if not guards_among([effect.name])
    ]


def _hint(claim: Claim) -> Claim:
    return replace(claim, claimed=False)


def _claimed(claim: Claim) -> Claim:
    return replace(claim, claimed=True)


def _grown(claim: Claim, growth: Mapping[str, float]) -> Claim:
    """Derivatives under each member of a group with the sigmas that they have elsewhere."""
    if claim.evidence is None or not growth:
        return claim
    members = {
        member: {name: replace(q, std=q.std * growth.get(name, 1.0)) for name, q in found.items()}
        for member, found in claim.evidence.derivatives.items()
    }
    return replace(claim, evidence=replace(claim.evidence, derivatives=members))


def _diagnosis(
    search: Search,
    root: Node,
    best: Node,
    verdict: Verdict,
    effects: Sequence[Claim],
    warnings: Sequence[str],
    tests: tuple[tuple[ResidualTest, ...], tuple[ResidualTest, ...]],
    out: tuple[HeldOut, HeldOut],
    validation: Sequence[Record],
    outputs: Sequence[str],
    seconds: Mapping[str, float],
    between: Between,
) -> Diagnosis:
    before, after = out
    shown = validation or search.records
    fits = (before.frozen, after.frozen) if validation else (root.fit, best.fit)
    channels = [name for name in outputs if any(name in record.output_names for record in shown)]
    predictions = [
        Prediction(record, tuple(channels), prediction(fits[0], r, record, channels), prediction(fits[1], r, record, channels))
        for r, record in enumerate(shown)
    ]
    everywhere = measured_masks(shown, outputs)
    if not validation:
        everywhere = [mask & kept for mask, kept in zip(everywhere, search.masks, strict=True)]
    elif fits[1] is not None:
        everywhere = spike_masks_of(fits[1], everywhere)
    masks = [mask[[outputs.index(name) for name in channels]] for mask in everywhere]
    return Diagnosis(
        verdict,
        tuple(_grown(claim, between.growth) for claim in effects),
        _derivatives(search, root, between.growth),
        _derivatives(search, best, between.growth, form_spread(search, best)),
        _derived(root),
        _derived(best),
        error_figures([p.before for p in predictions], shown, masks, channels),
        error_figures([p.after for p in predictions], shown, masks, channels),
        {name: std for name, std in noise_levels(best.fit).items() if name in channels},
        bool(validation),
        tests[0],
        tests[1],
        tuple(search.steps),
        tuple(search.evidence),
        tuple(warnings),
        tuple(predictions),
        tuple(
            FittedRecord(record, best.system.output_names, root.fit.residuals[r], _in_units(best, r), search.masks[r])
            for r, record in enumerate(search.records)
        ),
        dict(seconds),
        between.scatter,
        between.growth,
    )


def spike_masks_of(fit: Fit, masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Validity of held-out samples with isolated spikes set aside, for error figures only."""
    system = fit.layout.system
    every = zip(masks, fit.layout.problems, fit.lines, strict=True)
    everything = [np.where(mask, problem.z - line.y, 0.0) for mask, problem, line in every]
    blocked = [np.zeros(residual.shape[1], dtype=bool) for residual in everything]
    kept, _ = final_spikes([], system.output_names, everything, list(masks), blocked)
    return [mask & keep for mask, keep in zip(masks, kept, strict=True)]


def _derivatives(search: Search, node: Node, growth: Mapping[str, float] = _NONE, form: Mapping[str, float] = _NONE) -> dict[str, Quantity]:
    """Shared parameters of the declared model, with sigmas corrected for colour, grown by what records differ by, and by ``form``.

    ``form`` is what the form of an effect leaves open, added in squares.
    """
    estimate = _estimate(node)
    declared = set(search.model.parameters.names)

    def sigma(name: str, std: float) -> float:
        return max(growth.get(name, 1.0) * float(np.hypot(std, form.get(name, 0.0))), 1e-300)

    return {
        name: Quantity(float(value), sigma(name, float(std)), unit)
        for name, unit, value, std in zip(estimate.names, estimate.units, estimate.values, estimate.std, strict=True)
        if name in declared
    }


def _derived(node: Node) -> dict[str, Quantity]:
    if not node.system.inputs:
        return {}
    units, estimate = {"natural_frequency": "rad/s", "damping_ratio": "1"}, _estimate(node)
    out = {name: Quantity(value, max(std, 1e-300), units[name]) for name, (value, std) in modal_estimate(node.system, estimate).items()}
    if "delay" in estimate.names:
        out["delay"] = Quantity(estimate.value("delay"), max(estimate.sigma("delay"), 1e-300), "s")
    return out


def _estimate(node: Node) -> Estimate:
    return filter_error_estimate(node.fit) if is_forced(node.system) else estimate_of(node.fit)


def _in_units(node: Node, r: int) -> np.ndarray:
    """Residuals in the outputs' units; innovations, which have variance one, times the noise of their output."""
    if not is_forced(node.system):
        return node.fit.residuals[r]
    levels = noise_levels(node.fit)
    return node.fit.residuals[r] * np.array([levels[name] for name in node.system.output_names])[:, None]
