"""Faults of one column, or of two: which value stands in which row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.record import Channel, Record


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
