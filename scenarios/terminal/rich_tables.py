"""Tables and paragraphs that fit a terminal: a number is never cut short, a text never runs past the edge."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

TEXT_WIDTH = 100  # columns; longer lines are hard to read
_UNBOUNDED = 10_000


@dataclass(frozen=True)
class Column:
    """A heading and its cells, all of the same length within a table; numbers stand at the right."""

    heading: str
    cells: Sequence[str]
    left: bool = False


def print_table(out: Console, title: str, columns: Sequence[Column], further: Sequence[Column] = ()) -> None:
    """Print ``columns`` and ``further`` as one table; in a narrow terminal without frame, then as two with the first column in both."""
    for framed in (True, False):
        table = _table([*columns, *further], title, framed)
        if Measurement.get(out, out.options.update(max_width=_UNBOUNDED), table).maximum <= out.width or not (further or framed):
            out.print(table)
            return
    out.print(_table(columns, title, framed=False))
    out.print(_table([columns[0], *further], "", framed=False))


def print_paragraph(out: Console, text: str, indent: int = 2) -> None:
    """Print a text folded at words, within the terminal and ``TEXT_WIDTH``, moved in by ``indent`` columns."""
    margin = " " * indent
    for line in textwrap.wrap(text, min(out.width - 1, TEXT_WIDTH), initial_indent=margin, subsequent_indent=margin, break_on_hyphens=False):
        out.print(line, highlight=False, markup=False, soft_wrap=True)


def _table(columns: Sequence[Column], title: str, framed: bool) -> Table:
    table = Table(
        title=Text(title) if title else None,
        title_justify="left",
        title_style="bold",
        box=box.HEAVY_HEAD if framed else box.SIMPLE_HEAD,
        padding=(0, 1) if framed else 0,
    )
    for column in columns:
        heading = column.heading if framed else column.heading.replace(", ", ",\n").replace("off,\nown ", "off, own\n")
        table.add_column(Text(heading), justify="left" if column.left else "right", no_wrap=True)
    for cells in zip(*(column.cells for column in columns), strict=True):
        table.add_row(*(Text(cell) for cell in cells))
    return table
