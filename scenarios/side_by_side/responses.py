"""Measured, predicted and noise-free outputs over time, read back from a study folder."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenarios.files.channel_names import CHANNEL_UNITS, TIME
from scenarios.files.documents import found_json
from scenarios.files.measured.sidecar import SIMULATED as SIMULATED_ORIGIN
from scenarios.files.writing import PREDICTED, RESPONSE, TRUE

SIMULATION, SIMULATED = "simulation", "simulated_"  # of the closed-loop scenarios


@dataclass(frozen=True, eq=False)
class Responses:
    """Outputs of one study over ``time (N,)`` s, each ``(N,)`` in SI by name, NaN where there is nothing.

    ``predicted`` is what the estimate says; ``true`` is empty where nobody knows it. ``units`` of the channels, those that are known;
    ``simulated``: a program made the record.
    """

    time: np.ndarray
    inputs: Mapping[str, np.ndarray]
    measured: Mapping[str, np.ndarray]
    predicted: Mapping[str, np.ndarray]
    true: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    simulated: bool = False


def read_responses(folder: Path, method: str = "") -> Responses | None:
    """Responses of a study's main method, or of another by its name; None where the folder has none that can be read."""
    stems = (f"{RESPONSE}_{method}",) if method else (RESPONSE, SIMULATION)
    path = next((folder / f"{stem}.csv" for stem in stems if (folder / f"{stem}.csv").is_file()), None)
    table = _columns(path) if path is not None else {}
    if TIME not in table:
        return None
    predicted = {name.removeprefix(mark): row for mark in (PREDICTED, SIMULATED) for name, row in table.items() if name.startswith(mark)}
    true = {name.removeprefix(TRUE): row for name, row in table.items() if name.startswith(TRUE)}
    measured = {name: table[name] for name in predicted if name in table}
    others = (name for name in table if not name.startswith((PREDICTED, SIMULATED, TRUE)) and name not in (TIME, *measured))
    inputs = {name: table[name] for name in others}
    return Responses(table[TIME], inputs, measured, {name: predicted[name] for name in measured}, true, *_told(folder))


def _told(folder: Path) -> tuple[dict[str, str], bool]:
    """Units of channels, those of the folder's record where it tells them, and whether that record is simulated."""
    found = found_json(folder / "record.json")
    content = found if isinstance(found, dict) else {}
    units = content.get("units", {})
    told = {name: str(unit) for name, unit in units.items()} if isinstance(units, dict) else {}
    return {**CHANNEL_UNITS, **told}, content.get("origin") == SIMULATED_ORIGIN or (folder / "truth.json").is_file()


def _columns(path: Path) -> dict[str, np.ndarray]:
    """Columns of numbers by heading, NaN for an empty cell; none where the file is no such table."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            head, *rows = list(csv.reader(file))
        values = np.array([[float(cell) if cell else math.nan for cell in row] for row in rows], dtype=float)
    except (OSError, ValueError):
        return {}
    return dict(zip(head, values.T, strict=True)) if values.ndim == 2 and values.shape[1] == len(head) else {}
