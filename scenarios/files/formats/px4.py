"""PX4 logs (ULog) by pyulog: each message and instance is a topic with its own clock in
microseconds.
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

FORMAT = "ULog"
SUFFIXES = (".ulg", ".ulog")
MAGIC = (b"ULog\x01\x12\x35",)
EXTRA = "drones"
NO_PROGRESS = 100_000  # reads
CLOCK = "timestamp"  # microseconds since the autopilot started


class _Forward(io.BytesIO):
    """The bytes of a log with limited reading: the library loops forever in some damaged logs."""

    furthest, idle = 0, 0

    def read(self, size: int | None = -1, /) -> bytes:
        """Read as ``BytesIO``; EOFError after many reads without new bytes."""
        content = super().read(size)
        self.idle = 0 if self.tell() > self.furthest else self.idle + 1
        self.furthest = max(self.furthest, self.tell())
        if self.idle > NO_PROGRESS:
            raise EOFError("it is damaged")
        return content


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Topics ``message`` or, of further instances, ``message_1``; arrays are columns such as
    ``q[0]``.
    """
    try:
        from pyulog import ULog
    except ImportError as error:
        raise missing_library(error, path, FORMAT, EXTRA) from None
    try:
        log = ULog(_Forward(raw))
        data = [
            (
                item.name,
                item.multi_id,
                {name: np.asarray(values) for name, values in item.data.items()},
            )
            for item in log.data_list
        ]
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, FORMAT) from None
    result = []
    for name, instance, columns in sorted(data, key=lambda item: (item[0], item[1])):
        topic = f"{name}_{instance}" if instance else name
        result.append(
            Topic(topic, table_of_columns(path, columns, {CLOCK: "us"}, place=f"topic {topic}"))
        )
    if not result:
        raise no_table(path, (), "log at least one topic")
    dropped = sum(int(dropout.duration) for dropout in log.dropouts)
    note = f"the logger dropped data {len(log.dropouts)} times, {dropped / 1000.0:.2f} s in all"
    return (
        (Topic(result[0].name, result[0].table, (note,)), *result[1:]) if dropped else tuple(result)
    )
