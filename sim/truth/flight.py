"""The truth generator: flies a model through maneuvers, with random forcing where declared, and
measures it.

``fly`` returns what a test engineer would hand over, the Record, and apart from it the Truth that
only a study may open. The motion is exact to a tolerance far below any sensor's noise, or goes in
steps finer than an estimator's, and meets every switch of a maneuver at its own time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

import numpy as np

from sim.declaration.compile import compile_model
from sim.declaration.effect import ParameterSet
from sim.declaration.model import Model, System
from sim.errors import ModelError
from sim.maneuvers import Maneuver, Sum
from sim.propagation import (
    Drive,
    Grid,
    InputsAt,
    Step,
    cell_edges,
    drive_from_cells,
    drive_from_means,
    exact_motion,
    make_grid,
    outputs_at_samples,
    propagate,
    rk4_step,
    smooth_motion,
)
from sim.record import Channel, Hold, Record
from sim.truth.measurement import Measurement, measure

# ---- Propagation under random forcing


def propagate_with_process_noise(
    system: System,
    p: Sequence[float],
    drive: Drive,
    grid: Grid,
    method: Step,
    densities: Mapping[str, float],
    walking: Mapping[str, float],
    rng: np.random.Generator,
) -> tuple[list[np.ndarray], dict[str, np.ndarray]]:
    """States at all edges under white forcing, and parameters in random walk; the forcing is
    additive, so Euler-Maruyama's order is 1.
    """
    root = np.sqrt(grid.steps)
    walks = {key: np.empty(len(grid.edges)) for key in walking}
    for key, density in walking.items():
        walks[key][0] = p[system.parameters.index(key)]
        walks[key][1:] = walks[key][0] + np.cumsum(
            np.sqrt(density) * root * rng.standard_normal(len(root))
        )
    kicks = {
        system.state_names.index(key): (
            np.sqrt(value) * root * rng.standard_normal(len(root))
        ).tolist()
        for key, value in densities.items()
    }
    drifting = {system.parameters.index(key): row.tolist() for key, row in walks.items()}
    x, p = system.initial.values().tolist(), list(p)
    history = np.empty((len(x), len(grid.edges)))
    history[:, 0] = x
    stages = [[row.tolist() for row in stage] for stage in drive.stages]
    for m, (t, dt) in enumerate(zip(grid.edges[:-1].tolist(), grid.steps.tolist(), strict=True)):
        for index, walk in drifting.items():
            p[index] = walk[m]
        try:
            x = method(
                system.f,
                t,
                x,
                (
                    [row[m] for row in stages[0]],
                    [row[m] for row in stages[1]],
                    [row[m] for row in stages[2]],
                ),
                p,
                dt,
            )
        except (OverflowError, ZeroDivisionError):
            history[:, m + 1 :] = np.inf
            break
        for index, kick in kicks.items():
            x[index] += kick[m]
        history[:, m + 1] = x
    return list(history), walks


def outputs_with_walks(
    system: System,
    p: Sequence[float],
    states: Sequence[np.ndarray],
    walks: Mapping[str, np.ndarray],
    drive: Drive,
    grid: Grid,
) -> list[np.ndarray]:
    rows: list[object] = list(p)
    for key, walk in walks.items():
        rows[system.parameters.index(key)] = walk
    shape = grid.edges.shape
    begin = [np.broadcast_to(y, shape) for y in system.h(grid.edges, states, drive.begin, rows)]
    if system.sensor_stages:
        for key, walk in walks.items():
            rows[system.parameters.index(key)] = walk[1:]
        end = [
            np.broadcast_to(y, shape[0] - 1)
            for y in system.h(grid.edges[1:], [row[1:] for row in states], drive.end, rows)
        ]
        begin, _ = system.sensor_path(p, begin, end, grid.steps)
    return [row[grid.sample] for row in begin]


# ---- Inputs at the vehicle for maneuvers: every switch at its own time, whatever the grid


def drive_from_maneuvers(
    system: System, p: Sequence[float], by_input: tuple[Maneuver, ...], grid: Grid
) -> Drive:
    """Inputs at the vehicle for one maneuver an input, every switch at its own time."""
    if system.input_stages:
        edges = cell_edges(grid)
        return drive_from_cells(
            system, p, [maneuver.mean(edges[:-1], edges[1:]) for maneuver in by_input], edges, grid
        )
    a, b = grid.edges[:-1], grid.edges[1:]
    means = [maneuver.mean(a, b) for maneuver in by_input]
    begin = [maneuver(grid.edges) for maneuver in by_input]
    end = [maneuver.before(b) for maneuver in by_input]
    drive = drive_from_means(means, begin, end)
    # Where the input is smooth within a sub-step its values at the stages keep the integrator's
    # order; elsewhere the mean serves.
    stages: tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]] = ([], [], [])
    for maneuver, mean, first, last in zip(by_input, means, begin, end, strict=True):
        smooth = _without_break(maneuver, a, b)
        for stage, value in zip(stages, (first[:-1], maneuver(0.5 * (a + b)), last), strict=True):
            stage.append(np.where(smooth, value, mean))
    return replace(drive, stages=stages)


def _without_break(maneuver: Maneuver, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return whether sub-steps have no switch strictly inside."""
    if not maneuver.breakpoints:
        return np.ones(a.shape, dtype=bool)
    breaks = np.asarray(maneuver.breakpoints)
    return np.searchsorted(breaks, a, side="right") >= np.searchsorted(breaks, b, side="left")


