"""Flights of a drawn aircraft in the lateral axis, flown with all small causes, filtered and
sampled; one by one, or those of many flights together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from exam.surrogates.flights.drawing import SPEED, Drawn, with_term
from exam.surrogates.flights.level import speed_rate
from exam.surrogates.flights.maneuvers import CELL, Table
from exam.surrogates.flights.many_flights import fly_side_by_side
from exam.surrogates.flights.recorder import recorded
from sim.declaration.effect import NoiseEffect
from sim.declaration.model import Model
from sim.maneuvers import Maneuver
from sim.propagation import rk4_step
from sim.record import Channel, Hold, Record
from sim.truth.flight import fly, sample_times
from sim.truth.measurement import Measurement, dryden_gust, white_noise


@dataclass(frozen=True, eq=False)
class _Conditions:
    """Random conditions of one record.

    ``number`` is the record's number. ``model`` includes the dominant effects that act on it;
    ``constants`` are its constants, and ``moves`` its maneuvers by input. ``zeros`` are the
    recorded trims of the surfaces, rad, and ``noise`` is their noise, ``(N,)`` rad. ``sensors`` is
    the generator of the sensors' noise.
    """

    number: int
    model: Model
    constants: Mapping[str, float]
    moves: Mapping[str, Maneuver]
    zeros: Mapping[str, float]
    noise: Mapping[str, np.ndarray]
    sensors: np.random.Generator

    def scattered(self, drawn: Drawn) -> dict[str, float]:
        """Return the constants that are parameters of the model."""
        return {key: value for key, value in self.constants.items() if key in drawn.axis.scattered}


def fly_lateral(
    drawn: Drawn, number: int, rng: np.random.Generator, noise: bool, step: float
) -> tuple[Record, Mapping[str, float]]:
    """Fly a record, and return it with its own true values: mass, inertias, airspeed, density,
    thrust above drag (m/s2).

    Without ``noise`` the sensors have no noise; that of the recorded surfaces remains, because it
    is one of the small causes. ``step`` is in s.
    """
    causes, time = drawn.surrogate.causes, sample_times(drawn.rate, drawn.surrogate.flight.duration)
    found = _conditions(drawn, number, rng, len(time))
    std = {
        name: causes.noise_std[name]
        for name in drawn.channels
        if noise and causes.noise_std.get(name, 0.0) > 0
    }
    return _flown(drawn, found, time, step, std, number), found.constants


def _flown(
    drawn: Drawn,
    found: _Conditions,
    time: np.ndarray,
    step: float,
    std: Mapping[str, float],
    number: int,
) -> Record:
    """Fly one record with sensor noise of these standard deviations."""
    past = drawn.surrogate.causes.noise_time
    sensors = Measurement(std=std, correlation_time=dict.fromkeys(std, past) if past else {})
    model = found.model.with_values(found.scattered(drawn))
    record, _ = fly(
        model,
        found.moves,
        time,
        found.sensors,
        measurement=sensors,
        step=step,
        method=rk4_step,
        outputs=drawn.channels,
        name=f"record_{number + 1}",
    )
    return replace(record, inputs=_shown(drawn, found, time, step), hold=Hold.LINEAR)


def fly_lateral_draws(
    drawn: Drawn, generators: Sequence[np.random.Generator], numbers: range, step: float
) -> list[list[Record]]:
    """Fly the records ``numbers`` of many flights of the same plan together, without the sensors'
    noise.

    They agree with those of ``fly_lateral`` to rounding. ``generators`` has one for each flight.
    """
    time = sample_times(drawn.rate, drawn.surrogate.flight.duration)
    spawned = [generator.spawn(len(drawn.maneuvers)) for generator in generators]
    flights: list[list[Record]] = [[] for _ in generators]
    for number in numbers:
        group = [_conditions(drawn, number, own[number], len(time)) for own in spawned]
        model = group[0].model
        if any(isinstance(effect, NoiseEffect) for effect in model.effects):
            for flight, found in zip(flights, group, strict=True):
                flight.append(_flown(drawn, found, time, step, {}, number))
            continue
        values = {
            key: np.array([found.constants[key] for found in group]) for key in drawn.axis.scattered
        }
        moves = {name: [found.moves[name] for found in group] for name in group[0].moves}
        rows = fly_side_by_side(model, values, moves, time, step=step, outputs=drawn.channels)
        units = {signal.name: signal.unit for signal in model.equations.outputs}
        for column, (flight, found) in enumerate(zip(flights, group, strict=True)):
            outputs = tuple(
                Channel.of(name, units[name], rows[name][:, column]) for name in drawn.channels
            )
            flight.append(
                Record(
                    time,
                    _shown(drawn, found, time, step),
                    outputs,
                    Hold.LINEAR,
                    f"record_{number + 1}",
                )
            )
    return flights


def _conditions(drawn: Drawn, number: int, rng: np.random.Generator, samples: int) -> _Conditions:
    """Draw the conditions of one record."""
    flight, causes = drawn.surrogate.flight, drawn.surrogate.causes
    scatter, path_seed, sensor_seed = rng.spawn(3)
    constants, zeros = _scattered(drawn, scatter)
    drift = (
        causes.speed_drift
        * constants["airspeed"]
        / flight.duration
        * float(scatter.standard_normal())
    )
    constants["thrust"] = speed_rate(drawn, number) + drift
    model = drawn.model
    for dominant in drawn.hidden:
        if number in dominant.records and dominant.name != SPEED:
            model = with_term(model, dominant.effect, dominant.values)
    thrust = Table(np.full(2, constants["thrust"]), flight.duration)
    surfaces = {name: drawn.moves(name)[number] for name in drawn.axis.inputs}
    moves: dict[str, Maneuver] = {
        **surfaces,
        "sidewind": _gusts(drawn, constants["airspeed"], path_seed),
        "thrust": thrust,
    }
    noise = {name: white_noise(path_seed, samples, causes.input_noise) for name in surfaces}
    return _Conditions(number, model, constants, moves, zeros, noise, sensor_seed)


def _shown(drawn: Drawn, found: _Conditions, time: np.ndarray, step: float) -> tuple[Channel, ...]:
    """Return the surfaces as they are recorded."""
    return tuple(
        Channel.of(
            name,
            "rad",
            recorded(drawn, name, time, step, drawn.moves(name)[found.number])
            + found.zeros[name]
            + noise,
        )
        for name, noise in found.noise.items()
    )


def _scattered(drawn: Drawn, rng: np.random.Generator) -> tuple[dict[str, float], dict[str, float]]:
    """Draw the constants of one record, and the recorded trim of each surface, rad."""
    causes, p = drawn.surrogate.causes, drawn.model.parameters
    levels = {name: float(getattr(causes, level)) for name, level in drawn.axis.scattered.items()}
    constants = {
        name: p[name].value * (1.0 + level * float(rng.standard_normal()))
        for name, level in levels.items()
    }
    return constants, {
        name: causes.trim_scatter * float(rng.standard_normal()) for name in drawn.axis.inputs
    }


def _gusts(drawn: Drawn, airspeed: float, rng: np.random.Generator) -> Table:
    flight, causes = drawn.surrogate.flight, drawn.surrogate.causes
    times = CELL * np.arange(int(flight.duration / CELL) + 2)
    return Table(
        dryden_gust(rng, times, causes.turbulence, causes.turbulence_length, airspeed), CELL
    )
