"""A study of N tasks: missing tasks, their execution, and the table of all rows."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from scenarios.tasks.processes import available_cores, run_blocks
from scenarios.tasks.work import (
    Columns,
    Ended,
    Row,
    RowTable,
    Task,
    Work,
    all_columns,
    columns_of,
    in_order,
    joined,
    seed_of,
    table_of,
)
from sim.errors import FlightidError

if TYPE_CHECKING:
    from scenarios.tasks.work import Shards


# ---- A study of N tasks: request, missing tasks, table of all rows

Tell = Callable[[str, float], None]


@dataclass(frozen=True)
class TaskRequest:
    """Request of a study: number of tasks, root seed, and execution.

    ``jobs``: processes. ``folder``: of the rows (None: in memory only). ``resume``: continue with
    the rows of that folder. ``cluster``: address of a Dask scheduler. ``longest``: time limit of a
    block, s. ``unit``: name of a task, plural. ``elsewhere``: place where the work itself stores
    finished tasks.
    """

    count: int
    root: int
    jobs: int = 1
    folder: Path | None = None
    resume: bool = False
    cluster: str | None = None
    longest: float | None = None
    unit: str = "runs"
    elsewhere: Path | None = None


class Blocks(Sequence[Sequence[Task]]):
    """Blocks of the tasks that are missing, made when they are requested: a study of a million
    takes no room for its tasks.
    """

    def __init__(self, root: int, numbers: Sequence[np.ndarray]) -> None:
        self._root, self._numbers = root, numbers

    def __len__(self) -> int:
        return len(self._numbers)

    @overload
    def __getitem__(self, at: int) -> Sequence[Task]: ...
    @overload
    def __getitem__(self, at: slice) -> Blocks: ...
    def __getitem__(self, at: int | slice) -> Sequence[Task] | Blocks:
        if isinstance(at, slice):
            return Blocks(self._root, self._numbers[at])
        return [Task(int(number), seed_of(self._root, int(number))) for number in self._numbers[at]]


def run_study(work: Work, asked: TaskRequest, tell: Tell = lambda stage, share: None) -> RowTable:
    """Run the missing tasks and return the table of all; after Ctrl-C, of finished ones.

    Raises
    ------
    FlightidError : the folder holds another study, or none to resume, cannot be written, or another
        process writes there. KeyboardInterrupt : Ctrl-C, where no task had ended.
    """
    if asked.folder is None:
        if asked.resume:
            raise FlightidError(
                "there is no folder to go on with",
                where="--resume",
                remedy="name the folder with --out",
            )
        pieces: list[Columns] = []
        try:
            _run(
                work,
                asked,
                np.arange(asked.count),
                lambda ended: pieces.append(columns_of(work, ended)),
                tell,
            )
        except FlightidError as error:
            raise _cut_short(error, sum(len(piece["number"]) for piece in pieces), asked) from None
        return table_of(work, in_order(joined(all_columns(work), pieces), asked.count), asked.count)
    from scenarios.tasks.work import Shards, locked, manifest_of, missing

    folder, wanted = asked.folder, manifest_of(work, asked.root, asked.count)
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    shards: Shards | None = None
    try:
        with ExitStack() as stack:
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(folder))
            _agree(wanted, asked, folder)
            shards = Shards(folder, work)
            left = missing(shards.read(asked.count), asked.count)
            try:
                with shards:
                    _run(work, asked, left, shards.add, tell)
            except (FlightidError, KeyboardInterrupt) as error:
                kept = len(shards.read(asked.count)["number"])
                if not kept and not asked.resume:
                    stack.close()  # the lock's file is closed first: Windows removes no open file
                    _take_away(folder, made)
                raise (
                    _cut_short(error, kept, asked) if isinstance(error, FlightidError) else error
                ) from None
            columns = shards.read(asked.count)
            shards.compact()
    except OSError as error:
        kept = 0 if shards is None else len(shards.read(asked.count)["number"])
        what = (
            f"cannot be written ({error.strerror or error}); {kept} of {asked.count} {asked.unit} "
            "are kept"
        )
        raise FlightidError(
            what, where=str(folder), remedy="make room or mend it, then go on with --resume"
        ) from None
    return table_of(work, columns, asked.count)


def _run(
    work: Work,
    asked: TaskRequest,
    numbers: np.ndarray,
    keep: Callable[[list[Ended]], None],
    tell: Tell,
) -> None:
    """Run the tasks of ``numbers``; Ctrl-C ends it. Progress is the share of these tasks."""
    grouped = (
        np.split(numbers, np.flatnonzero(np.diff(numbers // work.block)) + 1)
        if len(numbers)
        else []
    )
    before = asked.count - len(numbers)
    done, since = 0, time.monotonic()
    tell(_stage(before, asked, 0.0), 0.0)
    blocks = Blocks(asked.root, grouped)

    def say(words: str) -> None:
        tell(f"{_stage(before + done, asked, 0.0)}; {words}", done / len(numbers))

    found = _by_cluster(work, blocks, asked, say) if asked.cluster else _here(work, blocks, asked)
    try:
        for ended in found:
            keep([_taken(work, each) for each in ended])
            done += len(ended)
            tell(
                _stage(before + done, asked, done / max(time.monotonic() - since, 1e-9)),
                done / len(numbers),
            )
    except KeyboardInterrupt:
        if before + done == 0:
            raise KeyboardInterrupt(f"none of {asked.count} {asked.unit} had ended") from None
    finally:
        found.close()


def _taken(work: Work, ended: Ended) -> Ended:
    """Return the part of an ended task that is kept."""
    take: Callable[[Row], Row] | None = getattr(work, "taken", None)
    return ended if take is None or ended.row is None else replace(ended, row=take(ended.row))


def _here(work: Work, blocks: Blocks, asked: TaskRequest) -> Generator[list[Ended], None, None]:
    yield from run_blocks(work, blocks, asked.jobs, asked.longest)


def _by_cluster(
    work: Work, blocks: Blocks, asked: TaskRequest, say: Callable[[str], None]
) -> Generator[list[Ended], None, None]:
    from scenarios.tasks.cluster import run_on_cluster

    assert asked.cluster is not None
    yield from run_on_cluster(work, blocks, asked.cluster, asked.longest, say)


def _cut_short(error: FlightidError, ended: int, asked: TaskRequest) -> FlightidError:
    """Return the error that stopped the tasks, with the results that are kept."""
    if not ended:
        return error
    if asked.elsewhere is not None:
        remedy = (
            f"{error.remedy}, then give the same command again"
            if error.remedy
            else "give the same command again"
        )
        what = f"{error.what}; {ended} of {asked.count} {asked.unit} are kept in {asked.elsewhere}"
        return FlightidError(what, where=error.where, remedy=remedy)
    if asked.folder is None:
        what = (
            f"{error.what}; the {ended} of {asked.count} {asked.unit} that had ended are lost, "
            "since no --out was given"
        )
        return FlightidError(what, where=error.where, remedy=error.remedy)
    remedy = f"{error.remedy}, then go on with --resume" if error.remedy else "go on with --resume"
    return FlightidError(
        f"{error.what}; {ended} of {asked.count} {asked.unit} are kept in {asked.folder}",
        where=error.where,
        remedy=remedy,
    )


def _take_away(folder: Path, made: Sequence[Path]) -> None:
    """Leave no trace of a study that could not begin: its manifest and lock, and the folders
    ``made`` for it, innermost first.
    """
    from scenarios.tasks.work import LOCK, MANIFEST

    with suppress(OSError):
        (folder / MANIFEST).unlink(missing_ok=True)
        (folder / LOCK).unlink(missing_ok=True)
        for each in made:
            each.rmdir()


def _agree(wanted: Mapping[str, Any], asked: TaskRequest, folder: Path) -> None:
    """Write the manifest of the request, or compare it with the existing one."""
    from scenarios.tasks.work import read_manifest, refuse_another, write_manifest

    kept = read_manifest(folder)
    if kept is None:
        if asked.resume:
            raise FlightidError(
                "there is no study to go on with",
                where=str(folder),
                remedy="leave --resume out, or name the folder of one",
            )
        write_manifest(folder, wanted)
        return
    if not asked.resume:
        raise FlightidError(
            "a study is kept here",
            where=str(folder),
            remedy="go on with it by --resume, or name another folder",
        )
    refuse_another(kept, wanted, folder)
    if asked.count > kept["count"]:
        write_manifest(folder, wanted)


def _stage(done: int, asked: TaskRequest, rate: float) -> str:
    """``"120 of 1000 runs, 14 a second"``, slow ones by the minute or hour."""
    words = f"{done} of {asked.count} {asked.unit}"
    for per, seconds in (("second", 1.0), ("minute", 60.0), ("hour", 3600.0)):
        if rate * seconds >= 1.0:
            return f"{words}, {rate * seconds:.3g} a {per}"
    return words


# ---- Execution options, common to all commands with repeated work

FOLDER = "runs"  # in the folder of a study: its rows and their manifest


MOST_JOBS = 1024
MOST_TASKS = 10_000_000  # tasks of one study; their rows take some 100 MB


@dataclass(frozen=True)
class Execution:
    """Execution of repeated work.

    ``jobs``: processes, None for one per core. ``out``: folder of the study, with its rows.
    ``resume``: continue with these rows. ``cluster``: address of a Dask scheduler. ``limit``: time
    limit of one task, s.
    """

    jobs: int | None = 1
    out: Path | None = None
    resume: bool = False
    cluster: str | None = None
    limit: float | None = None

    def asked(self, count: int, root: int, block: int, unit: str) -> TaskRequest:
        """Return a study of ``count`` tasks in blocks of ``block``. Raises FlightidError for what
        cannot be.
        """
        if self.jobs is not None and self.jobs < 1:
            raise FlightidError(
                f"{self.jobs} processes",
                where="--jobs",
                remedy="give one or more, or leave it out for one a core",
            )
        if self.jobs is not None and self.jobs > MOST_JOBS:
            raise FlightidError(
                f"{self.jobs} processes",
                where="--jobs",
                remedy=f"give {MOST_JOBS} or fewer, or leave it out for one a core",
            )
        if self.limit is not None and not 0.0 < self.limit < float("inf"):
            raise FlightidError(
                f"{self.limit:g} s",
                where="--time-limit",
                remedy="give the seconds that one of them may take",
            )
        if self.resume and self.out is None:
            raise FlightidError(
                "there is no folder to go on with",
                where="--resume",
                remedy="name the folder with --out",
            )
        folder = None if self.out is None else self.out / FOLDER
        longest = None if self.limit is None else self.limit * min(block, count)
        if count > MOST_TASKS:
            raise FlightidError(
                f"{count} {unit} are more than can be kept",
                where="--runs",
                remedy=f"give {MOST_TASKS} or fewer",
            )
        return TaskRequest(
            count,
            root,
            self.jobs or available_cores(),
            folder,
            self.resume,
            self.cluster,
            longest,
            unit,
        )


def stopped(ended: int, asked: int, unit: str, out: Path | None) -> KeyboardInterrupt:
    """Return the KeyboardInterrupt with which Ctrl-C ends a study: the results that are kept, and
    how to go on.
    """
    if out is None:
        return KeyboardInterrupt(
            f"the table of the {ended} of {asked} {unit} that had ended is printed above"
        )
    return KeyboardInterrupt(
        f"the table of the {ended} of {asked} {unit} that had ended is in {out}; the same command "
        "with --resume goes on"
    )
