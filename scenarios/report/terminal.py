"""Blocks of a document on a terminal: tables with units and sigmas in columns of their own."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from scenarios.report.document import (
    BY_ROW,
    MISSING,
    PURE,
    SIGMAS,
    Block,
    Bullets,
    Cell,
    Column,
    Number,
    Prose,
    Table,
)
from scenarios.report.quantities import unit_cell
from scenarios.report.text_tables import (
    WIDTH,
    TableColumn,
    print_paragraph,
    print_table,
    table_lines,
)

SIGMA = "+- sigma"
UNIT = "unit"


def show_blocks(out: Console, blocks: Sequence[Block], *, apart: bool = False) -> None:
    """Print tables and sentences, notes moved in; ``apart``: an empty line before each table."""
    for block in blocks:
        match block:
            case Table():
                if apart and block.rows:
                    out.print()
                show_table(out, block)
            case Prose():
                print_paragraph(out, block.text, indent=2 if block.kind == "note" else 0)
            case Bullets():
                for item in block.items:
                    print_paragraph(out, item, indent=0)
            case _:
                pass


def show_table(out: Console, table: Table, keys: int = 1) -> None:
    """Print a table on a console, as wide as that is, its caption bold; nothing where there is no
    row. ``keys``: how many of the first columns begin every block of a table that is too wide.
    """
    print_table(out, table.caption, printed_columns(table), keys)


def table_as_lines(
    table: Table, width: int = WIDTH, keys: int = 1, *, titled: bool = True
) -> list[str]:
    """The same as lines of text, below their caption unless ``titled`` is False."""
    title = table.caption if titled else ""
    return table_lines(printed_columns(table), title=title, width=width, keys=keys)


def printed_columns(table: Table) -> list[TableColumn]:
    """The columns of a table as a terminal shows them: rows' units behind the first column, sigmas
    behind their values.
    """
    out: list[TableColumn] = []
    for at, column in enumerate(table.columns):
        cells = [row[at] for row in table.rows]
        sigmas = [cell.sigma_text if isinstance(cell, Number) else "" for cell in cells]
        apart = any(sigmas) and not column.together
        texts = [cell_text(cell, apart) for cell in cells]
        left = column.left or (column.unit is None and not column.right)
        out.append(TableColumn(heading_text(column), texts, left, column.beside))
        if apart:
            shown = [
                "-" if isinstance(cell, str) and cell else text
                for cell, text in zip(cells, sigmas, strict=True)
            ]
            out.append(TableColumn(SIGMA, shown, beside=True))
        if at == 0 and table.units:
            out.append(TableColumn(UNIT, [unit_cell(unit) for unit in table.units], left=True))
    return out


def heading_text(column: Column) -> str:
    """A heading with the unit of its column."""
    if column.printed:
        return column.printed
    if column.unit in (None, PURE, BY_ROW):
        return column.heading
    return f"{column.heading}, {'sigmas' if column.unit == SIGMAS else column.unit}"


def cell_text(cell: Cell, apart: bool = False) -> str:
    """A cell as a terminal shows it; ``apart``: without its sigma."""
    if isinstance(cell, Number):
        return cell.value_text if apart else cell.plain
    return "-" if cell == MISSING else cell if isinstance(cell, str) else cell.text
