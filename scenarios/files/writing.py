"""Writing of records and results as files, and of study folders as a whole."""

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

# ---- Records and results as files: CSV with exact numbers, and strict JSON

# Letters of a name in the name of its temporary file or folder: more could exceed the limit of the
# file system.
_TEMPORARY_NAME_LETTERS = 40
RESPONSE = "response"  # file of a study's outputs over time
PREDICTED = "predicted_"  # prefix of predicted outputs
TRUE = "true_"  # prefix of true outputs


def write_record(
    folder: str | Path, record: Record, stem: str = "record", *, simulated: bool = False
) -> tuple[Path, Path]:
    """Write ``stem.csv`` and ``stem.json`` and return their paths.

    The CSV file has names without units, and values in SI units. Each number has the shortest
    decimal form of its float, and the cell of a missing sample is empty. The JSON file has the
    name, the hold of the inputs, the units, and the origin of ``simulated`` data.
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
    """Write time, inputs and outputs of a record with the predicted and the true outputs.

    The columns are ``time``, the inputs, and for each predicted output ``NAME``, ``predicted_NAME``
    and, if known, ``true_NAME``, in SI units and radians. The cell of a missing number is empty.

    Parameters
    ----------
    predicted, true : output -> ``(N,)`` values at the samples of the record.
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
    """Write strict JSON. The same content always gives the same bytes.

    Keys are sorted, and a list without tables or lists has one line. NumPy numbers and arrays,
    tuples, enums and paths are written as their values.

    Raises
    ------
    FlightidError : if the content has a NaN, an infinity, a None, a key that is no text, or an
        object that JSON does not have. Nothing is written then.
    """
    write_text(Path(path), json_text(content, str(path)) + "\n")


def json_text(content: Mapping[str, Any], where: str = "JSON") -> str:
    """Return the text of ``write_json``; ``where`` is the file, for messages."""
    return escaped(_indented(_json_value(content, where, ""), ""))


