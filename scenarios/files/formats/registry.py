"""Readers by file format. A new module in this package is found automatically."""

from __future__ import annotations

import bz2
import contextlib
import gzip
import hashlib
import importlib
import io
import logging
import lzma
import pkgutil
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files import formats
from scenarios.files.declarations import is_clock, split_header
from scenarios.files.formats.cells import (
    MISSING,
    CellTable,
    Reader,
    Topic,
    as_module,
    begins_with,
    first_line,
    is_number,
)
from scenarios.files.sources import (
    MOST_RECORD,
    InputFile,
    Source,
    read_source,
    refuse_oversized,
    too_large,
)
from sim.errors import RecordError

NOT_READERS = ("cells", "layout", "registry", "sizes", "topic", "variables")
GZIP = b"\x1f\x8b"  # first bytes of the file
BZIP2 = b"BZh"  # first bytes of the file
XZ = b"\xfd7zXZ\x00"  # first bytes of the file
ZIP = b"PK\x03\x04"  # first bytes of the file
PACKED = {".gz": "gzip", ".bz2": "bzip2", ".xz": "xz"}
MOST_FILES = 500  # in an archive
MOST_FOOTER_ROWS = 20  # rows below a table that may be remarks or sums


@lru_cache(maxsize=1)
def readers() -> dict[str, Reader]:
    """Module name -> reader, in alphabetical order, ``text`` last: it takes whatever no other
    format claims.
    """
    names = sorted(
        module.name
        for module in pkgutil.iter_modules(formats.__path__)
        if module.name not in NOT_READERS
    )
    ordered = [*(name for name in names if name != "text"), "text"]
    return {
        name: as_module(importlib.import_module(f"{formats.__name__}.{name}")) for name in ordered
    }


def reader_for(path: Path, raw: bytes) -> Reader:
    """Return the reader of a file by its first bytes, else by its suffix, else for text.

    For ZIP archives, which several formats use, the suffix decides first.
    """
    if raw.startswith(ZIP):
        named = next(
            (reader for reader in readers().values() if path.suffix.lower() in reader.SUFFIXES),
            None,
        )
        if named is not None and named is not readers()["text"]:
            return named
    for reader in readers().values():
        if any(begins_with(raw, mark) for mark in reader.MAGIC):
            return reader
    suffix = path.suffix.lower()
    return next(
        (reader for reader in readers().values() if suffix in reader.SUFFIXES), readers()["text"]
    )


