"""Propagation of a System: time grid, inputs at the vehicle, integrators, outputs.

Nodes are the record's samples, and further times in gaps, so that node intervals differ little.
Every node interval is divided into the same number of sub-steps, so that arrays over a record are
rectangular. Cells subdivide sub-steps; effects with memory act on the mean of the input over a
cell.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.declaration.model import System
from sim.errors import RecordError
from sim.maths import trailing
from sim.record import Hold

# ---- The time grid of a simulation

INPUT_CELL_TIME = 0.001  # s, longest cell
MOST_STEPS = 20_000_000  # most steps of a simulation; each takes some 100 bytes and a microsecond
# Most cells of a sub-step; sub-steps above half a second have longer cells.
MOST_CELLS = 500


@dataclass(frozen=True, eq=False)
class Grid:
    """Time grid of a simulation.

    Attributes
    ----------
    nodes : ``(K + 1,)`` s.
    substeps : sub-steps in each node interval.
    steps : ``(M,)`` sub-step sizes, ``M = K * substeps``, s.
    edges : ``(M + 1,)`` boundaries of the sub-steps, s; nodes are met exactly.
    sample : ``(N,)`` index into ``edges`` of each record sample.
    source : ``(M,)`` record row whose held input acts during the sub-step.
    """

    nodes: np.ndarray
    substeps: int
    steps: np.ndarray
    edges: np.ndarray
    sample: np.ndarray
    source: np.ndarray


def make_grid(time: np.ndarray, max_step: float) -> Grid:
    """Return the grid for record times ``(N,)``, s, with sub-steps of at most ``max_step`` s.

    Raises RecordError if the grid has more than ``MOST_STEPS`` sub-steps.
    """
    with np.errstate(over="ignore"):  # of times at the ends of the range of floats
        gaps = np.diff(time)
    usual = float(np.median(gaps))
    counted = np.maximum(1, np.ceil(gaps / (1.5 * usual) - 1e-9))
    refuse_endless(
        float(counted.sum()) * max(1.0, float(gaps.max() / counted[np.argmax(gaps)]) / max_step),
        gaps,
        max_step,
    )
    pieces = counted.astype(int)
    first = np.repeat(np.cumsum(pieces) - pieces, pieces)
    within = (np.arange(len(first)) - first) / np.repeat(pieces, pieces)
    nodes = np.append(np.repeat(time[:-1], pieces) + np.repeat(gaps, pieces) * within, time[-1])
    intervals = np.diff(nodes)
    substeps = max(1, math.ceil(float(intervals.max()) / max_step - 1e-6))
    steps = np.repeat(intervals / substeps, substeps)
    edges = np.append(
        (nodes[:-1, None] + intervals[:, None] * np.arange(substeps) / substeps).ravel(), nodes[-1]
    )
    sample = np.concatenate([[0], np.cumsum(pieces)]) * substeps
    source = np.repeat(np.arange(len(gaps)), pieces * substeps)
    return Grid(nodes, substeps, steps, edges, sample, source)


def refuse_endless(count: float, gaps: np.ndarray, max_step: float) -> None:
    """Raise RecordError if a simulation needs more than ``MOST_STEPS`` steps.

    Parameters
    ----------
    count : number of steps.
    gaps : sampling intervals, s.
    max_step : longest step, s.
    """
    if count > MOST_STEPS:
        problem = (
            f"samples {gaps.min():.3g} to {gaps.max():.3g} s apart take {count:.2g} steps of "
            f"{max_step:.2g} s or less"
        )
        raise RecordError(
            problem,
            where="column time",
            remedy="check the unit of the times, or read a part of them with --from and --to",
        )


@dataclass(frozen=True, eq=False)
class Drive:
    """Inputs at the vehicle: lists with a row for each input; batch axes trail.

    Attributes
    ----------
    stages : inputs at begin, middle and end of each sub-step for the integrator, each ``(M, ...)``.
    begin : ``(M + 1, ...)``, inputs that act on the outputs at the edges, just after an input that
        is held switches.
    end : ``(M, ...)``, the same at the end of each sub-step, just before the input switches.
    """

    stages: tuple[list[Any], list[Any], list[Any]]
    begin: list[Any]
    end: list[Any]


def drive_from_record(
    system: System, p: Any, u: np.ndarray, time: np.ndarray, hold: Hold, grid: Grid
) -> Drive:
    """Return the inputs at the vehicle for a record's inputs ``u (n_inputs, N)``, behind the input
    path.

    Without input-path effects they are those of `recorded_drive`.
    """
    if not system.input_stages:
        return recorded_drive(u, time, hold, grid)
    rows = list(u)
    if hold is Hold.PREVIOUS:
        source = np.repeat(np.append(grid.source, len(time) - 1), _cells_per_step(grid))
        return drive_from_cells(system, p, [row[source] for row in rows], cell_edges(grid), grid)
    return _changed_by_input_path(recorded_drive(u, time, hold, grid), system, p, rows, time, grid)


def recorded_drive(u: np.ndarray, time: np.ndarray, hold: Hold, grid: Grid) -> Drive:
    """Return a record's inputs ``u (n_inputs, N)`` without an input path.

    Held inputs are constant over each sub-step. Linear inputs are exact at the stages.
    """
    if hold is Hold.PREVIOUS:
        inputs = [row[grid.source] for row in u]
        return Drive(
            (inputs, inputs, inputs),
            [np.append(h, row[-1]) for h, row in zip(inputs, u, strict=True)],
            inputs,
        )
    begin = [np.interp(grid.edges, time, row) for row in u]
    middle = [0.5 * (b[:-1] + b[1:]) for b in begin]
    return Drive(
        ([b[:-1] for b in begin], middle, [b[1:] for b in begin]), begin, [b[1:] for b in begin]
    )


def drive_from_means(
    rows: list[np.ndarray], begin: list[np.ndarray], end: list[np.ndarray]
) -> Drive:
    """Return inputs from their means ``rows`` over each sub-step and their values at its ends."""
    return Drive((rows, rows, rows), begin, end)


def cell_edges(grid: Grid) -> np.ndarray:
    """Return the boundaries of the cells on which input-path effects act, s.

    Cells last ``INPUT_CELL_TIME`` or less; only cells of long sub-steps are longer. Edges of
    sub-steps are boundaries. A further sub-step after the last sample gives the feed-through there.
    """
    steps = np.append(grid.steps, grid.steps[-1])
    per_step = _cells_per_step(grid)
    return np.append(
        (grid.edges[:, None] + steps[:, None] * np.arange(per_step) / per_step).ravel(),
        grid.edges[-1] + steps[-1],
    )


def drive_from_cells(
    system: System, p: Any, cells: list[Any], edges: np.ndarray, grid: Grid
) -> Drive:
    """Return the inputs at the vehicle, behind the input path.

    Parameters
    ----------
    cells : for each input its means ``(n_cells, ...)`` over the cells.
    edges : ``cell_edges(grid)``.
    """
    split = [_by_step(row, grid) for row in system.input_path(p, cells, edges)]
    means = [_mean(row[:-1]) for row in split]
    return Drive(
        (means, means, means), [row[:, 0] for row in split], [row[:-1, -1] for row in split]
    )


def _cells_per_step(grid: Grid) -> int:
    """Return the number of cells in each sub-step."""
    return min(max(1, math.ceil(float(grid.steps.max()) / INPUT_CELL_TIME - 1e-6)), MOST_CELLS)


def _by_step(row: Any, grid: Grid) -> np.ndarray:
    """Return the cells of a row ``(n_cells, ...)`` by sub-step: ``(M + 1, cells, ...)``."""
    row = np.asarray(row)
    return row.reshape((len(grid.edges), -1) + row.shape[1:])


def _mean(split: np.ndarray) -> np.ndarray:
    """Return the mean over the cells of each sub-step."""
    # The mean of equal cells is exact, so that an absent effect changes nothing.
    return split[:, 0] + (split - split[:, :1]).mean(axis=1)


def _changed_by_input_path(
    linear: Drive, system: System, p: Any, rows: list[Any], time: np.ndarray, grid: Grid
) -> Drive:
    """Return linear inputs plus their change by the input path.

    Cells have only the mean of a linear input. So only the change is computed on cells.
    """
    edges = cell_edges(grid)
    cells = [0.5 * (a[:-1] + a[1:]) for a in (_prolonged(edges, time, row) for row in rows)]
    acted = system.input_path(p, cells, edges)
    start, middle, end = ([*stage] for stage in linear.stages)
    begin, last = [*linear.begin], [*linear.end]
    for i, (before, after) in enumerate(zip(cells, acted, strict=True)):
        if after is before:  # no effect acts on this input
            continue
        change = _by_step(after - trailing(before, np.ndim(after) - 1), grid)
        mean = _mean(change[:-1])
        for rows, added in (
            (start, mean),
            (middle, mean),
            (end, mean),
            (begin, change[:, 0]),
            (last, change[:-1, -1]),
        ):
            rows[i] = trailing(rows[i], added.ndim - 1) + added
    return Drive((start, middle, end), begin, last)


def _prolonged(edges: np.ndarray, time: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Return a linear input at ``edges``, which end one sub-step after the last sample.

    The input is extrapolated there; it is needed for the feed-through of the last sample.
    """
    further = row[-1] + (row[-1] - row[-2]) / (time[-1] - time[-2]) * (edges[-1] - time[-1])
    return np.interp(edges, np.append(time, edges[-1]), np.append(row, further))


