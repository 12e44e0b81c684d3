"""Commands on simulated studies: run, simulate, campaign, compare, design, report."""

from __future__ import annotations

import shlex
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.api.requests import LOADERS, Progress, Runner, flown_record
from scenarios.files.declarations import named_after
from scenarios.files.user_models import AIRCRAFT_SUFFIX
from scenarios.files.writing import unwritable, write_text
from scenarios.maneuver_design.setting import DesignRequest
from scenarios.report.figure_formats import USUAL, Formats
from scenarios.report.summary import details_in, written_to
from scenarios.report.terminal import progress_bar
from scenarios.studies.campaign import CampaignRuns, Rebuilt, fly_campaign
from scenarios.studies.campaign import Progress as CampaignProgress
from scenarios.studies.campaign_causes import Judgement, judge
from scenarios.studies.campaign_report import print_campaign
from scenarios.studies.declaration import Scenario
from scenarios.studies.folder import write_campaign
from scenarios.tasks.study import Execution, stopped
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.trials.planted.declaration import TraceScenario
    from scenarios.trials.planted.own_flight import OwnFlight


# ---- flightid compare, and flightid run --compare


def compare_studies(
    studies: Sequence[str], out: Path | None, all_methods: bool, figures: Formats
) -> None:
    """Compare studies side by side, print the tables and write them into ``out``.

    Parameters
    ----------
    studies : folders of the studies.
    out : folder of the comparison; None writes nothing.
    all_methods : show all methods of each study, not only its main one.
    figures : formats of the figures.

    Raises
    ------
    DeclarationError : a folder holds no study, or the studies share no parameter.
    """
    from scenarios.side_by_side import compare_columns, read_columns
    from scenarios.side_by_side_report import print_compared

    compared = compare_columns(read_columns(studies, all_methods))
    if out is not None:
        from scenarios.side_by_side_report import write_compared

        write_compared(compared, out, figures=figures)
    print_compared(compared)
    if out is not None:
        print(written_to(out))


# ---- flightid simulate: flights by JSBSim


def simulate_jsbsim(name: str, out: Path, seed: int | None, changes: Sequence[str]) -> list[Path]:
    """Write record, vehicle files and true values of a flight by JSBSim; return the files."""
    from scenarios.files.writing import files_together
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.trials.jsbsim.flight import fly_jsbsim, jsbsim_of, write_jsbsim

    flight = jsbsim_of(*load_document(name, changes))
    if seed is None:
        seed = flight.seed
    with named_after(scenario_file(name)):
        record, truth = fly_jsbsim(flight, seed)
    with files_together(out) as scratch:
        scratch_vehicles, scratch_truth = write_jsbsim(
            flight, seed, record, truth, scratch, out.stem
        )
    vehicles = {model: out.parent / path.name for model, path in scratch_vehicles.items()}
    truth_file = out.parent / scratch_truth.name
    print(
        f"{flight.aircraft} flown by JSBSim: {len(record)} samples, {record.time[-1]:g} s, "
        f"{flight.maneuver}; true values are in {truth_file.name}"
    )
    for model, vehicle in vehicles.items():
        print(f"flightid identify {out} --model {model} --vehicle {vehicle}")
    return [out, *vehicles.values(), truth_file]


# ---- flightid simulate: tracing scenarios and users' own models


def simulate_trace(name: str, out: Path, seed: int | None, changes: Sequence[str]) -> list[Path]:
    """Write the records and vehicle file of a tracing scenario; return the files."""
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.trials.planted.flights import trace_scenario_of

    return _write_trace(
        trace_scenario_of(*load_document(name, changes)), scenario_file(name), out, seed
    )


def simulate_own(
    flight: OwnFlight, out: Path, seed: int | None, changes: Sequence[str]
) -> list[Path]:
    """Write the records and vehicle file of a flight of a user's model; return the files."""
    from scenarios.studies.catalogue import with_changes
    from scenarios.trials.planted.flights import trace_scenario_of
    from scenarios.trials.planted.own_flight import trace_document

    document = with_changes(trace_document(flight), changes)
    scenario = trace_scenario_of(document, Path(flight.model).stem, flight.model)
    return _write_trace(scenario, flight.model, out, seed)


