"""From keywords to requests: run scenarios of every kind, simulate records."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, SupportsFloat

from scenarios.api import tables
from scenarios.api.record import Record as ApiRecord
from scenarios.api.record import record_of
from scenarios.api.records import ChannelMap, choices_of, opened_source
from scenarios.api.vehicle import Vehicle, source_of
from scenarios.files.declarations import named_after
from scenarios.files.measured.columns import RecordFile, refuse_duplicates
from scenarios.files.user_models import OwnModel, model_in_memory
from scenarios.files.vehicles import MODELS
from scenarios.preparation.plan import Plan, Request, plan_of
from scenarios.report.figure_formats import Formats
from scenarios.studies.catalogue import load_document, scenario_file, scenario_kind
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.errors import DeclarationError, RecordError

if TYPE_CHECKING:
    from rich.console import Console

    from sim.record import Record


# ---- Scenarios of every kind

Progress = Callable[[str, float], None]
KEPT = "below; save(FOLDER) keeps them"  # place of details, in Python


class Write(Protocol):
    """Writes a study into a folder, all files or none."""

    def __call__(self, study: Any, folder: Path, /, *, figures: Formats) -> object: ...


@dataclass(frozen=True)
class Runner:
    """Functions of a loaded scenario.

    Attributes
    ----------
    run : runs it with a seed (None: its own).
    write : writes a study into a folder.
    show : prints a study and the place of its details.
    text : returns the printed text, for Python.
    counted : whether the reported progress is proportional to time, unlike that of a search.
    """

    run: Callable[[int | None, Progress], Any]
    write: Write
    show: Callable[[Any, str], None]
    text: Callable[[Any], str]
    counted: bool = True


def no_progress(stage: str, share: float) -> None:
    """Ignore progress."""


def _identification(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.studies.catalogue import load_scenario
    from scenarios.studies.comparison import check_display
    from scenarios.studies.folder import write_study
    from scenarios.studies.study import StudyResult, fly_repeatedly, run_scenario
    from scenarios.studies.sweep import sweep_flexibility
    from scenarios.studies.text import print_brief, print_study

    scenario = load_scenario(name, changes)

    def run(seed: int | None, progress: Progress) -> StudyResult:
        study = run_scenario(scenario, seed)
        check_display(study)
        sweep = sweep_flexibility(scenario, study.record, study.seed, progress)
        return replace(study, repeated=fly_repeatedly(scenario, seed, progress), sweep=sweep)

    return Runner(run, write_study, _on_console(print_brief), _as_text(print_study))


def _trace(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.trials.planted_flights import trace_scenario_of
    from scenarios.trials.planted_report import trace_text, write_trace
    from scenarios.trials.planted_study import run_trace

    run = partial(run_trace, trace_scenario_of(*load_document(name, changes)))
    return Runner(
        run, write_trace, _printed(trace_text), partial(trace_text, details=KEPT), counted=False
    )


def _loop(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.x29.files import write_loop
    from scenarios.x29.printing import print_loop, print_loop_brief
    from scenarios.x29.study import loop_scenario, run_loop

    scenario = loop_scenario(name, changes)
    return Runner(
        lambda seed, progress: run_loop(scenario, seed),
        write_loop,
        _on_console(print_loop_brief),
        _as_text(print_loop),
    )


def _sweep(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.trials.sweeps import print_sweep, run_sweep, sweep_scenario_of, write_sweep

    run = partial(run_sweep, sweep_scenario_of(*load_document(name, changes)))
    return Runner(run, write_sweep, _on_console(print_sweep), _as_text(print_sweep))


def _flown_only(name: str, changes: Sequence[str]) -> Runner:
    remedy = f"use flightid simulate {name} --out flight.csv, and then identify or diagnose"
    raise DeclarationError(
        "a flight by JSBSim is a record without a study", where=scenario_file(name), remedy=remedy
    )


def _as_text(show: Callable[[Any, Console, str], None]) -> Callable[[Any], str]:
    """Return a function that returns what ``show`` prints of a study."""

    def text(study: Any) -> str:
        from scenarios.report.quantities import as_text

        return as_text(lambda out: show(study, out, KEPT))

    return text


def _on_console(show: Callable[..., None]) -> Callable[[Any, str], None]:
    """Return a function that prints a study with rich, and the place of its details."""
    return lambda study, details: show(study, details=details)


def _printed(text: Callable[[Any, int, str], str]) -> Callable[[Any, str], None]:
    """Return a function that prints a study's text in the width of the terminal."""

    def show(study: Any, details: str) -> None:
        from scenarios.report.summary import terminal_width

        print(text(study, terminal_width(), details), end="")

    return show


