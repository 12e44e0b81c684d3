"""`flightid simulate` and `campaign` of tracing scenarios, `simulate` of users' own models."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.files.declarations import named_after

if TYPE_CHECKING:
    from scenarios.trials.planted.declaration import TraceScenario
    from scenarios.trials.planted.own_flight import OwnFlight


def simulate_trace(name: str, out: Path, seed: int | None, changes: Sequence[str]) -> list[Path]:
    """Write what the loop is given of a tracing scenario, as ``_write``; the files."""
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.trials.planted.schema import trace_scenario_of

    return _write(trace_scenario_of(*load_document(name, changes)), scenario_file(name), out, seed)


def simulate_own(asked: OwnFlight, out: Path, seed: int | None, changes: Sequence[str]) -> list[Path]:
    """Write what the loop is given of a user's own model in a flight that the command line describes, as ``_write``; the files."""
    from scenarios.studies.catalogue import with_changes
    from scenarios.trials.planted.own_flight import trace_document
    from scenarios.trials.planted.schema import trace_scenario_of

    document = with_changes(trace_document(asked), changes)
    return _write(trace_scenario_of(document, Path(asked.model).stem, asked.model), asked.model, out, seed)


def _write(scenario: TraceScenario, file: str, out: Path, seed: int | None) -> list[Path]:
    """Both records and the vehicle file that the loop is given, the truth left out; ``file`` declares the scenario.

    ``record.csv`` asked for is the training record; beside it stand ``record_validate.csv`` and ``record_vehicle.toml``.
    """
    from scenarios.files.folders import files_together
    from scenarios.files.writing import write_record
    from scenarios.trials.planted.flights import fly_trace

    with named_after(file):
        flown = fly_trace(scenario, scenario.seed if seed is None else seed)
    vehicle = out.parent / f"{out.stem}_vehicle.toml"
    with files_together(out) as scratch:
        paths = [
            *write_record(scratch, flown.train, out.stem, simulated=True),
            *write_record(scratch, flown.validate, f"{out.stem}_validate", simulated=True),
        ]
        (scratch / vehicle.name).write_text(flown.vehicle_file, encoding="utf-8", newline="\n")
    written = [out.parent / path.name for path in paths]
    print(f"{out.name}; for --validate: {out.stem}_validate.csv; for --vehicle: {vehicle.name}")
    return [*written, vehicle]
