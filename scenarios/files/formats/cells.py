"""A table as it stands in a file: headers, cells, the row numbers that a user sees; and cells as
numbers.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sim.errors import RecordError

# What loggers, spreadsheets (their errors too) and languages write where a sample is missing.
MISSING = frozenset({
    "", "nan", "-nan", "na", "n/a", "n.a.", "null", "none", "nil", "nat", "<na>", "missing", "invalid", "-", "--", "---", "?", ".", "*", "**", "***",  # noqa: E501
    "****", "*****", "******", "*******", "********", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "#n/a", "#na", "#value!",  # noqa: E501
    "#div/0!", "#num!", "#ref!", "#null!", "#name?",
})  # fmt: skip
MINUS = "\N{MINUS SIGN}"  # as spreadsheets and word processors set it
_FORTRAN = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))[dD]([+-]?\d{1,3})", re.ASCII)
LARGEST = 1e50  # squares and sums of larger numbers leave the range of finite ones
# a number as somebody wrote it, with points and commas in it
_MARKED = re.compile(r"[+-]?(?=[.,]*\d)[\d.,]+([eE][+-]?\d+)?", re.ASCII)
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+", re.ASCII)


@dataclass(frozen=True, eq=False, repr=False)
class CellTable:
    """Columns of one file, nothing interpreted yet.

    Attributes
    ----------
    file : the path as the user gave it, for messages.
    header : one cell a column, on one line.
    columns : one sequence a column: texts, or an array of whatever the file holds.
    rows : number of each row as the user sees it; the first line of a text file is row 1.
    ragged : cells found in the rows (by position) that have more or fewer than the header.
    units : the row of units under the header, empty where a cell says nothing; none at all where
    there is no such row. separator : what stands between the cells of a text file, else empty.
    stated_apart : whether ``units`` are metadata of the file, which recorders fill in carelessly,
    and no row that somebody wrote. decimal_comma : whether the numbers are written with a comma
    where others write a point. unreadable : why a column (by position) is no sequence of numbers,
    ``"an array of 801x2"``. Its cells are empty; whoever asks for its
        numbers is refused.
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
    """One column as numbers, NaN where the cell is empty or holds text, and those texts by
    position.
    """

    values: np.ndarray
    texts: Mapping[int, str]


def numbers(table: CellTable, index: int) -> Numbers:
    """A column as floats; what is not a number, by the file's decimal mark, is kept apart with its
    position.

    Raises RecordError for a column that holds no sequence of numbers.
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
            values[position] = plain_number(text, comma=table.decimal_comma)
        except ValueError:
            texts[position] = text
    return Numbers(values, texts)


def plain_number(text: str, *, comma: bool = False) -> float:
    """A number of a file; ValueError for what Python alone would take for one (``1_000``, digits of
    other scripts) and for the other mark.
    """
    text = text.replace(MINUS, "-")
    if "_" in text or not text.isascii() or (comma and "." in text):
        raise ValueError(text)
    if (fortran := _FORTRAN.fullmatch(text)) is not None:
        return float(f"{fortran[1]}e{fortran[2]}")
    return float(text.replace(",", ".")) if comma and text.count(",") == 1 else float(text)


def has_decimal_comma(columns: Sequence[Sequence[str]]) -> bool:
    """Whether a file's commas are decimal marks for certain: one stands where none between
    thousands can, as in ``0,5``.
    """
    return any("," in cell and certain_comma(cell.strip()) for column in columns for cell in column)


def certain_comma(text: str) -> bool:
    """Whether a cell is a number whose one comma cannot part thousands."""
    return (
        text.count(",") == 1
        and "." not in text
        and _MARKED.fullmatch(text) is not None
        and _THOUSANDS.fullmatch(text) is None
    )


def mark_fault(table: CellTable, text: str) -> tuple[str, str] | None:
    """What is wrong with a cell whose points or commas do not go with its file, and the remedy;
    None where it is something else.
    """
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
    """The first line of what another library says, short enough for a message."""
    text = str(error).strip()
    return text.splitlines()[0][:160] if text else type(error).__name__


def header_cell(cell: str, file: str) -> str:
    """A header cell on one line. Raises RecordError where it holds characters that cannot be seen,
    with which no channel would be found.
    """
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
    """A header cell without the line breaks that spreadsheets put into it."""
    return " ".join(cell.split())
