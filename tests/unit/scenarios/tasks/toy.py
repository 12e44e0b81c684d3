"""Work of no meaning: rows that depend on their seeds alone, with tasks that fail, take their time,
or end their process.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from scenarios.tasks.work import Row, Task


@dataclass(frozen=True)
class Toy:
    """``raising``, ``refused`` : numbers of tasks that fail. ``killing`` : of tasks that kill their
    process; with ``once``, a folder, only once.

    ``pause`` : s that each block takes. ``stuck`` : of tasks that stay in one call of native code
    for half a minute.
    """

    block: int = 4
    pause: float = 0.0
    raising: tuple[int, ...] = ()
    refused: tuple[int, ...] = ()
    killing: tuple[int, ...] = ()
    once: Path | None = None
    stuck: tuple[int, ...] = ()
    quick: bool = False
    meaning: int = 1

    name = "toy"
    columns: ClassVar[Mapping[str, str]] = {
        "x": "float",
        "n": "int",
        "flag": "bool",
        "word": "text",
        "gap": "float",
    }

    def identity(self) -> Mapping[str, Any]:
        return {"meaning": self.meaning, "raising": list(self.raising)}

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        time.sleep(self.pause)
        numbers = {task.number for task in tasks}
        if numbers & set(self.raising):
            raise ValueError("a task\nthat raises")
        if numbers & set(self.killing) and self._due(min(numbers)):
            os.kill(os.getpid(), signal.SIGKILL)
        if numbers & set(self.stuck):
            sum(range(10**10))
        return [
            f"no row of {task.number}" if task.number in self.refused else row_of(task)
            for task in tasks
        ]

    def _due(self, number: int) -> bool:
        if self.once is None:
            return True
        mark = self.once / f"died-{number}"
        if mark.exists():
            return False
        mark.touch()
        return True


class Threads(Toy):
    """How many threads linear algebra takes in the process that works, also that which is loaded
    late.
    """

    columns: ClassVar[Mapping[str, str]] = {"threads": "int"}

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        import scipy.linalg
        import threadpoolctl

        scipy.linalg.inv(np.eye(3))
        return [
            {"threads": max(each["num_threads"] for each in threadpoolctl.threadpool_info())}
            for _ in tasks
        ]


class Loads(Toy):
    """Which process works, and how often the work was unpickled in it."""

    columns: ClassVar[Mapping[str, str]] = {"process": "int", "loads": "int"}
    loads: ClassVar[int] = 0

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        type(self).loads += 1

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        time.sleep(self.pause)
        return [{"process": os.getpid(), "loads": self.loads} for _ in tasks]


def row_of(task: Task) -> Row:
    """The row of a task, by which any table can be checked."""
    draws = np.random.default_rng(task.seed).normal(size=2)
    return {
        "x": float(draws[0]),
        "n": int(task.seed % 1000),
        "flag": bool(draws[1] > 0.0),
        "word": f"Wort {task.number} ü" if draws[1] > 0.0 else None,
        "gap": None if task.number % 3 else float(draws[1]),
    }
