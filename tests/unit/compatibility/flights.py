"""Records of one oracle flight, flown once: what the sensors show of it, with what is wrong with them."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence

import numpy as np

from sim.record import Channel, Record
from tests.oracles.flight_path import UNITS, Sensors, fly, shown

DEGREE = math.pi / 180.0
NOISE = {"alpha": 0.15 * DEGREE, "q": 0.15 * DEGREE, "nz": 0.01, "theta": 0.2 * DEGREE, "airspeed": 0.3, "ax": 0.05}
THREE, FOUR, ALL = ("alpha", "q", "nz"), ("alpha", "q", "nz", "theta"), tuple(NOISE)
SPEED = 130.0
SOUND = Sensors()


@functools.cache
def flown() -> Mapping[str, np.ndarray]:
    return fly(speed=SPEED)


def record(
    channels: Sequence[str] = THREE, sensors: Sensors = SOUND, seed: int = 0, rate: float = 25.0, noise: float = 1.0, name: str = "record"
) -> Record:
    columns = shown(flown(), rate, sensors, {channel: noise * NOISE[channel] for channel in channels}, np.random.default_rng(seed))
    return Record(columns["time"], (), tuple(Channel.of(channel, UNITS[channel], columns[channel]) for channel in channels), name=name)