def topics_of(source: Source) -> tuple[Topic, ...]:
    """Return the topics in a file of any format; a gzip file is unpacked first.

    Raises
    ------
    RecordError : the file is empty or damaged, its library is not installed, or it holds no row.
    """
    path, raw = source.path, source.content
    if not raw:
        raise RecordError(
            "the file is empty", where=str(path), remedy="give a header row and one row a sample"
        )
    inner = path
    if raw.startswith((GZIP, BZIP2, XZ)) or path.suffix.lower() in PACKED:
        raw, inner = (
            _unpacked(path, raw),
            path.with_suffix("") if path.suffix.lower() in PACKED else path,
        )
    refuse_oversized(inner, raw)
    packed = raw.startswith(ZIP) and inner.suffix.lower() == ".zip"
    files = _files_in(path, raw) if packed else ((inner, raw),)
    with _silent():
        parts = [(each, reader_for(each, content).read(path, content)) for each, content in files]
    topics = parts[0][1] if len(parts) == 1 else _one_log(path, parts)
    filled = tuple(
        _without_footer(replace(topic, table=without_empty_tail(topic.table))) for topic in topics
    )
    filled = tuple(topic for topic in filled if topic.table.rows.size)
    if not filled:
        raise RecordError(
            "there is a header but no rows", where=str(path), remedy="give one row a sample"
        )
    return filled


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Context manager that suppresses output, logs and warnings of libraries; problems are returned
    as errors or notes.
    """
    level = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with (
            warnings.catch_warnings(),
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(io.StringIO()),
        ):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(level)


def without_empty_tail(table: CellTable) -> CellTable:
    """Return the table without empty rows at its end, as in exported spreadsheets."""
    count = table.rows.size
    while count and all(
        len(column) < count or _is_empty(column[count - 1]) for column in table.columns
    ):
        count -= 1
    if count in (0, table.rows.size):
        return table  # a table without any number is for the reader of its channels to refuse
    columns = tuple(column[:count] for column in table.columns)
    return replace(
        table,
        columns=columns,
        rows=table.rows[:count],
        ragged={row: n for row, n in table.ragged.items() if row < count},
    )


def _is_empty(cell: object) -> bool:
    return cell is None or cell != cell or (isinstance(cell, str) and not cell.strip())


def _without_footer(topic: Topic) -> Topic:
    """Return the topic without remarks and sums below its numbers, and a note on them.

    These are last rows with a text in the first cell instead of a number.
    """
    table = topic.table
    first, count = table.columns[0] if table.columns else np.zeros(0), table.rows.size
    if (isinstance(first, np.ndarray) and first.dtype != object) or len(first) != count:
        return topic
    kept = count
    while kept and count - kept < MOST_FOOTER_ROWS and _is_remark(first[kept - 1]):
        kept -= 1
    if kept in (0, count) or not is_number(str(first[kept - 1])):
        return topic
    columns = tuple(column[:kept] for column in table.columns)
    ragged = {row: n for row, n in table.ragged.items() if row < kept}
    rest = "s are" if count - kept > 1 else " is"
    note = (
        f"{count - kept} row{rest} left out below the table, from row {table.rows[kept]} on "
        f"({str(first[kept])[:30]!r})"
    )
    return replace(
        topic,
        table=replace(table, columns=columns, rows=table.rows[:kept], ragged=ragged),
        notes=(*topic.notes, note),
    )


def _is_remark(cell: object) -> bool:
    """Return whether a cell holds a word: letters, and neither a number nor the mark of a missing
    sample.
    """
    text = "" if cell is None else str(cell).strip()
    return (
        text.lower() not in MISSING
        and any(letter.isalpha() for letter in text)
        and not is_number(text)
    )


def _files_in(path: Path, raw: bytes) -> tuple[tuple[Path, bytes], ...]:
    """Return names and contents of the files in a ZIP archive.

    Raises RecordError if it is empty, too large or damaged.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            inside = [
                item
                for item in archive.infolist()
                if not item.is_dir() and not item.filename.startswith("__MACOSX/")
            ]
            size = sum(item.file_size for item in inside)
            if 0 < len(inside) <= MOST_FILES and size <= MOST_RECORD:
                files = tuple((Path(item.filename), archive.read(item)) for item in inside)
                for inner, content in files:
                    refuse_oversized(inner, content)
                return files
    except (
        zipfile.BadZipFile,
        OSError,
        EOFError,
        RuntimeError,
        NotImplementedError,
        ValueError,
        zlib.error,
    ) as error:
        raise RecordError(
            f"not a ZIP archive ({first_line(error)})",
            where=str(path),
            remedy="pack it again, or give the plain file",
        ) from None
    raise RecordError(
        f"the archive holds {len(inside)} files of {size / 2**20:.0f} MiB",
        where=str(path),
        remedy="unpack it, and give one of its files",
    )


def _one_log(path: Path, parts: Sequence[tuple[Path, tuple[Topic, ...]]]) -> tuple[Topic, ...]:
    """Return the files of an archive (channels or instruments) as topics of one log.

    Raises RecordError if a file is no table, or two have the same columns, as separate records do.
    """
    shown = ", ".join(str(each) for each, _ in parts[:6]) + (", ..." if len(parts) > 6 else "")
    what = f"the archive holds {len(parts)} files ({shown})"
    remedy = "unpack it, and give one of its files"
    for each, topics in parts:
        if len(topics) != 1:
            raise RecordError(f"{what}; {each} is no table", where=str(path), remedy=remedy)
    headers = [topics[0].table.header for _, topics in parts]
    if len(set(headers)) < len(headers):
        why = "some have the same columns: they are records of their own"
        raise RecordError(f"{what}; {why}", where=str(path), remedy=remedy)
    names = [each.stem for each, _ in parts]
    if len(set(names)) < len(names):
        raise RecordError(f"{what}; two have one name", where=str(path), remedy=remedy)
    return tuple(
        replace(topics[0], name=name) for name, (_, topics) in zip(names, parts, strict=True)
    )


