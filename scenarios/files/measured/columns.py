"""Search for the column and the unit of a channel in a table; record files and their sidecars."""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.declarations import (
    CHANNEL_UNITS,
    STICK,
    ColumnChoice,
    closest,
    refuse_unknown,
    shortened_list,
    split_header,
)
from scenarios.files.formats.cells import CellTable, Topic
from scenarios.files.formats.registry import opened_folder, topics_of
from scenarios.files.sources import (
    MOST_RECORD,
    DocumentError,
    InputFile,
    json_value,
    read_source,
    resolved,
)
from scenarios.files.units import to_si
from sim.errors import RecordError
from sim.record import Hold

# ---- Which column of a table is which channel

_SECOND_ELEMENT = re.compile(r"(\w[\w.]*)\[1\]")  # xyz[1]; brackets else enclose a unit


@dataclass(frozen=True)
class SourceColumn:
    """Column of one channel.

    Attributes
    ----------
    channel : name of the channel in the program.
    header : header cell of the column in the file.
    index : index of the column in the table.
    unit : unit of the numbers in the column; for the stick a label that is not converted.
    target_unit : SI unit to which the column is converted; empty if ``unit`` is a label.
    """

    channel: str
    header: str
    index: int
    unit: str
    target_unit: str


def name_and_unit(header: Sequence[str], index: int) -> tuple[str, str | None]:
    """Return name and unit of a header cell; the unit is None if the cell states none.

    If the header has ``xyz[0]`` or ``xyz[2]`` too, ``xyz[1]`` is a name, the element of an array.
    """
    match = _SECOND_ELEMENT.fullmatch(header[index])
    if match is not None and (f"{match[1]}[0]" in header or f"{match[1]}[2]" in header):
        return header[index], None
    return split_header(header[index])


def suffix_unit(cell: str, channel: str) -> str | None:
    """Return the unit in a header cell of channel and unit, such as ``alpha_deg``; None for other
    cells. Words after the first one are divisors: ``q_deg_s`` is in ``deg/s``.
    """
    if not cell.startswith(channel + "_"):
        return None
    words = [word for word in cell[len(channel) + 1 :].split("_") if word and word != "per"]
    return "/".join(words)


def find_column(
    channel: str,
    header: Sequence[str],
    file: str,
    choices: Mapping[str, ColumnChoice] | None = None,
    units: Mapping[str, str] | None = None,
    channel_units: Mapping[str, str] = CHANNEL_UNITS,
    unit_row: Sequence[str] = (),
    *,
    lenient: bool = False,
) -> SourceColumn | None:
    """Return the column of a channel; None if the table has none.

    A channel that is not in the channel map is found by the headers ``alpha``, ``alpha [deg]`` and
    ``alpha_deg``. If there is a column ``alpha``, a column such as ``alpha_raw`` is another signal,
    since ``raw`` is no unit of an angle. A header that names another channel is never used.

    Parameters
    ----------
    header : header cells of the table.
    file : the file, for messages.
    choices : channel map, which gives the column of a channel or declares it absent.
    units : channel -> unit, from the sidecar, for columns whose unit is stated nowhere else.
    channel_units : SI unit of every known channel.
    unit_row : row of units under the header, for columns without a unit in the header.
    lenient : whether a unit of the wrong dimension in ``unit_row`` is ignored. Some recorders write
        wrong units.

    Raises
    ------
    RecordError : if two columns match the channel, if the file lacks the column that the map gives,
        if the unit is unknown or has the wrong dimension, or if header and unit row differ.
    """
    refuse_unknown("channel", channel, channel_units, file, RecordError)
    default = (units or {}).get(channel, channel_units[channel])
    target_unit = program_unit(channel, channel_units)
    if choices is not None and channel in choices:
        if choices[channel].absent:
            return None
        return _column_of_map(
            channel, choices[channel], header, file, default, target_unit, unit_row, lenient=lenient
        )
    exact, suffixed = [], []
    cells = _in_letter_case_of(channel, header, channel_units)
    for index, cell in enumerate(cells):
        name, unit = name_and_unit(cells, index)
        if name == channel:
            exact.append(SourceColumn(channel, header[index], index, unit or default, target_unit))
        elif name not in channel_units and (unit_word := suffix_unit(cell, channel)) is not None:
            suffixed.append(SourceColumn(channel, header[index], index, unit_word, target_unit))
    readable = [column for column in suffixed if _unit_error(column, file) is None]
    # The unit of a stick is a label, so that any word after ``stick_`` might be one.
    matching = exact + readable if target_unit else exact or suffixed
    if len(matching) > 1:
        headers = " and ".join(repr(column.header) for column in matching)
        raise RecordError(
            f"columns {headers} are all {channel}",
            where=file,
            remedy="delete all but one of them, or choose one with --channels",
        )
    chosen = matching or suffixed[:1]
    if not chosen:
        return None
    in_header = chosen[0] in suffixed or split_header(chosen[0].header)[1] is not None
    column = _with_unit_of_row(chosen[0], unit_row, file, in_header=in_header, lenient=lenient)
    return _with_checked_unit(column, file)


