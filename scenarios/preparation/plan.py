"""A user's request for measured records: files, model, parts, filter, and how inputs are read."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.files.declarations import CHANNEL_UNITS, shortened_list
from sim.errors import DeclarationError, time_span

if TYPE_CHECKING:
    from ident.flying_qualities.mode_levels import FlightPhase
    from scenarios.files.declarations import ColumnChoice
    from scenarios.files.measured.columns import RecordFile
    from scenarios.files.sources import Source
    from scenarios.files.user_models import OwnModel
    from scenarios.files.vehicles import VehicleFile
    from sim.declaration.proposal import Traceable
    from sim.record import Hold

# ---- Preparation of records

SPEED, DENSITY, LIFT, ATTITUDE = "airspeed_change", "density_change", "lift", "theta"
# Inputs of the equations that are measured motion and no controls; they do not excite the motion.
MEASURED_MOTION = (SPEED, DENSITY, LIFT, ATTITUDE)
BY_HAND = "as given by the user"  # word for a hold given by the user


@dataclass(frozen=True)
class Segment:
    """A part of a record, both ends included, s; None leaves that end open."""

    start: float | None = None
    stop: float | None = None


WHOLE = (Segment(),)


@dataclass(frozen=True)
class Plan:
    """Preparation of records; the same for all records of a call.

    Attributes
    ----------
    segments : parts of a record; each becomes a separate record.
    hold : behaviour of the inputs between samples; None: as the sidecar states, else as the data
        suggest.
    rate : Hz; all channels are resampled to this rate after one anti-alias filter. None keeps the
        samples. For a file without a clock it is the rate of its rows, for a log of several topics
        the rate of their common grid.
    lowpass : corner of one zero-phase filter for all channels, Hz; None: no filter.
    trusted : whether faults of the raw columns only give warnings, and no record or sample is
        rejected.
    columns : names of the columns of a file, in their order; empty: those of its header.
    chosen : sentences on segments that come from a file of maneuvers.
    """

    segments: tuple[Segment, ...] = WHOLE
    hold: Hold | None = None
    rate: float | None = None
    lowpass: float | None = None
    trusted: bool = False
    columns: tuple[str, ...] = ()
    chosen: tuple[str, ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        for option, value in (("--rate", self.rate), ("--lowpass", self.lowpass)):
            if value is None:
                continue
            if not _is_number(value):
                raise DeclarationError(
                    f"{value!r:.60} is no frequency",
                    where=option,
                    remedy="give a number in Hz, above zero",
                )
            if not (math.isfinite(value) and value > 0.0):
                raise DeclarationError(
                    f"{value:g} Hz is no frequency", where=option, remedy="give a number above zero"
                )


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def refuse_reversed(start: float | None, stop: float | None, where: str) -> None:
    """Raise DeclarationError if a part of a record that a file declares ends before it begins."""
    if start is not None and stop is not None and not start < stop:
        raise DeclarationError(
            f"from = {start:g} is not before to = {stop:g}",
            where=where,
            remedy="give the earlier time first",
        )


def plan_of(
    starts: Sequence[float] | None = None,
    stops: Sequence[float] | None = None,
    hold: str | None = None,
    rate: float | None = None,
    lowpass: float | None = None,
    *,
    trusted: bool = False,
    columns: str | None = None,
) -> Plan:
    """Return the plan that the options of a command line give.

    Parameters
    ----------
    starts, stops : values of ``--from`` and ``--to``, s, in pairs.
    hold : ``previous``, ``linear`` or None.
    rate, lowpass, trusted : as in ``Plan``.
    columns : names of columns, separated by commas.

    Raises
    ------
    DeclarationError : the ends make no pairs; segments overlap; a hold or a frequency is
        impossible; a name is empty or repeated.
    """
    chosen_hold = _hold_of(hold) if hold is not None else None
    segments = _segments(list(starts or ()), list(stops or ()))
    return Plan(segments, chosen_hold, rate, lowpass, trusted, _names_of(columns))


def options_of(plan: Plan) -> list[str]:
    """Return the options of a command line that give a plan; maneuvers become times."""
    words = []
    for segment in plan.segments:
        for option, value in (("--from", segment.start), ("--to", segment.stop)):
            words += [option, f"{value:.9g}"] if value is not None else []
    words += ["--hold", plan.hold.value] if plan.hold is not None else []
    for option, frequency in (("--rate", plan.rate), ("--lowpass", plan.lowpass)):
        words += [option, f"{frequency:.9g}"] if frequency is not None else []
    words += ["--columns", ",".join(plan.columns)] if plan.columns else []
    return [*words, "--trust-record"] if plan.trusted else words


def _names_of(columns: str | None) -> tuple[str, ...]:
    names = tuple(name.strip() for name in columns.split(",")) if columns is not None else ()
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None or not all(names):
        what = f"{twice!r} is named twice" if twice else "a name is empty"
        raise DeclarationError(
            what, where="--columns", remedy="give one name a column, as in time,elevator,alpha,q"
        )
    return names


def _hold_of(word: str) -> Hold:
    from sim.record import Hold

    kinds = {kind.value: kind for kind in Hold}
    if not isinstance(word, str) or word not in kinds:
        raise DeclarationError(
            f"there is no hold {word!r:.60}", where="--hold", remedy=f"use {' or '.join(kinds)}"
        )
    return kinds[word]


def _segments(starts: list[float], stops: list[float]) -> tuple[Segment, ...]:
    if len(starts) <= 1 and len(stops) <= 1:
        return (Segment(starts[0] if starts else None, stops[0] if stops else None),)
    if len(starts) != len(stops):
        what = f"{len(starts)} times --from and {len(stops)} times --to"
        raise DeclarationError(
            what, where="--from, --to", remedy="give each segment both ends, in pairs"
        )
    for start, stop in zip(starts, stops, strict=True):
        if not start < stop:
            raise DeclarationError(
                f"--from {start:g} is not before --to {stop:g}",
                where="--from, --to",
                remedy="give the earlier time first",
            )
    ordered = sorted(zip(starts, stops, strict=True))
    for (start, stop), (later, end) in pairwise(ordered):
        if later < stop:
            what = f"the segments {time_span(start, stop)} and {time_span(later, end)} overlap"
            raise DeclarationError(
                what, where="--from, --to", remedy="give segments that do not overlap"
            )
    return tuple(Segment(start, stop) for start, stop in zip(starts, stops, strict=True))


# ---- Request of a command: files, model, and how the files are read


@dataclass(frozen=True)
class Request:
    """The files of a call and how they are read. A file may be a path, open or in memory.

    Attributes
    ----------
    records : files that are fitted or checked.
    model : name of a built-in model, or a user's Python file or model; empty without a model.
    vehicle : vehicle file; None: ``vehicle.toml`` in the folder of the first record. A user's model
        needs none.
    validate : files that are predicted; they are not cut into segments.
    effects : a user's Python file with effects, or effects.
    channels : a channel map for all records.
    plan : segments of ``records``, and preparation of all files.
    effort : effort of a diagnosis, one of ``ident.tracing.diagnosis.EFFORTS``.
    aircraft_class : class I to IV of MIL-F-8785C; None: that of the vehicle file.
    flight_phase : category A to C of MIL-F-8785C; None: that of the vehicle file.
    """

    records: tuple[Path | RecordFile, ...]
    model: str | OwnModel = ""
    vehicle: Path | Source | None = None
    validate: tuple[Path | RecordFile, ...] = ()
    effects: Path | tuple[Traceable, ...] | None = None
    channels: Path | Mapping[str, Any] | None = None
    plan: Plan = field(default_factory=Plan)
    effort: str = "normal"
    aircraft_class: str | None = None
    flight_phase: str | None = None


def declared_phase(request: Request, vehicle: VehicleFile) -> FlightPhase:
    """Return aircraft class and flight-phase category for levels of flying qualities.

    They are those of the request, else those of the vehicle file, else assumed.

    Raises
    ------
    DeclarationError : the class or category is unknown, or the model is not that of an aircraft.
    """
    from ident.flying_qualities.mode_levels import flight_phase_of
    from scenarios.files.user_models import is_of_aircraft

    is_aircraft = vehicle.model != "ballistic" and (
        vehicle.own is None or is_of_aircraft(vehicle.own)
    )
    for option, requested in (
        ("--class", request.aircraft_class),
        ("--category", request.flight_phase),
    ):
        if requested is not None and not is_aircraft:
            what = f"{vehicle.model} is no model of an aircraft, whose flying qualities have levels"
            raise DeclarationError(what, where=option, remedy="leave it out")
    return flight_phase_of(
        request.aircraft_class or vehicle.aircraft_class,
        request.flight_phase or vehicle.flight_phase,
        vehicle.constants.get("mass") if is_aircraft else None,
    )


def reading_options(request: Request, *, opening: bool = False, rate: bool = True) -> list[str]:
    """Return the options with which a proposed command reads the records as the request does.

    ``opening``: only options that open a file, which are channel map, names of columns and, with
    ``rate``, the rate.
    """
    plan = request.plan
    words = ["--channels", str(request.channels)] if isinstance(request.channels, Path) else []
    if not opening:
        return [*words, *options_of(plan)]
    return [*words, *options_of(Plan(columns=plan.columns, rate=plan.rate if rate else None))]


def column_choices(
    request: Request, allowed: Iterable[str] = CHANNEL_UNITS, *, surfaces: bool = False
) -> Mapping[str, ColumnChoice] | None:
    """Return the channel map of a request, or None. Raises DeclarationError.

    ``allowed`` and ``surfaces``: as for ``read_channel_map``.
    """
    from scenarios.files.declarations import read_channel_map

    if request.channels is None:
        return None
    return read_channel_map(request.channels, allowed, surfaces=surfaces)


# ---- Maneuvers as parts of a record

FILE = "maneuvers.toml"
FIND = "flightid maneuvers RECORD --out DIR writes one"


@dataclass(frozen=True)
class Part:
    """A part of a record from ``start`` to ``stop``, s, with its number and name."""

    number: int
    name: str
    start: float
    stop: float

    @property
    def sentence(self) -> str:
        """Name of the part in messages, ``"maneuver 3 (pitch-doublet-1), 119.2 to 127.5 s"``."""
        return f"maneuver {self.number} ({self.name}), {time_span(self.start, self.stop)}"


@dataclass(frozen=True)
class DeclaredParts:
    """Parts that a file declares.

    Attributes
    ----------
    where : name of the file, for errors.
    record, sha256 : name and hash of the record; empty if the file does not state them.
    parts : the parts.
    """

    where: str
    record: str
    sha256: str
    parts: tuple[Part, ...]


def read_parts(path: str | Path) -> DeclaredParts:
    """Read ``maneuvers.toml``.

    A maneuver without a number has the number after that of the maneuver before it.

    Raises
    ------
    DeclarationError : there is no such file; a key is unknown or missing; a value is wrong; a
        maneuver ends before it begins; two maneuvers have the same number or name.
    """
    from scenarios.files.declarations import checked, read_toml
    from scenarios.files.schemas import FileEntry

    where = str(path)
    entry = checked(FileEntry, read_toml(path), path)
    parts: list[Part] = []
    for maneuver in entry.maneuvers:
        number = maneuver.number
        if number is None:
            number = parts[-1].number + 1 if parts else 1
        part = Part(number, maneuver.name or str(number), maneuver.from_, maneuver.to)
        refuse_reversed(part.start, part.stop, f"{where}, maneuver {part.number}")
        for other in parts:
            if number == other.number or part.name == other.name:
                what = (
                    f"two maneuvers have the {'number' if number == other.number else 'name'} "
                    f"{number if number == other.number else part.name}"
                )
                raise DeclarationError(
                    what, where=where, remedy="give each a number and a name of its own"
                )
        parts.append(part)
    return DeclaredParts(where, entry.record or "", entry.sha256 or "", tuple(parts))


def chosen_parts(parts: DeclaredParts, requested: Sequence[str | int]) -> tuple[Part, ...]:
    """Return the parts with the given numbers or names, in the order of their times.

    Raises
    ------
    DeclarationError : there is no such part, it is requested twice, or two overlap.
    """
    by_name = {part.name: part for part in parts.parts}
    by_name |= {str(part.number): part for part in parts.parts}
    chosen: list[Part] = []
    for wanted in requested:
        part = by_name.get(str(wanted).strip())
        if part is None:
            available = shortened_list(
                [f"{known.number} {known.name}" for known in parts.parts], 12
            )
            raise DeclarationError(
                f"there is no maneuver {str(wanted)!r}",
                where=parts.where,
                remedy=f"it has {available}" if available else "it has none",
            )
        if part in chosen:
            raise DeclarationError(
                f"maneuver {part.number} is asked for twice",
                where="--maneuver",
                remedy="name each once",
            )
        chosen.append(part)
    chosen.sort(key=lambda part: part.start)
    for first, second in pairwise(chosen):
        if second.start < first.stop:
            what = (
                f"maneuvers {first.number} and {second.number} overlap ({first.start:g} to "
                f"{first.stop:g} s, {time_span(second.start, second.stop)})"
            )
            raise DeclarationError(
                what,
                where=parts.where,
                remedy="take one of them, or change their times in the file",
            )
    return tuple(chosen)


def with_maneuvers(
    plan: Plan,
    records: Sequence[Path | RecordFile],
    requested: Sequence[str | int] | None,
    file: Path | DeclaredParts | None = None,
) -> Plan:
    """Return the plan with maneuvers as its segments, and a sentence on each.

    Parameters
    ----------
    requested : numbers or names of maneuvers; without any the plan does not change.
    file : file of maneuvers; None: ``maneuvers.toml`` beside the record.

    Raises
    ------
    DeclarationError : the plan has segments; there are several records; there is no file, or it is
        of another record; there is no such maneuver.
    """
    if not requested:
        if file is not None:
            raise DeclarationError(
                "no maneuver is named",
                where="--maneuvers",
                remedy="add --maneuver NUMBER, or leave it out",
            )
        return plan
    if plan.segments != WHOLE:
        raise DeclarationError(
            "goes without --from and --to", where="--maneuver", remedy="leave one or the other out"
        )
    if len(records) != 1:
        what = f"maneuvers are of one record, and {len(records)} are named"
        raise DeclarationError(
            what, where="--maneuver", remedy="name one record, or cut each with --from and --to"
        )
    parts = file if isinstance(file, DeclaredParts) else read_parts(file or _beside(records[0]))
    _refuse_other(parts, records[0])
    chosen = chosen_parts(parts, requested)
    segments = plan_of([part.start for part in chosen], [part.stop for part in chosen]).segments
    sentences = tuple(f"{part.sentence}, of {parts.where}" for part in chosen)
    return replace(plan, segments=segments, chosen=sentences)


def _beside(record: Path | RecordFile) -> Path:
    """Return the file of maneuvers beside a record. Raises DeclarationError without one."""
    from scenarios.files.measured.columns import path_of

    path = path_of(record)
    if path is None:
        raise DeclarationError(
            "the record is in memory, where no file lies beside it",
            where="--maneuver",
            remedy="name the file (maneuvers)",
        )
    beside = path.with_name(FILE)
    if not beside.is_file():
        raise DeclarationError(
            f"there is no {FILE} beside {path.name}",
            where="--maneuver",
            remedy=f"name one with --maneuvers; {FIND}",
        )
    return beside


def _refuse_other(parts: DeclaredParts, record: Path | RecordFile) -> None:
    """Raise DeclarationError if the file was made for a record of another content."""
    from scenarios.files.sources import read_source
    from sim.errors import RecordError

    if not parts.sha256:
        return
    identity = (
        read_source(record, RecordError, "the record file").identity
        if isinstance(record, Path)
        else record.identity
    )
    if identity.sha256 != parts.sha256:
        of = (
            f"{parts.record}, not of {identity.name}"
            if parts.record != identity.name
            else f"an earlier {parts.record}: its content has changed"
        )
        raise DeclarationError(
            f"is of {of}",
            where=parts.where,
            remedy="run flightid maneuvers on this record, or take sha256 out of the file",
        )


def command_on_records(request: Request, command: str, further: Sequence[str] = ()) -> str:
    """Return another command on the same records with the options of the request.

    ``further``: options that are added.
    """
    from scenarios.files.measured.columns import path_of

    paths = [path_of(record) for record in request.records]
    words = [str(path) if path is not None else "RECORD" for path in paths]
    model = request.model if isinstance(request.model, str) else "MODEL"
    given = {"--model": model, "--vehicle": request.vehicle}
    options = [
        word
        for option, value in given.items()
        if isinstance(value, str | Path)
        for word in (option, str(value))
    ]
    held_out = [path_of(record) for record in request.validate]
    validate = [str(path) if path is not None else "RECORD" for path in held_out]
    options += [
        *(word for path in validate for word in ("--validate", path)),
        *reading_options(request),
    ]
    return shlex.join(["flightid", command, *words, *options, *further])
