"""`flightid run` and `flightid simulate`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from scenarios.commands.failures import named_after
from scenarios.commands.jsbsim import simulate_jsbsim
from scenarios.commands.planted import simulate_own, simulate_trace
from scenarios.commands.standin import simulate_standin
from scenarios.plots.formats import Formats
from sim.errors import DeclarationError, FlightidError

if TYPE_CHECKING:
    from scenarios.trials.planted.own_flight import OwnFlight
    from sim.record import Record

Progress = Callable[[str, float], None]


class Write(Protocol):
    """Writes a study into a folder, whole or not at all."""

    def __call__(self, study: Any, folder: Path, /, *, figures: Formats) -> object: ...


@dataclass(frozen=True)
class Runner:
    """A scenario that is loaded: how it is run with a seed (None: its own), written into a folder with figures of some formats, and printed.

    ``page``: its folder holds a page to begin with. ``bar``: it takes long enough for a bar of progress, as all that make a page do.
    """

    run: Callable[[int | None, Progress], Any]
    write: Write
    show: Callable[[Any], None]
    page: bool = False
    bar: bool = False


def run_scenarios(names: Sequence[str], seed: int | None, out: Path | None, changes: Sequence[str], figures: Formats, *, told: bool = True) -> None:
    """Run scenarios one after the other; with several, each gets a folder of its own under ``out``, which is printed if ``told``."""
    from scenarios.studies.catalogue import scenario_kind

    shorts = [Path(name).stem if name.endswith(".toml") else name for name in names]
    kinds = [scenario_kind(name) for name in names]
    _refuse_same_names(shorts)
    runners = [_LOADERS[kind](name, changes) for name, kind in zip(names, kinds, strict=True)]
    for name, short, runner in zip(names, shorts, runners, strict=True):
        _run(runner, name, seed, None if out is None else out if len(runners) == 1 else out / short, figures, told)


def run_and_compare(names: Sequence[str], seed: int | None, out: Path | None, changes: Sequence[str], figures: Formats) -> None:
    """Run scenarios as ``run_scenarios``, then put their study folders side by side; without ``out`` these are gone afterwards."""
    from tempfile import TemporaryDirectory

    from scenarios.commands.compare import compare_studies

    shorts = [Path(name).stem if name.endswith(".toml") else name for name in names]
    if len(shorts) < 2:
        raise DeclarationError("one scenario has nothing beside it", where="flightid run --compare", remedy="name at least two")
    if out is not None:
        run_scenarios(names, seed, out, changes, figures)
        print()
        compare_studies([str(out / short) for short in shorts], out, False, figures)
        return
    with TemporaryDirectory(prefix="flightid-") as scratch:
        run_scenarios(names, seed, Path(scratch), changes, (), told=False)
        print()
        compare_studies([str(Path(scratch) / short) for short in shorts], None, False, ())


def _run(runner: Runner, name: str, seed: int | None, folder: Path | None, figures: Formats, told: bool) -> None:
    """Run, write where a folder is named, print, and say where it was written if ``told``."""
    from scenarios.studies.catalogue import scenario_file
    from scenarios.terminal.progress import progress_bar

    with named_after(scenario_file(name)), progress_bar() if runner.page or runner.bar else nullcontext(_untold) as progress:
        study = runner.run(seed, progress)
    if folder is not None:
        runner.write(study, folder, figures=figures)
    runner.show(study)
    if folder is not None and told:
        print(f"written to {folder}; begin with {folder / 'report.html'}" if runner.page else f"written to {folder}")


def _untold(stage: str, share: float) -> None:
    """Progress of what is done before a bar could be read."""


def _identification(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.studies.catalogue import load_scenario
    from scenarios.studies.comparison import check_display
    from scenarios.studies.files import write_study
    from scenarios.studies.repeated import fly_repeatedly
    from scenarios.studies.study import Study, run_scenario
    from scenarios.studies.sweep.sweep import sweep_flexibility
    from scenarios.studies.text import print_study

    scenario = load_scenario(name, changes)

    def run(seed: int | None, progress: Progress) -> Study:
        study = run_scenario(scenario, seed)
        check_display(study)
        sweep = sweep_flexibility(scenario, study.record, study.truth, study.seed, progress)
        return replace(study, repeated=fly_repeatedly(scenario, seed, progress), sweep=sweep)

    return Runner(run, write_study, print_study, bar=scenario.repeated is not None or scenario.sweep is not None)


def _trace(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.planted.files import write_trace
    from scenarios.trials.planted.schema import trace_scenario_of
    from scenarios.trials.planted.study import run_trace
    from scenarios.trials.planted.text import trace_text

    run = partial(run_trace, trace_scenario_of(*load_document(name, changes)))
    return Runner(run, write_trace, _printed(trace_text), page=True)


def _standin(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.standin.files import write_standin
    from scenarios.trials.standin.schema import standin_of
    from scenarios.trials.standin.study import run_standin
    from scenarios.trials.standin.text import standin_text

    run = partial(run_standin, standin_of(*load_document(name, changes)))
    return Runner(run, write_standin, _printed(standin_text), page=True)


def _loop(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.x29.files import write_loop
    from scenarios.x29.printing import print_loop
    from scenarios.x29.study import loop_scenario, run_loop

    scenario = loop_scenario(name, changes)
    return Runner(lambda seed, progress: run_loop(scenario, seed), write_loop, print_loop)


def _flown_only(name: str, changes: Sequence[str]) -> Runner:
    from scenarios.studies.catalogue import scenario_file

    remedy = f"use flightid simulate {name} --out flight.csv, and then identify or diagnose"
    raise DeclarationError("a flight by JSBSim is a record without a study", where=scenario_file(name), remedy=remedy)


def _printed(text: Callable[[Any, int], str]) -> Callable[[Any], None]:
    """Prints a study's text as wide as the terminal is."""

    def show(study: Any) -> None:
        from scenarios.terminal.paragraphs import terminal_width

        print(text(study, terminal_width()), end="")

    return show


