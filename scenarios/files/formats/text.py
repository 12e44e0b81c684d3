"""Text files in the dialects that loggers and spreadsheets write: encoding, separator, decimal
mark, titles, comments and a row of units.

Comment lines (``#``, ``%``, ``//``), titles and a spreadsheet's ``sep=;`` may stand above the
header. Commas, semicolons, tabs, bars or blanks separate columns: the mark that gives header and
rows equal numbers of cells. A file without a header has columns ``column 1``, ``column 2`` ... If
two readings of a file are possible, the file is refused, and the message names both.
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import io
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scenarios.files.formats.cells import (
    LOOKED_AT,
    MISSING,
    MOST_HEADS,
    CellTable,
    Reader,
    Topic,
    has_decimal_comma,
    has_number,
    header_cell,
    header_row,
    heads,
    is_known,
    is_number,
    unit_row,
    without_brackets,
)
from sim.errors import RecordError

SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
BLANKS = " "
COMMENT = "#"
COMMENTS = ("#", "%", "//")
UNNAMED = "column {}"
LONGEST_LINE = 100_000  # characters; the layout of a file with a longer line is not looked for
LAYOUT_BYTES = 200_000  # first bytes of a large file, which show its layout
BLOCK_BYTES = 4_000_000  # bytes that are parsed at a time
LARGE_FILE_BYTES = 500_000  # bytes from which a plain file is parsed column by column
_SEPARATOR_LINE = re.compile(r"sep=(.)\s*", re.IGNORECASE)  # as spreadsheets write it
_ZERO_BYTES = 0.4  # share of zeros among every second byte that shows UTF-16
_SAVE = "save it as CSV in UTF-8, as Parquet or as MAT"
_JSON = re.compile(rb"\s*(?:\{\s*\"|\[\s*[\[{])")
_UNPRINTABLE = re.compile("[\x00-\x08\x0e-\x1a\x1c-\x1f\x7f]")

Rows = list[tuple[int, list[str]]]  # number of each row as the user sees it, and its cells


def read(path: Path, raw: bytes) -> tuple[Topic, ...]:
    """Return the one table of a text file.

    Raises
    ------
    RecordError : the file has no text or is empty, or its separator cannot be decided.
    """
    if _JSON.match(raw[:LAYOUT_BYTES]):
        raise RecordError("JSON is not read", where=str(path), remedy=_SAVE)
    if len(raw) > LARGE_FILE_BYTES and (topic := _large(path, raw)) is not None:
        return (topic,)
    text, notes = _text(path, raw)
    with _long_cells(len(text)):
        layout = _layout(path, text)
        table, header_notes = _table(path, text[layout.first :], layout)
    table, cut_notes = _without_cut_row(table, text)
    return (Topic("", table, (*notes, *layout.notes, *header_notes, *cut_notes)),)


def _without_cut_row(table: CellTable, text: str) -> tuple[CellTable, tuple[str, ...]]:
    """Return the table without an incomplete last row, and a sentence on it if there was one.

    A recorder that loses its power leaves such a row: too few cells and no end of line.
    """
    last = table.rows.size - 1
    if (
        text.endswith(("\n", "\r"))
        or last < 1
        or table.ragged.get(last, len(table.header)) >= len(table.header)
    ):
        return table, ()
    note = f"the file ends within row {table.rows[last]}, which is left out"
    ragged = {row: cells for row, cells in table.ragged.items() if row != last}
    return replace(
        table,
        columns=tuple(column[:last] for column in table.columns),
        rows=table.rows[:last],
        ragged=ragged,
    ), (note,)


@contextlib.contextmanager
def _long_cells(most: int) -> Iterator[None]:
    """Allow cells of ``most`` characters while the body runs: a header of thousands of columns is
    a single cell by any separator but its own.
    """
    former = csv.field_size_limit(max(most, 1))
    try:
        yield
    finally:
        csv.field_size_limit(former)


class Layout(NamedTuple):
    """Layout of a text file.

    Attributes
    ----------
    first : position in the text of the table's first character.
    above : the lines above the table.
    separator : mark between columns.
    named : whether the table has a header.
    notes : a sentence on titles above the header, if there are any.
    """

    first: int
    above: list[str]
    separator: str
    named: bool
    notes: tuple[str, ...] = ()


def _layout(path: Path, text: str) -> Layout:
    first, above = _header_at(text)
    declared = _SEPARATOR_LINE.fullmatch(above[0]) if above else None
    if declared is not None:
        return Layout(first, above, declared[1], True)
    detected = _detected(text[first:])
    if detected is None:
        return Layout(first, above, _separator(path, text[first:], len(above)), True)
    separator, skipped, named = detected
    for line in itertools.islice(io.StringIO(text[first:], newline=""), skipped):
        above.append(line)
        first += len(line)
    titles = sum(_are_titles(above))
    notes = (f"{titles} lines above the header are taken as titles",) if titles else ()
    return Layout(first, above, separator, named, notes)


def _large(path: Path, raw: bytes) -> Topic | None:
    """Return the table of a large file, parsed column by column; None if only the reader of small
    files can read it.
    """
    first_bytes = raw[:LAYOUT_BYTES]
    try:
        head = first_bytes[: first_bytes.rindex(b"\n") + 1].decode("utf-8-sig")
        layout = _layout(path, head)
    except (ValueError, RecordError):
        return None
    byte_order_mark = len(codecs.BOM_UTF8) if first_bytes.startswith(codecs.BOM_UTF8) else 0
    table_at = byte_order_mark + len(head[: layout.first].encode())
    table = _fast_table(path, raw, table_at, head[layout.first :], layout)
    if table is None:
        return None
    header_notes = () if layout.named else _unnamed(layout, len(table.header), str(path))[1]
    return Topic("", table, (*layout.notes, *header_notes))


def _table(path: Path, text: str, layout: Layout) -> tuple[CellTable, tuple[str, ...]]:
    """Return the table of a text, and a sentence if its header is in a comment."""
    named, separator, above = layout.named, layout.separator, len(layout.above)
    notes: tuple[str, ...] = ()
    lines = _rows(path, text, separator, above)
    if not any(cell.strip() for _, cells in lines for cell in cells):
        raise RecordError(
            "the file is empty", where=str(path), remedy="give a header row and one row a sample"
        )
    width = len(lines[0][1])
    if named and all(is_number(cell) for cell in lines[0][1]) and width > 1:
        named = False
        if layout.above and _is_comment(layout.above[-1]) and not _commented_header(layout, width):
            remedy = (
                f"take the {COMMENT} from the header, row {above}, or name the columns with "
                "--columns"
            )
            raise RecordError(
                "there is no header, the first row holds numbers",
                where=f"{path}, row {lines[0][0]}",
                remedy=remedy,
            )
    if named:
        at, under, count = heads([cells for _, cells in lines[: MOST_HEADS + 1]])
        header, body = tuple(header_cell(cell, str(path)) for cell in lines[at][1]), lines[count:]
        units: tuple[str, ...] = ()
        if under is not None:
            units = tuple(map(without_brackets, lines[under][1]))
        elif body:
            units = unit_row(header, body[0][1])
            body = body[1:] if units else body
        # Where files were joined, the header comes again.
        body = [(row, cells) for row, cells in body if cells != lines[at][1]]
    else:
        header, notes = _unnamed(layout, width, str(path))
        body, units = lines, ()
    body = [
        (row, cells)
        for row, cells in body
        if len(cells) == len(header) or not _is_comment(cells[0])
    ]
    header, units, body = _of_one_width(header, units, body)
    ragged = {
        position: len(cells)
        for position, (_, cells) in enumerate(body)
        if len(cells) != len(header)
    }
    filled = [cells + [""] * (len(header) - len(cells)) if ragged else cells for _, cells in body]
    columns = tuple([cells[index] for cells in filled] for index in range(len(header)))
    decimal_comma = separator != "," and "," in text and has_decimal_comma(columns)
    rows = np.array([row for row, _ in body], dtype=int)
    table = CellTable(str(path), header, columns, rows, ragged, units, separator, decimal_comma)
    return table, notes


def _of_one_width(
    header: tuple[str, ...], units: tuple[str, ...], body: Rows
) -> tuple[tuple[str, ...], tuple[str, ...], Rows]:
    """Return header, units and rows with equal numbers of cells.

    Removes the empty cell after a final separator. Adds a header to row numbers, which R writes
    without one.
    """
    wider = bool(body) and all(len(cells) == len(header) + 1 for _, cells in body)
    if (
        len(header) > 1
        and not header[-1]
        and all(not cells[-1].strip() for _, cells in body if len(cells) == len(header))
    ):
        header, units = header[:-1], units[:-1]
        body = [
            (row, cells[:-1] if len(cells) == len(header) + 1 else cells) for row, cells in body
        ]
        return header, units, body
    if wider and all(not cells[-1].strip() for _, cells in body):
        return header, units, [(row, cells[:-1]) for row, cells in body]
    if wider and all(cells[0].strip() == str(n + 1) for n, (_, cells) in enumerate(body)):
        return ("", *header), ("", *units) if units else (), body
    return header, units, body


def _unnamed(layout: Layout, width: int, file: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the header of a table that begins with numbers, and a sentence if it is a comment.

    It is the comment above the table if that names columns, else ``column 1``, ``column 2`` ...
    """
    cells = _commented_header(layout, width)
    if not cells:
        return tuple(UNNAMED.format(n + 1) for n in range(width)), ()
    note = f"the header is the comment in row {len(layout.above)}"
    return tuple(header_cell(cell, file) for cell in cells), (note,)


