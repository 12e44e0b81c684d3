"""Channels that are computed from columns: a table with one column a channel comes out."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from scenarios.files.declarations import CHANNEL_UNITS, TIME, ColumnChoice, closest, split_header
from scenarios.files.formats.cells import CellTable, Topic, numbers
from scenarios.files.measured.columns import RecordFile, inside_unit, map_command
from scenarios.files.measured.expressions import evaluate, is_plain_name, parse
from scenarios.files.measured.grid import (
    Place,
    Wanted,
    calibrated,
    clock_of,
    clock_place,
    delayed,
    merged,
    topic_numbers,
    unit_of,
)
from sim.errors import RecordError


def with_derived(
    file: RecordFile,
    choices: Mapping[str, ColumnChoice] | None,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    rate: float | None = None,
    hold: str | None = None,
    channel_units: Mapping[str, str] = CHANNEL_UNITS,
) -> tuple[RecordFile, Mapping[str, ColumnChoice] | None]:
    """Return the file with a column for each channel that has to be computed, and the channel map
    that finds them.

    Parameters
    ----------
    file : the file as it was read.
    choices : channel map, None for none.
    inputs, outputs : channels that are requested.
    rate : Hz, of the grid that topics are put on; None: of the fastest output's topic.
    hold : how inputs go on between their own samples; None: by the channel map, else by their
        values.
    channel_units : all channels and their units inside.

    Raises
    ------
    RecordError : a column, topic or clock that is not there or not the only one of its name; an
        expression that cannot be computed.
    """
    absent = {name: choice for name, choice in (choices or {}).items() if choice.absent}
    chosen = {
        name: choice
        for name, choice in (choices or {}).items()
        if (name in inputs or name in outputs or name == TIME) and name not in absent
    }
    topics = file.topics if len(file.topics) > 1 else (Topic("", file.table),)
    if len(topics) > 1:
        others = [name for name in (*inputs, *outputs) if name not in chosen and name not in absent]
        direct = {
            name: ColumnChoice(name)
            for name in others
            if _unique(name, topics) and (name in inputs or _measured(name, topics))
        }
        wanted = [
            _wanted(file, topics, name, each, name in inputs, channel_units)
            for name, each in {**direct, **chosen}.items()
            if name != TIME
        ]
        if not wanted:
            what = (
                f"a log of {len(topics)} topics ({', '.join(topic.name for topic in topics[:8])}, "
                "...)"
            )
            raise RecordError(
                what,
                where=str(file.path),
                remedy=(
                    f"make a channel map with {map_command(file.path)}, and name it with --channels"
                ),
            )
        single, result = merged(file, topics, wanted, rate, hold, channel_units)
        return single, {**result, **absent}
    needed = {name: choice for name, choice in chosen.items() if _is_computed(choice, file.table)}
    if not needed:
        return file, choices
    return _computed(file, needed, choices or {}, inputs, channel_units)


def source_columns(
    file: RecordFile,
    choices: Mapping[str, ColumnChoice],
    inputs: Sequence[str],
    outputs: Sequence[str],
) -> tuple[int, ...]:
    """Return the columns of a file with one table that channels are computed from; empty if each
    channel is a column.
    """
    requested = {
        name: choice
        for name, choice in choices.items()
        if name in (*inputs, *outputs) and not choice.absent and _is_computed(choice, file.table)
    }
    wanted = [
        _wanted(file, (Topic("", file.table),), name, choice, name in inputs, CHANNEL_UNITS)
        for name, choice in requested.items()
    ]
    return tuple(sorted({index for each in wanted for _, index in each.places.values()}))


def _is_computed(choice: ColumnChoice, table: CellTable) -> bool:
    if isinstance(choice.column, int) or choice.computed:
        return True
    headers = {cell for cell in table.header} | {split_header(cell)[0] for cell in table.header}
    return choice.column not in headers and not is_plain_name(choice.column)


def _unique(name: str, topics: Sequence[Topic]) -> bool:
    return sum(name in topic.table.header for topic in topics) == 1


def _measured(name: str, topics: Sequence[Topic]) -> bool:
    """Return whether an unmapped field has any value except zero: loggers have fields for absent
    sensors.
    """
    topic, index = _places(name, topics)[0]
    values = numbers(topics[topic].table, index).values
    return bool(np.any(np.isfinite(values) & (values != 0.0)))


def _wanted(
    file: RecordFile,
    topics: Sequence[Topic],
    channel: str,
    choice: ColumnChoice,
    is_input: bool,
    channel_units: Mapping[str, str],
) -> Wanted:
    where = f"{file.path}, channel {channel}"
    if isinstance(choice.column, int):
        if len(topics) > 1 or choice.column > len(topics[0].table.header):
            width = len(topics[0].table.header)
            what = (
                f"there is no column {choice.column}"
                if len(topics) == 1
                else "a column's number means nothing in a log of several topics"
            )
            raise RecordError(
                what,
                where=where,
                remedy=f"the columns are numbered 1 to {width}"
                if len(topics) == 1
                else "write topic.field",
            )
        name = f"#{choice.column}"
        return Wanted(
            channel, choice, parse(f"`{name}`", where), {name: (0, choice.column - 1)}, is_input
        )
    whole = _places(choice.column, topics)
    expression = parse(f"`{choice.column}`" if whole else choice.column, where)
    places: dict[str, Place] = {}
    for column in expression.columns:
        result = _places(column, topics)
        if len(result) != 1:
            raise _not_one(file, topics, column, result, where)
        places[column] = result[0]
    if not places:
        raise RecordError(
            f"{choice.column!r} reads no column", where=where, remedy="name at least one column"
        )
    return Wanted(channel, choice, expression, places, is_input)


def _places(name: str, topics: Sequence[Topic]) -> list[Place]:
    """Return the positions of a column: ``topic.field``, else a field that only one topic has."""
    places: list[Place] = []
    for number, topic in enumerate(topics):
        for index, cell in enumerate(topic.table.header):
            bare = split_header(cell)[0]
            if topic.name and name in (f"{topic.name}.{cell}", f"{topic.name}.{bare}"):
                return [(number, index)]
            if name in (cell, bare):
                places.append((number, index))
    exact = [place for place in places if topics[place[0]].table.header[place[1]] == name]
    return exact if len(exact) == 1 else places


def _recorder_of(column: str) -> str:
    """Return the autopilot whose logs name a column so: ``IMU[0].GyrY``, ``vane.alpha``; empty if
    the name has no topic.
    """
    topic, dot, _ = column.partition(".")
    name = topic.partition("[")[0]
    if not dot or not re.fullmatch(r"[A-Z0-9]{2,4}|[a-z][a-z0-9_]*", name):
        return ""
    return "ArduPilot" if name.isupper() else "PX4"


def _not_one(
    file: RecordFile, topics: Sequence[Topic], column: str, positions: Sequence[Place], where: str
) -> RecordError:
    if positions:
        inside = [
            f"{topics[topic].name}.{column}" if topics[topic].name else f"column {index + 1}"
            for topic, index in positions
        ]
        return RecordError(
            f"{column!r} is in {len(inside)} places",
            where=where,
            remedy=f"write one of {', '.join(inside[:6])}",
        )
    names = [
        f"{topic.name}.{cell}" if topic.name else cell
        for topic in topics
        for cell in topic.table.header
    ]
    kinds = [_recorder_of(name) for name in (column, *names[:1])]
    if len(topics) > 1 and all(kinds) and kinds[0] != kinds[1]:
        return RecordError(
            f"there is no column {column!r}: the channel map is for logs of {kinds[0]}, and this "
            f"is one of {kinds[1]}",
            where=where,
            remedy="flightid map FILE drafts one",
        )
    return RecordError(
        f"there is no column {column!r}",
        where=where,
        remedy=closest(column, names) if len(names) < 400 else "see flightid map",
    )


def _computed(
    file: RecordFile,
    needed: Mapping[str, ColumnChoice],
    choices: Mapping[str, ColumnChoice],
    inputs: Sequence[str],
    channel_units: Mapping[str, str],
) -> tuple[RecordFile, Mapping[str, ColumnChoice]]:
    """Return a single table with further columns, one for each computed channel."""
    table, topics = file.table, (Topic("", file.table),)
    header, columns = list(table.header), list(table.columns)
    units = list(table.units) if table.units else []
    new, notes = dict(choices), list(file.notes)
    for channel, choice in needed.items():
        wanted = _wanted(file, topics, channel, choice, channel in inputs, channel_units)
        if channel == TIME:
            place = next(iter(wanted.places.values()))
            clock = clock_of(table, place[1], choice.unit) if not wanted.computed else None
            values = clock.time if clock is not None else _values(file, wanted, topics, choice.unit)
            unit = "s" if clock is not None or choice.unit is None else choice.unit
        else:
            values, unit, note = _in_unit(file, wanted, topics, channel_units)
            notes += [f"{channel}: {note}"] if note else []
        if choice.delay:
            place_of_clock = _clock_index(table, choices)
            if place_of_clock is None:
                raise RecordError(
                    "a delay needs a clock",
                    where=f"{file.path}, channel {channel}",
                    remedy="name the column of time",
                )
            values = delayed(clock_of(table, place_of_clock).time, values, choice.delay)
        label = f"{channel} (computed)"
        header.append(label)
        columns.append(np.asarray(values, dtype=float))
        units += [unit] if units else []
        new[channel] = ColumnChoice(label, unit, hold=choice.hold)
    wider = replace(table, header=tuple(header), columns=tuple(columns), units=tuple(units))
    return replace(file, table=wider, notes=tuple(notes)), new


def _clock_index(table: CellTable, choices: Mapping[str, ColumnChoice]) -> int | None:
    choice = choices.get(TIME)
    if choice is not None and isinstance(choice.column, str):
        return next(
            (
                n
                for n, cell in enumerate(table.header)
                if choice.column in (cell, split_header(cell)[0])
            ),
            None,
        )
    return (
        choice.column - 1
        if choice is not None and isinstance(choice.column, int)
        else clock_place(table)
    )


def _in_unit(
    file: RecordFile, wanted: Wanted, topics: Sequence[Topic], channel_units: Mapping[str, str]
) -> tuple[np.ndarray, str, str]:
    """A channel's values as computed, their unit, and a sentence on a unit that is not used."""
    unit, note = unit_of(wanted, topics, channel_units)
    return (
        _values(file, wanted, topics, unit),
        inside_unit(wanted.channel, channel_units) if unit is None else unit,
        note,
    )


def _values(
    file: RecordFile, wanted: Wanted, topics: Sequence[Topic], unit: str | None
) -> np.ndarray:
    """Return the values of a channel's expression on its columns' own rows; with ``unit`` None
    columns of stated units are in SI.
    """
    columns = {
        name: topic_numbers(file, topics, place, wanted, si=unit is None)
        for name, place in wanted.places.items()
    }
    where = f"{file.path}, channel {wanted.channel}"
    sizes = {values.size for values in columns.values()}
    if len(sizes) > 1:
        raise RecordError(
            "its columns have different lengths", where=where, remedy="use columns of one table"
        )
    return calibrated(evaluate(wanted.expression, columns, where), wanted.choice)
