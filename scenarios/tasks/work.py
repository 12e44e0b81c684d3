"""Repeated work: numbered tasks with seeds, their rows, and the folder that stores the rows."""

from __future__ import annotations

import io
import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from scenarios.files.sources import read_json, versions
from scenarios.files.writing import json_text, write_json
from sim.errors import FlightidError

if TYPE_CHECKING:
    import pyarrow as pa


# ---- Tasks and work

Cell = float | int | bool | str | None
Row = Mapping[str, Cell]

SEED_BITS = 53  # bits of a seed, exact in JSON, Parquet and spreadsheets


@dataclass(frozen=True)
class Task:
    """One of N independent tasks: its number, from 0, and the seed of its random numbers."""

    number: int
    seed: int


@dataclass(frozen=True)
class Ended:
    """A task that has ended, with its row or an error.

    Attributes
    ----------
    task : the task.
    row : its row; None after an error.
    error : the error in one line; empty with a row.
    seconds : wall time, s; the time of a block is divided equally among its tasks.
    passing : whether the error does not come from the task itself, as a process that died or a
        time limit. Such a task is computed again if the study is resumed.
    """

    task: Task
    row: Row | None
    error: str = ""
    seconds: float = 0.0
    passing: bool = False


class Work(Protocol):
    """A study of independent tasks.

    It is pickled for each worker, so it must not have open files or functions as attributes.

    Attributes
    ----------
    columns : type of each column of a row: ``"float"``, ``"int"``, ``"bool"``, ``"text"``, or
        ``"time"`` for a duration (s), which need not be reproducible. Cells may be None.
    block : number of neighbouring tasks that are computed as one batch. Blocks begin at multiples
        of this number, so rows do not depend on the number of tasks or on where they run.

    Three attributes are optional:

    - ``quick`` : True if a block takes less time than starting a process.
    - ``taken(row)`` : called in the main process with each row; returns the row to store.
    - ``unready()`` : called first by a worker of a cluster; returns None, or the reason why the
      worker cannot do the work, with the remedy.
    """

    @property
    def name(self) -> str:
        """Name of the work in the progress line and the manifest."""
        ...

    @property
    def columns(self) -> Mapping[str, str]: ...

    @property
    def block(self) -> int: ...

    def identity(self) -> Mapping[str, Any]:
        """Return all data on which rows depend, except number and seed, as JSON content.

        A study is resumed only if these data are equal to the stored ones.
        """
        ...

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        """Return the rows of a block of neighbouring tasks, in their order.

        A failed task has its error, in one line, in place of a row. An exception is recorded as the
        error of all tasks of the block, except KeyboardInterrupt.
        """
        ...


def seed_of(root: int, number: int) -> int:
    """Return the seed of a task, from child ``number`` of ``numpy.random.SeedSequence(root)``.

    Studies with different roots have no task in common. A study with more tasks begins with the
    same tasks.
    """
    child = np.random.SeedSequence(root, spawn_key=(number,))
    return int(child.generate_state(1, np.uint64)[0]) >> (64 - SEED_BITS)


def tasks_of(root: int, numbers: range) -> tuple[Task, ...]:
    """Return the tasks of a study with these numbers."""
    return tuple(Task(number, seed_of(root, number)) for number in numbers)


# ---- Rows of tasks as columns

Columns = dict[str, np.ndarray]

KINDS: Mapping[str, type] = {"float": float, "time": float, "int": int, "bool": bool, "text": str}
FLOATS = ("float", "time")
# Columns of every table, with their types.
COMMON_COLUMNS: Mapping[str, str] = {
    "number": "int",
    "seed": "int",
    "error": "text",
    "passing": "bool",
    "seconds": "time",
}
FIRST_COLUMNS = ("number", "seed", "error")  # first columns of a `RowTable`