def _in_letter_case_of(
    channel: str, header: Sequence[str], channel_units: Mapping[str, str]
) -> Sequence[str]:
    """Return the header with cells such as ``Elevator`` or ``ALPHA`` in the letter case of the
    channel. Cells that name another channel are not changed, nor a header with an exact match.
    """
    if any(name_and_unit(header, index)[0] == channel for index in range(len(header))):
        return header
    cells = list(header)
    for index, cell in enumerate(header):
        name = split_header(cell)[0]
        if name.lower() == channel.lower() and name not in channel_units:
            cells[index] = channel + cell[len(name) :]
        elif (
            name not in channel_units
            and name[: len(channel) + 1].lower() == f"{channel.lower()}_"
            and not name.startswith(channel)
        ):
            cells[index] = channel + cell[len(channel) :].lower()
    return cells


def program_unit(channel: str, channel_units: Mapping[str, str] = CHANNEL_UNITS) -> str:
    """Return the SI unit to which a channel is converted; empty for a stick, whose unit is only a
    label.
    """
    return "" if channel == STICK and channel_units[channel] == "1" else channel_units[channel]


def has_other_suffixes_only(
    channel: str, header: Sequence[str], choices: Mapping[str, ColumnChoice] | None = None
) -> bool:
    """Return whether the channel has no column of its own, and all columns whose header begins with
    its name continue with a word that is no unit, as in ``airspeed_raw``.
    """
    if channel in (choices or {}) or any(split_header(cell)[0] == channel for cell in header):
        return False
    words = [(cell, word) for cell in header if (word := suffix_unit(cell, channel)) is not None]
    return all(
        _unit_error(SourceColumn(channel, cell, 0, word, program_unit(channel)), "") is not None
        for cell, word in words
    )


def map_command(file: str | Path) -> str:
    """Return the command line that drafts a channel map of a file."""
    return f"flightid map {shlex.quote(str(file))}"


def missing_column(channel: str, header: Sequence[str], file: str) -> RecordError:
    """Return the error for a channel that a model needs and the file does not have."""
    shown = shortened_list([cell for cell in header if cell], 20)
    remedy = (
        f"name the column {channel}, or give --channels a map with {channel} = {{column = "
        f'"HEADER"}}; {map_command(file)} drafts one'
    )
    if header and header[0] == "column 1":  # the file has no header
        remedy = (
            f"name the columns with --columns, or give --channels a map with {channel} = NUMBER"
        )
    return RecordError(
        f"there is no column {channel!r}; the columns are {shown}",
        where=f"{file}, header",
        remedy=remedy,
    )


def column_place(file: str, column: SourceColumn) -> str:
    """Return the place of a column for messages: ``record.csv, column 'alpha_deg'``."""
    return f"{file}, column {column.header!r}"


def _with_unit_of_row(
    column: SourceColumn, unit_row: Sequence[str], file: str, *, in_header: bool, lenient: bool
) -> SourceColumn:
    """Return the column with the unit in the row ``unit_row`` the header, if there is one.

    ``in_header`` : whether the header states a unit too. If the two differ, RecordError is raised.
    """
    row_unit = unit_row[column.index] if unit_row else ""
    if lenient and row_unit and _unit_error(replace(column, unit=row_unit), file) is not None:
        row_unit = ""
    if not row_unit:
        return column
    if not in_header:
        return replace(column, unit=row_unit)
    if not _same_unit(column.unit, row_unit, column.target_unit):
        what = f"the header says {column.unit}, the row of units under it {row_unit}"
        raise RecordError(what, where=column_place(file, column), remedy="correct one of them")
    return column


