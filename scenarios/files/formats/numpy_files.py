"""NumPy's files: ``.npz`` with named arrays, ``.npy`` with one, also one of named columns; by the
rules of ``variables.py``.
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
    """The tables of the file. Pickled objects, which could run a program, are never loaded."""
    try:
        loaded = np.load(io.BytesIO(raw), allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            variables = (
                {name: loaded[name] for name in loaded.dtype.names}
                if loaded.dtype.names
                else {"data": loaded}
            )
        else:
            variables = {name: loaded[name] for name in loaded.files}
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, FORMAT) from None
    return topics_of_variables(path, variables)
