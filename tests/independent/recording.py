"""From a flight to files: sampling, noise, CSV, and a vehicle file whose starting values are
wrong.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tests.independent.flight import Flight, Vehicle

UNITS = {
    "alpha": "rad",
    "q": "rad/s",
    "nz": "g",
    "theta": "rad",
    "airspeed": "m/s",
    "elevator": "rad",
}
USUAL = {
    "alpha": np.radians(0.1),
    "q": np.radians(0.1),
    "nz": 0.01,
    "theta": np.radians(0.1),
    "airspeed": 0.3,
}
"""Standard deviations of flight-test sensors: a vane, a rate gyro, an accelerometer, a platform, a pitot boom."""  # noqa: E501
FINE = {name: sigma / 3.0 for name, sigma in USUAL.items()}
"""The same of a research installation."""
WRONG = 0.3  # by how much a starting value may be wrong
EVERY = ("alpha", "q", "nz", "theta", "airspeed")


@dataclass(frozen=True, eq=False)
class Sheet:
    """A record as it stands in a file: time, columns, and the unit that the header gives each. NaN
    is an empty cell.
    """

    time: np.ndarray
    columns: Mapping[str, np.ndarray]
    units: Mapping[str, str] = field(default_factory=lambda: dict(UNITS))

    def with_column(self, name: str, values: np.ndarray) -> Sheet:
        return replace(self, columns={**self.columns, name: values})

    @property
    def rate(self) -> float:
        """Samples a second."""
        return float(1.0 / np.median(np.diff(self.time)))


def sampled(
    flight: Flight,
    rate: float,
    channels: Sequence[str],
    sigma: Mapping[str, float],
    rng: np.random.Generator,
) -> Sheet:
    """Every so many steps of the fine grid, white Gaussian noise on each output, none on the
    elevator. ``rate`` divides the fine rate.
    """
    stride = round(1.0 / (rate * flight.step))
    assert abs(stride * rate * flight.step - 1.0) < 1e-9, f"{rate} Hz is no part of the fine rate"
    columns = {"elevator": flight.elevator[::stride]}
    for name in EVERY:
        # Drawn for every channel, used or not, so that leaving one out changes nothing of the
        # others.
        noise = sigma[name] * rng.standard_normal(len(columns["elevator"]))
        if name in channels:
            columns[name] = flight.signal(name)[::stride] + noise
    return Sheet(flight.time[::stride], columns)


def write_sheet(path: Path, sheet: Sheet) -> None:
    """The CSV file, one row a sample; units in the header, empty cells for NaN."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time [s]", *(f"{name} [{sheet.units[name]}]" for name in sheet.columns)])
        for k, time in enumerate(sheet.time):
            writer.writerow(
                [
                    f"{time:.6g}",
                    *(
                        "" if np.isnan(values[k]) else f"{values[k]:.9g}"
                        for values in sheet.columns.values()
                    ),
                ]
            )


def write_vehicle(path: Path, vehicle: Vehicle, rng: np.random.Generator) -> None:
    """The vehicle file: constants as they are, starting values up to `WRONG` off; a small CL_q or
    Cm_alpha starts at a usual size.
    """
    lines = [f'name = "{vehicle.name}"']
    lines += [
        f"{name} = {getattr(vehicle, name):.8g}"
        for name in ("mass", "wing_area", "chord", "pitch_inertia", "airspeed", "air_density")
    ]
    lines.append("[derivatives]")
    usual = {
        "CL_alpha": 4.0,
        "CL_q": 5.0,
        "CL_de": 0.3,
        "Cm_alpha": -0.3,
        "Cm_q": -15.0,
        "Cm_de": -1.0,
    }
    for name, true in vehicle.derivatives.items():
        about = true if abs(true) > 0.1 * abs(usual[name]) else 0.3 * usual[name]
        lines.append(f"{name} = {about * rng.uniform(1.0 - WRONG, 1.0 + WRONG):.4g}")
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
