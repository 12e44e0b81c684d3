"""Records and results as files: CSV that reads back bit for bit, and strict JSON."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.channel_names import TIME
from scenarios.files.escaping import escaped
from scenarios.files.measured.sidecar import SCHEMA, SIMULATED
from sim.errors import FlightidError
from sim.record import Record

_SHORT = 40  # characters of a file's name that its temporary one has, so that a long name can be used
RESPONSE, PREDICTED, TRUE = "response", "predicted_", "true_"  # a study's outputs over time: its file, and what stands before their names


def write_record(folder: str | Path, record: Record, stem: str = "record", *, simulated: bool = False) -> tuple[Path, Path]:
    """Write ``stem.csv`` and ``stem.json`` and return their paths.

    The CSV has plain names and SI units, each number in the shortest decimal form that reads back as the same
    float, an empty cell where a sample is missing. The JSON has the name, the hold of the inputs, the units, and
    that the data are ``simulated`` where they are.
    """
    table, sidecar = Path(folder) / f"{stem}.csv", Path(folder) / f"{stem}.json"
    columns = [record.time, *(channel.with_gaps() for channel in record.channels)]
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([TIME, *(channel.name for channel in record.channels)])
    writer.writerows(
        ["" if math.isnan(value) else repr(value) for value in row] for row in zip(*(column.tolist() for column in columns), strict=True)
    )
    write_text(table, text.getvalue())
    units = {TIME: "s", **{channel.name: channel.unit for channel in record.channels}}
    origin = {"origin": SIMULATED} if simulated else {}
    write_json(sidecar, {"schema": SCHEMA, "name": record.name, "hold": record.hold.value, "units": units, **origin})
    return table, sidecar


def write_responses(path: Path, record: Record, predicted: Mapping[str, np.ndarray], true: Mapping[str, np.ndarray] | None = None) -> None:
    """Write ``time``, the inputs, and of each predicted output ``NAME``, ``predicted_NAME`` and, where known, ``true_NAME``.

    ``predicted`` and ``true``: ``(N,)`` by output at the record's samples. SI and radians; a cell is empty where there is no number.
    """
    columns: dict[str, np.ndarray] = {TIME: record.time}
    columns |= {channel.name: channel.with_gaps() for channel in record.inputs}
    for name, row in predicted.items():
        columns |= {name: record[name].with_gaps(), f"{PREDICTED}{name}": row}
        if true is not None and name in true:
            columns[f"{TRUE}{name}"] = true[name]
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    rows = zip(*(np.asarray(column, dtype=float).tolist() for column in columns.values()), strict=True)
    writer.writerows([f"{value:.9g}" if math.isfinite(value) else "" for value in row] for row in rows)
    path.write_text(text.getvalue(), encoding="utf-8", newline="\n")


def write_json(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write strict JSON: keys sorted, lists of plain values on one line, the same bytes for the same content.

    NumPy numbers and arrays, tuples, enums and paths are written as what they hold.

    Raises
    ------
    FlightidError : a NaN, an infinity, a None, a key that is no text or an object that JSON does not know; nothing is written.
    """
    write_text(Path(path), json_text(content, str(path)) + "\n")


def json_text(content: Mapping[str, Any], where: str = "JSON") -> str:
    """The text that ``write_json`` writes; ``where`` names the file in errors."""
    return escaped(_laid_out(_plain(content, where, ""), ""))


def write_text(path: Path, text: str) -> None:
    """Write a whole file or none, UTF-8: under another name beside it, then renamed.

    A byte of a file's name that is no UTF-8 is written as ``\\udcff``, which JSON reads back as it was. Raises OSError.
    """
    write_content(path, text.encode("utf-8", "backslashreplace"))


def write_content(path: Path, content: bytes) -> None:
    """Write a whole file or none, as ``write_text``."""
    part = path.with_name(f".{path.name[:_SHORT]}.part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


_DEVICES = frozenset({"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))})


def unportable(name: str) -> str:
    """Why a file or folder cannot have this name on every system, as the end of a sentence; empty where it can.

    Windows refuses some characters, names of devices, and an end of a point or a space.
    """
    refused = next((letter for letter in name if letter in '<>:"/\\|?*' or ord(letter) < 32), "")
    if refused:
        return f"has the character {refused!r}, which Windows allows in no file name"
    if name.split(".")[0].rstrip(" ").lower() in _DEVICES:
        return "is the name of a device on Windows"
    if not name or name[-1] in ". ":
        return "ends with a point or a space, which Windows takes away" if name else "is empty"
    return ""


def file_stems(names: Sequence[str]) -> dict[str, str]:
    """For each name a part of a file's name of letters, digits and ``_``; no two differ by upper and lower case alone."""
    stems: dict[str, str] = {}
    for name in dict.fromkeys(names):
        stem = "".join(letter if letter.isalnum() else "_" for letter in name)
        taken = {each.lower() for each in stems.values()}
        tries = (stem if n == 1 else f"{stem}_{n}" for n in range(1, len(names) + 2))
        stems[name] = next(each for each in tries if each.lower() not in taken)
    return stems


def _plain(value: Any, where: str, key: str) -> Any:
    """The value in JSON's own types; ``key`` is the path to it."""
    place = f"{where}, key {key}" if key else where
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Enum):
        value = value.value
    if isinstance(value, Mapping):
        for name in value:
            if not isinstance(name, str):
                raise FlightidError(f"the key {name!r} is not a text", where=place, remedy="use texts as keys")
        return {name: _plain(inner, where, f"{key}.{name}" if key else name) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner, where, f"{key}[{index}]") for index, inner in enumerate(value)]
    if isinstance(value, Path):
        return str(value)
    if value is None:
        raise FlightidError("there is no value", where=place, remedy="leave the key out")
    if isinstance(value, float) and not math.isfinite(value):
        raise FlightidError(f"{value} is not a finite number", where=place, remedy="leave the key out, or report the failure in words")
    if not isinstance(value, str | bool | int | float):
        raise FlightidError(f"a {type(value).__name__} cannot be written as JSON", where=place, remedy="write numbers, texts, lists and tables")
    return value


def _laid_out(value: Any, indent: str) -> str:
    inner = indent + "  "
    if isinstance(value, dict) and value:
        lines = [f"{inner}{json.dumps(key, ensure_ascii=False)}: {_laid_out(value[key], inner)}" for key in sorted(value)]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        return "[\n" + ",\n".join(inner + _laid_out(item, inner) for item in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
