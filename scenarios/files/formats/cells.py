"""Tables of files: headers, cells, row numbers; and conversion of cells to numbers.

Where the header of a table is, and whether a row of units follows it: the same for text files
and spreadsheets.

The interface between readers and everything else: topics, each a table whose columns share one
clock.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np

from scenarios.files.declarations import CHANNEL_UNITS, is_clock, split_header
from scenarios.files.units import is_unit
from sim.errors import RecordError

# What loggers, spreadsheets (their errors too) and languages write where a sample is missing.
MISSING = frozenset({
    "", "nan", "-nan", "na", "n/a", "n.a.", "null", "none", "nil", "nat", "<na>", "missing", "invalid", "-", "--", "---", "?", ".", "*", "**", "***",  # noqa: E501
    "****", "*****", "******", "*******", "********", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "#n/a", "#na", "#value!",  # noqa: E501
    "#div/0!", "#num!", "#ref!", "#null!", "#name?",
})  # fmt: skip
MINUS = "\N{MINUS SIGN}"  # as spreadsheets and word processors set it
_FORTRAN = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))[dD]([+-]?\d{1,3})", re.ASCII)
# a number as somebody wrote it, with points and commas in it
_MARKED = re.compile(r"[+-]?(?=[.,]*\d)[\d.,]+([eE][+-]?\d+)?", re.ASCII)
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+", re.ASCII)


@dataclass(frozen=True, eq=False, repr=False)
class CellTable:
    """Columns of one file as texts.

    Attributes
    ----------
    file : the path as the user gave it, for messages.
    header : one cell per column.
    columns : one sequence per column: texts, or an array.
    rows : row numbers for messages; the first line of a text file is row 1.
    ragged : number of cells in rows (by position) that differ from the header's.
    units : row of units under the header; empty without one.
    separator : between the cells of a text file, else empty.
    stated_apart : whether ``units`` are metadata, which recorders often fill in carelessly.
    decimal_comma : whether numbers have a decimal comma.
    unreadable : reason why a column (by position) is no sequence of numbers, ``"an array of
        801x2"``; its cells are empty.
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
    """A column as numbers, NaN for empty cells and texts, and the texts by position."""

    values: np.ndarray
    texts: Mapping[int, str]


def numbers(table: CellTable, index: int) -> Numbers:
    """Convert a column to floats by the file's decimal mark, and return other texts with their
    position.

    Raises RecordError for a column without a sequence of numbers.
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
    """Convert a text; ValueError for forms that only Python accepts (``1_000``, digits of other
    scripts) and for the other decimal mark.
    """
    text = text.replace(MINUS, "-")
    if "_" in text or not text.isascii() or (comma and "." in text):
        raise ValueError(text)
    if (fortran := _FORTRAN.fullmatch(text)) is not None:
        return float(f"{fortran[1]}e{fortran[2]}")
    return float(text.replace(",", ".")) if comma and text.count(",") == 1 else float(text)


def has_decimal_comma(columns: Sequence[Sequence[str]]) -> bool:
    """Return whether the commas of a file are certainly decimal marks: one is where no separator of
    thousands can be, as in ``0,5``.
    """
    return any("," in cell and certain_comma(cell.strip()) for column in columns for cell in column)


def certain_comma(text: str) -> bool:
    """Return whether a cell is a number with a comma that cannot separate thousands."""
    return (
        text.count(",") == 1
        and "." not in text
        and _MARKED.fullmatch(text) is not None
        and _THOUSANDS.fullmatch(text) is None
    )


def mark_fault(table: CellTable, text: str) -> tuple[str, str] | None:
    """Error of a cell with the wrong decimal mark, and the remedy; None for another error."""
    if _MARKED.fullmatch(text) is None or not table.separator or not ("," in text or "." in text):
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
    """Return the first line of another library's message, shortened."""
    text = str(error).strip()
    return text.splitlines()[0][:160] if text else type(error).__name__


