"""Raw tables from text, Parquet and MAT files."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from scenarios.files.measured.cells import Table, first_line, one_line
from scenarios.files.measured.delimited import delimited_table
from scenarios.files.measured.sizes import refuse_oversized
from scenarios.files.sources import Source
from sim.errors import RecordError


def table_of(source: Source) -> Table:
    """The table in a file: ``.parquet``/``.pq``, ``.mat``, anything else as separated text (``.gz``: compressed).

    Raises
    ------
    RecordError : the file is empty, damaged, not UTF-8, or has a header and no rows.
    """
    if not source.content:
        raise RecordError("the file is empty", where=str(source.path), remedy="give a header row and one row a sample")
    refuse_oversized(source)
    table = _READERS.get(source.path.suffix.lower(), delimited_table)(source.path, source.content)
    if table.rows.size == 0:
        raise RecordError("there is a header but no rows", where=str(source.path), remedy="give one row a sample")
    return table


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
