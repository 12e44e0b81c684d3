"""Tables that other programs save: spreadsheets, Parquet, Feather and NumPy files. Rules for the
arrays of NumPy are in ``variables.py``.
"""

from __future__ import annotations

import datetime
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.formats.cells import (
    CellTable,
    Reader,
    Topic,
    damaged,
    header_cell,
    header_row,
    missing_library,
    no_table,
    unit_row,
    width_of,
)
from scenarios.files.formats.variables import topics_of_variables
from scenarios.files.units import is_unit

# ---- Spreadsheets by python-calamine: each sheet with a header row is a topic


def read_spreadsheet(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return one topic for each sheet with a table. Its name is that of the sheet if there are
    several.
    """
    try:
        from python_calamine import CalamineWorkbook
    except ImportError as error:
        raise missing_library(error, path, "spreadsheets", "spreadsheets") from None
    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(raw))
        sheets = [
            (name, book.get_sheet_by_name(name).to_python(skip_empty_area=False))
            for name in book.sheet_names
        ]
    except BaseException as error:  # errors of the compiled library are no Exception
        if isinstance(error, KeyboardInterrupt | SystemExit):
            raise
        raise damaged(error, path, "spreadsheet") from None
    tables = [
        (name, table)
        for name, rows in sheets
        if (table := _sheet_table(path, name, rows)) is not None
    ]
    if not tables:
        raise no_table(
            path,
            [name for name, _ in sheets],
            "give a sheet with a header row and one row a sample",
        )
    return tuple(Topic(name if len(tables) > 1 else "", table) for name, table in tables)


def _sheet_table(path: Path, sheet: str, rows: list[list[Any]]) -> CellTable | None:
    """Return the table of a sheet; None if the sheet has no header with a row of numbers below."""
    texts = [["" if cell is None else str(cell) for cell in row] for row in rows]
    head = header_row(texts)
    if head is None or head + 1 >= len(rows):
        return None
    width = width_of(texts[head])
    where = f"{path}, sheet {sheet!r}"
    header = tuple(header_cell(cell, where) for cell in texts[head][:width])
    units = unit_row(header, texts[head + 1][:width])
    begin = head + (2 if units else 1)
    filled_rows = [
        i for i in range(begin, len(rows)) if any(cell.strip() for cell in texts[i][:width])
    ]
    columns = tuple(
        _sheet_column([rows[i][column] for i in filled_rows]) for column in range(width)
    )
    return CellTable(where, header, columns, np.array(filled_rows, dtype=int) + 1, units=units)


def _sheet_column(cells: list[Any]) -> np.ndarray:
    """Return a column as floats if every cell is a number or empty; else as cells, with dates and
    times of day as ISO texts.
    """
    if all(isinstance(cell, int | float) or cell in ("", None) for cell in cells):
        return np.array(
            [np.nan if cell in ("", None) else float(cell) for cell in cells], dtype=float
        )
    column = np.empty(len(cells), dtype=object)
    column[:] = [_sheet_cell(cell) for cell in cells]
    return column


def _sheet_cell(cell: Any) -> Any:
    """Return a cell with a date or time of day as ISO text, a duration in s, and None if empty."""
    if isinstance(cell, datetime.datetime | datetime.date | datetime.time):
        return cell.isoformat()
    if isinstance(cell, datetime.timedelta):
        return cell.total_seconds()
    return None if cell == "" else cell


# ---- Apache Parquet and Feather (Arrow IPC) files by pyarrow, in batches of rows

ROWS_PER_BATCH = 1 << 16  # rows that are in memory twice at a time
FEATHER_SUFFIXES = (".feather", ".ft", ".arrow")


def read_parquet(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the table of the file as one topic. An index with a name is a column."""
    feather = raw.startswith((b"ARROW1", b"FEA1")) or path.suffix.lower() in FEATHER_SUFFIXES
    kind = "Feather" if feather else "Parquet"
    try:
        import pandas  # noqa: F401  the file may have a description of the columns by pandas
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise missing_library(error, path, kind, "") from None
    try:
        names, columns, count = _arrow_columns(raw, feather=feather)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, kind) from None
    header = tuple(header_cell(frame_header(name), str(path)) for name in names)
    return (Topic("", CellTable(str(path), header, tuple(columns), np.arange(1, count + 1))),)


def frame_header(name: object) -> str:
    """Return the name of a column of a DataFrame as a header cell. If the last of several levels is
    a unit, the result is ``alpha [deg]``.
    """
    if not isinstance(name, tuple):
        return str(name)
    words = [text for level in name if (text := str(level))]
    if len(words) > 1 and is_unit(words[-1]):
        return f"{' '.join(words[:-1])} [{words[-1]}]"
    return " ".join(words)


