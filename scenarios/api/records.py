"""Records in memory and in the containers of other packages, opened as record files."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scenarios.api.tables import refuse_wrong_type
from scenarios.files.declarations import (
    CHANNEL_UNITS,
    STICK,
    TIME,
    read_channel_map,
    refuse_unknown,
    split_header,
)
from scenarios.files.formats.cells import CellTable, header_cell, numbers
from scenarios.files.formats.tabular import frame_header
from scenarios.files.measured.columns import (
    RecordFile,
    Sidecar,
    SourceColumn,
    name_and_unit,
    read_record_file,
    suffix_unit,
)
from scenarios.files.measured.grid import clock_place
from scenarios.files.records import column_of, raw_column, read_record
from scenarios.files.sources import InputFile
from scenarios.preparation.plan import plan_of
from sim.errors import DeclarationError, RecordError
from sim.record import Hold, Record

if TYPE_CHECKING:
    import control
    import pandas
    import xarray


# ---- The channels of a record file without a model that asks for them

INPUTS = ("elevator", STICK, "aileron", "rudder", "thrust")


@dataclass(frozen=True)
class ChannelColumn:
    """Unit and header of a channel's column, and a function that returns its values ``(N,)``."""

    unit: str
    header: str
    values: Callable[[], np.ndarray]


def columns_of(file: RecordFile) -> dict[str, ChannelColumn]:
    """Return every channel of a record file, time left out, in the order of its columns.

    A column that is no known channel, or has a unit that does not fit it, keeps its name and
    numbers. A column without numbers is left out, and so is one that is no sequence
    (``refuse_unreadable``).
    """
    taken: dict[int, tuple[str, ChannelColumn]] = {}
    units_row = file.table.units or ("",) * len(file.table.header)
    # Mapped channels come first, so that no other channel takes their columns.
    for name in sorted(CHANNEL_UNITS, key=lambda channel: channel not in file.choices):
        found = _source_column(file, name)
        if found is None or found.index in taken or found.index in file.table.unreadable:
            continue
        unit = found.unit if name == STICK else CHANNEL_UNITS[name]
        column = ChannelColumn(unit, found.header, partial(_channel, file, name))
        taken[found.index] = (name, column)
    for name, choice in file.choices.items():
        if name in CHANNEL_UNITS:
            continue
        for index, cell in enumerate(file.table.header):
            if _called(cell, choice.column):
                unit = choice.unit or split_header(cell)[1] or units_row[index] or "1"
                column = ChannelColumn(unit, cell, partial(raw_column, file, index))
                taken[index] = (name, column)
    for index, cell in enumerate(file.table.header):
        if index in taken or index in file.table.unreadable or not cell:
            continue
        if not _numeric(file, index):
            continue
        name, header_unit = name_and_unit(file.table.header, index)
        sidecar_unit = file.sidecar.units.get(name) or file.sidecar.units.get(cell)
        unit = header_unit or units_row[index] or sidecar_unit or "1"
        column = ChannelColumn(unit, cell, partial(raw_column, file, index))
        taken[index] = (cell if name in CHANNEL_UNITS else name, column)
    clock = clock_place(file.table)
    return {
        name: column
        for index, (name, column) in sorted(taken.items())
        if name != TIME and index != clock
    }


def refuse_unreadable(file: RecordFile, name: str) -> None:
    """Raise RecordError if the file has a channel's column, but no sequence of numbers in it."""
    found = _source_column(file, name) if name in CHANNEL_UNITS else None
    at = (
        [found.index]
        if found is not None
        else [index for index, cell in enumerate(file.table.header) if _called(cell, name)]
    )
    for index in at:
        if index in file.table.unreadable:
            numbers(file.table, index)


def refuse_misread(file: RecordFile, name: str) -> None:
    """Raise RecordError if a channel's column is missing, or has a unit of another dimension."""
    if name in CHANNEL_UNITS:
        column_of(file, name)


def named_inputs(
    names: str | Iterable[str], channels: Sequence[str], where: str
) -> tuple[str, ...]:
    """Return the names of the inputs; a text is one name.

    Raises
    ------
    RecordError : a name that no channel has.
    """
    if not isinstance(names, Iterable):
        raise RecordError(
            f"a {type(names).__name__} is no list of channels",
            where=f"{where}, inputs",
            remedy='give names of channels, such as ["elevator"]',
        )
    chosen = (names,) if isinstance(names, str) else tuple(names)
    for name in chosen:
        refuse_unknown("channel", name, channels, f"{where}, inputs", RecordError)
    return chosen


