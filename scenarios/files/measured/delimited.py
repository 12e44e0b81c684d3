"""Text files in the dialects that loggers and spreadsheets write: separator, decimal mark, comments and a row of units, found for certain or refused.

Comment lines (``#``) and a spreadsheet's ``sep=;`` may stand above the header. Columns are separated by ``,`` ``;`` or tabs, whichever
parts the header; where several do, the one by which every row has as many cells as the header.
"""

from __future__ import annotations

import contextlib
import csv
import gzip
import io
import re
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from scenarios.files.measured.cells import MISSING, Table, first_line, has_decimal_comma, one_line, plain_number
from scenarios.files.sources import MOST_RECORD, too_large
from scenarios.files.units import is_unit
from sim.errors import RecordError

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}
COMMENT = "#"
_DECLARED = re.compile(r"sep=(.)\s*", re.IGNORECASE)
_MARKS = re.compile("[" + "".join(SEPARATORS) + "]")
_UTF16 = (b"\xff\xfe", b"\xfe\xff")  # byte order marks
_SAVE = "save it as CSV in UTF-8, as Parquet or as MAT"

Rows = list[tuple[int, list[str]]]  # number of each row as the user sees it, and its cells


def delimited_table(path: Path, raw: bytes) -> Table:
    """The table in a text file, ``.gz`` compressed.

    Raises
    ------
    RecordError : damaged, not UTF-8, empty, no header, or a separator that cannot be told.
    """
    text = _text(path, raw)
    first, above = _header_at(text)
    declared = _DECLARED.fullmatch(above[0]) if above else None
    with _long_cells(len(text)):
        separator = declared[1] if declared is not None else _separator(path, text[first:], len(above))
        lines = _rows(path, text[first:], separator, len(above))
    if not any(cell.strip() for _, cells in lines for cell in cells):
        raise RecordError("the file is empty", where=str(path), remedy="give a header row and one row a sample")
    header = tuple(one_line(cell) for cell in lines[0][1])
    _refuse_other_layouts(path, header, lines, above)
    body = lines[1:]
    units = _units(header, body)
    body = body[1:] if units else body
    ragged = {position: len(cells) for position, (_, cells) in enumerate(body) if len(cells) != len(header)}
    whole = [cells + [""] * (len(header) - len(cells)) if ragged else cells for _, cells in body]
    columns = tuple([cells[index] for cells in whole] for index in range(len(header)))
    comma = separator != "," and "," in text and has_decimal_comma(columns)
    return Table(str(path), header, columns, np.array([row for row, _ in body], dtype=int), ragged, units, separator, comma)


@contextlib.contextmanager
def _long_cells(most: int) -> Iterator[None]:
    """While the body runs, cells may be as long as the file: a header of thousands of columns is one cell to any other separator."""
    former = csv.field_size_limit(max(most, 1))
    try:
        yield
    finally:
        csv.field_size_limit(former)


def _unpacked(path: Path, raw: bytes) -> bytes:
    """What is in a gzip file, read no further than the limit: a few bytes may stand for any number of them."""
    pieces, size = [], 0
    with gzip.GzipFile(fileobj=io.BytesIO(raw)) as file:
        while piece := file.read(1 << 20):
            pieces.append(piece)
            size += len(piece)
            if size > MOST_RECORD:
                raise too_large(RecordError, str(path), "what it unpacks to", MOST_RECORD, "give a part of it, or save it as Parquet")
    return b"".join(pieces)


def _text(path: Path, raw: bytes) -> str:
    if path.suffix.lower() == ".gz":
        try:
            raw = _unpacked(path, raw)
        except (OSError, EOFError, zlib.error) as error:
            raise RecordError(f"not a gzip file ({first_line(error)})", where=str(path), remedy="compress it again, or give the plain file") from None
    try:
        return raw.decode("utf-16" if raw.startswith(_UTF16) else "utf-8-sig")
    except UnicodeDecodeError as error:
        row = raw[: error.start].count(b"\n") + 1
        raise RecordError("not UTF-8 text", where=f"{path}, row {row}", remedy=_SAVE) from None


