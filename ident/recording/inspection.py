"""The record check: searches the raw columns for faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.recording.distorted_channels import band_limited, clipped, hum, zero_steps
from ident.recording.interpolation import interpolated
from ident.recording.kinematic_relations import height_unit
from ident.recording.misread_columns import misread
from ident.recording.missing_samples import (
    dropouts,
    held_samples,
    missing_rows,
    stuck,
)
from ident.recording.series import (
    FEWEST_SAMPLES,
    Certainty,
    Expectations,
    RecordFinding,
    Series,
    changing_noise,
    coarse,
    series_of,
)
from sim.record import Record

# order of the findings
ORDER = (Certainty.CERTAIN, Certainty.LIKELY, Certainty.COSTS_INFORMATION, Certainty.NOTED)


def inspect(record: Record, expected: Expectations | None = None) -> tuple[RecordFinding, ...]:
    """Return the findings in the raw columns of a record, the certain ones first.

    Parameters
    ----------
    record : the record as it was read, in SI units and radians, with nz in g.
    expected : known values of the aircraft; None compares the channels with each other only.
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
    findings = missing_rows(record) if len(record) >= FEWEST_SAMPLES else []
    for series in outputs:
        others = [other for other in outputs if other is not series]
        findings += _sample_findings(series, others, inputs, len(record), masked)
    for series in inputs:
        findings += [
            *dropouts(series, len(record), is_input=True),
            *clipped(series, len(record), is_input=True),
        ]
        interpolation = interpolated(series, len(record), is_input=True)
        findings += [interpolation] if interpolation is not None else []
    band_limits = [finding for series in inputs if (finding := band_limited(series)) is not None]
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
            coarse(series),
            changing_noise(series, len(record), inputs, others),
            hum(series, inputs),
            _band_limit_finding(series, band_limits),
        )
        findings += [finding for finding in candidates if finding is not None]
    findings += zero_steps(
        [series for series in usable if series.least_bit <= 2.0 * max(series.noise, 1e-300)],
        inputs,
        masked,
        gravity_over_speed,
    )
    if expected.aircraft:
        findings += misread(clean, expected)
    findings += height_unit(clean, expected)
    return tuple(sorted(findings, key=lambda finding: ORDER.index(finding.certainty)))


def _sample_findings(
    series: Series,
    others: Sequence[Series],
    inputs: Sequence[Series],
    count: int,
    masked: dict[str, np.ndarray],
) -> list[RecordFinding]:
    """Return the findings on wrong samples of one channel, and store their mask in ``masked``. No
    sample is in two findings.
    """
    mask = np.zeros(count, dtype=bool)
    findings = dropouts(series, count)
    for finding in findings:
        mask |= finding.mask
    hold = held_samples(series, count) if not findings else None
    interpolation = interpolated(series, count, inputs) if not findings and hold is None else None
    lower_rate = hold or interpolation
    if lower_rate is not None:
        findings.append(lower_rate)
        mask |= lower_rate.mask
    else:
        for finding in clipped(series, count):
            findings.append(finding)
            mask |= finding.mask
        stuck_finding = stuck(series, others, inputs, count, mask)
        if stuck_finding is not None:
            findings.append(stuck_finding)
            mask |= stuck_finding.mask
    masked[series.name] = mask
    return findings


def _band_limit_finding(series: Series, inputs: Sequence[RecordFinding]) -> RecordFinding | None:
    """Return the finding of a band-limited output; None where an input has about the same cutoff,
    since a motion without noise has the bandwidth of its excitation.
    """
    finding = band_limited(series)
    if finding is None:
        return None
    cutoff = finding.numbers["cutoff"].value
    if any(0.5 < of_input.numbers["cutoff"].value / cutoff < 2.0 for of_input in inputs):
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
