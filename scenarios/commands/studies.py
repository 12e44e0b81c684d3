"""Work of the commands on simulated studies: run, simulate, campaign, compare, design, report."""

from __future__ import annotations

import shlex
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.api.requests import LOADERS, Progress, Runner, flown_record
from scenarios.files.declarations import named_after
from scenarios.files.user_models import AIRCRAFT_SUFFIX
from scenarios.files.writing import write_text
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
from sim.errors import DeclarationError, FlightidError

if TYPE_CHECKING:
    from scenarios.trials.planted.declaration import TraceScenario
    from scenarios.trials.planted.own_flight import OwnFlight


# ---- flightid compare, and flightid run --compare


def compare_studies(
    studies: Sequence[str], out: Path | None, every: bool, figures: Formats
) -> None:
    """Compare studies, read from their folders: print the tables, and write them with figures if a
    folder is named.

    Raises
    ------
    DeclarationError : what is named is no study, or the studies share no parameter.
    """
    from scenarios.side_by_side.comparison import compare_columns, read_columns
    from scenarios.side_by_side.report import print_compared

    compared = compare_columns(read_columns(studies, every))
    if out is not None:
        from scenarios.side_by_side.report import write_compared

        write_compared(compared, out, figures=figures)
    print_compared(compared)
    if out is not None:
        print(written_to(out))


# ---- flightid simulate of flights by JSBSim


def simulate_jsbsim(name: str, out: Path, seed: int | None, changes: Sequence[str]) -> list[Path]:
    """Write record, vehicle files for suitable models, and truth; return the files."""
    from scenarios.files.writing import files_together
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.trials.jsbsim.flight import fly_jsbsim, jsbsim_of, write_jsbsim

    flight = jsbsim_of(*load_document(name, changes))
    chosen = flight.seed if seed is None else seed
    with named_after(scenario_file(name)):
        record, truth = fly_jsbsim(flight, chosen)
    with files_together(out) as scratch:
        made, truth_file = write_jsbsim(flight, chosen, record, truth, scratch, out.stem)
    vehicles = {model: out.parent / path.name for model, path in made.items()}
    kept = out.parent / truth_file.name
    print(
        f"{flight.aircraft} flown by JSBSim: {len(record)} samples, {record.time[-1]:g} s, "
        f"{flight.maneuver}; the truth is in {kept.name}"
    )
    for model, vehicle in vehicles.items():
        print(f"flightid identify {out} --model {model} --vehicle {vehicle}")
    return [out, *vehicles.values(), kept]


# ---- flightid simulate and campaign of tracing scenarios, simulate of users' own models


def simulate_trace(name: str, out: Path, seed: int | None, changes: Sequence[str]) -> list[Path]:
    """Write the records and vehicle file of a tracing scenario; return the files."""
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.trials.planted.flights import trace_scenario_of

    return _write(trace_scenario_of(*load_document(name, changes)), scenario_file(name), out, seed)


def simulate_own(
    asked: OwnFlight, out: Path, seed: int | None, changes: Sequence[str]
) -> list[Path]:
    """Write the records and vehicle file of a user's model in a flight; return the files."""
    from scenarios.studies.catalogue import with_changes
    from scenarios.trials.planted.flights import trace_scenario_of
    from scenarios.trials.planted.own_flight import trace_document

    document = with_changes(trace_document(asked), changes)
    return _write(
        trace_scenario_of(document, Path(asked.model).stem, asked.model), asked.model, out, seed
    )


