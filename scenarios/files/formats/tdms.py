"""National Instruments TDMS files by npTDMS: each group is a topic; waveforms bring their clock as
start and increment.
"""

from __future__ import annotations

import io
from pathlib import Path

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
    """Return one topic for each group and length of channel; ``unit_string`` gives the units."""
    try:
        from nptdms import TdmsFile
    except ImportError as error:
        raise missing_library(error, path, FORMAT, EXTRA) from None
    topics: list[Topic] = []
    try:
        log = TdmsFile.read(io.BytesIO(raw))
        for group in log.groups():
            channels = [
                channel
                for channel in group.channels()
                if channel[:].dtype.kind in "fiubM" and len(channel)
            ]
            for rate in dict.fromkeys(
                (channel.properties.get("wf_increment"), len(channel)) for channel in channels
            ):
                mine = [
                    channel
                    for channel in channels
                    if (channel.properties.get("wf_increment"), len(channel)) == rate
                ]
                name = (
                    group.name
                    if not any(topic.name == group.name for topic in topics)
                    else f"{group.name} {len(mine[0])}"
                )
                columns = {channel.name: channel[:] for channel in mine}
                units = {
                    channel.name: str(channel.properties.get("unit_string", "")) for channel in mine
                }
                if rate[0] and not any(name.lower().startswith("time") for name in columns):
                    begin = float(mine[0].properties.get("wf_start_offset", 0.0))
                    columns = {"time": begin + float(rate[0]) * np.arange(rate[1]), **columns}
                    units["time"] = "s"
                topics.append(
                    Topic(name, table_of_columns(path, columns, units, place=f"group {name}"))
                )
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, FORMAT) from None
    if not topics:
        raise no_table(path, (), "give a file with at least one channel of numbers")
    return tuple(topics) if len(topics) > 1 else (Topic("", topics[0].table),)
