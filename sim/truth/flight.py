"""Simulated flights: a model flies maneuvers, with random forcing if declared, and is measured.

``fly`` returns the Record, as a flight test gives it, and the Truth, which only a study may use.
The error of the motion is far below any sensor's noise, or the steps are finer than those of an
estimator. Inputs switch at the exact times of their maneuvers.
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
    Step,
    cell_edges,
    drive_from_cells,
    drive_from_means,
    make_grid,
    outputs_at_samples,
    propagate,
    rk4_step,
)
from sim.record import Channel, Hold, Record
from sim.truth.measurement import Measurement, measure
from sim.truth.motion import InputsAt, exact_motion, smooth_motion

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
    """Return states at all edges under white forcing, and the parameters that walk randomly.

    The forcing is added after each step. It is additive noise, so that Euler-Maruyama's method has
    the order 1.

    Parameters
    ----------
    p : parameters.
    drive, grid, method : inputs at the vehicle, time grid, and integrator.
    densities : state -> spectral density of its forcing.
    walking : parameter -> spectral density of its random walk.
    rng : source of the random numbers.

    Returns
    -------
    An array ``(M + 1,)`` for each state, and parameter -> ``(M + 1,)``.
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
    """Return the outputs ``(N,)`` at the samples, as ``outputs_at_samples``, with parameters that
    walk randomly: ``walks``, by name ``(M + 1,)`` at the edges.
    """
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


# ---- Inputs at the vehicle for maneuvers, whose switches need not be edges of the grid


def drive_from_maneuvers(
    system: System, p: Sequence[float], by_input: tuple[Maneuver, ...], grid: Grid
) -> Drive:
    """Return the inputs at the vehicle; ``by_input`` has a maneuver for each input.

    Means over sub-steps are exact, so that a switch inside a sub-step acts at its time.
    """
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
    # In sub-steps where the input is smooth, its values at the stages keep the integrator's order;
    # in others its mean is used.
    stages: tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]] = ([], [], [])
    for maneuver, mean, first, last in zip(by_input, means, begin, end, strict=True):
        smooth = _without_break(maneuver, a, b)
        for stage, value in zip(stages, (first[:-1], maneuver(0.5 * (a + b)), last), strict=True):
            stage.append(np.where(smooth, value, mean))
    return replace(drive, stages=stages)


