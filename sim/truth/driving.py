"""Inputs at the vehicle for maneuvers: every switch at its own time, whatever the grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim.declaration.system import System
from sim.maneuvers.steps import Maneuver
from sim.propagation.grid import Drive, Grid, cell_edges, drive_from_cells, drive_from_means


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