@dataclass(frozen=True, eq=False)
class RowTable:
    """Rows of the N tasks that have ended, in the order of their numbers.

    Attributes
    ----------
    columns : arrays ``(N,)`` by name, first ``number``, ``seed`` and ``error`` (empty if the task
        has a row). A task without a row has the cells None, or NaN in columns of floats.
    asked : number of requested tasks.
    times : arrays ``(N,)`` by name, s: ``seconds`` of wall time and the work's columns of type
        ``time``. They differ from run to run.
    """

    columns: Mapping[str, np.ndarray]
    asked: int
    times: Mapping[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.columns["number"])

    @property
    def whole(self) -> bool:
        """Whether all tasks have ended."""
        return len(self) == self.asked

    @property
    def sound(self) -> np.ndarray:
        """``(N,)`` of bool: the tasks that have a row."""
        return np.array([not error for error in self.columns["error"]], dtype=bool)


def all_columns(work: Work) -> dict[str, str]:
    """Return name and type of all stored columns: ``COMMON_COLUMNS`` and those of the work.

    Raises
    ------
    ValueError : a column of the work has a name of ``COMMON_COLUMNS`` or an unknown type.
    """
    for name, kind in work.columns.items():
        if name in COMMON_COLUMNS or kind not in KINDS:
            raise ValueError(f"the column {name!r} of type {kind!r} of {work.name}")
    return {**COMMON_COLUMNS, **work.columns}


def columns_of(work: Work, ended: Sequence[Ended]) -> Columns:
    """Return the ended tasks as columns ``(k,)``.

    An empty cell is NaN in columns of floats, else None. A task whose row has other columns or
    types than the work declares gets an error.
    """
    kinds = all_columns(work)
    cells: dict[str, list[object]] = {name: [] for name in kinds}
    for result in ended:
        task = result.task
        row_error = _row_error(work, result)
        row = None if row_error else result.row
        error = row_error or result.error
        own = (task.number, task.seed, error, result.passing, result.seconds)
        for name, cell in zip(COMMON_COLUMNS, own, strict=True):
            cells[name].append(cell)
        for name in work.columns:
            cells[name].append(None if row is None else row[name])
    return {name: array_of(cells[name], kind) for name, kind in kinds.items()}


def array_of(cells: Iterable[object], kind: str) -> np.ndarray:
    """Return a column: an array of floats, or of Python objects for other types."""
    if kind in FLOATS:
        return np.array([np.nan if cell is None else cell for cell in cells], dtype=float)
    column = [None if cell is None else KINDS[kind](cell) for cell in cells]
    array = np.empty(len(column), dtype=object)
    array[:] = column
    return array


def joined(kinds: Mapping[str, str], pieces: Sequence[Columns]) -> Columns:
    """Return the concatenated columns; empty columns without any piece."""
    if not pieces:
        return {name: array_of((), kind) for name, kind in kinds.items()}
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in kinds}


def in_order(columns: Columns, count: int) -> Columns:
    """Return one row for each of the first ``count`` tasks, in the order of their numbers.

    Of several results of a task, one without a ``passing`` error is taken.
    """
    numbers = columns["number"].astype(np.int64)
    order = np.lexsort((columns["passing"].astype(bool), numbers))
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = numbers[order][1:] != numbers[order][:-1]
    chosen = order[is_first & (numbers[order] < count)]
    return {name: column[chosen] for name, column in columns.items()}


def table_of(work: Work, columns: Columns, asked: int) -> RowTable:
    """Return the table of sorted columns; ``asked`` is the number of requested tasks."""
    times = {name: columns[name] for name, kind in all_columns(work).items() if kind == "time"}
    shown = [name for name in (*FIRST_COLUMNS, *work.columns) if name not in times]
    return RowTable(
        {
            name: columns[name].astype(np.int64) if name in ("number", "seed") else columns[name]
            for name in shown
        },
        asked,
        times,
    )


_NUMBER = int | float | np.floating | np.integer
_CELL_TYPES: Mapping[str, Any] = {
    "float": _NUMBER,
    "time": _NUMBER,
    "int": int | np.integer,
    "bool": bool | np.bool_,
    "text": str,
}


def _row_error(work: Work, ended: Ended) -> str:
    """Return the error of a row that differs from the work's declaration; empty if it agrees."""
    if ended.row is None:
        return ""
    if set(ended.row) != set(work.columns):
        return f"its row has the columns {', '.join(sorted(ended.row))} and not those declared"
    for name, kind in work.columns.items():
        cell = ended.row[name]
        if cell is not None and not isinstance(cell, _CELL_TYPES[kind]):
            return f"column {name} has {cell!r} and no {kind}"
    return ""


