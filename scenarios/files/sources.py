"""Files opened once: bytes and hashes, escaped text, JSON and TOML as plain values, versions.

The size of a compressed file is checked before it is unpacked whole, since it may be huge.
"""

from __future__ import annotations

import contextlib
import difflib
import hashlib
import io
import json
import math
import os
import platform
import select
import stat
import struct
import sys
import time
import tomllib
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal, cast

from sim.errors import DeclarationError, FlightidError, RecordError

# ---- Control characters that came with headers

# In addition to control characters: line separators and marks of writing direction.
_HIDDEN = (
    *range(0x20),
    *range(0x7F, 0xA0),
    0x2028,
    0x2029,
    *range(0x202A, 0x202F),
    *range(0x2066, 0x206A),
)
_SHOWN = {number: f"\\u{number:04x}" for number in _HIDDEN if chr(number) not in "\n\t"}


def escaped(text: str) -> str:
    """Return the text with every control character but line ends and tabs as ``\\u001b``, which
    JSON reads back as it was.
    """
    return text if text.isascii() and text.isprintable() else text.translate(_SHOWN)


class EscapedStream:
    """A text stream that escapes its text; everything else is passed on to ``inner``."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner

    def write(self, text: str) -> int:
        """Write the escaped text; return the number of characters of the original text."""
        self.inner.write(escaped(text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write each line escaped."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)


@contextmanager
def escaped_streams() -> Iterator[None]:
    """Context manager that escapes text printed on stdout and stderr."""
    out, err = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (
        None if each is None else cast(Any, EscapedStream(each)) for each in (out, err)
    )
    try:
        yield
    finally:
        sys.stdout, sys.stderr = out, err


def styled_stream(stream: Any) -> Any:
    """Return the stream without escaping, for callers that escape texts themselves."""
    return stream.inner if isinstance(stream, EscapedStream) else stream


# ---- Files opened once

# bytes of a record file, also unpacked; several copies fit into memory
LARGEST_NUMBER = 1e50  # squares of larger numbers overflow
MOST_RECORD = 1 << 30
# bytes of a TOML or Python file: the parser takes a second for each million
MOST_DECLARED = 1 << 22
MOST_DOCUMENT = 1 << 27  # bytes of a JSON document of flightid, with figures
PIPE_TIMEOUT = 5.0  # s, longest wait for the first data from a pipe
_PIECE_BYTES = 1 << 20


@dataclass(frozen=True)
class InputFile:
    """A file that a result rests on: its bare name and the SHA-256 of the bytes that were read."""

    name: str
    sha256: str


@dataclass(frozen=True, eq=False)
class Source:
    """Content and hash of a file at the time it was read."""

    path: Path
    content: bytes
    identity: InputFile


def read_source(
    path: str | Path, error: type[FlightidError], wanted: str, most: int = MOST_DECLARED
) -> Source:
    """Open a file, once.

    Parameters
    ----------
    path : the file; a pipe serves as long as something writes into it.
    error : the kind of error to raise.
    wanted : what to name instead where ``path`` is no file, ``"a TOML file"``.
    most : bytes that are read at most.

    Raises
    ------
    FlightidError : of the kind ``error``: there is no such file, it is a folder, a device or a pipe
        that nothing writes into, it is larger than ``most`` bytes, or it cannot be read.
    """
    path = Path(path)
    content = read_content(path, error, wanted, most)
    return Source(path, content, InputFile(path.name, hashlib.sha256(content).hexdigest()))


def _similar(path: Path) -> str:
    """What to do about a file that is not there: a name of that folder which is meant, perhaps."""
    try:
        names = [each.name for each in path.parent.iterdir() if each.suffix == path.suffix]
    except OSError:
        return "check the path"
    near = difflib.get_close_matches(path.name, names, n=1, cutoff=0.75)
    return f"did you mean {str(path.with_name(near[0]))!r}?" if near else "check the path"


def read_content(path: Path, error: type[FlightidError], wanted: str, most: int) -> bytes:
    """Return the bytes of a file. Parameters and errors as ``read_source``."""
    where = str(path)
    try:
        return _content(path, error, wanted, most)
    except (FileNotFoundError, NotADirectoryError):
        raise error("there is no such file", where=where, remedy=_similar(path)) from None
    except IsADirectoryError:
        raise error("this is a folder", where=where, remedy=f"name {wanted} in it") from None
    except OSError as fault:
        raise error(
            f"cannot be read ({fault.strerror or fault})",
            where=where,
            remedy="check the file and its permissions",
        ) from None


def resolved(path: str | Path) -> Path:
    """Return a path without links in it; a circle of links stays, for whoever opens it to name."""
    return Path(os.path.realpath(path))


def too_large(
    error: type[FlightidError], where: str, size: str, most: int, remedy: str = ""
) -> FlightidError:
    """Error for a file beyond a limit; ``size``: its size in words, before "is more than"."""
    limit = f"{most >> 20} MiB" if most >= 1 << 20 else f"{most} bytes"
    return error(
        f"{size} is more than the {limit} that are read at most",
        where=where,
        remedy=remedy or "name a smaller file",
    )


def _content(path: Path, error: type[FlightidError], wanted: str, most: int) -> bytes:
    # Non-blocking, so that a pipe without a writer does not hang.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    try:
        status = os.fstat(handle)
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError
        is_pipe = stat.S_ISFIFO(status.st_mode)
        if not (stat.S_ISREG(status.st_mode) or is_pipe):
            raise error("this is a device, not a file", where=str(path), remedy=f"name {wanted}")
        if status.st_size > most:
            raise too_large(error, str(path), f"{status.st_size / (1 << 20):.4g} MiB", most)
        piece = _first_piece(handle) if is_pipe else _piece(handle)
        if is_pipe and not piece:
            raise error("nothing writes into this pipe", where=str(path), remedy=f"name {wanted}")
        pieces, size = [], 0
        while piece:
            pieces.append(piece)
            size += len(piece)
            if size > most:
                raise too_large(error, str(path), "what comes out of it", most)
            piece = _piece(handle)
    finally:
        os.close(handle)
    return b"".join(pieces)


def _piece(handle: int) -> bytes:
    """The next bytes, none at the end; of a pipe that is written into they are waited for."""
    while True:
        try:
            return os.read(handle, _PIECE_BYTES)
        except BlockingIOError:
            select.select([handle], [], [])


def _first_piece(handle: int) -> bytes:
    """Return the first bytes of a pipe; none if no program has come to write into it before
    ``PIPE_TIMEOUT`` is over.
    """
    until = time.monotonic() + PIPE_TIMEOUT
    while not (piece := _piece(handle)) and time.monotonic() < until:
        time.sleep(0.02)
    return piece


# ---- JSON and TOML texts as plain values, with limits on size and depth

DEEPEST_NESTING = 64  # tables and lists inside each other
MOST_DIGITS = 300  # longest whole number, so that it fits into a float
_documents_SHOWN = 40  # characters of what is wrong


class DocumentError(ValueError):
    """A text that is no valid JSON or TOML: the reason in a few words, and ``key`` if known."""

    def __init__(self, what: str, key: str = "") -> None:
        super().__init__(what)
        self.key = key


def json_value(content: bytes | str) -> Any:
    """Return the value of a strict JSON text.

    Raises
    ------
    DocumentError : it is not UTF-8, no JSON, nested deeper than ``DEEPEST_NESTING``, or holds a
        number that is not finite or has too many digits.
    """
    try:
        value = json.loads(content, parse_int=_whole, parse_constant=_constant)
    except DocumentError:
        raise
    except RecursionError:
        raise DocumentError(f"nested deeper than {DEEPEST_NESTING} levels") from None
    except UnicodeDecodeError:
        raise DocumentError("not UTF-8 text") from None
    except ValueError as error:
        raise DocumentError(f"not JSON: {' '.join(str(error).split())}") from None
    _refuse_extremes(value, finite=True)
    return value


def toml_value(text: str) -> dict[str, Any]:
    """Tables of a TOML text, which may have infinite numbers.

    Raises
    ------
    DocumentError : it is no TOML, nested deeper than ``DEEPEST_NESTING``, or holds a whole number
        of too many digits.
    """
    try:
        value = tomllib.loads(text)
    except RecursionError:
        raise DocumentError(f"nested deeper than {DEEPEST_NESTING} levels") from None
    except tomllib.TOMLDecodeError as error:
        raise DocumentError(f"not valid TOML: {' '.join(str(error).split())}") from None
    except ValueError:  # Python's own limit of digits, and dates that no calendar has
        raise DocumentError(
            f"not valid TOML: a number of more than {MOST_DIGITS} digits, or no date"
        ) from None
    _refuse_extremes(value, finite=False)
    return value


def read_json(
    path: Path, error: type[FlightidError] = DeclarationError, wanted: str = "the folder of a study"
) -> Any:
    """Return the value of a JSON file.

    Raises
    ------
    FlightidError : of the kind ``error``: it cannot be read, or as ``json_value``; the line names
        the file and what to name instead, ``wanted``.
    """
    content = read_content(path, error, wanted, MOST_DOCUMENT)
    try:
        return json_value(content)
    except DocumentError as fault:
        raise error(
            str(fault),
            where=f"{path}, key {fault.key}" if fault.key else str(path),
            remedy=f"name {wanted}",
        ) from None


def json_or_none(path: Path) -> Any:
    """Return the value of a JSON file; None if it is missing or not strict JSON."""
    try:
        return read_json(path)
    except DeclarationError:
        return None


def _whole(text: str) -> int:
    if len(text) > MOST_DIGITS:
        raise DocumentError(f"a number of {len(text)} digits")
    return int(text)


def _constant(word: str) -> float:
    raise DocumentError(f"{word} is not a finite number")


def _refuse_extremes(value: Any, *, finite: bool) -> None:
    """Go through all values, level by level so that no depth can overrun this."""
    level, depth = [("", value)], 0
    while level:
        if depth > DEEPEST_NESTING:
            raise DocumentError(
                f"nested deeper than {DEEPEST_NESTING} levels", level[0][0][:_documents_SHOWN]
            )
        inner: list[tuple[str, Any]] = []
        for key, each in level:
            if isinstance(each, dict):
                inner += [
                    (f"{key}.{name}" if key else str(name), item) for name, item in each.items()
                ]
            elif isinstance(each, list):
                inner += [(key, item) for item in each]
            elif isinstance(each, int) and abs(each) >= 10**MOST_DIGITS:
                raise DocumentError(
                    f"{str(each)[:_documents_SHOWN]}... is not a number to compute with: it has "
                    f"more than {MOST_DIGITS} digits",
                    key,
                )
            elif finite and isinstance(each, float) and not math.isfinite(each):
                raise DocumentError("a number beyond the range of floats", key)
        level, depth = inner, depth + 1


# ---- Versions of Python and packages

PACKAGES = ("flightid", "numpy", "scipy", "filterpy", "control")


def versions() -> dict[str, str]:
    """Return the versions of Python and of installed packages, for the files of a study."""
    versions_by_package = {"python": platform.python_version()}
    for package in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            versions_by_package[package] = version(package)
    return versions_by_package


def own_version() -> str:
    """The version of this package; ``"0+unknown"`` of a checkout that was never installed."""
    try:
        return version("flightid")
    except PackageNotFoundError:
        return "0+unknown"


MOST_NUMBERS = MOST_RECORD // 8
_PIECE_OF_PACKED = 1 << 20
COMPRESSED_TYPE = 15  # type of an element of a MAT file that is packed
_MAT_HEADER = 128
HDF5 = b"\x89HDF"  # first bytes of the file
ZIP = b"PK\x03\x04"  # first bytes of the file


def refuse_oversized(path: Path, content: bytes) -> None:
    """Raise RecordError if a packed file unpacks to more than is read; a damaged file is for its
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
    """Return the rows times columns, as the file's own index has them."""
    try:
        import pyarrow.parquet

        result = pyarrow.parquet.ParquetFile(io.BytesIO(content)).metadata
        return int(result.num_rows) * int(result.num_columns)
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
        total += _unpacked(body, MOST_RECORD - total) if kind == COMPRESSED_TYPE else len(body)
        at += 8 + size
    return total


def _unpacked(body: bytes, most: int) -> int:
    stream, size = zlib.decompressobj(), 0
    try:
        while body and size <= most and not stream.eof:
            size += len(stream.decompress(body, _PIECE_OF_PACKED))
            body = stream.unconsumed_tail
    except zlib.error:
        return 0
    return size
