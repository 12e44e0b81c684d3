"""Logs of autopilots, ArduPilot and PX4: each message and instance is a topic with its own clock in
microseconds.

Of a binary log of ArduPilot, pymavlink reads the formats, the units, and the positions of the
messages. NumPy then reads the numbers from the bytes, since a log may have hundreds of megabytes. A
text log (``FMT, 128, 89, FMT, ...``), as ground stations export it, has one message in each line,
with scaled numbers. Its lines are split here, with the formats and units of pymavlink.
"""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.formats.cells import (
    Reader,
    Topic,
    begins_with,
    damaged,
    missing_library,
    no_table,
    table_of_columns,
)
from sim.errors import RecordError

# ---- ArduPilot DataFlash logs by pymavlink

BINARY_START = b"\xa3\x95\x80"
TEXT_STARTS = (b"\nFMT, 128,", b"\nFMT,128,")
HEADER_BYTES = 3  # bytes of a message before its fields
CLOCKS = {"TimeUS": "us", "TimeMS": "ms"}
FIXED_POINT = "cCeEL"  # format letters of scaled integers
# messages that are no measurements
ADMINISTRATION = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "CMD", "MODE", "EV", "ERR", "VER")
DESCRIPTIONS = ("FMT", "UNIT", "MULT", "FMTU")  # messages that describe the format of the others