# ---- Integrators and the simulation of a System

Rates = Callable[[Any, Sequence[Any], Sequence[Any], Sequence[Any]], list[Any]]
Stages = tuple[Sequence[Any], Sequence[Any], Sequence[Any]]
Step = Callable[[Rates, Any, Sequence[Any], Stages, Sequence[Any], Any], list[Any]]


def euler_step(
    f: Rates, t: Any, x: Sequence[Any], u: Stages, p: Sequence[Any], dt: Any
) -> list[Any]:
    """Return the states after an explicit Euler step of size ``dt``, s; the order is 1.

    ``u`` are the inputs at begin, middle and end of the step.
    """
    return [value + dt * rate for value, rate in zip(x, f(t, x, u[0], p), strict=True)]


def rk4_step(f: Rates, t: Any, x: Sequence[Any], u: Stages, p: Sequence[Any], dt: Any) -> list[Any]:
    """Return the states after a classical Runge-Kutta step of size ``dt``, s; the order is 4.

    ``u`` are the inputs at begin, middle and end of the step.
    """
    half = 0.5 * dt
    k1 = f(t, x, u[0], p)
    k2 = f(t + half, [a + half * b for a, b in zip(x, k1, strict=True)], u[1], p)
    k3 = f(t + half, [a + half * b for a, b in zip(x, k2, strict=True)], u[1], p)
    k4 = f(t + dt, [a + dt * b for a, b in zip(x, k3, strict=True)], u[2], p)
    sixth = dt / 6.0
    return [
        a + sixth * (b + 2.0 * (c + d) + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)
    ]


