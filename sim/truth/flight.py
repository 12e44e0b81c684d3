"""The truth generator: fly a model through maneuvers, and measure what it does.

``fly`` returns what a test engineer would hand over, the Record, and apart from it the Truth that
only a study may open. The simulation steps finer than an estimator does and meets every switch of a
maneuver at its own time, by exact means of the input over sub-steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.declaration.parameters import ParameterSet
from sim.declaration.system import System
from sim.errors import ModelError
from sim.maneuvers.steps import Maneuver, Sum
from sim.propagation.grid import Drive, Grid, cell_edges, drive_from_cells, drive_from_means, make_grid
from sim.propagation.integrate import Step, outputs_at_samples, propagate, rk4_step
from sim.record import Channel, Record
from sim.truth.measurement import Measurement, measure
from sim.truth.random_forcing import outputs_with_walks, propagate_with_process_noise


class Distance(Enum):
    """How far a truth is from the model that will be fitted to it: the nearer, the easier the test ("inverse crime")."""

    SAME_EQUATIONS = "same equations and step"
    OTHER_STEP = "same equations, finer step"
    OTHER_VALUES = "same equations, other parameter values than the start"
    EFFECT_MISSING = "an effect is missing in the model, but is in the library"
    OTHER_FORM = "an effect is missing in the model, and of another form than in the library"
    NOTHING_FITS = "something acts that nothing in the library describes"
    MEASURED = "measured data: no truth is known"


@dataclass(frozen=True, eq=False)
class Truth:
    """What really happened; for scoring only, never for an estimator.

    Attributes
    ----------
    parameters : true values with units, those of effects included; of a random walk the start.
    effects : names of the effects that acted.
    time : ``(N,)`` s, the record's.
    states, outputs : by name, ``(N,)`` each, without measurement noise; outputs as the sensors would pass them on.
    walks : by name, ``(N,)``, parameters that drifted.
    noise_std : standard deviation of the measurement noise by output, zero where there was none.
    process_density : spectral density of the forcing that acted, by state or parameter.
    distance : how far this is from the model to be fitted.
    step, method : size (s) and name of the integration step.
    """

    parameters: ParameterSet
    effects: tuple[str, ...]
    time: np.ndarray
    states: Mapping[str, np.ndarray]
    outputs: Mapping[str, np.ndarray]
    walks: Mapping[str, np.ndarray]
    noise_std: Mapping[str, float]
    process_density: Mapping[str, float]
    distance: Distance
    step: float
    method: str


def sample_times(rate: float, duration: float, start: float = 0.0) -> np.ndarray:
    """Even sample times from ``start`` to ``start + duration`` inclusive, s; ``rate`` in 1/s. Shape ``(N,)``."""
    if not (rate > 0 and duration > 0 and np.isfinite(rate * duration)) or round(rate * duration) < 1:
        raise ModelError(f"{duration:g} s at {rate:g} samples a second", where="sample times", remedy="give a rate and a duration above zero")
    return start + np.arange(round(rate * duration) + 1) / rate


def fly(
    model: Model,
    maneuvers: Mapping[str, Maneuver] | Maneuver | None,
    time: np.ndarray,
    rng: np.random.Generator,
    *,
    measurement: Measurement | None = None,
    step: float = 0.001,
    method: Step = rk4_step,
    outputs: Sequence[str] | None = None,
    distance: Distance = Distance.OTHER_STEP,
    name: str = "record",
) -> tuple[Record, Truth]:
    """Simulate a model and measure it.

    Parameters
    ----------
    model : its parameter values, initial state and noise are the true ones. ``noise.process_density`` forces
        states by white noise, increments of variance density x step after each step, and lets parameters drift in a random walk.
    maneuvers : by input, or one for the only input; inputs not named rest at zero.
    time : ``(N,)`` s, sample times, uneven if wanted; see ``sample_times``.
    rng : the one source of randomness; the same state gives the same bytes.
    measurement : None for white noise of the model's ``measurement_std``.
    step, method : largest integration step, s, and the integrator.
    outputs : those recorded, all when None.
    distance : stated by the caller, kept in the Truth.

    Returns
    -------
    The record, inputs sampled at the switch with their new value, and the truth.

    Raises
    ------
    ModelError : an unknown input or output, a random walk of an unknown parameter, a simulation that diverges.
    """
    system = compile_model(model, outputs)
    by_input = _assigned(system, maneuvers)
    grid = make_grid(np.asarray(time, dtype=float), step)
    moved = _propagated(model, system, by_input, grid, method, rng)
    at = grid.sample
    measured = measurement or Measurement()
    std = model.noise.measurement_std if measured.std is None else measured.std
    truth = Truth(
        parameters=model.parameters,
        effects=tuple(effect.name for effect in model.effects),
        time=np.array(time, dtype=float),
        states={key: row[at] for key, row in zip(system.state_names, moved.states, strict=True)},
        outputs={key: np.array(row, dtype=float) for key, row in zip(system.output_names, moved.outputs, strict=True)},
        walks={key: row[at] for key, row in moved.walks.items()},
        noise_std={key: float(std.get(key, 0.0)) for key in system.output_names},
        process_density=moved.density,
        distance=distance,
        step=float(grid.steps.max()),
        method=getattr(method, "__name__", type(method).__name__),
    )
    units = {signal.name: signal.unit for signal in system.outputs}
    channels = measure(truth.time, truth.outputs, units, rng, replace(measured, std=truth.noise_std))
    return Record(truth.time, _recorded_inputs(system, by_input, truth.time), channels, Sum(by_input).hold, name), truth


def _recorded_inputs(system: System, by_input: tuple[Maneuver, ...], time: np.ndarray) -> tuple[Channel, ...]:
    return tuple(
        Channel.of(signal.name, signal.unit, np.broadcast_to(maneuver(time), time.shape))
        for signal, maneuver in zip(system.inputs, by_input, strict=True)
    )


@dataclass(frozen=True, eq=False)
class _Motion:
    """States and random walks at the nodes of the grid, outputs without noise at the samples, and what forced them."""

    states: Sequence[Any]
    walks: Mapping[str, np.ndarray]
    outputs: Sequence[Any]
    density: Mapping[str, float]


def _propagated(model: Model, system: System, by_input: tuple[Maneuver, ...], grid: Grid, method: Step, rng: np.random.Generator) -> _Motion:
    p = system.parameters.values().tolist()
    drive = drive_from_maneuvers(system, p, by_input, grid)
    densities = {key: value for key, value in zip(system.state_names, system.noise(p)[0], strict=True) if value > 0}
    walking = _walking(model, system)
    if densities or walking:
        states, walks = propagate_with_process_noise(system, p, drive, grid, method, densities, walking, rng)
    else:
        states, walks = propagate(system, p, system.initial.values().tolist(), drive, grid, method), {}
    refuse_divergence(model, grid, states)
    clean = outputs_with_walks(system, p, states, walks, drive, grid) if walks else outputs_at_samples(system, p, states, drive, grid)
    return _Motion(states, walks, clean, {**densities, **walking})


def remeasure(record: Record, truth: Truth, rng: np.random.Generator, measurement: Measurement | None = None) -> Record:
    """The same flight measured again with fresh noise, at no cost of simulation; None repeats white noise of the truth's ``noise_std``."""
    again = measurement or Measurement()
    std = truth.noise_std if again.std is None else again.std
    units = {channel.name: channel.unit for channel in record.outputs}
    return replace(record, outputs=measure(truth.time, truth.outputs, units, rng, replace(again, std=std)))


