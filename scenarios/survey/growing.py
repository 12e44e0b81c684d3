"""Work of a survey on its flights, on this machine or a cluster: diagnoses of new flights, and fits
with sets of effects. Results are kept in the folder of the survey.
"""

from __future__ import annotations

import base64
import hashlib
import io
import json
import os
import socket
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from scenarios.files.sources import json_or_none
from scenarios.files.user_models import is_model_file
from scenarios.files.writing import study_folder, write_json
from scenarios.report.figure_formats import Formats
from scenarios.survey.flights import FOLDER, Diagnoses, Flights, SurveyFlight, stored_diagnosis
from scenarios.survey.flights import KEPT as KEPT_FILES
from scenarios.tasks.study import ShowProgress, TaskRequest, run_study
from scenarios.tasks.work import Row, Task
from sim.errors import FlightidError

if TYPE_CHECKING:
    from ident.tracing.fitted_model import FitData, FittedModel
    from ident.whole_record.layout import FitSettings
    from scenarios.tasks.work import RowTable
    from sim.declaration.proposal import Traceable


# ---- Fits of each flight with every set of effects

SCHEMA = "flightid/survey-fits/2"
KEPT = "sets.json"
Starts = Mapping[str, float]  # full name of a parameter -> starting value


@dataclass(frozen=True)
class PooledFits:
    """Fits of all flights; each task fits one flight with all sets of effects.

    Attributes
    ----------
    flights : the flights.
    effects : effects that may recur.
    starts : starting values of these effects, from all flights.
    own : further effects that only one flight has, with starting values, for each flight.
    folder : folder of the survey.
    name : the work in words, for messages on its progress.
    block : number of flights of a task.
    """

    flights: tuple[SurveyFlight, ...]
    effects: tuple[str, ...]
    starts: Starts
    own: tuple[Mapping[str, Starts], ...]
    folder: Path
    name: str = "flights fitted with what recurs"
    block: int = 1

    @property
    def columns(self) -> Mapping[str, str]:
        """Types of the columns of the rows."""
        return {"flight": "text", "sets": "int"}

    def identity(self) -> Mapping[str, Any]:
        """Return the values by which an unfinished run of the same work is recognised."""
        return {"digests": [self.digest(number) for number in range(len(self.flights))]}

    def digest(self, number: int) -> str:
        """Return a hash of all that the fits of a flight depend on, except starting values."""
        content = [
            SCHEMA,
            self.flights[number].digest,
            sorted(self.effects),
            sorted(self.own[number]),
        ]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()

    def path(self, number: int) -> Path:
        """Return the path of the stored fits of a flight."""
        return self.folder / FOLDER / self.flights[number].name / KEPT

    def kept(self, number: int) -> Mapping[str, Any] | None:
        """Return the stored fits of a flight; None without fits, or if they are outdated."""
        content = json_or_none(self.path(number))
        if isinstance(content, dict) and content.get("digest") == self.digest(number):
            return content
        return None

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        """Fit the flights of the tasks, and return a row, or the text of an error, for each."""
        rows: list[Row | str] = []
        for task in tasks:
            try:
                sets = fitted_sets(
                    self.flights[task.number], self.effects, self.starts, self.own[task.number]
                )
            except FlightidError as error:
                rows.append(str(error))
                continue
            write_json(
                self.path(task.number),
                {"schema": SCHEMA, "digest": self.digest(task.number), **sets},
            )
            rows.append({"flight": self.flights[task.number].name, "sets": len(sets["sets"])})
        return rows