def _arrow_columns(raw: bytes, *, feather: bool) -> tuple[list[Any], list[np.ndarray], int]:
    """Return the names and columns of the DataFrame in the file, a named index first, and the
    number of rows.

    Batches are converted one after the other, to save memory.
    """
    schema, count, batches = _batches(raw, feather=feather)
    stored_columns = [_GrowingColumn(count) for _ in schema.names]
    for batch in batches:
        for column, part in zip(stored_columns, batch.columns, strict=True):
            column.add(part)
    names, columns = [], []
    for name, source in _names_and_sources(schema):
        names.append(name)
        if isinstance(source, int):
            columns.append(stored_columns[source].values())
        else:
            columns.append(np.asarray(source))
    return names, columns, count


def _batches(raw: bytes, *, feather: bool) -> tuple[Any, int, Iterator[Any]]:
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
    file = ipc.open_file(pyarrow.BufferReader(raw))
    # The batches are read_parquet twice, since all of them together would need more memory.
    batches = range(file.num_record_batches)
    count = sum(file.get_batch(i).num_rows for i in batches)
    return file.schema, count, (file.get_batch(i) for i in batches)


def _names_and_sources(schema: Any) -> Sequence[tuple[Any, int | range]]:
    """Return the name of each column with its source: its position in the file, or a range of
    numbers that the file describes.
    """
    frame = schema.empty_table().to_pandas()
    index = (schema.pandas_metadata or {}).get("index_columns", [])
    stored_levels = [name for name in index if isinstance(name, str)]
    positions = [i for i, name in enumerate(schema.names) if name not in stored_levels]
    columns: list[tuple[Any, int | range]] = list(zip(frame.columns, positions, strict=True))
    is_single = len(stored_levels) == 1 == len(index)
    if is_single and frame.index.name is None and "time" not in frame.columns:
        import pandas

        if isinstance(frame.index, pandas.DatetimeIndex | pandas.TimedeltaIndex):
            return [("time", schema.names.index(stored_levels[0])), *columns]
    levels = list(zip(index, frame.index.names, strict=False))
    if not any(
        (isinstance(level, dict) and level.get("name")) or name is not None
        for level, name in levels
    ):
        return columns
    index_columns: list[tuple[Any, int | range]] = []
    for number, (level, name) in enumerate(levels):
        if isinstance(level, dict):
            values = range(level["start"], level["stop"], level["step"])
            index_columns.append((level["name"], values))
            continue
        if name is None:
            name = "index" if len(index) == 1 else f"level_{number}"
        index_columns.append((name, schema.names.index(level)))
    return [*index_columns, *columns]


@dataclass(eq=False)
class _GrowingColumn:
    """A column to which batches are added.

    Attributes
    ----------
    count : number of rows of the whole column.
    filled : number of rows so far, of a column of numbers.
    numbers : ``(count,)`` the numbers, in the type of the file if no cell is empty.
    parts : batches of a column of other cells.
    """

    count: int
    filled: int = 0
    numbers: np.ndarray | None = None
    parts: list[Any] | None = None

    def add(self, part: Any) -> None:
        """Append the rows of a batch."""
        import pyarrow

        types = pyarrow.types
        if not (types.is_integer(part.type) or types.is_floating(part.type)):
            self.parts = [*(self.parts or ()), part]
            return
        if part.null_count and types.is_integer(part.type):
            part = part.cast(pyarrow.float64(), safe=False)
        numbers = part.to_numpy(zero_copy_only=False)
        if self.numbers is None:
            self.numbers = np.empty(self.count, dtype=numbers.dtype)
        if numbers.dtype.kind == "f" and self.numbers.dtype.kind != "f":
            self.numbers = self.numbers.astype(float)
        self.numbers[self.filled : self.filled + len(numbers)] = numbers
        self.filled += len(numbers)

    def values(self) -> np.ndarray:
        """Return the whole column: numbers, times in UTC, or cells, where None is an empty one."""
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


# ---- NumPy files: named arrays, or one array, which may have named columns


def read_numpy(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the topics of the file. Pickled objects are never loaded: they could run a program."""
    try:
        loaded = np.load(io.BytesIO(raw), allow_pickle=False)
        if not isinstance(loaded, np.ndarray):
            variables = {name: loaded[name] for name in loaded.files}
        elif loaded.dtype.names:
            variables = {name: loaded[name] for name in loaded.dtype.names}
        else:
            variables = {"data": loaded}
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, "NumPy") from None
    return topics_of_variables(path, variables)


READERS = (
    Reader(
        "spreadsheet",
        (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", b"PK\x03\x04"),
        read_spreadsheet,
    ),
    Reader(
        "Parquet",
        (".parquet", ".pq", ".feather", ".ft", ".arrow"),
        (b"PAR1", b"ARROW1", b"FEA1"),
        read_parquet,
    ),
    Reader("NumPy", (".npy", ".npz"), (b"\x93NUMPY",), read_numpy),
)
