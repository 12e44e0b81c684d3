"""MAT files of version 4 to 7.2 by SciPy, of version 7.3 by h5py; the rules for their variables are
in ``variables.py``.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Literal

from scenarios.files.formats.cells import Topic, damaged
from scenarios.files.formats.hdf5 import read_matlab
from scenarios.files.formats.variables import topics_of_variables
from scenarios.files.sources import COMPRESSED_TYPE

FORMAT = "MAT"
SUFFIXES = (".mat",)
MAGIC = (b"MATLAB 5.0", b"MATLAB 7.3")
EXTRA = ""
HEADER_BYTES = 128
MATRIX_TYPE = 14  # type of an element
ARRAY_CLASSES = range(1, 19)
PLAIN = (4, *range(6, 16))  # classes of texts and numbers
COMPLEX_FLAG = 0x800  # flag of an imaginary part
CELL_CLASS = 1  # class of a cell array
STRUCTURE_CLASS = 2
KNOWN_CLASSES = (1, 2, *range(4, 16))  # classes whose content can be read
# of elements, by MathWorks' description of the format
TYPES = (1, 2, 3, 4, 5, 6, 7, 9, 12, 13, MATRIX_TYPE, COMPRESSED_TYPE, 16, 17, 18)


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the tables of a MAT file of version 4 to 7.2 by SciPy, of version 7.3 by h5py."""
    if raw.startswith(b"MATLAB 7.3") or raw.startswith(b"\x89HDF"):
        return read_matlab(path, raw)
    from scipy.io import loadmat

    order: Literal["little", "big"] = "little" if raw[126:128] == b"IM" else "big"
    if raw.startswith(b"MATLAB 5.0") and not _known_types(raw, HEADER_BYTES, len(raw), order):
        raise damaged(ValueError("an element of no known type"), path, FORMAT)
    try:
        content = loadmat(io.BytesIO(raw), simplify_cells=True)
    except NotImplementedError:
        return read_matlab(path, raw)
    except Exception as error:  # a damaged file fails in many ways inside the library
        raise damaged(error, path, FORMAT) from None
    return topics_of_variables(
        path, {name: value for name, value in content.items() if not name.startswith("__")}
    )


def _known_types(
    raw: bytes, begin: int, end: int, order: Literal["little", "big"], *, inside: bool = False
) -> bool:
    """Return whether all elements from ``begin`` to ``end`` have types that belong there: SciPy
    ends the whole program at others. Packed elements have checksums and are not looked into.

    ``inside``: they are those of an array: flags, sizes, a name, then its content.
    """
    kinds: list[int] = []
    at, array_class, parts = begin, 0, 1
    while at + 8 <= end:
        kind = int.from_bytes(raw[at : at + 4], order)
        small = kind >> 16  # up to four bytes stand within the tag itself
        size = small or int.from_bytes(raw[at + 4 : at + 8], order)
        kind &= 0xFFFF if small else 0xFFFFFFFF
        if kind not in TYPES or small > 4 or (inside and kind == COMPRESSED_TYPE):
            return False
        if not kinds:
            flags = int.from_bytes(raw[at + 8 : at + 12], order)
            array_class, parts = flags & 0xFF, 2 if flags & COMPLEX_FLAG else 1
        kinds.append(kind)
        if kind == MATRIX_TYPE and not _known_types(
            raw, at + 8, min(at + 8 + size, end), order, inside=True
        ):
            return False
        at += 8 if small else 8 + size if kind == COMPRESSED_TYPE else 8 + (size + 7) // 8 * 8
    if not inside or not kinds:
        return True
    if at != end or array_class not in ARRAY_CLASSES:
        return False
    content = kinds[3 + (2 if array_class == STRUCTURE_CLASS else 0) :]
    if array_class in PLAIN and len(content) != parts:
        return False
    nested = array_class in (CELL_CLASS, STRUCTURE_CLASS)
    usual = kinds[:2] == [6, 5] and kinds[2:3] and kinds[2] in (1, 2, 16)
    return array_class not in KNOWN_CLASSES or (
        bool(usual) and all((kind == MATRIX_TYPE) == nested for kind in content)
    )