def refuse_units(units: Mapping[str, str], file: RecordFile) -> None:
    """Raise RecordError for a unit of a missing column, or one that the file contradicts."""
    table, where = file.table, f"{file.table.file}, units"
    columns = {choice.column for choice in file.choices.values()}
    for name, unit in units.items():
        stated_units = {
            cell: split_header(cell)[1] or (table.units[i] if table.units else "")
            for i, cell in enumerate(table.header)
            if _called(cell, name)
        }
        suffixed = [cell for cell in table.header if suffix_unit(cell, name) is not None]
        if not stated_units and suffixed:
            raise RecordError(
                f"column {suffixed[0]!r} says its unit itself",
                where=where,
                remedy="leave the unit out, or rename the column",
            )
        if not stated_units and name not in columns:
            names = [split_header(cell)[0] for cell in table.header if cell]
            refuse_unknown("column", name, names, where, RecordError)
        for stated in stated_units.values():
            if stated and stated != unit:
                what = f"column {name!r} is in {stated}, as it says itself, not in {unit}"
                raise RecordError(what, where=where, remedy="leave one of the two out")


def _called(cell: str, name: str | int) -> bool:
    return name in (cell, split_header(cell)[0])


def _source_column(file: RecordFile, name: str) -> SourceColumn | None:
    try:
        return column_of(file, name)
    except RecordError:
        return None


def _channel(file: RecordFile, name: str) -> np.ndarray:
    return read_record(file, (), (name,)).outputs[0].with_gaps()


def _numeric(file: RecordFile, index: int) -> bool:
    found = numbers(file.table, index)
    return not found.texts and bool(np.isfinite(found.values).any())


# ---- DataFrames

NAME = "record"


def file_of_columns(
    columns: Mapping[str, Any],
    name: str | None = None,
    units: Mapping[str, str] | None = None,
    hold: Hold | None = None,
    unreadable: Mapping[str, str] | None = None,
) -> RecordFile:
    """Return a record file of named sequences, with rows counted from 1.

    A time of datetimes counts from its first sample, one of timedeltas from zero, s.

    ``unreadable``: further names, with the reason why they hold no sequence of numbers. Reading one
    of them is an error.

    Raises
    ------
    RecordError : no column, no row, or columns that are not one-dimensional.
    """
    label = name or NAME
    header = tuple(header_cell(str(column), label) for column in columns)
    if not header:
        raise RecordError(
            "there is no column", where=label, remedy="give time and one column a channel"
        )
    values = tuple(
        _column(label, cell, column) for cell, column in zip(header, columns.values(), strict=True)
    )
    rows = max(column.size for column in values)
    if rows == 0:
        raise RecordError(
            "there is a header but no rows", where=label, remedy="give one row a sample"
        )
    faulty = dict(unreadable or {})
    table = CellTable(
        label,
        (*header, *(header_cell(name, label) for name in faulty)),
        (*values, *(np.full(rows, np.nan) for _ in faulty)),
        np.arange(1, rows + 1),
        unreadable={len(header) + at: reason for at, reason in enumerate(faulty.values())},
    )
    sidecar = Sidecar(label, hold or Hold.PREVIOUS, dict(units or {}), hold is not None)
    return RecordFile(
        Path(label), table, sidecar, InputFile(label, digest_of(table)), {}, in_memory=True
    )


def columns_of_frame(frame: pandas.DataFrame) -> dict[str, Any]:
    """Return the columns of a DataFrame by name, and its index if it has a name.

    An index that is named time is the time. So is an index of times if no column is named time.

    Raises RecordError if two columns have one name.
    """
    import pandas

    names = [frame_header(name) for name in frame.columns]
    columns: dict[str, Any] = {}
    for position, name in enumerate(names):
        if name in columns:
            raise RecordError(
                f"{names.count(name)} columns are headed {name!r}",
                where=NAME,
                remedy="rename all but one of them",
            )
        columns[name] = frame.iloc[:, position]
    index = frame.index
    named = index.name is not None and split_header(str(index.name))[0] == TIME
    if named or (
        isinstance(index, pandas.DatetimeIndex | pandas.TimedeltaIndex) and not _has_time(names)
    ):
        return {str(index.name) if named else TIME: index, **columns}
    levels = {
        str(name): index.get_level_values(at)
        for at, name in enumerate(index.names)
        if name is not None
    }
    return {**{name: values for name, values in levels.items() if name not in columns}, **columns}


