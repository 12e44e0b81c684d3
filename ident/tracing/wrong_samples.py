"""Wrong samples in the tracing loop: masks during the search, claims at its end, mended inputs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.process_noise.filter_error import noise_levels
from ident.statistics.noise_levels import (
    Spikes,
    final_spikes,
    input_edges,
    input_spikes,
    provisional_mask,
)
from ident.tracing.diagnosis import Claim, Quantity, Step
from ident.tracing.evidence import FAMILY_ODDS, FEWEST_FAMILY_MEMBERS, evidence_of
from ident.tracing.fitted_model import FittedModel, is_event
from ident.tracing.held_out import HeldOut
from ident.tracing.problem import TraceProblem, search_context
from sim.declaration.effect import full_name
from sim.record import Channel, Record

NEAR_EVENT = 0.15  # s, no spikes are sought so close to a fitted event: its form is approximate


def measured_masks(records: Sequence[Record], outputs: Sequence[str]) -> list[np.ndarray]:
    """Return the mask ``(m, N)`` of each record: True where a sample was measured."""
    return [record.output_array(outputs)[1] for record in records]


def spike_masks(problem: TraceProblem, fitted: FittedModel) -> list[np.ndarray]:
    """Return provisional masks without isolated spikes in a fitted model's residuals."""
    masks = []
    for laid_out, line, record in zip(
        fitted.fit.layout.problems, fitted.fit.linearisations, problem.records, strict=True
    ):
        measured = record.output_array(problem.outputs)[1]
        residual = np.where(measured, laid_out.z - line.y, 0.0)
        masks.append(measured & provisional_mask(residual, measured, input_edges(record)))
    return masks


def spike_claims(
    problem: TraceProblem, fitted: FittedModel
) -> tuple[list[np.ndarray], list[Claim]]:
    """Return the final masks ``(m, N)`` from the residuals of a fitted model, and the claims of
    spikes in those channels for which a candidate exists.
    """
    measured = measured_masks(problem.records, problem.outputs)
    residuals = [
        np.where(valid, laid_out.z - line.y, 0.0)
        for valid, laid_out, line in zip(
            measured, fitted.fit.layout.problems, fitted.fit.linearisations, strict=True
        )
    ]
    blocked = [_near_events(fitted, r, record) for r, record in enumerate(problem.records)]
    masks, spikes = final_spikes(problem.records, problem.outputs, residuals, measured, blocked)
    units = {signal.name: signal.unit for signal in fitted.system.outputs}
    by_channel: dict[str, list[Spikes]] = {}
    for spike in spikes:
        by_channel.setdefault(spike.channel, []).append(spike)
    names = _spike_candidates(problem)
    claims = [
        _claim(names[channel], found, units[channel], _sigma(fitted, channel))
        for channel, found in by_channel.items()
        if channel in names
    ]
    return [mask & valid for mask, valid in zip(masks, measured, strict=True)], claims


def held_out_masks(
    out: HeldOut, records: Sequence[Record], outputs: Sequence[str]
) -> list[np.ndarray] | None:
    """Return masks of held-out samples without isolated spikes; None where the fit failed."""
    if out.frozen is None:
        return None
    masks = []
    for residual, problem, record in zip(
        out.frozen.residuals, out.frozen.layout.problems, records, strict=True
    ):
        masks.append(problem.valid & provisional_mask(residual, problem.valid, input_edges(record)))
    return masks


def mended_inputs(problem: TraceProblem, record: Record, claims: Sequence[Claim]) -> Record:
    """Return a held-out record with spikes mended in those inputs for which spikes were claimed."""
    names, claimed = _spike_candidates(problem), {claim.name for claim in claims}
    return with_mended(
        record, [channel.name for channel in record.inputs if names.get(channel.name) in claimed]
    )


def with_mended(record: Record, names: Sequence[str]) -> Record:
    """Return a record with the spikes of these inputs mended."""
    for channel in record.inputs:
        if channel.name in names:
            record = _with_interpolated(record, channel.name, input_spikes(channel.values))
    return record


