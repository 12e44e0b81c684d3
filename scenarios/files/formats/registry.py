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
from scenarios.files.declarations import is_clock, shortened_list, split_header
from scenarios.files.formats.cells import (
    MISSING,
    CellTable,
    Reader,
    Topic,
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

NOT_READERS = ("cells", "registry", "variables")  # modules of the package without a format
# first bytes of packed files
GZIP = b"\x1f\x8b"
BZIP2 = b"BZh"
XZ = b"\xfd7zXZ\x00"
ZIP = b"PK\x03\x04"
PACKED_SUFFIXES = (".gz", ".bz2", ".xz")
MOST_FILES = 500  # most files in an archive
MOST_FOOTER_ROWS = 20  # most rows of remarks or sums below a table
UNPACKED_AT_ONCE = 1 << 20  # bytes that are unpacked before the size is checked


@lru_cache(maxsize=1)
def readers() -> tuple[Reader, ...]:
    """Return the readers of all modules. That of text is the last one, since it reads every file
    that has no other format.
    """
    names = {module.name for module in pkgutil.iter_modules(formats.__path__)}
    modules = [
        importlib.import_module(f"{formats.__name__}.{name}")
        for name in [*sorted(names - {*NOT_READERS, "text"}), "text"]
    ]
    return tuple(reader for module in modules for reader in module.READERS)


def reader_for(path: Path, raw: bytes) -> Reader:
    """Return the reader of a file by its first bytes, else by its suffix, else that for text.

    Several formats are ZIP archives: for these the suffix decides first.
    """
    *_, text = readers()
    suffix = path.suffix.lower()
    by_suffix = next((reader for reader in readers() if suffix in reader.suffixes), text)
    if raw.startswith(ZIP) and by_suffix is not text:
        return by_suffix
    by_mark = (
        reader for reader in readers() if any(begins_with(raw, mark) for mark in reader.magic)
    )
    return next(by_mark, by_suffix)


def topics_of(source: Source) -> tuple[Topic, ...]:
    """Return the topics of a file of any format. Packed files are unpacked first.

    Raises
    ------
    RecordError : if the file is empty or damaged, if the library for its format is not installed,
        or if it has no row.
    """
    path, raw = source.path, source.content
    if not raw:
        raise RecordError(
            "the file is empty", where=str(path), remedy="give a header row and one row a sample"
        )
    inner_path, has_packed_suffix = path, path.suffix.lower() in PACKED_SUFFIXES
    if raw.startswith((GZIP, BZIP2, XZ)) or has_packed_suffix:
        raw = _unpacked(path, raw)
        if has_packed_suffix:
            inner_path = path.with_suffix("")
    refuse_oversized(inner_path, raw)
    is_archive = raw.startswith(ZIP) and inner_path.suffix.lower() == ".zip"
    files = _files_in(path, raw) if is_archive else ((inner_path, raw),)
    with _silent():
        topics_by_file = [
            (file, reader_for(file, content).read(path, content)) for file, content in files
        ]
    topics = topics_by_file[0][1] if len(topics_by_file) == 1 else _one_log(path, topics_by_file)
    trimmed = [
        _without_footer(replace(topic, table=without_empty_tail(topic.table))) for topic in topics
    ]
    with_rows = tuple(topic for topic in trimmed if topic.table.rows.size)
    if not with_rows:
        raise RecordError(
            "there is a header but no rows", where=str(path), remedy="give one row a sample"
        )
    return with_rows


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Suppress output, logs and warnings of libraries. Readers state problems in errors and
    notes.
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
    """Return the table without the empty rows at its end that exported spreadsheets have."""
    count = table.rows.size
    while count and all(
        len(column) < count or _is_empty(column[count - 1]) for column in table.columns
    ):
        count -= 1
    if count in (0, table.rows.size):
        return table  # a table with empty rows only is refused when its channels are read
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
    """Return the topic without the remarks and sums below its numbers, with a note on them.

    Their first cell is a text, while that of the rows above is a number.
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
    plural = "s are" if count - kept > 1 else " is"
    note = (
        f"{count - kept} row{plural} left out below the table, from row {table.rows[kept]} on "
        f"({str(first[kept])[:30]!r})"
    )
    return replace(
        topic,
        table=replace(table, columns=columns, rows=table.rows[:kept], ragged=ragged),
        notes=(*topic.notes, note),
    )


def _is_remark(cell: object) -> bool:
    """Return whether a cell has letters, and is neither a number nor the mark of a missing
    sample.
    """
    text = "" if cell is None else str(cell).strip()
    return (
        text.lower() not in MISSING
        and any(letter.isalpha() for letter in text)
        and not is_number(text)
    )


def _files_in(path: Path, raw: bytes) -> tuple[tuple[Path, bytes], ...]:
    """Return the names and contents of the files in a ZIP archive.

    Raises
    ------
    RecordError : if the archive is empty, too large or damaged.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            items = [
                item
                for item in archive.infolist()
                if not item.is_dir() and not item.filename.startswith("__MACOSX/")
            ]
            size = sum(item.file_size for item in items)
            if 0 < len(items) <= MOST_FILES and size <= MOST_RECORD:
                files = tuple((Path(item.filename), archive.read(item)) for item in items)
                for name, content in files:
                    refuse_oversized(name, content)
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
        f"the archive holds {len(items)} files of {size / 2**20:.0f} MiB",
        where=str(path),
        remedy="unpack it, and give one of its files",
    )


