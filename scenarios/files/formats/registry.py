"""Which reader takes which file. A new format is one new module in this package; this one finds it by itself."""

from __future__ import annotations

import contextlib
import gzip
import importlib
import io
import logging
import pkgutil
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from scenarios.files import formats
from scenarios.files.formats.cells import Table, first_line
from scenarios.files.formats.sizes import refuse_oversized
from scenarios.files.formats.topic import Reader, Topic, as_module, begins_with
from scenarios.files.sources import MOST_RECORD, Source, too_large
from sim.errors import RecordError

NOT_READERS = ("cells", "layout", "registry", "sizes", "topic", "variables")
GZIP = b"\x1f\x8b"


@lru_cache(maxsize=1)
def readers() -> dict[str, Reader]:
    """Module name -> reader, in alphabetical order, ``text`` last: it takes whatever no other format claims."""
    names = sorted(module.name for module in pkgutil.iter_modules(formats.__path__) if module.name not in NOT_READERS)
    ordered = [*(name for name in names if name != "text"), "text"]
    return {name: as_module(importlib.import_module(f"{formats.__name__}.{name}")) for name in ordered}


def reader_for(path: Path, raw: bytes) -> Reader:
    """The reader whose first bytes the file has, else the one of its suffix, else the reader of text."""
    for reader in readers().values():
        if any(begins_with(raw, mark) for mark in reader.MAGIC):
            return reader
    suffix = path.suffix.lower()
    return next((reader for reader in readers().values() if suffix in reader.SUFFIXES), readers()["text"])


def topics_of(source: Source) -> tuple[Topic, ...]:
    """The topics in a file of any format; a gzip file is unpacked first.

    Raises
    ------
    RecordError : the file is empty or damaged, its library is not installed, or it holds no row.
    """
    path, raw = source.path, source.content
    if not raw:
        raise RecordError("the file is empty", where=str(path), remedy="give a header row and one row a sample")
    inner = path
    if raw.startswith(GZIP) or path.suffix.lower() == ".gz":
        raw, inner = _unpacked(path, raw), path.with_suffix("") if path.suffix.lower() == ".gz" else path
    refuse_oversized(inner, raw)
    with _silent():
        topics = reader_for(inner, raw).read(path, raw)
    filled = tuple(replace(topic, table=without_empty_tail(topic.table)) for topic in topics)
    filled = tuple(topic for topic in filled if topic.table.rows.size)
    if not filled:
        raise RecordError("there is a header but no rows", where=str(path), remedy="give one row a sample")
    return filled


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Libraries print, log and warn of what they find damaged; what matters of it comes back as an error or a note."""
    level = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(level)


def without_empty_tail(table: Table) -> Table:
    """The table without the rows at its end in which no cell holds anything, as spreadsheets export them."""
    count = table.rows.size
    while count and all(len(column) < count or _is_empty(column[count - 1]) for column in table.columns):
        count -= 1
    if count in (0, table.rows.size):
        return table  # a table without any number is for the reader of its channels to refuse
    columns = tuple(column[:count] for column in table.columns)
    return replace(table, columns=columns, rows=table.rows[:count], ragged={row: n for row, n in table.ragged.items() if row < count})


def _is_empty(cell: object) -> bool:
    return cell is None or cell != cell or (isinstance(cell, str) and not cell.strip())


def _unpacked(path: Path, raw: bytes) -> bytes:
    """What is in a gzip file, read no further than the limit: a few bytes may stand for any number of them."""
    pieces, size = [], 0
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(raw)) as file:
            while piece := file.read(1 << 20):
                pieces.append(piece)
                size += len(piece)
                if size > MOST_RECORD:
                    raise too_large(RecordError, str(path), "what it unpacks to", MOST_RECORD, "give a part of it, or save it as Parquet")
    except (OSError, EOFError, zlib.error) as error:
        raise RecordError(f"not a gzip file ({first_line(error)})", where=str(path), remedy="compress it again, or give the plain file") from None
    return b"".join(pieces)
