"""`flightid simulate` of flights by JSBSim."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scenarios.files.declarations import named_after


def simulate_jsbsim(name: str, out: Path, seed: int | None, changes: Sequence[str]) -> list[Path]:
    """Write the record, a vehicle file for each model that it serves, and the truth in a file of its own; the files."""
    from scenarios.files.folders import files_together
    from scenarios.studies.catalogue import load_document, scenario_file
    from scenarios.trials.jsbsim.files import write_jsbsim
    from scenarios.trials.jsbsim.flight import fly_jsbsim
    from scenarios.trials.jsbsim.schema import jsbsim_of

    flight = jsbsim_of(*load_document(name, changes))
    chosen = flight.seed if seed is None else seed
    with named_after(scenario_file(name)):
        record, truth = fly_jsbsim(flight, chosen)
    with files_together(out) as scratch:
        made, truth_file = write_jsbsim(flight, chosen, record, truth, scratch, out.stem)
    vehicles, kept = {model: out.parent / path.name for model, path in made.items()}, out.parent / truth_file.name
    print(f"{flight.aircraft} flown by JSBSim: {len(record)} samples, {record.time[-1]:g} s, {flight.maneuver}; the truth is in {kept.name}")
    for model, vehicle in vehicles.items():
        print(f"flightid identify {out} --model {model} --vehicle {vehicle}")
    return [out, *vehicles.values(), kept]
