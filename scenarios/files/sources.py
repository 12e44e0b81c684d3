"""Reading of files: bytes and hashes, escaped texts, JSON and TOML as plain values, versions.

Each file is read only once. The unpacked size of a compressed file is checked before the file is
unpacked.
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

# ---- Control characters in texts from files

# codes of control characters, line separators and marks of writing direction
_HIDDEN_CODES = (
    *range(0x20),
    *range(0x7F, 0xA0),
    0x2028,
    0x2029,
    *range(0x202A, 0x202F),
    *range(0x2066, 0x206A),
)
_ESCAPES = {number: f"\\u{number:04x}" for number in _HIDDEN_CODES if chr(number) not in "\n\t"}


def escaped(text: str) -> str:
    """Return the text with control characters written as ``\\u001b`` and so on, except line ends
    and tabs. JSON reads the original text from the escaped one.
    """
    if text.isascii() and text.isprintable():
        return text
    return text.translate(_ESCAPES)


class EscapedStream:
    """A text stream that writes escaped texts to the stream ``inner``."""

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
    """Escape the texts that the body prints on stdout and stderr."""
    out, err = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (
        None if stream is None else cast(Any, EscapedStream(stream)) for stream in (out, err)
    )
    try:
        yield
    finally:
        sys.stdout, sys.stderr = out, err


def styled_stream(stream: Any) -> Any:
    """Return the stream without escaping, for functions that escape their texts."""
    return stream.inner if isinstance(stream, EscapedStream) else stream


# ---- Files read once

LARGEST_NUMBER = 1e50  # powers and products of larger numbers could overflow
MOST_RECORD = 1 << 30  # most bytes of a record file, unpacked: several copies fit into memory
MOST_DECLARED = 1 << 22  # most bytes of a TOML or Python file: parsing a million takes a second
MOST_DOCUMENT = 1 << 27  # most bytes of a JSON file of flightid, with figures
PIPE_TIMEOUT = 5.0  # s, longest wait for the first data from a pipe
_PIECE_BYTES = 1 << 20  # bytes that are read at a time


@dataclass(frozen=True)
class InputFile:
    """An input file of a result: its name without folders and the SHA-256 of its bytes."""

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
    """Return the content and hash of a file.

    Parameters
    ----------
    path : the file, or a pipe into which a program writes.
    error : type of the errors.
    wanted : what the user should give if ``path`` is no file, such as ``"a TOML file"``.
    most : largest number of bytes that is read.

    Raises
    ------
    FlightidError : an error of the type ``error``, if the file is missing, a folder, a device, or a
        pipe into which no program writes; if it has more than ``most`` bytes; or if it cannot be
        read.
    """
    path = Path(path)
    content = read_content(path, error, wanted, most)
    return Source(path, content, InputFile(path.name, hashlib.sha256(content).hexdigest()))


def _similar_name(path: Path) -> str:
    """Return the remedy for a missing file, with a similar name in its folder if there is one."""
    try:
        names = [file.name for file in path.parent.iterdir() if file.suffix == path.suffix]
    except OSError:
        return "check the path"
    near = difflib.get_close_matches(path.name, names, n=1, cutoff=0.75)
    return f"did you mean {str(path.with_name(near[0]))!r}?" if near else "check the path"


def read_content(path: Path, error: type[FlightidError], wanted: str, most: int) -> bytes:
    """Return the bytes of a file, with parameters and errors as in ``read_source``."""
    where = str(path)
    try:
        return _content(path, error, wanted, most)
    except (FileNotFoundError, NotADirectoryError):
        raise error("there is no such file", where=where, remedy=_similar_name(path)) from None
    except IsADirectoryError:
        raise error("this is a folder", where=where, remedy=f"name {wanted} in it") from None
    except OSError as fault:
        raise error(
            f"cannot be read ({fault.strerror or fault})",
            where=where,
            remedy="check the file and its permissions",
        ) from None


def resolved(path: str | Path) -> Path:
    """Return a path without links in it. A circle of links remains, and cannot be opened."""
    return Path(os.path.realpath(path))


def too_large(
    error: type[FlightidError], where: str, size: str, most: int, remedy: str = ""
) -> FlightidError:
    """Return the error for a file of more than ``most`` bytes.

    ``size`` is the subject of the sentence, such as ``"2048 MiB"``. An empty ``remedy`` gives the
    usual one.
    """
    limit = f"{most >> 20} MiB" if most >= 1 << 20 else f"{most} bytes"
    return error(
        f"{size} is more than the {limit} that are read at most",
        where=where,
        remedy=remedy or "name a smaller file",
    )


def _content(path: Path, error: type[FlightidError], wanted: str, most: int) -> bytes:
    """Return the bytes of a file or pipe. Errors of the operating system are raised as they are."""
    # Opening must not block: a pipe may have no writer.
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
    """Return the next bytes, none at the end. Wait for the next bytes of a pipe."""
    while True:
        try:
            return os.read(handle, _PIECE_BYTES)
        except BlockingIOError:
            select.select([handle], [], [])


def _first_piece(handle: int) -> bytes:
    """Return the first bytes of a pipe; none if nothing is written within ``PIPE_TIMEOUT``."""
    deadline = time.monotonic() + PIPE_TIMEOUT
    piece = _piece(handle)
    while not piece and time.monotonic() < deadline:
        time.sleep(0.02)
        piece = _piece(handle)
    return piece


# ---- JSON and TOML texts as plain values, with limits on size and depth

DEEPEST_NESTING = 64  # tables and lists inside each other
MOST_DIGITS = 300  # longest whole number, so that it fits into a float
_MOST_SHOWN = 40  # letters of a wrong key or number that a message shows


class DocumentError(ValueError):
    """Error for a text that is no valid JSON or TOML: the reason, and its ``key`` if known."""

    def __init__(self, what: str, key: str = "") -> None:
        super().__init__(what)
        self.key = key


def json_value(content: bytes | str) -> Any:
    """Return the value of a strict JSON text.

    Raises
    ------
    DocumentError : if the text is not UTF-8 or no JSON, is nested deeper than ``DEEPEST_NESTING``,
        or has a number that is not finite or has too many digits.
    """
    try:
        value = json.loads(content, parse_int=_whole_number, parse_constant=_constant)
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
    """Return the tables of a TOML text, which may have infinite numbers.

    Raises
    ------
    DocumentError : if the text is no TOML, is nested deeper than ``DEEPEST_NESTING``, or has a
        whole number with too many digits.
    """
    try:
        value = tomllib.loads(text)
    except RecursionError:
        raise DocumentError(f"nested deeper than {DEEPEST_NESTING} levels") from None
    except tomllib.TOMLDecodeError as error:
        raise DocumentError(f"not valid TOML: {' '.join(str(error).split())}") from None
    except ValueError:  # more digits than Python converts, or an impossible date
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
    FlightidError : an error of the type ``error``, if the file cannot be read, or if ``json_value``
        refuses its content. ``wanted`` is what the user should give instead.
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


def _whole_number(text: str) -> int:
    """Return a whole number of JSON. Raise DocumentError if it has too many digits."""
    if len(text) > MOST_DIGITS:
        raise DocumentError(f"a number of {len(text)} digits")
    return int(text)


def _constant(word: str) -> float:
    """Raise DocumentError for ``NaN`` and ``Infinity``, which Python would accept."""
    raise DocumentError(f"{word} is not a finite number")


def _refuse_extremes(value: Any, *, finite: bool) -> None:
    """Raise DocumentError for deep nesting, too many digits and, if ``finite``, infinite numbers.

    The values are visited level by level, since a recursion could exceed the limit of Python.
    """
    level, depth = [("", value)], 0
    while level:
        if depth > DEEPEST_NESTING:
            raise DocumentError(
                f"nested deeper than {DEEPEST_NESTING} levels", level[0][0][:_MOST_SHOWN]
            )
        next_level: list[tuple[str, Any]] = []
        for key, item in level:
            if isinstance(item, dict):
                next_level += [
                    (f"{key}.{name}" if key else str(name), inner) for name, inner in item.items()
                ]
            elif isinstance(item, list):
                next_level += [(key, inner) for inner in item]
            elif isinstance(item, int) and abs(item) >= 10**MOST_DIGITS:
                raise DocumentError(
                    f"{str(item)[:_MOST_SHOWN]}... is not a number to compute with: it has "
                    f"more than {MOST_DIGITS} digits",
                    key,
                )
            elif finite and isinstance(item, float) and not math.isfinite(item):
                raise DocumentError("a number beyond the range of floats", key)
        level, depth = next_level, depth + 1


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
    """Return the version of this package; ``"0+unknown"`` if it is not installed."""
    try:
        return version("flightid")
    except PackageNotFoundError:
        return "0+unknown"


# ---- Sizes of compressed files

MOST_NUMBERS = MOST_RECORD // 8  # a float has 8 bytes
_PIECE_OF_PACKED = 1 << 20  # bytes that are unpacked at a time
COMPRESSED_TYPE = 15  # type number of a compressed element of a MAT file
_MAT_HEADER = 128  # bytes
HDF5 = b"\x89HDF"  # first bytes of the file
ZIP = b"PK\x03\x04"  # first bytes of the file


def refuse_oversized(path: Path, content: bytes) -> None:
    """Raise RecordError if a compressed file has more than ``MOST_RECORD`` bytes unpacked.

    A damaged file is not refused here: the reader of its format reports the damage.
    """
    if content.startswith(b"PAR1"):
        too_much = _numbers_in_parquet(content) > MOST_NUMBERS
    elif content.startswith(ZIP):
        too_much = _bytes_in_zip(content) > MOST_RECORD
    elif path.suffix.lower() == ".mat" and not content.startswith(HDF5):
        too_much = _bytes_in_mat(content) > MOST_RECORD
    else:
        too_much = False
    if too_much:
        raise too_large(
            RecordError,
            str(path),
            "what it unpacks to",
            MOST_RECORD,
            "give a part of its rows or columns",
        )


def _bytes_in_zip(content: bytes) -> int:
    """Return the unpacked bytes of a ZIP archive by its index; 0 if it is damaged."""
    import zipfile

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as file:
            return sum(item.file_size for item in file.infolist())
    except (zipfile.BadZipFile, OSError, ValueError, struct.error):
        return 0


def _numbers_in_parquet(content: bytes) -> int:
    """Return the number of rows times that of columns by the index of the file; 0 if it is
    damaged.
    """
    try:
        import pyarrow.parquet

        metadata = pyarrow.parquet.ParquetFile(io.BytesIO(content)).metadata
        return int(metadata.num_rows) * int(metadata.num_columns)
    except Exception:  # pyarrow is not installed, or the file is damaged in one of many ways
        return 0


def _bytes_in_mat(content: bytes) -> int:
    """Return the unpacked bytes of all elements of a MAT file of version 5.

    The count stops once it exceeds ``MOST_RECORD``.
    """
    order: Literal["little", "big"] = "little" if content[126:128] == b"IM" else "big"
    position, total = _MAT_HEADER, 0
    while position + 8 <= len(content) and total <= MOST_RECORD:
        # An element has its type and size in 4 bytes each, then its body.
        element_type = int.from_bytes(content[position : position + 4], order)
        size = int.from_bytes(content[position + 4 : position + 8], order)
        body = content[position + 8 : position + 8 + size]
        if element_type == COMPRESSED_TYPE:
            total += _unpacked_size(body, MOST_RECORD - total)
        else:
            total += len(body)
        position += 8 + size
    return total


def _unpacked_size(body: bytes, most: int) -> int:
    """Return the unpacked bytes of a compressed element, counted until they exceed ``most``; 0 if
    it is damaged.
    """
    stream, size = zlib.decompressobj(), 0
    try:
        while body and size <= most and not stream.eof:
            size += len(stream.decompress(body, _PIECE_OF_PACKED))
            body = stream.unconsumed_tail
    except zlib.error:
        return 0
    return size
