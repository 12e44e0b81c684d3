"""Cells of the lines of a stream, which commas, semicolons or tabs separate."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence

from scenarios.files.formats.cells import (
    MISSING,
    certain_comma,
    header_cell,
    is_number,
    number_of_text,
)
from scenarios.files.sources import LARGEST_NUMBER
from sim.errors import RecordError

COMMA = ","
OTHER_SEPARATORS = (";", "\t")


def is_row(line: bytes, name: str) -> bool:
    """Return whether a line has only numbers, and is not a header. Raises as ``header_cells``."""
    return all(is_number(cell) or not cell.strip() for cell in header_cells(line, name))


def separator_of(line: bytes) -> str:
    """Return the separator of the cells of a stream's first line: a comma, a semicolon or a tab.

    It is the separator that gives most cells. In a first row of numbers commas may be decimal
    marks: a semicolon or a tab that leaves only numbers then comes first.
    """
    text = line.decode("utf-8-sig", errors="replace").strip("\r\n")
    cells = {separator: _split(text, separator) for separator in (COMMA, *OTHER_SEPARATORS)}
    for separator in OTHER_SEPARATORS:
        if len(cells[separator]) > 1 and all(
            is_number(cell) or not cell.strip() for cell in cells[separator]
        ):
            return separator
    return max(cells, key=lambda separator: len(cells[separator]))


def _split(text: str, separator: str) -> list[str]:
    """Return the cells of a line; none if it is no CSV."""
    try:
        return next(csv.reader([text], delimiter=separator), [])
    except csv.Error:
        return []


def header_cells(line: bytes, name: str) -> list[str]:
    """Return the cells of a stream's first line. Raises RecordError if it is not CSV in UTF-8."""
    remedy = "stream text in UTF-8 with commas, semicolons or tabs between the columns"
    try:
        text = line.decode("utf-8-sig")
        return [
            header_cell(cell, name)
            for cell in next(csv.reader([text], delimiter=separator_of(line)), [])
        ]
    except UnicodeDecodeError:
        raise RecordError("not UTF-8 text", where=f"{name}, row 1", remedy=remedy) from None
    except csv.Error as error:
        what = f"not text of separated columns ({error})"
        raise RecordError(what, where=f"{name}, row 1", remedy=remedy) from None


def plain_numbers(
    line: bytes, places: Sequence[int], width: int, separator: str = COMMA
) -> list[float] | None:
    """Return the numbers of a line that has only numbers with decimal points; None for any other.

    Nearly all lines are of this kind, for which this function is three times as fast as
    ``numbers_of``. Parameters as there.
    """
    cells = line.split(separator.encode())
    if len(cells) != width or b'"' in line or b"_" in line or not line.isascii():
        return None
    try:
        numbers = [float(cells[place]) for place in places]
    except ValueError:
        return None
    return numbers if max(numbers) <= LARGEST_NUMBER and min(numbers) >= -LARGEST_NUMBER else None


def numbers_of(
    line: bytes, places: Sequence[int], width: int, separator: str = COMMA
) -> list[float]:
    """Return the numbers of a line, NaN for an empty cell; no numbers for an empty line.

    If the separator is no comma, numbers have decimal commas if one of the commas cannot separate
    thousands. Raises ValueError for any other cell.

    Parameters
    ----------
    places : indices of the cells that are read.
    width : number of cells that the line must have.
    """
    if not line.strip():
        return []
    text = line.decode("ascii").strip("\r\n")
    cells = _split(text, separator) if '"' in text else text.split(separator)
    if len(cells) != width:
        raise ValueError(f"{len(cells)} cells under a header of {width}")
    texts = [cells[place].strip() for place in places]
    comma = separator != COMMA and any(map(certain_comma, texts))
    return [_number(text, comma=comma) for text in texts]


def _number(text: str, *, comma: bool) -> float:
    """Return the number in a cell, NaN for a missing value. Raises ValueError with the reason."""
    shown = repr(text if len(text) <= 40 else text[:37] + "...")
    if comma and "." in text and is_number(text):
        raise ValueError(f"{shown} has a point among decimal commas")
    if not comma and "," in text and is_number(text):
        raise ValueError(f"{shown} may be a decimal number or one with its thousands parted")
    if text.lower() in MISSING:
        return math.nan
    try:
        value = number_of_text(text, comma=comma)
    except ValueError:
        raise ValueError(f"{shown} is not a number") from None
    if abs(value) > LARGEST_NUMBER:
        raise ValueError(f"{shown} is no measurement")
    return value
