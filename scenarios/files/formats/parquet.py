"""Apache Parquet and Feather (Arrow IPC) files, by pyarrow through pandas."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from scenarios.files.formats.cells import Table, header_cell
from scenarios.files.formats.topic import Topic, damaged, missing_library
from scenarios.files.units import is_unit

FORMAT = "Parquet"
SUFFIXES = (".parquet", ".pq", ".feather", ".ft", ".arrow")
MAGIC = (b"PAR1", b"ARROW1", b"FEA1")
EXTRA = ""


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """The one table of the file; its index becomes a column where it has a name."""
    feather = raw.startswith((b"ARROW1", b"FEA1")) or path.suffix.lower() in (".feather", ".ft", ".arrow")
    kind = "Feather" if feather else FORMAT
    try:
        import pandas
        import pyarrow  # noqa: F401  pandas would choose and name another engine
    except ImportError as error:
        raise missing_library(error, path, kind, EXTRA) from None
    try:
        frame = pandas.read_feather(io.BytesIO(raw)) if feather else pandas.read_parquet(io.BytesIO(raw), engine="pyarrow")
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, kind) from None
    if any(name is not None for name in frame.index.names):
        frame = frame.reset_index()
    columns = []
    for index in range(frame.shape[1]):
        series = frame.iloc[:, index]
        if isinstance(series.dtype, pandas.DatetimeTZDtype):
            series = series.dt.tz_convert(None)
        plain = pandas.api.types.is_numeric_dtype(series.dtype) and not pandas.api.types.is_bool_dtype(series.dtype)
        if isinstance(series.dtype, np.dtype) and series.dtype.kind in "mM":
            columns.append(series.to_numpy())
        else:
            cells = series.astype(object).where(series.notna(), None).to_numpy() if not plain else None
            columns.append(series.to_numpy(dtype=float, na_value=np.nan) if cells is None else cells)
    header = tuple(header_cell(frame_header(name), str(path)) for name in frame.columns)
    return (Topic("", Table(str(path), header, tuple(columns), np.arange(1, len(frame) + 1))),)


def frame_header(name: object) -> str:
    """The name of a DataFrame's column as a header cell; of a column of several levels ``alpha [deg]`` where the last level is a unit."""
    if not isinstance(name, tuple):
        return str(name)
    words = [text for level in name if (text := str(level))]
    if len(words) > 1 and is_unit(words[-1]):
        return f"{' '.join(words[:-1])} [{words[-1]}]"
    return " ".join(words)