def _write_trace(scenario: TraceScenario, file: str, out: Path, seed: int | None) -> list[Path]:
    """Write both records and the vehicle file of a tracing scenario; return the files.

    True values are not written. If ``out`` is ``record.csv``, it holds the record to fit; the
    second record is ``record_validate.csv`` and the vehicle file ``record_vehicle.toml``, in the
    same folder. ``file`` declares the scenario; errors name it.
    """
    from scenarios.files.writing import files_together, write_record
    from scenarios.trials.planted.flights import fly_trace

    with named_after(file):
        flown = fly_trace(scenario, scenario.seed if seed is None else seed)
    vehicle = out.parent / f"{out.stem}_vehicle.toml"
    with files_together(out) as scratch:
        paths = [
            *write_record(scratch, flown.train, out.stem, simulated=True),
            *write_record(scratch, flown.validate, f"{out.stem}_validate", simulated=True),
        ]
        write_text(scratch / vehicle.name, flown.vehicle_file)
    written = [out.parent / path.name for path in paths]
    print(
        f"written: {out.name}, {out.stem}_validate.csv (a second flight, for --validate) and "
        f"{vehicle.name} (for --vehicle)"
    )
    return [*written, vehicle]


# ---- flightid run and flightid simulate


def run_scenarios(
    names: Sequence[str],
    seed: int | None,
    out: Path | None,
    changes: Sequence[str],
    figures: Formats,
    *,
    print_folder: bool = True,
    progress: bool = True,
) -> None:
    """Run scenarios one after the other, and write their studies.

    Parameters
    ----------
    names : scenarios of the catalogue, or paths of TOML files.
    seed : seed of the noise; None takes that of each scenario.
    out : folder of the study; several studies get folders in it; None writes nothing.
    changes : changes of the scenario files, as ``"KEY=VALUE"``.
    figures : formats of the figures.
    print_folder : print where the studies were written.
    progress : show a progress bar.

    After Ctrl-C, finished studies remain.
    """
    from scenarios.studies.catalogue import scenario_kind

    short_names = [_short_name(name) for name in names]
    kinds = [scenario_kind(name) for name in names]
    _refuse_same_names(short_names)
    runners = [LOADERS[kind](name, changes) for name, kind in zip(names, kinds, strict=True)]
    folders: list[Path | None] = [None] * len(names)
    if out is not None:
        folders = [out] if len(names) == 1 else [out / short for short in short_names]
    started = time.monotonic()
    for done, (name, folder, runner) in enumerate(zip(names, folders, runners, strict=True)):
        try:
            with progress_bar(
                progress, counted=runner.counted, before=(done, len(names), started)
            ) as show_progress:
                show_progress(name, 0.0)
                study = _run_and_write(runner, name, seed, folder, figures, show_progress)
        except KeyboardInterrupt as interrupt:
            finished = ""
            if print_folder:
                finished = _finished_sentence(folders[:done], len(names))
            sentences = [text for text in (str(interrupt), finished) if text]
            raise KeyboardInterrupt("; ".join(sentences)) from None
        runner.show(study, details_in(folder if print_folder else None))
        if folder is not None and print_folder:
            print(written_to(folder))


def _short_name(name: str) -> str:
    """Return the name of a scenario, or the stem of its file."""
    return Path(name).stem if name.endswith(".toml") else name


def _finished_sentence(folders: Sequence[Path | None], total: int) -> str:
    """Return a sentence on the studies that are finished when ``run`` is stopped; empty if none is.

    Parameters
    ----------
    folders : folder of each finished study; None for a study that is not written.
    total : number of all studies.
    """
    if not folders:
        return ""
    written = [str(folder) for folder in folders if folder is not None]
    where = f": {', '.join(written)}" if written else ", and printed above"
    return f"{len(folders)} of {total} studies are finished{where}"


def _run_and_write(
    runner: Runner,
    name: str,
    seed: int | None,
    folder: Path | None,
    figures: Formats,
    progress: Progress,
) -> Any:
    """Run a scenario, write its study if a folder is named, and return the study."""
    from scenarios.studies.catalogue import scenario_file

    with named_after(scenario_file(name)):
        study = runner.run(seed, progress)
    if folder is not None:
        runner.write(study, folder, figures=figures)
    return study


def documents_of(names: Sequence[str], compare: bool) -> list[str]:
    """Return the paths of the JSON documents that ``run`` writes, relative to its folder.

    A comparison has one document, else each study has one.
    """
    if compare:
        return ["compared.json"]
    if len(names) == 1:
        return ["comparison.json"]
    return [f"{_short_name(name)}/comparison.json" for name in names]


def run_and_compare(
    names: Sequence[str],
    seed: int | None,
    out: Path | None,
    changes: Sequence[str],
    figures: Formats,
    *,
    progress: bool = True,
) -> None:
    """Run scenarios as ``run_scenarios``, and compare their studies.

    If ``out`` is None, the studies are in a temporary folder, which is deleted.
    """
    from tempfile import TemporaryDirectory

    short_names = [_short_name(name) for name in names]
    if len(names) < 2:
        raise DeclarationError(
            "a single scenario cannot be compared",
            where="flightid run --compare",
            remedy="name at least two",
        )
    if out is not None:
        run_scenarios(names, seed, out, changes, figures, progress=progress)
        print()
        compare_studies([str(out / short) for short in short_names], out, False, figures)
        return
    with TemporaryDirectory(prefix="flightid-") as scratch:
        run_scenarios(
            names, seed, Path(scratch), changes, (), print_folder=False, progress=progress
        )
        print()
        folders = [str(Path(scratch) / short) for short in short_names]
        compare_studies(folders, None, False, ())


