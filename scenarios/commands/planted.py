"""`flightid simulate` of tracing scenarios."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scenarios.commands.failures import named_after


def simulate_trace(name: str, out: Path, seed: int | None, changes: Sequence[str]) -> None:
    """Write both records and the vehicle file that the loop is given, the truth left out.

    ``record.csv`` asked for is the training record; beside it stand ``record_validate.csv`` and ``record_vehicle.toml``.
    """
    from scenarios.files.writing import write_record
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.trials.planted.flights import fly_trace
    from scenarios.trials.planted.schema import trace_scenario_of

    scenario = trace_scenario_of(*load_document(name, changes))
    with named_after(scenario_file(name)):
        flown = fly_trace(scenario, scenario.seed if seed is None else seed)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_record(out.parent, flown.train, out.stem)
    write_record(out.parent, flown.validate, f"{out.stem}_validate")
    vehicle = out.parent / f"{out.stem}_vehicle.toml"
    vehicle.write_text(flown.vehicle_file, encoding="utf-8")
    print(f"{out.name}; for --validate: {out.stem}_validate.csv; for --vehicle: {vehicle.name}")
