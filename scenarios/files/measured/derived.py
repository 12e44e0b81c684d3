"""Channels that are computed from columns of a file: the result is one table with these columns."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from scenarios.files.declarations import (
    CHANNEL_UNITS,
    TIME,
    ColumnChoice,
    closest,
    shortened_list,
    split_header,
)
from scenarios.files.formats.cells import CellTable, Topic, numbers
from scenarios.files.measured.columns import RecordFile, map_command, program_unit
from scenarios.files.measured.expressions import evaluate, is_plain_name, parse
from scenarios.files.measured.grid import (
    ChannelRequest,
    Place,
    clock_of,
    clock_place,
    merge_topics,
    topic_numbers,
    unit_of,
    with_calibration,
    without_delay,
)
from sim.errors import RecordError

# from this number of column names on, no similar name is searched for
MAX_NAMES_FOR_SUGGESTION = 400


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
    """Return the file with a further column for each computed channel, and the channel map of the
    new file.

    Parameters
    ----------
    file : file with one table, or a log of several topics.
    choices : channel map; None without one.
    inputs, outputs : requested channels.
    rate : sample rate, Hz, to which topics are brought; None takes that of the fastest topic with
        an output.
    hold : interpolation of inputs between their own samples; None takes that of the channel map,
        else that which the values show.
    channel_units : channel -> unit in the program, for all channels.

    Raises
    ------
    RecordError : if a column, topic or clock is missing or ambiguous, or if an expression cannot be
        computed.
    """
    absent = {name: choice for name, choice in (choices or {}).items() if choice.absent}
    chosen = {
        name: choice
        for name, choice in (choices or {}).items()
        if (name in inputs or name in outputs or name == TIME) and name not in absent
    }
    topics = file.topics
    if len(topics) > 1:
        unmapped = [
            name for name in (*inputs, *outputs) if name not in chosen and name not in absent
        ]
        by_own_name = {
            name: ColumnChoice(name)
            for name in unmapped
            if _is_unique(name, topics) and (name in inputs or _is_measured(name, topics))
        }
        requests = [
            _request_of(file, topics, name, choice, name in inputs, channel_units)
            for name, choice in {**by_own_name, **chosen}.items()
            if name != TIME
        ]
        if not requests and TIME in chosen:
            single, clock = _topic_with_clock(file, chosen[TIME], channel_units)
            return with_derived(
                single, {TIME: clock, **absent}, inputs, outputs, channel_units=channel_units
            )
        if not requests:
            names = shortened_list([topic.name for topic in topics], 8)
            raise RecordError(
                f"a log of {len(topics)} topics ({names})",
                where=str(file.path),
                remedy=(
                    f"make a channel map with {map_command(file.path)}, and name it with --channels"
                ),
            )
        single, new_choices = merge_topics(file, topics, requests, rate, hold, channel_units)
        return single, {**new_choices, **absent}
    computed = {name: choice for name, choice in chosen.items() if _is_computed(choice, file.table)}
    if not computed:
        return file, choices
    return _with_computed_columns(file, computed, choices or {}, inputs, channel_units)


def source_columns(
    file: RecordFile,
    choices: Mapping[str, ColumnChoice],
    inputs: Sequence[str],
    outputs: Sequence[str],
) -> tuple[int, ...]:
    """Return the positions of the columns from which channels of a file with one table are
    computed; empty if no channel is computed.
    """
    requested = {
        name: choice
        for name, choice in choices.items()
        if name in (*inputs, *outputs) and not choice.absent and _is_computed(choice, file.table)
    }
    requests = [
        _request_of(file, (Topic("", file.table),), name, choice, name in inputs, CHANNEL_UNITS)
        for name, choice in requested.items()
    ]
    return tuple(sorted({index for item in requests for _, index in item.places.values()}))


def _topic_with_clock(
    file: RecordFile, choice: ColumnChoice, channel_units: Mapping[str, str]
) -> tuple[RecordFile, ColumnChoice]:
    """Return a file with only the topic whose clock the channel map names, and the map's entry for
    the clock, rewritten without the name of the topic.

    Raises
    ------
    RecordError : if the column is missing, or if the entry names columns of several topics.
    """
    where = f"{file.path}, channel {TIME}"
    request = _request_of(file, file.topics, TIME, choice, False, channel_units)
    numbers_of_topics = {number for number, _ in request.places.values()}
    if len(numbers_of_topics) > 1:
        raise RecordError(
            f"{choice.column!r} names columns of several topics",
            where=where,
            remedy="name the clock of one topic",
        )
    topic = file.topics[numbers_of_topics.pop()]
    note = f"only {topic.name} is read, whose clock the channel map names"
    single = replace(file, table=topic.table, topics=(), notes=(*file.notes, note))
    return single, replace(choice, column=str(choice.column).replace(f"{topic.name}.", ""))


def _is_computed(choice: ColumnChoice, table: CellTable) -> bool:
    """Return whether a channel needs a column of its own in the new table: it is an expression, or
    a column chosen by number.
    """
    if isinstance(choice.column, int) or choice.computed:
        return True
    headers = {cell for cell in table.header} | {split_header(cell)[0] for cell in table.header}
    return choice.column not in headers and not is_plain_name(choice.column)


def _is_unique(name: str, topics: Sequence[Topic]) -> bool:
    return sum(name in topic.table.header for topic in topics) == 1


def _is_measured(name: str, topics: Sequence[Topic]) -> bool:
    """Return whether a field has a value other than zero. Loggers have fields of zeros for sensors
    that are not installed.
    """
    topic, index = _places(name, topics)[0]
    values = numbers(topics[topic].table, index).values
    return bool(np.any(np.isfinite(values) & (values != 0.0)))


def _request_of(
    file: RecordFile,
    topics: Sequence[Topic],
    channel: str,
    choice: ColumnChoice,
    is_input: bool,
    channel_units: Mapping[str, str],
) -> ChannelRequest:
    """Return the request for a channel: its expression and the places of its columns.

    Raises
    ------
    RecordError : if a column is missing or ambiguous.
    """
    where = f"{file.path}, channel {channel}"
    if isinstance(choice.column, int):
        if len(topics) > 1:
            what = "a column's number means nothing in a log of several topics"
            raise RecordError(what, where=where, remedy="write topic.field")
        width = len(topics[0].table.header)
        if choice.column > width:
            what = f"there is no column {choice.column}"
            raise RecordError(what, where=where, remedy=f"the columns are numbered 1 to {width}")
        name = f"#{choice.column}"
        return ChannelRequest(
            channel, choice, parse(f"`{name}`", where), {name: (0, choice.column - 1)}, is_input
        )
    is_column = bool(_places(choice.column, topics))
    expression = parse(f"`{choice.column}`" if is_column else choice.column, where)
    places: dict[str, Place] = {}
    for column in expression.columns:
        candidates = _places(column, topics)
        if len(candidates) != 1:
            raise _missing_or_ambiguous(file, topics, column, candidates, where)
        places[column] = candidates[0]
    if not places:
        raise RecordError(
            f"{choice.column!r} reads no column", where=where, remedy="name at least one column"
        )
    return ChannelRequest(channel, choice, expression, places, is_input)


def _places(name: str, topics: Sequence[Topic]) -> list[Place]:
    """Return the places of a column: that of ``topic.field``, or those of all fields with the
    name.
    """
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
    """Return the autopilot whose logs have such a column: ArduPilot for ``IMU[0].GyrY``, PX4 for
    ``vane.alpha``, and an empty text for a name without a topic.
    """
    topic, dot, _ = column.partition(".")
    name = topic.partition("[")[0]
    if not dot or not re.fullmatch(r"[A-Z0-9]{2,4}|[a-z][a-z0-9_]*", name):
        return ""
    return "ArduPilot" if name.isupper() else "PX4"


def _missing_or_ambiguous(
    file: RecordFile, topics: Sequence[Topic], column: str, places: Sequence[Place], where: str
) -> RecordError:
    """Return the error for a column with several ``places``, or with none."""
    if places:
        names = [
            f"{topics[topic].name}.{column}" if topics[topic].name else f"column {index + 1}"
            for topic, index in places
        ]
        return RecordError(
            f"{column!r} is in {len(names)} places",
            where=where,
            remedy=f"write one of {', '.join(names[:6])}",
        )
    names = [
        f"{topic.name}.{cell}" if topic.name else cell
        for topic in topics
        for cell in topic.table.header
    ]
    recorders = [_recorder_of(name) for name in (column, *names[:1])]
    if len(topics) > 1 and all(recorders) and recorders[0] != recorders[1]:
        return RecordError(
            f"there is no column {column!r}: the channel map is for logs of {recorders[0]}, and "
            f"this is one of {recorders[1]}",
            where=where,
            remedy="flightid map FILE drafts one",
        )
    remedy = closest(column, names) if len(names) < MAX_NAMES_FOR_SUGGESTION else "see flightid map"
    return RecordError(f"there is no column {column!r}", where=where, remedy=remedy)


def _with_computed_columns(
    file: RecordFile,
    computed: Mapping[str, ColumnChoice],
    choices: Mapping[str, ColumnChoice],
    inputs: Sequence[str],
    channel_units: Mapping[str, str],
) -> tuple[RecordFile, Mapping[str, ColumnChoice]]:
    """Return a file of one table with a further column for each ``computed`` channel, and its
    channel map.
    """
    table, topics = file.table, (Topic("", file.table),)
    header, columns = list(table.header), list(table.columns)
    units = list(table.units) if table.units else []
    new_choices, notes = dict(choices), list(file.notes)
    for channel, choice in computed.items():
        request = _request_of(file, topics, channel, choice, channel in inputs, channel_units)
        if channel == TIME:
            if request.computed:
                values = _values(file, request, topics, choice.unit)
                unit = "s" if choice.unit is None else choice.unit
            else:
                _, index = next(iter(request.places.values()))
                values, unit = clock_of(table, index, choice.unit).time, "s"
        else:
            values, unit, note = _values_and_unit(file, request, topics, channel_units)
            if note:
                notes.append(f"{channel}: {note}")
        if choice.delay:
            clock_index = _clock_index(table, choices)
            if clock_index is None:
                raise RecordError(
                    "a delay needs a clock",
                    where=f"{file.path}, channel {channel}",
                    remedy="name the column of time",
                )
            values = without_delay(clock_of(table, clock_index).time, values, choice.delay)
        label = f"{channel} (computed)"
        header.append(label)
        columns.append(np.asarray(values, dtype=float))
        if units:
            units.append(unit)
        new_choices[channel] = ColumnChoice(label, unit, hold=choice.hold)
    wider = replace(table, header=tuple(header), columns=tuple(columns), units=tuple(units))
    return replace(file, table=wider, notes=tuple(notes)), new_choices


def _clock_index(table: CellTable, choices: Mapping[str, ColumnChoice]) -> int | None:
    """Return the position of the column of time; None if it is not found."""
    choice = choices.get(TIME)
    if choice is None:
        return clock_place(table)
    if isinstance(choice.column, int):
        return choice.column - 1
    for index, cell in enumerate(table.header):
        if choice.column in (cell, split_header(cell)[0]):
            return index
    return None


def _values_and_unit(
    file: RecordFile,
    request: ChannelRequest,
    topics: Sequence[Topic],
    channel_units: Mapping[str, str],
) -> tuple[np.ndarray, str, str]:
    """Return the computed values ``(N,)`` of a channel, their unit, and a note if the unit in the
    header of the file is overruled; else an empty text.
    """
    unit, note = unit_of(request, topics, channel_units)
    values = _values(file, request, topics, unit)
    return values, program_unit(request.channel, channel_units) if unit is None else unit, note


def _values(
    file: RecordFile, request: ChannelRequest, topics: Sequence[Topic], unit: str | None
) -> np.ndarray:
    """Return the values ``(N,)`` of the expression of a channel at the rows of its columns. If
    ``unit`` is None, columns with a stated unit are converted to SI units first.
    """
    columns = {
        name: topic_numbers(file, topics, place, request, si=unit is None)
        for name, place in request.places.items()
    }
    where = f"{file.path}, channel {request.channel}"
    sizes = {values.size for values in columns.values()}
    if len(sizes) > 1:
        raise RecordError(
            "its columns have different lengths", where=where, remedy="use columns of one table"
        )
    return with_calibration(evaluate(request.expression, columns, where), request.choice)
