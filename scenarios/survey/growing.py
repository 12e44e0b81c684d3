"""A survey's folder that grows: new flights are computed, on this machine or a cluster, and fitted
with the sets of effects.
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
from collections.abc import Callable, Mapping, Sequence
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
from scenarios.survey.flights import FOLDER, Diagnoses, Flights, SurveyFlight, kept_diagnosis
from scenarios.survey.flights import KEPT as KEPT_FILES
from scenarios.tasks.study import TaskRequest, run_study
from scenarios.tasks.work import Row, Task
from sim.errors import FlightidError

if TYPE_CHECKING:
    from ident.tracing.fitted_model import FitData, FittedModel
    from ident.whole_record.layout import FitSettings
    from scenarios.tasks.work import RowTable
    from sim.declaration.proposal import Traceable


# ---- Each flight fitted with every set of the effects that recur

SCHEMA = "flightid/survey-fits/2"
KEPT = "sets.json"
Starts = Mapping[str, float]  # by full name of a parameter


@dataclass(frozen=True)
class PooledFits:
    """Fits of all flights; each task fits one flight with all sets of ``effects``.

    ``starts``: starting values of effects, from other flights. ``own``: further effects of each
    flight alone, with their values.
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
        return {"flight": "text", "sets": "int"}

    def identity(self) -> Mapping[str, Any]:
        return {"digests": [self.digest(number) for number in range(len(self.flights))]}

    def digest(self, number: int) -> str:
        """Hash of everything that a flight's fits depend on, without the starting values."""
        content = [
            SCHEMA,
            self.flights[number].digest,
            sorted(self.effects),
            sorted(self.own[number]),
        ]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()

    def path(self, number: int) -> Path:
        return self.folder / FOLDER / self.flights[number].name / KEPT

    def kept(self, number: int) -> Mapping[str, Any] | None:
        """Return the fits of a flight from its folder; None if these are not there."""
        content = json_or_none(self.path(number))
        return (
            content
            if isinstance(content, dict) and content.get("digest") == self.digest(number)
            else None
        )

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        out: list[Row | str] = []
        for task in tasks:
            try:
                sets = fitted_sets(
                    self.flights[task.number], self.effects, self.starts, self.own[task.number]
                )
            except FlightidError as error:
                out.append(str(error))
                continue
            write_json(
                self.path(task.number),
                {"schema": SCHEMA, "digest": self.digest(task.number), **sets},
            )
            out.append({"flight": self.flights[task.number].name, "sets": len(sets["sets"])})
        return out