def fitted_sets(
    flight: SurveyFlight, names: Sequence[str], starts: Starts, own: Mapping[str, Starts]
) -> dict[str, Any]:
    """Return log likelihood, estimates and covariance of a flight with each set of effects.

    For coloured residuals, the log likelihood is scaled by the share of independent samples, taken
    from the fit of the largest set. All fits under ``sets`` have the flight's ``own`` effects as
    well. Those under ``sets_without`` have only those ``own`` effects that concern single flights
    by their nature, such as gusts: a flight alone may claim one effect instead of two recurring
    ones.
    """
    from ident.statistics.residual_spectrum import effective_share
    from ident.tracing.fitted_model import FitData
    from ident.tracing.wrong_samples import measured_masks
    from ident.whole_record.layout import FitSettings
    from scenarios.diagnosis.opening import (
        candidates_for,
        loop_input_for,
        opened_files,
        own_effects,
        vehicle_path_of,
    )
    from scenarios.preparation.declared_model import sub_step
    from scenarios.survey.recurring import is_of_flight

    request = flight.request()
    opened = opened_files(request, vehicle_path_of(request))
    prepared = loop_input_for(opened, request.plan)
    records = (*prepared.records, *prepared.predicted)
    users_effects = own_effects(request.effects, prepared.model)[0]
    by_name = {effect.name: effect for effect in candidates_for(prepared.model, users_effects)}
    measured = {name for record in records for name in record.output_names}
    outputs = [item.name for item in prepared.model.equations.outputs if item.name in measured]
    data = FitData(records, measured_masks(records, outputs), prepared.model, outputs)
    settings = FitSettings(max_step=sub_step(prepared.model, prepared.records, 0.01), enough=1e-6)
    usable = [name for name in names if name in by_name]
    search = _EffectSetFits(
        data,
        settings,
        by_name,
        starts,
        {full: value for values in own.values() for full, value in values.items()},
    )
    own_usable = [name for name in own if name in by_name]
    of_flight = [name for name in own_usable if is_of_flight(name)]
    fits = {"sets": search.sets(usable, own_usable)}
    if of_flight != own_usable:
        fits["sets_without"] = search.sets(usable, of_flight)
    successful = [fitted for fitted in fits["sets"].values() if fitted is not None]
    share = 1.0
    if successful:
        largest = successful[-1]
        valid = [problem.valid for problem in largest.fit.layout.problems]
        share = effective_share(largest.fit.residuals, valid)
    declared = [
        item.name
        for item in prepared.model.parameters
        if item.free and not item.name.startswith("bias_")
    ]
    units = {item.name: item.unit for item in prepared.model.parameters}
    return {
        "declared": declared,
        "units": {name: units[name] for name in declared},
        "effects": {
            name: {
                "parameters": [*_units(by_name[name])],
                "units": _units(by_name[name]),
                "full": _full_names(by_name[name]),
            }
            for name in usable
        },
        "independent": share,
        "own": [name for name in own_usable if name not in of_flight],
        **{
            key: {
                "+".join(sorted(chosen)): _fit_content(
                    fitted, declared, [by_name[name] for name in sorted(chosen)], share
                )
                for chosen, fitted in by_set.items()
                if fitted is not None
            }
            for key, by_set in fits.items()
        },
    }


@dataclass(frozen=True, eq=False)
class _EffectSetFits:
    """Fits of the records of a flight with sets of effects, each started from the best smaller set.

    Attributes
    ----------
    data : records and model.
    settings : settings of the fits.
    known : name -> effect.
    starts, own : starting values of the effects that may recur, and of those of the flight alone.
    """

    data: FitData
    settings: FitSettings
    known: Mapping[str, Traceable]
    starts: Starts
    own: Starts

    def sets(
        self, names: Sequence[str], always: Sequence[str]
    ) -> dict[frozenset[str], FittedModel | None]:
        """Return the fits with every subset of ``names``, the full set last, None for a failed fit.

        Every fit has the effects ``always`` as well.
        """
        fits: dict[frozenset[str], FittedModel | None] = {}
        for size in range(len(names) + 1):
            for chosen in combinations(names, size):
                smaller = [
                    fitted
                    for name in chosen
                    if (fitted := fits[frozenset(chosen) - {name}]) is not None
                ]
                start = min(smaller, key=lambda fitted: fitted.fit.cost, default=None)
                fits[frozenset(chosen)] = self._fitted([*always, *chosen], start)
        return fits

    def _fitted(self, names: Sequence[str], start: FittedModel | None) -> FittedModel | None:
        from ident.tracing.fitted_model import fit_set, start_from

        return fit_set(
            self.data,
            [self.known[name] for name in names],
            self.settings,
            start_from(start, {**self.own, **self.starts}),
        )


def _units(effect: Traceable) -> dict[str, str]:
    return {item.name: item.unit for item in effect.parameters if item.free}


def _full_names(effect: Traceable) -> list[str]:
    from sim.declaration.effect import full_name

    return [full_name(effect, item.name) for item in effect.parameters if item.free]