def _unpacked(path: Path, raw: bytes) -> bytes:
    """Return the content of a gzip, bzip2 or xz file, read up to the limit, since a few bytes may
    expand to any size.
    """
    if raw.startswith(BZIP2) or path.suffix.lower() == ".bz2":
        name = "a bzip2"
        opened: Callable[[io.BytesIO], Any] = bz2.BZ2File
    elif raw.startswith(XZ) or path.suffix.lower() == ".xz":
        name, opened = "an xz", lzma.LZMAFile
    else:
        name, opened = "a gzip", _gzip
    pieces, size = [], 0
    try:
        with opened(io.BytesIO(raw)) as file:
            while piece := file.read(1 << 20):
                pieces.append(piece)
                size += len(piece)
                if size > MOST_RECORD:
                    raise too_large(
                        RecordError,
                        str(path),
                        "what it unpacks to",
                        MOST_RECORD,
                        "give a part of it, or save it as Parquet",
                    )
    except (OSError, EOFError, zlib.error, lzma.LZMAError) as error:
        raise RecordError(
            f"not {name} file ({first_line(error)})",
            where=str(path),
            remedy="compress it again, or give the plain file",
        ) from None
    return b"".join(pieces)


def _gzip(content: io.BytesIO) -> gzip.GzipFile:
    return gzip.GzipFile(fileobj=content)


# ---- A folder with one CSV file a channel, read as one log

# Headers that say nothing: the channel has the name of its file.
NAMELESS = ("", "value", "values", "data", "y", "reading", "signal", "column 2")
MOST_CHANNELS = 1000  # files of a folder


def opened_folder(folder: Path) -> tuple[Source, tuple[Topic, ...]] | None:
    """The files of a folder as topics of one log, each with its own clock.

    Parameters
    ----------
    folder : holds one CSV file for each channel: a column of time and one of values. A channel is
        named by its header, or by its file where the header says ``value``.

    Returns
    -------
    What stands for the file of the record (its content is that of all files, one after the other),
    and the topics; None if it is no folder, or holds no CSV file.

    Raises
    ------
    RecordError : a file holds anything but a time and one channel, or two hold the same channel.
    """
    paths = sorted(folder.glob("*.csv")) if folder.is_dir() else []
    if not paths:
        return None
    if len(paths) > MOST_CHANNELS:
        raise RecordError(
            f"this is a folder of {len(paths)} CSV files",
            where=str(folder),
            remedy="name one of them",
        )
    sources = [read_source(path, RecordError, "the record file", MOST_RECORD) for path in paths]
    topics = tuple(_channel(folder, source) for source in sources)
    names = [header for topic in topics for header in topic.table.header[1:]]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise RecordError(
            f"two files of this folder hold {twice!r}: they are records of their own",
            where=str(folder),
            remedy="name one of them",
        )
    content = b"".join(source.content for source in sources)
    identity = InputFile(folder.name, hashlib.sha256(content).hexdigest())
    return Source(folder, content, identity), topics


def _channel(folder: Path, source: Source) -> Topic:
    """Return a file as a topic, the time first. Raises RecordError if it is no single channel."""
    topics = topics_of(source)
    header, columns = topics[0].table.header, topics[0].table.columns
    clocks = [at for at, cell in enumerate(header) if is_clock(split_header(cell)[0])]
    if len(topics) != 1 or len(header) != 2 or len(clocks) != 1:
        raise RecordError(
            f"this is a folder, and {source.path.name} is not a table of time and one channel",
            where=str(folder),
            remedy="name one of its files, or join them to one table with a column time",
        )
    order, table, stem = (clocks[0], 1 - clocks[0]), topics[0].table, source.path.stem
    name, unit = split_header(header[order[1]])
    units = tuple(table.units[at] for at in order) if table.units else ("", "")
    channel = stem if name.strip().lower() in NAMELESS else name
    table = replace(
        table,
        header=(header[order[0]], channel),
        columns=tuple(columns[at] for at in order),
        units=(units[0], unit or units[1]),
    )
    return replace(topics[0], name=stem, table=table)