_LOADERS: Mapping[str, Callable[[str, Sequence[str]], Runner]] = {
    "identification": _identification,
    "trace": _trace,
    "standin": _standin,
    "x29": _loop,
    "jsbsim": _flown_only,
}


def simulate(what: str | OwnFlight, out: Path, seed: int | None, changes: Sequence[str]) -> None:
    """Write the record of a scenario, or of a flight of a user's own model, its truth left out."""
    from scenarios.files.writing import write_record
    from scenarios.studies.catalogue import scenario_kind

    if out.suffix != ".csv":
        raise DeclarationError(f"{out.suffix or 'no'} ending", where=str(out), remedy="name a .csv file")
    try:
        if not isinstance(what, str):
            simulate_own(what, out, seed, changes)
            return
        whole = {"standin": simulate_standin, "trace": simulate_trace, "jsbsim": simulate_jsbsim}.get(scenario_kind(what))
        if whole is not None:
            whole(what, out, seed, changes)
            return
        record = _record(what, seed, changes)
        out.parent.mkdir(parents=True, exist_ok=True)
        write_record(out.parent, record, out.stem)
    except OSError as error:
        raise FlightidError(f"cannot be written ({error.strerror})", where=str(out), remedy="name a file that you may write") from None


def _record(name: str, seed: int | None, changes: Sequence[str]) -> Record:
    from scenarios.studies.catalogue import load_scenario, scenario_file, scenario_kind

    if scenario_kind(name) == "x29":
        from scenarios.x29.flying import fly_loop
        from scenarios.x29.study import loop_scenario

        loop = loop_scenario(name, changes)
        with named_after(scenario_file(name)):
            return fly_loop(loop.flight, loop.seed if seed is None else seed).record
    from scenarios.studies.flying import fly_scenario

    scenario = load_scenario(name, changes)
    with named_after(scenario_file(name)):
        return fly_scenario(scenario, scenario.seed if seed is None else seed)[0]


def _refuse_same_names(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise DeclarationError(f"{name} is named twice", where="flightid run", remedy="name each scenario once")
