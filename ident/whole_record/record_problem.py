"""One record laid out for a whole-record fit: its grid, the inputs on it, and what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from sim.declaration.model import System
from sim.propagation import Drive, Grid, Step, drive_from_record, make_grid, recorded_drive, rk4_step
from sim.record import Record

INCREMENT = 1e-6  # of a parameter's or state's size, for forward differences


@dataclass(frozen=True, eq=False)
class RecordProblem:
    """A record laid out for whole-record fits: ``z``, ``valid`` ``(m, N)``, grid, and the columns wanted.

    ``free`` are positions of the wanted parameters among all, ``starts`` those of the wanted initial states; ``moving`` are
    those of ``free`` that act in the dynamics. ``exact`` differentiates by complex steps, else by forward differences
    of ``increment (np,)``: a few times cheaper, good to about a millionth. ``drive`` is kept where no parameter moves it.
    """

    record: Record
    system: System
    grid: Grid
    z: np.ndarray
    valid: np.ndarray
    free: tuple[int, ...]
    starts: tuple[int, ...]
    moving: tuple[int, ...]
    increment: np.ndarray
    exact: bool
    drive: Drive | None
    step: Step = rk4_step


def record_problem(
    record: Record,
    system: System,
    max_step: float,
    free: Sequence[int],
    starts: Sequence[int],
    *,
    valid: np.ndarray | None = None,
    at: np.ndarray | None = None,
    exact: bool = True,
    step: Step = rk4_step,
) -> RecordProblem:
    """Lay out a record; sub-steps of at most ``max_step`` s; ``valid (m, N)`` replaces the record's own mask.

    ``at (np,)``: parameters that the input path has where none of it is free; those of the system when None.
    """
    z, measured = record.output_array(system.output_names)
    grid, recorded = _recorded(record, system.input_names, max_step)
    items = [system.parameters.items[index] for index in free]
    sizes = [abs(item.value) or (item.prior_std if np.isfinite(item.prior_std) else 1.0) for item in items]
    acting = [position for position, item in enumerate(items) if item.name not in system.output_parameters]
    drive = None
    if not system.input_parameters.intersection(item.name for item in items):
        held = system.parameters.values() if at is None else at
        drive = driven_by(record, system, held.tolist(), grid) if system.input_stages else recorded
    mask = measured if valid is None else measured & valid
    increment = INCREMENT * np.array(sizes, dtype=float)
    return RecordProblem(record, system, grid, z, mask, tuple(free), tuple(starts), tuple(acting), increment, exact, drive, step)


@lru_cache(maxsize=16)  # a search lays out the same few records hundreds of times
def _recorded(record: Record, inputs: tuple[str, ...], max_step: float) -> tuple[Grid, Drive]:
    grid = make_grid(record.time, max_step)
    return grid, recorded_drive(record.input_array(inputs), record.time, record.hold, grid)


def driven_by(record: Record, system: System, p: Sequence[Any] | np.ndarray, grid: Grid) -> Drive:
    """A record's inputs at the vehicle, through the input path at parameters ``p``."""
    return drive_from_record(system, p, record.input_array(system.input_names), record.time, record.hold, grid)
