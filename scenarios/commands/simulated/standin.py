"""`flightid simulate` and `campaign` of stand-ins for measured flights."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.files.declarations import named_after
from scenarios.plots.formats import USUAL, Formats

if TYPE_CHECKING:
    from scenarios.tasks.manner import Manner


def simulate_standin(name: str, out: Path, seed: int | None, changes: Sequence[str]) -> list[Path]:
    """Write all records: ``record.csv`` asked for gives ``record_1.csv``, ``record_2.csv`` ..., and ``record_vehicle.toml``; the truth left out.

    Returns the files.
    """
    from scenarios.files.writing import write_record
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.trials.standin.flights.flight import fly_standin, vehicle_text
    from scenarios.trials.standin.schema import standin_of

    standin = standin_of(*load_document(name, changes))
    with named_after(scenario_file(name)):
        flight = fly_standin(standin, standin.seed if seed is None else seed)
    out.parent.mkdir(parents=True, exist_ok=True)
    names = [f"{out.stem}_{number}" for number in range(1, len(flight.records) + 1)]
    written = [path for stem, record in zip(names, flight.records, strict=True) for path in write_record(out.parent, record, stem, simulated=True)]
    vehicle = out.parent / f"{out.stem}_vehicle.toml"
    vehicle.write_text(vehicle_text(flight.drawn), encoding="utf-8")
    print(f"{len(names)} records of one flight: {names[0]}.csv to {names[-1]}.csv; for --vehicle: {vehicle.name}")
    return [*written, vehicle]


def standin_campaign(
    name: str, runs: int, seed: int | None, manner: Manner, changes: Sequence[str], figures: Formats = USUAL, progress: bool = True
) -> None:
    """Run, print, and write ``campaign.json`` and ``flights.csv`` into ``manner.out``."""
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.tasks.manner import stopped
    from scenarios.terminal.paragraphs import terminal_width
    from scenarios.terminal.progress import progress_bar
    from scenarios.terminal.summary import details_in, written_to
    from scenarios.trials.repeated import fly_all
    from scenarios.trials.standin.campaign import standin_flights
    from scenarios.trials.standin.campaign_text import campaign_text, write_campaign
    from scenarios.trials.standin.page import campaign_page
    from scenarios.trials.standin.schema import standin_of

    standin, out = standin_of(*load_document(name, changes)), manner.out
    with named_after(scenario_file(name)), progress_bar(progress) as tell:
        done = fly_all(standin_flights(standin), runs, standin.seed if seed is None else seed, manner, tell)
    print(campaign_text(standin, done.found, done.words, terminal_width(), details_in(out)), end="")
    if out is not None:
        write_campaign(standin, done, out, partial(campaign_page, standin, done), figures)
        print(written_to(out))
    if not done.whole:
        raise stopped(done.ended, done.asked, "flights", out)
