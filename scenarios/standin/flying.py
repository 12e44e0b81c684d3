"""From a drawn flight to its records: what differs from record to record, and what only the truth keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from scenarios.hidden.anti_alias_filter import AntiAliasFilter
from scenarios.standin.drawing import ELEVATOR, Drawn, with_term
from scenarios.standin.maneuvers import CELL, Table
from sim.grid import make_grid
from sim.maneuvers import Maneuver
from sim.measurement import Measurement
from sim.model import Model
from sim.noise import dryden_gust, white_noise
from sim.record import Channel, Hold, Record
from sim.truth import fly, sample_times

SPEED = "speed-variation"


@dataclass(frozen=True, eq=False)
class FlownRecord:
    """A record, and what was true of it alone: mass, inertia, airspeed, density, trim, thrust above drag (m/s2) at the start."""

    record: Record
    constants: Mapping[str, float]


@dataclass(frozen=True)
class _Corner:
    corner: float


def fly_drawn(
    drawn: Drawn, rng: np.random.Generator, *, noise: bool = True, step: float | None = None, count: int | None = None
) -> tuple[FlownRecord, ...]:
    """All records of a flight, or the first ``count``, each from a generator of its own.

    ``noise`` False leaves out the sensors' noise (the elevator's stays: it is one of the small causes); ``step`` in s, else the declared one.
    """
    own = rng.spawn(len(drawn.maneuvers))[:count]
    return tuple(_fly(drawn, number, generator, noise, step or drawn.standin.flight.step) for number, generator in enumerate(own))


def _fly(drawn: Drawn, number: int, rng: np.random.Generator, noise: bool, step: float) -> FlownRecord:
    flight, causes = drawn.standin.flight, drawn.standin.causes
    scatter, path_seed, sensor_seed = rng.spawn(3)
    model, thrust = drawn.model, 0.0
    for dominant in drawn.hidden:
        if number not in dominant.records:
            continue
        if dominant.name == SPEED:
            thrust += dominant.values["rate"]
        else:
            model = with_term(model, dominant.effect, dominant.values)
    constants, zero = _scattered(model, drawn, scatter)
    constants["thrust"] = thrust + causes.speed_drift * constants["airspeed"] / flight.duration * scatter.standard_normal()
    model = model.with_values({key: constants[key] for key in ("mass", "pitch_inertia", "airspeed", "air_density", "trim_alpha")})
    time = sample_times(drawn.rate, flight.duration)
    moves: dict[str, Maneuver] = {ELEVATOR: drawn.maneuvers[number], "updraft": _gusts(drawn, constants["airspeed"], path_seed)}
    moves["thrust"] = Table(np.full(2, constants["thrust"]), flight.duration)
    std = {name: causes.noise_std[name] for name in drawn.channels if noise and causes.noise_std.get(name, 0.0) > 0}
    sensors = Measurement(std=std, correlation_time=dict.fromkeys(std, causes.noise_time) if causes.noise_time else {})
    name = f"record_{number + 1}"
    record, _ = fly(model, moves, time, sensor_seed, measurement=sensors, step=step, outputs=drawn.channels, name=name)
    elevator = _recorded(drawn, time, step, drawn.maneuvers[number]) + zero + white_noise(path_seed, len(time), causes.input_noise)
    levels = {"alpha": constants["trim_alpha"], "nz": 1.0} if flight.total else {}
    outputs = tuple(Channel.of(c.name, c.unit, c.values + levels[c.name]) if c.name in levels else c for c in record.outputs)
    return FlownRecord(replace(record, inputs=(Channel.of(ELEVATOR, "rad", elevator),), outputs=outputs, hold=Hold.LINEAR), constants)


def _scattered(model: Model, drawn: Drawn, rng: np.random.Generator) -> tuple[dict[str, float], float]:
    """Constants of one record, and where its elevator's trim lies, rad."""
    causes, p = drawn.standin.causes, model.parameters
    shares = {"mass": causes.mass_scatter, "pitch_inertia": causes.inertia_scatter, "airspeed": causes.airspeed_scatter}
    shares["air_density"] = causes.density_scatter
    constants = {key: p[key].value * (1.0 + share * float(rng.standard_normal())) for key, share in shares.items()}
    constants["trim_alpha"] = p["trim_alpha"].value + causes.trim_scatter * float(rng.standard_normal())
    return constants, causes.trim_scatter * float(rng.standard_normal())


def _gusts(drawn: Drawn, airspeed: float, rng: np.random.Generator) -> Table:
    flight, causes = drawn.standin.flight, drawn.standin.causes
    times = CELL * np.arange(int(flight.duration / CELL) + 2)
    return Table(dryden_gust(rng, times, causes.turbulence, causes.turbulence_length, airspeed), CELL)


def _recorded(drawn: Drawn, time: np.ndarray, step: float, maneuver: Table) -> np.ndarray:
    """The elevator as its own filtered channel shows it."""
    if not drawn.corners:
        return maneuver(time)
    grid = make_grid(time, step)
    begin, end = maneuver(grid.edges), maneuver.before(grid.edges[1:])
    filtered, _ = AntiAliasFilter(ELEVATOR).act(grid.steps, begin, end, _Corner(drawn.corners[ELEVATOR]))
    return np.asarray(filtered)[grid.sample]
