"""The time grid of a simulation: record samples, nodes, equal sub-steps between nodes, cells for inputs.

Nodes are the record's samples, with further ones put into gaps so that node intervals differ little;
every node interval is cut into the same number of sub-steps, which keeps whole-record algorithms
rectangular. Cells subdivide sub-steps; effects with memory act on the mean of the input over a cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.declaration.system import System
from sim.errors import RecordError
from sim.maths.elementary import trailing
from sim.record import Hold

CELL = 0.001
MOST_STEPS = 20_000_000  # of a simulation, some 100 bytes and a microsecond each
MOST_CELLS = 500  # of a sub-step: one of more than half a second is of a motion that takes minutes


@dataclass(frozen=True, eq=False)
class Grid:
    """Where a simulation steps.

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
    """Grid for record times ``(N,)`` with sub-steps of at most ``max_step`` s.

    Raises RecordError where that takes more than ``MOST_STEPS`` of them.
    """
    with np.errstate(over="ignore"):  # of times at the ends of the range of floats
        gaps = np.diff(time)
    usual = float(np.median(gaps))
    counted = np.maximum(1, np.ceil(gaps / (1.5 * usual) - 1e-9))
    refuse_endless(float(counted.sum()) * max(1.0, float(gaps.max() / counted[np.argmax(gaps)]) / max_step), gaps, max_step)
    pieces = counted.astype(int)
    first = np.repeat(np.cumsum(pieces) - pieces, pieces)
    within = (np.arange(len(first)) - first) / np.repeat(pieces, pieces)
    nodes = np.append(np.repeat(time[:-1], pieces) + np.repeat(gaps, pieces) * within, time[-1])
    intervals = np.diff(nodes)
    substeps = max(1, math.ceil(float(intervals.max()) / max_step - 1e-6))
    steps = np.repeat(intervals / substeps, substeps)
    edges = np.append((nodes[:-1, None] + intervals[:, None] * np.arange(substeps) / substeps).ravel(), nodes[-1])
    sample = np.concatenate([[0], np.cumsum(pieces)]) * substeps
    source = np.repeat(np.arange(len(gaps)), pieces * substeps)
    return Grid(nodes, substeps, steps, edges, sample, source)


def refuse_endless(count: float, gaps: np.ndarray, max_step: float) -> None:
    """Raise RecordError where intervals ``gaps``, s, take more than ``MOST_STEPS`` steps; ``count`` is how many."""
    if count > MOST_STEPS:
        told = f"samples {gaps.min():.3g} to {gaps.max():.3g} s apart take {count:.2g} steps of {max_step:.2g} s or less"
        raise RecordError(told, where="column time", remedy="check the unit of the times, or read a part of them with --from and --to")


@dataclass(frozen=True, eq=False)
class Drive:
    """Inputs at the vehicle, one row an input, batch axes trailing.

    ``stages`` are the inputs at the beginning, middle and end of each sub-step as the integrator sees
    them, each ``(M, ...)``; ``begin`` ``(M + 1, ...)`` and ``end`` ``(M, ...)`` are those that act on the
    outputs directly, ``begin`` just after a sample's switch, ``end`` just before the next.
    """

    stages: tuple[list[Any], list[Any], list[Any]]
    begin: list[Any]
    end: list[Any]


def drive_from_record(system: System, p: Any, u: np.ndarray, time: np.ndarray, hold: Hold, grid: Grid) -> Drive:
    """Inputs at the vehicle for a record's inputs ``u (n_inputs, N)``, through the input path.

    Without input-path effects held inputs pass unchanged and linear ones are exact at the stages.
    """
    if not system.input_stages:
        return recorded_drive(u, time, hold, grid)
    rows = list(u)
    if hold is Hold.PREVIOUS:
        source = np.repeat(np.append(grid.source, len(time) - 1), _cells_per_step(grid))
        return drive_from_cells(system, p, [row[source] for row in rows], cell_edges(grid), grid)
    return _changed_by_input_path(recorded_drive(u, time, hold, grid), system, p, rows, time, grid)


def recorded_drive(u: np.ndarray, time: np.ndarray, hold: Hold, grid: Grid) -> Drive:
    """A record's inputs ``u (n_inputs, N)`` as they are: held ones unchanged, linear ones exact at the stages."""
    if hold is Hold.PREVIOUS:
        held = [row[grid.source] for row in u]
        return Drive((held, held, held), [np.append(h, row[-1]) for h, row in zip(held, u, strict=True)], held)
    begin = [np.interp(grid.edges, time, row) for row in u]
    middle = [0.5 * (b[:-1] + b[1:]) for b in begin]
    return Drive(([b[:-1] for b in begin], middle, [b[1:] for b in begin]), begin, [b[1:] for b in begin])


def drive_from_means(rows: list[np.ndarray], begin: list[np.ndarray], end: list[np.ndarray]) -> Drive:
    """Inputs given as means over each sub-step and values at its two ends."""
    return Drive((rows, rows, rows), begin, end)


def cell_edges(grid: Grid) -> np.ndarray:
    """Boundaries of the cells that input-path effects act on, s: ``CELL`` or less where sub-steps are short, these met exactly.

    One further sub-step after the last sample carries the feed-through there.
    """
    steps = np.append(grid.steps, grid.steps[-1])
    per_step = _cells_per_step(grid)
    return np.append((grid.edges[:, None] + steps[:, None] * np.arange(per_step) / per_step).ravel(), grid.edges[-1] + steps[-1])


def drive_from_cells(system: System, p: Any, cells: list[Any], edges: np.ndarray, grid: Grid) -> Drive:
    """Inputs at the vehicle for means ``(n_cells, ...)`` over the cells between ``edges = cell_edges(grid)``, through the input path."""
    split = [_by_step(row, grid) for row in system.input_path(p, cells, edges)]
    means = [_mean(row[:-1]) for row in split]
    return Drive((means, means, means), [row[:, 0] for row in split], [row[:-1, -1] for row in split])


def _cells_per_step(grid: Grid) -> int:
    return min(max(1, math.ceil(float(grid.steps.max()) / CELL - 1e-6)), MOST_CELLS)


def _by_step(row: Any, grid: Grid) -> np.ndarray:
    row = np.asarray(row)
    return row.reshape((len(grid.edges), -1) + row.shape[1:])


def _mean(split: np.ndarray) -> np.ndarray:
    # Equal cells give their value and no rounding: an effect that is absent then changes nothing.
    return split[:, 0] + (split - split[:, :1]).mean(axis=1)


def _changed_by_input_path(linear: Drive, system: System, p: Any, rows: list[Any], time: np.ndarray, grid: Grid) -> Drive:
    # Cells carry means only. What the input path changes is added to the straight input, exact at the stages.
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
        for rows, added in ((start, mean), (middle, mean), (end, mean), (begin, change[:, 0]), (last, change[:-1, -1])):
            rows[i] = trailing(rows[i], added.ndim - 1) + added
    return Drive((start, middle, end), begin, last)


def _prolonged(edges: np.ndarray, time: np.ndarray, row: np.ndarray) -> np.ndarray:
    # The last sample's feed-through is taken from the cell after it: the line goes on.
    further = row[-1] + (row[-1] - row[-2]) / (time[-1] - time[-2]) * (edges[-1] - time[-1])
    return np.interp(edges, np.append(time, edges[-1]), np.append(row, further))
