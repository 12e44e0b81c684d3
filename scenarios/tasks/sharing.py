"""Who runs blocks of tasks: this process, or several of this machine."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence

from scenarios.tasks.running import run_block
from scenarios.tasks.work import Ended, Task, Work

WORTH = 2.0  # s of work left in one process, from which starting others pays


def available_cores() -> int:
    """Processors that this process may use, which a batch system may have made fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_blocks(work: Work, blocks: Sequence[Sequence[Task]], jobs: int = 1, longest: float | None = None) -> Iterator[list[Ended]]:
    """Each block's tasks as they end, in whatever order. Nothing in a row depends on ``jobs``.

    ``longest`` : s of wall time that a block may take; then it is ended, and its tasks have that as their error. What is ``quick``
    begins here, and goes to processes if enough is left for them.
    """
    at = 0
    if longest is None:
        while at < len(blocks) and (jobs < 2 or len(blocks) - at < 2 or getattr(work, "quick", False)):
            started = time.perf_counter()
            yield run_block(work, blocks[at])
            at += 1
            if jobs > 1 and (time.perf_counter() - started) * (len(blocks) - at) > WORTH * jobs / (jobs - 1.0):
                break
    if at < len(blocks):
        from scenarios.tasks.processes import run_in_processes

        yield from run_in_processes(work, blocks[at:], jobs, longest)