def fitted_sets(
    flight: SurveyFlight, names: Sequence[str], starts: Starts, own: Mapping[str, Starts]
) -> dict[str, Any]:
    """Return likelihood, estimates and covariance of a flight with each set of effects.

    For coloured residuals, the log likelihood is scaled by the share of independent samples, taken
    from the largest set. ``sets`` include the flight's ``own`` effects. ``sets_without`` include
    only effects of single flights, such as gusts, since a flight alone may claim one effect instead
    of two recurring ones.
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
    from scenarios.preparation.declared_model import step_for
    from scenarios.survey.recurring import is_of_flight

    request = flight.request()
    opened = opened_files(request, vehicle_path_of(request))
    prepared = loop_input_for(opened, request.plan)
    records = (*prepared.records, *prepared.predicted)
    by_name = {
        each.name: each
        for each in candidates_for(prepared.model, own_effects(request.effects, prepared.model)[0])
    }
    measured = {name for record in records for name in record.output_names}
    outputs = [item.name for item in prepared.model.equations.outputs if item.name in measured]
    data = FitData(records, measured_masks(records, outputs), prepared.model, outputs)
    settings = FitSettings(max_step=step_for(prepared.model, prepared.records, 0.01), enough=1e-6)
    able = [name for name in names if name in by_name]
    search = _EffectSetFits(
        data,
        settings,
        by_name,
        starts,
        {full: value for each in own.values() for full, value in each.items()},
    )
    beside = [name for name in own if name in by_name]
    remain = [name for name in beside if is_of_flight(name)]
    result = {True: search.sets(able, beside)} | (
        {False: search.sets(able, remain)} if remain != beside else {}
    )
    most = next((each for each in reversed(result[True].values()) if each is not None), None)
    share = (
        effective_share(most.fit.residuals, [problem.valid for problem in most.fit.layout.problems])
        if most is not None
        else 1.0
    )
    declared = [
        item.name
        for item in prepared.model.parameters
        if item.free and not item.name.startswith("bias_")
    ]
    units = {item.name: item.unit for item in prepared.model.parameters}
    local = {name: [item.name for item in by_name[name].parameters if item.free] for name in able}
    return {
        "declared": declared,
        "units": {name: units[name] for name in declared},
        "effects": {
            name: {
                "parameters": local[name],
                "units": _units(by_name[name]),
                "full": _full(by_name[name]),
            }
            for name in able
        },
        "independent": share,
        "own": [name for name in beside if name not in remain],
        **{
            key: {
                "+".join(sorted(taken)): _fit_content(
                    each, declared, [by_name[n] for n in sorted(taken)], share
                )
                for taken, each in result[own_in].items()
                if each
            }
            for key, own_in in (("sets", True), ("sets_without", False))
            if own_in in result
        },
    }


@dataclass(frozen=True, eq=False)
class _EffectSetFits:
    """Fits of one record with sets of effects, each started from the best smaller set."""

    data: FitData
    settings: FitSettings
    known: Mapping[str, Traceable]
    starts: Starts
    own: Starts

    def sets(
        self, names: Sequence[str], beside: Sequence[str]
    ) -> dict[frozenset[str], FittedModel | None]:
        """Return fits with every subset of ``names``, plus ``beside``; the full set last."""
        result: dict[frozenset[str], FittedModel | None] = {}
        for size in range(len(names) + 1):
            for chosen in combinations(names, size):
                sound = [
                    each
                    for name in chosen
                    if (each := result[frozenset(chosen) - {name}]) is not None
                ]
                start = min(sound, key=lambda each: each.fit.cost, default=None)
                result[frozenset(chosen)] = self.fitted([*beside, *chosen], start)
        return result

    def fitted(self, names: Sequence[str], start: FittedModel | None) -> FittedModel | None:
        from ident.tracing.fitted_model import fit_set, start_from

        return fit_set(
            self.data,
            [self.known[name] for name in names],
            self.settings,
            start_from(start, {**self.own, **self.starts}),
        )


def _units(effect: Traceable) -> dict[str, str]:
    return {item.name: item.unit for item in effect.parameters if item.free}


def _full(effect: Traceable) -> list[str]:
    from sim.declaration.effect import full_name

    return [full_name(effect, item.name) for item in effect.parameters if item.free]


def _fit_content(
    fitted: FittedModel, declared: Sequence[str], effects: Sequence[Traceable], share: float
) -> dict[str, Any]:
    """Estimates of the declared parameters and then of the effects', with their covariance."""
    from ident.statistics.intervals import inverse_information

    normal, _ = fitted.fit.normal_equations()
    covariance, _ = inverse_information(normal, fitted.fit.theta)
    places = {name: at for at, name in enumerate(fitted.fit.layout.names)}
    names = [*declared, *(full for effect in effects for full in _full(effect))]
    at = [places.get(name, places.get(f"{name}, record 1", -1)) for name in names]
    sound = np.array([place >= 0 for place in at])
    chosen = np.array([max(place, 0) for place in at], dtype=int)
    estimate = np.where(sound, fitted.fit.theta[chosen], 0.0)
    return {
        "log_likelihood": share * fitted.fit.log_likelihood,
        "names": names,
        "estimate": estimate,
        "covariance": np.where(
            np.outer(sound, sound), covariance[np.ix_(chosen, chosen)], 1e30 * np.eye(len(at))
        )
        / share,
    }


# ---- A survey's work as the workers of a cluster do it

FILES = "files"  # column with a flight's files, as a ZIP archive in text form
STUDY = "diagnosis.json"


@dataclass(frozen=True)
class Sent:
    """The same work for a cluster.

    ``work``: as this machine would do it, into its folder. ``place``: the current folder, from
    which paths are read. ``typed``: the words of the command line, which pages show. ``inputs``:
    files that are there, which every worker has to see at the same path.
    """

    work: Diagnoses | PooledFits
    place: Path
    typed: tuple[str, ...]
    inputs: tuple[Path, ...]

    @property
    def name(self) -> str:
        return self.work.name

    @property
    def block(self) -> int:
        return self.work.block

    @property
    def columns(self) -> Mapping[str, str]:
        return {**self.work.columns, FILES: "text"}

    def identity(self) -> Mapping[str, Any]:
        return self.work.identity()

    def unready(self) -> tuple[str, str] | None:
        """Why this machine cannot do the work, and the remedy; None if it can."""
        for path in self.inputs:
            if not (self.place / path).is_file():
                return (
                    f"the worker on {socket.gethostname()} does not see {self.place / path}",
                    "put the flights on a disk that every worker sees at the same path",
                )
        return None

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        """Each task in a temporary folder; its files are part of its row."""
        os.chdir(self.place)  # of a process that does this work alone
        sys.argv = list(self.typed)
        out: list[Row | str] = []
        for task in tasks:
            with TemporaryDirectory(prefix="flightid-") as scratch:
                own = Path(scratch) / FOLDER / self.work.flights[task.number].name
                own.mkdir(parents=True)
                (row,) = replace(self.work, folder=Path(scratch)).run([task])
                out.append(row if isinstance(row, str) else {**row, FILES: _packed(own)})
        return out

    def taken(self, row: Row) -> Row:
        """Write the files that came with a row into this machine's folder; the row without them.
        Raises FlightidError.
        """
        files = _unpacked(str(row[FILES]))
        folder = self.work.folder / FOLDER / str(row["flight"])
        if STUDY in files:
            # what it says is no longer of this folder
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
    """Return a survey's work, to be given to a cluster by this process."""
    files = {path: None for flight in work.flights for path in _inputs(flight) if path.is_file()}
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
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as files:
        for path in sorted(folder.iterdir()):
            files.write(path, path.name)
    return base64.b64encode(archive.getvalue()).decode("ascii")


