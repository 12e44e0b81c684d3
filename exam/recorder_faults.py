"""Faults of a recorder, which are put into a record after sampling and noise.

Each fault is a function of a record, named values and a random generator, and returns a record. A
new one becomes an entry of `exam.random_cases.kinds`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.record import Channel, Record

# ---- Faults of one column, or of two


def with_column(record: Record, name: str, values: np.ndarray) -> Record:
    """Return the record with other values ``(N,)`` in one column, input or output."""

    def changed(channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
        return tuple(Channel.of(c.name, c.unit, values) if c.name == name else c for c in channels)

    return replace(record, inputs=changed(record.inputs), outputs=changed(record.outputs))


def held(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """Only every ``rows``-th sample is new; it is repeated until the next new one."""
    rows = round(values["rows"])
    return with_column(record, name, record[name].values[np.arange(len(record)) // rows * rows])


def dead(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """For ``length`` seconds from ``begin``, s, the last value is repeated; if ``zero`` is 1, the
    value is zero.
    """
    during = _during(record, values)
    before = record[name].values[max(0, int(np.argmax(during)) - 1)]
    return with_column(
        record, name, np.where(during, 0.0 if values["zero"] else before, record[name].values)
    )


def skewed(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """The column is shifted down by ``rows`` rows: each value is in the row of a later time, and
    the first is repeated.
    """
    rows = round(values["rows"])
    column = record[name].values
    return with_column(record, name, np.concatenate([np.full(rows, column[0]), column[:-rows]]))


def exchanged(
    first: str, second: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """In ``count`` rows the values of two columns are exchanged."""
    rows = rng.choice(len(record), round(values["count"]), replace=False)
    one, two = record[first].values.copy(), record[second].values.copy()
    one[rows], two[rows] = two[rows], one[rows]
    return with_column(with_column(record, first, one), second, two)


def burst(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """Noise of standard deviation ``sigma``, in the channel's unit, is added for ``length`` seconds
    from ``begin``, s.
    """
    more = values["sigma"] * rng.standard_normal(len(record))
    return with_column(
        record, name, record[name].values + np.where(_during(record, values), more, 0.0)
    )


def _during(record: Record, values: Mapping[str, float]) -> np.ndarray:
    return (record.time >= values["begin"]) & (record.time < values["begin"] + values["length"])


# ---- Faults of the time column and of whole rows


def fast_clock(record: Record, values: Mapping[str, float], rng: np.random.Generator) -> Record:
    """The clock counts ``factor`` seconds in one true second."""
    return replace(record, time=record.time * values["factor"])


def rows_missing(record: Record, values: Mapping[str, float], rng: np.random.Generator) -> Record:
    """Rows are missing for ``length`` seconds from ``begin``, s, with a gap in the time column."""
    return _kept(record, _outside(record, values))


def rows_lost(record: Record, values: Mapping[str, float], rng: np.random.Generator) -> Record:
    """Rows are missing as in ``rows_missing``, without a gap in the time column: later rows have
    times that are too early.
    """
    kept = _kept(record, _outside(record, values))
    return replace(kept, time=record.time[: len(kept)])


def _outside(record: Record, values: Mapping[str, float]) -> np.ndarray:
    return (record.time < values["begin"]) | (record.time >= values["begin"] + values["length"])


def _kept(record: Record, rows: np.ndarray) -> Record:
    def cut(channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
        return tuple(
            replace(channel, values=channel.values[rows], valid=channel.valid[rows])
            for channel in channels
        )

    return replace(
        record, time=record.time[rows], inputs=cut(record.inputs), outputs=cut(record.outputs)
    )


# ---- Faults of what a value means


def coarse(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """Values are rounded to multiples of ``bit``, in the channel's unit."""
    return with_column(record, name, np.round(record[name].values / values["bit"]) * values["bit"])


def clipped(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """The reading is limited at ``share`` of its range below its highest and above its lowest
    value.
    """
    column = record[name].values
    low, high = float(np.min(column)), float(np.max(column))
    edge = values["share"] * (high - low)
    return with_column(record, name, np.clip(column, low + edge, high - edge))


def scaled(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """The values are multiplied by ``factor`` under the same header: another sign or unit."""
    return with_column(record, name, values["factor"] * record[name].values)
