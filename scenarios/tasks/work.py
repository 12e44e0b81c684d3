"""Repeated work: numbered tasks with seeds, their rows, and the folder that keeps the rows."""

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


# ---- What repeated work is

Cell = float | int | bool | str | None
Row = Mapping[str, Cell]

SEED_BITS = 53  # bits of a seed, exact in JSON, Parquet and spreadsheets


@dataclass(frozen=True)
class Task:
    """One of N independent tasks: its number, from 0, and the seed of everything random in it."""

    number: int
    seed: int


@dataclass(frozen=True)
class Ended:
    """A task that has ended: its row, or in its place what went wrong, in one line; ``seconds`` of
    wall time, with its block's shared alike.

    ``passing`` : a circumstance is to blame, as a process that died or too short a time; where the
    study is resumed, it is computed again.
    """

    task: Task
    row: Row | None
    error: str = ""
    seconds: float = 0.0
    passing: bool = False


class Work(Protocol):
    """A study of independent tasks. It is pickled for each worker, so it must not hold open files
    or functions.

    Attributes
    ----------
    columns : type of each column of a row: ``"float"``, ``"int"``, ``"bool"``, ``"text"``, or
        ``"time"`` for a duration (s), which need not be reproducible. Cells may be None.
    block : number of neighbouring tasks that are computed as one batch. Blocks begin at multiples
        of it, so that rows do not depend on the number of tasks or on where they run.

    Optional: ``quick`` True if a block takes less time than starting a process; ``taken(row)``,
    called in the main process with each row, returns the row to store; ``unready()``, called first
    by a worker of a cluster, returns a reason why it cannot do the work and the remedy, or None.
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
        """Everything on which the rows depend but number and seed, as JSON: work is resumed only if
        it is equal.
        """
        ...

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        """Return the rows of a block of neighbouring tasks, in their order; text in place of a row
        says in one line why there is none.

        What it raises is recorded as the error of all of them; KeyboardInterrupt alone passes.
        """
        ...


def seed_of(root: int, number: int) -> int:
    """Return the seed of a task: that of child ``number`` of ``numpy.random.SeedSequence(root)``,
    as `SeedSequence.spawn` gives it.

    Studies of different roots share no task, and a study with more tasks has the same first ones.
    """
    child = np.random.SeedSequence(root, spawn_key=(number,))
    return int(child.generate_state(1, np.uint64)[0]) >> (64 - SEED_BITS)


def tasks_of(root: int, numbers: range) -> tuple[Task, ...]:
    """Tasks of a study by their numbers."""
    return tuple(Task(number, seed_of(root, number)) for number in numbers)


# ---- Rows of tasks as columns

Columns = dict[str, np.ndarray]

KINDS: Mapping[str, type] = {"float": float, "time": float, "int": int, "bool": bool, "text": str}
FLOATS = ("float", "time")
# of every work
OWN: Mapping[str, str] = {
    "number": "int",
    "seed": "int",
    "error": "text",
    "passing": "bool",
    "seconds": "time",
}
SHOWN = ("number", "seed", "error")  # first columns of a table


@dataclass(frozen=True, eq=False)
class RowTable:
    """Rows of the tasks that have ended, in the order of their numbers.

    ``columns`` : each ``(N,)``, beginning with ``number``, ``seed`` and ``error`` (empty if
    there is a row); cells of tasks without a row are None, NaN in columns of floats. ``asked`` :
    how many tasks there were to be. ``times`` ``(N,)`` each, s : ``seconds`` of wall time, and the
    work's columns of type ``time``, which no two runs have in common.
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
    """Return the names and types of what is kept of a task: its own and those of the work.

    Raises ValueError if the work names a column as one of ours, or a type that there is not.
    """
    for name, kind in work.columns.items():
        if name in OWN or kind not in KINDS:
            raise ValueError(f"the column {name!r} of type {kind!r} of {work.name}")
    return {**OWN, **work.columns}