def _header_at(text: str) -> tuple[int, list[str]]:
    """Where the header begins, and the lines above it: comments, empty ones, and a spreadsheet's word on the separator."""
    above: list[str] = []
    at = 0
    for line in io.StringIO(text, newline=""):
        if line.strip() and not line.lstrip().startswith(COMMENT) and not (not above and _DECLARED.fullmatch(line)):
            break
        above.append(line)
        at += len(line)
    return at, above


def _rows(path: Path, text: str, separator: str, above: int) -> Rows:
    """All rows but empty ones."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    lines: Rows = []
    try:
        for cells in reader:
            if cells:
                lines.append((reader.line_num + above, cells))
    except csv.Error as error:
        what = f"not text separated by {SEPARATORS.get(separator, repr(separator))} ({error})"
        raise RecordError(what, where=f"{path}, row {reader.line_num + above}", remedy=_SAVE) from None
    return lines


def _separator(path: Path, text: str, above: int) -> str:
    """What separates the columns; a comma where there is one column."""
    parting = [mark for mark in SEPARATORS if len(_first_row(path, text, mark, above)) > 1]
    if len(parting) > 1:
        fitting = [mark for mark in parting if _even(_rows(path, text, mark, above))]
        if len(fitting) != 1:
            both = " and ".join(SEPARATORS[mark] for mark in parting)
            what = f"{both} stand in the header, and either may separate the columns"
            raise RecordError(what, where=f"{path}, row {above + 1}", remedy="save it with one separator, names that contain another in quotes")
        return fitting[0]
    return parting[0] if parting else ","


def _first_row(path: Path, text: str, separator: str, above: int) -> list[str]:
    try:
        return next(csv.reader(io.StringIO(text, newline=""), delimiter=separator), [])
    except csv.Error as error:
        raise RecordError(f"not separated text ({error})", where=f"{path}, row {above + 1}", remedy=_SAVE) from None


def _even(lines: Rows) -> bool:
    return len(lines) > 1 and all(len(cells) == len(lines[0][1]) for _, cells in lines)


def _refuse_other_layouts(path: Path, header: Sequence[str], lines: Rows, above: Sequence[str]) -> None:
    """Refuse a file whose columns are separated by blanks, one with a title above its header, and one whose header is commented out."""
    words = len(header[0].split())
    if len(header) == 1 and words > 1 and len(lines) > 1 and all(len(cells) == 1 and len(cells[0].split()) == words for _, cells in lines[1:]):
        raise RecordError("the columns are separated by blanks", where=f"{path}, row {lines[0][0]}", remedy="save it with commas between the columns")
    if sum(bool(cell.strip()) for cell in header) == 1 and len(lines) > 2:
        under, last = ([word for cell in lines[row][1] for word in _MARKS.split(cell) if word.strip()] for row in (1, -1))
        if len(under) > 1 and not any(map(_is_number, under)) and any(map(_is_number, last)):
            what = "a title stands above the header"
            raise RecordError(what, where=f"{path}, row {lines[0][0]}", remedy=f"begin the line with {COMMENT}, or delete it")
    if above and above[-1].lstrip().startswith(COMMENT) and all(_is_number(cell) for cell in header):
        remedy = f"take the {COMMENT} from the header, row {len(above)}" if len(header) > 1 else "give a header row"
        raise RecordError("there is no header, the first row holds numbers", where=f"{path}, row {lines[0][0]}", remedy=remedy)


def _units(header: Sequence[str], body: Rows) -> tuple[str, ...]:
    """The row under the header as units: no cell of it is a number but a ``1``, and at least one is a unit that is known. Else nothing."""
    if not body or len(body[0][1]) != len(header):
        return ()
    cells = [_bare(cell) for cell in body[0][1]]
    told = [cell for cell in cells if cell.lower() not in (*MISSING, "1", "-")]
    if any(_is_number(cell) for cell in told) or not any(is_unit(cell) for cell in told):
        return ()
    return tuple("" if cell == "-" else cell for cell in cells)


def _bare(cell: str) -> str:
    """A unit without the brackets around it."""
    text = one_line(cell)
    return text[1:-1].strip() if text[:1] + text[-1:] in ("[]", "()") else text


def _is_number(cell: str) -> bool:
    for comma in (False, True):
        try:
            plain_number(cell.strip(), comma=comma)
        except ValueError:
            continue
        return True
    return False
