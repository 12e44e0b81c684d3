"""How repeated work is run: what the options of every command that repeats something say."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scenarios.tasks.sharing import available_cores
from scenarios.tasks.study import Asked
from sim.errors import FlightidError

FOLDER = "runs"  # in the folder of a study: its rows and their manifest


MOST_JOBS = 1024
MOST_TASKS = 10_000_000  # of one study, whose numbers alone then take some 100 MB


@dataclass(frozen=True)
class Manner:
    """``jobs`` : processes, None for one a core. ``out`` : the folder of the study, in which rows are kept as they come. ``resume`` : go on with
    them. ``cluster`` : the address of a Dask scheduler. ``limit`` : s that one task may take."""

    jobs: int | None = 1
    out: Path | None = None
    resume: bool = False
    cluster: str | None = None
    limit: float | None = None

    def asked(self, count: int, root: int, block: int, unit: str) -> Asked:
        """A study of ``count`` tasks in blocks of ``block``. Raises FlightidError for what cannot be."""
        if self.jobs is not None and self.jobs < 1:
            raise FlightidError(f"{self.jobs} processes", where="--jobs", remedy="give one or more, or leave it out for one a core")
        if self.jobs is not None and self.jobs > MOST_JOBS:
            raise FlightidError(f"{self.jobs} processes", where="--jobs", remedy=f"give {MOST_JOBS} or fewer, or leave it out for one a core")
        if self.limit is not None and not 0.0 < self.limit < float("inf"):
            raise FlightidError(f"{self.limit:g} s", where="--time-limit", remedy="give the seconds that one of them may take")
        if self.resume and self.out is None:
            raise FlightidError("there is no folder to go on with", where="--resume", remedy="name the folder with --out")
        folder = None if self.out is None else self.out / FOLDER
        longest = None if self.limit is None else self.limit * min(block, count)
        if count > MOST_TASKS:
            raise FlightidError(f"{count} {unit} are more than can be kept", where="--runs", remedy=f"give {MOST_TASKS} or fewer")
        return Asked(count, root, self.jobs or available_cores(), folder, self.resume, self.cluster, longest, unit)


def stopped(ended: int, asked: int, unit: str, out: Path | None) -> KeyboardInterrupt:
    """What Ctrl-C ends a study with: what is kept of it, and how to go on."""
    if out is None:
        return KeyboardInterrupt(f"the table of the {ended} of {asked} {unit} that had ended is printed above")
    return KeyboardInterrupt(f"the table of the {ended} of {asked} {unit} that had ended is in {out}; the same command with --resume goes on")