LOADERS: Mapping[str, Callable[[str, Sequence[str]], Runner]] = {
    "identification": _identification,
    "trace": _trace,
    "x29": _loop,
    "sweep": _sweep,
    "jsbsim": _flown_only,
}


def flown_record(name: str, seed: int | None, changes: Sequence[str]) -> Record:
    """Return the record of a scenario with one flight: identification, closed loop or sweep."""
    from scenarios.studies.catalogue import load_scenario

    if scenario_kind(name) == "sweep":
        import numpy as np

        from scenarios.trials.sweeps import fly_sweep, sweep_scenario_of

        sweep = sweep_scenario_of(*load_document(name, changes))
        with named_after(scenario_file(name)):
            return fly_sweep(sweep, np.random.default_rng(sweep.seed if seed is None else seed))
    if scenario_kind(name) == "x29":
        from scenarios.x29.declaration import fly_loop
        from scenarios.x29.study import loop_scenario

        loop = loop_scenario(name, changes)
        with named_after(scenario_file(name)):
            return fly_loop(loop.flight, loop.seed if seed is None else seed).record
    from scenarios.studies.estimating import fly_scenario

    scenario = load_scenario(name, changes)
    with named_after(scenario_file(name)):
        return fly_scenario(scenario, scenario.seed if seed is None else seed)[0]


# ---- From keywords to the request that the commands make of their options

RecordSource = str | PathLike[str] | ApiRecord | Any  # a record, or whatever `read_record` takes
# A model's name, the path of the Python file of a user model, or that model itself.
ModelSource = str | PathLike[str] | Model
Times = float | Sequence[float] | None
ManeuverNames = int | str | Sequence[int | str] | None  # maneuvers by number or name
# The result of `find_maneuvers`, or the path of a file of maneuvers.
ManeuverParts = str | PathLike[str] | Any


