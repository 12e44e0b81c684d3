"""Blocks of tasks run one after another, or shared out among processes, and given back as they end."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

from scenarios.tasks.work import Ended, Task, Work


def run_blocks(work: Work, blocks: Sequence[Sequence[Task]], jobs: int = 1, longest: float | None = None) -> Iterator[list[Ended]]:
    """Each block's tasks as they end, in whatever order. Nothing in a row depends on ``jobs``.

    ``longest`` : s of wall time that a block may take; then it is ended, and its tasks have that as their error.
    """
    for block in blocks:
        yield run_block(work, block)


def run_block(work: Work, block: Sequence[Task]) -> list[Ended]:
    """One block in this process; what fails is recorded."""
    started = time.perf_counter()
    try:
        rows = list(work.run(block))
    except Exception as error:
        rows = [f"{type(error).__name__}: {error}"] * len(block)
    seconds = (time.perf_counter() - started) / len(block)
    return [Ended(task, None, row, seconds) if isinstance(row, str) else Ended(task, row, "", seconds) for task, row in zip(block, rows, strict=True)]
