"""`flightid simulate` and `campaign` of stand-ins for measured flights."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from scenarios.files.declarations import named_after


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


def standin_campaign(name: str, runs: int, seed: int | None, out: Path | None, changes: Sequence[str], progress: bool = True) -> None:
    """Run, print, and write ``campaign.json`` and ``flights.csv`` into ``out``."""
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.terminal.paragraphs import terminal_width
    from scenarios.terminal.progress import progress_bar
    from scenarios.terminal.summary import details_in, written_to
    from scenarios.trials.standin.campaign import fly_standin_campaign
    from scenarios.trials.standin.campaign_text import campaign_text, write_campaign
    from scenarios.trials.standin.page import campaign_page
    from scenarios.trials.standin.schema import standin_of
    from scenarios.trials.stopping import flown, stopped_after

    standin = standin_of(*load_document(name, changes))
    first = standin.seed if seed is None else seed
    with named_after(scenario_file(name)), progress_bar(progress) as tell:
        done = flown(lambda: fly_standin_campaign(standin, runs, first, tell, os.cpu_count() or 1), range(first, first + runs))
    with stopped_after(len(done.seeds), runs, out):
        print(campaign_text(standin, done.found, done.words, terminal_width(), details_in(out)), end="")
        if out is not None:
            write_campaign(standin, done.found, out, done.content, campaign_page(standin, done.found, done.words))
            print(written_to(out))
