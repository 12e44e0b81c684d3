"""Files of NumPy: ``.npz`` with named arrays, and ``.npy`` with one array, which may have named
columns. The rules for the arrays are in ``variables.py``.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from scenarios.files.formats.cells import Topic, damaged
from scenarios.files.formats.variables import topics_of_variables

FORMAT = "NumPy"
SUFFIXES = (".npy", ".npz")
MAGIC = (b"\x93NUMPY",)
EXTRA = ""


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
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
        raise damaged(error, path, FORMAT) from None
    return topics_of_variables(path, variables)
