"""Write records and results as files, and study folders as a whole."""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import json
import math
import os
import shutil
import signal
import tempfile
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.declarations import TIME
from scenarios.files.measured.columns import SCHEMA, SIMULATED
from scenarios.files.sources import escaped, json_or_none, resolved
from sim.errors import FlightidError
from sim.record import Record

# ---- Records and results as files: CSV that reads back bit for bit, and strict JSON

# characters of a file's name that its temporary one has, so that a long name can be used
_TEMPORARY_NAME_LETTERS = 40
RESPONSE = "response"  # file of a study's outputs over time
PREDICTED = "predicted_"  # prefix of predicted outputs
TRUE = "true_"  # prefix of true outputs


def write_record(
    folder: str | Path, record: Record, stem: str = "record", *, simulated: bool = False
) -> tuple[Path, Path]:
    """Write ``stem.csv`` and ``stem.json`` and return their paths.

    The CSV has plain names and SI units, each number in the shortest decimal form that reads back
    as the same float, an empty cell where a sample is missing. The JSON has the name, the hold of
    the inputs, the units, and that the data are ``simulated`` where they are.
    """
    table, sidecar = Path(folder) / f"{stem}.csv", Path(folder) / f"{stem}.json"
    columns = [record.time, *(channel.with_gaps() for channel in record.channels)]
    rows = (
        ["" if math.isnan(value) else repr(value) for value in row]
        for row in zip(*(column.tolist() for column in columns), strict=True)
    )
    write_text(table, csv_text([TIME, *(channel.name for channel in record.channels)], rows))
    units = {TIME: "s", **{channel.name: channel.unit for channel in record.channels}}
    origin = {"origin": SIMULATED} if simulated else {}
    write_json(
        sidecar,
        {
            "schema": SCHEMA,
            "name": record.name,
            "hold": record.hold.value,
            "units": units,
            **origin,
        },
    )
    return table, sidecar


