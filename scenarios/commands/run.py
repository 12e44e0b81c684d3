"""`flightid run` and `flightid simulate`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.api.running import LOADERS, Progress, Runner, flown_record
from scenarios.commands.simulated.jsbsim import simulate_jsbsim
from scenarios.commands.simulated.planted import simulate_own, simulate_trace
from scenarios.files.declarations import named_after
from scenarios.plots.formats import Formats
from scenarios.terminal.progress import progress_bar
from scenarios.terminal.summary import details_in, written_to
from sim.errors import DeclarationError, FlightidError

if TYPE_CHECKING:
    from scenarios.trials.planted.own_flight import OwnFlight


def run_scenarios(
    names: Sequence[str],
    seed: int | None,
    out: Path | None,
    changes: Sequence[str],
    figures: Formats,
    *,
    told: bool = True,
    progress: bool = True,
) -> None:
    """Run scenarios one after the other; with several, each gets a folder of its own under ``out``, which is printed if ``told``.

    ``progress`` False: nothing is shown of how far it is. Ctrl-C leaves the studies that are finished.
    """
    from scenarios.studies.catalogue import scenario_kind

    shorts = [Path(name).stem if name.endswith(".toml") else name for name in names]
    kinds = [scenario_kind(name) for name in names]
    _refuse_same_names(shorts)
    runners = [LOADERS[kind](name, changes) for name, kind in zip(names, kinds, strict=True)]
    folders = [None if out is None else out if len(runners) == 1 else out / short for short in shorts]
    begun = time.monotonic()
    for done, (name, folder, runner) in enumerate(zip(names, folders, runners, strict=True)):
        try:
            with progress_bar(progress, counted=runner.counted, before=(done, len(names), begun)) as tell:
                tell(name, 0.0)
                study = _studied(runner, name, seed, folder, figures, tell)
        except KeyboardInterrupt as stopped:
            raise KeyboardInterrupt("; ".join(filter(None, (str(stopped), _kept(folders[:done], len(names), told))))) from None
        runner.show(study, details_in(folder if told else None))
        if folder is not None and told:
            print(written_to(folder))


def _kept(folders: Sequence[Path | None], of: int, told: bool) -> str:
    """What there is when ``run`` is stopped; empty where there is nothing."""
    if not folders or not told:
        return ""
    written = [str(folder) for folder in folders if folder is not None]
    return f"{len(folders)} of {of} studies are finished{': ' + ', '.join(written) if written else ', and printed above'}"


def _studied(runner: Runner, name: str, seed: int | None, folder: Path | None, figures: Formats, tell: Progress) -> Any:
    """Run, and write where a folder is named; the study."""
    from scenarios.studies.catalogue import scenario_file

    with named_after(scenario_file(name)):
        study = runner.run(seed, tell)
    if folder is not None:
        runner.write(study, folder, figures=figures)
    return study


def documents_of(names: Sequence[str], compare: bool) -> list[str]:
    """The JSON documents of such a run by their paths in its folder: of a comparison its own, else one a study."""
    if compare:
        return ["compared.json"]
    return ["comparison.json"] if len(names) == 1 else [f"{Path(name).stem if name.endswith('.toml') else name}/comparison.json" for name in names]


def run_and_compare(
    names: Sequence[str], seed: int | None, out: Path | None, changes: Sequence[str], figures: Formats, *, progress: bool = True
) -> None:
    """Run scenarios as ``run_scenarios``, then put their study folders side by side; without ``out`` these are gone afterwards."""
    from tempfile import TemporaryDirectory

    from scenarios.commands.compare import compare_studies

    shorts = [Path(name).stem if name.endswith(".toml") else name for name in names]
    if len(shorts) < 2:
        raise DeclarationError("one scenario has nothing beside it", where="flightid run --compare", remedy="name at least two")
    if out is not None:
        run_scenarios(names, seed, out, changes, figures, progress=progress)
        print()
        compare_studies([str(out / short) for short in shorts], out, False, figures)
        return
    with TemporaryDirectory(prefix="flightid-") as scratch:
        run_scenarios(names, seed, Path(scratch), changes, (), told=False, progress=progress)
        print()
        compare_studies([str(Path(scratch) / short) for short in shorts], None, False, ())


def simulate(what: str | OwnFlight, out: Path, seed: int | None, changes: Sequence[str]) -> list[Path]:
    """Write the record of a scenario, or of a flight of a user's own model, its truth left out; the files."""
    from scenarios.files.folders import files_together
    from scenarios.files.writing import write_record
    from scenarios.studies.catalogue import scenario_kind

    if out.suffix != ".csv":
        raise DeclarationError(f"{out.suffix or 'no'} ending", where=str(out), remedy="name a .csv file")
    try:
        if not isinstance(what, str):
            return simulate_own(what, out, seed, changes)
        whole = {"trace": simulate_trace, "jsbsim": simulate_jsbsim}.get(scenario_kind(what))
        if whole is not None:
            return whole(what, out, seed, changes)
        record = flown_record(what, seed, changes)
        with files_together(out) as scratch:
            written = write_record(scratch, record, out.stem, simulated=True)
        return [out.parent / path.name for path in written]
    except OSError as error:
        raise FlightidError(f"cannot be written ({error.strerror})", where=str(out), remedy="name a file that you may write") from None


def files_text(files: Sequence[Path]) -> str:
    """The JSON that says which files ``simulate`` wrote."""
    from scenarios.files.writing import json_text

    return json_text({"schema": "flightid/simulated/1", "files": [str(path) for path in files]})


def _refuse_same_names(names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise DeclarationError(f"{name} is named twice", where="flightid run", remedy="name each scenario once")
