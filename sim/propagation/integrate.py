"""Integrators and the simulation of a System, one source for floats, batches and complex steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sim.declaration.system import System
from sim.maths.elementary import trailing
from sim.propagation.grid import Drive, Grid

Rates = Callable[[Any, Sequence[Any], Sequence[Any], Sequence[Any]], list[Any]]
Stages = tuple[Sequence[Any], Sequence[Any], Sequence[Any]]
Step = Callable[[Rates, Any, Sequence[Any], Stages, Sequence[Any], Any], list[Any]]


def euler_step(f: Rates, t: Any, x: Sequence[Any], u: Stages, p: Sequence[Any], dt: Any) -> list[Any]:
    """One explicit Euler step of size ``dt``; order 1. ``u`` are inputs at begin, middle, end."""
    return [value + dt * rate for value, rate in zip(x, f(t, x, u[0], p), strict=True)]


def rk4_step(f: Rates, t: Any, x: Sequence[Any], u: Stages, p: Sequence[Any], dt: Any) -> list[Any]:
    """One classical Runge-Kutta step of size ``dt``; order 4. ``u`` are inputs at begin, middle, end."""
    half = 0.5 * dt
    k1 = f(t, x, u[0], p)
    k2 = f(t + half, [a + half * b for a, b in zip(x, k1, strict=True)], u[1], p)
    k3 = f(t + half, [a + half * b for a, b in zip(x, k2, strict=True)], u[1], p)
    k4 = f(t + dt, [a + dt * b for a, b in zip(x, k3, strict=True)], u[2], p)
    sixth = dt / 6.0
    return [a + sixth * (b + 2.0 * (c + d) + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)]


def propagate(system: System, p: Sequence[Any], x0: Sequence[Any], drive: Drive, grid: Grid, step: Step = rk4_step) -> list[np.ndarray]:
    """States at all sub-step edges: one array ``(M + 1, ...)`` a state.

    ``p`` and ``x0`` are rows; batch axes of their entries, and of the drive, trail. A state that grows
    without limit, or comes to where its rates are not defined, is returned as it is (infinite), for the caller to judge.
    """
    f, steps, times = system.f, grid.steps.tolist(), grid.edges.tolist()
    shape = np.broadcast_shapes(*(np.shape(v) for v in [*p, *x0]), *(np.shape(u)[1:] for u in drive.begin))
    complex_ = any(np.iscomplexobj(v) for v in [*p, *x0, *drive.begin])
    if shape == ():
        p, x = _scalars(p), _scalars(x0)
    else:
        p, x = list(p), [np.broadcast_to(v, shape) for v in x0]
    stages = [[_per_step(row) for row in stage] for stage in drive.stages]
    history = np.empty((len(x), len(steps) + 1, *shape), dtype=complex if complex_ else float)
    history[:, 0] = x
    with np.errstate(over="ignore", invalid="ignore"):
        for m, dt in enumerate(steps):
            u = ([row[m] for row in stages[0]], [row[m] for row in stages[1]], [row[m] for row in stages[2]])
            try:
                x = step(f, times[m], x, u, p, dt)
            except (OverflowError, ZeroDivisionError):
                history[:, m + 1 :] = np.inf
                break
            for i, value in enumerate(x):
                history[i, m + 1] = value
    return list(history)


def outputs_at_samples(system: System, p: Sequence[Any], states: Sequence[np.ndarray], drive: Drive, grid: Grid) -> list[np.ndarray]:
    """Outputs at the record's samples, ``(N, ...)`` a row, from states at all sub-step edges.

    Only the samples are evaluated when no sensor has memory; else both ends of every sub-step. States
    without limit give outputs that are not finite, without a warning.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        if not system.sensor_stages:
            at = grid.sample
            return _outputs(system, p, grid.edges[at], [row[at] for row in states], [row[at] for row in drive.begin])
        begin = _outputs(system, p, grid.edges, list(states), drive.begin)
        end = _outputs(system, p, grid.edges[1:], [row[1:] for row in states], drive.end)
        begin, _ = system.sensor_path(p, begin, end, grid.steps)
        return [row[grid.sample] for row in begin]


def simulate(system: System, p: Sequence[Any], x0: Sequence[Any], drive: Drive, grid: Grid, step: Step = rk4_step) -> list[np.ndarray]:
    """Outputs at the record's samples, one array ``(N, ...)`` an output."""
    return outputs_at_samples(system, p, propagate(system, p, x0, drive, grid, step), drive, grid)


def _scalars(values: Sequence[Any]) -> list[Any]:
    return [complex(v) if np.iscomplexobj(v) else float(v) for v in values]


def _per_step(row: Any) -> Any:
    return row.tolist() if np.ndim(row) == 1 else row


def _outputs(system: System, p: Sequence[Any], times: np.ndarray, x: Sequence[Any], u: Sequence[Any]) -> list[np.ndarray]:
    """Outputs at many times at once, each ``(n, ...)``: time leads, batch axes trail."""
    batch = np.broadcast_shapes(*(np.shape(r)[1:] for r in [*x, *u]), *(np.shape(v) for v in p))
    depth = len(batch)
    rows = [trailing(row, depth) for row in [*x, *u]]
    y = system.h(trailing(times, depth), rows[: len(x)], rows[len(x) :], [np.asarray(v)[None] if np.ndim(v) else v for v in p])
    return [
        np.broadcast_to(trailing(np.asarray(value), depth), (len(times), *batch)) if np.ndim(value) else np.full((len(times), *batch), value)
        for value in y
    ]