def _same_unit(unit: str, other_unit: str, target_unit: str) -> bool:
    """Return whether two units are equal by name, or by their factor to ``target_unit``."""
    if unit == other_unit:
        return True
    if not target_unit:
        return False
    try:
        return to_si(1.0, unit, target_unit, "") == to_si(1.0, other_unit, target_unit, "")
    except RecordError:
        return False


def _with_checked_unit(column: SourceColumn, file: str) -> SourceColumn:
    error = _unit_error(column, file)
    if error is not None:
        raise error
    return column


def _column_of_map(
    channel: str,
    choice: ColumnChoice,
    header: Sequence[str],
    file: str,
    default: str,
    target_unit: str,
    unit_row: Sequence[str],
    *,
    lenient: bool,
) -> SourceColumn:
    """Return the column that the channel map names, by its whole header cell or else by its name
    without the unit.
    """
    assert isinstance(choice.column, str)  # `with_derived` has replaced numbers of columns
    matching = [index for index, cell in enumerate(header) if cell == choice.column]
    matching = matching or [
        index for index, cell in enumerate(header) if split_header(cell)[0] == choice.column
    ]
    if not matching:
        error = missing_column(channel, header, file)
        near = closest(choice.column, [cell for cell in header if cell])
        if choice.column == channel:  # a signal of `flightid response`, which is no channel
            raise RecordError(error.what, where=error.where, remedy=near)
        what = error.what.replace(
            repr(channel), f"{choice.column!r}, which the channel map names for {channel}", 1
        )
        raise RecordError(what, where=error.where, remedy=f"correct the channel map: {near}")
    if len(matching) > 1:
        what = f"{len(matching)} columns are headed {choice.column!r}"
        raise RecordError(what, where=f"{file}, header", remedy="rename all but one of them")
    index = matching[0]
    if choice.unit is not None:
        unit: str | None = choice.unit
        column = SourceColumn(channel, header[index], index, unit or default, target_unit)
        return _with_checked_unit(column, file)
    unit = name_and_unit(header, index)[1]
    column = SourceColumn(channel, header[index], index, unit or default, target_unit)
    column = _with_unit_of_row(column, unit_row, file, in_header=bool(unit), lenient=lenient)
    return _with_checked_unit(column, file)


def _unit_error(column: SourceColumn, file: str) -> RecordError | None:
    """Return the error if the unit of a column cannot be converted; None if it can."""
    if not column.target_unit:
        return None
    try:
        to_si(1.0, column.unit, column.target_unit, column_place(file, column))
    except RecordError as error:
        return error
    return None


# ---- Sidecar: the JSON file beside a record

SCHEMA = "flightid/record/1"
KEYS = ("schema", "name", "hold", "units", "origin")
_DAMAGED_SIDECAR_REMEDY = "correct it, or move it away if it does not belong to the record"
SIMULATED = "simulated"  # the value of the key ``origin``


@dataclass(frozen=True)
class Sidecar:
    """Content of the JSON file beside a record.

    Attributes
    ----------
    name : name of the record; None if the file states none.
    hold : behaviour of the inputs between samples.
    units : channel -> unit of a column without a unit in its header.
    states_hold : whether the file states the hold; if not, ``hold`` is the default.
    simulated : whether the data are simulated.
    file : name of the JSON file; empty if there is none.
    """

    name: str | None = None
    hold: Hold = Hold.PREVIOUS
    units: Mapping[str, str] = field(default_factory=dict)
    states_hold: bool = False
    simulated: bool = False
    file: str = ""


def sidecar_path(record: Path) -> Path:
    """Return the path ``record.json`` for a record ``record.csv`` or ``record.csv.gz``."""
    uncompressed = record.with_suffix("") if record.suffix.lower() == ".gz" else record
    return uncompressed.with_suffix(".json")


def read_sidecar(record: Path) -> Sidecar:
    """Return the sidecar of a record file.

    The default sidecar is returned if there is no file, or a JSON file of another program.

    Raises
    ------
    RecordError : the file cannot be read or is damaged, or it is a sidecar with an entry that
        cannot be used.
    """
    path = sidecar_path(record)
    try:
        raw = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return Sidecar()
    except OSError as error:
        raise RecordError(
            f"cannot be read ({error.strerror or error})",
            where=str(path),
            remedy=_DAMAGED_SIDECAR_REMEDY,
        ) from None
    try:
        content = json_value(raw)
    except DocumentError as error:
        raise RecordError(str(error), where=str(path), remedy=_DAMAGED_SIDECAR_REMEDY) from None
    return _sidecar_of(content, path) if isinstance(content, dict) else Sidecar()