# ---- The motion of a true aircraft to a tolerance

EXACT = "exact, linear"  # exact solution of linear equations
SMOOTH = "LSODA"  # SciPy's integrator for smooth inputs
INTEGRATION_TOLERANCE = 1e-9  # of the motion's size, at the end of a flight


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """States ``(N,)`` each, and by which method they were found: ``EXACT`` or ``SMOOTH``."""

    states: list[np.ndarray]
    method: str


def by_tolerance(
    system: System, p: Sequence[float], by_input: tuple[Maneuver, ...], time: np.ndarray
) -> SimulatedMotion | None:
    """Motion at ``time`` (s, ``(N,)``) within ``INTEGRATION_TOLERANCE``, inputs as the maneuvers
    give them; None where no method keeps it.

    None too for effects on the input path: they act on means over cells, and so do not leave inputs
    that are functions of time.
    """
    if system.input_stages:
        return None
    breaks = Sum(by_input).breakpoints
    x0 = system.initial.values().tolist()
    states = exact_motion(
        system, p, x0, lambda t: [maneuver(t) for maneuver in by_input], breaks, time
    )
    if states is not None:
        return SimulatedMotion(list(states), EXACT)
    states = smooth_motion(
        system, p, x0, lambda begin, end: _between(by_input, begin, end), breaks, time
    )
    return None if states is None else SimulatedMotion(list(states), SMOOTH)


def _between(by_input: tuple[Maneuver, ...], begin: float, end: float) -> InputsAt:
    """Inputs from one break to the next: a held one by its level, others up to the break and not
    beyond it.
    """
    if all(maneuver.hold is Hold.PREVIOUS for maneuver in by_input):
        input_values = [float(maneuver(0.5 * (begin + end))) for maneuver in by_input]
        return lambda t: input_values
    last = [float(maneuver.before(end)) for maneuver in by_input]
    return lambda t: [float(maneuver(t)) for maneuver in by_input] if t < end - 1e-9 else last


# ---- The truth generator: fly a model through maneuvers, and measure what it does


class Distance(Enum):
    """Difference between the truth and the model that will be fitted: the smaller, the easier the
    test ("inverse crime").
    """

    SAME_EQUATIONS = "same equations and step"
    OTHER_STEP = "same equations, finer step"
    OTHER_VALUES = "same equations, other parameter values than the start"
    EFFECT_MISSING = "an effect is missing in the model, but is in the library"
    OTHER_FORM = "an effect is missing in the model, and of another form than in the library"
    NOTHING_FITS = "something acts that nothing in the library describes"
    MEASURED = "measured data: no truth is known"


