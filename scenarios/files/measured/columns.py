"""Columns of channels in a table and their units, and record files with their sidecars."""

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

_SECOND_ELEMENT = re.compile(r"(\w[\w.]*)\[1\]")  # xyz[1], which also reads as xyz in the unit 1


@dataclass(frozen=True)
class SourceColumn:
    """Column of one channel.

    Attributes
    ----------
    channel : name of the channel in the program.
    header : header cell of the column in the file.
    index : index of the column in the table.
    unit : unit of the numbers in the column; for the stick a label that is not converted.
    inside : SI unit of the channel in the program; empty if ``unit`` is a label.
    """

    channel: str
    header: str
    index: int
    unit: str
    inside: str


def split_at(header: Sequence[str], index: int) -> tuple[str, str | None]:
    """Return name and unit of a header cell; the unit is None if the cell states none.

    ``xyz[1]`` beside ``xyz[0]`` or ``xyz[2]`` is an element of an array, without a unit.
    """
    match = _SECOND_ELEMENT.fullmatch(header[index])
    if match is not None and (f"{match[1]}[0]" in header or f"{match[1]}[2]" in header):
        return header[index], None
    return split_header(header[index])


def suffix_unit(cell: str, channel: str) -> str | None:
    """Return the unit in a header ``channel_unit``; None for any other header.

    Words after the first one are divisors: ``q_deg_s`` is in ``deg/s``.
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
    under: Sequence[str] = (),
    *,
    lenient: bool = False,
) -> SourceColumn | None:
    """Return the column of a channel; None if the table has none.

    A channel that is not in the channel map is found by the headers ``alpha``, ``alpha [deg]`` and
    ``alpha_deg``. If a column ``alpha`` exists, a header ``alpha_word`` is another signal unless
    the word is a unit of an angle. A header that is the name of another channel is never used.

    Parameters
    ----------
    header : header cells of the table.
    file : the file, for messages.
    choices : channel map, with the column of a channel, or the declaration that it is absent.
    units : channel -> unit of the sidecar, for columns without another unit.
    channel_units : SI unit of every known channel.
    under : row of units under the header, for columns without a unit in the header.
    lenient : whether a unit in ``under`` of the wrong dimension is ignored: recorders often write
        wrong units.

    Raises
    ------
    RecordError : if two columns are the channel, if the file lacks the column of the map, if the
        unit is unknown or has the wrong dimension, or if the units in the header and under it
        differ.
    """
    refuse_unknown("channel", channel, channel_units, file, RecordError)
    default = (units or {}).get(channel, channel_units[channel])
    inside = program_unit(channel, channel_units)
    if choices is not None and channel in choices:
        if choices[channel].absent:
            return None
        return _column_of_map(
            channel, choices[channel], header, file, default, inside, under, lenient=lenient
        )
    named, suffixed = [], []
    cells = _in_case_of_channel(channel, header, channel_units)
    for index, cell in enumerate(cells):
        name, unit = split_at(cells, index)
        if name == channel:
            named.append(SourceColumn(channel, header[index], index, unit or default, inside))
        elif name not in channel_units and (word := suffix_unit(cell, channel)) is not None:
            suffixed.append(SourceColumn(channel, header[index], index, word, inside))
    readable = [column for column in suffixed if _unit_fault(column, file) is None]
    # The unit of a stick is a label, and every word is a possible label.
    matching = named + readable if inside else named or suffixed
    if len(matching) > 1:
        both = " and ".join(repr(column.header) for column in matching)
        raise RecordError(
            f"columns {both} are all {channel}",
            where=file,
            remedy="leave one of them, or choose with --channels",
        )
    chosen = matching or suffixed[:1]
    if not chosen:
        return None
    stated = chosen[0] in suffixed or split_header(chosen[0].header)[1] is not None
    column = _with_unit_under(chosen[0], under, file, stated=stated, lenient=lenient)
    return _convertible(column, file)


def _in_case_of_channel(
    channel: str, header: Sequence[str], channel_units: Mapping[str, str]
) -> Sequence[str]:
    """Return the header with cells such as ``Elevator`` or ``ALPHA`` in the letter case of the
    channel. Cells that name another channel, and a header with an exact match, are not changed.
    """
    if any(split_at(header, index)[0] == channel for index in range(len(header))):
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
    """Return the unit in the program to which a channel is converted; empty for a stick without a
    unit.
    """
    return "" if channel == STICK and channel_units[channel] == "1" else channel_units[channel]


def named_otherwise(
    channel: str, header: Sequence[str], choices: Mapping[str, ColumnChoice] | None = None
) -> bool:
    """Return whether all headers that begin with the name of the channel continue with a word that
    is no unit, as in ``airspeed_raw``.
    """
    if channel in (choices or {}) or any(split_header(cell)[0] == channel for cell in header):
        return False
    words = [(cell, word) for cell in header if (word := suffix_unit(cell, channel)) is not None]
    return all(
        _unit_fault(SourceColumn(channel, cell, 0, word, program_unit(channel)), "") is not None
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


def _with_unit_under(
    column: SourceColumn, under: Sequence[str], file: str, *, stated: bool, lenient: bool
) -> SourceColumn:
    """Return the column with the unit in the row ``under`` the header, if there is one.

    ``stated`` : whether the header states a unit too. RecordError is raised unless both agree.
    """
    unit_under = under[column.index] if under else ""
    if lenient and unit_under and _unit_fault(replace(column, unit=unit_under), file) is not None:
        unit_under = ""
    if not unit_under:
        return column
    if not stated:
        return replace(column, unit=unit_under)
    if not _same_unit(column.unit, unit_under, column.inside):
        what = f"the header says {column.unit}, the row of units under it {unit_under}"
        raise RecordError(what, where=column_place(file, column), remedy="correct one of them")
    return column


def _same_unit(unit: str, other_unit: str, inside: str) -> bool:
    """Return whether two units are equal by name, or by their factor to the unit ``inside``."""
    if unit == other_unit:
        return True
    if not inside:
        return False
    try:
        return to_si(1.0, unit, inside, "") == to_si(1.0, other_unit, inside, "")
    except RecordError:
        return False


def _convertible(column: SourceColumn, file: str) -> SourceColumn:
    fault = _unit_fault(column, file)
    if fault is not None:
        raise fault
    return column


def _column_of_map(
    channel: str,
    choice: ColumnChoice,
    header: Sequence[str],
    file: str,
    default: str,
    inside: str,
    under: Sequence[str],
    *,
    lenient: bool,
) -> SourceColumn:
    """Return the column that the channel map names: by its whole header cell, else by its name
    without unit.
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
        column = SourceColumn(channel, header[index], index, unit or default, inside)
        return _convertible(column, file)
    unit = split_at(header, index)[1]
    column = SourceColumn(channel, header[index], index, unit or default, inside)
    column = _with_unit_under(column, under, file, stated=bool(unit), lenient=lenient)
    return _convertible(column, file)


