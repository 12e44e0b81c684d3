"""Records of one oracle flight, flown once: what the sensors show of it, with what is wrong with
them.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from sim.record import Channel, Record
from tests.oracles import undeclared_flights as flights
from tests.oracles.flight_path import UNITS, Sensors, fly, shown
from tests.oracles.undeclared_flights import TRAINER, Hidden

DEGREE = math.pi / 180.0
NOISE = {
    "alpha": 0.15 * DEGREE,
    "q": 0.15 * DEGREE,
    "nz": 0.01,
    "theta": 0.2 * DEGREE,
    "airspeed": 0.3,
    "ax": 0.05,
}
THREE, FOUR, ALL = ("alpha", "q", "nz"), ("alpha", "q", "nz", "theta"), tuple(NOISE)
SPEED = 130.0
SOUND = Sensors()
PATTERN = (
    flights.three_two_one_one(0.06, 0.5, 1.0)
    + flights.doublet(-0.05, 0.8, 7.0)
    + flights.three_two_one_one(-0.05, 0.4, 12.0)
)


@functools.cache
def flown() -> Mapping[str, np.ndarray]:
    return fly(speed=SPEED)


def record(
    channels: Sequence[str] = THREE,
    sensors: Sensors = SOUND,
    seed: int = 0,
    rate: float = 25.0,
    noise: float = 1.0,
    name: str = "record",
) -> Record:
    columns = shown(
        flown(),
        rate,
        sensors,
        {channel: noise * NOISE[channel] for channel in channels},
        np.random.default_rng(seed),
    )
    return Record(
        columns["time"],
        (),
        tuple(Channel.of(channel, UNITS[channel], columns[channel]) for channel in channels),
        name=name,
    )


def in_rough_air(
    seed: int, turbulence: float = 1.0, sensors: Mapping[str, flights.Sensor] = MappingProxyType({})
) -> Record:
    """20 s at 25 samples a second in turbulence (m/s; 1 is a degree at this speed), with the
    elevator recorded.
    """
    rng = np.random.default_rng(seed)
    gust = flights.dryden(rng, turbulence, 150.0, TRAINER.airspeed, 21.0)
    flown = flights.fly_aircraft(
        TRAINER, flights.steps(PATTERN, 25.0, 20.0), 25.0, Hidden(gust=gust, sensors=sensors)
    )
    columns = flights.measured(flown, rng, {name: NOISE[name] for name in THREE})
    elevator = Channel.of("elevator", "rad", columns["elevator"])
    return Record(
        columns["time"],
        (elevator,),
        tuple(Channel.of(name, UNITS[name], columns[name]) for name in THREE),
        name=f"flight {seed}",
    )
