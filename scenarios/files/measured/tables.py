"""Raw tables from text, Parquet and MAT files."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.measured.cells import Table, first_line, header_cell
from scenarios.files.measured.delimited import delimited_table
from scenarios.files.sources import Source
from scenarios.files.units import is_unit
from sim.errors import RecordError


def table_of(source: Source) -> Table:
    """The table in a file: ``.parquet``/``.pq``, ``.mat``, anything else as separated text (``.gz``: compressed).

    Raises
    ------
    RecordError : the file is empty, damaged, not UTF-8, or has a header and no rows.
    """
    if not source.content:
        raise RecordError("the file is empty", where=str(source.path), remedy="give a header row and one row a sample")
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
    if any(name is not None for name in frame.index.names):
        frame = frame.reset_index()
    columns = []
    for index in range(frame.shape[1]):
        series = frame.iloc[:, index]
        plain = pandas.api.types.is_numeric_dtype(series.dtype) and not pandas.api.types.is_bool_dtype(series.dtype)
        columns.append(series.to_numpy(dtype=float, na_value=np.nan) if plain else series.astype(object).where(series.notna(), None).to_numpy())
    header = tuple(header_cell(frame_header(name), str(path)) for name in frame.columns)
    return Table(str(path), header, tuple(columns), np.arange(1, len(frame) + 1))


def frame_header(name: object) -> str:
    """The name of a DataFrame's column as a header cell; of a column of several levels ``alpha [deg]`` where the last level is a unit."""
    if not isinstance(name, tuple):
        return str(name)
    words = [text for level in name if (text := str(level))]
    if len(words) > 1 and is_unit(words[-1]):
        return f"{' '.join(words[:-1])} [{words[-1]}]"
    return " ".join(words)


def _mat_table(path: Path, raw: bytes) -> Table:
    from scipy.io import loadmat

    try:
        content = loadmat(io.BytesIO(raw), simplify_cells=True)
    except NotImplementedError:
        raise RecordError("MAT files of version 7.3 are not read", where=str(path), remedy="save it in MATLAB with -v7") from None
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise RecordError(f"not a MAT file ({first_line(error)})", where=str(path), remedy="save it in MATLAB with -v7, or as CSV") from None
    variables = {name: value for name, value in content.items() if not name.startswith("__")}
    structs = [name for name, value in variables.items() if isinstance(value, dict)]
    twice: frozenset[str] = frozenset()
    if len(structs) == 1 and "time" not in variables:
        inside = variables.pop(structs[0])
        twice = frozenset(inside) & frozenset(variables)
        variables = {**variables, **inside}
    vectors: dict[str, np.ndarray] = {}
    unreadable: dict[str, str] = {}
    for name, value in variables.items():
        vector, fault = _mat_vector(value)
        fault = f"there twice, in the struct {structs[0]} and outside it" if name in twice else fault
        if fault:
            unreadable[name] = fault
        else:
            vectors[name] = vector
    if not vectors:
        found = ", ".join(f"{name} is {fault}" for name, fault in unreadable.items())
        what = "there is no vector in the file" + (f" ({first_line(ValueError(found))})" if found else "")
        raise RecordError(what, where=str(path), remedy="save named vectors, or one struct of vectors")
    rows = vectors["time"].size if "time" in vectors else max(vector.size for vector in vectors.values())
    header = tuple(header_cell(name, str(path)) for name in (*vectors, *unreadable))
    columns = (*vectors.values(), *(np.full(rows, np.nan) for _ in unreadable))
    faults = {len(vectors) + at: fault for at, fault in enumerate(unreadable.values())}
    return Table(str(path), header, columns, np.arange(1, rows + 1), unreadable=faults)


def _mat_vector(value: Any) -> tuple[np.ndarray, str]:
    """A MAT variable as a vector, with an empty text; where it is none an empty vector, and a text that says what it is."""
    from scipy.sparse import issparse

    none = np.zeros(0)
    if isinstance(value, dict):
        return none, "a struct"
    if issparse(value):
        if min(value.shape) > 1:
            return none, f"a sparse array of {'x'.join(map(str, value.shape))}"
        value = value.toarray().ravel()
    array = np.atleast_1d(value)
    if array.size == 0:
        return none, "empty"
    return (array, "") if array.ndim == 1 else (none, f"an array of {'x'.join(map(str, array.shape))}")


_READERS: Mapping[str, Callable[[Path, bytes], Table]] = {".parquet": _parquet_table, ".pq": _parquet_table, ".mat": _mat_table}
