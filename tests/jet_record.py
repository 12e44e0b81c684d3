"""A business jet flown by the second simulator: its vehicle file and plain records without a word
on how inputs run between samples.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.independent.flight import Vehicle
from tests.independent.maneuvers import Maneuver, three_two_one_one
from tests.independent.short_period import BUSINESS_JET, Hidden, flown

NOISE = {"alpha": 5e-4, "q": 5e-4, "nz": 5e-3, "theta": 5e-4}
LONG = Maneuver((*three_two_one_one(1.0, 0.5), *three_two_one_one(14.0, 0.5, -1.0)), 28.0)


def vehicle_file(path: Path, vehicle: Vehicle, **factors: float) -> Path:
    """A vehicle file with derivatives 20 % too small, or times their factors."""
    names = ("mass", "wing_area", "chord", "pitch_inertia", "airspeed", "air_density")
    lines = [f"{name} = {getattr(vehicle, name)}" for name in names]
    starts = [
        f"{name} = {factors.get(name, 0.8) * value}" for name, value in vehicle.derivatives.items()
    ]
    path.write_text("\n".join(['name = "jet"', *lines, "[derivatives]", *starts]))
    return path


def recorded(
    path: Path, hidden: Hidden, outputs: tuple[str, ...] = ("alpha", "q", "nz"), every: int = 16
) -> Path:
    """A record of the jet by the second simulator, every 16th of its 400 Hz samples, without a word
    on how inputs run between samples.
    """
    flight, rng = flown(BUSINESS_JET, LONG, 0.02, hidden), np.random.default_rng(1)
    columns = {"time": flight.time, "elevator": flight.elevator}
    columns |= {
        name: flight.signal(name) + NOISE[name] * rng.standard_normal(len(flight.time))
        for name in outputs
    }
    np.savetxt(
        path,
        np.array([*columns.values()]).T[::every],
        delimiter=",",
        header=",".join(columns),
        comments="",
        fmt="%.12g",
    )
    return path
