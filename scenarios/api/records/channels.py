"""The channels of a record file without a model that asks for them: what is ours by name and unit, and the other columns as they stand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from scenarios.files.channel_names import CHANNEL_UNITS, STICK, TIME, split_header
from scenarios.files.declarations import closest
from scenarios.files.formats.cells import numbers
from scenarios.files.measured.columns import Column as Found
from scenarios.files.measured.columns import suffix_unit
from scenarios.files.measured.derived import clock_place
from scenarios.files.measured.record_file import RecordFile
from scenarios.files.records import column_of, raw_column, read_record
from sim.errors import RecordError

INPUTS = ("elevator", STICK, "aileron", "rudder", "thrust")


@dataclass(frozen=True)
class Column:
    """A channel's unit, and how its values ``(N,)`` are read; ``header`` is its cell in the file."""

    unit: str
    header: str
    values: Callable[[], np.ndarray]


def columns_of(file: RecordFile) -> dict[str, Column]:
    """Every channel of a record file, time left out, in the order of its columns.

    A column that is none of our channels, or of a unit that does not fit it, keeps its name and numbers; one without numbers is left out, and
    so is one that is no sequence (``refuse_unreadable``).
    """
    taken: dict[int, tuple[str, Column]] = {}
    under = file.table.units or ("",) * len(file.table.header)
    for name in sorted(CHANNEL_UNITS, key=lambda each: each not in file.choices):  # what is mapped is nothing else
        found, unit = _found(file, name), CHANNEL_UNITS[name]
        if found is not None and found.index not in taken and found.index not in file.table.unreadable:
            told = found.unit if name == STICK else unit
            taken[found.index] = (name, Column(told, found.header, partial(_channel, file, name)))
    for name in (each for each in file.choices if each not in CHANNEL_UNITS):
        choice = file.choices[name]
        for index, cell in enumerate(file.table.header):
            if choice.column in (cell, split_header(cell)[0]):
                taken[index] = (name, Column(choice.unit or split_header(cell)[1] or under[index] or "1", cell, partial(_raw, file, index)))
    for index, cell in enumerate(file.table.header):
        if index not in taken and index not in file.table.unreadable and cell and _numeric(file, index):
            name, unit_told = split_header(cell)
            told = unit_told or under[index] or file.sidecar.units.get(name) or file.sidecar.units.get(cell) or "1"
            taken[index] = (name if name not in CHANNEL_UNITS else cell, Column(told, cell, partial(_raw, file, index)))
    clock = clock_place(file.table)
    return {name: column for index, (name, column) in sorted(taken.items()) if name != TIME and index != clock}


def refuse_unreadable(file: RecordFile, name: str) -> None:
    """Raise RecordError where a channel's column is in the file and holds no sequence of numbers."""
    found = _found(file, name) if name in CHANNEL_UNITS else None
    at = [found.index] if found is not None else [index for index, cell in enumerate(file.table.header) if _called(cell, name)]
    for index in at:
        if index in file.table.unreadable:
            numbers(file.table, index)


def refuse_units(units: Mapping[str, str], file: RecordFile) -> None:
    """Raise RecordError for a unit of a column that is not there, or of one that says another itself, in its header or under it."""
    table, where = file.table, f"{file.table.file}, units"
    columns = {choice.column for choice in file.choices.values()}
    for name, unit in units.items():
        said = {cell: split_header(cell)[1] or (table.units[i] if table.units else "") for i, cell in enumerate(table.header) if _called(cell, name)}
        suffixed = [cell for cell in table.header if suffix_unit(cell, name) is not None]
        if not said and suffixed:
            raise RecordError(f"column {suffixed[0]!r} says its unit itself", where=where, remedy="leave the unit out, or rename the column")
        if not said and name not in columns:
            names = [split_header(cell)[0] for cell in table.header if cell]
            raise RecordError(f"there is no column {name!r}", where=where, remedy=closest(name, names))
        for told in (told for told in said.values() if told and told != unit):
            what = f"column {name!r} is in {told}, as it says itself, not in {unit}"
            raise RecordError(what, where=where, remedy="leave one of the two out")


def _called(cell: str, name: str) -> bool:
    return name in (cell, split_header(cell)[0])


def _found(file: RecordFile, name: str) -> Found | None:
    try:
        return column_of(file, name)
    except RecordError:
        return None


def _channel(file: RecordFile, name: str) -> np.ndarray:
    return read_record(file, (), (name,)).outputs[0].with_gaps()


def _raw(file: RecordFile, index: int) -> np.ndarray:
    return raw_column(file, index)


def _numeric(file: RecordFile, index: int) -> bool:
    found = numbers(file.table, index)
    return not found.texts and bool(np.isfinite(found.values).any())
