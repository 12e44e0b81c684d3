"""What a command prints, as blocks of a page: numbers become numbers again, with the unit that their heading or their row gives them."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING

from scenarios.pages.model import BY_ROW, Block, Column, Prose, Table
from scenarios.pages.numbers import PURE, Cell, Number, read_cell, signs
from scenarios.pages.wording import capital, sentence
from scenarios.terminal.listening import Told, listened
from scenarios.terminal.tables import Column as Printed

if TYPE_CHECKING:
    from rich.console import Console

SIGMA = ("+- sigma", "± sigma")  # headings of a column that belongs to the number before it
UNIT = "unit"
SIGMAS = "σ"
_BEHIND = re.compile(r", (?P<unit>sigmas|s|Hz|deg|rad|%|dB|m|m/s|rad/s)$")  # what stands behind the words of a heading


def printed_blocks(show: Callable[[Console], object], units: Mapping[str, str] = MappingProxyType({})) -> list[Block]:
    """The tables and sentences that ``show`` prints on a console; ``units`` as in ``told_table``."""
    return [Prose(sentence(each)) if isinstance(each, str) else told_table(each, units) for each in listened(show)]


def told_table(told: Told, known: Mapping[str, str] = MappingProxyType({})) -> Table:
    """A printed table; a column of sigmas joins the numbers before it, a column of units becomes that of the rows.

    ``known`` are units by what stands at the head of a column, or at the begin of a row where the table has no units.
    """
    count = len(told.columns[0][1])
    known = {} if "correlation" in told.title else known  # which has no unit, whatever it is of
    units: tuple[str, ...] = next((cells for heading, cells in told.columns if heading == UNIT), ())
    if not units and any(name in known for name in told.columns[0][1]):
        units = tuple(known.get(name, PURE) for name in told.columns[0][1])
    headings: list[str] = []
    columns: list[list[Cell]] = []
    for heading, cells in told.columns:
        if heading == UNIT:
            continue
        read = [read_cell(cell) for cell in cells]
        if heading in SIGMA and columns and not any(isinstance(cell, Number) and cell.sigma for cell in columns[-1]):
            columns[-1] = [_with_sigma(cell, sigma) for cell, sigma in zip(columns[-1], read, strict=True)]
            continue
        headings.append(heading or ("remark" if headings else "name"))
        columns.append(read)
    rows = tuple(tuple(column[at] for column in columns) for at in range(count))
    made = tuple(_column(heading, column, known.get(heading, BY_ROW if units else PURE)) for heading, column in zip(headings, columns, strict=True))
    return Table(capital(told.title), made, rows, tuple(unit or PURE for unit in units))


def rows_table(
    caption: str,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    printed: int | None = None,
    units: Mapping[str, str] = MappingProxyType({}),
) -> Table:
    """A table of which there are texts by row; ``printed`` as in ``Table``, ``units`` as in ``told_table``."""
    cells = tuple(tuple(row[at] for row in rows) for at in range(len(headings)))
    made = told_table(Told(caption, tuple(zip(headings, cells, strict=True))), units) if rows else Table(caption, tuple(map(Column, headings)), ())
    return Table(caption, made.columns, made.rows, made.units, printed)


def columns_table(caption: str, columns: Sequence[Printed], units: Mapping[str, str] = MappingProxyType({})) -> Table:
    """A table of which there are the columns that a terminal prints."""
    return told_table(Told(caption, tuple((column.heading, tuple(column.cells)) for column in columns)), units)


def _with_sigma(cell: Cell, sigma: Cell) -> Cell:
    if not isinstance(cell, Number) or not isinstance(sigma, Number):
        return cell
    return Number(cell.value, sigma.value, cell.unit, shown=signs(f"{cell.shown} ± {sigma.shown}"))


def _column(heading: str, cells: Sequence[Cell], usual: str) -> Column:
    numbers = [cell for cell in cells if isinstance(cell, Number)]
    if not numbers:
        return Column(heading)
    behind = _BEHIND.search(heading)
    if behind is not None:
        return Column(heading[: behind.start()], SIGMAS if behind["unit"] == "sigmas" else behind["unit"])
    if heading.endswith(" %"):
        return Column(heading.removesuffix(" %"), "%")
    return Column(heading, PURE if all(cell.unit for cell in numbers) else usual)
