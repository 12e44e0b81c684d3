"""What the paper leaves open of the two loops, the simulation's and the flight's, and the ranges in which it is varied.

Everything here is [own]: no number of NASA TM-101722 says any of it. The simulation's loop is airframe S, the flight's is F, both under one
law; what the paper does say, their low-order equivalents, is met anew at every point (`matching.py`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim.closed_loop.airframe import X29, Sensor


@dataclass(frozen=True)
class OpenValue:
    """One open value: a factor (``ratio``, varied evenly in its logarithm) or a difference, from ``low`` to ``high``.

    ``between`` : it tells flight from simulation in what is not the airframe.
    """

    name: str
    label: str
    low: float
    high: float
    ratio: bool = True
    between: bool = False

    def at(self, place: float) -> float:
        """The value at a place from -1 (``low``) to 1 (``high``)."""
        if self.ratio:
            return math.exp(0.5 * ((1.0 + place) * math.log(self.high) + (1.0 - place) * math.log(self.low)))
        return 0.5 * ((1.0 + place) * self.high + (1.0 - place) * self.low)


# Ranges: a quarter up or down is what a specification leaves of a servo or sensor; half a frame what unsynchronised computers add or take;
# half to double what wind tunnels and estimates of pitch damping differ by.
OPEN = (
    OpenValue("surfaces", "surfaces' bandwidth, both", 0.8, 1.25),
    OpenValue("sensors", "sensors' bandwidth, both", 0.8, 1.25),
    OpenValue("computing", "computing delay, both, frames", 0.5, 1.5, ratio=False),
    OpenValue("damping_simulation", "pitch damping, simulation, times", 0.5, 2.0),
    OpenValue("damping_flight", "pitch damping, flight, times", 0.5, 2.0),
    OpenValue("lift_flight", "lift of the surfaces, flight, times", 0.5, 2.0),
    OpenValue("surfaces_flight", "surfaces' bandwidth, flight over simulation", 0.8, 1.25, between=True),
    OpenValue("computing_flight", "computing delay, flight less simulation, frames", -0.5, 0.5, ratio=False, between=True),
)


def hypercube(samples: int, seed: int) -> np.ndarray:
    """Places ``(samples, len(OPEN))`` from -1 to 1 of a Latin hypercube: each value's range is met evenly."""
    from scipy.stats import qmc

    return np.asarray(2.0 * qmc.LatinHypercube(len(OPEN), rng=np.random.default_rng(seed)).random(samples) - 1.0)


def values_at(places: np.ndarray) -> dict[str, float]:
    """Open values by name at places ``(len(OPEN),)``."""
    return {item.name: item.at(float(place)) for item, place in zip(OPEN, places, strict=True)}


def simulated_loop(x29: X29, values: Mapping[str, float]) -> tuple[X29, float]:
    """The simulation's aircraft at some open values, and its computing delay (s)."""
    airframe = replace(x29.airframe, M_q=values["damping_simulation"] * x29.airframe.M_q)
    return _systems(replace(x29, airframe=airframe), values["surfaces"], values["sensors"]), values["computing"] * x29.frame


def flown_loop(x29: X29, values: Mapping[str, float]) -> tuple[X29, float]:
    """The flight's aircraft at some open values, and its computing delay (s)."""
    a = x29.airframe
    canard, flaperon, strake = (values["lift_flight"] * each for each in a.L_surface)
    airframe = replace(a, M_q=values["damping_flight"] * a.M_q, L_surface=(canard, flaperon, strake))
    changed = _systems(replace(x29, airframe=airframe), values["surfaces"] * values["surfaces_flight"], values["sensors"])
    return changed, (values["computing"] + values["computing_flight"]) * x29.frame


def _systems(x29: X29, surfaces: float, sensors: float) -> X29:
    """The aircraft with servos and rams so many times as fast, and sensors."""
    canard, flaperon, strake = (
        replace(each, ram=surfaces * each.ram, servo_frequency=None if each.servo_frequency is None else surfaces * each.servo_frequency)
        for each in x29.surfaces
    )
    gyro, accelerometer = (Sensor(sensors * each.frequency, each.damping) for each in (x29.gyro, x29.accelerometer))
    return replace(x29, surfaces=(canard, flaperon, strake), gyro=gyro, accelerometer=accelerometer)
