"""Many flights of one model at once: the truth generator of campaigns whose flights differ in
numbers and inputs only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sim.declaration.compile import compile_model
from sim.declaration.effect import InputEffect
from sim.declaration.model import Model, System
from sim.errors import ModelError
from sim.maneuvers import Maneuver, Sum
from sim.propagation import Drive, Grid, Step, make_grid, outputs_at_samples, propagate, rk4_step
from sim.truth.flight import drive_from_maneuvers, refuse_divergence


def fly_side_by_side(
    model: Model,
    values: Mapping[str, np.ndarray],
    maneuvers: Mapping[str, Sequence[Maneuver]],
    time: np.ndarray,
    *,
    step: float = 0.001,
    method: Step = rk4_step,
    outputs: Sequence[str] | None = None,
) -> dict[str, np.ndarray]:
    """Outputs ``(N, B)`` by name of ``B`` flights, without measurement noise: what
    `sim.truth.flight.fly` gives one by one, to rounding.

    Parameters
    ----------
    values : parameters that differ, ``(B,)`` each; none that acts on an input.
    maneuvers : by input, one a flight; inputs not named rest at zero. The same object is worked out
    once. time, step, method, outputs : as those of ``fly``.

    Raises
    ------
    ModelError : a parameter of the input path that differs, random forcing, a simulation that
    diverges.
    """
    system = compile_model(model, outputs)
    grid = make_grid(np.asarray(time, dtype=float), step)
    p: list[Any] = system.parameters.values().tolist()
    if system.input_parameters.intersection(values) or any(
        density > 0 for density in system.noise(p)[0]
    ):
        what = "random forcing, or an input path that differs from flight to flight"
        raise ModelError(what, where=f"model {model.name}", remedy="fly them one by one")
    drive = _drive(model, system, p, maneuvers, grid)
    for name, column in values.items():
        p[system.parameters.index(name)] = np.asarray(column, dtype=float)
    states = propagate(system, p, system.initial.values().tolist(), drive, grid, method)
    refuse_divergence(model, grid, [row.reshape(len(row), -1).sum(axis=1) for row in states])
    observe = _through_sensors if system.sensor_stages else outputs_at_samples
    rows = observe(system, p, states, drive, grid)
    return {
        name: np.array(row, dtype=float)
        for name, row in zip(system.output_names, rows, strict=True)
    }


def _drive(
    model: Model,
    system: System,
    p: Sequence[float],
    maneuvers: Mapping[str, Sequence[Maneuver]],
    grid: Grid,
) -> Drive:
    """Compute each input alone, and each maneuver once."""
    acted = {effect.signal for effect in model.effects if isinstance(effect, InputEffect)}
    untouched = replace(system, input_path=lambda p, u, edges: list(u))
    drives = []
    for i, name in enumerate(system.input_names):
        flown = maneuvers.get(name, (Sum(),))
        one = {id(move): move for move in flown}
        column = {key: at for at, key in enumerate(one)}
        take = np.array([column[id(move)] for move in flown])
        rest: tuple[Maneuver, ...] = tuple(Sum() for _ in system.inputs)
        through = system if name in acted else untouched
        parts = [
            drive_from_maneuvers(through, p, (*rest[:i], move, *rest[i + 1 :]), grid)
            for move in one.values()
        ]
        begin, end = (
            [_wide([getattr(part, side)[i] for part in parts], take)] for side in ("begin", "end")
        )
        first, middle, last = (
            [_wide([part.stages[s][i] for part in parts], take)] for s in range(3)
        )
        drives.append(Drive((first, middle, last), begin, end))
    stages = [[row for drive in drives for row in drive.stages[s]] for s in range(3)]
    return Drive(
        (stages[0], stages[1], stages[2]),
        [row for d in drives for row in d.begin],
        [row for d in drives for row in d.end],
    )


def _wide(rows: Sequence[np.ndarray], take: np.ndarray) -> np.ndarray:
    """Return one column for each flight; a maneuver that all flights have stays one row."""
    return np.asarray(rows[0], dtype=float) if len(rows) == 1 else np.stack(rows, axis=1)[:, take]


def _through_sensors(
    system: System, p: Sequence[Any], states: Sequence[np.ndarray], drive: Drive, grid: Grid
) -> list[np.ndarray]:
    """Apply sensors with memory flight by flight, since not all of them broadcast."""
    flights = np.shape(states[0])[1:]
    rows = [np.empty((len(grid.sample), *flights)) for _ in system.outputs]
    for index in np.ndindex(flights):
        at = (slice(None), *index)
        mine = [value[index] if np.ndim(value) else value for value in p]

        def own(inputs: list[Any], at: tuple[Any, ...] = at) -> list[Any]:
            return [row[at] if np.ndim(row) > 1 else row for row in inputs]

        first, middle, last = (own(stage) for stage in drive.stages)
        alone = Drive((first, middle, last), own(drive.begin), own(drive.end))
        for row, values in zip(
            rows,
            outputs_at_samples(system, mine, [state[at] for state in states], alone, grid),
            strict=True,
        ):
            row[at] = values
    return rows