def simulate(
    flight: str | OwnFlight, out: Path, seed: int | None, changes: Sequence[str]
) -> list[Path]:
    """Write the record of a scenario, or of a flight of a user's own model; return the files.

    True values are not written.
    """
    from scenarios.files.writing import files_together, write_record
    from scenarios.studies.catalogue import scenario_kind

    if out.suffix != ".csv":
        raise DeclarationError(
            f"{out.suffix or 'no'} ending", where=str(out), remedy="name a .csv file"
        )
    try:
        if not isinstance(flight, str):
            return simulate_own(flight, out, seed, changes)
        kind = scenario_kind(flight)
        if kind == "trace":
            return simulate_trace(flight, out, seed, changes)
        if kind == "jsbsim":
            return simulate_jsbsim(flight, out, seed, changes)
        record = flown_record(flight, seed, changes)
        vehicle_name = _vehicle_of(flight)
        vehicle = out.parent / f"{out.stem}_vehicle.toml"
        has_file = vehicle_name.endswith(AIRCRAFT_SUFFIX)  # the file is copied beside the record
        with files_together(out) as scratch:
            written = write_record(scratch, record, out.stem, simulated=True)
            if has_file:
                write_text(scratch / vehicle.name, Path(vehicle_name).read_text(encoding="utf-8"))
        paths = [out.parent / path.name for path in written]
        if has_file:
            command = ["identify", str(out), "--model", "aircraft", "--vehicle", str(vehicle)]
            print(f"written: {out.name} and {vehicle.name} (for --vehicle), with true values")
            print(f"next: flightid {shlex.join(command)}")
            return [*paths, vehicle]
        hint = ""
        if vehicle_name:
            hint = f"; its vehicle, with true values, is --vehicle {vehicle_name}"
        print(f"written: {out.name}{hint}")
        return paths
    except OSError as error:
        raise unwritable(out, error, "name a file that you may write") from None


def _vehicle_of(name: str) -> str:
    """Return the vehicle of a scenario of identification, as ``--vehicle`` takes it.

    It is a name of the library, or the path of an aircraft file. The text is empty for other
    scenarios and for a user's model.
    """
    from scenarios.studies.catalogue import IDENTIFICATION, load_scenario, scenario_kind

    if scenario_kind(name) != IDENTIFICATION:
        return ""
    vehicle = load_scenario(name).flight.vehicle
    if vehicle.endswith(".py"):
        return ""  # a user's own model; the scenario has its values
    return vehicle


def files_text(files: Sequence[Path]) -> str:
    """Return JSON with the files that ``simulate`` wrote."""
    from scenarios.files.writing import json_text

    return json_text({"schema": "flightid/simulated/1", "files": [str(path) for path in files]})


