"""What a user asks of measured records: files, model, parts, filter, and how inputs are read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.files.channels import CHANNEL_UNITS
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from ident.flying_qualities.levels import Flown
    from scenarios.files.channels import ColumnChoice
    from scenarios.files.measured.columns import RecordFile
    from scenarios.files.sources import Source
    from scenarios.files.user_models import OwnModel
    from scenarios.files.vehicles import VehicleFile
    from sim.declaration.proposal import Traceable
    from sim.record import Hold


# ---- What a user asks of the preparation

SPEED, DENSITY, LIFT, ATTITUDE = "airspeed_change", "density_change", "lift", "theta"
# inputs of the equations that are measured motion: no control, which alone excites
MEASURED_MOTION = (SPEED, DENSITY, LIFT, ATTITUDE)
BY_HAND = "chosen by hand"  # of a hold, in the sentences on how records were prepared


@dataclass(frozen=True)
class Segment:
    """A part of a record, both ends included, s; None leaves that end open."""

    start: float | None = None
    stop: float | None = None


WHOLE = (Segment(),)


@dataclass(frozen=True)
class Plan:
    """How records are prepared; the same for all of a call.

    Attributes
    ----------
    segments : each becomes a record of its own.
    hold : behaviour of the inputs between samples; None: as the file's sidecar says, else as the
    data say. rate : Hz, to which all channels are resampled behind one anti-alias filter; None
    keeps the samples. Of a file without a clock it is the
        rate of its rows, and of a log of several topics the rate of the grid that they are put on.
    lowpass : Hz, corner of one zero-phase filter for all channels; None leaves them unfiltered.
    columns : names of a file's columns, in their order, where it has no header or another one is
    wanted; none keeps its own. trusted : what the raw columns show is only warned of; nothing is
    refused or set aside for it. chosen : sentences on where the segments come from, where a file of
    maneuvers gave them.
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
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise DeclarationError(
                    f"{value:g} Hz is no frequency", where=option, remedy="give a number above zero"
                )


def refuse_turned(start: float | None, stop: float | None, where: str) -> None:
    """Raise DeclarationError where a part of a record, as a file declares it, ends before it
    begins."""
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
    """A plan from the words of a command line: ``--from`` and ``--to`` in pairs, in their order.

    Raises
    ------
    DeclarationError : ends that make no pairs, segments that overlap, a hold or a frequency that is
    none, an empty or repeated name.
    """
    held = _hold_of(hold) if hold is not None else None
    return Plan(
        _segments(list(starts or ()), list(stops or ())),
        held,
        rate,
        lowpass,
        trusted,
        _names_of(columns),
    )


def options_of(plan: Plan) -> list[str]:
    """The words of a command line that ask for a plan; segments of maneuvers as their times."""
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
    if word not in kinds:
        raise DeclarationError(
            f"there is no hold {word!r}", where="--hold", remedy=f"use {' or '.join(kinds)}"
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
            what = f"the segments {start:g} to {stop:g} s and {later:g} to {end:g} s overlap"
            raise DeclarationError(what, where="--from, --to", remedy="let no sample count twice")
    return tuple(Segment(start, stop) for start, stop in zip(starts, stops, strict=True))


# ---- What a command asks of measured records: which files, for which model, how they are read


@dataclass(frozen=True)
class Request:
    """The files of a call and how they are read, as the command line took them; a file may be open
    already, or content that never was one.

    Attributes
    ----------
    records : files that are fitted or checked.
    model : one of ``MODELS`` of the vehicle files, or a user's Python file or model; empty where
    none is asked for. vehicle : constants and starting values; None takes ``vehicle.toml`` from the
    folder of the first record. An own model can do without. validate : files that are predicted,
    whole. effects : a user's Python file, which is run, or effects. channels : a channel map, for
    all records. aircraft_class, flight_phase : class I to IV and category A to C of MIL-F-8785C;
    None takes the vehicle file's. effort : how far a diagnosis looks, one of
    ``ident.tracing.settings.EFFORTS``. plan : segments of ``records`` (those of ``validate`` are
    not cut), and how all of them are prepared.
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


def flown_of(request: Request, vehicle: VehicleFile) -> Flown:
    """Class and category by which levels of flying qualities are told: the request's, else the
    vehicle file's, else assumed.

    Raises
    ------
    DeclarationError : a class or category that there is not, or one asked of what is no aircraft.
    """
    from ident.flying_qualities.levels import flown_as
    from scenarios.files.user_models import is_of_aircraft

    aircraft = vehicle.model != "ballistic" and (vehicle.own is None or is_of_aircraft(vehicle.own))
    for option, given in (
        ("--class", request.aircraft_class),
        ("--category", request.flight_phase),
    ):
        if given is not None and not aircraft:
            what = f"{vehicle.model} is no model of an aircraft, whose flying qualities have levels"
            raise DeclarationError(what, where=option, remedy="leave it out")
    return flown_as(
        request.aircraft_class or vehicle.aircraft_class,
        request.flight_phase or vehicle.flight_phase,
    )


def reading_options(request: Request, *, opening: bool = False, rate: bool = True) -> list[str]:
    """Options of the command line that read the records as the request does, for commands that are
    proposed.

    ``opening`` : those alone that open a file: channel map, names of columns, and with ``rate`` the
    rate.
    """
    plan = request.plan
    words = ["--channels", str(request.channels)] if isinstance(request.channels, Path) else []
    if not opening:
        return [*words, *options_of(plan)]
    return [*words, *options_of(Plan(columns=plan.columns, rate=plan.rate if rate else None))]


def column_choices(
    request: Request, known: Iterable[str] = CHANNEL_UNITS
) -> Mapping[str, ColumnChoice] | None:
    """The channel map that a request names, of the channels ``known``, read now; None where it
    names none. Raises DeclarationError.
    """
    from scenarios.files.channels import read_channel_map

    return read_channel_map(request.channels, known) if request.channels is not None else None
