"""Record check: search for faults in the raw columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.recording.distorted_channels import clipping_findings, zero_step_findings
from ident.recording.interpolation import interpolation_finding
from ident.recording.kinematic_relations import height_unit_findings
from ident.recording.misread_columns import misread_findings
from ident.recording.missing_samples import (
    dropout_findings,
    held_samples_finding,
    missing_rows_findings,
    stuck_finding,
)
from ident.recording.series import (
    FEWEST_SAMPLES,
    Certainty,
    Expectations,
    RecordFinding,
    Series,
    noise_level_finding,
    resolution_finding,
    series_of,
)
from ident.recording.spectra import band_limit_finding, hum_finding
from sim.record import Record

# order of the findings
ORDER = (Certainty.CERTAIN, Certainty.LIKELY, Certainty.COSTS_INFORMATION, Certainty.NOTED)


def inspect(record: Record, expected: Expectations | None = None) -> tuple[RecordFinding, ...]:
    """Return the findings in the raw columns of a record, the certain ones first.

    Parameters
    ----------
    record : the record as it was read, in SI units and radians, with nz in g.
    expected : known values of the aircraft; None compares the channels only with each other.
    """
    expected = expected or Expectations()
    gravity_over_speed = expected.gravity / expected.airspeed if expected.airspeed else None
    outputs = [
        series_of(record, channel)
        for channel in record.outputs
        if np.count_nonzero(channel.valid) >= FEWEST_SAMPLES
    ]
    inputs = [series_of(record, channel) for channel in record.inputs]
    masked: dict[str, np.ndarray] = {}
    findings = missing_rows_findings(record) if len(record) >= FEWEST_SAMPLES else []
    for series in outputs:
        others = [other for other in outputs if other is not series]
        findings += _sample_findings(series, others, inputs, len(record), masked)
    for series in inputs:
        findings += [
            *dropout_findings(series, len(record), is_input=True),
            *clipping_findings(series, len(record), is_input=True),
        ]
        interpolation = interpolation_finding(series, len(record), is_input=True)
        findings += [interpolation] if interpolation is not None else []
    band_limits = [
        finding for series in inputs if (finding := band_limit_finding(series)) is not None
    ]
    findings += band_limits
    clean = _without_masked(record, masked)
    usable = [
        series_of(clean, clean[series.name])
        for series in outputs
        if not _mostly_masked(masked.get(series.name))
    ]
    for series in usable:
        others = [other for other in usable if other is not series]
        candidates = (
            resolution_finding(series),
            noise_level_finding(series, len(record), inputs, others),
            hum_finding(series, inputs),
            _output_band_limit_finding(series, band_limits),
        )
        findings += [finding for finding in candidates if finding is not None]
    findings += zero_step_findings(
        [series for series in usable if series.least_bit <= 2.0 * max(series.noise, 1e-300)],
        inputs,
        masked,
        gravity_over_speed,
    )
    if expected.aircraft:
        findings += misread_findings(clean, expected)
    findings += height_unit_findings(clean, expected)
    return tuple(sorted(findings, key=lambda finding: ORDER.index(finding.certainty)))


def _sample_findings(
    series: Series,
    others: Sequence[Series],
    inputs: Sequence[Series],
    count: int,
    masked: dict[str, np.ndarray],
) -> list[RecordFinding]:
    """Return the findings on wrong samples of one channel, and store the mask of these samples in
    ``masked``. No sample is in two findings. ``count`` is the number of rows of the record.
    """
    mask = np.zeros(count, dtype=bool)
    findings = dropout_findings(series, count)
    for finding in findings:
        mask |= finding.mask
    hold = held_samples_finding(series, count) if not findings else None
    interpolation = (
        interpolation_finding(series, count, inputs) if not findings and hold is None else None
    )
    lower_rate = hold or interpolation
    if lower_rate is not None:
        findings.append(lower_rate)
        mask |= lower_rate.mask
    else:
        for finding in clipping_findings(series, count):
            findings.append(finding)
            mask |= finding.mask
        stuck_samples = stuck_finding(series, others, inputs, count, mask)
        if stuck_samples is not None:
            findings.append(stuck_samples)
            mask |= stuck_samples.mask
    masked[series.name] = mask
    return findings


def _output_band_limit_finding(
    series: Series, input_findings: Sequence[RecordFinding]
) -> RecordFinding | None:
    """Return the finding of a band-limited output; None if an input has about the same cutoff,
    since a motion without noise has the bandwidth of its excitation.
    """
    finding = band_limit_finding(series)
    if finding is None:
        return None
    cutoff = finding.numbers["cutoff"].value
    if any(0.5 < other.numbers["cutoff"].value / cutoff < 2.0 for other in input_findings):
        return None
    return finding


def _mostly_masked(mask: np.ndarray | None) -> bool:
    """Return whether more than a tenth of the samples is masked."""
    return mask is not None and bool(np.mean(mask) > 0.1)


def _without_masked(record: Record, masked: dict[str, np.ndarray]) -> Record:
    """Return the record with its masked samples invalid."""
    if not any(np.any(mask) for mask in masked.values()):
        return record
    outputs = tuple(
        replace(channel, valid=channel.valid & ~masked[channel.name])
        if np.any(masked.get(channel.name, False))
        else channel
        for channel in record.outputs
    )
    return replace(record, outputs=outputs)