def _sidecar_of(content: Mapping[str, Any], path: Path) -> Sidecar:
    schema = content.get("schema")
    if not isinstance(schema, str) or not schema.startswith("flightid/"):
        sidecar_keys = [key for key in ("hold", "units") if key in content]
        if sidecar_keys and not isinstance(schema, str):
            what = f"it has the key {sidecar_keys[0]} and no schema"
            remedy = f'add "schema": "{SCHEMA}", or move the file away'
            raise RecordError(what, where=f"{path}, key schema", remedy=remedy)
        return Sidecar()
    if schema != SCHEMA:
        what, remedy = f"schema {schema!r} is not known", f"write the record again as {SCHEMA}"
        raise RecordError(what, where=f"{path}, key schema", remedy=remedy)
    for key in content:
        if key not in KEYS:
            raise RecordError(
                "there is no such key", where=f"{path}, key {key!r}", remedy=closest(key, KEYS)
            )
    name, hold = content.get("name"), content.get("hold", Hold.PREVIOUS.value)
    units = content.get("units", {})
    if name is not None and not isinstance(name, str):
        raise RecordError(f"{name!r} is no name", where=f"{path}, key name", remedy="write a text")
    if hold not in [kind.value for kind in Hold]:
        what, remedy = f"hold {hold!r} is not known", "write previous or linear"
        raise RecordError(what, where=f"{path}, key hold", remedy=remedy)
    if not isinstance(units, dict) or not all(isinstance(unit, str) for unit in units.values()):
        raise RecordError(
            "a unit is not a text", where=f"{path}, key units", remedy='write {"alpha": "rad", ...}'
        )
    if not isinstance(content.get("origin", ""), str):
        what, remedy = "the origin is not a text", f"write {SIMULATED}, or leave it out"
        raise RecordError(what, where=f"{path}, key origin", remedy=remedy)
    return Sidecar(
        name, Hold(hold), units, "hold" in content, content.get("origin") == SIMULATED, path.name
    )


def refuse_unknown_units(
    sidecar: Sidecar, header: Sequence[str], record: Path, allowed: Collection[str]
) -> None:
    """Raise RecordError if the sidecar states a unit for a name that is neither an ``allowed``
    channel nor a column.
    """
    for name in sidecar.units:
        if name in allowed or any(
            split_header(cell)[0] == name or suffix_unit(cell, name) for cell in header
        ):
            continue
        where = f"{sidecar_path(record)}, key units"
        raise RecordError(
            f"there is no channel {name!r}",
            where=where,
            remedy=closest(name, [*allowed, *(cell for cell in header if cell)]),
        )


@dataclass(frozen=True, eq=False, repr=False)
class RecordFile:
    """An open record file.

    Attributes
    ----------
    path : path of the file; only a name for a record in memory.
    table : cells of the file; for a log of several topics only headers ``topic.field``, no rows.
    sidecar : content of the JSON file beside the record.
    identity : name for outputs and hash of the content. Files of equal names differ in the folders
        before their names.
    choices : channel map.
    in_memory : whether the record is not a file.
    topics : tables of a log of several topics, each with its own clock; empty for other files.
    notes : sentences on the interpretation of the file.
    """

    path: Path
    table: CellTable
    sidecar: Sidecar
    identity: InputFile
    choices: Mapping[str, ColumnChoice] = field(default_factory=dict)
    in_memory: bool = False
    topics: tuple[Topic, ...] = ()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<RecordFile {self.path}: {self.table!r}>"