def columns_of(work: Work, ended: Sequence[Ended]) -> Columns:
    """Return the ended tasks as columns ``(k,)``: floats with NaN for no number, else objects with
    None.

    A row that has not the work's columns, or a cell of another type, is an error of its task.
    """
    kinds = all_columns(work)
    cells: dict[str, list[object]] = {name: [] for name in kinds}
    for each in ended:
        wrong = _wrong(work, each)
        row = None if wrong else each.row
        own = (each.task.number, each.task.seed, wrong or each.error, each.passing, each.seconds)
        for name, cell in zip(OWN, own, strict=True):
            cells[name].append(cell)
        for name in work.columns:
            cells[name].append(None if row is None else row[name])
    return {name: array_of(cells[name], kind) for name, kind in kinds.items()}


def array_of(cells: Iterable[object], kind: str) -> np.ndarray:
    """Return one column: floats as floats, all else as objects of Python's own types."""
    if kind in FLOATS:
        return np.array([np.nan if cell is None else cell for cell in cells], dtype=float)
    column = [None if cell is None else KINDS[kind](cell) for cell in cells]
    array = np.empty(len(column), dtype=object)
    array[:] = column
    return array


def joined(kinds: Mapping[str, str], pieces: Sequence[Columns]) -> Columns:
    """Return the columns one after another; of none, empty ones."""
    if not pieces:
        return {name: array_of((), kind) for name, kind in kinds.items()}
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in kinds}


def in_order(columns: Columns, count: int) -> Columns:
    """Return one row of each of the first ``count`` tasks; later results replace interruptions."""
    numbers = columns["number"].astype(np.int64)
    order = np.lexsort((columns["passing"].astype(bool), numbers))
    first = np.ones(len(order), dtype=bool)
    first[1:] = numbers[order][1:] != numbers[order][:-1]
    kept = order[first & (numbers[order] < count)]
    return {name: column[kept] for name, column in columns.items()}


def table_of(work: Work, columns: Columns, asked: int) -> RowTable:
    """Return the table of rows that are in order."""
    times = {name: columns[name] for name, kind in all_columns(work).items() if kind == "time"}
    shown = [name for name in (*SHOWN, *work.columns) if name not in times]
    return RowTable(
        {
            name: columns[name].astype(np.int64) if name in ("number", "seed") else columns[name]
            for name in shown
        },
        asked,
        times,
    )


def _wrong(work: Work, each: Ended) -> str:
    if each.row is None:
        return ""
    if set(each.row) != set(work.columns):
        return f"its row has the columns {', '.join(sorted(each.row))} and not those declared"
    for name, kind in work.columns.items():
        cell = each.row[name]
        if cell is None or (
            kind in FLOATS and isinstance(cell, int | float | np.floating | np.integer)
        ):
            continue
        if not isinstance(
            cell,
            {
                "int": int | np.integer,
                "bool": bool | np.bool_,
                "text": str,
                "float": float,
                "time": float,
            }[kind],
        ):
            return f"column {name} has {cell!r} and no {kind}"
    return ""


# ---- The study to which a folder of rows belongs

MANIFEST = "manifest.json"
SCHEMA = "flightid/tasks/1"
# versions on which the last digits hang
DECIDING = ("flightid", "numpy", "scipy", "filterpy", "control")


def manifest_of(work: Work, root: int, count: int) -> dict[str, Any]:
    """Return the manifest of a study: everything that its rows depend on, and their number."""
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
    """Return the manifest of a folder; None if there is none. Raises FlightidError if it
    cannot be read.
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
    """Write it whole or not at all, and down to the disk."""
    write_json(folder / MANIFEST, content)
    flush_folder(folder)


def flush_folder(folder: Path) -> None:
    """Flush a folder's file names to disk, against a power cut. Not needed on Windows."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def refuse_another(kept: Mapping[str, Any], asked: Mapping[str, Any], folder: Path) -> None:
    """Raise FlightidError with the first difference if stored rows belong to another request."""
    versions_kept, versions_asked = kept.get("versions", {}), asked["versions"]
    pairs = [
        (key, kept.get(key), asked[key]) for key in ("name", "root", "identity", "columns", "block")
    ]
    pairs += [
        (f"version of {name}", versions_kept.get(name), versions_asked.get(name))
        for name in DECIDING
    ]
    for key, old, new in pairs:
        found = _difference("seed" if key == "root" else key, old, new)
        if found:
            raise FlightidError(
                f"what is kept here is another study: {found}",
                where=str(folder),
                remedy="ask for the same, or name another folder",
            )