def _fit_content(
    fitted: FittedModel, declared: Sequence[str], effects: Sequence[Traceable], share: float
) -> dict[str, Any]:
    """Return the content of a fit: estimates of the declared parameters, then of those of the
    effects, with their covariance.

    A parameter that the fit does not have is zero, with a variance of 1e30.
    """
    from ident.statistics.intervals import inverse_information

    normal, _ = fitted.fit.normal_equations()
    covariance, _ = inverse_information(normal, fitted.fit.theta)
    places = {name: place for place, name in enumerate(fitted.fit.layout.names)}
    names = [*declared, *(full for effect in effects for full in _full_names(effect))]
    at = np.array([places.get(name, places.get(f"{name}, record 1", -1)) for name in names], int)
    is_fitted, at = at >= 0, np.maximum(at, 0)
    return {
        "log_likelihood": share * fitted.fit.log_likelihood,
        "names": names,
        "estimate": np.where(is_fitted, fitted.fit.theta[at], 0.0),
        "covariance": np.where(
            np.outer(is_fitted, is_fitted), covariance[np.ix_(at, at)], 1e30 * np.eye(len(at))
        )
        / share,
    }


# ---- The same work on a cluster

FILES = "files"  # column with the files of a flight, as a ZIP archive in base64
STUDY = "diagnosis.json"


@dataclass(frozen=True)
class Sent:
    """Work of a survey for the workers of a cluster.

    Attributes
    ----------
    work : the work, with the folder on this machine.
    place : current folder, to which paths are relative.
    typed : words of the command line, which pages show.
    inputs : existing files, which every worker has to see at the same path.
    """

    work: Diagnoses | PooledFits
    place: Path
    typed: tuple[str, ...]
    inputs: tuple[Path, ...]

    @property
    def name(self) -> str:
        """The work in words."""
        return self.work.name

    @property
    def block(self) -> int:
        """Number of flights of a task."""
        return self.work.block

    @property
    def columns(self) -> Mapping[str, str]:
        """Types of the columns of the rows."""
        return {**self.work.columns, FILES: "text"}

    def identity(self) -> Mapping[str, Any]:
        """Return the values by which an unfinished run of the same work is recognised."""
        return self.work.identity()

    def unready(self) -> tuple[str, str] | None:
        """Return the reason why this machine cannot do the work, and the remedy; None if it can."""
        for path in self.inputs:
            if not (self.place / path).is_file():
                return (
                    f"the worker on {socket.gethostname()} does not see {self.place / path}",
                    "put the flights on a disk that every worker sees at the same path",
                )
        return None

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        """Do each task in a temporary folder, and return its row with the files that it wrote."""
        os.chdir(self.place)  # the process does nothing else
        sys.argv = list(self.typed)
        rows: list[Row | str] = []
        for task in tasks:
            with TemporaryDirectory(prefix="flightid-") as scratch:
                folder = Path(scratch) / FOLDER / self.work.flights[task.number].name
                folder.mkdir(parents=True)
                (row,) = replace(self.work, folder=Path(scratch)).run([task])
                rows.append(row if isinstance(row, str) else {**row, FILES: _packed(folder)})
        return rows

    def taken(self, row: Row) -> Row:
        """Write the files of a row into the folder of the survey, and return the row without them.

        Raises FlightidError if the folder cannot be written.
        """
        files = _unpacked(str(row[FILES]))
        folder = self.work.folder / FOLDER / str(row["flight"])
        if STUDY in files:
            # The old result no longer belongs to the folder.
            (folder / KEPT_FILES).unlink(missing_ok=True)
            with study_folder(folder, STUDY) as scratch:
                for name, content in files.items():
                    if name != KEPT_FILES:
                        (scratch / name).write_bytes(content)
            files = {KEPT_FILES: files[KEPT_FILES]}
        for name, content in files.items():
            part = folder / f".{name}.part"
            part.write_bytes(content)
            os.replace(part, folder / name)
        return {**row, FILES: ""}


def sent(work: Diagnoses | PooledFits) -> Sent:
    """Return the work of a survey, to be given to a cluster by this process."""
    files = dict.fromkeys(
        path for flight in work.flights for path in _inputs(flight) if path.is_file()
    )
    folder = Path.cwd()
    return Sent(replace(work, folder=folder / work.folder), folder, tuple(sys.argv), tuple(files))


def _inputs(flight: SurveyFlight) -> list[Path]:
    model = [Path(flight.model)] if is_model_file(flight.model) else []
    return [
        *flight.records,
        *model,
        *(path for path in (flight.channels, flight.effects) if path is not None),
    ]