def _commented_header(layout: Layout, width: int) -> tuple[str, ...]:
    """Return the cells of the last comment above the numbers if it is a header, else nothing.

    A header has as many cells as the rows, no number, and the name of a clock or channel.
    """
    if not layout.above or not _is_comment(layout.above[-1]):
        return ()
    comment = layout.above[-1].strip().lstrip("".join(COMMENTS)).strip()
    cells = tuple(cell.strip() for cell in _cells(comment, layout.separator))
    if len(cells) != width or any(map(is_number, cells)):
        return ()
    return cells if any(map(is_known, cells)) else ()


def _are_titles(above: Sequence[str]) -> list[bool]:
    """Return which lines are neither empty, nor comments, nor a spreadsheet's separator line."""
    return [
        bool(line.strip()) and not _is_comment(line) and not _SEPARATOR_LINE.fullmatch(line)
        for line in above
    ]


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith(COMMENTS)


def _text(path: Path, raw: bytes) -> tuple[str, tuple[str, ...]]:
    """Return the text of a file, and a sentence on its encoding if that is not Unicode."""
    sample = raw[:4096]
    even, odd = sample[::2], sample[1::2]
    long_enough = len(sample) > 8
    unicode = "utf-8-sig"
    if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        unicode = "utf-16"
    # In UTF-16 one byte of each letter of English is zero: the second one in little endian.
    elif long_enough and odd.count(0) > _ZERO_BYTES * len(odd) and not even.count(0):
        unicode = "utf-16-le"
    elif long_enough and even.count(0) > _ZERO_BYTES * len(even) and not odd.count(0):
        unicode = "utf-16-be"
    for encoding in (unicode, "cp1252"):
        try:
            text = raw.decode(encoding)
        except UnicodeDecodeError:
            continue
        if encoding.startswith("utf"):
            return text, ()
        if _UNPRINTABLE.search(text) is None:
            return text, ("the text is read as Latin-1 (Windows-1252)",)
    wrong = _UNPRINTABLE.search(raw.decode("latin-1"))
    row = raw[: wrong.start()].count(b"\n") + 1 if wrong is not None else 1
    raise RecordError(
        "neither text nor a format that is known here", where=f"{path}, row {row}", remedy=_SAVE
    ) from None


