"""One record of a lateral stand-in: what differs from record to record, flown, filtered, sampled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from scenarios.trials.standin.flights.drawing import SPEED, Drawn, with_term
from scenarios.trials.standin.flights.level import speed_rate
from scenarios.trials.standin.flights.maneuvers import CELL, Table
from scenarios.trials.standin.flights.recorder import recorded
from sim.maneuvers.steps import Maneuver
from sim.record import Channel, Hold, Record
from sim.truth.flight import fly, sample_times
from sim.truth.measurement import Measurement
from sim.truth.noise import dryden_gust, white_noise


def fly_lateral(drawn: Drawn, number: int, rng: np.random.Generator, noise: bool, step: float) -> tuple[Record, Mapping[str, float]]:
    """A record, and what was true of it alone: mass, inertias, airspeed, density, thrust above drag (m/s2).

    ``noise`` False leaves out the sensors' noise (that of the recorded surfaces stays: it is one of the small causes); ``step`` in s.
    """
    flight, causes = drawn.standin.flight, drawn.standin.causes
    scatter, path_seed, sensor_seed = rng.spawn(3)
    time = sample_times(drawn.rate, flight.duration)
    constants, zeros = _scattered(drawn, scatter)
    drift = causes.speed_drift * constants["airspeed"] / flight.duration * float(scatter.standard_normal())
    constants["thrust"] = speed_rate(drawn, number) + drift
    model = drawn.model
    for dominant in drawn.hidden:
        if number in dominant.records and dominant.name != SPEED:
            model = with_term(model, dominant.effect, dominant.values)
    model = model.with_values({key: value for key, value in constants.items() if key in drawn.axis.scattered})
    surfaces = {name: drawn.moves(name)[number] for name in drawn.axis.inputs}
    thrust = Table(np.full(2, constants["thrust"]), flight.duration)
    moves: dict[str, Maneuver] = {**surfaces, "sidewind": _gusts(drawn, constants["airspeed"], path_seed), "thrust": thrust}
    std = {name: causes.noise_std[name] for name in drawn.channels if noise and causes.noise_std.get(name, 0.0) > 0}
    sensors = Measurement(std=std, correlation_time=dict.fromkeys(std, causes.noise_time) if causes.noise_time else {})
    record, _ = fly(model, moves, time, sensor_seed, measurement=sensors, step=step, outputs=drawn.channels, name=f"record_{number + 1}")
    shown = (
        Channel.of(name, "rad", recorded(drawn, name, time, step, move) + zeros[name] + white_noise(path_seed, len(time), causes.input_noise))
        for name, move in surfaces.items()
    )
    return replace(record, inputs=tuple(shown), hold=Hold.LINEAR), constants


def _scattered(drawn: Drawn, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """Constants of one record, and where the trim of each surface lies in its record, rad."""
    causes, p = drawn.standin.causes, drawn.model.parameters
    levels = {name: float(getattr(causes, level)) for name, level in drawn.axis.scattered.items()}
    constants = {name: p[name].value * (1.0 + level * float(rng.standard_normal())) for name, level in levels.items()}
    return constants, {name: causes.trim_scatter * float(rng.standard_normal()) for name in drawn.axis.inputs}


def _gusts(drawn: Drawn, airspeed: float, rng: np.random.Generator) -> Table:
    flight, causes = drawn.standin.flight, drawn.standin.causes
    times = CELL * np.arange(int(flight.duration / CELL) + 2)
    return Table(dryden_gust(rng, times, causes.turbulence, causes.turbulence_length, airspeed), CELL)
