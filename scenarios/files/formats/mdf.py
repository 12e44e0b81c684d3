"""ASAM MDF measurement files (MF4, MDF, DAT) by asammdf: each channel group is a topic with its own
clock.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.formats.cells import (
    Topic,
    damaged,
    missing_library,
    no_table,
    table_of_columns,
)

FORMAT = "ASAM MDF"
SUFFIXES = (".mf4", ".mdf")
MAGIC = (b"MDF     ", b"UnFinMF ")
EXTRA = "recorders"
MASTER_CHANNELS = (2, 3)  # types of channels that are the clock


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return one topic for each channel group, with the name of the group or ``group 1``, ... The
    clock is ``time``, s.
    """
    try:
        from asammdf import MDF
    except ImportError as error:
        raise missing_library(error, path, FORMAT, EXTRA) from None
    topics = []
    try:
        with MDF(io.BytesIO(raw)) as log:
            for number in range(len(log.groups)):
                topic = _topic(path, log, number, _name(log, number))
                if topic is not None:
                    topics.append(topic)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, FORMAT) from None
    if not topics:
        raise no_table(path, (), "give a file with at least one channel of numbers")
    return tuple(topics) if len(topics) > 1 else (Topic("", topics[0].table),)


def _name(log: Any, number: int) -> str:
    """Return the name of a channel group."""
    return getattr(log.groups[number].channel_group, "acq_name", None) or f"group {number + 1}"


def _topic(path: Path, log: Any, number: int, name: str) -> Topic | None:
    """Return the topic of a channel group; None if the group has no channel of numbers."""
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {"time": "s"}
    for index, channel in enumerate(log.groups[number].channels):
        signal = log.get(group=number, index=index)
        if signal.samples.dtype.kind not in "fiub" or signal.samples.ndim != 1:
            continue
        columns.setdefault("time", np.asarray(signal.timestamps, dtype=float))
        if channel.channel_type in MASTER_CHANNELS:
            continue
        columns[channel.name], units[channel.name] = signal.samples, signal.unit or ""
    if len(columns) < 2:
        return None
    return Topic(name, table_of_columns(path, columns, units, place=name))
