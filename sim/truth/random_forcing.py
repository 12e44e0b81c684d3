"""Propagation under random forcing: white noise on the rates of states, and parameters that drift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim.declaration.system import System
from sim.propagation.grid import Drive, Grid
from sim.propagation.integrate import Step


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
    """States at all edges under white forcing, and parameters in random walk; the forcing is additive, so Euler-Maruyama's order is 1."""
    root = np.sqrt(grid.steps)
    walks = {key: np.empty(len(grid.edges)) for key in walking}
    for key, density in walking.items():
        walks[key][0] = p[system.parameters.index(key)]
        walks[key][1:] = walks[key][0] + np.cumsum(np.sqrt(density) * root * rng.standard_normal(len(root)))
    kicks = {system.state_names.index(key): (np.sqrt(value) * root * rng.standard_normal(len(root))).tolist() for key, value in densities.items()}
    drifting = {system.parameters.index(key): row.tolist() for key, row in walks.items()}
    x, p = system.initial.values().tolist(), list(p)
    history = np.empty((len(x), len(grid.edges)))
    history[:, 0] = x
    stages = [[row.tolist() for row in stage] for stage in drive.stages]
    for m, (t, dt) in enumerate(zip(grid.edges[:-1].tolist(), grid.steps.tolist(), strict=True)):
        for index, walk in drifting.items():
            p[index] = walk[m]
        try:
            x = method(system.f, t, x, ([row[m] for row in stages[0]], [row[m] for row in stages[1]], [row[m] for row in stages[2]]), p, dt)
        except (OverflowError, ZeroDivisionError):
            history[:, m + 1 :] = np.inf
            break
        for index, kick in kicks.items():
            x[index] += kick[m]
        history[:, m + 1] = x
    return list(history), walks


def outputs_with_walks(
    system: System, p: Sequence[float], states: Sequence[np.ndarray], walks: Mapping[str, np.ndarray], drive: Drive, grid: Grid
) -> list[np.ndarray]:
    rows: list[object] = list(p)
    for key, walk in walks.items():
        rows[system.parameters.index(key)] = walk
    shape = grid.edges.shape
    begin = [np.broadcast_to(y, shape) for y in system.h(grid.edges, states, drive.begin, rows)]
    if system.sensor_stages:
        for key, walk in walks.items():
            rows[system.parameters.index(key)] = walk[1:]
        end = [np.broadcast_to(y, shape[0] - 1) for y in system.h(grid.edges[1:], [row[1:] for row in states], drive.end, rows)]
        begin, _ = system.sensor_path(p, begin, end, grid.steps)
    return [row[grid.sample] for row in begin]
