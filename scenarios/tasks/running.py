"""One block of tasks, where it stands: what fails in it is recorded."""

from __future__ import annotations

import time
from collections.abc import Sequence

from scenarios.tasks.work import Ended, Task, Work


def run_block(work: Work, block: Sequence[Task]) -> list[Ended]:
    """One block in this process; what fails is recorded."""
    started = time.perf_counter()
    try:
        rows = list(work.run(block))
        if len(rows) != len(block):
            raise ValueError(f"{len(rows)} rows of {len(block)} tasks")
    except Exception as error:
        line = " ".join(f"{type(error).__name__}: {error}".split())
        rows = [line] * len(block)
    seconds = (time.perf_counter() - started) / len(block)
    return [Ended(task, None, row, seconds) if isinstance(row, str) else Ended(task, row, "", seconds) for task, row in zip(block, rows, strict=True)]


def failed_by_circumstance(block: Sequence[Task], why: str, seconds: float = 0.0) -> list[Ended]:
    """A block that something other than its tasks ended."""
    return [Ended(task, None, why, seconds / len(block), passing=True) for task in block]
