"""From keywords to the request that the commands make of their options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, SupportsFloat

from scenarios.api.records.in_memory import numbered_apart
from scenarios.api.records.opening import Choices, choices_of, opened_source
from scenarios.api.records.record import Record
from scenarios.api.vehicle import Vehicle, source_of
from scenarios.files.measured.record_file import RecordFile, refuse_twice
from scenarios.files.own_models import OwnModel, model_in_memory
from scenarios.files.vehicles import MODELS
from scenarios.preparation.plan import Plan, plan_of
from scenarios.preparation.request import Request
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.errors import DeclarationError, RecordError

Source = str | PathLike[str] | Record | Any  # a record, or whatever `read_record` takes
Declared = str | PathLike[str] | Model  # a model's name, the path of a Python file that holds one of your own, or that model itself
Times = float | Sequence[float] | None
Named = int | str | Sequence[int | str] | None  # maneuvers by number or name
Found = str | PathLike[str] | Any  # what `find_maneuvers` returned, or the path of a file of maneuvers


def request_of(
    records: Source | Sequence[Source],
    model: Declared = "",
    vehicle: str | PathLike[str] | Mapping[str, Any] | Vehicle | None = None,
    validate: Source | Sequence[Source] = (),
    *,
    effects: str | PathLike[str] | Sequence[Traceable] | None = None,
    channels: Choices | None = None,
    plan: Plan,
    effort: str = "normal",
    aircraft_class: str | None = None,
    category: str | None = None,
) -> Request:
    """The request; records are opened now, so that a fault in one is told before anything is computed."""
    fitted, predicted = _listed(records), _listed(validate)
    if not fitted:
        raise RecordError("no record is given", where="records", remedy="give one at least")
    opened = [file_of(each) for each in (*fitted, *predicted)]
    refuse_twice([file for file in opened if file.in_memory])
    files = numbered_apart(opened)
    asked = model_of(model)
    return Request(
        tuple(files[: len(fitted)]),
        asked,
        source_of(vehicle, asked if isinstance(asked, str) else "") if vehicle is not None else None,
        tuple(files[len(fitted) :]),
        effects_of(effects),
        choices_of(channels),
        plan,
        effort,
        aircraft_class,
        category,
    )


def plan_from(
    start: Times,
    stop: Times,
    hold: str | None,
    rate: float | None,
    lowpass: float | None,
    trust_record: bool,
    columns: str | Sequence[str] | None = None,
) -> Plan:
    """The plan; ``start`` and ``stop`` are one time or one of each maneuver, s; ``columns`` names with commas or as a list."""
    names = columns if columns is None or isinstance(columns, str) else ",".join(columns)
    return plan_of(_times(start), _times(stop), hold, rate, lowpass, trusted=trust_record, columns=names)


def with_parts(request: Request, asked: Named, found: Found) -> Request:
    """The request with the parts of the maneuvers that are asked for as its segments. Raises DeclarationError."""
    from scenarios.preparation.maneuver_file import Parts, with_maneuvers

    several: list[int | str] = [] if asked is None else [asked] if isinstance(asked, int | str) else list(asked)
    file = Path(found) if isinstance(found, str | PathLike) else getattr(found, "parts", found)
    if not (file is None or isinstance(file, Path | Parts)):
        what = f"a {type(found).__name__} holds no maneuvers"
        raise DeclarationError(what, where="maneuvers", remedy="give what find_maneuvers returned, or a file's path")
    return replace(request, plan=with_maneuvers(request.plan, request.records, several, file))


def model_of(given: Declared) -> str | OwnModel:
    """A model's name, a path, or a user's model that was made in Python. Raises DeclarationError."""
    return model_in_memory(given, MODELS) if isinstance(given, Model) else str(given)


def effects_of(given: str | PathLike[str] | Sequence[Traceable] | None) -> Path | tuple[Traceable, ...] | None:
    """Effects of a user's own, or the path of their file."""
    if given is None or isinstance(given, str | PathLike):
        return None if given is None else Path(given)
    if not isinstance(given, list | tuple):
        raise DeclarationError(f"a {type(given).__name__} is no list of effects", where="effects", remedy="give a list of them, or a file's path")
    return tuple(given)


def _times(given: Times) -> list[float] | None:
    """Times as the plan takes them. Raises DeclarationError for what is no number."""
    if given is None:
        return None
    several: Sequence[Any] = given if isinstance(given, list | tuple) else [given]
    for each in several:
        if isinstance(each, bool | str) or not isinstance(each, SupportsFloat):
            raise DeclarationError(f"{each!r:.60} is no time", where="start, stop", remedy="give a number in s, or a list of them")
    return [float(each) for each in several]


def _listed(given: Source | Sequence[Source]) -> list[Source]:
    """One record or several as a list."""
    if given is None:
        return []
    return list(given) if isinstance(given, list | tuple) else [given]


def file_of(given: Source) -> RecordFile:
    """The record file of what stands for a record. Raises RecordError."""
    return given.file if isinstance(given, Record) else opened_source(given)[0]
