"""HDF5 files by h5py, also MAT files of version 7.3: a group is a struct, and a dataset is a
variable in it.
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
# attributes with the names of the columns of a matrix
NAME_ATTRIBUTES = ("columns", "column_names", "names", "labels", "fields", "channels")


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the topics of the file, by the rules of ``variables.py``."""
    return _topics(path, raw, matlab=False)


def read_matlab(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the topics of a MAT file of version 7.3. Its arrays are transposed, and its texts are
    numbers.
    """
    return _topics(path, raw, matlab=True)


def _topics(path: Path, raw: bytes, *, matlab: bool) -> tuple[Topic, ...]:
    try:
        import h5py
    except ImportError as error:
        name = "MAT files of version 7.3" if matlab else FORMAT
        raise missing_library(error, path, name, EXTRA) from None
    try:
        with h5py.File(io.BytesIO(raw), "r") as file:
            variables = _variables(file, file, matlab=matlab)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, "MAT" if matlab else FORMAT) from None
    return topics_of_variables(path, variables)


def _variables(group: Any, file: Any, *, matlab: bool) -> dict[str, Any]:
    """Return name -> variable of a group; inner groups are mappings of the same kind."""
    import h5py

    variables: dict[str, Any] = {}
    for name, item in group.items():
        if name.startswith("#"):  # objects of MATLAB to which references point
            continue
        if isinstance(item, h5py.Group):
            variables[name] = _variables(item, file, matlab=matlab)
        elif isinstance(item, h5py.Dataset):
            value = _value(item, file, matlab=matlab)
            names = next(
                (_names(item.attrs[key]) for key in NAME_ATTRIBUTES if key in item.attrs), ()
            )
            if np.ndim(value) == 2 and len(names) == np.shape(value)[1] > 1:
                variables[name] = {column: value[:, i] for i, column in enumerate(names)}
                continue
            unit = next(
                (_text(item.attrs[key]) for key in UNIT_ATTRIBUTES if key in item.attrs), ""
            )
            variables[name] = {"data": value, "units": unit} if unit else value
    return variables


def _value(item: Any, file: Any, *, matlab: bool) -> Any:
    """Return a dataset as an array, a text, or a mapping of columns."""
    import h5py

    matlab_class = item.attrs.get("MATLAB_class", b"")
    if item.attrs.get("MATLAB_empty", 0):
        return np.zeros(0)
    if item.dtype.names:  # a table with named columns, as written by pandas and PyTables
        values = item[()]
        return {name: values[name] for name in item.dtype.names}
    values = item[()]
    if h5py.check_ref_dtype(item.dtype) is not None:
        references = np.asarray(values).reshape(-1)
        # np.array would join cells of equal size to one array.
        cells = np.empty(references.size, dtype=object)
        for i, reference in enumerate(references):
            cells[i] = _value(file[reference], file, matlab=matlab)
        return cells
    if matlab_class == b"char":
        return "".join(chr(code) for code in np.asarray(values).T.reshape(-1))
    if h5py.check_string_dtype(item.dtype) is not None:
        if not np.ndim(values):
            return _text(values)
        return np.array([_text(text) for text in np.asarray(values).reshape(-1)], dtype=object)
    return np.asarray(values).T if matlab else np.asarray(values)


def _names(value: Any) -> tuple[str, ...]:
    """Return the names in an attribute, which is a list of texts or one text with commas."""
    if np.ndim(value) == 1:
        return tuple(_text(name).strip() for name in value)
    return tuple(name.strip() for name in _text(value).split(","))


def _text(value: Any) -> str:
    """Return a text, or the first text of an array."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return str(np.asarray(value).reshape(-1)[0] if np.ndim(value) else value)