def read_record_file(path: str | Path) -> RecordFile:
    """Read a record file of any known format, or a folder with one CSV file a channel, and its
    sidecar.

    Raises
    ------
    RecordError : if the file is missing, unreadable, empty, not UTF-8, or has a header and no rows;
        or if the sidecar has an entry that cannot be used.
    """
    folder = opened_folder(Path(path))
    if folder is None:
        source = read_source(path, RecordError, "the record file", MOST_RECORD)
        topics = topics_of(source)
    else:
        source, topics = folder
    sidecar = read_sidecar(source.path)
    if len(topics) == 1:
        return RecordFile(
            source.path, topics[0].table, sidecar, source.identity, notes=topics[0].notes
        )
    notes = tuple(f"{topic.name}: {note}" for topic in topics for note in topic.notes)
    # This table has no rows; messages list its header.
    header = tuple(f"{topic.name}.{cell}" for topic in topics for cell in topic.table.header)
    empty = tuple(np.zeros(0) for _ in header)
    table = CellTable(str(source.path), header, empty, np.zeros(0, dtype=int))
    return RecordFile(source.path, table, sidecar, source.identity, topics=topics, notes=notes)


def with_names(file: RecordFile, names: Sequence[str]) -> RecordFile:
    """Return the file with new names of its columns, in their order.

    Raises
    ------
    RecordError : if the numbers of names and columns differ, or if the file is a log of several
        topics.
    """
    if not names:
        return file
    if file.topics:
        raise RecordError(
            "a log of several topics already names its columns",
            where="--columns",
            remedy="omit the option, and use a channel map",
        )
    if len(names) != len(file.table.header):
        what = f"{len(names)} names for {len(file.table.header)} columns of {file.path.name}"
        raise RecordError(
            what, where="--columns", remedy="give one name a column, separated by commas"
        )
    return replace(file, table=replace(file.table, header=tuple(name.strip() for name in names)))


def read_record_files(records: Iterable[Path | RecordFile]) -> tuple[RecordFile, ...]:
    """Return the open record files, in their order, with distinct names."""
    return with_distinct_names([opened(record) for record in records])


def opened(record: Path | RecordFile) -> RecordFile:
    """Return the record file of a path; an open file is returned as it is."""
    return record if isinstance(record, RecordFile) else read_record_file(record)


def read_with_validation(
    records: Iterable[Path | RecordFile], validate: Iterable[Path | RecordFile]
) -> tuple[tuple[RecordFile, ...], tuple[RecordFile, ...]]:
    """Return the open record files to fit, and those to predict, all with distinct names."""
    fitted = [opened(record) for record in records]
    files = with_distinct_names([*fitted, *(opened(record) for record in validate)])
    return files[: len(fitted)], files[len(fitted) :]


def with_distinct_names(files: Sequence[RecordFile]) -> tuple[RecordFile, ...]:
    """Return the files with distinct names. Folders are added before equal names, as in
    ``flight1/record.csv`` and ``flight2/record.csv``.
    """
    by_name: dict[str, list[Path]] = {}
    for file in files:
        if not file.in_memory:
            by_name.setdefault(file.path.name, []).append(resolved(file.path))
    depths = {name: _distinguishing_depth(paths) for name, paths in by_name.items()}

    def renamed(file: RecordFile) -> RecordFile:
        if file.in_memory:
            return file
        name = "/".join(resolved(file.path).parts[-depths[file.path.name] :])
        return replace(file, identity=replace(file.identity, name=name))

    return tuple(renamed(file) for file in files)


def _distinguishing_depth(paths: Sequence[Path]) -> int:
    """Return how many parts at the end of the paths distinguish them, with the file name as one."""
    longest = max(len(path.parts) for path in paths)
    for depth in range(1, longest):
        if len({path.parts[-depth:] for path in paths}) == len(paths):
            return depth
    return longest


def identities(files: Iterable[RecordFile]) -> tuple[InputFile, ...]:
    """Return the names and hashes of record files, in their order."""
    return tuple(file.identity for file in files)


def all_simulated(files: Iterable[RecordFile]) -> bool:
    """Return whether the sidecar of every record states that its data are simulated."""
    return all(file.sidecar.simulated for file in files)


def path_of(record: Path | RecordFile) -> Path | None:
    """Return the path of a record file; None for a record in memory."""
    if isinstance(record, RecordFile):
        return None if record.in_memory else record.path
    return record


def refuse_duplicates(
    records: Sequence[Path | RecordFile], remedy: str = "name each record once"
) -> None:
    """Raise RecordError if two paths lead to the same file, or a record in memory appears twice."""
    seen: set[Path | int] = set()
    for record in records:
        path = path_of(record)
        key = resolved(path) if path is not None else id(record)
        if key in seen:
            name = str(record.path if isinstance(record, RecordFile) else record)
            raise RecordError("the record is named twice", where=name, remedy=remedy)
        seen.add(key)
