"""MAT files of version 4 to 7.2 by SciPy, of version 7.3 by h5py; the rules for their variables are in ``variables.py``."""

from __future__ import annotations

import io
from pathlib import Path

from scenarios.files.formats.hdf5 import read_matlab
from scenarios.files.formats.topic import Topic, damaged
from scenarios.files.formats.variables import topics_of_variables

FORMAT = "MAT"
SUFFIXES = (".mat",)
MAGIC = (b"MATLAB 5.0", b"MATLAB 7.3")
EXTRA = ""


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """The tables of a MAT file of version 4 to 7.2 by SciPy, of version 7.3 by h5py."""
    if raw.startswith(b"MATLAB 7.3") or raw.startswith(b"\x89HDF"):
        return read_matlab(path, raw)
    from scipy.io import loadmat

    try:
        content = loadmat(io.BytesIO(raw), simplify_cells=True)
    except NotImplementedError:
        return read_matlab(path, raw)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, FORMAT) from None
    return topics_of_variables(path, {name: value for name, value in content.items() if not name.startswith("__")})
