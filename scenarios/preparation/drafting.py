"""Draft a channel map from the headers of a file: guess each channel, and try to read it.

Each guess has a reason.
"""

from __future__ import annotations

import re
import tomllib
import unicodedata
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np

from ident.recording.missing_samples import fill_value
from scenarios.files.declarations import CHANNEL_UNITS, TIME, ColumnChoice, is_clock, split_header
from scenarios.files.formats.cells import Topic, numbers
from scenarios.files.measured.clock import SECONDS, grid_of_coarse_stamps
from scenarios.files.measured.columns import RecordFile, name_and_unit
from scenarios.files.measured.grid import clock_of, clock_place, holds_dates, measures, stated_unit
from scenarios.files.records import read_record
from sim.errors import RecordError

SURFACES = ("elevator", "stick", "aileron", "rudder", "thrust")
COMMANDS = ("roll_command", "pitch_command", "yaw_command", "thrust_command")
INPUTS = (*SURFACES, *COMMANDS)
# PX4 columns with the type of vehicle, and the number of a multirotor.
ROTARY_WING = {"vehicle_status.vehicle_type": 1.0, "vehicle_status.is_rotary_wing": 1.0}
UNIT_SUFFIXES = {  # Unit by its spelling after a name without brackets.
    "deg": "deg", "rad": "rad", "ktas": "kt", "kts": "kt", "ft": "ft", "ftmsl": "ft", "degs": "deg/s", "rads": "rad/s", "g": "g",  # noqa: E501
    "dps": "deg/s", "rps": "rad/s", "fps": "ft/s", "fps2": "ft/s2", "mps": "m/s", "mps2": "m/s2", "psf": "lbf/ft2",  # noqa: E501
}  # fmt: skip
# An angle or rate without a unit that moves farther is more likely to be in degrees.
LARGEST_IN_RADIANS = {"rad": 1.6, "rad/s": 8.0}
# Most samples of any flight stay below; beyond, the unit is wrong.
LARGEST_IN_FLIGHT = {"rad": LARGEST_IN_RADIANS["rad"], "rad/s": 20.0}
MOST_UNUSED = 60  # largest number of columns without a channel that are tried
SERVO_PULSES = re.compile(r"RCOU\.C\d+")  # outputs to the servos of ArduPilot, us
EVEN_CLOCK_TOLERANCE = 1e-3  # largest relative deviation of a step of a clock that is no gap
MOST_GAP_SHARE = 0.02  # largest share of the steps of a clock that are gaps
# With an aileron or a rudder, these channels suggest the model ``aircraft``.
ALL_AXES = {"elevator", "p", "q", "r", "airspeed", "alpha"}
# Names of topics without measured motion.
NO_MEASUREMENT = re.compile(r"setpoint|_sp\b|status|innov|target|reference|command")
UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})


@dataclass(frozen=True)
class Guess:
    """A channel of the draft.

    Attributes
    ----------
    channel : name of the channel.
    choice : its column or expression.
    reason : why this column, in a few words.
    samples : number of values.
    least, most : smallest and largest value, SI.
    fault : error when the channel was read, or empty.
    command : whether the channel is an angle and its column a command from -1 to 1.
    """

    channel: str
    choice: ColumnChoice
    reason: str
    samples: int = 0
    least: float = 0.0
    most: float = 0.0
    fault: str = ""
    command: bool = False


@dataclass(frozen=True)
class TopicSummary:
    """A topic of a log: name, columns, number of rows, and rate in Hz (zero without a clock)."""

    name: str
    columns: tuple[str, ...]
    rows: int
    rate: float


@dataclass(frozen=True, eq=False)
class Draft:
    """A draft of a channel map.

    Attributes
    ----------
    file : the record file.
    topics : topics of the file.
    guesses : channels that were found, in the order of ``CHANNEL_UNITS``.
    faults : errors of the file, one line each.
    unused : columns that no channel takes.
    model : name of the model that the channels suit; empty if they suit none.
    clockless : whether the file has no clock and no rate was given.
    constant : column by channel that is recorded but constant.
    moving : columns of servo pulses that move and that no channel takes.
    readable : whether a channel or an unused column can be read, or no channel was found.
    """

    file: RecordFile
    topics: tuple[TopicSummary, ...]
    guesses: tuple[Guess, ...]
    faults: tuple[str, ...]
    unused: tuple[str, ...]
    model: str
    clockless: bool = False
    constant: Mapping[str, str] = field(default_factory=dict)
    moving: tuple[str, ...] = ()
    readable: bool = True

    @property
    def nearest(self) -> str:
        """Return the model that the channels suit; ``lateral`` for lateral outputs only."""
        readable = {guess.channel for guess in self.guesses if not guess.fault}
        lateral = readable & {"p", "r", "beta", "phi", "ay", "ny"}
        if self.model or not lateral or readable & {"elevator", "q", "alpha", "nz", "az"}:
            return self.model
        return "lateral"