def _without_break(maneuver: Maneuver, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return whether sub-steps from ``a`` to ``b`` have no switch strictly inside, ``(M,)``."""
    if not maneuver.breakpoints:
        return np.ones(a.shape, dtype=bool)
    breaks = np.asarray(maneuver.breakpoints)
    return np.searchsorted(breaks, a, side="right") >= np.searchsorted(breaks, b, side="left")


# ---- The motion of a true aircraft to a tolerance

EXACT = "exact, linear"  # exact solution of linear equations
SMOOTH = "LSODA"  # SciPy's integrator for smooth inputs
INTEGRATION_TOLERANCE = 1e-9  # error at the end of a flight, relative to the size of the motion


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """States ``(N,)`` each, and the method that gave them: ``EXACT`` or ``SMOOTH``."""

    states: list[np.ndarray]
    method: str


def motion_to_tolerance(
    system: System, p: Sequence[float], by_input: tuple[Maneuver, ...], time: np.ndarray
) -> SimulatedMotion | None:
    """Return the motion at ``time (N,)``, s, within ``INTEGRATION_TOLERANCE``.

    The result is None if no method keeps the tolerance. It is also None for effects on the input
    path: they act on means over cells, so that the inputs behind them are no functions of time.
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
    """Return the inputs from one break to the next (s), as a function of time.

    Held inputs are constant. Other inputs keep their last value from the second break on.
    """
    if all(maneuver.hold is Hold.PREVIOUS for maneuver in by_input):
        input_values = [float(maneuver(0.5 * (begin + end))) for maneuver in by_input]
        return lambda t: input_values
    last = [float(maneuver.before(end)) for maneuver in by_input]
    return lambda t: [float(maneuver(t)) for maneuver in by_input] if t < end - 1e-9 else last


# ---- The truth generator: a model flies maneuvers, and its outputs are measured


class Distance(Enum):
    """Difference between the truth and the model to be fitted.

    A small difference makes the test of an estimator too easy ("inverse crime").
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
    parameters : true values with units, those of effects included; the start of a random walk.
    effects : names of the effects that acted.
    time : ``(N,)``, s, that of the record.
    states, outputs : by name, ``(N,)`` each, without measurement noise; sensor effects act on the
        outputs.
    walks : by name, ``(N,)``, parameters that walked randomly.
    noise_std : output -> standard deviation of its measurement noise, zero without noise.
    process_density : state or parameter -> spectral density of its forcing.
    distance : difference from the model to be fitted.
    step, method : largest integration step, s, and name of the integrator; the step is None if the
        motion was computed to a tolerance.
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
    """Return even sample times ``(N,)`` from ``start`` to ``start + duration`` inclusive, s; the
    ``rate`` is in 1/s.
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
        ``noise.process_density`` forces states by white noise (increments with the variance density
        times step, after each step), and makes parameters walk randomly.
    maneuvers : by input, or the maneuver of the only input; inputs without one are zero.
    time : ``(N,)``, s, sample times, which may be uneven; see ``sample_times``.
    rng : source of all random numbers; the same state gives the same bytes.
    measurement : errors of the recording; None for white noise of the model's ``measurement_std``.
    method : integrator of fixed steps. None computes to a tolerance of 1e-9: linear models exactly,
        others by LSODA. With random forcing or effects on the input path, or if LSODA fails, None
        stands for Runge-Kutta's method of order 4.
    step : largest step of an integrator and of sensors with memory, s.
    outputs : recorded outputs; None for all.
    distance : difference from the model to be fitted, which the Truth states.
    name : name of the record.

    Returns
    -------
    The record and the truth. An input that is sampled at a switch has its new value.

    Raises
    ------
    ModelError : an input or output is unknown, a parameter that should walk is unknown, or the
        simulation diverges.
    """
    system = compile_model(model, outputs)
    by_input = _assigned(system, maneuvers)
    motion = _propagated(model, system, by_input, np.asarray(time, dtype=float), step, method, rng)
    samples = motion.sample
    measured = measurement or Measurement()
    std = model.noise.measurement_std if measured.std is None else measured.std
    truth = Truth(
        parameters=model.parameters,
        effects=tuple(effect.name for effect in model.effects),
        time=np.array(time, dtype=float),
        states={
            key: row[samples] for key, row in zip(system.state_names, motion.states, strict=True)
        },
        outputs={
            key: np.array(row, dtype=float)
            for key, row in zip(system.output_names, motion.outputs, strict=True)
        },
        walks={key: row[samples] for key, row in motion.walks.items()},
        noise_std={key: float(std.get(key, 0.0)) for key in system.output_names},
        process_density=motion.density,
        distance=distance,
        step=motion.step,
        method=motion.method,
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
    """Motion on a time grid that contains the samples.

    Attributes
    ----------
    states, walks : states and random walks at the edges of the grid.
    sample : indices of the samples among the edges.
    outputs : outputs at the samples, without noise.
    density : spectral density of the forcing, by state or parameter.
    step, method : largest step, s, or None, and name of the integrator.
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
    """Return the motion of a model; the parameters are those of ``fly``."""
    p = system.parameters.values().tolist()
    densities = {
        key: value
        for key, value in zip(system.state_names, system.noise(p)[0], strict=True)
        if value > 0
    }
    walking = _walking(model, system)
    if method is None and not densities and not walking:
        # Sensors with memory need the motion between samples.
        grid = make_grid(time, step if system.sensor_stages else np.inf)
        result = motion_to_tolerance(system, p, by_input, grid.edges)
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
    method_name = getattr(method, "__name__", type(method).__name__)
    largest_step = float(grid.steps.max())
    return _GridStates(
        states, walks, grid.sample, clean, {**densities, **walking}, largest_step, method_name
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
    """Return a maneuver for each input; an input at rest has an empty sum."""
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
    """Return parameter -> spectral density of its random walk.

    Raises
    ------
    ModelError : process noise is declared for neither a state nor a parameter.
    """
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
    """Raise ModelError with the time from which states ``(M + 1,)`` at the edges are not finite."""
    finite = np.all(np.isfinite(states), axis=0)
    if not np.all(finite):
        when = grid.edges[int(np.argmin(finite))]
        raise ModelError(
            f"the simulation diverges at {when:.4g} s",
            where=f"model {model.name}",
            remedy="shorten the flight or check the parameter values",
        )
