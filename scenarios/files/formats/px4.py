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
MOST_READS_WITHOUT_PROGRESS = 100_000
CLOCK = "timestamp"  # microseconds since the start of the autopilot


class _LogBytes(io.BytesIO):
    """The bytes of a log, with an error after many reads without new bytes: the library does not
    end in some damaged logs.
    """

    furthest, reads_without_progress = 0, 0

    def read(self, size: int | None = -1, /) -> bytes:
        """Read as ``BytesIO``. Raise EOFError after too many reads without new bytes."""
        content = super().read(size)
        if self.tell() > self.furthest:
            self.furthest, self.reads_without_progress = self.tell(), 0
        else:
            self.reads_without_progress += 1
        if self.reads_without_progress > MOST_READS_WITHOUT_PROGRESS:
            raise EOFError("it is damaged")
        return content


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the topics ``message`` and, for further instances, ``message_1``, ... Arrays are
    columns such as ``q[0]``.
    """
    try:
        from pyulog import ULog
    except ImportError as error:
        raise missing_library(error, path, FORMAT, EXTRA) from None
    try:
        log = ULog(_LogBytes(raw))
        messages = [
            (
                item.name,
                item.multi_id,
                {name: np.asarray(values) for name, values in item.data.items()},
            )
            for item in log.data_list
        ]
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, FORMAT) from None
    topics = []
    for message, instance, columns in sorted(messages, key=lambda item: (item[0], item[1])):
        name = f"{message}_{instance}" if instance else message
        table = table_of_columns(path, columns, {CLOCK: "us"}, place=f"topic {name}")
        topics.append(Topic(name, table))
    if not topics:
        raise no_table(path, (), "log at least one topic")
    lost_time = sum(int(dropout.duration) for dropout in log.dropouts)  # ms
    if lost_time:
        note = (
            f"the logger dropped data {len(log.dropouts)} times, {lost_time / 1000.0:.2f} s in all"
        )
        topics[0] = Topic(topics[0].name, topics[0].table, (note,))
    return tuple(topics)
