"""Where the header of a table is, and whether a row of units follows it: the same for text files
and spreadsheets.
"""

from __future__ import annotations

from collections.abc import Sequence

from scenarios.files.channel_names import CHANNEL_UNITS, is_clock, split_header
from scenarios.files.formats.cells import MISSING, one_line, plain_number
from scenarios.files.units import is_unit

MOST_HEADS = 5  # rows of names, remarks and units above the numbers, and one of numbers
LOOKED_AT = 200  # rows in which the header is looked for


def header_row(rows: Sequence[Sequence[str]]) -> int | None:
    """Index of the header: the last row of names that is as wide as the first rows of numbers below
    it, or None.

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
    """The row under the header as units: no cell of it is a number but a ``1``, and at least one is
    a known unit. Else nothing.
    """
    if len(under) != len(header):
        return ()
    cells = [without_brackets(cell) for cell in under]
    said = [cell for cell in cells if cell.lower() not in (*MISSING, "1", "-")]
    if any(is_number(cell) for cell in said) or not any(is_unit(cell) for cell in said):
        return ()
    return tuple("" if cell == "-" else cell for cell in cells)


def heads(rows: Sequence[Sequence[str]]) -> tuple[int, int | None, int]:
    """Which of the first rows names the columns, which one has their units, if any, and how many
    rows these are.

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
    known = [
        sum(is_known(cell) for cell in cells) if n != at else -1 for n, cells in enumerate(above)
    ]
    return max(range(count), key=lambda n: known[n]), at, count


def is_known(cell: str) -> bool:
    """Whether a header cell, without its unit, is the name of a clock or of a channel."""
    name = split_header(one_line(cell))[0]
    return is_clock(name) or name.lower() in CHANNEL_UNITS


def without_brackets(cell: str) -> str:
    """A unit without the brackets around it."""
    text = one_line(cell)
    return text[1:-1].strip() if text[:1] + text[-1:] in ("[]", "()") else text


def has_number(cells: Sequence[str]) -> bool:
    """Whether a cell of the row is a number other than a lone ``1``, which a row of units may
    hold.
    """
    return any(is_number(cell) and cell.strip() != "1" for cell in cells)


def is_number(cell: str) -> bool:
    """Whether a cell is a number with a decimal point or a decimal comma."""
    for comma in (False, True):
        try:
            plain_number(cell.strip(), comma=comma)
        except ValueError:
            continue
        return True
    return False


def _width(cells: Sequence[str]) -> int:
    return max((index + 1 for index, cell in enumerate(cells) if cell.strip()), default=0)