def propagate(
    system: System,
    p: Sequence[Any],
    x0: Sequence[Any],
    drive: Drive,
    grid: Grid,
    step: Step = rk4_step,
) -> list[np.ndarray]:
    """Return the states at all sub-step edges: an array ``(M + 1, ...)`` for each state.

    Batch axes of the parameters ``p``, the initial states ``x0`` and the inputs trail. A state that
    diverges, or reaches a point where its rates are not defined, is infinite from there on; the
    caller has to check this.
    """
    f, steps, times = system.f, grid.steps.tolist(), grid.edges.tolist()
    shape = np.broadcast_shapes(
        *(np.shape(v) for v in [*p, *x0]), *(np.shape(u)[1:] for u in drive.begin)
    )
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
            u = (
                [row[m] for row in stages[0]],
                [row[m] for row in stages[1]],
                [row[m] for row in stages[2]],
            )
            try:
                x = step(f, times[m], x, u, p, dt)
            except (OverflowError, ZeroDivisionError):
                history[:, m + 1 :] = np.inf
                break
            for i, value in enumerate(x):
                history[i, m + 1] = value
    return list(history)


def outputs_at_samples(
    system: System, p: Sequence[Any], states: Sequence[np.ndarray], drive: Drive, grid: Grid
) -> list[np.ndarray]:
    """Return the outputs at the record's samples, ``(N, ...)`` each, from states at all edges.

    Outputs are evaluated at the samples only, unless a sensor has memory: then at both ends of
    every sub-step. States that diverged give outputs that are not finite, without a warning.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        if not system.sensor_stages:
            samples = grid.sample
            return _outputs(
                system,
                p,
                grid.edges[samples],
                [row[samples] for row in states],
                [row[samples] for row in drive.begin],
            )
        begin = _outputs(system, p, grid.edges, list(states), drive.begin)
        end = _outputs(system, p, grid.edges[1:], [row[1:] for row in states], drive.end)
        begin, _ = system.sensor_path(p, begin, end, grid.steps)
        return [row[grid.sample] for row in begin]


def simulate(
    system: System,
    p: Sequence[Any],
    x0: Sequence[Any],
    drive: Drive,
    grid: Grid,
    step: Step = rk4_step,
) -> list[np.ndarray]:
    """Return the outputs at the record's samples: an array ``(N, ...)`` for each output."""
    return outputs_at_samples(system, p, propagate(system, p, x0, drive, grid, step), drive, grid)


def _scalars(values: Sequence[Any]) -> list[Any]:
    """Return values as Python numbers, with which arithmetic is faster than with NumPy scalars."""
    return [complex(v) if np.iscomplexobj(v) else float(v) for v in values]


def _per_step(row: Any) -> Any:
    """Return a row as a list of Python numbers if it has no batch axes."""
    return row.tolist() if np.ndim(row) == 1 else row


def _outputs(
    system: System, p: Sequence[Any], times: np.ndarray, x: Sequence[Any], u: Sequence[Any]
) -> list[np.ndarray]:
    """Return outputs at n times, ``(n, ...)`` each: the time axis leads, batch axes trail."""
    batch = np.broadcast_shapes(*(np.shape(r)[1:] for r in [*x, *u]), *(np.shape(v) for v in p))
    depth = len(batch)
    rows = [trailing(row, depth) for row in [*x, *u]]
    y = system.h(
        trailing(times, depth),
        rows[: len(x)],
        rows[len(x) :],
        [np.asarray(v)[None] if np.ndim(v) else v for v in p],
    )
    return [
        np.broadcast_to(trailing(np.asarray(value), depth), (len(times), *batch))
        if np.ndim(value)
        else np.full((len(times), *batch), value)
        for value in y
    ]