def write_responses(
    path: Path,
    record: Record,
    predicted: Mapping[str, np.ndarray],
    true: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write ``time``, the inputs, and of each predicted output ``NAME``, ``predicted_NAME`` and,
    where known, ``true_NAME``.

    ``predicted`` and ``true``: ``(N,)`` by output at the record's samples. SI and radians; a cell
    is empty if there is no number.
    """
    columns: dict[str, np.ndarray] = {TIME: record.time}
    columns |= {channel.name: channel.with_gaps() for channel in record.inputs}
    for name, row in predicted.items():
        columns |= {name: record[name].with_gaps(), f"{PREDICTED}{name}": row}
        if true is not None and name in true:
            columns[f"{TRUE}{name}"] = true[name]
    rows = zip(
        *(np.asarray(column, dtype=float).tolist() for column in columns.values()), strict=True
    )
    cells = ([f"{value:.9g}" if math.isfinite(value) else "" for value in row] for row in rows)
    write_text(path, csv_text(columns, cells))


def write_json(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write strict JSON: keys sorted, lists of plain values on one line, the same bytes for the
    same content.

    NumPy numbers and arrays, tuples, enums and paths are written as their values.

    Raises
    ------
    FlightidError : a NaN, an infinity, a None, a key that is no text or an object that JSON does
        not know; nothing is written.
    """
    write_text(Path(path), json_text(content, str(path)) + "\n")


def json_text(content: Mapping[str, Any], where: str = "JSON") -> str:
    """Return the text that ``write_json`` writes; ``where`` names the file in errors."""
    return escaped(_laid_out(_json_value(content, where, ""), ""))


def csv_text(header: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """Return a table as the text of a CSV file: its header, then its rows."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 file completely or not at all, by renaming a temporary file. Raises OSError.

    Bytes of file names that are not UTF-8 are written as ``\\udcff``, which JSON restores.
    """
    write_content(path, text.encode("utf-8", "backslashreplace"))


def write_content(path: Path, content: bytes) -> None:
    """Write a whole file or none, as ``write_text``."""
    part = path.with_name(f".{path.name[:_TEMPORARY_NAME_LETTERS]}.part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


_DEVICES = frozenset(
    {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}
)


def unportable(name: str) -> str:
    """Return why a file or folder cannot have this name on every system, as the end of a sentence;
    empty if it can.

    Windows refuses some characters, names of devices, and a final point or space.
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
    """Part of a file name for each name, of letters, digits and ``_``; no two differ only in upper
    and lower case.
    """
    stems: dict[str, str] = {}
    for name in dict.fromkeys(names):
        stem = "".join(letter if letter.isalnum() else "_" for letter in name)
        taken = {each.lower() for each in stems.values()}
        tries = (stem if n == 1 else f"{stem}_{n}" for n in range(1, len(names) + 2))
        stems[name] = next(each for each in tries if each.lower() not in taken)
    return stems


def _json_value(value: Any, where: str, key: str) -> Any:
    """Return the value in JSON's own types; ``key`` is the path to it."""
    place = f"{where}, key {key}" if key else where
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, Enum):
        value = value.value
    if isinstance(value, Mapping):
        for name in value:
            if not isinstance(name, str):
                raise FlightidError(
                    f"the key {name!r} is not a text", where=place, remedy="use texts as keys"
                )
        return {
            name: _json_value(inner, where, f"{key}.{name}" if key else name)
            for name, inner in value.items()
        }
    if isinstance(value, list | tuple):
        return [_json_value(inner, where, f"{key}[{index}]") for index, inner in enumerate(value)]
    if isinstance(value, Path):
        return str(value)
    if value is None:
        raise FlightidError("there is no value", where=place, remedy="leave the key out")
    if isinstance(value, float) and not math.isfinite(value):
        raise FlightidError(
            f"{value} is not a finite number",
            where=place,
            remedy="leave the key out, or report the failure in words",
        )
    if not isinstance(value, str | bool | int | float):
        raise FlightidError(
            f"a {type(value).__name__} cannot be written as JSON",
            where=place,
            remedy="write numbers, texts, lists and tables",
        )
    return value


def _laid_out(value: Any, indent: str) -> str:
    inner = indent + "  "
    if isinstance(value, dict) and value:
        lines = [
            f"{inner}{json.dumps(key, ensure_ascii=False)}: {_laid_out(value[key], inner)}"
            for key in sorted(value)
        ]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        return "[\n" + ",\n".join(inner + _laid_out(item, inner) for item in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


# ---- The study folder

MANIFEST = "files"
# characters of a folder's name that its temporary one has, so that a long name can be used
_folders_SHORT = 40
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
_ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


class _Scratch:
    """A temporary folder, and two spare open files, which its removal needs if all others are used
    up.
    """

    def __init__(self, beside: Path, name: str) -> None:
        self.path = Path(tempfile.mkdtemp(prefix=f".{name[:_folders_SHORT]}-", dir=beside))
        self._aside: list[int] = []
        with contextlib.suppress(OSError):
            self._aside += [os.open(os.devnull, os.O_RDONLY) for _ in range(2)]

    def remove(self) -> None:
        """Remove the folder with all that is in it."""
        while self._aside:
            os.close(self._aside.pop())
        shutil.rmtree(self.path, ignore_errors=True)


@contextmanager
def study_folder(path: str | Path, main: str) -> Iterator[Path]:
    """A temporary folder to write a study into; on leaving, its files become those of ``path``.

    ``path`` may be missing, empty, or hold an older run. ``main`` is the study's own JSON
    (``"comparison.json"``, ``"diagnosis.json"``): it must be written, gets the list of all files
    under the key ``files``, and is renamed last, so a folder with a new ``main`` is a complete one.

    Files of an older run are removed if its ``main`` lists them, the new run did not write them,
    and no other study in the folder lists them. Other files are kept. If the body raises, the
    folder is not changed.

    Raises
    ------
    FlightidError : ``path`` is a file or cannot be written, or a folder stands where a file of ours
        should go.
    """
    target = resolved(path)
    if os.path.lexists(target) and not os.path.isdir(target):
        what = (
            "this is a link that leads nowhere"
            if os.path.islink(target)
            else "this is a file, not a folder"
        )
        raise FlightidError(what, where=str(path), remedy="name another folder")
    made: list[Path] = []
    scratch: _Scratch | None = None
    try:
        try:
            _make(target.parent, made)
            scratch = _Scratch(target.parent, target.name)
        except OSError as error:
            raise unwritable(path, error) from None
        try:
            yield scratch.path
        except OSError as error:
            if error.errno in _FULL:
                raise unwritable(path, error) from None
            raise
        try:
            with _uninterrupted(path):
                _move_in(scratch.path, target, main, made)
        except OSError as error:
            raise unwritable(path, error) from None
    except BaseException:
        if scratch is not None:
            scratch.remove()
        _unmake(made)
        raise
    scratch.remove()


@contextmanager
def files_together(named: Path) -> Iterator[Path]:
    """Context manager: temporary folder for a record and its accompanying files.

    At the end, all files are moved into the folder of ``named``, or none. ``named`` is the file
    that the user requested; it is replaced. Other existing files are only replaced if an earlier
    call wrote them, which their JSON schema shows.

    Raises
    ------
    FlightidError : the folder cannot be written, or a file of somebody else has the name of one of
        ours.
    """
    target = named.parent
    made: list[Path] = []
    scratch: _Scratch | None = None
    try:
        try:
            _make(target, made)
            scratch = _Scratch(target, named.stem)
            yield scratch.path
            _refuse_strangers(scratch.path, named)
            with _uninterrupted(named):
                for name in sorted(
                    os.listdir(scratch.path), key=lambda name: (name == named.name, name)
                ):
                    os.replace(scratch.path / name, target / name)
        except OSError as error:
            raise unwritable(named, error) from None
    except BaseException:
        if scratch is not None:
            scratch.remove()
        _unmake(made)
        raise
    scratch.remove()


def _refuse_strangers(scratch: Path, named: Path) -> None:
    """Raise FlightidError if a file to be written exists and was not written by flightid."""
    beside = [named.parent / name for name in sorted(os.listdir(scratch)) if name != named.name]
    ours = {path for path in beside if path.suffix == ".json" and _is_ours(path)}
    for path in (named, *beside):
        if path.is_dir() or (
            path in beside
            and os.path.lexists(path)
            and path not in ours
            and (path.suffix == ".json" or not ours)
        ):
            what = (
                "it stands where a file that goes with the record has to go, and flightid did not "
                "write it"
            )
            raise FlightidError(
                what, where=str(path), remedy="move it away, or name another record file"
            )


def _is_ours(path: Path) -> bool:
    content = json_or_none(path)
    return isinstance(content, dict) and str(content.get("schema", "")).startswith("flightid/")


@contextmanager
def _uninterrupted(path: str | Path) -> Iterator[None]:
    """Delay signals until the files are in their place, so that a study is complete or absent."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    former = {
        number: signal.getsignal(number) for number in _ENDING if callable(signal.getsignal(number))
    }
    for number in former:
        signal.signal(number, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)
    for number in came:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(number)
        raise KeyboardInterrupt(f"the study in {path} is whole")


def listed_files(main: Path) -> frozenset[str]:
    """Files that a study's JSON lists; empty for any other file."""
    content = json_or_none(main)
    if not isinstance(content, dict) or not str(content.get("schema", "")).startswith("flightid/"):
        return frozenset()
    names = content.get(MANIFEST)
    return (
        frozenset(name for name in names if isinstance(name, str) and _is_bare_name(name))
        if isinstance(names, list)
        else frozenset()
    )


def _move_in(scratch: Path, target: Path, main: str, made: list[Path]) -> None:
    written = sorted(entry.name for entry in scratch.iterdir())
    if main not in written:
        raise ValueError(f"the study did not write {main}")
    if not all((scratch / name).is_file() for name in written):
        raise ValueError("a study folder holds files only")
    _refuse_unportable(written)
    for name in written:
        if (target / name).is_dir():
            raise FlightidError(
                "a folder stands where a file has to go",
                where=str(target / name),
                remedy="move it away, or name another folder",
            )
    content = json.loads((scratch / main).read_bytes())
    write_json(scratch / main, {**content, MANIFEST: written})
    others = (
        [entry for entry in target.glob("*.json") if entry.name != main] if target.is_dir() else []
    )
    listed = set(written).union(*(listed_files(entry) for entry in others))
    stale = listed_files(target / main) - listed
    _make(target, made)
    for name in sorted(written, key=lambda name: (name == main, name.endswith(".json"), name)):
        if name == main:
            for old in sorted(stale):
                if (target / old).is_file():
                    (target / old).unlink()
        _rename(scratch / name, target / name)


def _refuse_unportable(names: Sequence[str]) -> None:
    """Raise ValueError if a name of a study's file is not allowed on every system."""
    for name in names:
        if why := unportable(name):
            raise ValueError(f"the name of the file {name!r} {why}")
    if len({name.lower() for name in names}) < len(names):
        raise ValueError("two files of a study differ by upper and lower case alone")


def _rename(source: Path, target: Path) -> None:
    try:
        os.replace(source, target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        # the folder is a mount point: its parent is on another disk
        part = target.with_name(f".{target.name}.part")
        shutil.copyfile(source, part)
        os.replace(part, target)


def _make(folder: Path, made: list[Path]) -> None:
    """Create a folder and its parents, and append those that were missing to ``made``."""
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    for parent in reversed(missing):
        parent.mkdir(exist_ok=True)
        made.append(parent)


def _unmake(made: list[Path]) -> None:
    """Remove folders that were created and are empty."""
    for folder in reversed(made):
        with contextlib.suppress(OSError):
            folder.rmdir()


def _is_bare_name(name: str) -> bool:
    """Whether a name has no folder in it: a study's list may only name files inside its folder."""
    return name not in ("", ".", "..") and "/" not in name and "\\" not in name and "\0" not in name


def unwritable(path: str | Path, error: OSError) -> FlightidError:
    """Return the error for a place that cannot be written, with the operating system's reason."""
    remedy = (
        "make room, or name a place on another disk"
        if error.errno in _FULL
        else "name a folder that you may write in"
    )
    return FlightidError(f"cannot be written ({error.strerror})", where=str(path), remedy=remedy)