def _packed(folder: Path) -> str:
    """Return the files of a folder as a ZIP archive in base64."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as files:
        for path in sorted(folder.iterdir()):
            files.write(path, path.name)
    return base64.b64encode(archive.getvalue()).decode("ascii")


def _unpacked(text: str) -> dict[str, bytes]:
    """Return file name -> content of an archive as ``_packed`` returns it."""
    with zipfile.ZipFile(io.BytesIO(base64.b64decode(text))) as files:
        return {Path(item.filename).name: files.read(item) for item in files.infolist()}


# ---- Results of all flights

MAIN = "survey.json"
GROWING_SCHEMA = "flightid/survey/1"


@dataclass(frozen=True)
class SurveyFiles:
    """The diagnoses of the flights of a survey, and the names of new and removed flights.

    Attributes
    ----------
    diagnoses : flight -> content of its diagnosis file, in the order of the survey file.
    flights : flight -> its declaration.
    computed : flights that were diagnosed in this run.
    failed : flight that could not be diagnosed -> reason.
    removed : flights that only the last survey had.
    before : flights of the last survey.
    """

    diagnoses: Mapping[str, Mapping[str, Any]]
    flights: Mapping[str, SurveyFlight]
    computed: tuple[str, ...]
    failed: Mapping[str, str]
    removed: tuple[str, ...]
    before: frozenset[str]

    @property
    def new(self) -> tuple[str, ...]:
        """Return the flights that the last survey did not have; none in the first survey."""
        if not self.before:
            return ()
        return tuple(name for name in self.diagnoses if name not in self.before)


def survey_files(
    survey_flights: Flights,
    folder: Path,
    jobs: int = 1,
    figures: Formats = (),
    show_progress: ShowProgress = lambda stage, share: None,
    cluster: str | None = None,
) -> SurveyFiles:
    """Diagnose the flights without results in the folder, and return all results.

    It works in ``jobs`` processes, or on the ``cluster`` at an address.

    Raises
    ------
    KeyboardInterrupt : after Ctrl-C. The message has the number of flights that are kept.
    FlightidError : ``folder`` cannot be written.
    """
    before = last_survey(folder)
    missing = tuple(
        flight for flight in survey_flights.flights if stored_diagnosis(flight, folder) is None
    )
    failed: dict[str, str] = {}
    if missing:
        work = Diagnoses(missing, folder, figures)
        try:
            table = run_flights(work, len(missing), jobs, folder, show_progress, cluster)
            ended = len(table)
        except KeyboardInterrupt:
            ended, table = 0, None
        if table is None or not table.whole:
            raise KeyboardInterrupt(
                f"{len(survey_flights.flights) - len(missing) + ended} of "
                f"{len(survey_flights.flights)} flights are kept in {folder}"
            )
        failed = {
            missing[int(n)].name: str(error)
            for n, error in zip(table.columns["number"], table.columns["error"], strict=True)
            if error
        }
    kept = {flight.name: stored_diagnosis(flight, folder) for flight in survey_flights.flights}
    diagnoses = {name: content for name, content in kept.items() if content is not None}
    for name in kept:
        if name not in diagnoses:
            failed.setdefault(name, "nothing was kept of it")
    computed = tuple(flight.name for flight in missing if flight.name in diagnoses)
    flights_before = frozenset(map(str, before.get("flights", {})))
    return SurveyFiles(
        diagnoses,
        {flight.name: flight for flight in survey_flights.flights},
        computed,
        failed,
        tuple(sorted(flights_before - set(kept))),
        flights_before,
    )


def run_flights(
    work: Diagnoses | PooledFits,
    count: int,
    jobs: int,
    folder: Path,
    show_progress: ShowProgress,
    cluster: str | None,
) -> RowTable:
    """Do the work of a survey on ``count`` flights, and return its rows. Raises as ``run_study``.

    The files of the flights are written into ``folder``.
    """
    task_request = TaskRequest(
        count, 0, max(1, min(jobs, count)), cluster=cluster, unit="flights", elsewhere=folder
    )
    return run_study(work if cluster is None else sent(work), task_request, show_progress)


def last_survey(folder: Path) -> Mapping[str, Any]:
    """Return the document of the last survey in a folder; empty if there is none."""
    content = json_or_none(folder / MAIN)
    is_survey = (
        isinstance(content, dict)
        and content.get("schema") == GROWING_SCHEMA
        and isinstance(content.get("flights"), dict)
    )
    return content if is_survey else {}
