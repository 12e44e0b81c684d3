"""MAT files of version 4 to 7.2 by SciPy, and of version 7.3 by h5py. The rules for their variables
are in ``variables.py``.
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
# numbers from the description of the format by MathWorks
INT8_TYPE, UINT8_TYPE, INT32_TYPE, UINT32_TYPE, MATRIX_TYPE, UTF8_TYPE = 1, 2, 5, 6, 14, 16
TYPES = (1, 2, 3, 4, 5, 6, 7, 9, 12, 13, MATRIX_TYPE, COMPRESSED_TYPE, 16, 17, 18)  # of elements
ARRAY_CLASSES = range(1, 19)
CELL_CLASS, STRUCTURE_CLASS = 1, 2
PLAIN_CLASSES = (4, *range(6, 16))  # classes of texts and numbers
READABLE_CLASSES = (CELL_CLASS, STRUCTURE_CLASS, *range(4, 16))
COMPLEX_FLAG = 0x800  # flag of an array with an imaginary part


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the topics of a MAT file of any version."""
    if raw.startswith((b"MATLAB 7.3", b"\x89HDF")):
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
    """Return whether all elements from byte ``begin`` to ``end`` have possible types. SciPy ends
    the whole program at other types.

    Compressed elements are not tested, since they have checksums. ``inside`` is True for the
    elements of an array: flags, sizes, a name, then its content.
    """
    element_types: list[int] = []
    position, array_class, parts = begin, 0, 1
    while position + 8 <= end:
        element_type = int.from_bytes(raw[position : position + 4], order)
        # A small element has its size in the upper half, and up to four bytes within the tag.
        small_size = element_type >> 16
        size = small_size or int.from_bytes(raw[position + 4 : position + 8], order)
        element_type &= 0xFFFF if small_size else 0xFFFFFFFF
        if element_type not in TYPES or small_size > 4:
            return False
        if inside and element_type == COMPRESSED_TYPE:
            return False
        if not element_types:
            flags = int.from_bytes(raw[position + 8 : position + 12], order)
            array_class, parts = flags & 0xFF, 2 if flags & COMPLEX_FLAG else 1
        element_types.append(element_type)
        content_begin = position + 8
        if element_type == MATRIX_TYPE and not _known_types(
            raw, content_begin, min(content_begin + size, end), order, inside=True
        ):
            return False
        if small_size:
            position = content_begin
        elif element_type == COMPRESSED_TYPE:
            position = content_begin + size
        else:  # filled up to a multiple of eight bytes
            position = content_begin + (size + 7) // 8 * 8
    if not inside or not element_types:
        return True
    if position != end or array_class not in ARRAY_CLASSES:
        return False
    content = element_types[5 if array_class == STRUCTURE_CLASS else 3 :]
    if array_class in PLAIN_CLASSES and len(content) != parts:
        return False
    if array_class not in READABLE_CLASSES:
        return True
    flags_and_sizes, name = element_types[:2], element_types[2:3]
    if flags_and_sizes != [UINT32_TYPE, INT32_TYPE]:
        return False
    if not name or name[0] not in (INT8_TYPE, UINT8_TYPE, UTF8_TYPE):
        return False
    has_arrays = array_class in (CELL_CLASS, STRUCTURE_CLASS)
    return all((element_type == MATRIX_TYPE) == has_arrays for element_type in content)
