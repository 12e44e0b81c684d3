"""Flights of a survey as its file declares them, and one flight checked and diagnosed."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

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


# ---- A vehicle file with what one flight changes of it, as TOML


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
    """TOML text of the content of a TOML file: one line a key, tables inline."""
    return "".join(f"{_text(key)} = {_inline(value)}\n" for key, value in content.items())


def _inline(value: Any) -> str:
    if isinstance(value, float):
        return repr(value)  # inf and nan, too, are TOML
    if isinstance(value, Mapping):
        return (
            "{" + ", ".join(f"{_text(key)} = {_inline(each)}" for key, each in value.items()) + "}"
        )
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return _text(value) if isinstance(value, str) else json.dumps(value, default=str)


def _text(value: str) -> str:
    # what JSON and TOML write alike
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


# ---- The flights of a survey as its file declares them

RESULT_VERSION = "1"  # version of stored results; others are recomputed
# Quantities that are conditions wherever they are given, in the unit in which they are kept.
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
    """One flight: its name, request (files not yet opened), and flight condition.

    ``vehicle``: text of the vehicle file with the flight's changes, or empty. ``condition``: values
    with units, by name. ``digest``: hash of everything that affects the results.
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
        """The vehicle file that is read because it is in the folder of the record, where the survey
        names none.
        """
        return None if self.vehicle else vehicle_next_to(self.records[0])

    def request(self) -> Request:
        """Request of the diagnosis of this flight."""
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
    """A survey's file: its path and hash, its title, its model, its flights in their order."""

    path: Path
    sha256: str
    title: str
    model: str
    flights: tuple[SurveyFlight, ...]


