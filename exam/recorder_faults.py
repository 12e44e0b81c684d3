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
    """The same record with other values ``(N,)`` in one column, input or output."""

    def changed(channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
        return tuple(Channel.of(c.name, c.unit, values) if c.name == name else c for c in channels)

    return replace(record, inputs=changed(record.inputs), outputs=changed(record.outputs))


def held(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """Every ``rows``-th sample is new, and stands until the next new one."""
    rows = round(values["rows"])
    return with_column(record, name, record[name].values[np.arange(len(record)) // rows * rows])


def dead(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """For ``length`` seconds from ``begin``, s, the last value stands, or zero where ``zero`` is
    1.
    """
    during = _during(record, values)
    before = record[name].values[max(0, int(np.argmax(during)) - 1)]
    return with_column(
        record, name, np.where(during, 0.0 if values["zero"] else before, record[name].values)
    )


def skewed(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """The column stands ``rows`` rows too low: each value in the row of a later time; the first is
    repeated.
    """
    rows = round(values["rows"])
    column = record[name].values
    return with_column(record, name, np.concatenate([np.full(rows, column[0]), column[:-rows]]))


def exchanged(
    first: str, second: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """In ``count`` rows the values of two columns stand in each other's place."""
    rows = rng.choice(len(record), round(values["count"]), replace=False)
    one, two = record[first].values.copy(), record[second].values.copy()
    one[rows], two[rows] = two[rows], one[rows]
    return with_column(with_column(record, first, one), second, two)


def burst(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """Noise of standard deviation ``sigma`` on top, in the channel's unit, for ``length`` seconds
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
    """The clock counts ``factor`` seconds in a true one."""
    return replace(record, time=record.time * values["factor"])


def rows_missing(record: Record, values: Mapping[str, float], rng: np.random.Generator) -> Record:
    """No rows for ``length`` seconds from ``begin``, s; the time column tells."""
    return _kept(record, _outside(record, values))


def rows_lost(record: Record, values: Mapping[str, float], rng: np.random.Generator) -> Record:
    """The same with a time column that was written afterwards, even from end to end: what follows
    comes too early.
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
    """The sensor ends ``share`` of its range short of its highest value and as much above its
    lowest.
    """
    column = record[name].values
    low, high = float(np.min(column)), float(np.max(column))
    edge = values["share"] * (high - low)
    return with_column(record, name, np.clip(column, low + edge, high - edge))


def scaled(
    name: str, record: Record, values: Mapping[str, float], rng: np.random.Generator
) -> Record:
    """``factor`` times the value under the same header: a sign turned, or another unit."""
    return with_column(record, name, values["factor"] * record[name].values)
