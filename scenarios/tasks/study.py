"""A study of N tasks: what is asked, what is kept in its folder, and the table of all rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenarios.tasks.running import run_blocks
from scenarios.tasks.work import Ended, Work, tasks_of

Tell = Callable[[str, float], None]


@dataclass(frozen=True)
class Asked:
    """How many tasks, from which root of seeds, and how they are run.

    ``jobs`` : processes. ``folder`` : where rows are kept as they come (None: in memory alone). ``resume`` : go on with what that
    folder holds. ``cluster`` : the address of a Dask scheduler. ``longest`` : s that a block of tasks may take.
    """

    count: int
    root: int
    jobs: int = 1
    folder: Path | None = None
    resume: bool = False
    cluster: str | None = None
    longest: float | None = None


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of the tasks that have ended, in the order of their numbers.

    ``columns`` : each ``(N,)``, beginning with ``number``, ``seed`` and ``error`` (empty where there is a row); cells of tasks without a row
    are None, NaN in columns of floats. ``asked`` : how many tasks there were to be.
    """

    columns: Mapping[str, np.ndarray]
    asked: int

    def __len__(self) -> int:
        return len(self.columns["number"])

    @property
    def whole(self) -> bool:
        """Whether all tasks have ended."""
        return len(self) == self.asked


def run_study(work: Work, asked: Asked, tell: Tell = lambda stage, share: None) -> Table:
    """Run what is missing and give the table of all; after Ctrl-C, of those that had ended.

    Raises
    ------
    FlightidError : the folder holds another study, or none to resume.
    """
    tasks = tasks_of(asked.root, range(asked.count))
    blocks = [tasks[at : at + work.block] for at in range(0, len(tasks), work.block)]
    ended: list[Ended] = []
    for found in run_blocks(work, blocks, asked.jobs, asked.longest):
        ended += found
        tell(f"{len(ended)} of {asked.count} runs", len(ended) / asked.count)
    return _table(work, sorted(ended, key=lambda each: each.task.number), asked.count)


def _table(work: Work, ended: list[Ended], asked: int) -> Table:
    columns: dict[str, np.ndarray] = {
        "number": np.array([each.task.number for each in ended], dtype=np.int64),
        "seed": np.array([each.task.seed for each in ended], dtype=np.int64),
        "error": np.array([each.error for each in ended], dtype=object),
    }
    for name, kind in work.columns.items():
        cells = [None if each.row is None else each.row[name] for each in ended]
        columns[name] = np.array([np.nan if cell is None else cell for cell in cells]) if kind == "float" else np.array(cells, dtype=object)
    return Table(columns, asked)
