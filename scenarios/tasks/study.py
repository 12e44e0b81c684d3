"""Study of N tasks: run those that have no row yet and return the table of all rows."""

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


# ---- Study of N tasks

ShowProgress = Callable[[str, float], None]  # takes a sentence and the share of the work done
SHORTEST_TIME = 1e-9  # s, keeps a rate finite


@dataclass(frozen=True)
class TaskRequest:
    """Request of a study.

    Attributes
    ----------
    count : number of tasks.
    root : seed from which the seeds of the tasks follow.
    jobs : number of processes.
    folder : folder of the rows; None stores them in memory only.
    resume : continue with the rows of the folder.
    cluster : address of a Dask scheduler.
    longest : time limit of a block, s.
    unit : name of the tasks in sentences, plural.
    elsewhere : folder in which the work itself stores finished tasks.
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
    """Blocks of tasks from their numbers; tasks are made on request, which saves memory."""

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


def run_study(
    work: Work, request: TaskRequest, show_progress: ShowProgress = lambda stage, share: None
) -> RowTable:
    """Run the tasks that have no row, and return the table of all tasks.

    After Ctrl-C the table has the tasks that have ended.

    Raises
    ------
    FlightidError : the folder has another study, or none to resume; it cannot be written; or
        another process writes into it.
    KeyboardInterrupt : Ctrl-C before any task had ended.
    """
    if request.folder is None:
        return _run_in_memory(work, request, show_progress)
    from scenarios.tasks.work import Shards, locked, manifest_of, missing

    folder, manifest = request.folder, manifest_of(work, request.root, request.count)
    new_folders = [path for path in (folder, *folder.parents) if not path.exists()]
    shards: Shards | None = None
    try:
        with ExitStack() as stack:
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(folder))
            _check_manifest(manifest, request, folder)
            shards = Shards(folder, work)
            numbers = missing(shards.read(request.count), request.count)
            try:
                with shards:
                    _run(work, request, numbers, shards.add, show_progress)
            except (FlightidError, KeyboardInterrupt) as error:
                stored = len(shards.read(request.count)["number"])
                if not stored and not request.resume:
                    stack.close()  # closes the file of the lock; Windows removes no open file
                    _remove_study(folder, new_folders)
                if isinstance(error, FlightidError):
                    raise _with_stored_results(error, stored, request) from None
                raise error from None
            columns = shards.read(request.count)
            shards.compact()
    except OSError as error:
        stored = 0 if shards is None else len(shards.read(request.count)["number"])
        what = (
            f"cannot be written ({error.strerror or error}); {stored} of {request.count} "
            f"{request.unit} are kept"
        )
        raise FlightidError(
            what, where=str(folder), remedy="make room or mend the folder, then go on with --resume"
        ) from None
    return table_of(work, columns, request.count)


def _run_in_memory(work: Work, request: TaskRequest, show_progress: ShowProgress) -> RowTable:
    if request.resume:
        raise FlightidError(
            "there is no folder to go on with",
            where="--resume",
            remedy="name the folder with --out",
        )
    pieces: list[Columns] = []

    def keep(ended: list[Ended]) -> None:
        pieces.append(columns_of(work, ended))

    try:
        _run(work, request, np.arange(request.count), keep, show_progress)
    except FlightidError as error:
        ended = sum(len(piece["number"]) for piece in pieces)
        raise _with_stored_results(error, ended, request) from None
    columns = in_order(joined(all_columns(work), pieces), request.count)
    return table_of(work, columns, request.count)


def _run(
    work: Work,
    request: TaskRequest,
    numbers: np.ndarray,
    keep: Callable[[list[Ended]], None],
    show_progress: ShowProgress,
) -> None:
    """Run tasks until they have ended or Ctrl-C.

    Parameters
    ----------
    numbers : numbers of the tasks; progress is the share of them that has ended.
    keep : function that stores the ended tasks of a block.
    """
    block_numbers: list[np.ndarray] = []
    if len(numbers):
        block_numbers = np.split(numbers, np.flatnonzero(np.diff(numbers // work.block)) + 1)
    blocks = Blocks(request.root, block_numbers)
    before = request.count - len(numbers)
    done, started = 0, time.monotonic()
    show_progress(_stage(before, request, 0.0), 0.0)

    def report(words: str) -> None:
        show_progress(f"{_stage(before + done, request, 0.0)}; {words}", done / len(numbers))

    results = _run_on_cluster if request.cluster else _run_on_this_machine
    running = results(work, blocks, request, report)
    try:
        for ended in running:
            keep([_to_store(work, result) for result in ended])
            done += len(ended)
            rate = done / max(time.monotonic() - started, SHORTEST_TIME)
            show_progress(_stage(before + done, request, rate), done / len(numbers))
    except KeyboardInterrupt:
        if before + done == 0:
            raise KeyboardInterrupt(f"none of {request.count} {request.unit} had ended") from None
    finally:
        running.close()


def _to_store(work: Work, ended: Ended) -> Ended:
    """Return an ended task with the row to store, which ``taken`` of the work may replace."""
    take: Callable[[Row], Row] | None = getattr(work, "taken", None)
    return ended if take is None or ended.row is None else replace(ended, row=take(ended.row))


def _run_on_this_machine(
    work: Work, blocks: Blocks, request: TaskRequest, report: Callable[[str], None]
) -> Generator[list[Ended], None, None]:
    yield from run_blocks(work, blocks, request.jobs, request.longest)


def _run_on_cluster(
    work: Work, blocks: Blocks, request: TaskRequest, report: Callable[[str], None]
) -> Generator[list[Ended], None, None]:
    from scenarios.tasks.cluster import run_on_cluster

    assert request.cluster is not None
    yield from run_on_cluster(work, blocks, request.cluster, request.longest, report)


def _with_stored_results(error: FlightidError, ended: int, request: TaskRequest) -> FlightidError:
    """Return the error that stopped the tasks, with a sentence on the results that are stored."""
    if not ended:
        return error
    number = f"{ended} of {request.count} {request.unit}"
    if request.elsewhere is not None:
        what = f"{error.what}; {number} are kept in {request.elsewhere}"
        remedy = "give the same command again"
    elif request.folder is not None:
        what = f"{error.what}; {number} are kept in {request.folder}"
        remedy = "go on with --resume"
    else:
        what = f"{error.what}; the {number} that had ended are lost, since no --out was given"
        return FlightidError(what, where=error.where, remedy=error.remedy)
    if error.remedy:
        remedy = f"{error.remedy}, then {remedy}"
    return FlightidError(what, where=error.where, remedy=remedy)


def _remove_study(folder: Path, new_folders: Sequence[Path]) -> None:
    """Remove manifest, lock and new folders (innermost first) of a study that could not begin."""
    from scenarios.tasks.work import LOCK, MANIFEST

    with suppress(OSError):
        (folder / MANIFEST).unlink(missing_ok=True)
        (folder / LOCK).unlink(missing_ok=True)
        for path in new_folders:
            path.rmdir()


def _check_manifest(manifest: Mapping[str, Any], request: TaskRequest, folder: Path) -> None:
    """Write the manifest of the request, or compare it with the one in the folder."""
    from scenarios.tasks.work import read_manifest, refuse_other_study, write_manifest

    stored = read_manifest(folder)
    if stored is None:
        if request.resume:
            raise FlightidError(
                "there is no study to go on with",
                where=str(folder),
                remedy="leave --resume out, or name the folder of one",
            )
        write_manifest(folder, manifest)
        return
    if not request.resume:
        raise FlightidError(
            "a study is kept here",
            where=str(folder),
            remedy="go on with it by --resume, or name another folder",
        )
    refuse_other_study(stored, manifest, folder)
    if request.count > stored["count"]:
        write_manifest(folder, manifest)


def _stage(done: int, request: TaskRequest, rate: float) -> str:
    """Return ``"120 of 1000 runs, 14 a second"``; a low ``rate`` (1/s) is shown per hour."""
    words = f"{done} of {request.count} {request.unit}"
    for unit, seconds in (("second", 1.0), ("minute", 60.0), ("hour", 3600.0)):
        if rate * seconds >= 1.0:
            return f"{words}, {rate * seconds:.3g} a {unit}"
    return words


# ---- Options of all commands with repeated work

FOLDER = "runs"  # subfolder of a study with its rows and their manifest


MOST_JOBS = 1024  # processes
MOST_TASKS = 10_000_000  # tasks of one study; their rows take about 100 MB


@dataclass(frozen=True)
class Execution:
    """Options on the execution of repeated work.

    Attributes
    ----------
    jobs : number of processes; None for one per core.
    out : folder of the study, with its rows.
    resume : continue with these rows.
    cluster : address of a Dask scheduler.
    limit : time limit of one task, s.
    """

    jobs: int | None = 1
    out: Path | None = None
    resume: bool = False
    cluster: str | None = None
    limit: float | None = None

    def request(self, count: int, root: int, block: int, unit: str) -> TaskRequest:
        """Return the request of a study.

        Parameters
        ----------
        count : number of tasks.
        root : seed from which the seeds of the tasks follow.
        block : number of tasks in a block.
        unit : name of the tasks in sentences, plural.

        Raises
        ------
        FlightidError : an option has an impossible value.
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
                remedy="give the seconds that one run may take",
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
    """Return the KeyboardInterrupt that ends a study after Ctrl-C.

    Its text names the results and the command that continues. ``asked`` is the number of requested
    tasks, and ``unit`` their name in the plural.
    """
    if out is None:
        return KeyboardInterrupt(
            f"the table of the {ended} of {asked} {unit} that had ended is printed above"
        )
    return KeyboardInterrupt(
        f"the table of the {ended} of {asked} {unit} that had ended is in {out}; the same command "
        "with --resume goes on"
    )