def _unpacked(text: str) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(base64.b64decode(text))) as files:
        return {Path(each.filename).name: files.read(each) for each in files.infolist()}


# ---- A survey's folder that grows

MAIN = "survey.json"
GROWING_SCHEMA = "flightid/survey/1"
Tell = Callable[[str, float], None]


@dataclass(frozen=True)
class SurveyFiles:
    """The diagnoses of a survey's flights, and which of them are new.

    ``diagnoses``: content of each flight's diagnosis file by name of the flight, in the order of
    the survey file. ``computed``, ``failed`` (with the reason), ``removed`` since the last
    survey, ``before``: names of the flights that the last survey had.
    """

    diagnoses: Mapping[str, Mapping[str, Any]]
    flights: Mapping[str, SurveyFlight]
    computed: tuple[str, ...]
    failed: Mapping[str, str]
    removed: tuple[str, ...]
    before: frozenset[str]

    @property
    def new(self) -> tuple[str, ...]:
        """Flights that the last survey had not; none in the first one."""
        return (
            tuple(name for name in self.diagnoses if name not in self.before) if self.before else ()
        )


def survey_files(
    survey_flights: Flights,
    folder: Path,
    jobs: int = 1,
    figures: Formats = (),
    tell: Tell = lambda stage, share: None,
    cluster: str | None = None,
) -> SurveyFiles:
    """Diagnose the flights without results in the folder, and return all results.

    Runs in processes, or on the ``cluster`` at an address.

    Raises
    ------
    KeyboardInterrupt : Ctrl-C, with how many flights are kept.
    FlightidError : ``folder`` cannot be written.
    """
    before = last_survey(folder)
    missing = tuple(
        flight for flight in survey_flights.flights if kept_diagnosis(flight, folder) is None
    )
    failed: dict[str, str] = {}
    if missing:
        work = Diagnoses(missing, folder, figures)
        try:
            table = run_flights(work, len(missing), jobs, folder, tell, cluster)
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
    result = {flight.name: kept_diagnosis(flight, folder) for flight in survey_flights.flights}
    diagnoses = {name: content for name, content in result.items() if content is not None}
    for name in result:
        if name not in diagnoses and name not in failed:
            failed[name] = "nothing was kept of it"
    computed = tuple(flight.name for flight in missing if flight.name in diagnoses)
    had = frozenset(str(name) for name in before.get("flights", {}))
    removed = tuple(sorted(had - set(result)))
    return SurveyFiles(
        diagnoses,
        {f.name: replace(f) for f in survey_flights.flights},
        computed,
        failed,
        removed,
        had,
    )


def run_flights(
    work: Diagnoses | PooledFits,
    count: int,
    jobs: int,
    folder: Path,
    tell: Tell,
    cluster: str | None,
) -> RowTable:
    """Run a survey's work on ``count`` flights and return its rows. Raises as ``run_study``.

    Files of the flights are written into ``folder``.
    """
    task_request = TaskRequest(
        count, 0, max(1, min(jobs, count)), cluster=cluster, unit="flights", elsewhere=folder
    )
    if cluster is None:
        return run_study(work, task_request, tell)

    return run_study(sent(work), task_request, tell)


def last_survey(folder: Path) -> Mapping[str, Any]:
    """Return the document of the last survey in a folder; empty if there is none."""
    content = json_or_none(folder / MAIN)
    return (
        content
        if isinstance(content, dict)
        and content.get("schema") == GROWING_SCHEMA
        and isinstance(content.get("flights"), dict)
        else {}
    )