def read_ardupilot(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the topics ``ATT``, ``IMU[0]``, ...: one for each message, or for each instance of a
    message with an instance field.
    """
    try:
        from pymavlink import DFReader  # noqa: F401
    except ImportError as error:
        raise missing_library(error, path, "ArduPilot DataFlash", "drones") from None
    is_text = any(begins_with(raw, mark) for mark in TEXT_STARTS)
    if is_text and not raw.startswith(BINARY_START):
        topics = _topics_of_text(path, raw)
    else:
        topics = _topics_of_bytes(path, raw)
    if not topics:
        raise no_table(path, (), "give a log that holds messages")
    return tuple(sorted(topics, key=lambda topic: topic.name))


def _topics_of_bytes(path: Path, raw: bytes) -> list[Topic]:
    from pymavlink.DFReader import DFReader_binary

    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "log.bin"  # the library needs a file
        copy.write_bytes(raw)
        try:
            with _silent_process():
                reader = DFReader_binary(str(copy))
            content = np.frombuffer(raw, dtype=np.uint8)
            topics = []
            for kind, layout in reader.formats.items():
                offsets = reader.offsets[kind] if kind < len(reader.offsets) else ()
                if _has_numbers(layout) and len(offsets):
                    fields = _fields(layout, content, np.asarray(offsets, dtype=np.int64))
                    topics += _topics_of_message(path, layout, fields)
            reader.data_map.close()
            reader.filehandle.close()
        except Exception as error:  # a damaged file fails in many ways inside the library
            raise damaged(error, path, "ArduPilot DataFlash") from None
    return topics


def _topics_of_text(path: Path, raw: bytes) -> list[Topic]:
    """Return the topics of a text log. Lines with another number of cells than their format are
    left out; a note has their number.
    """
    lines: dict[str, list[str]] = {}
    for line in raw.decode("latin-1").splitlines():
        name, _, rest = line.partition(",")
        lines.setdefault(name.strip(), []).append(rest)
    try:
        layouts = _layouts(
            {name: [_cells(name, rest) for rest in lines.get(name, ())] for name in DESCRIPTIONS}
        )
        topics: list[Topic] = []
        for name, layout in layouts.items():
            if (
                not _has_numbers(layout)
                or name not in lines
                or len(layout.msg_fmts) != len(layout.columns)
            ):
                continue
            rows = [
                cells
                for rest in lines[name]
                if len(cells := rest.split(",")) == len(layout.columns)
            ]
            omitted = len(lines[name]) - len(rows)
            note = (
                f"{omitted} line{'s' * (omitted > 1)} of {name} with another number of cells than "
                "its format left out"
            )
            fields = _numbers(layout, rows) if rows else None
            topics += _topics_of_message(path, layout, fields, (note,) if omitted else ())
    except RecordError:
        raise
    except Exception as error:  # formats that pymavlink does not know, cells that are no numbers
        raise damaged(error, path, "ArduPilot DataFlash") from None
    return topics


def _cells(name: str, rest: str) -> list[str]:
    """Return the cells of a message that describes others. The names of the columns of a format
    remain one cell.
    """
    return [cell.strip() for cell in rest.split(",", 4 if name == "FMT" else -1)]


def _layouts(descriptions: dict[str, list[list[str]]]) -> dict[str, Any]:
    """Return name -> format of each message of a text log, with the units that the log states.

    ``descriptions`` has the cells of each message in ``DESCRIPTIONS``.
    """
    from pymavlink.DFReader import DFFormat

    layouts: dict[str, Any] = {}
    for kind, size, name, letters, columns in (
        cells for cells in descriptions["FMT"] if len(cells) == 5
    ):
        layouts[name] = DFFormat(int(kind), name, int(size), letters, columns)
    layout_by_kind = {layout.type: layout for layout in layouts.values()}
    units = {chr(int(cells[1])): cells[2] for cells in descriptions["UNIT"] if len(cells) == 3}
    # Multipliers are numbers of single precision in the log: seven digits are exact, as in
    # pymavlink for binary logs.
    factors = {
        chr(int(cells[1])): float(f"{float(cells[2]):.7g}")
        for cells in descriptions["MULT"]
        if len(cells) == 3
    }
    for _, kind, unit_letters, factor_letters in (
        cells for cells in descriptions["FMTU"] if len(cells) == 4
    ):
        if int(kind) in layout_by_kind:
            layout_by_kind[int(kind)].set_unit_ids(unit_letters, units)
            layout_by_kind[int(kind)].set_mult_ids(factor_letters, factors)
    return layouts


def _numbers(layout: Any, rows: list[list[str]]) -> dict[str, np.ndarray]:
    """Return column -> numbers of one message, without texts and arrays."""
    columns: dict[str, np.ndarray] = {}
    cells_by_column = zip(*rows, strict=True)
    for name, letter, cells in zip(layout.columns, layout.msg_fmts, cells_by_column, strict=True):
        if _dtype(letter).startswith("S"):
            continue
        try:
            columns[name] = np.array(cells, dtype=float)
        except ValueError:
            continue  # a text, as the name of a flight mode
    return columns


def _has_numbers(layout: Any) -> bool:
    """Return whether messages of a format are measurements with a clock."""
    return layout.name not in ADMINISTRATION and any(column in CLOCKS for column in layout.columns)


@contextlib.contextmanager
def _silent_process() -> Iterator[None]:
    """Suppress the error stream of the process, to which the compiled part of the library writes
    directly.
    """
    try:
        saved = os.dup(2)
    except OSError:  # the process has no error stream
        yield
        return
    try:
        with open(os.devnull, "wb") as null_device:
            os.dup2(null_device.fileno(), 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


def _topics_of_message(
    path: Path, layout: Any, fields: dict[str, np.ndarray] | None, notes: tuple[str, ...] = ()
) -> list[Topic]:
    """Return the topic of one kind of message, or the topics of its instances. The first one has
    the notes.
    """
    if fields is None or not any(column in CLOCKS for column in fields):
        return []
    units = {name: CLOCKS.get(name) or _unit(layout, name) for name in fields}
    instance = layout.instance_field
    if instance is None or instance not in fields:
        table = table_of_columns(path, fields, units, place=f"message {layout.name}")
        return [Topic(layout.name, table, notes)]
    topics: list[Topic] = []
    for number in np.unique(fields[instance][np.isfinite(fields[instance])]):
        name = f"{layout.name}[{int(number)}]"
        rows = fields[instance] == number
        columns = {column: values[rows] for column, values in fields.items()}
        table = table_of_columns(path, columns, units, place=f"message {name}")
        topics.append(Topic(name, table, () if topics else notes))
    return topics


def _fields(layout: Any, content: np.ndarray, offsets: np.ndarray) -> dict[str, np.ndarray] | None:
    """Return column -> numbers of all messages of one kind, without texts and arrays; None if there
    are none. A message that the file has only in part is left out.

    ``content`` are the bytes of the file, and ``offsets`` the positions of the messages.
    """
    letters = list(layout.msg_fmts)
    row_type = np.dtype([(f"f{n}", _dtype(letter)) for n, letter in enumerate(letters)])
    size = row_type.itemsize
    offsets = offsets[offsets + HEADER_BYTES + size <= content.size]
    if not offsets.size or len(letters) != len(layout.columns):
        return None
    rows = np.lib.stride_tricks.sliding_window_view(content, size)[offsets + HEADER_BYTES]
    fields = np.ascontiguousarray(rows).view(row_type)[:, 0]
    columns: dict[str, np.ndarray] = {}
    for n, (name, letter, multiplier) in enumerate(
        zip(layout.columns, letters, layout.msg_mults, strict=True)
    ):
        values = fields[f"f{n}"]
        if values.dtype.kind in "fiu" and values.ndim == 1:
            factor = multiplier if letter in FIXED_POINT and multiplier is not None else 1.0
            columns[name] = values.astype(float) * factor
    return columns


def _dtype(letter: str) -> str:
    """Return the type in NumPy of a format letter, from its struct code in pymavlink."""
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    code = FORMAT_TO_STRUCT[letter][0]
    return f"S{code[:-1]}" if code.endswith("s") else f"<{code}"


def _unit(layout: Any, column: str) -> str:
    """Return the unit that the log states for a column, as `scenarios.files.units` writes it; empty
    if the log states none.
    """
    text = layout.get_unit(column)
    return _UNIT_SPELLINGS.get(text, text) if text else ""


_UNIT_SPELLINGS = {
    "degheading": "deg",
    "deglatitude": "deg",
    "deglongitude": "deg",
    "m/s/s": "m/s2",
    "deg/s/s": "deg/s2",
    "PWM": "",
    "instance": "",
    "%": "%",
}


# ---- PX4 logs (ULog) by pyulog

MOST_READS_WITHOUT_PROGRESS = 100_000
CLOCK = "timestamp"  # microseconds since the start of the autopilot


class _LogBytes(io.BytesIO):
    """The bytes of a log, with an error after many reads without new bytes: the library does not
    end in some damaged logs.
    """

    furthest, reads_without_progress = 0, 0

    def read_px4(self, size: int | None = -1, /) -> bytes:
        """Read as ``BytesIO``. Raise EOFError after too many reads without new bytes."""
        content = super().read(size)
        if self.tell() > self.furthest:
            self.furthest, self.reads_without_progress = self.tell(), 0
        else:
            self.reads_without_progress += 1
        if self.reads_without_progress > MOST_READS_WITHOUT_PROGRESS:
            raise EOFError("it is damaged")
        return content


def read_px4(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the topics ``message`` and, for further instances, ``message_1``, ... Arrays are
    columns such as ``q[0]``.
    """
    try:
        from pyulog import ULog
    except ImportError as error:
        raise missing_library(error, path, "ULog", "drones") from None
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
        raise damaged(error, path, "ULog") from None
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


READERS = (
    Reader("ArduPilot DataFlash", (".bin",), (BINARY_START, *TEXT_STARTS), read_ardupilot),
    Reader("ULog", (".ulg", ".ulog"), (b"ULog\x01\x12\x35",), read_px4),
)
