"""Apache Parquet and Feather (Arrow IPC) files, by pyarrow in batches of rows."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.formats.cells import CellTable, Topic, damaged, header_cell, missing_library
from scenarios.files.units import is_unit

FORMAT = "Parquet"
SUFFIXES = (".parquet", ".pq", ".feather", ".ft", ".arrow")
MAGIC = (b"PAR1", b"ARROW1", b"FEA1")
EXTRA = ""
ROWS_PER_BATCH = 1 << 16  # of a batch: what is held twice at a time


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the one table of the file; its index becomes a column where it has a name."""
    feather = raw.startswith((b"ARROW1", b"FEA1")) or path.suffix.lower() in (
        ".feather",
        ".ft",
        ".arrow",
    )
    kind = "Feather" if feather else FORMAT
    try:
        import pandas  # noqa: F401  its description of the columns is in the file
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise missing_library(error, path, kind, EXTRA) from None
    try:
        names, columns, count = _columns(raw, feather=feather)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, kind) from None
    header = tuple(header_cell(frame_header(name), str(path)) for name in names)
    return (Topic("", CellTable(str(path), header, tuple(columns), np.arange(1, count + 1))),)


def frame_header(name: object) -> str:
    """Return the name of a DataFrame's column as a header cell; of a column of several levels
    ``alpha [deg]`` where the last level is a unit.
    """
    if not isinstance(name, tuple):
        return str(name)
    words = [text for level in name if (text := str(level))]
    if len(words) > 1 and is_unit(words[-1]):
        return f"{' '.join(words[:-1])} [{words[-1]}]"
    return " ".join(words)


def _columns(raw: bytes, *, feather: bool) -> tuple[list[Any], list[np.ndarray], int]:
    """Return the names and columns as the DataFrame in the file would have them, a named index
    first; and the number of rows.

    Batches are converted one after the other, to save memory.
    """
    schema, count, batches = _batches(raw, feather=feather)
    described = _described(schema)
    collected = [_Collected(count) for _ in schema.names]
    for batch in batches:
        for column, part in zip(collected, batch.columns, strict=True):
            column.add(part)
    names, columns = [], []
    for name, source in described:
        names.append(name)
        columns.append(collected[source].whole() if isinstance(source, int) else np.asarray(source))
    return names, columns, count


def _batches(raw: bytes, *, feather: bool) -> tuple[Any, int, Iterator[Any]]:
    """Return the schema, the number of rows and the batches of rows."""
    import pyarrow
    from pyarrow import feather as feather_format
    from pyarrow import ipc, parquet

    if not feather:
        file = parquet.ParquetFile(pyarrow.BufferReader(raw))
        return (
            file.schema_arrow,
            file.metadata.num_rows,
            file.iter_batches(batch_size=ROWS_PER_BATCH, use_threads=False),
        )
    if raw.startswith(b"FEA1"):
        table = feather_format.read_table(io.BytesIO(raw))
        return table.schema, table.num_rows, iter(table.to_batches())
    opened = ipc.open_file(pyarrow.BufferReader(raw))
    # Two passes, since storing all batches would need more memory.
    count = sum(opened.get_batch(at).num_rows for at in range(opened.num_record_batches))
    return opened.schema, count, (opened.get_batch(at) for at in range(opened.num_record_batches))


def _described(schema: Any) -> Sequence[tuple[Any, int | range]]:
    """Name of each column and where it comes from: a place among the file's, or a range that the
    file only describes.
    """
    frame = schema.empty_table().to_pandas()
    index = (schema.pandas_metadata or {}).get("index_columns", [])
    stored = [name for name in index if isinstance(name, str)]
    plain = [at for at, name in enumerate(schema.names) if name not in stored]
    columns: list[tuple[Any, int | range]] = list(zip(frame.columns, plain, strict=True))
    if len(stored) == 1 == len(index) and frame.index.name is None and "time" not in frame.columns:
        import pandas

        if isinstance(frame.index, pandas.DatetimeIndex | pandas.TimedeltaIndex):
            return [("time", schema.names.index(stored[0])), *columns]
    if not any(
        (isinstance(each, dict) and each.get("name")) or name is not None
        for each, name in zip(index, frame.index.names, strict=False)
    ):
        return columns
    named: list[tuple[Any, int | range]] = []
    for level, (each, name) in enumerate(zip(index, frame.index.names, strict=False)):
        if isinstance(each, dict):
            named.append((each["name"], range(each["start"], each["stop"], each["step"])))
        else:
            named.append(
                (
                    name if name is not None else "index" if len(index) == 1 else f"level_{level}",
                    schema.names.index(each),
                )
            )
    return [*named, *columns]


@dataclass(eq=False)
class _Collected:
    """A column as it grows: numbers in place, in the file's own type as long as no cell is empty;
    of anything else the parts.
    """

    count: int
    filled: int = 0
    numbers: np.ndarray | None = None
    parts: list[Any] | None = None

    def add(self, part: Any) -> None:
        """Put the rows of a batch after those that are there."""
        import pyarrow

        types = pyarrow.types
        if not (types.is_integer(part.type) or types.is_floating(part.type)):
            self.parts = [*(self.parts or ()), part]
            return
        if part.null_count and types.is_integer(part.type):
            part = part.cast(pyarrow.float64(), safe=False)
        values = part.to_numpy(zero_copy_only=False)
        if self.numbers is None:
            self.numbers = np.empty(self.count, dtype=values.dtype)
        if values.dtype.kind == "f" and self.numbers.dtype.kind != "f":
            self.numbers = self.numbers.astype(float)
        self.numbers[self.filled : self.filled + len(values)] = values
        self.filled += len(values)

    def whole(self) -> np.ndarray:
        """The column: numbers, times without a zone, or cells with None if one is empty."""
        import pandas
        import pyarrow

        if self.numbers is not None:
            return self.numbers
        if not self.parts:
            return np.zeros(0)
        series = pyarrow.chunked_array(self.parts).to_pandas()
        if isinstance(series.dtype, pandas.DatetimeTZDtype):
            series = series.dt.tz_convert(None)
        if isinstance(series.dtype, np.dtype) and series.dtype.kind in "mM":
            return np.asarray(series.to_numpy())
        return np.asarray(series.astype(object).where(series.notna(), None).to_numpy())