def _unit_fault(column: SourceColumn, file: str) -> RecordError | None:
    """Return the error if the unit of a column cannot be converted; None if it can."""
    if not column.inside:
        return None
    try:
        to_si(1.0, column.unit, column.inside, column_place(file, column))
    except RecordError as fault:
        return fault
    return None


# ---- The JSON beside a record

SCHEMA = "flightid/record/1"
KEYS = ("schema", "name", "hold", "units", "origin")
_AWAY = "mend it, or move it away where it does not belong to the record"
SIMULATED = "simulated"  # the value of the key ``origin``


@dataclass(frozen=True)
class Sidecar:
    """Content of the JSON file beside a record.

    Attributes
    ----------
    name : name of the record; None if the file states none.
    hold : behaviour of the inputs between samples.
    units : channel -> unit of a column without a unit in its header.
    says_hold : whether the file states the hold; if not, ``hold`` is the default.
    simulated : whether the data are simulated.
    file : name of the JSON file; empty if there is none.
    """

    name: str | None = None
    hold: Hold = Hold.PREVIOUS
    units: Mapping[str, str] = field(default_factory=dict)
    says_hold: bool = False
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
            f"cannot be read ({error.strerror or error})", where=str(path), remedy=_AWAY
        ) from None
    try:
        content = json_value(raw)
    except DocumentError as error:
        raise RecordError(str(error), where=str(path), remedy=_AWAY) from None
    return _sidecar_of(content, path) if isinstance(content, dict) else Sidecar()


def _sidecar_of(content: Mapping[str, Any], path: Path) -> Sidecar:
    schema = content.get("schema")
    if not isinstance(schema, str) or not schema.startswith("flightid/"):
        ours = [key for key in ("hold", "units") if key in content]
        if ours and not isinstance(schema, str):
            what = f"it has the key {ours[0]} and no schema"
            remedy = f'add "schema": "{SCHEMA}", or move the file away'
            raise RecordError(what, where=f"{path}, key schema", remedy=remedy)
        return Sidecar()
    if schema != SCHEMA:
        what, remedy = f"schema {schema!r} is not known here", f"write the record again as {SCHEMA}"
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
    table : cells of the file; only the headers ``topic.field`` for a log of several topics.
    sidecar : content of the JSON file beside the record.
    identity : name in outputs, with folders if two files have the same name, and hash of the
        content.
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
    # A table without rows, whose header messages show.
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
            "a log of several topics has names of its own",
            where="--columns",
            remedy="leave it out, and use a channel map",
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
    """Return the files with distinct names. Equal names of files are preceded by their folders:
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
    """Return the number of last parts that distinguish the paths; the name of the file is one."""
    most = max(len(path.parts) for path in paths)
    for depth in range(1, most):
        if len({path.parts[-depth:] for path in paths}) == len(paths):
            return depth
    return most


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


def refuse_twice(
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