def _assigned(system: System, maneuvers: Mapping[str, Maneuver] | Maneuver | None) -> tuple[Maneuver, ...]:
    names = system.input_names
    if maneuvers is None:
        table: Mapping[str, Maneuver] = {}
    elif isinstance(maneuvers, Mapping):
        table = maneuvers
    elif len(names) == 1:
        table = {names[0]: maneuvers}
    else:
        raise ModelError(
            f"one maneuver for {len(names)} inputs", where="fly", remedy=f"give a mapping by input: {', '.join(names) or 'there is none'}"
        )
    for key in table:
        if key not in names:
            raise ModelError(f"there is no input {key!r}", where="fly", remedy=f"the inputs are {', '.join(names) or 'none'}")
    return tuple(table.get(key, Sum()) for key in names)


def drive_from_maneuvers(system: System, p: Sequence[float], by_input: tuple[Maneuver, ...], grid: Grid) -> Drive:
    """Inputs at the vehicle for one maneuver an input, every switch at its own time."""
    if system.input_stages:
        edges = cell_edges(grid)
        return drive_from_cells(system, p, [maneuver.mean(edges[:-1], edges[1:]) for maneuver in by_input], edges, grid)
    a, b = grid.edges[:-1], grid.edges[1:]
    means = [maneuver.mean(a, b) for maneuver in by_input]
    begin, end = [maneuver(grid.edges) for maneuver in by_input], [maneuver.before(b) for maneuver in by_input]
    drive = drive_from_means(means, begin, end)
    # Where the input is smooth within a sub-step its values at the stages keep the integrator's order; elsewhere the mean serves.
    stages: tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]] = ([], [], [])
    for maneuver, mean, first, last in zip(by_input, means, begin, end, strict=True):
        smooth = _without_break(maneuver, a, b)
        for stage, value in zip(stages, (first[:-1], maneuver(0.5 * (a + b)), last), strict=True):
            stage.append(np.where(smooth, value, mean))
    return replace(drive, stages=stages)


def _without_break(maneuver: Maneuver, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Which sub-steps hold no switch strictly inside."""
    if not maneuver.breakpoints:
        return np.ones(a.shape, dtype=bool)
    breaks = np.asarray(maneuver.breakpoints)
    return np.searchsorted(breaks, a, side="right") >= np.searchsorted(breaks, b, side="left")


def _walking(model: Model, system: System) -> dict[str, float]:
    walking = {}
    for key, density in model.noise.process_density.items():
        if key in system.state_names:
            continue
        if key not in model.parameters:
            raise ModelError(
                "process noise on neither a state nor a parameter",
                where=f"model {model.name}, {key}",
                remedy=f"its states are {', '.join(system.state_names)}",
            )
        if density > 0:
            walking[key] = density
    return walking


def refuse_divergence(model: Model, grid: Grid, states: Sequence[np.ndarray]) -> None:
    """ModelError with the time from which states ``(M + 1,)`` at the edges are not finite."""
    finite = np.all(np.isfinite(states), axis=0)
    if not np.all(finite):
        when = grid.edges[int(np.argmin(finite))]
        raise ModelError(
            f"the simulation diverges at {when:.4g} s", where=f"model {model.name}", remedy="shorten the flight or check the parameter values"
        )