def columns_of_record(record: Record) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Return the columns and units of a record in SI."""
    columns = {
        TIME: record.time,
        **{channel.name: channel.with_gaps() for channel in record.channels},
    }
    return columns, {TIME: "s", **{channel.name: channel.unit for channel in record.channels}}


def _has_time(names: Sequence[str]) -> bool:
    return any(split_header(name)[0] == TIME or name.startswith(f"{TIME}_") for name in names)


def _column(label: str, name: str, values: Any) -> np.ndarray:
    """Return a column as a file's table holds it: floats, or cells as objects."""
    array = _plain(values)
    if array.ndim != 1:
        raise RecordError(
            f"{array.ndim} dimensions",
            where=f"{label}, column {name!r}",
            remedy="give one value a sample",
        )
    if array.dtype.kind == "M":
        array = array - array[:1]
    if array.dtype.kind == "m":
        return np.where(np.isnat(array), np.nan, array / np.timedelta64(1, "ns") * 1e-9)
    return array.astype(float) if array.dtype.kind in "fiu" else array.astype(object)


def _plain(values: Any) -> np.ndarray:
    """Return a NumPy array; of a pandas column with NaN for missing numbers, and times in UTC."""
    dtype = getattr(values, "dtype", None)
    if getattr(dtype, "tz", None) is not None:
        # In UTC, since local clocks may be put forward.
        values = (values.dt if hasattr(values, "dt") else values).tz_convert(None)
    if not isinstance(dtype, np.dtype | None) and hasattr(values, "to_numpy"):
        import pandas

        if pandas.api.types.is_numeric_dtype(dtype) and not pandas.api.types.is_bool_dtype(dtype):
            return values.to_numpy(dtype=float, na_value=np.nan)
    if isinstance(values, np.ma.MaskedArray) and values.dtype.kind in "fiu":
        return np.asarray(np.ma.filled(values.astype(float), np.nan))
    return np.asarray(values)


def digest_of(table: CellTable) -> str:
    """Return the SHA-256 of header and cells."""
    digest = hashlib.sha256("\x1f".join(table.header).encode())
    for column in table.columns:
        array = np.asarray(column)
        digest.update(array.tobytes() if array.dtype.kind == "f" else repr(array.tolist()).encode())
    return digest.hexdigest()


# ---- Records from the containers of other packages


@dataclass(frozen=True)
class ContainerFacts:
    """Facts on a record in its container, besides the numbers; None or empty if not stated.

    ``unreadable``: variables without one value per sample, with the reason.
    """

    units: Mapping[str, str] = field(default_factory=dict)
    name: str | None = None
    hold: str | None = None
    inputs: tuple[str, ...] | None = None
    unreadable: Mapping[str, str] = field(default_factory=dict)


def unpacked(source: Any) -> tuple[Path | Mapping[str, Any], ContainerFacts]:
    """Return a path, or columns by name, and the facts that the container states.

    Raises
    ------
    RecordError : the source holds no record.
    """
    if isinstance(source, str | PathLike):
        return Path(source), ContainerFacts()
    if isinstance(source, Record):
        columns, units = columns_of_record(source)
        return columns, ContainerFacts(units, source.name, source.hold.value, source.input_names)
    if isinstance(source, Mapping) and not hasattr(source, "data_vars"):
        return source, ContainerFacts()
    kinds = {base.__name__ for base in type(source).__mro__}
    if "TimeResponseData" in kinds:
        return _of_response(source)
    if "Dataset" in kinds and hasattr(source, "data_vars"):
        return _of_dataset(source)
    if isinstance(source, np.ndarray) and source.dtype.names:
        return {name: source[name] for name in source.dtype.names}, ContainerFacts()
    if "DataFrame" not in kinds or not hasattr(source, "iloc"):
        if not hasattr(source, "to_pandas"):
            what = f"a {type(source).__name__} is no record"
            raise RecordError(
                what,
                where="read_record",
                remedy=(
                    "give a path, a DataFrame, a mapping of names to arrays, a Dataset or a "
                    "response"
                ),
            )
        source = source.to_pandas()
    return columns_of_frame(source), _of_attributes(source.attrs)


def _of_attributes(attributes: Mapping[str, Any]) -> ContainerFacts:
    """Return the facts in attributes that ``to_pandas`` and ``to_xarray`` write; ignore others."""
    units, name, hold, inputs = (attributes.get(key) for key in ("units", "name", "hold", "inputs"))
    return ContainerFacts(
        {str(key): str(value) for key, value in units.items()}
        if isinstance(units, Mapping)
        else {},
        name if isinstance(name, str) else None,
        hold if hold in ("previous", "linear") else None,
        tuple(map(str, inputs)) if isinstance(inputs, tuple | list) else None,
    )


