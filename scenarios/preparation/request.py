"""What a command asks of measured records: which files, for which model, how they are read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.files.channel_names import CHANNEL_UNITS
from scenarios.preparation.plan import Plan, options_of
from sim.errors import DeclarationError

if TYPE_CHECKING:  # a process that draws figures starts before these are loaded
    from ident.flying_qualities.levels import Flown
    from scenarios.files.channels import ColumnChoice
    from scenarios.files.measured.record_file import RecordFile
    from scenarios.files.own_models import OwnModel
    from scenarios.files.sources import Source
    from scenarios.files.vehicles import VehicleFile
    from sim.declaration.proposal import Traceable


@dataclass(frozen=True)
class Request:
    """The files of a call and how they are read, as the command line took them; a file may be open already, or content that never was one.

    Attributes
    ----------
    records : files that are fitted or checked.
    model : one of ``MODELS`` of the vehicle files, or a user's Python file or model; empty where none is asked for.
    vehicle : constants and starting values; None takes ``vehicle.toml`` from the folder of the first record. An own model can do without.
    validate : files that are predicted, whole. effects : a user's Python file, which is run, or effects.
    channels : a channel map, for all records.
    aircraft_class, flight_phase : class I to IV and category A to C of MIL-F-8785C; None takes the vehicle file's.
    effort : how far a diagnosis looks, one of ``ident.tracing.settings.EFFORTS``.
    plan : segments of ``records`` (those of ``validate`` are not cut), and how all of them are prepared.
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
    """Class and category by which levels of flying qualities are told: the request's, else the vehicle file's, else assumed.

    Raises
    ------
    DeclarationError : a class or category that there is not, or one asked of what is no aircraft.
    """
    from ident.flying_qualities.levels import flown_as
    from scenarios.files.own_models import is_of_aircraft

    aircraft = vehicle.model != "ballistic" and (vehicle.own is None or is_of_aircraft(vehicle.own))
    for option, given in (("--class", request.aircraft_class), ("--category", request.flight_phase)):
        if given is not None and not aircraft:
            what = f"{vehicle.model} is no model of an aircraft, whose flying qualities have levels"
            raise DeclarationError(what, where=option, remedy="leave it out")
    return flown_as(request.aircraft_class or vehicle.aircraft_class, request.flight_phase or vehicle.flight_phase)


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


def column_choices(request: Request, known: Iterable[str] = CHANNEL_UNITS) -> Mapping[str, ColumnChoice] | None:
    """The channel map that a request names, of the channels ``known``, read now; None where it names none. Raises DeclarationError."""
    from scenarios.files.channels import read_channel_map

    return read_channel_map(request.channels, known) if request.channels is not None else None