# ---- The manifest: the study to which a folder of rows belongs

MANIFEST = "manifest.json"
SCHEMA = "flightid/tasks/1"
# Packages whose version may change the last digits of results.
DECIDING = ("flightid", "numpy", "scipy", "filterpy", "control")


def manifest_of(work: Work, root: int, count: int) -> dict[str, Any]:
    """Return the manifest of a study: all data on which its rows depend, and their number."""
    identity = json.loads(json_text(dict(work.identity()), "the identity of the work"))
    return {
        "schema": SCHEMA,
        "name": work.name,
        "identity": identity,
        "root": root,
        "columns": dict(work.columns),
        "block": work.block,
        "versions": versions(),
        "count": count,
    }


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return the manifest of a folder; None if there is none.

    Raises
    ------
    FlightidError : the manifest cannot be read.
    """
    path = folder / MANIFEST
    if not os.path.lexists(path):
        return None
    content: Any = read_json(path, FlightidError, "another folder")
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise FlightidError(
            f"this is no manifest of schema {SCHEMA}",
            where=str(path),
            remedy="begin in another folder",
        )
    return content


def write_manifest(folder: Path, content: Mapping[str, Any]) -> None:
    """Write the manifest completely or not at all, and flush it to disk."""
    write_json(folder / MANIFEST, content)
    flush_folder(folder)


def flush_folder(folder: Path) -> None:
    """Flush a folder's file names to disk, so that a power cut loses none.

    Nothing is done on Windows, which cannot open a folder.
    """
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def refuse_other_study(
    stored: Mapping[str, Any], requested: Mapping[str, Any], folder: Path
) -> None:
    """Raise FlightidError, with the first difference, if two manifests are of different studies."""
    stored_versions, requested_versions = stored.get("versions", {}), requested["versions"]
    pairs = [
        (key, stored.get(key), requested[key])
        for key in ("name", "root", "identity", "columns", "block")
    ]
    pairs += [
        (f"version of {name}", stored_versions.get(name), requested_versions.get(name))
        for name in DECIDING
    ]
    for key, old, new in pairs:
        difference = _difference("seed" if key == "root" else key, old, new)
        if difference:
            raise FlightidError(
                f"this folder has the rows of another study: {difference}",
                where=str(folder),
                remedy="request the same study, or name another folder",
            )


def _difference(place: str, old: Any, new: Any) -> str:
    """Return the first difference of two JSON values in words; empty if they are equal."""
    parts: list[tuple[str, Any, Any]] = []
    if isinstance(old, dict) and isinstance(new, dict):
        parts = [
            (f"{place}.{key}".removeprefix("identity."), old.get(key), new.get(key))
            for key in sorted({*old, *new})
        ]
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        parts = [(f"{place}[{i}]", *pair) for i, pair in enumerate(zip(old, new, strict=True))]
    elif type(old) is not type(new) or old != new:
        return f"{place} was {_shown(old)} and now is {_shown(new)}"
    return next((text for part in parts if (text := _difference(*part))), "")


LONGEST_VALUE = 79  # characters of a value in a message


def _shown(value: Any) -> str:
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 2]}..."


# ---- Rows stored in a folder while tasks end

SHARD_INTERVAL = 5.0  # s between shards; a power cut loses at most the rows of this time
MOST_SHARD_ROWS = 50_000  # rows of a shard
MOST_SHARDS = 16  # number of shards from which they are merged at the end
LOCK = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder for this process; the lock also ends with the process.

    Raises
    ------
    FlightidError : another process has locked the folder.
    """
    with open(folder / LOCK, "ab") as handle:
        try:
            _lock(handle.fileno())
        except OSError:
            remedy = "wait for it, or name another folder"
            raise FlightidError(
                "another process is writing here", where=str(folder), remedy=remedy
            ) from None
        yield


def _lock(descriptor: int) -> None:
    """Lock an open file for this process until it is closed.

    Raises
    ------
    OSError : another process has locked the file.
    """
    try:
        import fcntl
    except ImportError:  # Windows locks a range of bytes: the first byte
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        return
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