def csv_text(header: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """Return a header and rows as the text of a CSV file."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 file completely or not at all, by renaming a temporary file. Raises OSError.

    Bytes of names of files that are not UTF-8 are written as ``\\udcff``, as JSON reads them.
    """
    write_content(path, text.encode("utf-8", "backslashreplace"))


def write_content(path: Path, content: bytes) -> None:
    """Write the bytes of a file completely or not at all, as ``write_text``."""
    temporary = path.with_name(f".{path.name[:_TEMPORARY_NAME_LETTERS]}.part")
    try:
        temporary.write_bytes(content)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


# names of devices on Windows, where no file can have them
_DEVICES = frozenset(
    {"con", "prn", "aux", "nul", *(f"{port}{n}" for port in ("com", "lpt") for n in range(1, 10))}
)


def unportable(name: str) -> str:
    """Return the reason why a file or folder cannot have this name on every system, as the end of a
    sentence; empty if it can.

    Windows refuses some characters, names of devices, and a final point or space.
    """
    refused = next((letter for letter in name if letter in '<>:"/\\|?*' or ord(letter) < 32), "")
    if refused:
        return f"has the character {refused!r}, which Windows allows in no file name"
    if name.split(".")[0].rstrip(" ").lower() in _DEVICES:
        return "is the name of a device on Windows"
    if not name:
        return "is empty"
    if name[-1] in ". ":
        return "ends with a point or a space, which Windows takes away"
    return ""


def file_stems(names: Sequence[str]) -> dict[str, str]:
    """Return name -> part of a file name of letters, digits and ``_``.

    The parts differ in more than upper and lower case, which some systems do not distinguish.
    """
    stems: dict[str, str] = {}
    for name in dict.fromkeys(names):
        plain = "".join(letter if letter.isalnum() else "_" for letter in name)
        taken = {stem.lower() for stem in stems.values()}
        candidates = (plain if n == 1 else f"{plain}_{n}" for n in range(1, len(names) + 2))
        stems[name] = next(stem for stem in candidates if stem.lower() not in taken)
    return stems


def _json_value(value: Any, where: str, key: str) -> Any:
    """Return a value in the types of JSON; ``where`` and ``key`` are for messages."""
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


def _indented(value: Any, indent: str) -> str:
    """Return the JSON text of a value whose closing bracket is indented by ``indent``."""
    inner = indent + "  "
    if isinstance(value, dict) and value:
        lines = [
            f"{inner}{json.dumps(key, ensure_ascii=False)}: {_indented(value[key], inner)}"
            for key in sorted(value)
        ]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        return "[\n" + ",\n".join(inner + _indented(item, inner) for item in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


# ---- The study folder

MANIFEST = "files"
_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
# signals of the system that end the program
_ENDING_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


class _Scratch:
    """A temporary folder, which can also be removed when the program has opened as many files as
    the system allows.

    Its removal opens folders. For this purpose two files are kept open, and are closed first.
    """

    def __init__(self, parent: Path, name: str) -> None:
        prefix = f".{name[:_TEMPORARY_NAME_LETTERS]}-"
        self.path = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        self._spare_files: list[int] = []
        with contextlib.suppress(OSError):
            self._spare_files += [os.open(os.devnull, os.O_RDONLY) for _ in range(2)]

    def remove(self) -> None:
        """Remove the folder and its content."""
        while self._spare_files:
            os.close(self._spare_files.pop())
        shutil.rmtree(self.path, ignore_errors=True)


@contextmanager
def study_folder(path: str | Path, main: str) -> Iterator[Path]:
    """Give the body a temporary folder for a study, and move its files into ``path`` at the end.

    If the body raises, ``path`` is not changed. A file of an older run is removed if the ``main``
    of that run lists it, the new run did not write it, and no other study in the folder lists it.
    Other files remain.

    Parameters
    ----------
    path : folder of the study, which may be missing, be empty or have an older run.
    main : name of the JSON file of the study, such as ``diagnosis.json``. The body must write it.
        The list of all files is added to it under the key ``files``, and it is moved last: a folder
        with a new ``main`` is complete.

    Raises
    ------
    FlightidError : if ``path`` is a file or cannot be written, or if a folder in it has the name of
        a file of the study.
    """
    target = resolved(path)
    if os.path.lexists(target) and not os.path.isdir(target):
        what = (
            "this is a link that leads nowhere"
            if os.path.islink(target)
            else "this is a file, not a folder"
        )
        raise FlightidError(what, where=str(path), remedy="name another folder")
    created: list[Path] = []
    scratch: _Scratch | None = None
    try:
        try:
            _create(target.parent, created)
            scratch = _Scratch(target.parent, target.name)
        except OSError as error:
            raise unwritable(path, error) from None
        try:
            yield scratch.path
        except OSError as error:
            if error.errno in _DISK_FULL:
                raise unwritable(path, error) from None
            raise
        try:
            with _uninterrupted(path):
                _move_into_folder(scratch.path, target, main, created)
        except OSError as error:
            raise unwritable(path, error) from None
    except BaseException:
        if scratch is not None:
            scratch.remove()
        _remove_created(created)
        raise
    scratch.remove()


@contextmanager
def files_together(named: Path) -> Iterator[Path]:
    """Give the body a temporary folder for a record and the files that belong to it.

    At the end all files are moved into the folder of ``named``, or none. ``named`` is the file that
    the user asked for; it is replaced. Another existing file is replaced only if flightid wrote it,
    which the schema in the JSON file shows.

    Raises
    ------
    FlightidError : the folder cannot be written, or a file that flightid did not write has one of
        the names.
    """
    target = named.parent
    created: list[Path] = []
    scratch: _Scratch | None = None
    try:
        try:
            _create(target, created)
            scratch = _Scratch(target, named.stem)
            yield scratch.path
            _refuse_files_of_others(scratch.path, named)
            with _uninterrupted(named):
                names = os.listdir(scratch.path)
                for name in sorted(names, key=lambda name: (name == named.name, name)):
                    os.replace(scratch.path / name, target / name)
        except OSError as error:
            raise unwritable(named, error) from None
    except BaseException:
        if scratch is not None:
            scratch.remove()
        _remove_created(created)
        raise
    scratch.remove()


def _refuse_files_of_others(scratch: Path, named: Path) -> None:
    """Raise FlightidError if a file beside ``named`` exists and flightid did not write it."""
    beside = [named.parent / name for name in sorted(os.listdir(scratch)) if name != named.name]
    ours = {path for path in beside if path.suffix == ".json" and _is_ours(path)}
    for path in (named, *beside):
        if path.is_dir() or (
            path in beside
            and os.path.lexists(path)
            and path not in ours
            and (path.suffix == ".json" or not ours)
        ):
            raise FlightidError(
                "a file of this name exists, and flightid did not write it",
                where=str(path),
                remedy="move it away, or name another record file",
            )


def _is_ours(path: Path) -> bool:
    content = json_or_none(path)
    return isinstance(content, dict) and str(content.get("schema", "")).startswith("flightid/")


@contextmanager
def _uninterrupted(path: str | Path) -> Iterator[None]:
    """Delay signals that end the program until the body has moved files, so that a study is
    complete or absent. ``path`` is for the message.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread can set handlers of signals
        return
    received: list[int] = []
    handlers = {
        number: signal.getsignal(number)
        for number in _ENDING_SIGNALS
        if callable(signal.getsignal(number))
    }
    for number in handlers:
        signal.signal(number, lambda number, frame: received.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for number in received:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(number)
        raise KeyboardInterrupt(f"the study in {path} is whole")


def listed_files(main: Path) -> frozenset[str]:
    """Return the names of the files that the JSON file of a study lists; empty for other files."""
    content = json_or_none(main)
    if not isinstance(content, dict) or not str(content.get("schema", "")).startswith("flightid/"):
        return frozenset()
    names = content.get(MANIFEST)
    if not isinstance(names, list):
        return frozenset()
    return frozenset(name for name in names if isinstance(name, str) and _is_bare_name(name))


def _move_into_folder(scratch: Path, target: Path, main: str, created: list[Path]) -> None:
    """Move the files of a study from ``scratch`` into ``target``, ``main`` last.

    Outdated files of an older run are removed. New folders are appended to ``created``.
    """
    written = sorted(entry.name for entry in scratch.iterdir())
    if main not in written:
        raise ValueError(f"the study did not write {main}")
    if not all((scratch / name).is_file() for name in written):
        raise ValueError("a study folder holds files only")
    _refuse_unportable(written)
    for name in written:
        if (target / name).is_dir():
            raise FlightidError(
                "there is a folder with the name of a file of the study",
                where=str(target / name),
                remedy="move it away, or name another folder",
            )
    content = json.loads((scratch / main).read_bytes())
    write_json(scratch / main, {**content, MANIFEST: written})
    other_studies = []
    if target.is_dir():
        other_studies = [entry for entry in target.glob("*.json") if entry.name != main]
    needed = set(written).union(*(listed_files(entry) for entry in other_studies))
    stale = listed_files(target / main) - needed
    _create(target, created)
    for name in sorted(written, key=lambda name: (name == main, name.endswith(".json"), name)):
        if name == main:
            for stale_name in sorted(stale):
                if (target / stale_name).is_file():
                    (target / stale_name).unlink()
        _move_file(scratch / name, target / name)


def _refuse_unportable(names: Sequence[str]) -> None:
    """Raise ValueError if the name of a file of a study is not possible on every system."""
    for name in names:
        if reason := unportable(name):
            raise ValueError(f"the name of the file {name!r} {reason}")
    if len({name.lower() for name in names}) < len(names):
        raise ValueError("two files of a study differ by upper and lower case alone")


def _move_file(source: Path, target: Path) -> None:
    """Move a file, also to another disk."""
    try:
        os.replace(source, target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        # The target folder is a mount point: the temporary folder beside it is on another disk.
        temporary = target.with_name(f".{target.name}.part")
        shutil.copyfile(source, temporary)
        os.replace(temporary, target)


def _create(folder: Path, created: list[Path]) -> None:
    """Create a folder and its parents, and append those that were missing to ``created``."""
    missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
    for parent in reversed(missing):
        parent.mkdir(exist_ok=True)
        created.append(parent)


def _remove_created(created: list[Path]) -> None:
    for folder in reversed(created):
        with contextlib.suppress(OSError):
            folder.rmdir()


def _is_bare_name(name: str) -> bool:
    """Return whether a name has no folder: a study may list files of its own folder only."""
    return name not in ("", ".", "..") and "/" not in name and "\\" not in name and "\0" not in name


def unwritable(
    path: str | Path, error: OSError, remedy: str = "name a folder that you may write in"
) -> FlightidError:
    """Return the error for a place that cannot be written, with the reason of the system.

    ``remedy`` is for any reason other than a full disk.
    """
    if error.errno in _DISK_FULL:
        remedy = "make room, or name a place on another disk"
    what = f"cannot be written ({error.strerror or error})"
    return FlightidError(what, where=str(path), remedy=remedy)
