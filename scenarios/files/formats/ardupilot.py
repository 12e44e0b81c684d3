"""ArduPilot DataFlash logs by pymavlink: each message and instance is a topic with its own clock in
microseconds.

pymavlink reads the formats, the units and where each message of a binary log begins; the numbers
are then taken from the bytes with NumPy, which is as fast as a log of hundreds of megabytes needs.
A text log (``FMT, 128, 89, FMT, ...``, as ground stations export it) has one message a line, with
its numbers scaled already; it is split here, with pymavlink's formats and units.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.formats.cells import (
    Topic,
    begins_with,
    damaged,
    missing_library,
    no_table,
    table_of_columns,
)
from sim.errors import RecordError

FORMAT = "ArduPilot DataFlash"
SUFFIXES = (".bin",)
BINARY_START = b"\xa3\x95\x80"
TEXT = (b"\nFMT, 128,", b"\nFMT,128,")
MAGIC = (BINARY_START, *TEXT)
EXTRA = "drones"
HEADER_BYTES = 3  # bytes of a message before its fields
CLOCKS = {"TimeUS": "us", "TimeMS": "ms"}
FIXED_POINT = "cCeEL"  # format letters of scaled integers
ADMINISTRATION = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG", "CMD", "MODE", "EV", "ERR", "VER")
# messages that describe the others, in order of dependence
DECLARED = ("FMT", "UNIT", "MULT", "FMTU")


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Topics ``ATT``, ``IMU[0]``, ...: of messages with an instance field one for each instance."""
    try:
        from pymavlink import DFReader  # noqa: F401
    except ImportError as error:
        raise missing_library(error, path, FORMAT, EXTRA) from None
    text = not raw.startswith(BINARY_START) and any(begins_with(raw, mark) for mark in TEXT)
    result = _of_text(path, raw) if text else _of_bytes(path, raw)
    if not result:
        raise no_table(path, (), "give a log that holds messages")
    return tuple(sorted(result, key=lambda topic: topic.name))


def _of_bytes(path: Path, raw: bytes) -> list[Topic]:
    """Return the topics of a binary log."""
    from pymavlink.DFReader import DFReader_binary

    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "log.bin"  # it maps a file into memory and takes no bytes
        copy.write_bytes(raw)
        try:
            with _silent_process():
                reader = DFReader_binary(str(copy))
            content = np.frombuffer(raw, dtype=np.uint8)
            result = []
            for kind, layout in reader.formats.items():
                offsets = reader.offsets[kind] if kind < len(reader.offsets) else ()
                if _has_numbers(layout) and len(offsets):
                    fields = _fields(layout, content, np.asarray(offsets, dtype=np.int64))
                    result += _topics(path, layout, fields)
            reader.data_map.close()
            reader.filehandle.close()
        except Exception as error:  # a damaged file fails in many ways inside the library
            raise damaged(error, path, FORMAT) from None
    return result


