"""The raw look at a record: every kind of fault in turn, cheapest first, each knowing what the ones before have masked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.recording.band_limited import band_limited
from ident.recording.dropouts import dropouts
from ident.recording.extremes import clipped
from ident.recording.finding import Certainty, Expectations, Finding
from ident.recording.height_unit import height_unit
from ident.recording.hum import hum
from ident.recording.interpolated import interpolated
from ident.recording.noise_level import changing_noise, coarse
from ident.recording.readings import misread
from ident.recording.repeats import held, stuck
from ident.recording.rows import missing_rows
from ident.recording.series import FEWEST, Series, series_of
from ident.recording.zero_steps import zero_steps
from sim.record import Record

ORDER = (Certainty.CERTAIN, Certainty.LIKELY, Certainty.COSTS_INFORMATION, Certainty.NOTED)


def inspect(record: Record, expected: Expectations | None = None) -> tuple[Finding, ...]:
    """What the raw columns of a record show, the certain first; empty where nothing is wrong.

    Parameters
    ----------
    record : as it was read, before anything is done to it; SI and radians, nz in g.
    expected : what it is compared with beside itself; None: itself alone.

    A few tens of milliseconds for a thousand rows of four channels. No finding is raised as an error; what follows from one is the caller's.
    """
    expected = expected or Expectations()
    over = expected.gravity / expected.airspeed if expected.airspeed else None
    outputs = [series_of(record, channel) for channel in record.outputs if np.count_nonzero(channel.valid) >= FEWEST]
    inputs = [series_of(record, channel) for channel in record.inputs]
    masked: dict[str, np.ndarray] = {}
    found = missing_rows(record) if len(record) >= FEWEST else []
    for series in outputs:
        others = [other for other in outputs if other is not series]
        found += _samples(series, others, inputs, len(record), masked)
    for series in inputs:
        found += [*dropouts(series, len(record), is_input=True), *clipped(series, len(record), is_input=True)]
        filled = interpolated(series, len(record), is_input=True)
        found += [filled] if filled is not None else []
    limited = [one for series in inputs if (one := band_limited(series)) is not None]
    found += limited
    clean = _without(record, masked)
    whole = [series_of(clean, clean[series.name]) for series in outputs if not _mostly(masked.get(series.name))]
    for series in whole:
        others = [other for other in whole if other is not series]
        looked = (coarse(series), changing_noise(series, len(record), inputs, others), hum(series, inputs), _band_limited(series, limited))
        found += [one for one in looked if one is not None]
    found += zero_steps([series for series in whole if series.least_bit <= 2.0 * max(series.noise, 1e-300)], inputs, masked, over)
    if expected.aircraft:
        found += misread(clean, expected)
    found += height_unit(clean, expected)
    return tuple(sorted(found, key=lambda one: ORDER.index(one.certainty)))


def _samples(series: Series, others: Sequence[Series], inputs: Sequence[Series], count: int, masked: dict[str, np.ndarray]) -> list[Finding]:
    """What masks samples of one channel; a sample is masked once."""
    taken = np.zeros(count, dtype=bool)
    out = dropouts(series, count)
    for one in out:
        taken |= one.mask
    hold = held(series, count) if not out else None
    filled = interpolated(series, count, inputs) if not out and hold is None else None
    lower_rate = hold or filled
    if lower_rate is not None:
        out.append(lower_rate)
        taken |= lower_rate.mask
    else:
        for one in clipped(series, count):
            out.append(one)
            taken |= one.mask
        still = stuck(series, others, inputs, count, taken)
        if still is not None:
            out.append(still)
            taken |= still.mask
    masked[series.name] = taken
    return out


def _band_limited(series: Series, inputs: Sequence[Finding]) -> Finding | None:
    """An output's end of the spectrum, unless that of an input explains it: a motion without noise ends where what excites it does."""
    found = band_limited(series)
    return None if found is None or any(0.5 < one.numbers["cutoff"].value / found.numbers["cutoff"].value < 2.0 for one in inputs) else found


def _mostly(mask: np.ndarray | None) -> bool:
    """Whether so many samples are masked that the rest is no longer sampled as the record is."""
    return mask is not None and bool(np.mean(mask) > 0.1)


def _without(record: Record, masked: dict[str, np.ndarray]) -> Record:
    """The record less its masked samples."""
    if not any(np.any(mask) for mask in masked.values()):
        return record
    outputs = tuple(
        replace(channel, valid=channel.valid & ~masked[channel.name]) if np.any(masked.get(channel.name, False)) else channel
        for channel in record.outputs
    )
    return replace(record, outputs=outputs)
