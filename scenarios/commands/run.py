"""`flightid run` and `flightid simulate`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scenarios.commands.failures import named_after
from sim.errors import DeclarationError, FlightidError


def run_scenarios(names: Sequence[str], seed: int | None, out: Path | None, changes: Sequence[str], figures: bool) -> None:
    """Run scenarios one after the other; with several, each gets a folder of its own under ``out``."""
    from scenarios.comparing import check_display
    from scenarios.library import load_scenario, scenario_file
    from scenarios.printing import console, print_study
    from scenarios.run import run_scenario

    scenarios = [load_scenario(name, changes) for name in names]
    _refuse_same_names([scenario.name for scenario in scenarios])
    terminal = console()
    for name, scenario in zip(names, scenarios, strict=True):
        with named_after(scenario_file(name)):
            study = run_scenario(scenario, seed)
            check_display(study)
        folder = None if out is None else out if len(scenarios) == 1 else out / scenario.name
        if folder is not None:
            from scenarios.study_files import write_study

            write_study(study, folder, figures=figures)
        print_study(study, terminal)
        if folder is not None:
            terminal.print(f"written to {folder}", highlight=False)


def simulate_scenario(name: str, out: Path, seed: int | None, changes: Sequence[str]) -> None:
    """Write the record of a scenario, its truth left out."""
    from scenarios.files.writing import write_record
    from scenarios.flying import fly_scenario
    from scenarios.library import load_scenario, scenario_file

    if out.suffix != ".csv":
        raise DeclarationError(f"{out.suffix or 'no'} ending", where=str(out), remedy="name a .csv file")
    scenario = load_scenario(name, changes)
    with named_after(scenario_file(name)):
        record, _ = fly_scenario(scenario, scenario.seed if seed is None else seed)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_record(out.parent, record, out.stem)
    except OSError as error:
        raise FlightidError(f"cannot be written ({error.strerror})", where=str(out), remedy="name a file that you may write") from None


def _refuse_same_names(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise DeclarationError(f"{name} is named twice", where="flightid run", remedy="name each scenario once")
