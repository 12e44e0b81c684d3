"""A folder for one flight: its records, its vehicle file, and the truth beside them."""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.independent.catalogue import Planted
from tests.independent.flight import Flight, Vehicle
from tests.independent.recorder import SheetFault
from tests.independent.recording import FINE, USUAL, sampled, write_sheet, write_vehicle


@dataclass(frozen=True)
class Recording:
    """How a flight is recorded: samples a second, output columns, standard deviations."""

    rate: float = 50.0
    channels: tuple[str, ...] = ("alpha", "q", "nz")
    fine: bool = False


def write_flight(
    folder: Path,
    vehicle: Vehicle,
    bend: float,
    flights: Sequence[Flight],
    faults: Sequence[tuple[Planted, float]],
    how: Recording,
    seed: int,
) -> None:
    """Training records, the last of them to predict, the vehicle file, and beside them the truth,
    which no one but the examiner opens.

    ``faults`` with their sizes, the first nearest to the physics; ``bend`` of lift and moment in
    the calm maneuver, in standard deviations.
    """
    folder.mkdir(parents=True, exist_ok=True)
    sigma = FINE if how.fine else USUAL
    rng = np.random.default_rng([seed, zlib.crc32(folder.name.encode())])
    stems = ["train", *(f"train_{number}" for number in range(2, len(flights))), "validate"]
    for stem, flight in zip(stems, flights, strict=True):
        sheet_faults: list[SheetFault] = []
        for fault, much in faults:
            act, on_sheet = fault.make(much, rng)
            flight = act(flight)
            sheet_faults.append(on_sheet)
        sheet = sampled(flight, how.rate, how.channels, sigma, rng)
        for on_sheet in sheet_faults:
            sheet = on_sheet(sheet)
        write_sheet(folder / f"{stem}.csv", sheet)
    write_vehicle(folder / "vehicle.toml", vehicle, rng)
    truth = {
        "vehicle": vehicle.name,
        "faults": [
            {
                "name": one.name,
                "size": much,
                "unit": one.unit,
                "right": sorted(one.right),
                "twins": sorted(one.twins),
                "channels": list(one.channels),
            }
            for one, much in faults
        ],
        "derivatives": vehicle.derivatives,
        "bend": bend,
        "seed": seed,
        "rate": how.rate,
        "channels": list(how.channels),
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1), encoding="utf-8")