def _one_log(
    path: Path, topics_by_file: Sequence[tuple[Path, tuple[Topic, ...]]]
) -> tuple[Topic, ...]:
    """Return the files of an archive, each with one channel or instrument, as topics of one log.

    Raises
    ------
    RecordError : if a file is no table, or if two files have the same columns: they are then
        separate records.
    """
    files = [file for file, _ in topics_by_file]
    what = f"the archive holds {len(files)} files ({shortened_list([*map(str, files)], 6)})"
    remedy = "unpack it, and give one of its files"
    for file, topics in topics_by_file:
        if len(topics) != 1:
            raise RecordError(f"{what}; {file} is no table", where=str(path), remedy=remedy)
    headers = [topics[0].table.header for _, topics in topics_by_file]
    if len(set(headers)) < len(headers):
        why = "some have the same columns: they are records of their own"
        raise RecordError(f"{what}; {why}", where=str(path), remedy=remedy)
    names = [file.stem for file in files]
    if len(set(names)) < len(names):
        raise RecordError(f"{what}; two have one name", where=str(path), remedy=remedy)
    return tuple(
        replace(topics[0], name=name)
        for name, (_, topics) in zip(names, topics_by_file, strict=True)
    )


def _unpacked(path: Path, raw: bytes) -> bytes:
    """Return the content of a gzip, bzip2 or xz file.

    Raises
    ------
    RecordError : if the file is damaged, or if its content is too large. The size is checked while
        the file is unpacked, since a small file may have a content of any size.
    """
    open_file: Callable[..., Any]
    if raw.startswith(BZIP2) or path.suffix.lower() == ".bz2":
        name, open_file = "a bzip2", bz2.open
    elif raw.startswith(XZ) or path.suffix.lower() == ".xz":
        name, open_file = "an xz", lzma.open
    else:
        name, open_file = "a gzip", gzip.open
    pieces, size = [], 0
    try:
        with open_file(io.BytesIO(raw)) as file:
            while piece := file.read(UNPACKED_AT_ONCE):
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


# ---- A folder with one CSV file for each channel, read as one log

# headers that are no names: the name of the file is that of the channel
NAMELESS = ("", "value", "values", "data", "y", "reading", "signal", "column 2")
MOST_CHANNELS = 1000  # most files of a folder


def opened_folder(folder: Path) -> tuple[Source, tuple[Topic, ...]] | None:
    """Return the files of a folder as topics of one log, each with its own clock.

    Parameters
    ----------
    folder : folder with one CSV file for each channel, which has a column of time and one of
        values. The name of a channel is its header, or that of its file if the header is no name.

    Returns
    -------
    The source of the record, whose content is that of all files, and the topics. None if the path
    is no folder, or has no CSV file.

    Raises
    ------
    RecordError : if a file is not a time and one channel, or if two files have the same channel.
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
        duplicate = next(name for name in names if names.count(name) > 1)
        raise RecordError(
            f"two files of this folder hold {duplicate!r}: they are records of their own",
            where=str(folder),
            remedy="name one of them",
        )
    content = b"".join(source.content for source in sources)
    identity = InputFile(folder.name, hashlib.sha256(content).hexdigest())
    return Source(folder, content, identity), topics


def _channel(folder: Path, source: Source) -> Topic:
    """Return the topic of a file with one channel, the time first.

    Raises
    ------
    RecordError : if the file is not a table of time and one channel.
    """
    topics = topics_of(source)
    header, columns = topics[0].table.header, topics[0].table.columns
    clocks = [i for i, cell in enumerate(header) if is_clock(split_header(cell)[0])]
    if len(topics) != 1 or len(header) != 2 or len(clocks) != 1:
        raise RecordError(
            f"this is a folder, and {source.path.name} is not a table of time and one channel",
            where=str(folder),
            remedy="name one of its files, or join them to one table with a column time",
        )
    clock, channel = clocks[0], 1 - clocks[0]
    table, stem = topics[0].table, source.path.stem
    name, unit = split_header(header[channel])
    units = (table.units[clock], table.units[channel]) if table.units else ("", "")
    table = replace(
        table,
        header=(header[clock], stem if name.strip().lower() in NAMELESS else name),
        columns=(columns[clock], columns[channel]),
        units=(units[0], unit or units[1]),
    )
    return replace(topics[0], name=stem, table=table)
