"""The files of a flight by JSBSim: the record, a vehicle file for each model, and the truth in a file that no command of identification reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.sources import versions
from scenarios.files.writing import write_json, write_record
from scenarios.trials.jsbsim.declaration import JsbsimFlight
from scenarios.trials.jsbsim.derivatives import Slopes
from scenarios.trials.jsbsim.faults import named
from scenarios.trials.jsbsim.flight import JsbsimTruth
from sim.record import Record

STARTS_APART = 1_000_003  # between the seeds of sensors and those of starting values
FELT = 1e-3  # share of a load's spread: a derivative that moves less is zero for a fit


def write_jsbsim(flight: JsbsimFlight, seed: int, record: Record, truth: JsbsimTruth, folder: Path, stem: str) -> tuple[dict[str, Path], Path]:
    """``stem.csv`` with its sidecar, ``stem_MODEL.toml`` for each model, ``stem_truth.json``; vehicle files by model, and the truth's path."""
    folder.mkdir(parents=True, exist_ok=True)
    write_record(folder, record, stem, simulated=True)
    rng = np.random.default_rng((STARTS_APART, seed))
    vehicles = {}
    for model, constants in truth.constants.items():
        vehicles[model] = folder / f"{stem}_{model}.toml"
        text = vehicle_text(flight, constants, truth.about_trim[model], rng)
        vehicles[model].write_text(text, encoding="utf-8", newline="\n")
    path = folder / f"{stem}_truth.json"
    write_json(path, truth_content(flight, seed, truth))
    return vehicles, path


def vehicle_text(flight: JsbsimFlight, constants: Mapping[str, float], slopes: Slopes, rng: np.random.Generator) -> str:
    """A vehicle file: constants as JSBSim has them, derivatives wrong by up to ``wrong``; those that move nothing left out."""
    lines = [f'name = "{flight.aircraft}"', *(f"{name} = {value!r}" for name, value in constants.items()), "[derivatives]"]
    for name, value in slopes.values.items():
        start = value * (1.0 + flight.wrong * rng.uniform(-1.0, 1.0))
        if slopes.weight.get(name, 1.0) > FELT:
            lines.append(f"{name} = {start:.4g}")
    return "\n".join(lines) + "\n"


def truth_content(flight: JsbsimFlight, seed: int, truth: JsbsimTruth) -> dict[str, Any]:
    """Derivatives about trim and over the maneuver by model, what was put in, and how the flight was made."""
    made = {key: value for key, value in asdict(flight).items() if key not in ("name", "title", "about", "seed")}
    return {
        "schema": "flightid/truth/1",
        "parameters": {model: dict(found.values) for model, found in truth.about_trim.items()},
        "in_maneuver": {model: dict(found.values) for model, found in truth.in_maneuver.items()},
        "variance_left": {model: found.left for model, found in truth.in_maneuver.items()},
        "hidden": named(flight),
        "flight": made,
        "controls": dict(truth.sizes),
        "seed": seed,
        "versions": versions(),
    }