def read_flights(path: str | Path) -> Flights:
    """Read a survey's file; paths in it are relative to it.

    Raises
    ------
    DeclarationError : no such file, a key that is unknown or missing, a value that is wrong, two
        flights of one name, no flight; a line with file, flight and remedy. A record that does not
        exist is no error here: its flight is reported as failed.
    """
    from scenarios.files.schemas import SurveyEntry

    source = read_toml_source(path)
    where, root = str(path), Path(path).parent
    entry = checked(SurveyEntry, toml_of(source), path)
    model = str(root / entry.model) if is_model_file(entry.model) else entry.model
    refuse_unknown_model(model, f"{where}, key model")
    vehicle = toml_of(read_toml_source(root / entry.vehicle)) if entry.vehicle is not None else {}
    result = [
        (_name_of(each, root, where, number), each)
        for number, each in enumerate([*_listed(entry, root, where), *entry.flights], start=1)
    ]
    if not result:
        raise DeclarationError(
            "there is no flight",
            where=where,
            remedy='add [[flights]] tables, or records = "flights/*.csv"',
        )
    names = [name for name, _ in result]
    first: dict[str, str] = {}
    for name in names:
        other = first.setdefault(name.lower(), name)
        if names.count(name) > 1 or other != name:
            pair = (
                name
                if other == name
                else f"{other} and {name}, one folder where case does not count"
            )
            raise DeclarationError(
                f"two flights are called {pair}", where=where, remedy="give each a name of its own"
            )
    flights = tuple(
        _flight(name, each, entry, root, model, vehicle, where) for name, each in result
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
    """Flights of the records that the top of the file lists, sorted by name."""
    from scenarios.files.schemas import FlightEntry

    patterns = [entry.records] if isinstance(entry.records, str) else entry.records or []
    listed = {Path(one) for each in entry.flights for one in (each.records or [str(each.record)])}
    out = []
    for pattern in patterns:
        anchor = Path(Path(pattern).anchor) if Path(pattern).is_absolute() else root
        below = str(Path(pattern).relative_to(anchor)) if Path(pattern).is_absolute() else pattern
        matched = (
            sorted(anchor.glob(below))
            if any(mark in pattern for mark in "*?[")
            else [root / pattern]
        )
        if not matched:
            raise DeclarationError(
                f"no file matches {pattern!r}",
                where=f"{where}, key records",
                remedy="check the path; it is relative to this file",
            )
        paths = [each.relative_to(root) if each.is_relative_to(root) else each for each in matched]
        out += [
            FlightEntry.model_validate({"record": each.as_posix()})
            for each in paths
            if each not in listed
        ]
    return out


def _name_of(entry: FlightEntry, root: Path, where: str, number: int) -> str:
    import re

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
    records = tuple(root / each for each in (entry.records or [str(entry.record)]))
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
    """Return the plan with the maneuvers that a flight names. Raises DeclarationError; a record
    that is not there fails with its flight.
    """
    from scenarios.preparation.plan import with_maneuvers

    if not all(each.is_file() for each in records):
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
    """Raise DeclarationError for an error common to all flights: a missing map or file of effects,
    a wrong vehicle.
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
    texts: dict[str, SurveyFlight] = {}
    for flight in flights:
        texts.setdefault(flight.vehicle, flight)
    # The vehicle file first: its errors do not belong to a flight.
    for text in sorted(filter(None, texts), key=lambda text: text != shared):
        source = texts[text].request().vehicle
        try:
            read_vehicle(source, texts[text].model)
        except DeclarationError as error:
            place = error.where.removeprefix(texts[text].vehicle_name)
            origin = (
                f"{vehicle}{place}"
                if text == shared
                else f"{where}, flight {texts[text].name}, vehicle{place}"
            )
            raise DeclarationError(error.what, where=origin, remedy=error.remedy) from None


def _own_or_shared(own: Any, shared: Any) -> Any:
    return own if own is not None else shared


def _condition(key: str, value: object, place: str) -> tuple[float, str]:
    """Return a condition in its standard unit if known, else as given."""
    from scenarios.files.schemas import number_in

    unit = CONDITIONS.get(key.lower())
    if unit is not None or not isinstance(value, str):
        return number_in(value, unit or "1", f"{place}, {key}"), unit or "1"
    number, _, own = value.strip().partition(" ")
    try:
        return to_si(
            float(number), own.strip(), own.strip(), f"{place}, {key}", DeclarationError
        ), own.strip() or "1"
    except ValueError:
        raise DeclarationError(
            f"{value!r} is not a number with a unit",
            where=f"{place}, {key}",
            remedy='write 0.6 or "12000 ft"',
        ) from None


def _in_one_unit(flights: Sequence[SurveyFlight], where: str) -> tuple[SurveyFlight, ...]:
    """Each condition in the unit of the first flight that has it. Raises DeclarationError if it
    measures something else.
    """
    units: dict[str, str] = {}
    out = []
    for flight in flights:
        condition = {}
        for key, (value, unit) in flight.condition.items():
            first = units.setdefault(key, unit)
            condition[key] = (
                to_si(
                    value, unit, first, f"{where}, flight {flight.name}, {key}", DeclarationError
                ),
                first,
            )
        out.append(replace(flight, condition=condition))
    return tuple(out)


def _digest(flight: SurveyFlight) -> str:
    """Return a hash of everything that a flight's results depend on, also of which files are
    missing.
    """
    files = [*flight.records, *(each.with_suffix(".json") for each in flight.records)]
    files += [
        each
        for each in (
            flight.channels,
            flight.effects,
            Path(flight.model) if is_model_file(flight.model) else None,
            flight.vehicle_beside,
        )
        if each is not None
    ]
    contents = [
        hashlib.sha256(each.read_bytes()).hexdigest() if each.is_file() else "" for each in files
    ]
    rest = [
        RESULT_VERSION,
        own_version(),
        flight.name,
        flight.model,
        flight.vehicle,
        repr(flight.plan),
        flight.effort,
        *contents,
    ]
    return hashlib.sha256(json.dumps(rest).encode()).hexdigest()


# ---- Check and diagnosis of one flight, as a task

SCHEMA = "flightid/survey-flight/1"
KEPT = "flight.json"
FOLDER = "flights"


@dataclass(frozen=True)
class Diagnoses:
    """Diagnoses of a survey; each task is a flight and writes its folder."""

    flights: tuple[SurveyFlight, ...]
    folder: Path
    figures: Formats = ()
    name: str = "flights diagnosed"
    block: int = 1

    @property
    def columns(self) -> Mapping[str, str]:
        return {"flight": "text", "verdict": "text"}

    def identity(self) -> Mapping[str, Any]:
        return {"flights": [flight.digest for flight in self.flights]}

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        return [self._one(self.flights[task.number]) for task in tasks]

    def _one(self, flight: SurveyFlight) -> Row | str:
        try:
            kept = diagnosed(flight, self.folder / FOLDER / flight.name, self.figures)
        except FlightidError as error:
            return str(error)
        return {"flight": flight.name, "verdict": kept["verdict"]}


def diagnosed(flight: SurveyFlight, folder: Path, figures: Formats) -> dict[str, Any]:
    """Check and diagnose a flight, write its study, and return the content of ``flight.json``.

    Raises FlightidError if the flight cannot be used.
    """
    from scenarios.diagnosis.diagnose import diagnose_files
    from scenarios.diagnosis.report.files import write_diagnosis
    from scenarios.diagnosis.report.text import headline, quantities

    started = time.perf_counter()
    tracing = diagnose_files(flight.request())
    (folder / KEPT).unlink(missing_ok=True)  # the old result no longer belongs to the folder
    write_diagnosis(tracing, folder, figures=figures)
    d = tracing.diagnosis
    content = {
        "schema": SCHEMA,
        "digest": flight.digest,
        "name": flight.name,
        "verdict": d.verdict.value,
        "headline": headline(tracing),
        "effects": [
            {
                "name": c.name,
                "claimed": c.claimed,
                "alternatives": list(c.alternatives),
                "parameters": quantities(c.parameters),
            }
            for c in d.effects
        ],
        "derivatives": quantities(d.after),
        "check": kinematics_of(flight),
        "simulated": tracing.simulated,
        "seconds": round(time.perf_counter() - started, 3),
    }
    write_json(folder / KEPT, content)
    return content


def kinematics_of(flight: SurveyFlight) -> dict[str, Any]:
    """Kinematic check of a flight's sensors, or why there is none."""
    from scenarios.compatibility.check import check_files
    from scenarios.compatibility.report import finding_lines

    try:
        result = check_files(flight.request())
    except FlightidError as error:
        return {"done": False, "sentences": [f"{error.what}"], "findings": []}
    names = list(
        dict.fromkeys(finding.name for finding in result.result.findings if finding.stands)
    )
    return {"done": True, "sentences": list(finding_lines(result)), "findings": names}


def kept_diagnosis(flight: SurveyFlight, folder: Path) -> dict[str, Any] | None:
    """Stored diagnosis of a flight if record, vehicle, model, options and version are unchanged;
    else None.
    """
    content = json_or_none(folder / FOLDER / flight.name / KEPT)
    sound = (
        isinstance(content, dict)
        and content.get("schema") == SCHEMA
        and content.get("digest") == flight.digest
    )
    return content if sound else None
