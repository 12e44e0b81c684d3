"""A fighter that a controller holds, written apart from `sim`: totals of lift, drag and weight,
classical Runge-Kutta.

The short period is unstable; elevator = angle alpha + rate q + the stick behind a filter, through
an actuator. The record has what a recorder has: angle of attack, elevator and load factor as
totals, in level flight off zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim.record import Channel, Hold, Record
from tests.recorded_flight import maneuver

G0 = 9.80665
CONSTANTS = {
    "mass": 9300.0,
    "wing_area": 27.87,
    "chord": 3.45,
    "pitch_inertia": 75674.0,
    "airspeed": 150.0,
    "air_density": 1.0,
}
DERIVATIVES = {
    "CL_alpha": 4.0,
    "CL_q": 4.0,
    "CL_de": 0.5,
    "Cm_alpha": 0.15,
    "Cm_q": -5.0,
    "Cm_de": -0.65,
}
DRAG, INDUCED = 0.03, 0.12
ELEVATOR = -0.04  # rad, in trim
ACTUATOR, FILTER = 0.05, 0.2  # s
STEPS = 4  # of the simulation between two rows
SIGMAS = {"alpha": 0.001, "q": 0.001, "nz": 0.01, "airspeed": 0.2}
UNITS = {"alpha": "rad", "q": "rad/s", "nz": "g", "airspeed": "m/s"}


@dataclass(frozen=True)
class Held:
    """The controller, the maneuver (``kind``, ``size`` of the stick in rad, s), the share of the
    trim's thrust, and a brake, m/s2.
    """

    angle: float = 0.5
    rate: float = 0.4
    kind: str = "3211"
    size: float = 0.04
    duration: float = 16.0
    thrust: float = 1.0
    brake: float = 0.0


def fly_held(
    rng: np.random.Generator,
    how: Held,
    derivatives: Mapping[str, float] = DERIVATIVES,
    sampled: float = 50.0,
) -> Record:
    """A record with noise; nz contains the 1 g, and the airspeed goes as drag and weight make
    it.
    """
    c, d, count = CONSTANTS, derivatives, int(how.duration * sampled) + 1
    time = np.arange(count) / sampled
    stick, h = maneuver(how.kind, time, how.size, 0.8), 1.0 / sampled / STEPS
    force = 0.5 * c["air_density"] * c["airspeed"] ** 2 * c["wing_area"]
    lift0 = c["mass"] * G0 / force
    thrust = how.thrust * force * (DRAG + INDUCED * lift0**2)

    def rates(x: np.ndarray, command: float) -> tuple[np.ndarray, float]:
        alpha, q, gamma, speed, surface, filtered = (float(value) for value in x)
        force = 0.5 * c["air_density"] * speed**2 * c["wing_area"]
        turned = q * c["chord"] / (2.0 * speed)
        lift = lift0 + d["CL_alpha"] * alpha + d["CL_q"] * turned + d["CL_de"] * surface
        moment = d["Cm_alpha"] * alpha + d["Cm_q"] * turned + d["Cm_de"] * surface
        climbing = (force * lift / c["mass"] - G0 * math.cos(gamma)) / speed
        faster = (
            (thrust - force * (DRAG + INDUCED * lift**2)) / c["mass"]
            - how.brake
            - G0 * math.sin(gamma)
        )
        asked = how.angle * alpha + how.rate * q + filtered
        turning = force * c["chord"] * moment / c["pitch_inertia"]
        moves = [
            q - climbing,
            turning,
            climbing,
            faster,
            (asked - surface) / ACTUATOR,
            (command - filtered) / FILTER,
        ]
        return np.array(moves), force * lift / (c["mass"] * G0)

    x, rows = np.array([0.0, 0.0, 0.0, c["airspeed"], 0.0, 0.0]), []
    for command in stick.tolist():
        rows.append(
            (x[0] + lift0 / d["CL_alpha"], x[1], rates(x, command)[1], x[3], x[4] + ELEVATOR)
        )
        for _ in range(STEPS):
            k1 = rates(x, command)[0]
            k2 = rates(x + 0.5 * h * k1, command)[0]
            k3 = rates(x + 0.5 * h * k2, command)[0]
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rates(x + h * k3, command)[0])
    columns = dict(zip(("alpha", "q", "nz", "airspeed", "elevator"), np.array(rows).T, strict=True))
    outputs = tuple(
        Channel.of(name, UNITS[name], columns[name] + SIGMAS[name] * rng.standard_normal(count))
        for name in SIGMAS
    )
    return Record(
        time,
        (Channel.of("elevator", "rad", columns["elevator"]),),
        outputs,
        Hold.PREVIOUS,
        name="held.csv",
    )


def drawn_pair(seed: int) -> tuple[list[Record], dict[str, float]]:
    """Two records of one aircraft under one controller, and what a vehicle file may say of its
    derivatives: up to 30 % off, or stable.
    """
    rng = np.random.default_rng(seed)
    angle, rate, size = rng.uniform(0.3, 0.9), rng.uniform(0.2, 0.7), rng.uniform(0.02, 0.08)
    kind, thrust = str(rng.choice(["3211", "doublets", "steps"])), rng.uniform(0.5, 1.5)
    brake, duration = float(rng.choice([0.0, 0.0, 1.5])), float(rng.choice([12.0, 20.0, 30.0]))
    share, stable = rng.uniform(0.7, 1.3), rng.random() >= 0.5
    true = dict(DERIVATIVES, Cm_alpha=rng.uniform(0.05, 0.35))
    records = [
        fly_held(rng, Held(angle, rate, each, size, duration, thrust, brake), true)
        for each in (kind, "3211")
    ]
    return records, {name: share * value for name, value in DERIVATIVES.items()} | (
        {"Cm_alpha": -0.1} if stable else {}
    )
