"""`flightid run` and `flightid simulate`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.commands.failures import named_after
from scenarios.commands.standin import simulate_standin, standin_runner
from sim.errors import DeclarationError, FlightidError

if TYPE_CHECKING:
    from sim.record import Record

# Seed, folder and whether figures are drawn.
Run = Callable[[int | None, Path | None, bool], None]


def run_scenarios(names: Sequence[str], seed: int | None, out: Path | None, changes: Sequence[str], figures: bool) -> None:
    """Run scenarios one after the other; with several, each gets a folder of its own under ``out``."""
    from scenarios.studies.catalogue import scenario_kind

    shorts = [Path(name).stem if name.endswith(".toml") else name for name in names]
    kinds = [scenario_kind(name) for name in names]
    _refuse_same_names(shorts)
    runs = [_RUNNERS[kind](name, changes) for name, kind in zip(names, kinds, strict=True)]
    for short, run in zip(shorts, runs, strict=True):
        run(seed, None if out is None else out if len(runs) == 1 else out / short, figures)


def _identification(name: str, changes: Sequence[str]) -> Run:
    """An identification that is loaded and can be run."""
    from scenarios.studies.catalogue import load_scenario, scenario_file

    scenario = load_scenario(name, changes)

    def run(seed: int | None, folder: Path | None, figures: bool) -> None:
        from scenarios.studies.comparison import check_display
        from scenarios.studies.study import run_scenario
        from scenarios.studies.text import print_study
        from scenarios.terminal.numbers import console

        terminal = console()
        with named_after(scenario_file(name)):
            study = run_scenario(scenario, seed)
            check_display(study)
        if folder is not None:
            from scenarios.studies.files import write_study

            write_study(study, folder, figures=figures)
        print_study(study, terminal)
        if folder is not None:
            terminal.print(f"written to {folder}", highlight=False)

    return run


def _trace(name: str, changes: Sequence[str]) -> Run:
    """A tracing scenario that is loaded and can be run."""
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.trials.planted.schema import trace_scenario_of

    scenario = trace_scenario_of(*load_document(name, changes))

    def run(seed: int | None, folder: Path | None, figures: bool) -> None:
        from scenarios.terminal.plain_tables import terminal_width
        from scenarios.terminal.progress import progress_bar
        from scenarios.trials.planted.study import run_trace
        from scenarios.trials.planted.text import trace_text

        with named_after(scenario_file(name)), progress_bar() as progress:
            study = run_trace(scenario, seed, progress)
        if folder is not None:
            from scenarios.trials.planted.files import write_trace

            write_trace(study, folder, figures=figures)
        print(trace_text(study, terminal_width()), end="")
        if folder is not None:
            print(f"written to {folder}; begin with {folder / 'report.html'}")

    return run


def _loop(name: str, changes: Sequence[str]) -> Run:
    """A closed-loop scenario that is loaded and can be run."""
    from scenarios.studies.catalogue import scenario_file
    from scenarios.x29.study import loop_scenario

    scenario = loop_scenario(name, changes)

    def run(seed: int | None, folder: Path | None, figures: bool) -> None:
        from scenarios.terminal.numbers import console
        from scenarios.x29.printing import print_loop
        from scenarios.x29.study import run_loop

        terminal = console()
        with named_after(scenario_file(name)):
            study = run_loop(scenario, seed)
        if folder is not None:
            from scenarios.x29.files import write_loop

            write_loop(study, folder, figures=figures)
        print_loop(study, terminal)
        if folder is not None:
            terminal.print(f"written to {folder}", highlight=False)

    return run


_RUNNERS: Mapping[str, Callable[[str, Sequence[str]], Run]] = {
    "identification": _identification,
    "trace": _trace,
    "standin": standin_runner,
    "x29": _loop,
}


def simulate_scenario(name: str, out: Path, seed: int | None, changes: Sequence[str]) -> None:
    """Write the record of a scenario, its truth left out."""
    from scenarios.files.writing import write_record
    from scenarios.studies.catalogue import scenario_kind

    if out.suffix != ".csv":
        raise DeclarationError(f"{out.suffix or 'no'} ending", where=str(out), remedy="name a .csv file")
    try:
        if scenario_kind(name) == "standin":
            simulate_standin(name, out, seed, changes)
            return
        record = _record(name, seed, changes)
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
