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


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return one topic for each channel group, with the group's name or ``group 1``, ...; its clock
    is ``time`` in s.
    """
    try:
        from asammdf import MDF
    except ImportError as error:
        raise missing_library(error, path, FORMAT, EXTRA) from None
    result = []
    try:
        with MDF(io.BytesIO(raw)) as log:
            for number in range(len(log.groups)):
                topic = _topic(path, log, number, _name(log, number))
                if topic is not None:
                    result.append(topic)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, FORMAT) from None
    if not result:
        raise no_table(path, (), "give a file with at least one channel of numbers")
    return tuple(result) if len(result) > 1 else (Topic("", result[0].table),)


def _name(log: Any, number: int) -> str:
    return getattr(log.groups[number].channel_group, "acq_name", None) or f"group {number + 1}"


def _topic(path: Path, log: Any, number: int, name: str) -> Topic | None:
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {"time": "s"}
    for index, channel in enumerate(log.groups[number].channels):
        signal = log.get(group=number, index=index)
        if signal.samples.dtype.kind not in "fiub" or signal.samples.ndim != 1:
            continue
        columns.setdefault("time", np.asarray(signal.timestamps, dtype=float))
        if channel.channel_type in (2, 3):  # the master channel is the clock itself
            continue
        columns[channel.name], units[channel.name] = signal.samples, signal.unit or ""
    return (
        Topic(name, table_of_columns(path, columns, units, place=name))
        if len(columns) > 1
        else None
    )