def drafted(file: RecordFile, rate: float | None = None) -> Draft:
    """Guess the channels of a file and try each of them.

    Parameters
    ----------
    file : the open file.
    rate : Hz; sample rate of a file without a clock.
    """
    topics = topics_of(file)
    guesses = _guesses(CHANNEL_UNITS, topics, _in_degrees(topics))
    clockless: tuple[str, ...] = ()
    if not any(guess.channel == TIME for guess in guesses) and len(topics) == 1 and rate is None:
        clockless = (
            "the file has no clock; give its rate with --rate HZ, or name the column of time",
        )
    if len(topics) > 1:
        guesses = [guess for guess in guesses if guess.channel != TIME]
    tried = _tried(file, guesses, 1.0 if clockless else rate)
    faults = list(dict.fromkeys([*clockless, *(guess.fault for guess in tried if guess.fault)]))
    taken = {column for guess in tried for column in _columns_in(guess.choice, topics)}
    constant = _constant({*CHANNEL_UNITS} - {guess.channel for guess in tried}, topics)
    taken |= {*constant.values()}
    names = [  # without clocks, which are used but are no channel in a log of several topics
        _path(topic, cell)
        for topic in topics
        for cell in topic.table.header
        if not is_clock(split_header(cell)[0])
    ]
    unused = tuple(name for name in names if name not in taken)
    moving = tuple(
        path
        for topic in topics
        for index, cell in enumerate(topic.table.header)
        if (path := _path(topic, cell)) not in taken
        and SERVO_PULSES.fullmatch(path)
        and _moves(topic, index)
    )
    return Draft(
        file,
        tuple(_summary(topic) for topic in topics),
        tuple(tried),
        tuple(faults),
        unused,
        _model_for({guess.channel for guess in tried if not guess.fault}),
        bool(clockless),
        constant,
        moving,
        _is_readable(file, tried, unused, 1.0 if clockless else rate),
    )


def _constant(channels: Collection[str], topics: Sequence[Topic]) -> dict[str, str]:
    """Return, for each channel that is recorded but constant, its column."""
    columns: dict[str, str] = {}
    for channel in CHANNEL_UNITS:
        if channel not in channels or channel == TIME:
            continue
        names = (channel, *recorder_names().get(channel, {}).get("names", ()))
        known = {_letters_and_digits(name) for name in names}
        for topic in topics:
            for index, cell in enumerate(topic.table.header):
                named = _letters_and_digits(name_and_unit(topic.table.header, index)[0]) in known
                if named and _numbers(topic, index).size and not _moves(topic, index):
                    columns.setdefault(channel, _path(topic, cell))
    return columns


def named_only(draft: Draft) -> Draft:
    """Return the draft without the faults of its channels.

    For a file with a fault that prevents reading every channel: the headers still make a draft.
    """
    guesses = tuple(replace(guess, fault="") for guess in draft.guesses)
    model = _model_for({guess.channel for guess in guesses})
    return replace(draft, guesses=guesses, model=model)


def recognised(file: RecordFile, channels: Iterable[str]) -> Mapping[str, str]:
    """Return the column or expression that a draft would take for each channel, if it finds one.

    ``file``: the open file. ``channels``: the channels that are looked for.
    """
    return {
        guess.channel: str(guess.choice.column) for guess in _guesses(channels, topics_of(file), ())
    }


@lru_cache(maxsize=1)
def recorder_names() -> Mapping[str, Any]:
    """Return the names and columns that recorders give each channel (recorder_names.toml)."""
    return tomllib.loads(
        files("scenarios.preparation").joinpath("recorder_names.toml").read_text(encoding="utf-8")
    )


def _is_multirotor(topics: Sequence[Topic]) -> bool:
    """Return whether a file is of a multirotor.

    A log names its type of vehicle, or has the outputs of rate controllers and no airspeed. A table
    has a column of a command to the motors.
    """
    for path, number in ROTARY_WING.items():
        name, _, field = path.rpartition(".")
        for topic in topics:
            if topic.name == name and field in topic.table.header:
                return bool(np.any(_numbers(topic, topic.table.header.index(field)) == number))
    if len(topics) == 1:
        return any(
            _letters_and_digits(split_header(cell)[0]) in map(_letters_and_digits, COMMANDS)
            for cell in topics[0].table.header
        )
    has_airspeed = any(
        topic.name.split("[")[0] in ("ARSP", "AOA", "airspeed_validated") for topic in topics
    )
    return _has("RATE.ROut", topics) and not has_airspeed


