"""From nodes and held-out fits to a Diagnosis: derivatives with their sigmas, error figures, what was fitted and predicted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from ident.estimate import Estimate
from ident.flying_qualities.modal import modal_estimate
from ident.process_noise.filter_error import filter_error_estimate, noise_levels
from ident.process_noise.innovations_model import has_process_noise
from ident.statistics.residuals import ResidualTest
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Claim, Diagnosis, FittedRecord, Prediction, Quantity, Verdict
from ident.tracing.replication.between_records import RecordScatter
from ident.tracing.selection.form_spread import form_spread
from ident.tracing.selection.search import Search
from ident.tracing.spikes.detection import final_spikes
from ident.tracing.spikes.masks import measured_masks
from ident.tracing.validation.error_figures import error_figures, prediction
from ident.tracing.validation.held_out import HeldOut
from ident.whole_record.gauss_newton import Fit
from ident.whole_record.output_error import estimate_of
from sim.record import Record

_NONE: Mapping[str, float] = MappingProxyType({})


def _inflated(claim: Claim, inflation: Mapping[str, float]) -> Claim:
    """Derivatives under each member of a group with the sigmas that they have elsewhere."""
    if claim.evidence is None or not inflation:
        return claim
    members = {
        member: {name: replace(q, std=q.std * inflation.get(name, 1.0)) for name, q in found.items()}
        for member, found in claim.evidence.derivatives.items()
    }
    return replace(claim, evidence=replace(claim.evidence, derivatives=members))


def reported(
    search: Search,
    root: FittedModel,
    best: FittedModel,
    verdict: Verdict,
    effects: Sequence[Claim],
    warnings: Sequence[str],
    tests: tuple[tuple[ResidualTest, ...], tuple[ResidualTest, ...]],
    out: tuple[HeldOut, HeldOut],
    validation: Sequence[Record],
    outputs: Sequence[str],
    seconds: Mapping[str, float],
    record_scatter: tuple[RecordScatter, RecordScatter],
) -> Diagnosis:
    before, after = out
    inflated_before, inflated = record_scatter[0].inflation, record_scatter[1].inflation
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
        tuple(_inflated(claim, inflated) for claim in effects),
        _derivatives(search, root, inflated_before),
        _derivatives(search, best, inflated, form_spread(search, best)),
        _derived(root, inflated_before),
        _derived(best, inflated),
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
        record_scatter[1].scatter,
        inflated,
    )


def spike_masks_of(fit: Fit, masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Validity of held-out samples with isolated spikes set aside, for error figures only."""
    system = fit.layout.system
    every = zip(masks, fit.layout.problems, fit.lines, strict=True)
    everything = [np.where(mask, problem.z - line.y, 0.0) for mask, problem, line in every]
    blocked = [np.zeros(residual.shape[1], dtype=bool) for residual in everything]
    kept, _ = final_spikes([], system.output_names, everything, list(masks), blocked)
    return [mask & keep for mask, keep in zip(masks, kept, strict=True)]


def _derivatives(
    search: Search, fitted: FittedModel, inflation: Mapping[str, float] = _NONE, form: Mapping[str, float] = _NONE
) -> dict[str, Quantity]:
    """Shared parameters of the declared model, with sigmas corrected for colour, grown by what records differ by, and by ``form``.

    ``form`` is what the form of an effect leaves open, added in squares.
    """
    estimate = _estimate(fitted)
    declared = set(search.model.parameters.names)

    def sigma(name: str, std: float) -> float:
        return max(inflation.get(name, 1.0) * float(np.hypot(std, form.get(name, 0.0))), 1e-300)

    return {
        name: Quantity(float(value), sigma(name, float(std)), unit)
        for name, unit, value, std in zip(estimate.names, estimate.units, estimate.values, estimate.std, strict=True)
        if name in declared
    }


def _derived(fitted: FittedModel, inflation: Mapping[str, float] = _NONE) -> dict[str, Quantity]:
    """Frequency, damping and delay, with sigmas that follow from those of the derivatives as they are reported."""
    if not fitted.system.inputs:
        return {}
    plain = _estimate(fitted)
    inflated = np.array([inflation.get(name, 1.0) for name in plain.names])
    units, estimate = {"natural_frequency": "rad/s", "damping_ratio": "1"}, replace(plain, covariance=plain.covariance * np.outer(inflated, inflated))
    out = {name: Quantity(value, max(std, 1e-300), units[name]) for name, (value, std) in modal_estimate(fitted.system, estimate).items()}
    if "delay" in estimate.names:
        out["delay"] = Quantity(estimate.value("delay"), max(estimate.sigma("delay"), 1e-300), "s")
    return out


def _estimate(fitted: FittedModel) -> Estimate:
    return filter_error_estimate(fitted.fit) if has_process_noise(fitted.system) else estimate_of(fitted.fit)


def _in_units(fitted: FittedModel, r: int) -> np.ndarray:
    """Residuals in the outputs' units; innovations, which have variance one, times the noise of their output."""
    if not has_process_noise(fitted.system):
        return fitted.fit.residuals[r]
    levels = noise_levels(fitted.fit)
    return fitted.fit.residuals[r] * np.array([levels[name] for name in fitted.system.output_names])[:, None]