def request_of(
    records: RecordSource | Sequence[RecordSource],
    model: ModelSource = "",
    vehicle: str | PathLike[str] | Mapping[str, Any] | Vehicle | None = None,
    validate: RecordSource | Sequence[RecordSource] = (),
    *,
    effects: str | PathLike[str] | Sequence[Traceable] | None = None,
    channels: ChannelMap | None = None,
    plan: Plan,
    effort: str = "normal",
    aircraft_class: str | None = None,
    category: str | None = None,
) -> Request:
    """Return the request. Records are opened here, so that errors precede any computation."""
    fitted, predicted = _listed(records), _listed(validate)
    if not fitted:
        raise RecordError("no record is given", where="records", remedy="give one at least")
    opened = [file_of(source) for source in (*fitted, *predicted)]
    refuse_duplicates([file for file in opened if file.in_memory])
    files = numbered_apart(opened)
    declared = model_of(model)
    return Request(
        tuple(files[: len(fitted)]),
        declared,
        source_of(vehicle, declared if isinstance(declared, str) else ""),
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
    """Return the plan of preparation.

    ``start``, ``stop``: one time, or one of each maneuver, s. ``columns``: names with commas, or a
    list.
    """
    names = None if columns is None else ",".join(tables.names_of(columns, "column", "columns"))
    return plan_of(
        _times(start), _times(stop), hold, rate, lowpass, trusted=trust_record, columns=names
    )


def with_parts(request: Request, asked: ManeuverNames, found: ManeuverParts) -> Request:
    """Return the request with the requested maneuvers as its segments. Raises DeclarationError."""
    from scenarios.preparation.plan import DeclaredParts, with_maneuvers

    listed: Any = [] if asked is None else [asked] if isinstance(asked, int | str) else asked
    if not isinstance(listed, list | tuple) or not all(isinstance(e, int | str) for e in listed):
        remedy = "give a number or a name, or a list of them"
        raise DeclarationError(f"{asked!r:.60} is no maneuver", where="maneuver", remedy=remedy)
    several: list[int | str] = [*listed]
    file = Path(found) if isinstance(found, str | PathLike) else getattr(found, "parts", found)
    if not (file is None or isinstance(file, Path | DeclaredParts)):
        what = f"a {type(found).__name__} holds no maneuvers"
        raise DeclarationError(
            what, where="maneuvers", remedy="give what find_maneuvers returned, or a file's path"
        )
    return replace(request, plan=with_maneuvers(request.plan, request.records, several, file))


def model_of(given: ModelSource) -> str | OwnModel:
    """Return a model's name, a path, or a user model made in Python. Raises DeclarationError."""
    return model_in_memory(given, MODELS) if isinstance(given, Model) else str(given)


def effects_of(
    given: str | PathLike[str] | Sequence[Traceable] | None,
) -> Path | tuple[Traceable, ...] | None:
    """Return a user's effects, or the path of their file. Raises DeclarationError."""
    if given is None:
        return None
    if isinstance(given, str | PathLike):
        return Path(given)
    if not isinstance(given, list | tuple):
        raise DeclarationError(
            f"a {type(given).__name__} is no list of effects",
            where="effects",
            remedy="give a list of them, or a file's path",
        )
    return tuple(given)


def _times(given: Times) -> list[float] | None:
    """Return the times as a list. Raises DeclarationError for an entry that is no number."""
    if given is None:
        return None
    times: Sequence[Any] = given if isinstance(given, list | tuple) else [given]
    for time in times:
        if isinstance(time, bool | str) or not isinstance(time, SupportsFloat):
            raise DeclarationError(
                f"{time!r:.60} is no time",
                where="start, stop",
                remedy="give a number in s, or a list of them",
            )
    return [float(time) for time in times]


def _listed(given: RecordSource | Sequence[RecordSource]) -> list[RecordSource]:
    if given is None:
        return []
    return list(given) if isinstance(given, list | tuple) else [given]


def file_of(given: RecordSource) -> RecordFile:
    """Return the record file of a record, or of a source of one. Raises RecordError."""
    return given.file if isinstance(given, ApiRecord) else opened_source(given)[0]


# ---- Flights of scenarios for their records alone


@dataclass(frozen=True, eq=False, repr=False)
class Flight:
    """Simulated records without their truth.

    Attributes
    ----------
    records : records to fit.
    validate : records to predict.
    vehicle : declared vehicle; None if the scenario has no vehicle file.
    """

    records: tuple[ApiRecord, ...]
    validate: tuple[ApiRecord, ...] = ()
    vehicle: Vehicle | None = None

    @property
    def record(self) -> ApiRecord:
        """The first record."""
        return self.records[0]

    def __repr__(self) -> str:
        more = ", ..." if len(self.records) > 3 else ""
        return f"<Flight: {', '.join(map(repr, self.records[:3]))}{more}>"

    def _repr_html_(self) -> str:
        parts = [record._repr_html_() for record in (*self.records, *self.validate)]
        parts += [] if self.vehicle is None else [self.vehicle._repr_html_()]
        return tables.page("flight", *parts)


def flown(name: str, seed: int | None, changes: Sequence[str]) -> Flight:
    """Simulate the flight of a scenario of any kind; the same seed gives the same numbers.

    Raises FlightidError.
    """
    kind = scenario_kind(name)
    if kind in _SIMULATED:
        return _SIMULATED[kind](name, seed, changes)
    return Flight((record_of(flown_record(name, seed, changes)),))


def _trace_flight(name: str, seed: int | None, changes: Sequence[str]) -> Flight:
    from scenarios.trials.planted_flights import fly_trace, trace_scenario_of

    scenario = trace_scenario_of(*load_document(name, changes))
    with named_after(scenario_file(name)):
        flight = fly_trace(scenario, scenario.seed if seed is None else seed)
    vehicle = Vehicle(tomllib.loads(flight.vehicle_file))
    return Flight((record_of(flight.train),), (record_of(flight.validate),), vehicle)


def _jsbsim_flight(name: str, seed: int | None, changes: Sequence[str]) -> Flight:
    from scenarios.trials.jsbsim_flight import fly_jsbsim, jsbsim_of

    flight = jsbsim_of(*load_document(name, changes))
    with named_after(scenario_file(name)):
        record, _ = fly_jsbsim(flight, flight.seed if seed is None else seed)
    return Flight((record_of(record),))


_SIMULATED = {"trace": _trace_flight, "jsbsim": _jsbsim_flight}


# ---- Names of record files in memory


def numbered_apart(files: Sequence[RecordFile]) -> list[RecordFile]:
    """Return the record files with different names in memory: ``record``, ``record 2`` ..."""
    taken = {file.path.name for file in files if not file.in_memory}
    renamed = []
    for file in files:
        name, number = file.path.name, 1
        while file.in_memory and name in taken:
            number += 1
            name = f"{file.path.name} {number}"
        if file.in_memory:
            taken.add(name)
        if name != file.path.name:
            table, identity = replace(file.table, file=name), replace(file.identity, name=name)
            file = replace(file, path=Path(name), table=table, identity=identity)
        renamed.append(file)
    return renamed