def header_cell(cell: str, file: str) -> str:
    """Return a header cell on one line. Raises RecordError for invisible characters."""
    if any(
        character not in "\t\r\n" and unicodedata.category(character) in ("Cc", "Cf", "Cs")
        for character in cell
    ):
        shown = repr(cell if len(cell) <= 60 else cell[:57] + "...")
        raise RecordError(
            f"the name {shown} holds control characters",
            where=f"{file}, header",
            remedy="rename that column",
        )
    return one_line(cell)


def one_line(cell: str) -> str:
    """Return a header cell without the line breaks that spreadsheets put into it."""
    return " ".join(cell.split())


MOST_HEADS = 5  # rows of names, remarks and units above the numbers, and one of numbers
LOOKED_AT = 200  # rows in which the header is looked for


def header_row(rows: Sequence[Sequence[str]]) -> int | None:
    """Return the index of the header: the last row of names that is as wide as the first rows of
    numbers below it, or None.

    Rows above it, titles and remarks, may have any number of cells.
    """
    for index, cells in enumerate(rows[:LOOKED_AT]):
        below = [row for row in rows[index + 1 : index + 4] if any(cell.strip() for cell in row)]
        if (
            _width(cells) >= 1
            and not has_number(cells)
            and any(_width(row) <= _width(cells) and has_number(row) for row in below)
        ):
            numeric = next(row for row in below if has_number(row))
            if _width(numeric) * 2 >= _width(cells):
                return index
    return None


