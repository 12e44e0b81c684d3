"""Faults of the recorder, put into a sheet after sampling and noise: what breaks between the sensor
and the file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.independent.flight import G0
from tests.independent.recording import UNITS, Sheet

SheetFault = Callable[[Sheet], Sheet]


def _during(sheet: Sheet, begin: float, length: float) -> np.ndarray:
    return (sheet.time >= begin) & (sheet.time < begin + length)


def held_lower(name: str, times: int) -> SheetFault:
    """A channel of a lower rate written at the record's: every value stands ``times`` rows."""

    def act(sheet: Sheet) -> Sheet:
        rows = np.arange(len(sheet.time)) // times * times
        return sheet.with_column(name, sheet.columns[name][rows])

    return act


def stuck(name: str, begin: float, length: float) -> SheetFault:
    """The value at ``begin`` (s) stands for ``length`` seconds."""

    def act(sheet: Sheet) -> Sheet:
        where = _during(sheet, begin, length)
        return sheet.with_column(
            name, np.where(where, sheet.columns[name][int(np.argmax(where))], sheet.columns[name])
        )

    return act


def clipped(name: str, share: float) -> SheetFault:
    """The upper and the lower ``share`` of the range about the first value are cut flat."""

    def act(sheet: Sheet) -> Sheet:
        values = sheet.columns[name]
        low, high = np.min(values), np.max(values)
        edge = share * (high - low)
        return sheet.with_column(name, np.clip(values, low + edge, high - edge))

    return act


def coarse(name: str, bit: float) -> SheetFault:
    """Least bit ``bit``, in the channel's unit."""
    return lambda sheet: sheet.with_column(name, np.round(sheet.columns[name] / bit) * bit)


def zero_runs(name: str, begin: float, length: float) -> SheetFault:
    """Exact zeros for ``length`` seconds from ``begin`` and once more 6 s later: a link that drops
    out.
    """

    def act(sheet: Sheet) -> Sheet:
        where = _during(sheet, begin, length) | _during(sheet, begin + 6.0, length)
        return sheet.with_column(name, np.where(where, 0.0, sheet.columns[name]))

    return act


def rows_missing(begin: float, length: float) -> SheetFault:
    """No rows at all for ``length`` seconds from ``begin``; the time column tells."""

    def act(sheet: Sheet) -> Sheet:
        kept = ~_during(sheet, begin, length)
        return replace(
            sheet,
            time=sheet.time[kept],
            columns={name: values[kept] for name, values in sheet.columns.items()},
        )

    return act


def zero_step(name: str, begin: float, size: float) -> SheetFault:
    return lambda sheet: sheet.with_column(name, sheet.columns[name] + size * (sheet.time >= begin))


def noise_burst(
    name: str, begin: float, length: float, sigma: float, rng: np.random.Generator
) -> SheetFault:
    """More noise of ``sigma`` for a while."""

    def act(sheet: Sheet) -> Sheet:
        more = sigma * rng.standard_normal(len(sheet.time)) * _during(sheet, begin, length)
        return sheet.with_column(name, sheet.columns[name] + more)

    return act


def hum(name: str, frequency: float, size: float) -> SheetFault:
    """A sine of ``frequency`` Hz (above half the sample rate it shows folded) and amplitude
    ``size``.
    """
    return lambda sheet: sheet.with_column(
        name, sheet.columns[name] + size * np.sin(2.0 * np.pi * frequency * sheet.time + 0.4)
    )


def in_degrees(name: str) -> SheetFault:
    """Degrees under a header that says radians."""
    return lambda sheet: sheet.with_column(name, np.degrees(sheet.columns[name]))


def in_metres_per_second_squared(sheet: Sheet) -> Sheet:
    """nz in m/s2 under a header that says g."""
    return sheet.with_column("nz", G0 * sheet.columns["nz"])


def sign_turned(name: str) -> SheetFault:
    return lambda sheet: sheet.with_column(name, -sheet.columns[name])


def exchanged(first: str, second: str) -> SheetFault:
    """Two columns under each other's name; their header says what the name should have."""

    def act(sheet: Sheet) -> Sheet:
        return sheet.with_column(first, sheet.columns[second]).with_column(
            second, sheet.columns[first]
        )

    return act


def time_base(factor: float) -> SheetFault:
    """The time column runs by ``factor`` too fast: a rate that was noted wrongly."""
    return lambda sheet: replace(sheet, time=sheet.time * factor)


def untouched(sheet: Sheet) -> Sheet:
    assert set(sheet.columns) <= set(UNITS)
    return sheet