def _difference(place: str, old: Any, new: Any) -> str:
    """Return the first difference of two JSON values in words; empty if they are equal."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            found = _difference(
                f"{place}.{key}".removeprefix("identity."), old.get(key), new.get(key)
            )
            if found:
                return found
        return ""
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        return next(
            (
                found
                for at, (a, b) in enumerate(zip(old, new, strict=True))
                if (found := _difference(f"{place}[{at}]", a, b))
            ),
            "",
        )
    return (
        ""
        if type(old) is type(new) and old == new
        else f"{place} was {_shown(old)} and now is {_shown(new)}"
    )


def _shown(value: Any) -> str:
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) < 80 else f"{text[:77]}..."


# ---- Rows kept in a folder as they come

# s between shards, at most lost in a power cut
SHARD_INTERVAL = 5.0
MOST_SHARD_ROWS = 50_000
MOST_SHARDS = 16  # number of shards above which they are merged at the end
LOCK = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """One process a folder; the lock ends with its process, however that ends. Raises
    FlightidError if another has it.
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
    """Lock an open file for this process until it is closed. Raises OSError if another process
    has locked it.
    """
    try:
        import fcntl
    except ImportError:  # Windows, whose lock is of a range of bytes, here the first
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        return
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


class Shards:
    """The rows of one study in its folder, locked by this process.

    Half-written files are removed; unreadable ones are listed in ``damaged`` and recomputed.
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
        """Keep what has ended, written by and by. Raises OSError, as where the disk is full."""
        self._buffer += ended
        if time.monotonic() - self._since > SHARD_INTERVAL or len(self._buffer) >= MOST_SHARD_ROWS:
            self.flush()

    def flush(self) -> None:
        """Write what is not yet written."""
        if self._buffer:
            self._write(columns_of(self.work, self._buffer))
            self._buffer = []
        self._since = time.monotonic()

    def read(self, count: int) -> Columns:
        """Return all rows of the first ``count`` tasks, in order and each once."""
        return in_order(
            joined(all_columns(self.work), [columns for _, columns in self._readable()]), count
        )

    def compact(self) -> None:
        """Make many shards one; wherever it is cut short, no row is lost and none counts twice."""
        found = self._readable()
        if len(found) < MOST_SHARDS:
            return
        columns = joined(all_columns(self.work), [columns for _, columns in found])
        self._write(in_order(columns, int(columns["number"].max()) + 1))
        for path, _ in found:
            path.unlink()

    def _paths(self) -> list[Path]:
        return sorted(self.folder.glob("rows-*.parquet"))

    def _readable(self) -> list[tuple[Path, Columns]]:
        import pyarrow as pa
        import pyarrow.parquet as pq

        found = []
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
            found.append(
                (
                    path,
                    {
                        name: _read(table.column(name), kind)
                        for name, kind in all_columns(self.work).items()
                    },
                )
            )
        return found

    def _write(self, columns: Columns) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        kinds = all_columns(self.work)
        cells = {
            name: columns[name] if kind in FLOATS else columns[name].tolist()
            for name, kind in kinds.items()
        }
        text = io.BytesIO()
        pq.write_table(
            pa.table(cells, schema=self._schema()),
            text,
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
                handle.write(text.getbuffer())
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


def _read(column: pa.ChunkedArray, kind: str) -> np.ndarray:
    return (
        np.array(column.to_numpy(), dtype=float)
        if kind in FLOATS
        else array_of(column.to_pylist(), kind)
    )


def missing(columns: Columns, count: int) -> np.ndarray:
    """Return the numbers below ``count`` that have no row yet, or that a circumstance ended."""
    done = np.zeros(count, dtype=bool)
    done[columns["number"].astype(np.int64)[~columns["passing"].astype(bool)]] = True
    return np.flatnonzero(~done)
