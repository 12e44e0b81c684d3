"""National Instruments TDMS files by npTDMS: each group is a topic. A waveform has its clock as
start and increment.
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

FORMAT = "TDMS"
SUFFIXES = (".tdms",)
MAGIC = (b"TDSm",)
EXTRA = "recorders"


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return one topic for the channels of a group with equal increments and lengths. The property
    ``unit_string`` has the units.
    """
    try:
        from nptdms import TdmsFile
    except ImportError as error:
        raise missing_library(error, path, FORMAT, EXTRA) from None
    topics: list[Topic] = []
    try:
        log = TdmsFile.read(io.BytesIO(raw))
        for group in log.groups():
            channels_by_clock: dict[tuple[Any, int], list[Any]] = {}
            for channel in group.channels():
                if channel[:].dtype.kind in "fiubM" and len(channel):
                    clock = (channel.properties.get("wf_increment"), len(channel))
                    channels_by_clock.setdefault(clock, []).append(channel)
            for (increment, count), channels in channels_by_clock.items():
                name = group.name
                if any(topic.name == group.name for topic in topics):
                    name = f"{group.name} {count}"
                columns = {channel.name: channel[:] for channel in channels}
                units = {
                    channel.name: str(channel.properties.get("unit_string", ""))
                    for channel in channels
                }
                has_time = any(column.lower().startswith("time") for column in columns)
                if increment and not has_time:
                    begin = float(channels[0].properties.get("wf_start_offset", 0.0))
                    columns = {"time": begin + float(increment) * np.arange(count), **columns}
                    units["time"] = "s"
                table = table_of_columns(path, columns, units, place=f"group {name}")
                topics.append(Topic(name, table))
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, FORMAT) from None
    if not topics:
        raise no_table(path, (), "give a file with at least one channel of numbers")
    return tuple(topics) if len(topics) > 1 else (Topic("", topics[0].table),)
