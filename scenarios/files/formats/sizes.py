"""How much a packed file unpacks to, found without unpacking it whole: a few bytes may stand for
any number of them.
"""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Literal

from scenarios.files.sources import MOST_RECORD, too_large
from sim.errors import RecordError

MOST_NUMBERS = MOST_RECORD // 8
_PIECE = 1 << 20
_COMPRESSED = 15  # type of an element of a MAT file that is packed
_MAT_HEADER = 128
HDF5, ZIP = b"\x89HDF", b"PK\x03\x04"


def refuse_oversized(path: Path, content: bytes) -> None:
    """Raise RecordError where a packed file unpacks to more than is read; a damaged file is for its
    reader to name.
    """
    suffix = path.suffix.lower()
    parquet = content.startswith(b"PAR1") and _numbers_in_parquet(content) > MOST_NUMBERS
    matlab = (
        suffix == ".mat"
        and not content.startswith(HDF5)
        and _unpacked_by_mat(content) > MOST_RECORD
    )
    if parquet or matlab or (content.startswith(ZIP) and _unpacked_by_zip(content) > MOST_RECORD):
        raise too_large(
            RecordError,
            str(path),
            "what it unpacks to",
            MOST_RECORD,
            "give a part of its rows or columns",
        )


def _unpacked_by_zip(content: bytes) -> int:
    """Bytes of all parts of a spreadsheet, as its own index has them."""
    import zipfile

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            return sum(item.file_size for item in file.infolist())
    except (zipfile.BadZipFile, OSError, ValueError, struct.error):
        return 0


def _numbers_in_parquet(content: bytes) -> int:
    """Rows times columns, as the file's own index has them."""
    try:
        import pyarrow.parquet

        found = pyarrow.parquet.ParquetFile(io.BytesIO(content)).metadata
        return int(found.num_rows) * int(found.num_columns)
    except Exception:  # not installed, or damaged in one of many ways
        return 0


def _unpacked_by_mat(content: bytes) -> int:
    """Bytes of all elements of a MAT file of version 5, counted until there are too many."""
    order: Literal["little", "big"] = "little" if content[126:128] == b"IM" else "big"
    at, total = _MAT_HEADER, 0
    while at + 8 <= len(content) and total <= MOST_RECORD:
        kind, size = (
            int.from_bytes(content[at + shift : at + shift + 4], order) for shift in (0, 4)
        )
        body = content[at + 8 : at + 8 + size]
        total += _unpacked(body, MOST_RECORD - total) if kind == _COMPRESSED else len(body)
        at += 8 + size
    return total


def _unpacked(body: bytes, most: int) -> int:
    stream, size = zlib.decompressobj(), 0
    try:
        while body and size <= most and not stream.eof:
            size += len(stream.decompress(body, _PIECE))
            body = stream.unconsumed_tail
    except zlib.error:
        return 0
    return size