def topics_of(file: RecordFile) -> Sequence[Topic]:
    """Return the topics of a log; another file is a single topic without a name."""
    return file.topics or (Topic("", file.table),)


def _guesses(
    channels: Iterable[str], topics: Sequence[Topic], degrees: Collection[str]
) -> list[Guess]:
    """Return the best column of each channel that the vehicle can have; ``degrees`` as below."""
    absent = (*SURFACES, "airspeed") if _is_multirotor(topics) else COMMANDS
    guesses = (_guess(channel, topics, degrees) for channel in channels if channel not in absent)
    return [guess for guess in guesses if guess is not None]


def _guess(channel: str, topics: Sequence[Topic], degrees: Collection[str]) -> Guess | None:
    """Return the best column of a channel; None if no column with a known name of it moves.

    ``degrees``: names of topics in which angles without a unit are in degrees.
    """
    known = recorder_names().get(channel, {})
    if len(topics) > 1:
        for path in known.get("columns", ()):
            if _has(path, topics):
                unit = known.get("units", {}).get(path)
                return Guess(
                    channel,
                    ColumnChoice(path, unit),
                    f"the usual column of {_recorder(path)}{_unit_words(unit)}",
                    command=unit == "rad",
                )
        for expression in known.get("expression", ()):
            if all(_has(name, topics) and "." in name for name in expression["needs"]):
                return Guess(channel, ColumnChoice(expression["text"]), expression["reason"])
    for name in (channel, *known.get("names", ())):
        plain = _letters_and_digits(name)
        spellings = (plain, *(f"{plain}{word}" for word in recorder_names()["unit_words"]))
        for topic in topics:
            if len(topics) > 1 and NO_MEASUREMENT.search(topic.name.lower()):
                continue
            cells = topic.table.header
            named = [
                n
                for n in range(len(cells))
                if _letters_and_digits(name_and_unit(cells, n)[0]) in spellings
            ]
            # Of two columns with one name, prefer the one with a known unit.
            for index in sorted(named, key=lambda n: not _states_unit(topic, n, channel)):
                if channel == TIME or (clock_place(topic.table) != index and _moves(topic, index)):
                    return _of_column(channel, topic, index, degrees)
    for expression in known.get("expression", ()):
        if all(_has(name, topics) for name in expression["needs"]):
            unit, reason = expression.get("unit"), expression["reason"]
            if expression.get("of_angles"):  # in degrees if one of the columns is
                cells = topics[0].table.header
                units = {
                    _of_column(channel, topics[0], cells.index(name), degrees).choice.unit
                    for name in expression["needs"]
                    if name in cells
                }
                unit = "deg" if "deg" in units else None
                reason = f"{reason}; taken as {unit or CHANNEL_UNITS[channel]}"
            return Guess(channel, ColumnChoice(expression["text"], unit), reason)
    return _clock(topics[0]) if channel == TIME and len(topics) == 1 else None


def _states_unit(topic: Topic, index: int, channel: str) -> bool:
    """Return whether the file states a unit that suits the channel; any unit suits a clock."""
    unit = stated_unit(topic.table, index)
    return channel == TIME or (unit is not None and measures(unit, CHANNEL_UNITS[channel]))


def _clock(topic: Topic) -> Guess | None:
    """Return the column that reading takes for the clock; else a column of dates; else a column
    that increases in even steps.
    """
    table = topic.table
    place = clock_place(table)
    if place is not None:
        unnamed = Guess(TIME, ColumnChoice(place + 1), "the dates of the rows")
        return _of_column(TIME, topic, place, ()) if table.header[place] else unnamed
    for index in range(min(len(table.header), 3)):
        if holds_dates(table.columns[index]):
            return Guess(TIME, ColumnChoice(index + 1), "holds dates or times of day")
    return _even_column(topic)


def _even_column(topic: Topic) -> Guess | None:
    """Return the first column that increases in even steps, possibly with gaps, as a clock does.

    A column that counts 0, 1, 2 ... is a row number, not a clock.
    """
    for index in range(min(len(topic.table.header), 3)):
        values = _numbers(topic, index)
        if (
            values.size != topic.table.rows.size
            or values.size < 10
            or not np.all(np.diff(values) >= 0.0)
        ):
            continue
        steps = np.diff(values)
        usual = float(np.median(steps))
        if values[0] in (0.0, 1.0) and np.all(steps == 1.0):
            continue
        uneven = np.abs(steps - usual) >= EVEN_CLOCK_TOLERANCE * usual
        only_gaps = np.all(steps[uneven] > usual) and np.mean(uneven) < MOST_GAP_SHARE
        if only_gaps or grid_of_coarse_stamps(values) is not None:
            return Guess(TIME, ColumnChoice(index + 1), "increases in even steps, as a clock does")
    return None


