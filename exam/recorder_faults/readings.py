"""Faults of what a value means: its steps, its limits, its sign and its unit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from exam.recorder_faults.columns import with_column
from sim.record import Record


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
