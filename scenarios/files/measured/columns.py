"""Which column of a table is which channel, and in which unit: header cells, channel map and sidecar together."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from scenarios.files.channel_names import CHANNEL_UNITS, STICK, split_header
from scenarios.files.channels import ColumnChoice
from scenarios.files.declarations import closest
from scenarios.files.units import to_si
from sim.errors import RecordError

_SECOND = re.compile(r"(\w[\w.]*)\[1\]")


@dataclass(frozen=True)
class Column:
    """One channel's column.

    Attributes
    ----------
    channel : our name.
    header : the cell in the file.
    index : position in the table.
    unit : unit of the column's numbers; for the stick a label.
    inside : the unit that they are converted to, empty where the unit is a label.
    """

    channel: str
    header: str
    index: int
    unit: str
    inside: str


def split_at(header: Sequence[str], index: int) -> tuple[str, str | None]:
    """Name and unit of a cell of a header. ``xyz[1]`` beside ``xyz[0]`` or ``xyz[2]`` is an element of an array, in no unit."""
    found = _SECOND.fullmatch(header[index])
    if found is not None and (f"{found[1]}[0]" in header or f"{found[1]}[2]" in header):
        return header[index], None
    return split_header(header[index])


def suffix_unit(cell: str, channel: str) -> str | None:
    """Unit of ``channel_unit``: the first word over the others, ``q_deg_s`` is in ``deg/s``; None for any other header."""
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
    known: Mapping[str, str] = CHANNEL_UNITS,
    under: Sequence[str] = (),
    *,
    lenient: bool = False,
) -> Column | None:
    """The column of a channel, None if the table has none.

    A channel in ``choices`` is looked for under that header alone, or counts as absent. Else
    ``alpha``, ``alpha [deg]`` and ``alpha_deg``
    count; a ``alpha_word`` whose word is no unit of an angle counts as another signal if there is an ``alpha`` besides.
    ``units`` (the sidecar's) hold for headers without a unit, before them ``under``, the row of units under the header. ``known``: all
    channels that there are, and their units inside; a header that is another channel's name is that channel's alone. ``lenient``: a unit
    in ``under`` that cannot be one of the channel is left out, as the units are metadata that recorders fill in carelessly.

    Raises
    ------
    RecordError : two columns for the channel, a mapped column that is absent, an unknown unit, one of the wrong dimension, or two
        that contradict each other, in the header and under it.
    """
    if channel not in known:
        raise RecordError(f"there is no channel {channel!r}", where=file, remedy=closest(channel, known))
    default, inside = (units or {}).get(channel, known[channel]), inside_unit(channel, known)
    if choices is not None and channel in choices:
        if choices[channel].absent:
            return None
        return _mapped(channel, choices[channel], header, file, default, inside, under, lenient=lenient)
    named, suffixed = [], []
    cells = _in_our_case(channel, header, known)
    for index, cell in enumerate(cells):
        name, unit = split_at(cells, index)
        if name == channel:
            named.append(Column(channel, header[index], index, default if unit is None else unit or default, inside))
        elif name not in known and (word := suffix_unit(cell, channel)) is not None:
            suffixed.append(Column(channel, header[index], index, word, inside))
    readable = [column for column in suffixed if _unit_fault(column, file) is None]
    found = named + readable if inside else named or suffixed  # any word is a label
    if len(found) > 1:
        both = " and ".join(repr(column.header) for column in found)
        raise RecordError(f"columns {both} are all {channel}", where=file, remedy="leave one of them, or choose with --channels")
    chosen = found or suffixed[:1]
    if not chosen:
        return None
    said = chosen[0] in suffixed or split_header(chosen[0].header)[1] is not None
    return _sound(_with_unit_under(chosen[0], under, file, said=said, lenient=lenient), file)


def _in_our_case(channel: str, header: Sequence[str], known: Mapping[str, str]) -> Sequence[str]:
    """The header with ``Elevator`` and ``ALPHA`` written as the channel is, where no cell is written so and no other channel is meant."""
    if any(split_at(header, index)[0] == channel for index in range(len(header))):
        return header
    cells = list(header)
    for index, cell in enumerate(header):
        name = split_header(cell)[0]
        if name.lower() == channel.lower() and name not in known:
            cells[index] = channel + cell[len(name) :]
        elif name not in known and name[: len(channel) + 1].lower() == f"{channel.lower()}_" and not name.startswith(channel):
            cells[index] = channel + cell[len(channel) :].lower()
    return cells


def inside_unit(channel: str, known: Mapping[str, str] = CHANNEL_UNITS) -> str:
    """The unit that a channel is converted to; empty for a stick without one, whose unit is a label."""
    return "" if channel == STICK and known[channel] == "1" else known[channel]


def named_otherwise(channel: str, header: Sequence[str], choices: Mapping[str, ColumnChoice] | None = None) -> bool:
    """Whether all that reminds of a channel are headers such as ``airspeed_raw``, whose last words are no unit of it."""
    if channel in (choices or {}) or any(split_header(cell)[0] == channel for cell in header):
        return False
    words = [(cell, word) for cell in header if (word := suffix_unit(cell, channel)) is not None]
    return all(_unit_fault(Column(channel, cell, 0, word, inside_unit(channel)), "") is not None for cell, word in words)


def missing_column(channel: str, header: Sequence[str], file: str) -> RecordError:
    """The error for a channel that a model cannot do without."""
    present = [cell for cell in header if cell]
    shown = ", ".join(present[:20]) + (", ..." if len(present) > 20 else "")
    remedy = f'name the column {channel}, or give --channels a map with {channel} = {{column = "HEADER"}}'
    if header and header[0] == "column 1":  # the file has no header
        remedy = f"name the columns with --columns, or give --channels a map with {channel} = NUMBER"
    return RecordError(f"there is no column {channel!r}; the columns are {shown}", where=f"{file}, header", remedy=remedy)


def column_place(file: str, column: Column) -> str:
    """``record.csv, column 'alpha_deg'``."""
    return f"{file}, column {column.header!r}"


def _with_unit_under(column: Column, under: Sequence[str], file: str, *, said: bool, lenient: bool) -> Column:
    """The column in the unit of the row under its header, where that says one; ``said``: the header says one too, and both must be the same."""
    told = under[column.index] if under else ""
    if lenient and told and _unit_fault(replace(column, unit=told), file) is not None:
        told = ""
    if not told or not said:
        return replace(column, unit=told) if told else column
    if not _same_unit(column.unit, told, column.inside):
        what = f"the header says {column.unit}, the row of units under it {told}"
        raise RecordError(what, where=column_place(file, column), remedy="correct one of them")
    return column


def _same_unit(one: str, other: str, inside: str) -> bool:
    try:
        return one == other or (inside != "" and to_si(1.0, one, inside, "") == to_si(1.0, other, inside, ""))
    except RecordError:
        return False


def _sound(column: Column, file: str) -> Column:
    """The column, if its unit can be converted."""
    fault = _unit_fault(column, file)
    if fault is not None:
        raise fault
    return column


def _mapped(
    channel: str, choice: ColumnChoice, header: Sequence[str], file: str, default: str, inside: str, under: Sequence[str], *, lenient: bool
) -> Column:
    assert isinstance(choice.column, str)  # numbers are resolved before
    found = [index for index, cell in enumerate(header) if cell == choice.column]
    found = found or [index for index, cell in enumerate(header) if split_header(cell)[0] == choice.column]
    if not found:
        error = missing_column(channel, header, file)
        what = error.what.replace(repr(channel), f"{choice.column!r}, which the channel map names for {channel}", 1)
        raise RecordError(what, where=error.where, remedy=f"correct the channel map: {closest(choice.column, [cell for cell in header if cell])}")
    if len(found) > 1:
        raise RecordError(f"{len(found)} columns are headed {choice.column!r}", where=f"{file}, header", remedy="rename all but one of them")
    cell = header[found[0]]
    if choice.unit is not None:
        return _sound(Column(channel, cell, found[0], choice.unit or default, inside), file)
    unit = split_at(header, found[0])[1]
    column = Column(channel, cell, found[0], unit or default, inside)
    return _sound(_with_unit_under(column, under, file, said=bool(unit), lenient=lenient), file)


def _unit_fault(column: Column, file: str) -> RecordError | None:
    if not column.inside:
        return None
    try:
        to_si(1.0, column.unit, column.inside, column_place(file, column))
    except RecordError as fault:
        return fault
    return None
