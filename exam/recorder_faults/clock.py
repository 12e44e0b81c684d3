"""Faults of the time column and of whole rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.record import Channel, Record


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
