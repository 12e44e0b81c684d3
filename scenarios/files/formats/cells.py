"""Tables of files, their headers and units, and conversion of cells to numbers.

The search for the header and for a row of units is the same for text files and spreadsheets. A
reader returns topics: tables whose columns have a common clock.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.files.declarations import CHANNEL_UNITS, is_clock, shortened_list, split_header
from scenarios.files.units import is_unit
from sim.errors import RecordError

# texts that loggers, spreadsheets and languages write for a missing sample, errors of spreadsheets
# included
MISSING = frozenset({
    "", "nan", "-nan", "na", "n/a", "n.a.", "null", "none", "nil", "nat", "<na>", "missing", "invalid", "-", "--", "---", "?", ".", "*", "**", "***",  # noqa: E501
    "****", "*****", "******", "*******", "********", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "#n/a", "#na", "#value!",  # noqa: E501
    "#div/0!", "#num!", "#ref!", "#null!", "#name?",
})  # fmt: skip
MINUS = "\N{MINUS SIGN}"  # minus sign of spreadsheets and word processors
_FORTRAN = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))[dD]([+-]?\d{1,3})", re.ASCII)
_WITH_POINTS_OR_COMMAS = re.compile(r"[+-]?(?=[.,]*\d)[\d.,]+([eE][+-]?\d+)?", re.ASCII)
_LONGEST_MESSAGE = 160  # characters of the message of a library
_LONGEST_NAME = 60  # characters of a name in a message
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+", re.ASCII)


@dataclass(frozen=True, eq=False, repr=False)
class CellTable:
    """Table of one file, its cells as in the file.

    Attributes
    ----------
    file : the path as the user gave it, for messages.
    header : one cell for each column.
    columns : one sequence of N texts, or array ``(N,)``, for each column.
    rows : ``(N,)`` row numbers for messages; the first line of a text file is row 1.
    ragged : position of a row -> number of its cells, if it is not that of the header.
    units : row of units below the header; empty without one.
    separator : separator of the cells in a text file; empty for other files.
    decimal_comma : whether numbers have a decimal comma.
    stated_apart : whether ``units`` are metadata, which are often wrong.
    unreadable : position of a column -> reason why it is no sequence of numbers, such as ``"an
        array of 801x2"``. The cells of such a column are empty.
    """

    file: str
    header: tuple[str, ...]
    columns: tuple[list[str] | np.ndarray, ...]
    rows: np.ndarray
    ragged: Mapping[int, int] = field(default_factory=dict)
    units: tuple[str, ...] = ()
    separator: str = ""
    decimal_comma: bool = False
    stated_apart: bool = False
    unreadable: Mapping[int, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Table {self.file}: {self.rows.size} rows of {len(self.header)} columns>"


@dataclass(frozen=True, eq=False)
class Numbers:
    """A column as numbers ``(N,)``, NaN for empty cells and texts; and position -> text."""

    values: np.ndarray
    texts: Mapping[int, str]


def numbers(table: CellTable, index: int) -> Numbers:
    """Return the numbers of a column, read with the decimal mark of the file, and its other texts.

    Raises
    ------
    RecordError : if the column is no sequence of numbers.
    """
    if index in table.unreadable:
        where = f"{table.file}, column {table.header[index]!r}"
        raise RecordError(
            f"it is {table.unreadable[index]}",
            where=where,
            remedy="store one vector for each channel, or rename what is no channel",
        )
    column = table.columns[index]
    if isinstance(column, np.ndarray) and column.dtype.kind in "fiu":
        return Numbers(column.astype(float), {})
    values, texts = np.full(len(column), np.nan), {}
    for position, cell in enumerate(column):
        if cell is None:
            continue
        text = str(cell).strip()
        if text.lower() in MISSING:
            continue
        try:
            values[position] = number_of_text(text, comma=table.decimal_comma)
        except ValueError:
            texts[position] = text
    return Numbers(values, texts)


def number_of_text(text: str, *, comma: bool = False) -> float:
    """Return the number that a text is. ``comma`` : whether numbers have a decimal comma.

    Raises
    ------
    ValueError : if the text is no number, has the other decimal mark, or has a form that only
        Python accepts (``1_000``, digits of other scripts).
    """
    text = text.replace(MINUS, "-")
    if "_" in text or not text.isascii() or (comma and "." in text):
        raise ValueError(text)
    if (fortran := _FORTRAN.fullmatch(text)) is not None:
        return float(f"{fortran[1]}e{fortran[2]}")
    if comma and text.count(",") == 1:
        text = text.replace(",", ".")
    return float(text)


def has_decimal_comma(columns: Sequence[Sequence[str]]) -> bool:
    """Return whether the commas of a file are certainly decimal marks: a number such as ``0,5`` has
    a comma where no separator of thousands can be.
    """
    return any("," in cell and certain_comma(cell.strip()) for column in columns for cell in column)


def certain_comma(text: str) -> bool:
    """Return whether a cell is a number with a comma that cannot separate thousands."""
    return (
        text.count(",") == 1
        and "." not in text
        and _WITH_POINTS_OR_COMMAS.fullmatch(text) is not None
        and _THOUSANDS.fullmatch(text) is None
    )


def mark_fault(table: CellTable, text: str) -> tuple[str, str] | None:
    """Return the error of a cell with the wrong decimal mark and the remedy; None for any other
    cell.
    """
    if (
        _WITH_POINTS_OR_COMMAS.fullmatch(text) is None
        or not table.separator
        or not ("," in text or "." in text)
    ):
        return None
    if table.separator == "," and "," in text:
        return (
            f"{text!r} has a comma in a file whose columns are separated by commas",
            "export with semicolons between the columns, or with points",
        )
    if table.decimal_comma:
        return (
            f"{text!r} has a point in a file with decimal commas",
            "write all numbers with one decimal mark, and none between thousands",
        )
    return (
        f"{text!r} may be a decimal number or one with its thousands parted",
        "export with decimal points and nothing between thousands",
    )


def first_line(error: Exception) -> str:
    """Return the first line of the message of a library, shortened."""
    text = str(error).strip()
    return text.splitlines()[0][:_LONGEST_MESSAGE] if text else type(error).__name__


def header_cell(cell: str, file: str) -> str:
    """Return a header cell without line breaks.

    Raises
    ------
    RecordError : if it has control characters.
    """
    if any(
        character not in "\t\r\n" and unicodedata.category(character) in ("Cc", "Cf", "Cs")
        for character in cell
    ):
        shown = repr(cell if len(cell) <= _LONGEST_NAME else cell[: _LONGEST_NAME - 3] + "...")
        raise RecordError(
            f"the name {shown} holds control characters",
            where=f"{file}, header",
            remedy="rename that column",
        )
    return one_line(cell)


def one_line(cell: str) -> str:
    """Return a header cell without the line breaks that spreadsheets put into it."""
    return " ".join(cell.split())


# most rows among which `heads` searches: those of names, remarks and units, and the first numbers
MOST_HEADS = 5
LOOKED_AT = 200  # rows among which the header is searched for


def header_row(rows: Sequence[Sequence[str]]) -> int | None:
    """Return the index of the header; None without one.

    The header is the first row without a number that has a row of numbers among the three rows
    below it. This row is at most as wide as the header and at least half as wide. Rows above the
    header, titles and remarks, may have any number of cells.
    """
    for index, cells in enumerate(rows[:LOOKED_AT]):
        width = width_of(cells)
        below = [row for row in rows[index + 1 : index + 4] if any(cell.strip() for cell in row)]
        numeric = [row for row in below if has_number(row)]
        if (
            width >= 1
            and not has_number(cells)
            and any(width_of(row) <= width for row in numeric)
            and width_of(numeric[0]) * 2 >= width
        ):
            return index
    return None


def unit_row(header: Sequence[str], under: Sequence[str]) -> tuple[str, ...]:
    """Return the row ``under`` the header if it has units, else an empty row.

    A row of units has at least one known unit, and no number except ``1``.
    """
    if len(under) != len(header):
        return ()
    cells = [without_brackets(cell) for cell in under]
    filled_cells = [cell for cell in cells if cell.lower() not in (*MISSING, "1", "-")]
    if any(is_number(cell) for cell in filled_cells) or not any(
        is_unit(cell) for cell in filled_cells
    ):
        return ()
    return tuple("" if cell == "-" else cell for cell in cells)


def heads(rows: Sequence[Sequence[str]]) -> tuple[int, int | None, int]:
    """Return the position of the row of names, that of the row of units, and the number of header
    rows, for files with several header rows.

    Header rows are all rows above the first number. The row of units has the largest share of known
    units, and the row of names has most names of clocks and channels; the first of equal rows is
    taken. The result is ``0, None, 1``, a single row of names, if there are fewer rows or no units,
    and also if the units are the second of two rows: ``unit_row`` finds these.
    """
    count = next((n for n, cells in enumerate(rows[:MOST_HEADS]) if has_number(cells)), 0)
    above = rows[:count]
    if count < 2 or any(len(cells) != len(above[0]) for cells in above):
        return 0, None, 1
    units = [
        sum(is_unit(without_brackets(cell)) for cell in cells if cell.strip()) for cells in above
    ]
    filled = [sum(bool(cell.strip()) for cell in cells) for cells in above]
    unit_position = max(range(count), key=lambda n: units[n] / max(filled[n], 1))
    if 2 * units[unit_position] <= filled[unit_position] or (count == 2 and unit_position == 1):
        return 0, None, 1
    known_names = [sum(is_known(cell) for cell in cells) for cells in above]
    known_names[unit_position] = -1
    return max(range(count), key=lambda n: known_names[n]), unit_position, count


def is_known(cell: str) -> bool:
    """Return whether a header cell, without its unit, is a known name of a clock or channel."""
    name = split_header(one_line(cell))[0]
    return is_clock(name) or name.lower() in CHANNEL_UNITS


def without_brackets(cell: str) -> str:
    """Return a unit without the brackets around it."""
    text = one_line(cell)
    return text[1:-1].strip() if text[:1] + text[-1:] in ("[]", "()") else text


def has_number(cells: Sequence[str]) -> bool:
    """Return whether a cell of the row is a number other than ``1``."""
    return any(is_number(cell) and cell.strip() != "1" for cell in cells)


def is_number(cell: str) -> bool:
    """Return whether a cell is a number with a decimal point or a decimal comma."""
    for comma in (False, True):
        try:
            number_of_text(cell.strip(), comma=comma)
        except ValueError:
            continue
        return True
    return False


def width_of(cells: Sequence[str]) -> int:
    """Return the number of cells of a row up to the last one that is not empty."""
    return max((index + 1 for index, cell in enumerate(cells) if cell.strip()), default=0)


FIRST_LINES = 4096  # bytes among which a mark of a format is searched for


@dataclass(frozen=True, eq=False, repr=False)
class Topic:
    """Columns with a common clock.

    Attributes
    ----------
    name : name of the message, sheet or group in the file; empty if the file has only one table.
    table : the columns, with the clock.
    notes : sentences on the interpretation of the file.
    """

    name: str
    table: CellTable
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Topic {self.name or '(only one)'}: {self.table!r}>"


@dataclass(frozen=True)
class Reader:
    """The reader of one format.

    Attributes
    ----------
    name : name of the format.
    suffixes : suffixes of its files.
    magic : first bytes of its files. A mark that begins with a line break may be at the begin of
        any of the first lines.
    read : function of path and content that returns the topics of a file; it raises RecordError if
        the file is damaged or has no table.
    """

    name: str
    suffixes: tuple[str, ...]
    magic: tuple[bytes, ...]
    read: Callable[[Path, bytes], tuple[Topic, ...]]


def table_of_columns(
    path: Path,
    columns: Mapping[str, Any],
    units: Mapping[str, str] | None = None,
    *,
    place: str = "",
    rows: int | None = None,
    unreadable: Mapping[str, str] | None = None,
) -> CellTable:
    """Return a table of named columns.

    Parameters
    ----------
    path : the file, for messages.
    columns : name -> one-dimensional sequence. A column that is shorter than the others is refused
        when a channel needs it.
    units : name -> unit, where the file states it apart from the header.
    place : the topic in the file, for messages.
    rows : number of rows; None takes that of the longest column.
    unreadable : further name -> reason why it is no sequence of numbers. Such a column is refused
        when a channel needs it.
    """
    vectors = [_vector(values) for values in columns.values()]
    count = rows if rows is not None else max((vector.size for vector in vectors), default=0)
    where = f"{path}, {place}" if place else str(path)
    faults = dict(unreadable or {})
    names = (*columns, *faults)
    column_units = units or {}
    unit_cells: tuple[str, ...] = ()
    if any(column_units.values()):
        unit_cells = tuple(column_units.get(name, "") if name in columns else "" for name in names)
    return CellTable(
        where,
        tuple(header_cell(str(name), where) for name in names),
        (*vectors, *(np.full(count, np.nan) for _ in faults)),
        np.arange(1, count + 1),
        units=unit_cells,
        stated_apart=True,
        unreadable={len(vectors) + i: fault for i, fault in enumerate(faults.values())},
    )


def missing_library(error: ImportError, path: Path, format_name: str, extra: str) -> RecordError:
    """Return the error for a format whose library is not installed."""
    library = (error.name or "its library").split(".")[0]
    command = f"python -m pip install {library}"
    if extra:
        command = f'in the folder of the project: python -m pip install -e ".[{extra}]"'
    what = f"reading {format_name} needs {library}, which is not installed"
    return RecordError(what, where=str(path), remedy=f"{command}; or export the record as CSV")


def damaged(fault: BaseException, path: Path, format_name: str) -> RecordError:
    """Return the error for a file that the library of its format cannot read."""
    text = re.sub(r"'?<[^<>]* object at 0x[0-9a-f]+>'?", "the file", str(fault)).strip()
    reason = type(fault).__name__
    if text:
        reason = " ".join(text.splitlines()[0].split())[:_LONGEST_MESSAGE]
    return RecordError(
        f"not a readable {format_name} file ({reason})",
        where=str(path),
        remedy="export it again, or save the record as CSV",
    )


def no_table(path: Path, content: Sequence[str], remedy: str) -> RecordError:
    """Return the error for a file without a column of numbers. ``content`` has the names of what
    the file contains instead.
    """
    held = f"; it holds {shortened_list(content, 12)}" if content else ""
    return RecordError(f"no column of numbers is in the file{held}", where=str(path), remedy=remedy)


def begins_with(raw: bytes, mark: bytes) -> bool:
    """Return whether a file begins with a mark. If the mark begins with a line break, one of the
    first lines must begin with it.
    """
    if mark.startswith(b"\n"):
        return mark in b"\n" + raw[:FIRST_LINES]
    return raw.startswith(mark)


def _vector(values: Any) -> np.ndarray:
    """Return values as an array ``(N,)`` of floats, times or objects."""
    array = np.asarray(values)
    if array.dtype.kind in "fiu":
        return array.astype(float, copy=False).reshape(-1)
    if array.dtype.kind == "b":
        return array.astype(float).reshape(-1)
    if array.dtype.kind in "mM":
        return array.reshape(-1)
    return array.astype(object).reshape(-1)