def _refuse_same_names(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise DeclarationError(
                f"{name} is named twice", where="flightid run", remedy="name each scenario once"
            )


# ---- flightid campaign: Monte Carlo simulation


def own_campaign(
    flight: OwnFlight,
    runs: int,
    seed: int | None,
    execution: Execution,
    changes: Sequence[str],
    figures: Formats = USUAL,
    *,
    levels: bool = False,
    progress: bool = True,
) -> None:
    """Run a campaign of a user's model, as ``run_campaign`` does for a scenario.

    ``flight`` is the flight of the user's model, as the options of the command describe it.
    """
    from scenarios.studies.catalogue import with_changes
    from scenarios.studies.reading import scenario_of
    from scenarios.trials.planted.own_flight import study_document

    document = with_changes(study_document(flight), changes)
    rebuilt = Rebuilt(document, Path(flight.model).stem, flight.model)
    scenario = scenario_of(rebuilt.document, rebuilt.name, rebuilt.where)
    _run_campaign(
        scenario, rebuilt, runs, seed, execution, figures, levels=levels, progress=progress
    )


def run_campaign(
    name: str,
    runs: int,
    seed: int | None,
    execution: Execution,
    changes: Sequence[str],
    method: str | None = None,
    figures: Formats = USUAL,
    *,
    levels: bool = False,
    progress: bool = True,
) -> None:
    """Run a campaign of a scenario of identification, print it and write it.

    Parameters
    ----------
    name : the scenario.
    runs : number of runs.
    seed : seed of the first run; None takes that of the scenario.
    execution : where the runs are computed and written.
    changes : changes of the scenario file, as ``"KEY=VALUE"``.
    method : the estimator; None takes the main one of the scenario.
    figures : formats of the figures.
    levels : estimate noise levels by likelihood, even if all reported sigmas are right.
    progress : show a progress bar.

    After Ctrl-C, the finished runs are printed and written.
    """
    from scenarios.studies.catalogue import (
        IDENTIFICATION,
        load_document,
        load_scenario,
        moved,
        scenario_kind,
    )

    kind = scenario_kind(name)
    if kind == "trace":
        raise moved(f"a campaign of {name}", f"hidden-effects {name}")
    if kind != IDENTIFICATION:
        what = f"there is no campaign of a scenario of kind {kind}"
        raise DeclarationError(what, where=name, remedy="name a scenario of estimators")
    document, short_name, where = load_document(name, changes)
    rebuilt = Rebuilt(
        {key: value for key, value in document.items() if key != "kind"}, short_name, where
    )
    _run_campaign(
        load_scenario(name, changes),
        rebuilt,
        runs,
        seed,
        execution,
        figures,
        method or "main",
        levels=levels,
        progress=progress,
    )


def refuse_method(method: str | None) -> None:
    """Raise DeclarationError if a method is named for a campaign that has only one."""
    if method is not None:
        raise DeclarationError(
            "this campaign has no methods to choose from", where="--method", remedy="leave it out"
        )


def _run_campaign(
    scenario: Scenario,
    rebuilt: Rebuilt,
    runs: int,
    seed: int | None,
    execution: Execution,
    figures: Formats,
    method: str = "main",
    *,
    levels: bool = False,
    progress: bool = True,
) -> None:
    """Run a campaign, print it and write it; the parameters are those of ``run_campaign``.

    ``rebuilt`` is the document of the scenario, from which other processes build it again.
    """
    with named_after(rebuilt.where), progress_bar(progress) as show_progress:
        campaign = fly_campaign(scenario, runs, seed, method, show_progress, execution, rebuilt)
        judgement, complete = _judgement_of(campaign, levels, show_progress)
    out = execution.out
    print_campaign(campaign, details=details_in(out), judgement=judgement)
    if out is not None:
        write_campaign(campaign, judgement, out, figures=figures)
        print(written_to(out))
    if len(campaign.seeds) < campaign.asked:
        raise stopped(len(campaign.seeds), campaign.asked, "runs", out)
    if not complete:
        raise KeyboardInterrupt(
            "all runs had ended; the search for causes of wrong sigmas was not complete"
        )


def _judgement_of(
    campaign: CampaignRuns, levels: bool, progress: CampaignProgress
) -> tuple[Judgement, bool]:
    """Return the judgement of the sigmas, and whether the search for causes was complete.

    A stopped campaign has no causes. Ctrl-C also stops the search for causes.
    """
    all_runs = len(campaign.seeds) == campaign.asked
    progress("checking the sigmas", 1.0)
    try:
        return judge(campaign, causes=all_runs, levels=levels), True
    except KeyboardInterrupt:
        return judge(campaign, causes=False), False


# ---- flightid design: the maneuver to fly


def design_maneuver(
    request: DesignRequest, out: Path | None, figures: Formats, *, progress: bool = True
) -> None:
    """Design a maneuver, write it into ``out`` and print it.

    ``progress`` : whether a progress bar is shown.
    """
    from scenarios.maneuver_design.design import design
    from scenarios.maneuver_design.report import design_text
    from scenarios.report.summary import terminal_width

    with progress_bar(progress) as show_progress:
        result = design(request, show_progress)
        if out is not None:
            from scenarios.maneuver_design.report import write_design

            write_design(result, out, figures=figures)
    print(design_text(result, terminal_width(), details_in(out)), end="")
    if out is not None:
        print(written_to(out))


# ---- flightid report: pages of study folders, written again


def rebuild_pages(
    folders: Sequence[Path], *, tables: bool = False, pdf: bool = False, paper: str = "a4"
) -> None:
    """Write ``report.html`` of each folder again.

    Parameters
    ----------
    folders : study folders.
    tables : also write the tables as Markdown, LaTeX and XLSX.
    pdf : also write the page as ``report.pdf``.
    paper : its paper, ``a4`` or ``letter``.

    Raises
    ------
    FlightidError : a folder has no content of a page, or there is no such paper.
    """
    from scenarios.report.folder import rebuilt, stored_page

    for folder in folders:
        print(f"written to {rebuilt(folder)}")
        if tables:
            from scenarios.report.folder import write_tables

            files = write_tables(stored_page(folder), folder)
            print(f"tables: {', '.join(map(str, files))}")
        if pdf:
            from scenarios.report.folder import write_pdf

            print(f"PDF: {write_pdf(folder, paper)}")
