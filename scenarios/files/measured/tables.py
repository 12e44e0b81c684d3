"""Raw tables from CSV, Parquet and MAT files: column headers, cells as they stand, and the row numbers that a user sees."""

from __future__ import annotations

import csv
import gzip
import io
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from scenarios.files.sources import Source
from sim.errors import RecordError

MISSING = frozenset({"", "nan", "-nan", "na", "n/a", "null"})


@dataclass(frozen=True, eq=False, repr=False)
class Table:
    """Columns of one file, nothing interpreted yet.

    Attributes
    ----------
    file : the path as the user gave it, for messages.
    header : one cell a column, on one line.
    columns : one sequence a column: texts, or an array of whatever the file holds.
    rows : number of each row as the user sees it; the header of a CSV file is row 1.
    ragged : cells found in the rows (by position) that have more or fewer than the header.
    """

    file: str
    header: tuple[str, ...]
    columns: tuple[list[str] | np.ndarray, ...]
    rows: np.ndarray
    ragged: Mapping[int, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Table {self.file}: {self.rows.size} rows of {len(self.header)} columns>"


@dataclass(frozen=True, eq=False)
class Numbers:
    """One column as numbers, NaN where the cell is empty or holds text, and those texts by position."""

    values: np.ndarray
    texts: Mapping[int, str]


def table_of(source: Source) -> Table:
    """The table in a file: ``.parquet``/``.pq``, ``.mat``, anything else as comma-separated text (``.gz``: compressed).

    Raises
    ------
    RecordError : the file is empty, damaged, not UTF-8, or has a header and no rows.
    """
    if not source.content:
        raise RecordError("the file is empty", where=str(source.path), remedy="give a header row and one row a sample")
    table = _READERS.get(source.path.suffix.lower(), _csv_table)(source.path, source.content)
    if table.rows.size == 0:
        raise RecordError("there is a header but no rows", where=str(source.path), remedy="give one row a sample")
    return table


def numbers(column: list[str] | np.ndarray) -> Numbers:
    """A column as floats; what is not a number is kept apart with its position."""
    if isinstance(column, np.ndarray) and column.dtype.kind in "fiu":
        return Numbers(column.astype(float), {})
    values, texts = np.full(len(column), np.nan), {}
    for position, cell in enumerate(column):
        if cell is None:
            continue
        text = str(cell).strip()
        if text.lower() in MISSING:
            continue
        try:
            values[position] = _number(text)
        except ValueError:
            texts[position] = text
    return Numbers(values, texts)


def first_line(error: Exception) -> str:
    """The first line of what another library says, short enough for a message."""
    text = str(error).strip()
    return text.splitlines()[0][:160] if text else type(error).__name__


def one_line(cell: str) -> str:
    """A header cell without the line breaks that spreadsheets put into it."""
    return " ".join(cell.split())


def _number(text: str) -> float:
    if "_" in text or not text.isascii():  # float() takes 1_000 and digits of other scripts
        raise ValueError(text)
    return float(text)


def _csv_table(path: Path, raw: bytes) -> Table:
    if path.suffix.lower() == ".gz":
        try:
            raw = gzip.decompress(raw)
        except (OSError, EOFError, zlib.error) as error:
            raise RecordError(f"not a gzip file ({first_line(error)})", where=str(path), remedy="compress it again, or give the plain file") from None
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = raw[: error.start].count(b"\n") + 1
        raise RecordError("not UTF-8 text", where=f"{path}, row {row}", remedy="save it as CSV in UTF-8, as Parquet or as MAT") from None
    reader = csv.reader(io.StringIO(text, newline=""))
    lines: list[tuple[int, list[str]]] = []
    try:
        for cells in reader:
            if cells:
                lines.append((reader.line_num, cells))
    except csv.Error as error:
        raise RecordError(
            f"not comma-separated text ({error})", where=f"{path}, row {reader.line_num}", remedy="save it as CSV in UTF-8, as Parquet or as MAT"
        ) from None
    if not any(cell.strip() for _, cells in lines for cell in cells):
        raise RecordError("the file is empty", where=str(path), remedy="give a header row and one row a sample")
    header = tuple(one_line(cell) for cell in lines[0][1])
    if len(header) == 1 and any(mark in header[0] for mark in ";\t"):
        raise RecordError("the columns are not separated by commas", where=f"{path}, row 1", remedy="save it with commas between the columns")
    body = [cells for _, cells in lines[1:]]
    ragged = {position: len(cells) for position, cells in enumerate(body) if len(cells) != len(header)}
    if ragged:
        body = [cells + [""] * (len(header) - len(cells)) for cells in body]
    columns = tuple([cells[index] for cells in body] for index in range(len(header)))
    return Table(str(path), header, columns, np.array([row for row, _ in lines[1:]], dtype=int), ragged)


def _parquet_table(path: Path, raw: bytes) -> Table:
    try:
        import pandas
        import pyarrow  # noqa: F401  pandas would choose and name another engine
    except ImportError as error:
        what = f"reading Parquet needs {error.name}, which is not installed"
        raise RecordError(what, where=str(path), remedy="python -m pip install pyarrow, or save the record as CSV") from None
    try:
        frame = pandas.read_parquet(io.BytesIO(raw), engine="pyarrow")
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise RecordError(f"not a Parquet file ({first_line(error)})", where=str(path), remedy="write it again, or save the record as CSV") from None
    if frame.index.name is not None:
        frame = frame.reset_index()
    columns = []
    for index in range(frame.shape[1]):
        series = frame.iloc[:, index]
        plain = pandas.api.types.is_numeric_dtype(series.dtype) and not pandas.api.types.is_bool_dtype(series.dtype)
        columns.append(series.to_numpy(dtype=float, na_value=np.nan) if plain else series.astype(object).where(series.notna(), None).to_numpy())
    return Table(str(path), tuple(one_line(str(name)) for name in frame.columns), tuple(columns), np.arange(1, len(frame) + 1))


def _mat_table(path: Path, raw: bytes) -> Table:
    from scipy.io import loadmat

    try:
        content = loadmat(io.BytesIO(raw), simplify_cells=True)
    except NotImplementedError:
        raise RecordError("MAT files of version 7.3 are not read", where=str(path), remedy="save it in MATLAB with -v7") from None
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise RecordError(f"not a MAT file ({first_line(error)})", where=str(path), remedy="save it in MATLAB with -v7, or as CSV") from None
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    structs = [value for value in variables.values() if isinstance(value, dict)]
    if len(structs) == 1 and "time" not in variables:
        variables = structs[0]
    flat = {name: value for name, value in variables.items() if not isinstance(value, dict) and np.ndim(value) <= 1 and np.size(value)}
    vectors = {name: np.atleast_1d(value) for name, value in flat.items()}
    if not vectors:
        raise RecordError("there is no vector in the file", where=str(path), remedy="save named vectors, or one struct of vectors")
    rows = max(vector.size for vector in vectors.values()) if "time" not in vectors else vectors["time"].size
    return Table(str(path), tuple(vectors), tuple(vectors.values()), np.arange(1, rows + 1))


_READERS: Mapping[str, Callable[[Path, bytes], Table]] = {".parquet": _parquet_table, ".pq": _parquet_table, ".mat": _mat_table}