def _write(scenario: TraceScenario, file: str, out: Path, seed: int | None) -> list[Path]:
    """Write both records and the vehicle file, without the truth; return the files.

    ``file``: declares the scenario. A requested ``record.csv`` is the training record, next to
    ``record_validate.csv`` and ``record_vehicle.toml``.
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
    """Run scenarios one after the other; several get separate folders under ``out``.

    ``print_folder``: print the folder. ``progress``: show progress. After Ctrl-C, finished studies
    remain.
    """
    from scenarios.studies.catalogue import scenario_kind

    shorts = [Path(name).stem if name.endswith(".toml") else name for name in names]
    kinds = [scenario_kind(name) for name in names]
    _refuse_same_names(shorts)
    runners = [LOADERS[kind](name, changes) for name, kind in zip(names, kinds, strict=True)]
    folders = [
        None if out is None else out if len(runners) == 1 else out / short for short in shorts
    ]
    started = time.monotonic()
    for done, (name, folder, runner) in enumerate(zip(names, folders, runners, strict=True)):
        try:
            with progress_bar(
                progress, counted=runner.counted, before=(done, len(names), started)
            ) as tell:
                tell(name, 0.0)
                study = _studied(runner, name, seed, folder, figures, tell)
        except KeyboardInterrupt as stopped:
            raise KeyboardInterrupt(
                "; ".join(
                    filter(None, (str(stopped), _kept(folders[:done], len(names), print_folder)))
                )
            ) from None
        runner.show(study, details_in(folder if print_folder else None))
        if folder is not None and print_folder:
            print(written_to(folder))


def _kept(folders: Sequence[Path | None], of: int, print_folder: bool) -> str:
    """Return a sentence on the results that remain if ``run`` is stopped; empty if there are
    none.
    """
    if not folders or not print_folder:
        return ""
    written = [str(folder) for folder in folders if folder is not None]
    return (
        f"{len(folders)} of {of} studies are "
        f"finished{': ' + ', '.join(written) if written else ', and printed above'}"
    )


def _studied(
    runner: Runner,
    name: str,
    seed: int | None,
    folder: Path | None,
    figures: Formats,
    tell: Progress,
) -> Any:
    """Run a scenario, write it if a folder is named, and return the study."""
    from scenarios.studies.catalogue import scenario_file

    with named_after(scenario_file(name)):
        study = runner.run(seed, tell)
    if folder is not None:
        runner.write(study, folder, figures=figures)
    return study


def documents_of(names: Sequence[str], compare: bool) -> list[str]:
    """Return the paths of the JSON documents that ``run`` writes, relative to its folder: one for a
    comparison, else one a study.
    """
    if compare:
        return ["compared.json"]
    return (
        ["comparison.json"]
        if len(names) == 1
        else [
            f"{Path(name).stem if name.endswith('.toml') else name}/comparison.json"
            for name in names
        ]
    )


def run_and_compare(
    names: Sequence[str],
    seed: int | None,
    out: Path | None,
    changes: Sequence[str],
    figures: Formats,
    *,
    progress: bool = True,
) -> None:
    """Run scenarios as ``run_scenarios``, then put their study folders side by side; without
    ``out`` these are gone afterwards.
    """
    from tempfile import TemporaryDirectory

    shorts = [Path(name).stem if name.endswith(".toml") else name for name in names]
    if len(shorts) < 2:
        raise DeclarationError(
            "one scenario has nothing beside it",
            where="flightid run --compare",
            remedy="name at least two",
        )
    if out is not None:
        run_scenarios(names, seed, out, changes, figures, progress=progress)
        print()
        compare_studies([str(out / short) for short in shorts], out, False, figures)
        return
    with TemporaryDirectory(prefix="flightid-") as scratch:
        run_scenarios(
            names, seed, Path(scratch), changes, (), print_folder=False, progress=progress
        )
        print()
        compare_studies([str(Path(scratch) / short) for short in shorts], None, False, ())


def simulate(
    what: str | OwnFlight, out: Path, seed: int | None, changes: Sequence[str]
) -> list[Path]:
    """Write the record of a scenario, or of a flight of a user's own model, without the truth;
    return the files.
    """
    from scenarios.files.writing import files_together, write_record
    from scenarios.studies.catalogue import scenario_kind

    if out.suffix != ".csv":
        raise DeclarationError(
            f"{out.suffix or 'no'} ending", where=str(out), remedy="name a .csv file"
        )
    try:
        if not isinstance(what, str):
            return simulate_own(what, out, seed, changes)
        write_flight = {"trace": simulate_trace, "jsbsim": simulate_jsbsim}.get(scenario_kind(what))
        if write_flight is not None:
            return write_flight(what, out, seed, changes)
        record = flown_record(what, seed, changes)
        vehicle_name = _flown_vehicle(what)
        vehicle = out.parent / f"{out.stem}_vehicle.toml"
        own = vehicle_name.endswith(AIRCRAFT_SUFFIX)  # a file, which goes with the record
        with files_together(out) as scratch:
            written = write_record(scratch, record, out.stem, simulated=True)
            if own:
                write_text(scratch / vehicle.name, Path(vehicle_name).read_text(encoding="utf-8"))
        if own:
            command = ["identify", str(out), "--model", "aircraft", "--vehicle", str(vehicle)]
            print(f"written: {out.name} and {vehicle.name} (for --vehicle), with true values")
            print(f"next: flightid {shlex.join(command)}")
        else:
            words = (
                f"; --vehicle {vehicle_name} names its vehicle, with true values"
                if vehicle_name
                else ""
            )
            print(f"written: {out.name}{words}")
        return [*(out.parent / path.name for path in written), *([vehicle] if own else [])]
    except OSError as error:
        raise FlightidError(
            f"cannot be written ({error.strerror})",
            where=str(out),
            remedy="name a file that you may write",
        ) from None


def _flown_vehicle(name: str) -> str:
    """Return the vehicle of a scenario of identification: a name of the library, or the path of an
    aircraft's file; empty for other scenarios, and for a model of one's own.
    """
    from scenarios.studies.catalogue import IDENTIFICATION, load_scenario, scenario_kind

    if scenario_kind(name) != IDENTIFICATION:
        return ""
    vehicle = load_scenario(name).flight.vehicle
    own = vehicle.endswith(".py")  # a model, whose values are in the scenario
    return "" if own else vehicle


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


# ---- flightid campaign: Monte Carlo, printed and written


def own_campaign(
    asked: OwnFlight,
    runs: int,
    seed: int | None,
    execution: Execution,
    changes: Sequence[str],
    figures: Formats = USUAL,
    *,
    levels: bool = False,
    progress: bool = True,
) -> None:
    """Run a campaign as ``run_campaign``, of a user's model in a flight that the command line
    describes.
    """
    from scenarios.studies.catalogue import with_changes
    from scenarios.studies.reading import scenario_of
    from scenarios.trials.planted.own_flight import study_document

    rebuilt_scenario = Rebuilt(
        with_changes(study_document(asked), changes), Path(asked.model).stem, asked.model
    )
    scenario = scenario_of(rebuilt_scenario.document, rebuilt_scenario.name, rebuilt_scenario.where)
    _run(
        scenario, rebuilt_scenario, runs, seed, execution, figures, levels=levels, progress=progress
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
    """Run a campaign of a scenario of estimators by one ``method``, print it, and write
    ``campaign.json`` and the runs into ``execution.out``.

    ``method``: the main one of the scenario when None. ``levels``: noise levels by likelihood even
    where no sigma is wrong. ``progress``: show progress. After Ctrl-C, the runs that had ended are
    printed and written.
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
    document, short, where = load_document(name, changes)
    rebuilt_scenario = Rebuilt(
        {key: value for key, value in document.items() if key != "kind"}, short, where
    )
    _run(
        load_scenario(name, changes),
        rebuilt_scenario,
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


def _run(
    scenario: Scenario,
    rebuilt_scenario: Rebuilt,
    runs: int,
    seed: int | None,
    execution: Execution,
    figures: Formats,
    method: str = "main",
    *,
    levels: bool = False,
    progress: bool = True,
) -> None:
    with named_after(rebuilt_scenario.where), progress_bar(progress) as tell:
        campaign = fly_campaign(scenario, runs, seed, method, tell, execution, rebuilt_scenario)
        judgement, ended = _assessed(campaign, levels, tell)
    out = execution.out
    print_campaign(campaign, details=details_in(out), judgement=judgement)
    if out is not None:
        write_campaign(campaign, judgement, out, figures=figures)
        print(written_to(out))
    if len(campaign.seeds) < campaign.asked:
        raise stopped(len(campaign.seeds), campaign.asked, "runs", out)
    if not ended:
        raise KeyboardInterrupt(
            "all runs had ended; why sigmas are wrong was not looked for to the end"
        )


def _assessed(
    campaign: CampaignRuns, levels: bool, tell: CampaignProgress
) -> tuple[Judgement, bool]:
    """Return the judgement of the runs; a stopped campaign has no causes. The bool is False if
    Ctrl-C ended the search for causes.
    """
    whole = len(campaign.seeds) == campaign.asked
    tell("whether the sigmas are right, and why not", 1.0)
    try:
        return judge(campaign, causes=whole, levels=levels), True
    except KeyboardInterrupt:
        return judge(campaign, causes=False), False


# ---- flightid design: which maneuver to fly, printed and written


def design_maneuver(
    asked: DesignRequest, out: Path | None, figures: Formats, *, progress: bool = True
) -> None:
    """Design a maneuver, write and print it; ``progress``: show progress."""
    from scenarios.maneuver_design.design import design
    from scenarios.maneuver_design.report import design_text
    from scenarios.report.summary import terminal_width

    with progress_bar(progress) as tell:
        found = design(asked, tell)
        if out is not None:
            from scenarios.maneuver_design.report import write_design

            write_design(found, out, figures=figures)
    print(design_text(found, terminal_width(), details_in(out)), end="")
    if out is not None:
        print(written_to(out))


# ---- flightid report: pages remade from their folders


def rebuild_pages(folders: Sequence[Path], *, tables: bool = False, pdf: bool = False) -> None:
    """Make ``report.html`` of each folder again and say where it is; ``tables``: write
    its tables as Markdown, LaTeX and XLSX as well; ``pdf``: print it as ``report.pdf``.

    Raises FlightidError for the first folder that has no content of a page.
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

            print(f"PDF: {write_pdf(folder)}")
