"""Flights of the speed oracle as records and files, and the model that a user would declare for
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sim.declaration.model import Model
from sim.record import Channel, Hold, Record
from sim.vehicles.factory import model_from_constants
from tests.oracles.falling_speed import CONSTANTS, TRUE, FallingSpeed

UNITS = {
    "elevator": "rad",
    "alpha": "rad",
    "q": "rad/s",
    "nz": "g",
    "airspeed": "m/s",
    "dynamic_pressure": "Pa",
}
NOISE = {
    "elevator": 0.0,
    "alpha": 0.001,
    "q": 0.001,
    "nz": 0.005,
    "airspeed": 0.4,
    "dynamic_pressure": 30.0,
}
OUTPUTS = ("alpha", "q", "nz")


def declared(share: float = 0.8) -> Model:
    """The oracle's aircraft, derivatives at a share of the true ones."""
    return model_from_constants(
        "rigid", CONSTANTS, {name: share * value for name, value in TRUE.items()}
    )


def record_of(
    flown: FallingSpeed,
    hold: Hold = Hold.LINEAR,
    outputs: Sequence[str] = OUTPUTS,
    rng: np.random.Generator | None = None,
) -> Record:
    """Channels of a flight, with noise where a generator is given."""
    columns = noisy(flown, rng)
    channels = {
        name: Channel.of(name, UNITS[name], columns[name]) for name in ("elevator", *outputs)
    }
    return Record(
        flown.time, (channels["elevator"],), tuple(channels[name] for name in outputs), hold
    )


def write_flown(
    path: Path,
    flown: FallingSpeed,
    outputs: Sequence[str] = OUTPUTS,
    rng: np.random.Generator | None = None,
) -> Path:
    """The same as a plain CSV file in SI."""
    columns = {
        "time": flown.time,
        **{name: noisy(flown, rng)[name] for name in ("elevator", *outputs)},
    }
    np.savetxt(
        path,
        np.array([*columns.values()]).T,
        delimiter=",",
        header=",".join(columns),
        comments="",
        fmt="%.12g",
    )
    return path


def noisy(flown: FallingSpeed, rng: np.random.Generator | None = None) -> dict[str, np.ndarray]:
    if rng is None:
        return {name: getattr(flown, name) for name in UNITS}
    return {
        name: getattr(flown, name) + NOISE[name] * rng.standard_normal(len(flown.time))
        for name in UNITS
    }