def _of_response(response: control.TimeResponseData) -> tuple[Mapping[str, Any], ContainerFacts]:
    outputs = np.atleast_2d(response.y)
    inputs = (
        np.atleast_2d(response.u) if response.u is not None else np.zeros((0, len(response.time)))
    )
    if outputs.ndim != 2 or inputs.ndim != 2:
        raise RecordError(
            "it holds several traces",
            where="read_record",
            remedy="give one of them, for example response[:, 0]",
        )
    names = list(response.output_labels or [f"y[{i}]" for i in range(len(outputs))])
    controls = list(response.input_labels or [f"u[{i}]" for i in range(len(inputs))])[: len(inputs)]
    columns = {
        TIME: response.time,
        **dict(zip(controls, inputs, strict=True)),
        **dict(zip(names, outputs, strict=True)),
    }
    return columns, ContainerFacts(
        name=response.title or None, inputs=tuple(split_header(name)[0] for name in controls)
    )


def _of_dataset(dataset: xarray.Dataset) -> tuple[Mapping[str, Any], ContainerFacts]:
    time_dims = dataset[TIME].dims if TIME in dataset.variables else None
    columns: dict[str, Any] = {}
    units: dict[str, str] = {}
    unreadable: dict[str, str] = {}
    for key in (*dataset.coords, *dataset.data_vars):
        name, variable = str(key), dataset[key]
        if time_dims is not None and variable.dims != time_dims:
            dims, expected = (", ".join(map(str, each)) for each in (variable.dims, time_dims))
            unreadable[name] = f"over {dims}, not over {expected}" if dims else "a single number"
            continue
        columns[name] = variable.to_numpy()
        if "units" in variable.attrs:
            units[name] = str(variable.attrs["units"])
    facts = _of_attributes(dataset.attrs)
    return columns, replace(facts, units={**facts.units, **units}, unreadable=unreadable)


# ---- Records in any form, opened as record files

Units = Mapping[str, str]
# A channel map: channel -> column, with its unit where the column does not say it; or the path of a
# file with such a map.
ChannelMap = Mapping[str, str | tuple[str, str] | Mapping[str, str]] | str | PathLike[str]


def opened_source(
    source: Any,
    *,
    units: Units | None = None,
    channels: ChannelMap | None = None,
    hold: str | None = None,
    name: str | None = None,
) -> tuple[RecordFile, tuple[str, ...] | None]:
    """Return a record file from a path, table, arrays or container, and the inputs it names.

    The inputs are None if it names none. Only columns that ``units`` and ``channels`` name are
    checked. Raises RecordError and DeclarationError.
    """
    refuse_wrong_type("units", units, "Mapping | None")
    content, facts = unpacked(source)
    known = {**facts.units, **(units or {})}
    held = plan_of(hold=facts.hold if hold is None else hold).hold
    if isinstance(content, Path):
        file = read_record_file(content)
        sidecar = replace(file.sidecar, units={**file.sidecar.units, **known})
        file = replace(
            file,
            sidecar=sidecar
            if held is None
            else replace(sidecar, hold=Hold(held), states_hold=True),
        )
    else:
        file = file_of_columns(
            content, name or facts.name, known, held, unreadable=facts.unreadable
        )
    chosen = choices_of(channels, units or {})
    if chosen is not None:
        choices = (
            read_channel_map(chosen)
            if isinstance(chosen, Path)
            else read_channel_map(chosen, chosen)
        )
        file = _computed(replace(file, choices=choices))
    refuse_units(units or {}, file)
    return file, facts.inputs


def _computed(file: RecordFile) -> RecordFile:
    """Return the file with the channels that its map computes, and a log's topics on one grid."""
    from scenarios.files.measured.derived import with_derived

    names = [name for name in file.choices if name != TIME]
    controls = [name for name in names if name in INPUTS]
    known = {**{name: "1" for name in names}, **CHANNEL_UNITS}
    derived, choices = with_derived(
        file,
        file.choices,
        controls,
        [name for name in names if name not in controls],
        channel_units=known,
    )
    return replace(derived, choices=dict(choices or {}))


def choices_of(channels: Any, units: Units | None = None) -> Path | dict[str, Any] | None:
    """Return a channel map in the form of files, or its path; None for None.

    ``units``: units by column. Raises DeclarationError.
    """
    if channels is None:
        return None
    if isinstance(channels, str | PathLike):
        return Path(channels)
    if not isinstance(channels, Mapping):
        what = f"a {type(channels).__name__} is no channel map"
        raise DeclarationError(
            what, where="channels", remedy='give {"alpha": "HEADER", ...} or the path of a map'
        )
    return {key: _entry(value, units or {}) for key, value in channels.items()}


def _entry(value: Any, units: Units) -> Any:
    if isinstance(value, str):
        return {"column": value, **({"unit": units[value]} if value in units else {})}
    if isinstance(value, tuple | list) and len(value) == 2:
        return {"column": value[0], "unit": value[1]}
    return value
