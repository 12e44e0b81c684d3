"""`flightid run` and `flightid simulate`."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.api.running import LOADERS, Runner, flown_record, untold
from scenarios.commands.jsbsim import simulate_jsbsim
from scenarios.commands.planted import simulate_own, simulate_trace
from scenarios.commands.standin import simulate_standin
from scenarios.files.declarations import named_after
from sim.errors import DeclarationError, FlightidError

if TYPE_CHECKING:
    from scenarios.trials.planted.own_flight import OwnFlight


def run_scenarios(names: Sequence[str], seed: int | None, out: Path | None, changes: Sequence[str], figures: bool, *, told: bool = True) -> None:
    """Run scenarios one after the other; with several, each gets a folder of its own under ``out``, which is printed if ``told``."""
    from scenarios.studies.catalogue import scenario_kind

    shorts = [Path(name).stem if name.endswith(".toml") else name for name in names]
    kinds = [scenario_kind(name) for name in names]
    _refuse_same_names(shorts)
    runners = [LOADERS[kind](name, changes) for name, kind in zip(names, kinds, strict=True)]
    for name, short, runner in zip(names, shorts, runners, strict=True):
        _run(runner, name, seed, None if out is None else out if len(runners) == 1 else out / short, figures, told)


def run_and_compare(names: Sequence[str], seed: int | None, out: Path | None, changes: Sequence[str], figures: bool) -> None:
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
        run_scenarios(names, seed, Path(scratch), changes, False, told=False)
        print()
        compare_studies([str(Path(scratch) / short) for short in shorts], None, False, False)


def _run(runner: Runner, name: str, seed: int | None, folder: Path | None, figures: bool, told: bool) -> None:
    """Run, write where a folder is named, print, and say where it was written if ``told``."""
    from scenarios.studies.catalogue import scenario_file
    from scenarios.terminal.progress import progress_bar

    with named_after(scenario_file(name)), progress_bar() if runner.page or runner.bar else nullcontext(untold) as progress:
        study = runner.run(seed, progress)
    if folder is not None:
        runner.write(study, folder, figures=figures)
    runner.show(study)
    if folder is not None and told:
        print(f"written to {folder}; begin with {folder / 'report.html'}" if runner.page else f"written to {folder}")


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
        record = flown_record(what, seed, changes)
        out.parent.mkdir(parents=True, exist_ok=True)
        write_record(out.parent, record, out.stem)
    except OSError as error:
        raise FlightidError(f"cannot be written ({error.strerror})", where=str(out), remedy="name a file that you may write") from None


def _refuse_same_names(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise DeclarationError(f"{name} is named twice", where="flightid run", remedy="name each scenario once")