def cleaned_inputs(
    problem: TraceProblem, declared_fit: FittedModel
) -> tuple[TraceProblem, FittedModel, list[Claim], list[Step]]:
    """Mend spikes of recorded inputs if the log likelihood increases by more than their prior odds.

    Returns
    -------
    The problem with mended inputs; its fit without effects; claims and steps for the log.
    """
    claims: list[Claim] = []
    steps: list[Step] = []
    names = _spike_candidates(problem)
    for name in [name for name in declared_fit.system.input_names if name in names]:
        found = [input_spikes(record[name].values) for record in problem.records]
        if not any(samples.size for samples in found):
            continue
        trial = replace(
            problem,
            records=[
                _with_interpolated(record, name, samples)
                for record, samples in zip(problem.records, found, strict=True)
            ],
        )
        fitted = trial.fit((), declared_fit)
        gain = declared_fit.fit.cost - fitted.fit.cost if fitted is not None else 0.0
        if fitted is not None and gain > -math.log(FAMILY_ODDS / FEWEST_FAMILY_MEMBERS):
            unit = declared_fit.system.inputs[declared_fit.system.input_names.index(name)].unit
            size_sigma = max(float(np.ptp(problem.records[0][name].values)) * 1e-3, 1e-12)
            claims.append(
                _claim(
                    names[name],
                    _removed_spikes(problem.records, trial.records, name, found),
                    unit,
                    size_sigma,
                )
            )
            sentence = f"spikes of {name} mended: the log likelihood rises by {gain:.1f}"
            evidence, _, _ = evidence_of(fitted, search_context(fitted, problem.predicted))
            steps.append(Step((), evidence, fitted.fit.log_likelihood, sentence))
            problem, declared_fit = trial, fitted
    return problem, declared_fit, claims, steps


def _removed_spikes(
    records: Sequence[Record], mended: Sequence[Record], name: str, found: Sequence[np.ndarray]
) -> list[Spikes]:
    """Return the spikes that mending removed from a channel of each record."""
    return [
        Spikes(
            r,
            name,
            tuple(samples.tolist()),
            tuple((record[name].values - other[name].values)[samples].tolist()),
        )
        for r, (record, other, samples) in enumerate(zip(records, mended, found, strict=True))
        if samples.size
    ]


def _spike_candidates(problem: TraceProblem) -> dict[str, str]:
    """Return channel -> name of the candidate for isolated wrong samples of this channel."""
    return {
        candidate.traits.wrong_samples_of: candidate.name
        for candidate in problem.candidates
        if candidate.traits.wrong_samples_of
    }


def _with_interpolated(record: Record, name: str, samples: np.ndarray) -> Record:
    """Return a record with these samples of an input replaced by the mean of their neighbours."""
    if not samples.size:
        return record
    values = record[name].values.copy()
    values[samples] = 0.5 * (values[samples - 1] + values[samples + 1])
    old = record[name]
    return replace(
        record,
        inputs=tuple(
            Channel.of(name, old.unit, values) if c.name == name else c for c in record.inputs
        ),
    )


def _claim(name: str, spikes: Sequence[Spikes], unit: str, sigma: float) -> Claim:
    """Return the claim of the spikes of one channel.

    ``name`` : of the candidate. ``sigma`` : of the size of a single spike.
    """
    sizes = np.array([size for spike in spikes for size in spike.sizes])
    count = len(sizes)
    size = float(np.sqrt(np.mean(sizes**2)))
    parameters = {
        "count": Quantity(float(count), 0.5, "1"),
        "size": Quantity(size, sigma / np.sqrt(count), unit),
    }
    records = tuple(sorted({spike.record for spike in spikes}))
    text = (
        f"{count} isolated sample(s) of the channel are wrong, by {size:.3g} {unit} (root mean "
        "square); they were set aside in every fit"
    )
    return Claim(name, parameters, (), True, records, text)


def _sigma(fitted: FittedModel, channel: str) -> float:
    """Return the standard deviation of the noise of a channel."""
    return float(noise_levels(fitted.fit)[channel])


def _near_events(fitted: FittedModel, r: int, record: Record) -> np.ndarray:
    """Return a mask ``(N,)`` of record ``r``: True near the onset and the end of a fitted event."""
    blocked = np.zeros(len(record), dtype=bool)
    own, shared = fitted.values.own[r], fitted.values.shared
    for effect in fitted.effects:
        if not is_event(effect):
            continue
        known = {
            item.name: own.get(
                full_name(effect, item.name), shared.get(full_name(effect, item.name), item.value)
            )
            for item in effect.parameters
        }
        onset = known[effect.traits.onset]
        for edge in (onset, onset + known.get("duration", 0.0)):
            blocked |= np.abs(record.time - edge) < NEAR_EVENT
    return blocked
