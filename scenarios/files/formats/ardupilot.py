"""ArduPilot DataFlash logs by pymavlink: each message and instance is a topic with its own clock in microseconds.

pymavlink reads the formats, the units and where each message begins; the numbers are then taken from the bytes with NumPy, which is as
fast as a log of hundreds of megabytes needs.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.formats.topic import Topic, damaged, missing_library, no_table, table_of_columns

FORMAT = "ArduPilot DataFlash"
SUFFIXES = (".bin",)
MAGIC = (b"\xa3\x95\x80",)
EXTRA = "drones"
HEAD = 3  # bytes of a message before its fields
CLOCKS = {"TimeUS": "us", "TimeMS": "ms"}
FIXED_POINT = "cCeEL"  # format letters whose integers are scaled
ADMINISTRATION = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "CMD", "MODE", "EV", "ERR", "VER")


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Topics ``ATT``, ``IMU[0]``, ...: of messages with an instance field one for each instance."""
    try:
        from pymavlink.DFReader import DFReader_binary
    except ImportError as error:
        raise missing_library(error, path, FORMAT, EXTRA) from None
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "log.bin"  # it maps a file into memory and takes no bytes
        copy.write_bytes(raw)
        try:
            with _silent_process():
                reader = DFReader_binary(str(copy))
            content = np.frombuffer(raw, dtype=np.uint8)
            found = [topic for kind in reader.formats for topic in _topics(path, content, reader, kind)]
            reader.data_map.close()
            reader.filehandle.close()
        except Exception as error:  # a damaged file fails in many ways inside the library
            raise damaged(error, path, FORMAT) from None
    if not found:
        raise no_table(path, (), "give a log that holds messages")
    return tuple(sorted(found, key=lambda topic: topic.name))


@contextlib.contextmanager
def _silent_process() -> Iterator[None]:
    """The compiled part of the library writes to the process's own stderr, past Python."""
    try:
        kept = os.dup(2)
    except OSError:  # there is no such stream
        yield
        return
    try:
        with open(os.devnull, "wb") as nothing:
            os.dup2(nothing.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _topics(path: Path, content: np.ndarray, reader: Any, kind: int) -> list[Topic]:
    """The topics of one kind of message."""
    layout, offsets = reader.formats[kind], reader.offsets[kind] if kind < len(reader.offsets) else ()
    if layout.name in ADMINISTRATION or not len(offsets) or not any(column in CLOCKS for column in layout.columns):
        return []
    fields = _fields(layout, content, np.asarray(offsets, dtype=np.int64))
    if fields is None:
        return []
    units = {name: CLOCKS.get(name) or _unit(layout, name) for name in fields}
    instance = layout.instance_field
    if instance is None or instance not in fields:
        return [Topic(layout.name, table_of_columns(path, fields, units, place=f"message {layout.name}"))]
    found = []
    for number in np.unique(fields[instance]):
        mine, name = fields[instance] == number, f"{layout.name}[{int(number)}]"
        columns = {column: values[mine] for column, values in fields.items()}
        found.append(Topic(name, table_of_columns(path, columns, units, place=f"message {name}")))
    return found


def _fields(layout: Any, content: np.ndarray, offsets: np.ndarray) -> dict[str, np.ndarray] | None:
    """Column -> numbers of all messages of one kind; texts and arrays are left out, as is a message that the file's end cuts."""
    formats = [letter for letter in layout.msg_fmts]
    kinds = np.dtype([(f"f{n}", _dtype(letter)) for n, letter in enumerate(formats)])
    offsets = offsets[offsets + HEAD + kinds.itemsize <= content.size]
    if not offsets.size or len(formats) != len(layout.columns):
        return None
    rows = np.lib.stride_tricks.sliding_window_view(content, kinds.itemsize)[offsets + HEAD]
    values = np.ascontiguousarray(rows).view(kinds)[:, 0]
    columns: dict[str, np.ndarray] = {}
    for n, (name, letter, multiplier) in enumerate(zip(layout.columns, formats, layout.msg_mults, strict=True)):
        if values[f"f{n}"].dtype.kind in "fiu" and values[f"f{n}"].ndim == 1:
            scaled = multiplier if letter in FIXED_POINT and multiplier is not None else 1.0
            columns[name] = values[f"f{n}"].astype(float) * scaled
    return columns


def _dtype(letter: str) -> str:
    """NumPy's type of a format letter, by the struct code that pymavlink has for it."""
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    code = FORMAT_TO_STRUCT[letter][0]
    return f"S{code[:-1]}" if code.endswith("s") else f"<{code}"


def _unit(layout: Any, column: str) -> str:
    """The unit that the log states for a column, in our spelling; empty where it states none."""
    return _OURS.get(text, text) if (text := layout.get_unit(column)) else ""


_OURS = {"degheading": "deg", "deglatitude": "deg", "deglongitude": "deg", "m/s/s": "m/s2", "deg/s/s": "deg/s2", "PWM": "", "instance": "", "%": "%"}