def unit_row(header: Sequence[str], under: Sequence[str]) -> tuple[str, ...]:
    """Return the row under the header if it has units, else nothing.

    At least one cell must be a known unit, and no cell a number except ``1``.
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
    """Find the header rows: which of the first rows names the columns, which has their units, if
    any, and the number of header rows.

    The rows are those above the first number, three at least or two with the units above. The units
    are the row with most known ones, the names the row with most names of clocks and channels; of
    rows with as many the first. Fewer rows are for ``unit_row``: ``0, None, 1``.
    """
    count = next((n for n, cells in enumerate(rows[:MOST_HEADS]) if has_number(cells)), 0)
    above = rows[:count]
    if count < 2 or any(len(cells) != len(above[0]) for cells in above):
        return 0, None, 1
    units = [
        sum(is_unit(without_brackets(cell)) for cell in cells if cell.strip()) for cells in above
    ]
    filled = [sum(bool(cell.strip()) for cell in cells) for cells in above]
    at = max(range(count), key=lambda n: units[n] / max(filled[n], 1))
    if 2 * units[at] <= filled[at] or (count == 2 and at == 1):
        return 0, None, 1
    recognised = [
        sum(is_known(cell) for cell in cells) if n != at else -1 for n, cells in enumerate(above)
    ]
    return max(range(count), key=lambda n: recognised[n]), at, count


def is_known(cell: str) -> bool:
    """Return whether a header cell, without its unit, is the name of a clock or of a channel."""
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


def _width(cells: Sequence[str]) -> int:
    return max((index + 1 for index, cell in enumerate(cells) if cell.strip()), default=0)


FIRST_LINES = 4096  # bytes


@dataclass(frozen=True, eq=False, repr=False)
class Topic:
    """Columns that were sampled by one clock.

    Attributes
    ----------
    name : name of the message, sheet or group in the file; empty if the file has one table only.
    table : the columns, the clock among them.
    notes : sentences on how the reader understood the file.
    """

    name: str
    table: CellTable
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Topic {self.name or '(only one)'}: {self.table!r}>"


class Reader(Protocol):
    """A module of this package: the suffixes and first bytes of its format, and its reading
    function.

    A mark of ``MAGIC`` that begins with a line break may be at the start of any of the first lines.
    ``EXTRA`` names the optional dependency group of ``pyproject.toml`` that installs the library,
    empty if none is needed.
    """

    FORMAT: str
    SUFFIXES: tuple[str, ...]
    MAGIC: tuple[bytes, ...]
    EXTRA: str

    def read(self, path: Path, raw: bytes) -> tuple[Topic, ...]:
        """Return the topics of a file. Raises RecordError if it is damaged or holds no table."""


def table_of_columns(
    path: Path,
    columns: Mapping[str, Any],
    units: Mapping[str, str] | None = None,
    *,
    place: str = "",
    rows: int | None = None,
    unreadable: Mapping[str, str] | None = None,
) -> CellTable:
    """Return a table of named columns; a shorter column is refused when a channel needs it.

    Parameters
    ----------
    path : the file, for messages.
    place : the topic in it.
    columns : name -> one-dimensional sequence.
    units : name -> unit, where the file states it apart from the header.
    rows : number of rows; None: as many as the longest column has.
    unreadable : further names, and why they hold no sequence of numbers; whoever asks for one of
        them is refused.
    """
    column_units = units or {}
    vectors = tuple(_vector(values) for values in columns.values())
    count = rows if rows is not None else max((vector.size for vector in vectors), default=0)
    under = (
        tuple(column_units.get(name, "") for name in columns) if any(column_units.values()) else ()
    )
    where = f"{path}, {place}" if place else str(path)
    others = dict(unreadable or {})
    header = tuple(header_cell(str(name), where) for name in (*columns, *others))
    faults = {len(vectors) + at: fault for at, fault in enumerate(others.values())}
    under = (*under, *("" for _ in others)) if under else ()
    vectors = (*vectors, *(np.full(count, np.nan) for _ in others))
    return CellTable(
        where,
        header,
        vectors,
        np.arange(1, count + 1),
        units=under,
        stated_apart=True,
        unreadable=faults,
    )


def missing_library(error: ImportError, path: Path, format_name: str, extra: str) -> RecordError:
    """Return the error for a format whose library is not installed."""
    library = (error.name or "its library").split(".")[0]
    wanted = (
        f'in the folder of the project: python -m pip install -e ".[{extra}]"'
        if extra
        else f"python -m pip install {library}"
    )
    what = f"reading {format_name} needs {library}, which is not installed"
    return RecordError(what, where=str(path), remedy=f"{wanted}; or export the record as CSV")


def damaged(fault: BaseException, path: Path, format_name: str) -> RecordError:
    """Return the error for a file that the format's library cannot read."""
    text = re.sub(r"'?<[^<>]* object at 0x[0-9a-f]+>'?", "the file", str(fault)).strip()
    reason = " ".join(text.splitlines()[0].split())[:160] if text else type(fault).__name__
    return RecordError(
        f"not a readable {format_name} file ({reason})",
        where=str(path),
        remedy="export it again, or save the record as CSV",
    )


def no_table(path: Path, seen: Sequence[str], remedy: str) -> RecordError:
    """Return the error for a file without a column; ``seen``: names of the file's other content."""
    listed = ", ".join(seen[:12]) + (", ..." if len(seen) > 12 else "")
    return RecordError(
        f"no column of numbers is in the file{f'; it holds {listed}' if listed else ''}",
        where=str(path),
        remedy=remedy,
    )


def begins_with(raw: bytes, mark: bytes) -> bool:
    """Whether a file begins with a mark; of a mark that begins with a line break, whether one of
    its first lines does."""
    return mark in b"\n" + raw[:FIRST_LINES] if mark.startswith(b"\n") else raw.startswith(mark)


def as_module(module: ModuleType) -> Reader:
    """Return a module seen as a reader."""
    return module


def _vector(values: Any) -> np.ndarray:
    array = np.asarray(values)
    if array.dtype.kind in "fiu":
        return array.astype(float, copy=False).reshape(-1)
    if array.dtype.kind == "b":
        return array.astype(float).reshape(-1)
    if array.dtype.kind in "mM":
        return array.reshape(-1)
    return array.astype(object).reshape(-1)
