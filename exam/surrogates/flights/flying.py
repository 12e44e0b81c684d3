"""From a drawn flight to its records, with differences between records, and values that only the
truth has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from exam.surrogates.declaration import LATERAL
from exam.surrogates.flights.drawing import ELEVATOR, SPEED, Dominant, Drawn, with_term
from exam.surrogates.flights.lateral.flying import fly_lateral, fly_lateral_draws
from exam.surrogates.flights.level import speed_rate, steered
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

SCATTERED = ("mass", "pitch_inertia", "airspeed", "air_density", "trim_alpha")
TOGETHER = 250  # records flown at once; more need memory without saving time


@dataclass(frozen=True, eq=False)
class FlownRecord:
    """A record, and its own true values: mass, inertia, airspeed, density, trim, thrust above drag
    (m/s2) at the start.
    """

    record: Record
    constants: Mapping[str, float]


def fly_drawn(
    drawn: Drawn,
    rng: np.random.Generator,
    *,
    noise: bool = True,
    step: float | None = None,
    count: int | None = None,
) -> tuple[FlownRecord, ...]:
    """Fly all records of a flight, or the first ``count``, each with a generator of its own.

    Without ``noise`` the sensors have no noise; that of the recorded elevator remains, because it
    is one of the small causes. ``step`` is the integration step in s, else the declared one.
    """
    own = rng.spawn(len(drawn.maneuvers))[:count]
    if drawn.surrogate.flight.axis == LATERAL:
        dt = step or drawn.surrogate.flight.step
        return tuple(
            FlownRecord(*fly_lateral(drawn, number, generator, noise, dt))
            for number, generator in enumerate(own)
        )
    return tuple(
        _fly(drawn, number, generator, noise, step or drawn.surrogate.flight.step)
        for number, generator in enumerate(own)
    )


@dataclass(frozen=True, eq=False)
class _Conditions:
    """Random conditions of one record.

    ``terms`` are the dominant effects that act on it, without thrust. ``zero`` is that of the
    recorded elevator, rad, and ``noise`` its noise, ``(N,)`` rad.
    """

    number: int
    terms: tuple[Dominant, ...]
    constants: Mapping[str, float]
    gusts: Table
    thrust: Table
    zero: float
    noise: np.ndarray


def _fly(
    drawn: Drawn, number: int, rng: np.random.Generator, noise: bool, step: float
) -> FlownRecord:
    causes, time = drawn.surrogate.causes, sample_times(drawn.rate, drawn.surrogate.flight.duration)
    found, sensor_seed = _conditions(drawn, number, rng, len(time))
    model = _with_terms(drawn, found.terms).with_values(
        {key: found.constants[key] for key in SCATTERED}
    )
    elevator_moves = steered(drawn, number)
    moves: dict[str, Maneuver] = {
        ELEVATOR: elevator_moves,
        "updraft": found.gusts,
        "thrust": found.thrust,
    }
    std = {
        name: causes.noise_std[name]
        for name in drawn.channels
        if noise and causes.noise_std.get(name, 0.0) > 0
    }
    sensors = Measurement(
        std=std, correlation_time=dict.fromkeys(std, causes.noise_time) if causes.noise_time else {}
    )
    name = f"record_{number + 1}"
    record, _ = fly(
        model,
        moves,
        time,
        sensor_seed,
        measurement=sensors,
        step=step,
        method=rk4_step,
        outputs=drawn.channels,
        name=name,
    )
    elevator = recorded(drawn, ELEVATOR, time, step, elevator_moves) + found.zero + found.noise
    levels = _levels(drawn, found)
    outputs = tuple(
        Channel.of(c.name, c.unit, c.values + levels[c.name]) if c.name in levels else c
        for c in record.outputs
    )
    return FlownRecord(
        replace(
            record,
            inputs=(Channel.of(ELEVATOR, "rad", elevator),),
            outputs=outputs,
            hold=Hold.LINEAR,
        ),
        found.constants,
    )


def fly_draws(
    drawn: Drawn,
    generators: Sequence[np.random.Generator],
    channels: Sequence[str],
    *,
    step: float | None = None,
    count: int | None = None,
) -> list[list[Record]]:
    """Fly records of many flights of the same plan together, without the sensors' noise.

    They agree with those of ``fly_drawn`` to rounding. ``generators`` has one for each flight, and
    ``channels`` the wanted outputs among the recorded ones.
    """
    chosen, dt = (
        tuple(name for name in drawn.channels if name in channels),
        step or drawn.surrogate.flight.step,
    )
    numbers = range(len(drawn.maneuvers))[:count]
    if drawn.surrogate.flight.axis == LATERAL:
        return fly_lateral_draws(drawn, generators, numbers, dt)
    at_once = max(1, TOGETHER // len(numbers))
    flights: list[list[Record]] = []
    for first in range(0, len(generators), at_once):
        flights += _fly_some(drawn, generators[first : first + at_once], chosen, numbers, dt)
    return flights


def _fly_some(
    drawn: Drawn,
    generators: Sequence[np.random.Generator],
    channels: tuple[str, ...],
    numbers: range,
    step: float,
) -> list[list[Record]]:
    time = sample_times(drawn.rate, drawn.surrogate.flight.duration)
    spawned = [generator.spawn(len(drawn.maneuvers)) for generator in generators]
    drawings = [
        [_conditions(drawn, number, own[number], len(time)) for number in numbers]
        for own in spawned
    ]
    steering = {number: steered(drawn, number) for number in numbers}
    elevators = {
        number: recorded(drawn, ELEVATOR, time, step, steering[number]) for number in numbers
    }
    records: list[list[Any]] = [[None] * len(numbers) for _ in generators]
    for names in dict.fromkeys(
        tuple(term.name for term in found.terms) for found, _ in drawings[0]
    ):
        places = [
            (d, r)
            for d, row in enumerate(drawings)
            for r, (found, _) in enumerate(row)
            if tuple(term.name for term in found.terms) == names
        ]
        group = [drawings[d][r][0] for d, r in places]
        model = _with_terms(drawn, group[0].terms)
        values = {key: np.array([found.constants[key] for found in group]) for key in SCATTERED}
        moves = {ELEVATOR: [steering[found.number] for found in group]}
        moves.update(
            updraft=[found.gusts for found in group], thrust=[found.thrust for found in group]
        )
        if any(isinstance(effect, NoiseEffect) for effect in model.effects):
            rows = _one_by_one(
                model, values, moves, time, [drawings[d][r][1] for d, r in places], step, channels
            )
        else:
            rows = fly_side_by_side(model, values, moves, time, step=step, outputs=channels)
        units = {signal.name: signal.unit for signal in model.equations.outputs}
        for column, ((d, r), found) in enumerate(zip(places, group, strict=True)):
            levels = _levels(drawn, found)
            outputs = tuple(
                Channel.of(name, units[name], rows[name][:, column] + levels.get(name, 0.0))
                for name in channels
            )
            elevator = Channel.of(
                ELEVATOR, "rad", elevators[found.number] + found.zero + found.noise
            )
            records[d][r] = Record(
                time, (elevator,), outputs, Hold.LINEAR, f"record_{found.number + 1}"
            )
    return records


def _one_by_one(
    model: Model,
    values: Mapping[str, np.ndarray],
    moves: Mapping[str, Sequence[Maneuver]],
    time: np.ndarray,
    seeds: Sequence[np.random.Generator],
    step: float,
    channels: tuple[str, ...],
) -> dict[str, np.ndarray]:
    """Fly the flights one by one, for a model with random forcing."""
    columns = []
    for column, seed in enumerate(seeds):
        own = model.with_values({key: float(row[column]) for key, row in values.items()})
        mine = {name: each[column] for name, each in moves.items()}
        columns.append(
            fly(
                own,
                mine,
                time,
                seed,
                measurement=Measurement(std={}),
                step=step,
                method=rk4_step,
                outputs=channels,
            )[1].outputs
        )
    return {name: np.stack([column[name] for column in columns], axis=1) for name in channels}


def _conditions(
    drawn: Drawn, number: int, rng: np.random.Generator, samples: int
) -> tuple[_Conditions, np.random.Generator]:
    """Draw the conditions of one record, and the generator of its sensors."""
    flight, causes = drawn.surrogate.flight, drawn.surrogate.causes
    scatter, path_seed, sensor_seed = rng.spawn(3)
    acting = [dominant for dominant in drawn.hidden if number in dominant.records]
    terms = tuple(dominant for dominant in acting if dominant.name != SPEED)
    constants, zero = _scattered(drawn.model, drawn, scatter)
    constants["thrust"] = (
        speed_rate(drawn, number)
        + causes.speed_drift * constants["airspeed"] / flight.duration * scatter.standard_normal()
    )
    gusts = _gusts(drawn, constants["airspeed"], path_seed)
    pushed = Table(np.full(2, constants["thrust"]), flight.duration)
    return _Conditions(
        number,
        terms,
        constants,
        gusts,
        pushed,
        zero,
        white_noise(path_seed, samples, causes.input_noise),
    ), sensor_seed


def _with_terms(drawn: Drawn, terms: Sequence[Dominant]) -> Model:
    model = drawn.model
    for dominant in terms:
        model = with_term(model, dominant.effect, dominant.values)
    return model


def _levels(drawn: Drawn, found: _Conditions) -> dict[str, float]:
    """Return the trim values that the recorder shows."""
    return (
        {"alpha": found.constants["trim_alpha"], "nz": 1.0} if drawn.surrogate.flight.total else {}
    )


def _scattered(
    model: Model, drawn: Drawn, rng: np.random.Generator
) -> tuple[dict[str, float], float]:
    """Draw the constants of one record, and the trim of its elevator, rad."""
    causes, p = drawn.surrogate.causes, model.parameters
    shares = {
        "mass": causes.mass_scatter,
        "pitch_inertia": causes.inertia_scatter,
        "airspeed": causes.airspeed_scatter,
    }
    shares["air_density"] = causes.density_scatter
    constants = {
        key: p[key].value * (1.0 + share * float(rng.standard_normal()))
        for key, share in shares.items()
    }
    constants["trim_alpha"] = p["trim_alpha"].value + causes.trim_scatter * float(
        rng.standard_normal()
    )
    return constants, causes.trim_scatter * float(rng.standard_normal())


def _gusts(drawn: Drawn, airspeed: float, rng: np.random.Generator) -> Table:
    flight, causes = drawn.surrogate.flight, drawn.surrogate.causes
    times = CELL * np.arange(int(flight.duration / CELL) + 2)
    return Table(
        dryden_gust(rng, times, causes.turbulence, causes.turbulence_length, airspeed), CELL
    )
