"""Flights of a survey as its file declares them, and one flight checked and diagnosed."""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.files.aircraft_files import toml_string
from scenarios.files.declarations import checked, read_toml_source, toml_of
from scenarios.files.sources import InputFile, Source, json_or_none, own_version
from scenarios.files.units import to_si
from scenarios.files.user_models import is_model_file
from scenarios.files.vehicles import read_vehicle, refuse_unknown_model, vehicle_next_to
from scenarios.files.writing import unportable, write_json
from scenarios.preparation.plan import Plan, Request, plan_of, refuse_reversed
from scenarios.report.figure_formats import Formats
from scenarios.tasks.work import Row, Task
from sim.errors import DeclarationError, FlightidError

if TYPE_CHECKING:
    from scenarios.files.schemas import FlightEntry, SurveyEntry


# ---- A vehicle file with the changes of a flight, as TOML


def changed(content: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content with ``changes`` replaced; tables key by key."""
    replaced = {
        key: {**content[key], **value}
        if isinstance(value, dict) and isinstance(content.get(key), dict)
        else value
        for key, value in changes.items()
    }
    return {**content, **replaced}


def toml_text(content: Mapping[str, Any]) -> str:
    """Return the content of a TOML file as text: one line for each key, tables inline."""
    return "".join(f"{toml_string(key)} = {_inline(value)}\n" for key, value in content.items())


def _inline(value: Any) -> str:
    if isinstance(value, float):
        return repr(value)  # TOML has inf and nan
    if isinstance(value, Mapping):
        entries = [f"{toml_string(key)} = {_inline(entry)}" for key, entry in value.items()]
        return f"{{{', '.join(entries)}}}"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return toml_string(value) if isinstance(value, str) else json.dumps(value, default=str)


# ---- The flights of a survey as its file declares them

RESULT_VERSION = "1"  # version of stored results; others are recomputed
# Quantities that are flight conditions, also if the vehicle file has them -> unit of their values.
CONDITIONS = {
    "mass": "kg",
    "airspeed": "m/s",
    "reference_airspeed": "m/s",
    "air_density": "kg/m3",
    "pitch_inertia": "kg m2",
    "altitude": "m",
    "mach": "1",
    "dynamic_pressure": "Pa",
    "trim_alpha": "rad",
    "roll_inertia": "kg m2",
    "yaw_inertia": "kg m2",
}


@dataclass(frozen=True)
class SurveyFlight:
    """One flight of a survey; its files are not yet opened.

    Attributes
    ----------
    name : name of the flight and of its folder.
    records : its records, each fitted.
    model : name of the model, or path of a user's model.
    vehicle : text of the vehicle file with the changes of the flight; empty without a file.
    vehicle_name : name of the vehicle file.
    channels : channel map.
    effects : a user's file with effects.
    plan : preparation of the records.
    effort : effort of the diagnosis.
    condition : name of a flight condition -> value and unit.
    date, tail : date of the flight and tail number of the aircraft, as given.
    digest : hash of everything that affects the results.
    """

    name: str
    records: tuple[Path, ...]
    model: str
    vehicle: str
    vehicle_name: str
    channels: Path | None
    effects: Path | None
    plan: Plan
    effort: str
    condition: Mapping[str, tuple[float, str]]
    date: str = ""
    tail: str = ""
    digest: str = ""

    @property
    def vehicle_beside(self) -> Path | None:
        """The vehicle file in the folder of the record, which is read if the survey names none."""
        return None if self.vehicle else vehicle_next_to(self.records[0])

    def request(self) -> Request:
        """Return the request of the diagnosis of this flight."""
        raw = self.vehicle.encode()
        identity = InputFile(self.vehicle_name, hashlib.sha256(raw).hexdigest())
        vehicle = Source(Path(self.vehicle_name), raw, identity) if raw else None
        return Request(
            self.records,
            self.model,
            vehicle,
            (),
            self.effects,
            self.channels,
            self.plan,
            self.effort,
        )


@dataclass(frozen=True)
class Flights:
    """The file of a survey: path, hash, title, model, and the flights in their order."""

    path: Path
    sha256: str
    title: str
    model: str
    flights: tuple[SurveyFlight, ...]


def read_flights(path: str | Path) -> Flights:
    """Read the file of a survey. Paths in it are relative to its folder.

    Raises
    ------
    DeclarationError : there is no such file, a key is unknown or missing, a value is wrong, two
        flights have one name, or there is no flight. A missing record is no error here: its flight
        is reported as failed.
    """
    from scenarios.files.schemas import SurveyEntry

    source = read_toml_source(path)
    where, root = str(path), Path(path).parent
    entry = checked(SurveyEntry, toml_of(source), path)
    model = str(root / entry.model) if is_model_file(entry.model) else entry.model
    refuse_unknown_model(model, f"{where}, key model")
    vehicle = toml_of(read_toml_source(root / entry.vehicle)) if entry.vehicle is not None else {}
    entries = [*_listed(entry, root, where), *entry.flights]
    if not entries:
        raise DeclarationError(
            "there is no flight",
            where=where,
            remedy='add [[flights]] tables, or records = "flights/*.csv"',
        )
    names = [_name_of(flight, where, number) for number, flight in enumerate(entries, start=1)]
    first: dict[str, str] = {}
    for name in names:
        other = first.setdefault(name.lower(), name)
        if names.count(name) > 1 or other != name:
            pair = name
            if other != name:
                pair = f"{other} and {name}, one folder where case does not count"
            raise DeclarationError(
                f"two flights are called {pair}", where=where, remedy="give each a name of its own"
            )
    flights = tuple(
        _flight(name, flight, entry, root, model, vehicle, where)
        for name, flight in zip(names, entries, strict=True)
    )
    flights = _in_one_unit(flights, where)
    _refuse_unreadable(
        flights,
        str(root / entry.vehicle) if entry.vehicle is not None else "",
        toml_text(vehicle),
        where,
    )
    return Flights(
        Path(path), source.identity.sha256, entry.title or Path(path).stem, entry.model, flights
    )


def _listed(entry: SurveyEntry, root: Path, where: str) -> list[FlightEntry]:
    """Return flights of the records that the top of the file lists, sorted by name.

    A record that a flight names itself is left out.
    """
    from scenarios.files.schemas import FlightEntry

    patterns = [entry.records] if isinstance(entry.records, str) else entry.records or []
    named = {
        Path(record)
        for flight in entry.flights
        for record in (flight.records or [str(flight.record)])
    }
    flights = []
    for pattern in patterns:
        folder, relative = root, pattern
        if Path(pattern).is_absolute():
            folder = Path(Path(pattern).anchor)
            relative = str(Path(pattern).relative_to(folder))
        is_pattern = any(mark in pattern for mark in "*?[")
        matched = sorted(folder.glob(relative)) if is_pattern else [root / pattern]
        if not matched:
            raise DeclarationError(
                f"no file matches {pattern!r}",
                where=f"{where}, key records",
                remedy="check the path; it is relative to this file",
            )
        paths = [path.relative_to(root) if path.is_relative_to(root) else path for path in matched]
        flights += [
            FlightEntry.model_validate({"record": path.as_posix()})
            for path in paths
            if path not in named
        ]
    return flights


def _name_of(entry: FlightEntry, where: str, number: int) -> str:
    from scenarios.files.schemas import FOLDER_NAME

    if (entry.record is None) == (entry.records is None):
        what = "names no record" if entry.record is None else "has record and records"
        raise DeclarationError(
            f"flight {entry.name or number} {what}",
            where=where,
            remedy='give it record = "FILE", or a list of records',
        )
    name = entry.name or Path((entry.records or [str(entry.record)])[0]).stem
    if not re.fullmatch(FOLDER_NAME, name) or unportable(name):
        raise DeclarationError(
            f"{name!r} cannot be the name of a folder",
            where=f"{where}, flight {number}",
            remedy='give it a plain name = "..."',
        )
    return name


def _flight(
    name: str,
    entry: FlightEntry,
    shared: SurveyEntry,
    root: Path,
    model: str,
    vehicle: Mapping[str, Any],
    where: str,
) -> SurveyFlight:
    """Return a flight. An entry that it does not have is that at the top of the file (``shared``).

    ``vehicle`` is the content of the vehicle file, and ``where`` the file of the survey.
    """
    place = f"{where}, flight {name}"
    start, stop = _own_or_shared(entry.from_, shared.from_), _own_or_shared(entry.to, shared.to)
    hold, rate, lowpass = (
        _own_or_shared(getattr(entry, key), getattr(shared, key))
        for key in ("hold", "rate", "lowpass")
    )
    refuse_reversed(start, stop, place)
    columns = _own_or_shared(entry.columns, shared.columns)
    names = ",".join(columns) if isinstance(columns, list) else columns
    try:
        plan = plan_of(
            [start] if start is not None else None,
            [stop] if stop is not None else None,
            hold,
            rate,
            lowpass,
            columns=names,
        )
    except FlightidError as error:
        raise DeclarationError(error.what, where=place, remedy=error.remedy) from None
    records = tuple(root / record for record in (entry.records or [str(entry.record)]))
    maneuver = _own_or_shared(entry.maneuver, shared.maneuver)
    file = _own_or_shared(entry.maneuvers, shared.maneuvers)
    plan = _with_maneuvers(
        plan, records, maneuver, root / file if file is not None else None, place
    )
    if entry.vehicle and not vehicle:
        raise DeclarationError(
            "changes a vehicle file that is not named",
            where=place,
            remedy='add vehicle = "FILE.toml" at the top',
        )
    content = changed(vehicle, entry.vehicle)
    given: dict[str, Any] = {
        key: value for key, value in content.items() if key in CONDITIONS
    } | entry.condition
    channels = _own_or_shared(entry.channels, shared.channels)
    flight = SurveyFlight(
        name,
        records,
        model,
        toml_text(content) if content else "",
        shared.vehicle or "",
        root / channels if channels is not None else None,
        root / shared.effects if shared.effects is not None else None,
        plan,
        shared.effort,
        {key: _condition(key, value, place) for key, value in given.items()},
        entry.date or "",
        entry.tail or "",
    )
    return replace(flight, digest=_digest(flight))


def _with_maneuvers(
    plan: Plan, records: tuple[Path, ...], maneuver: Any, file: Path | None, place: str
) -> Plan:
    """Return the plan with the maneuvers that a flight names; unchanged if a record is missing.

    Raises DeclarationError as ``with_maneuvers``.
    """
    from scenarios.preparation.plan import with_maneuvers

    if not all(record.is_file() for record in records):
        return plan
    try:
        return with_maneuvers(
            plan, records, maneuver if isinstance(maneuver, list | None) else [maneuver], file
        )
    except DeclarationError as error:
        raise DeclarationError(
            f"{error.what} ({error.where})", where=place, remedy=error.remedy
        ) from None


def _refuse_unreadable(
    flights: Sequence[SurveyFlight], vehicle: str, shared: str, where: str
) -> None:
    """Raise DeclarationError for a missing channel map or file of effects, or a wrong vehicle.

    ``vehicle`` is the path of the vehicle file, ``shared`` its text, ``where`` the survey's file.
    """
    for flight in flights:
        for path in (flight.channels, flight.effects):
            if path is not None and not path.is_file():
                what = f"there is no file {str(path)!r}"
                raise DeclarationError(
                    what,
                    where=f"{where}, flight {flight.name}",
                    remedy="check the path; it is relative to this file",
                )
    first_with_text: dict[str, SurveyFlight] = {}
    for flight in flights:
        first_with_text.setdefault(flight.vehicle, flight)
    # The vehicle file first: its errors do not belong to a flight.
    for text in sorted(filter(None, first_with_text), key=lambda text: text != shared):
        flight = first_with_text[text]
        try:
            read_vehicle(flight.request().vehicle, flight.model)
        except DeclarationError as error:
            origin = vehicle if text == shared else f"{where}, flight {flight.name}, vehicle"
            place = error.where.removeprefix(flight.vehicle_name)
            raise DeclarationError(
                error.what, where=f"{origin}{place}", remedy=error.remedy
            ) from None


def _own_or_shared(own: Any, shared: Any) -> Any:
    return own if own is not None else shared


def _condition(key: str, value: object, place: str) -> tuple[float, str]:
    """Return a flight condition: value and unit. A known one has the unit in ``CONDITIONS``."""
    from scenarios.files.schemas import number_in

    unit = CONDITIONS.get(key.lower())
    if unit is not None or not isinstance(value, str):
        return number_in(value, unit or "1", f"{place}, {key}"), unit or "1"
    number, _, unit = (word.strip() for word in value.strip().partition(" "))
    try:
        return to_si(float(number), unit, unit, f"{place}, {key}", DeclarationError), unit or "1"
    except ValueError:
        raise DeclarationError(
            f"{value!r} is not a number with a unit",
            where=f"{place}, {key}",
            remedy='write 0.6 or "12000 ft"',
        ) from None


def _in_one_unit(flights: Sequence[SurveyFlight], where: str) -> tuple[SurveyFlight, ...]:
    """Return the flights with each condition in the unit of the first flight that has it.

    Raises DeclarationError if a condition cannot be converted to this unit.
    """
    units: dict[str, str] = {}
    converted = []
    for flight in flights:
        condition = {}
        for key, (value, unit) in flight.condition.items():
            first = units.setdefault(key, unit)
            place = f"{where}, flight {flight.name}, {key}"
            condition[key] = to_si(value, unit, first, place, DeclarationError), first
        converted.append(replace(flight, condition=condition))
    return tuple(converted)


def _digest(flight: SurveyFlight) -> str:
    """Return a hash of everything that the results of a flight depend on.

    A missing file counts as well: the results change when it appears.
    """
    further = (
        flight.channels,
        flight.effects,
        Path(flight.model) if is_model_file(flight.model) else None,
        flight.vehicle_beside,
    )
    files = [*flight.records, *(record.with_suffix(".json") for record in flight.records)]
    files += [path for path in further if path is not None]
    hashes = [
        hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "" for path in files
    ]
    content = [
        RESULT_VERSION,
        own_version(),
        flight.name,
        flight.model,
        flight.vehicle,
        repr(flight.plan),
        flight.effort,
        *hashes,
    ]
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


# ---- Check and diagnosis of one flight, as a task

SCHEMA = "flightid/survey-flight/1"
KEPT = "flight.json"
FOLDER = "flights"


@dataclass(frozen=True)
class Diagnoses:
    """Diagnoses of the flights of a survey; each task diagnoses a flight and writes its folder.

    Attributes
    ----------
    flights : the flights.
    folder : folder of the survey.
    figures : formats of the figures of each flight.
    name : the work in words, for messages on its progress.
    block : number of flights of a task.
    """

    flights: tuple[SurveyFlight, ...]
    folder: Path
    figures: Formats = ()
    name: str = "flights diagnosed"
    block: int = 1

    @property
    def columns(self) -> Mapping[str, str]:
        """Types of the columns of the rows."""
        return {"flight": "text", "verdict": "text"}

    def identity(self) -> Mapping[str, Any]:
        """Return the values by which an unfinished run of the same work is recognised."""
        return {"flights": [flight.digest for flight in self.flights]}

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        """Diagnose the flights of the tasks, and return a row or the text of an error for each."""
        rows: list[Row | str] = []
        for task in tasks:
            flight = self.flights[task.number]
            try:
                content = diagnosed(flight, self.folder / FOLDER / flight.name, self.figures)
                rows.append({"flight": flight.name, "verdict": content["verdict"]})
            except FlightidError as error:
                rows.append(str(error))
        return rows


def diagnosed(flight: SurveyFlight, folder: Path, figures: Formats) -> dict[str, Any]:
    """Check and diagnose a flight, write its study, and return the content of ``flight.json``.

    Raises FlightidError if the flight cannot be used.
    """
    from scenarios.diagnosis.diagnose import diagnose_files
    from scenarios.diagnosis.files import write_diagnosis
    from scenarios.diagnosis.text import headline, quantities

    started = time.perf_counter()
    tracing = diagnose_files(flight.request())
    (folder / KEPT).unlink(missing_ok=True)  # the old result no longer belongs to the folder
    write_diagnosis(tracing, folder, figures=figures)
    diagnosis = tracing.diagnosis
    content = {
        "schema": SCHEMA,
        "digest": flight.digest,
        "name": flight.name,
        "verdict": diagnosis.verdict.value,
        "headline": headline(tracing),
        "effects": [
            {
                "name": effect.name,
                "claimed": effect.claimed,
                "alternatives": list(effect.alternatives),
                "parameters": quantities(effect.parameters),
            }
            for effect in diagnosis.effects
        ],
        "derivatives": quantities(diagnosis.after),
        "check": kinematics_of(flight),
        "simulated": tracing.simulated,
        "seconds": round(time.perf_counter() - started, 3),
    }
    write_json(folder / KEPT, content)
    return content


def kinematics_of(flight: SurveyFlight) -> dict[str, Any]:
    """Return the kinematic check of the sensors of a flight, or the reason why there is none."""
    from scenarios.compatibility import check_files
    from scenarios.compatibility_report import finding_lines

    try:
        result = check_files(flight.request())
    except FlightidError as error:
        return {"done": False, "sentences": [error.what], "findings": []}
    names = dict.fromkeys(finding.name for finding in result.result.findings if finding.supported)
    return {"done": True, "sentences": list(finding_lines(result)), "findings": list(names)}


def stored_diagnosis(flight: SurveyFlight, folder: Path) -> dict[str, Any] | None:
    """Return the stored diagnosis of a flight; None without one, or if its inputs have changed.

    Inputs are records, vehicle, model, options and the version of the package.
    """
    content = json_or_none(folder / FOLDER / flight.name / KEPT)
    is_current = (
        isinstance(content, dict)
        and content.get("schema") == SCHEMA
        and content.get("digest") == flight.digest
    )
    return content if is_current else None