class Shards:
    """Rows of one study in Parquet files (shards) of its folder, which this process has locked.

    Incomplete files are removed. Unreadable files are listed in ``damaged``; their tasks are
    computed again.
    """

    def __init__(self, folder: Path, work: Work) -> None:
        self.folder, self.work = folder, work
        self.damaged: list[str] = []
        self._buffer: list[Ended] = []
        self._since = time.monotonic()
        for part in folder.glob(".*.part"):
            part.unlink()

    def __enter__(self) -> Shards:
        return self

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        if kind is None or issubclass(kind, KeyboardInterrupt | FlightidError):
            self.flush()

    def add(self, ended: Sequence[Ended]) -> None:
        """Store results in memory, and write them from time to time.

        Raises
        ------
        OSError : the rows cannot be written, as if the disk is full.
        """
        self._buffer += ended
        if time.monotonic() - self._since > SHARD_INTERVAL or len(self._buffer) >= MOST_SHARD_ROWS:
            self.flush()

    def flush(self) -> None:
        """Write the results that are still in memory."""
        if self._buffer:
            self._write(columns_of(self.work, self._buffer))
            self._buffer = []
        self._since = time.monotonic()

    def read(self, count: int) -> Columns:
        """Return all rows of the first ``count`` tasks, in order and each once."""
        shards = [columns for _, columns in self._readable()]
        return in_order(joined(all_columns(self.work), shards), count)

    def compact(self) -> None:
        """Merge many shards into one. If this is interrupted, no row is lost or counted twice."""
        shards = self._readable()
        if len(shards) < MOST_SHARDS:
            return
        columns = joined(all_columns(self.work), [columns for _, columns in shards])
        self._write(in_order(columns, int(columns["number"].max()) + 1))
        for path, _ in shards:
            path.unlink()

    def _paths(self) -> list[Path]:
        return sorted(self.folder.glob("rows-*.parquet"))

    def _readable(self) -> list[tuple[Path, Columns]]:
        """Return path and columns of all readable shards; rename the others."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        shards = []
        for path in self._paths():
            try:
                table = pq.read_table(
                    io.BytesIO(path.read_bytes()), page_checksum_verification=True
                )
                if table.schema != self._schema():
                    raise ValueError("it has other columns")
            except (OSError, ValueError, pa.ArrowException) as error:
                path.replace(path.with_suffix(".damaged"))
                self.damaged.append(f"{path.name} ({' '.join(str(error).split())[:120]})")
                continue
            columns = {
                name: _read_column(table.column(name), kind)
                for name, kind in all_columns(self.work).items()
            }
            shards.append((path, columns))
        return shards

    def _write(self, columns: Columns) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        kinds = all_columns(self.work)
        cells = {
            name: columns[name] if kind in FLOATS else columns[name].tolist()
            for name, kind in kinds.items()
        }
        content = io.BytesIO()
        pq.write_table(
            pa.table(cells, schema=self._schema()),
            content,
            compression="zstd",
            write_page_checksum=True,
        )
        last = max(
            (int(path.stem.split("-")[1]) for path in self.folder.glob("rows-*")), default=-1
        )
        path = self.folder / f"rows-{last + 1:06d}.parquet"
        part = path.with_name(f".{path.name}.part")
        try:
            with open(part, "wb") as handle:
                handle.write(content.getbuffer())
                handle.flush()
                os.fsync(handle.fileno())
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)
        flush_folder(self.folder)

    def _schema(self) -> pa.Schema:
        import pyarrow as pa

        types = {
            "float": pa.float64(),
            "time": pa.float64(),
            "int": pa.int64(),
            "bool": pa.bool_(),
            "text": pa.string(),
        }
        return pa.schema(
            [pa.field(name, types[kind]) for name, kind in all_columns(self.work).items()]
        )


def _read_column(column: pa.ChunkedArray, kind: str) -> np.ndarray:
    if kind in FLOATS:
        return np.array(column.to_numpy(), dtype=float)
    return array_of(column.to_pylist(), kind)


def missing(columns: Columns, count: int) -> np.ndarray:
    """Return the numbers of the tasks to run: without a result, or with a ``passing`` error."""
    done = np.zeros(count, dtype=bool)
    done[columns["number"].astype(np.int64)[~columns["passing"].astype(bool)]] = True
    return np.flatnonzero(~done)
