"""What repeated work is: numbered tasks, each with a seed of its own, that each give one row of one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

Cell = float | int | bool | str | None
Row = Mapping[str, Cell]

SEED_BITS = 53  # of a task's seed: what JSON, Parquet and spreadsheets all hold exactly


@dataclass(frozen=True)
class Task:
    """One of N independent tasks: its number, from 0, and the seed of everything random in it."""

    number: int
    seed: int


@dataclass(frozen=True)
class Ended:
    """A task that has ended: its row, or in its place what went wrong, in one line; ``seconds`` of wall time, with its block's shared alike.

    ``passing`` : a circumstance is to blame, as a process that died or too short a time; where the study is resumed, it is computed again.
    """

    task: Task
    row: Row | None
    error: str = ""
    seconds: float = 0.0
    passing: bool = False


class Work(Protocol):
    """A study of independent tasks. It is pickled once and sent to each worker, so it holds data and names, no open files and no functions.

    ``columns`` : each column of a row and its type, one of ``"float" "int" "bool" "text"``, or ``"time"`` for seconds that something took and
    that no other run has to equal; a cell may be None.
    ``block`` : how many neighbouring tasks are computed at once, as one batch; blocks begin at multiples of it, so that no task's row
    depends on how many are asked for, or on who works. Work may have ``quick`` True: a block takes less time than starting a process.
    It may have ``taken(row)``, which the process that asked calls with each row as it comes: it gives the row that is kept; and
    ``unready()``, which a worker of a cluster calls first: why it cannot do the work and the remedy, or None.
    """

    @property
    def name(self) -> str:
        """What it is called in the progress line and the manifest."""
        ...

    @property
    def columns(self) -> Mapping[str, str]: ...

    @property
    def block(self) -> int: ...

    def identity(self) -> Mapping[str, Any]:
        """Everything on which the rows depend but number and seed, as JSON: work is resumed only where it is equal."""
        ...

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        """The rows of a block of neighbouring tasks, in their order; text in place of a row says in one line why there is none.

        What it raises is recorded as the error of all of them; KeyboardInterrupt alone passes.
        """
        ...


def seed_of(root: int, number: int) -> int:
    """The seed of a task: that of child ``number`` of ``numpy.random.SeedSequence(root)``, as `SeedSequence.spawn` gives it.

    Studies of different roots share no task, and a study with more tasks has the same first ones.
    """
    child = np.random.SeedSequence(root, spawn_key=(number,))
    return int(child.generate_state(1, np.uint64)[0]) >> (64 - SEED_BITS)


def tasks_of(root: int, numbers: range) -> tuple[Task, ...]:
    """Tasks of a study by their numbers."""
    return tuple(Task(number, seed_of(root, number)) for number in numbers)