def _moves(topic: Topic, index: int) -> bool:
    values = _numbers(topic, index)
    return bool(values.size and np.ptp(values) > 0.0)


def _in_degrees(topics: Sequence[Topic]) -> set[str]:
    """Return the names of topics with an angle or rate without a unit that moves too far to be in
    radians.
    """
    names = set()
    for channel, inside in CHANNEL_UNITS.items():
        if inside not in LARGEST_IN_RADIANS or channel in INPUTS:
            continue
        guess = _guess(channel, topics, ())
        if (
            guess is not None
            and guess.choice.unit in ("deg", "deg/s")
            and "no unit is stated" in guess.reason
        ):
            names.add(str(guess.choice.column).rpartition(".")[0] if len(topics) > 1 else "")
    return names


def _of_column(channel: str, topic: Topic, index: int, degrees: Collection[str]) -> Guess:
    """Return the guess that a column is a channel, with the unit that file or numbers show."""
    cell = topic.table.header[index]
    path = f"{topic.name}.{cell}" if topic.name else cell
    inside = CHANNEL_UNITS[channel]
    reason = f"named {split_header(cell)[0]}"
    stated = stated_unit(topic.table, index)
    if channel == TIME:
        if stated is not None and not measures(stated, inside):
            # The brackets hold the name of a message or a sensor, no unit.
            stated = next(
                (unit for unit in SECONDS if split_header(cell)[0].lower().endswith(f"_{unit}")),
                None,
            )
        return Guess(
            channel,
            ColumnChoice(path, stated),
            f"{reason}; its unit: {stated or 'found by its steps from row to row'}",
        )
    if stated is None:
        stated = _suffix(cell)
    if stated is not None and measures(stated, inside):
        return Guess(channel, ColumnChoice(path, stated), f"{reason}, in {stated}")
    values = _numbers(topic, index)
    fill = fill_value(values)
    if fill is not None:
        reason += f"; {fill:g} is taken as a fill value, for no measurement"
        values = values[values != fill]
    moves = float(np.max(np.abs(values - np.median(values)))) if values.size else 0.0
    degree = {"rad": "deg", "rad/s": "deg/s"}.get(inside)
    if moves > LARGEST_IN_RADIANS.get(inside, np.inf):
        return Guess(
            channel,
            ColumnChoice(path, degree),
            f"{reason}; no unit is stated, and it moves by {moves:.3g}: taken as {degree}",
        )
    if degree is not None and topic.name in degrees:
        return Guess(
            channel,
            ColumnChoice(path, degree),
            f"{reason}; no unit is stated: taken as {degree}, as other angles of the file are",
        )
    return Guess(
        channel, ColumnChoice(path, None), f"{reason}; no unit is stated: taken as {inside}"
    )


def _tried(file: RecordFile, guesses: Sequence[Guess], rate: float | None) -> list[Guess]:
    """Return the guesses with their ranges, or with the fault that prevents reading them.

    Channels with a common clock are read together, or separately if one has a fault.
    """
    topics = topics_of(file)
    clock = {guess.channel: guess.choice for guess in guesses if guess.channel == TIME}
    topic_of = {
        _path(topic, cell): topic.name for topic in file.topics for cell in topic.table.header
    }
    by_topics: dict[frozenset[str], list[Guess]] = {}
    for guess in guesses:
        used = (
            {topic_of[name] for name in _columns_in(guess.choice, topics)} if file.topics else set()
        )
        by_topics.setdefault(frozenset(used), []).append(guess)
    tried = {guess.channel: guess for guess in guesses if guess.channel == TIME}
    for group in by_topics.values():
        tried |= _read(file, [guess for guess in group if guess.channel != TIME], clock, rate)
    return [tried[guess.channel] for guess in guesses]