def _detected(text: str) -> tuple[str, int, bool] | None:
    """Return separator, lines above the header, and whether there is a header.

    None if the first two lines have equal numbers of cells by comma, semicolon or tab.
    """
    lines = []
    for line in io.StringIO(text, newline=""):
        lines.append(line.rstrip("\r\n"))
        if len(lines) >= LOOKED_AT:
            break
    if any(len(line) > LONGEST_LINE or line.count('"') % 2 for line in lines):
        return None  # a cell may continue on the next line
    filled = [line for line in lines if line.strip()]
    if len(filled) < 2:
        return None
    for mark in (",", ";", "\t"):
        first, second, last = (_cells(line, mark) for line in (*filled[:2], filled[-1]))
        # Titles may have as many cells as each other, but hardly as many as the rows.
        if (
            len(first) > 1
            and len(first) == len(second)
            and (len(first) == len(last) or len(lines) < LOOKED_AT)
        ):
            return None
    tail = filled[-max(1, min(len(filled) // 2, 20)) :]
    most_numbers, separator = 0, ""
    for mark in (*SEPARATORS, BLANKS):
        cells = [_cells(line, mark) for line in tail]
        width = len(cells[0])
        if width > 1 and all(len(row) == width and has_number(row) for row in cells):
            numbers = sum(is_number(cell) for row in cells for cell in row)
            if numbers > most_numbers:
                most_numbers, separator = numbers, mark
    if not separator:
        return None
    mark = separator
    width = len(_cells(tail[0], mark))
    cells = [
        _cells(line, mark) if line.strip() and not _is_comment(line) else [""] for line in lines
    ]
    rows = [row if len(row) == width else [""] for row in cells]
    first_numbers = next(
        (n for n, row in enumerate(rows) if len(row) == width and has_number(row)), None
    )
    header_at = header_row(rows)
    if header_at is not None and len(rows[header_at]) == width:
        return mark, header_at, True
    if first_numbers is None:
        return None
    if first_numbers and mark != BLANKS and 1 < len(cells[first_numbers - 1]) != width:
        return None  # header and rows differ in width; _rows and the checks of cells report it
    return mark, first_numbers, False


def _cells(line: str, mark: str) -> list[str]:
    """Return the cells of a line, without the empty cell after a final bar."""
    cells = line.split() if mark == BLANKS else next(csv.reader([line], delimiter=mark), [])
    if mark == "|" and len(cells) > 1 and not cells[-1].strip():
        return cells[:-1]
    return cells


def _fast_table(path: Path, raw: bytes, at: int, begin: str, layout: Layout) -> CellTable | None:
    """Return the table of a plain file from the byte ``at`` on, with the first lines ``begin``;
    None if the file is not plain.
    """
    separator, named = layout.separator, layout.named
    lines = begin.splitlines()[:3]
    body = begin.split("\n", 1)[-1]
    if (
        separator not in (*SEPARATORS, BLANKS)
        or len(lines) < 3
        or '"' in body
        or (separator != "," and "," in body)
    ):
        return None
    header = (
        tuple(header_cell(cell, str(path)) for cell in _cells(lines[0], separator)) if named else ()
    )
    if named and has_number(header):
        return None
    units = unit_row(header, _cells(lines[1], separator)) if named else ()
    skipped = (1 + bool(units)) if named else 0
    for _ in range(skipped):
        at = raw.index(b"\n", at) + 1
    width = len(header) or len(_cells(lines[0], separator))
    columns = (
        _blank_columns(raw, at, width)
        if separator == BLANKS
        else _marked_columns(raw, at, separator, width)
    )
    if columns is None or len(columns[0]) != raw.count(b"\n", at) + (not raw.endswith(b"\n")):
        return None
    rows = np.arange(len(columns[0])) + len(layout.above) + skipped + 1
    return CellTable(
        str(path),
        header or _unnamed(layout, width, str(path))[0],
        tuple(columns),
        rows,
        {},
        units,
        separator,
    )


def _marked_columns(raw: bytes, at: int, separator: str, width: int) -> list[np.ndarray] | None:
    """Return the columns of the rows from a byte on, block by block to save memory.

    A column has numbers if its first block has numbers. None if a later cell of it is no number:
    then the reader of small files has to read the file.
    """
    import pyarrow
    from pyarrow import csv as arrow_csv

    missing = sorted(
        {
            spelling
            for word in MISSING
            for spelling in (word, word.upper(), word.capitalize(), "NaN", "-NaN")
        }
    )
    names = [f"c{n}" for n in range(width)]
    trailing = (
        raw[at : raw.index(b"\n", at)].rstrip(b"\r ").endswith(separator.encode())
        and separator == "|"
    )
    names_in_file = [*names, "end"] if trailing else names
    parsing = arrow_csv.ParseOptions(delimiter=separator, quote_char=False)
    content = pyarrow.py_buffer(raw).slice(at)

    def options(types: dict[str, pyarrow.DataType]) -> arrow_csv.ConvertOptions:
        return arrow_csv.ConvertOptions(
            null_values=missing,
            strings_can_be_null=True,
            column_types=types,
            include_columns=names,
            true_values=[],
            false_values=[],
        )

    reading = arrow_csv.ReadOptions(column_names=names_in_file, block_size=BLOCK_BYTES)
    count = raw.count(b"\n", at) + (not raw.endswith(b"\n"))
    try:
        first = arrow_csv.open_csv(
            pyarrow.BufferReader(content), reading, parsing, options({})
        ).read_next_batch()
        numeric = [
            pyarrow.types.is_integer(field.type)
            or pyarrow.types.is_floating(field.type)
            or pyarrow.types.is_null(field.type)
            for field in first.schema
        ]
        types = {
            name: pyarrow.float64() if number else pyarrow.string()
            for name, number in zip(names, numeric, strict=True)
        }
        columns = [
            np.empty(count) if number else np.empty(count, dtype=object) for number in numeric
        ]
        row = 0
        for batch in arrow_csv.open_csv(
            pyarrow.BufferReader(content), reading, parsing, options(types)
        ):
            if row + batch.num_rows > count:
                return None
            for column, values in zip(columns, batch.columns, strict=True):
                column[row : row + batch.num_rows] = values.to_numpy(zero_copy_only=False)
            row += batch.num_rows
    except (pyarrow.ArrowInvalid, StopIteration):
        return None
    if row != count:
        return None  # pyarrow skips empty lines, but row numbers in messages count them
    return [
        column if number else _numeric_or_text(column)
        for column, number in zip(columns, numeric, strict=True)
    ]


def _numeric_or_text(cells: np.ndarray) -> np.ndarray:
    """Return a column of texts as numbers if each text is a number with blanks around it."""
    try:
        if not all(cell is None or (cell.isascii() and "_" not in cell) for cell in cells):
            return cells
        return np.array(
            [
                np.nan if cell is None or cell.strip().lower() in MISSING else float(cell)
                for cell in cells
            ]
        )
    except ValueError:
        return cells


def _blank_columns(raw: bytes, at: int, width: int) -> list[np.ndarray] | None:
    """Return the columns of rows separated by blanks; None for a text or a ragged row."""
    try:
        values = np.loadtxt(io.BytesIO(raw[at:]), dtype=float, comments=None, ndmin=2)
    except ValueError:
        return None
    return list(np.ascontiguousarray(values.T)) if values.shape[1] == width else None


def _header_at(text: str) -> tuple[int, list[str]]:
    """Return the position of the header, and the lines above it: comments, empty lines, and a
    spreadsheet's separator line.
    """
    above: list[str] = []
    at = 0
    for line in io.StringIO(text, newline=""):
        if (
            line.strip()
            and not _is_comment(line)
            and not (not above and _SEPARATOR_LINE.fullmatch(line))
        ):
            break
        above.append(line)
        at += len(line)
    return at, above


def _rows(path: Path, text: str, separator: str, above: int) -> Rows:
    """Return the rows that are not empty; ``above``: how many lines stand above the text."""
    if separator == BLANKS:
        split_lines = [
            (n + above + 1, line.split())
            for n, line in enumerate(io.StringIO(text, newline=""))
            if not _is_comment(line)
        ]
        return [(row, cells) for row, cells in split_lines if cells]
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    lines: Rows = []
    try:
        for cells in reader:
            if cells:
                lines.append((reader.line_num + above, cells))
    except csv.Error as error:
        what = f"not text separated by {SEPARATORS.get(separator, repr(separator))} ({error})"
        raise RecordError(
            what, where=f"{path}, row {reader.line_num + above}", remedy=_SAVE
        ) from None
    return lines


def _separator(path: Path, text: str, above: int) -> str:
    """Return the separator of the columns; a comma for a single column.

    If the header has several marks, the separator is the one by which all rows have equal numbers
    of cells. Raises RecordError if several marks do that, or none.
    """
    in_header = [mark for mark in SEPARATORS if len(_first_row(path, text, mark, above)) > 1]
    if not in_header:
        return ","
    if len(in_header) == 1:
        return in_header[0]
    fitting = [mark for mark in in_header if _of_equal_width(_rows(path, text, mark, above))]
    if len(fitting) != 1:
        marks = " and ".join(SEPARATORS[mark] for mark in in_header)
        what = f"{marks} stand in the header, and either may separate the columns"
        remedy = "save it with one separator, names that contain another in quotes"
        raise RecordError(what, where=f"{path}, row {above + 1}", remedy=remedy)
    return fitting[0]


def _first_row(path: Path, text: str, separator: str, above: int) -> list[str]:
    try:
        return next(csv.reader(io.StringIO(text, newline=""), delimiter=separator), [])
    except csv.Error as error:
        raise RecordError(
            f"not separated text ({error})", where=f"{path}, row {above + 1}", remedy=_SAVE
        ) from None


def _of_equal_width(lines: Rows) -> bool:
    return len(lines) > 1 and all(len(cells) == len(lines[0][1]) for _, cells in lines)


READERS = (Reader("text", (".csv", ".txt", ".asc", ".dat", ".tsv", ".tab", ".log"), (), read),)
