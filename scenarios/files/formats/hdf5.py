"""HDF5 files by h5py, MAT files of version 7.3 among them: the groups become structs, the datasets
their columns.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.formats.cells import Topic, damaged, missing_library
from scenarios.files.formats.variables import topics_of_variables

FORMAT = "HDF5"
SUFFIXES = (".h5", ".hdf5", ".hdf", ".he5", ".nc4")
MAGIC = (b"\x89HDF\r\n\x1a\n",)
EXTRA = "recorders"
UNIT_ATTRIBUTES = ("units", "unit", "Unit", "Units", "UNIT", "UNITS")
# of the columns of a matrix
NAME_ATTRIBUTES = ("columns", "column_names", "names", "labels", "fields", "channels")


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the tables of the file, as of a MAT file with the same variables."""
    try:
        import h5py
    except ImportError as error:
        raise missing_library(error, path, FORMAT, EXTRA) from None
    try:
        with h5py.File(io.BytesIO(raw), "r") as file:
            variables = _variables(file, file, matlab=False)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, FORMAT) from None
    return topics_of_variables(path, variables)


def read_matlab(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return a MAT file of version 7.3: MATLAB writes arrays with their dimensions turned round,
    and texts as numbers.
    """
    try:
        import h5py
    except ImportError as error:
        raise missing_library(error, path, "MAT files of version 7.3", EXTRA) from None
    try:
        with h5py.File(io.BytesIO(raw[:]), "r") as file:
            variables = _variables(file, file, matlab=True)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, "MAT") from None
    return topics_of_variables(path, variables)


def _variables(group: Any, file: Any, *, matlab: bool) -> dict[str, Any]:
    import h5py

    result: dict[str, Any] = {}
    for name, item in group.items():
        if name.startswith("#"):  # MATLAB's store of referenced objects
            continue
        if isinstance(item, h5py.Group):
            result[name] = _variables(item, file, matlab=matlab)
        elif isinstance(item, h5py.Dataset):
            value = _value(item, file, matlab=matlab)
            names = next(
                (_names(item.attrs[key]) for key in NAME_ATTRIBUTES if key in item.attrs), ()
            )
            if np.ndim(value) == 2 and len(names) == np.shape(value)[1] > 1:
                result[name] = {each: value[:, at] for at, each in enumerate(names)}
                continue
            unit = next(
                (_text(item.attrs[key]) for key in UNIT_ATTRIBUTES if key in item.attrs), ""
            )
            result[name] = {"data": value, "units": unit} if unit else value
    return result


def _value(item: Any, file: Any, *, matlab: bool) -> Any:
    import h5py

    kind = item.attrs.get("MATLAB_class", b"")
    if item.attrs.get("MATLAB_empty", 0):
        return np.zeros(0)
    if item.dtype.names:  # a table of named columns, as pandas and PyTables write
        values = item[()]
        return {name: values[name] for name in item.dtype.names}
    values = item[()]
    if h5py.check_ref_dtype(item.dtype) is not None:
        references = np.asarray(values).reshape(-1)
        # NumPy would make one array of cells of one size
        cells = np.empty(references.size, dtype=object)
        for at, reference in enumerate(references):
            cells[at] = _value(file[reference], file, matlab=matlab)
        return cells
    if kind == b"char":
        return "".join(chr(code) for code in np.asarray(values).T.reshape(-1))
    if h5py.check_string_dtype(item.dtype) is not None:
        return (
            np.array([_text(text) for text in np.asarray(values).reshape(-1)], dtype=object)
            if np.ndim(values)
            else _text(values)
        )
    return np.asarray(values).T if matlab else np.asarray(values)


def _names(value: Any) -> tuple[str, ...]:
    """Return the names in an attribute: a list of texts, or one text with commas between them."""
    if np.ndim(value) == 1:
        return tuple(_text(each).strip() for each in value)
    return tuple(name.strip() for name in _text(value).split(","))


def _text(value: Any) -> str:
    return (
        value.decode("utf-8", "replace")
        if isinstance(value, bytes)
        else str(np.asarray(value).reshape(-1)[0] if np.ndim(value) else value)
    )
