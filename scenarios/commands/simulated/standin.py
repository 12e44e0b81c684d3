"""`flightid simulate` of stand-ins for measured flights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scenarios.files.declarations import named_after


def simulate_standin(name: str, out: Path, seed: int | None, changes: Sequence[str]) -> list[Path]:
    """Write all records: ``record.csv`` asked for gives ``record_1.csv``, ``record_2.csv`` ..., and ``record_vehicle.toml``; the truth left out.

    Returns the files.
    """
    from scenarios.files.folders import files_together
    from scenarios.files.writing import write_record
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.trials.standin.flights.flight import fly_standin, vehicle_text
    from scenarios.trials.standin.schema import standin_of

    standin = standin_of(*load_document(name, changes))
    with named_after(scenario_file(name)):
        flight = fly_standin(standin, standin.seed if seed is None else seed)
    names = [f"{out.stem}_{number}" for number in range(1, len(flight.records) + 1)]
    vehicle = out.parent / f"{out.stem}_vehicle.toml"
    with files_together(out) as scratch:
        paths = [path for stem, record in zip(names, flight.records, strict=True) for path in write_record(scratch, record, stem, simulated=True)]
        (scratch / vehicle.name).write_text(vehicle_text(flight.drawn), encoding="utf-8", newline="\n")
    written = [out.parent / path.name for path in paths]
    print(f"{len(names)} records of one flight: {names[0]}.csv to {names[-1]}.csv; for --vehicle: {vehicle.name}")
    return [*written, vehicle]