def _of_text(path: Path, raw: bytes) -> list[Topic]:
    """The topics of a text log; lines that are no message of a declared format are left out and
    counted in a note."""
    lines: dict[str, list[str]] = {}
    for line in raw.decode("latin-1").splitlines():
        name, _, rest = line.partition(",")
        lines.setdefault(name.strip(), []).append(rest)
    try:
        layouts = _layouts(
            {name: [_cells(name, rest) for rest in lines.get(name, ())] for name in DECLARED}
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
            left = len(lines[name]) - len(rows)
            note = (
                f"{left} line{'s' * (left > 1)} of {name} with another number of cells than its "
                "format left out"
            )
            topics += _topics(
                path, layout, _numbers(layout, rows) if rows else None, (note,) if left else ()
            )
    except RecordError:
        raise
    except Exception as error:  # formats that pymavlink does not know, numbers that are none
        raise damaged(error, path, FORMAT) from None
    return topics


def _cells(name: str, rest: str) -> list[str]:
    """Return the cells of a message that describes others; the columns of a format are one cell."""
    return [cell.strip() for cell in rest.split(",", 4 if name == "FMT" else -1)]


def _layouts(declared: dict[str, list[list[str]]]) -> dict[str, Any]:
    """Name -> format of each message of a text log, with the units that the log states."""
    from pymavlink.DFReader import DFFormat

    layouts: dict[str, Any] = {}
    for kind, size, name, letters, columns in (
        cells for cells in declared["FMT"] if len(cells) == 5
    ):
        layouts[name] = DFFormat(int(kind), name, int(size), letters, columns)
    numbers = {layout.type: layout for layout in layouts.values()}
    units = {chr(int(cells[1])): cells[2] for cells in declared["UNIT"] if len(cells) == 3}
    # As pymavlink does for binary logs: multipliers are single-precision numbers that became
    # doubles.
    factors = {
        chr(int(cells[1])): float(f"{float(cells[2]):.7g}")
        for cells in declared["MULT"]
        if len(cells) == 3
    }
    for _, kind, unit_letters, factor_letters in (
        cells for cells in declared["FMTU"] if len(cells) == 4
    ):
        if int(kind) in numbers:
            numbers[int(kind)].set_unit_ids(unit_letters, units)
            numbers[int(kind)].set_mult_ids(factor_letters, factors)
    return layouts


def _numbers(layout: Any, rows: list[list[str]]) -> dict[str, np.ndarray]:
    """Return the numbers of one message by column, without texts and arrays."""
    columns: dict[str, np.ndarray] = {}
    every = zip(layout.columns, layout.msg_fmts, zip(*rows, strict=True), strict=True)
    for name, letter, cells in every:
        if _dtype(letter).startswith("S"):
            continue
        try:
            columns[name] = np.array(cells, dtype=float)
        except ValueError:
            continue  # a flight mode by its name, say
    return columns


def _has_numbers(layout: Any) -> bool:
    """Return whether messages of a format are measurements with a clock."""
    return layout.name not in ADMINISTRATION and any(column in CLOCKS for column in layout.columns)


@contextlib.contextmanager
def _silent_process() -> Iterator[None]:
    """The compiled part of the library writes to the process's own stderr, past Python."""
    try:
        saved = os.dup(2)
    except OSError:  # there is no such stream
        yield
        return
    try:
        with open(os.devnull, "wb") as nothing:
            os.dup2(nothing.fileno(), 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)


def _topics(
    path: Path, layout: Any, fields: dict[str, np.ndarray] | None, notes: tuple[str, ...] = ()
) -> list[Topic]:
    """Return the topics of one kind of message: one for each instance where it has several."""
    if fields is None or not any(column in CLOCKS for column in fields):
        return []
    units = {name: CLOCKS.get(name) or _unit(layout, name) for name in fields}
    instance = layout.instance_field
    if instance is None or instance not in fields:
        return [
            Topic(
                layout.name,
                table_of_columns(path, fields, units, place=f"message {layout.name}"),
                notes,
            )
        ]
    topics: list[Topic] = []
    for number in np.unique(fields[instance][np.isfinite(fields[instance])]):
        mine, name = fields[instance] == number, f"{layout.name}[{int(number)}]"
        columns = {column: values[mine] for column, values in fields.items()}
        topics.append(
            Topic(
                name,
                table_of_columns(path, columns, units, place=f"message {name}"),
                () if topics else notes,
            )
        )
    return topics


def _fields(layout: Any, content: np.ndarray, offsets: np.ndarray) -> dict[str, np.ndarray] | None:
    """Column -> numbers of all messages of one kind; texts and arrays are left out, as is a message
    that the file's end cuts.
    """
    formats = [letter for letter in layout.msg_fmts]
    kinds = np.dtype([(f"f{n}", _dtype(letter)) for n, letter in enumerate(formats)])
    offsets = offsets[offsets + HEADER_BYTES + kinds.itemsize <= content.size]
    if not offsets.size or len(formats) != len(layout.columns):
        return None
    rows = np.lib.stride_tricks.sliding_window_view(content, kinds.itemsize)[offsets + HEADER_BYTES]
    values = np.ascontiguousarray(rows).view(kinds)[:, 0]
    columns: dict[str, np.ndarray] = {}
    for n, (name, letter, multiplier) in enumerate(
        zip(layout.columns, formats, layout.msg_mults, strict=True)
    ):
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
    """The unit that the log states for a column, in our spelling; empty if it states none."""
    return _OURS.get(text, text) if (text := layout.get_unit(column)) else ""


_OURS = {
    "degheading": "deg",
    "deglatitude": "deg",
    "deglongitude": "deg",
    "m/s/s": "m/s2",
    "deg/s/s": "deg/s2",
    "PWM": "",
    "instance": "",
    "%": "%",
}