def _read(
    file: RecordFile,
    guesses: Sequence[Guess],
    clock: Mapping[str, ColumnChoice],
    rate: float | None,
) -> dict[str, Guess]:
    """Return the guess of each channel with the range of its values, or with its fault."""
    tried: dict[str, Guess] = {}
    if not guesses:
        return tried
    try:
        chosen = {**clock, **{guess.channel: guess.choice for guess in guesses}}
        record = read_record(file, (), [guess.channel for guess in guesses], chosen, rate=rate)
    except RecordError as error:
        if len(guesses) == 1:
            (guess,) = guesses
            return {guess.channel: replace(guess, fault=str(error))}
        for guess in guesses:
            tried |= _read(file, [guess], clock, rate)
        return tried
    for guess in guesses:
        values = record[guess.channel].values[record[guess.channel].valid]
        tried[guess.channel] = replace(
            guess, samples=int(values.size), least=float(values.min()), most=float(values.max())
        )
    return tried


def _is_readable(
    file: RecordFile, tried: Sequence[Guess], unused: Sequence[str], rate: float | None
) -> bool:
    """Return whether any column of the file can be read: that of a guess, or an unused one.

    If none can, the fault is in the clock or in the rows and not in single columns.
    """
    faulty = [guess for guess in tried if guess.fault]
    if not faulty or any(guess.samples for guess in tried):
        return True
    clock = {guess.channel: guess.choice for guess in tried if guess.channel == TIME}
    channel = faulty[0].channel
    choices = (ColumnChoice(name, CHANNEL_UNITS[channel]) for name in unused[:MOST_UNUSED])
    return any(
        _read(file, [replace(faulty[0], choice=choice, fault="")], clock, rate)[channel].samples > 0
        for choice in choices
    )


def _summary(topic: Topic) -> TopicSummary:
    clock = clock_place(topic.table)
    rate = 0.0
    if clock is not None:
        try:
            steps = np.diff(clock_of(topic.table, clock).time)
        except RecordError:
            steps = np.zeros(0)
        steps = steps[np.isfinite(steps) & (steps > 0.0)]
        rate = 1.0 / float(np.median(steps)) if steps.size else 0.0
    return TopicSummary(topic.name, topic.table.header, int(topic.table.rows.size), rate)


def _model_for(channels: set[str]) -> str:
    """Return the model that the channels suit, empty if they suit none."""
    if {"roll_command", "pitch_command", "yaw_command"} & channels and {"p", "q", "r"} & channels:
        return "multirotor"
    if channels >= ALL_AXES and {"aileron", "rudder"} & channels:
        return "aircraft"
    if "elevator" in channels and {"q", "alpha", "nz", "az"} & channels:
        return "longitudinal" if {"airspeed", "theta", "thrust"} <= channels else "rigid"
    if {"aileron", "rudder"} & channels and {"p", "r", "beta"} & channels:
        return "lateral"
    falls = channels - {TIME} and channels <= {TIME, "altitude", "height", "airspeed"}
    return "ballistic" if falls else ""


def _path(topic: Topic, cell: str) -> str:
    """Return a column as a channel map names it, with its topic if that has a name."""
    return f"{topic.name}.{cell}" if topic.name else cell


def _columns_in(choice: ColumnChoice, topics: Sequence[Topic]) -> set[str]:
    """Return the columns of a channel: its column, or all columns in its expression."""
    text = str(choice.column)
    names = {_path(topic, cell) for topic in topics for cell in topic.table.header}
    if text in names:
        return {text}
    return {name for name in names if re.search(rf"(?<![\w.]){re.escape(name)}(?![\w\[])", text)}


def _has(path: str, topics: Sequence[Topic]) -> bool:
    return any(
        path in (cell, f"{topic.name}.{cell}") for topic in topics for cell in topic.table.header
    )


def _recorder(path: str) -> str:
    """Return the autopilot that names a column so: topics of ArduPilot are in capital letters."""
    return "ArduPilot" if path.split(".")[0].split("[")[0].isupper() else "PX4"


def _unit_words(unit: str | None) -> str:
    if unit is None:
        return ""
    if unit == "rad":
        return ": a command from -1 to 1; for THROW put the angle, deg, at 1"
    return f", in {unit}"


def _letters_and_digits(name: str) -> str:
    """Return a name in lower case without marks; umlauts are written as two letters (``ae``)."""
    plain = unicodedata.normalize("NFC", name).lower().translate(UMLAUTS)
    return re.sub(r"[^a-z0-9]", "", plain)


def _suffix(cell: str) -> str | None:
    """Return a unit after an underscore or a comma: ``alpha,__deg``, ``pitch_deg``."""
    word = re.split(r"[,_ ]+", split_header(cell)[0].strip())[-1]
    return UNIT_SUFFIXES.get(word)


def _numbers(topic: Topic, index: int) -> np.ndarray:
    values = numbers(topic.table, index).values
    return values[np.isfinite(values)]
