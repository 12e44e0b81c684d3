"""Rows kept in a folder as they come: shards of Parquet, each written as a whole, beside the manifest."""

from __future__ import annotations

import io
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from scenarios.tasks.manifest import flush_folder
from scenarios.tasks.rows import FLOATS, Columns, all_columns, array_of, columns_of, in_order, joined
from scenarios.tasks.work import Ended, Work
from sim.errors import FlightidError

if TYPE_CHECKING:
    import pyarrow as pa

EVERY = 5.0  # s between shards: what a power cut costs at most, beside the blocks under way
MOST = 50_000  # rows in one shard
MANY = 16  # shards, from which they are made one when the study ends
LOCK = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """One process a folder; the lock ends with its process, however that ends. Raises FlightidError where another has it."""
    with open(folder / LOCK, "ab") as handle:
        try:
            _lock(handle.fileno())
        except OSError:
            remedy = "wait for it, or name another folder"
            raise FlightidError("another process is writing here", where=str(folder), remedy=remedy) from None
        yield


def _lock(descriptor: int) -> None:
    """Lock an open file for this process until it is closed. Raises OSError where another process has locked it."""
    try:
        import fcntl
    except ImportError:  # Windows, whose lock is of a range of bytes, here the first
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        return
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


class Shards:
    """The rows of one study in its folder, which is this process's alone.

    What was half written when a process ended is taken away, and what cannot be read is told in ``damaged`` and computed again.
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
        if time.monotonic() - self._since > EVERY or len(self._buffer) >= MOST:
            self.flush()

    def flush(self) -> None:
        """Write what is not yet written."""
        if self._buffer:
            self._write(columns_of(self.work, self._buffer))
            self._buffer = []
        self._since = time.monotonic()

    def read(self, count: int) -> Columns:
        """All rows of the first ``count`` tasks, in order and each once."""
        return in_order(joined(all_columns(self.work), [columns for _, columns in self._readable()]), count)

    def compact(self) -> None:
        """Make many shards one; wherever it is cut short, no row is lost and none counts twice."""
        found = self._readable()
        if len(found) < MANY:
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
                table = pq.read_table(io.BytesIO(path.read_bytes()), page_checksum_verification=True)
                if table.schema != self._schema():
                    raise ValueError("it has other columns")
            except (OSError, ValueError, pa.ArrowException) as error:
                path.replace(path.with_suffix(".damaged"))
                self.damaged.append(f"{path.name} ({' '.join(str(error).split())[:120]})")
                continue
            found.append((path, {name: _read(table.column(name), kind) for name, kind in all_columns(self.work).items()}))
        return found

    def _write(self, columns: Columns) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        kinds = all_columns(self.work)
        cells = {name: columns[name] if kind in FLOATS else columns[name].tolist() for name, kind in kinds.items()}
        text = io.BytesIO()
        pq.write_table(pa.table(cells, schema=self._schema()), text, compression="zstd", write_page_checksum=True)
        last = max((int(path.stem.split("-")[1]) for path in self.folder.glob("rows-*")), default=-1)
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

        types = {"float": pa.float64(), "time": pa.float64(), "int": pa.int64(), "bool": pa.bool_(), "text": pa.string()}
        return pa.schema([pa.field(name, types[kind]) for name, kind in all_columns(self.work).items()])


def _read(column: pa.ChunkedArray, kind: str) -> np.ndarray:
    return np.array(column.to_numpy(), dtype=float) if kind in FLOATS else array_of(column.to_pylist(), kind)


def missing(columns: Columns, count: int) -> np.ndarray:
    """Numbers below ``count`` that have no row yet, or that a circumstance ended."""
    done = np.zeros(count, dtype=bool)
    done[columns["number"].astype(np.int64)[~columns["passing"].astype(bool)]] = True
    return np.flatnonzero(~done)
