"""Inputs of a record flown again."""

from __future__ import annotations

from sim.maneuvers import MultiStep
from sim.record import Record


def held_inputs(record: Record) -> dict[str, MultiStep]:
    """The inputs of a record as maneuvers that hold each sample until the next."""
    interval = float(record.time[-1] - record.time[-2])
    times = (*record.time.tolist(), float(record.time[-1] + interval))
    return {
        channel.name: MultiStep(tuple(channel.values.tolist()), times) for channel in record.inputs
    }