@dataclass(frozen=True, eq=False)
class Truth:
    """The true simulation; for scoring only, never for an estimator.

    Attributes
    ----------
    parameters : true values with units, those of effects included; of a random walk the start.
    effects : names of the effects that acted.
    time : ``(N,)`` s, the record's.
    states, outputs : by name, ``(N,)`` each, without measurement noise; outputs as the sensors
        would pass them on.
    walks : by name, ``(N,)``, parameters that drifted.
    noise_std : standard deviation of the measurement noise by output, zero where there was none.
    process_density : spectral density of the forcing that acted, by state or parameter.
    distance : how far this is from the model to be fitted.
    step, method : largest integration step, s, and the integrator's name; no step where the motion
        was found to a tolerance.
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
    step: float | None
    method: str


def sample_times(rate: float, duration: float, start: float = 0.0) -> np.ndarray:
    """Even sample times from ``start`` to ``start + duration`` inclusive, s; ``rate`` in 1/s. Shape
    ``(N,)``.
    """
    if (
        not (rate > 0 and duration > 0 and np.isfinite(rate * duration))
        or round(rate * duration) < 1
    ):
        raise ModelError(
            f"{duration:g} s at {rate:g} samples a second",
            where="sample times",
            remedy="give a rate and a duration above zero",
        )
    return start + np.arange(round(rate * duration) + 1) / rate


def fly(
    model: Model,
    maneuvers: Mapping[str, Maneuver] | Maneuver | None,
    time: np.ndarray,
    rng: np.random.Generator,
    *,
    measurement: Measurement | None = None,
    step: float = 0.001,
    method: Step | None = None,
    outputs: Sequence[str] | None = None,
    distance: Distance = Distance.OTHER_STEP,
    name: str = "record",
) -> tuple[Record, Truth]:
    """Simulate a model and measure it.

    Parameters
    ----------
    model : its parameter values, initial state and noise are the true ones.
        ``noise.process_density`` forces states by white noise, increments of variance density x
        step after each step, and lets parameters drift in a random walk.
    maneuvers : by input, or one for the only input; inputs not named rest at zero.
    time : ``(N,)`` s, sample times, uneven if wanted; see ``sample_times``.
    rng : the one source of randomness; the same state gives the same bytes.
    measurement : None for white noise of the model's ``measurement_std``.
    method : an integrator that goes in steps, or None for the exact motion of what is linear and
        else LSODA, to a tolerance of 1e-9; where random forcing or effects on the input path act,
        or no solver keeps that tolerance, Runge-Kutta's of order 4 in its place.
    step : largest step of an integrator and of sensors with memory, s.
    outputs : those recorded, all when None.
    distance : stated by the caller, kept in the Truth.

    Returns
    -------
    The record, inputs sampled at the switch with their new value, and the truth.

    Raises
    ------
    ModelError : an unknown input or output, a random walk of an unknown parameter, a simulation
        that diverges.
    """
    system = compile_model(model, outputs)
    by_input = _assigned(system, maneuvers)
    moved = _propagated(model, system, by_input, np.asarray(time, dtype=float), step, method, rng)
    at = moved.sample
    measured = measurement or Measurement()
    std = model.noise.measurement_std if measured.std is None else measured.std
    truth = Truth(
        parameters=model.parameters,
        effects=tuple(effect.name for effect in model.effects),
        time=np.array(time, dtype=float),
        states={key: row[at] for key, row in zip(system.state_names, moved.states, strict=True)},
        outputs={
            key: np.array(row, dtype=float)
            for key, row in zip(system.output_names, moved.outputs, strict=True)
        },
        walks={key: row[at] for key, row in moved.walks.items()},
        noise_std={key: float(std.get(key, 0.0)) for key in system.output_names},
        process_density=moved.density,
        distance=distance,
        step=moved.step,
        method=moved.method,
    )
    units = {signal.name: signal.unit for signal in system.outputs}
    channels = measure(
        truth.time, truth.outputs, units, rng, replace(measured, std=truth.noise_std)
    )
    return Record(
        truth.time,
        _recorded_inputs(system, by_input, truth.time),
        channels,
        Sum(by_input).hold,
        name,
    ), truth


def _recorded_inputs(
    system: System, by_input: tuple[Maneuver, ...], time: np.ndarray
) -> tuple[Channel, ...]:
    return tuple(
        Channel.of(signal.name, signal.unit, np.broadcast_to(maneuver(time), time.shape))
        for signal, maneuver in zip(system.inputs, by_input, strict=True)
    )


@dataclass(frozen=True, eq=False)
class _GridStates:
    """States and random walks at the edges of a grid that contains the samples, noise-free outputs
    there, and the integration method.
    """

    states: Sequence[Any]
    walks: Mapping[str, np.ndarray]
    sample: np.ndarray
    outputs: Sequence[Any]
    density: Mapping[str, float]
    step: float | None
    method: str


def _propagated(
    model: Model,
    system: System,
    by_input: tuple[Maneuver, ...],
    time: np.ndarray,
    step: float,
    method: Step | None,
    rng: np.random.Generator,
) -> _GridStates:
    p = system.parameters.values().tolist()
    densities = {
        key: value
        for key, value in zip(system.state_names, system.noise(p)[0], strict=True)
        if value > 0
    }
    walking = _walking(model, system)
    if method is None and not densities and not walking:
        # Sensors with memory act on what passes between samples.
        grid = make_grid(time, step if system.sensor_stages else np.inf)
        result = by_tolerance(system, p, by_input, grid.edges)
        if result is not None:
            clean = outputs_at_samples(
                system, p, result.states, drive_from_maneuvers(system, p, by_input, grid), grid
            )
            return _GridStates(result.states, {}, grid.sample, clean, {}, None, result.method)
    grid, method = make_grid(time, step), method or rk4_step
    drive = drive_from_maneuvers(system, p, by_input, grid)
    if densities or walking:
        states, walks = propagate_with_process_noise(
            system, p, drive, grid, method, densities, walking, rng
        )
    else:
        states = propagate(system, p, system.initial.values().tolist(), drive, grid, method)
        walks = {}
    refuse_divergence(model, grid, states)
    clean = (
        outputs_with_walks(system, p, states, walks, drive, grid)
        if walks
        else outputs_at_samples(system, p, states, drive, grid)
    )
    named = getattr(method, "__name__", type(method).__name__)
    return _GridStates(
        states, walks, grid.sample, clean, {**densities, **walking}, float(grid.steps.max()), named
    )


def remeasure(record: Record, truth: Truth, rng: np.random.Generator) -> Record:
    """Return the same flight with fresh white measurement noise of the truth's ``noise_std``,
    without a new simulation.
    """
    units = {channel.name: channel.unit for channel in record.outputs}
    return replace(
        record,
        outputs=measure(truth.time, truth.outputs, units, rng, Measurement(std=truth.noise_std)),
    )


def _assigned(
    system: System, maneuvers: Mapping[str, Maneuver] | Maneuver | None
) -> tuple[Maneuver, ...]:
    names = system.input_names
    if maneuvers is None:
        table: Mapping[str, Maneuver] = {}
    elif isinstance(maneuvers, Mapping):
        table = maneuvers
    elif len(names) == 1:
        table = {names[0]: maneuvers}
    else:
        raise ModelError(
            f"one maneuver for {len(names)} inputs",
            where="fly",
            remedy=f"give a mapping by input: {', '.join(names) or 'there is none'}",
        )
    for key in table:
        if key not in names:
            raise ModelError(
                f"there is no input {key!r}",
                where="fly",
                remedy=f"the inputs are {', '.join(names) or 'none'}",
            )
    return tuple(table.get(key, Sum()) for key in names)


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
            f"the simulation diverges at {when:.4g} s",
            where=f"model {model.name}",
            remedy="shorten the flight or check the parameter values",
        )
