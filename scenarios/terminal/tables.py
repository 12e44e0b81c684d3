"""Tables, the one way in which every command prints them: at any width every number is whole, and nothing is left out.

Where a table is too wide, cells of words and then headings are folded; where that is not enough, the columns that are left over follow in
further blocks, each begun by the columns that say which row it is.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scenarios.terminal.listening import Told, heard_of
from scenarios.terminal.paragraphs import WIDTH, folded, print_lines, wrapped

if TYPE_CHECKING:
    from rich.console import Console

INDENT = "  "
GAP = "  "  # between columns
LEAST = 24  # characters below which a column of words is not folded
_PARTS = re.compile(r"(?<=[A-Za-z][:-])(?=[A-Za-z])")  # where a long name may be parted: never within a number


@dataclass(frozen=True)
class Column:
    """A heading and its cells, all of the same length within a table.

    Numbers stand at the right. ``left``: words, which stand at the left and may be folded. ``beside``: in the same block as the column before
    it, which its heading does not make sense without.
    """

    heading: str
    cells: Sequence[str]
    left: bool = False
    beside: bool = False


def columns_of(headings: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1, words: Sequence[str] = ()) -> list[Column]:
    """Columns of a table that is given by rows: the first ``left`` and those headed by ``words`` stand at the left."""
    return [Column(head, [row[i] for row in rows], left=i < left or head in words) for i, head in enumerate(headings)]


def table_lines(columns: Sequence[Column], *, title: str = "", width: int = WIDTH, keys: int = 1) -> list[str]:
    """A table as lines no longer than ``width`` characters if that can be; nothing where there is no row.

    ``keys``: how many of the first columns begin every block.
    """
    if not columns or not columns[0].cells:
        return []
    lines = wrapped(title, width) if title else []
    for number, block in enumerate(_blocks(columns, width, keys)):
        lines += ([""] if number else []) + _block(block, width)
    return lines


def print_table(out: Console, title: str, columns: Sequence[Column], keys: int = 1) -> None:
    """Print a table on a console, as wide as that is, its title bold."""
    if (heard := heard_of(out)) is not None:
        if columns and columns[0].cells:
            heard.append(Told(title, tuple((column.heading, tuple(column.cells)) for column in columns)))
        return
    lines = table_lines(columns, width=out.width, keys=keys)
    for line in wrapped(title, out.width) if title and lines else ():
        out.print(line, style="bold", highlight=False, markup=False, soft_wrap=True)
    print_lines(out, lines)


def _blocks(columns: Sequence[Column], width: int, keys: int) -> list[list[Column]]:
    """Columns of each block: as many as fit when they are folded as far as they may be."""
    first, groups = list(columns[:keys]), list[list[Column]]()
    for column in columns[keys:]:
        if column.beside and groups:
            groups[-1].append(column)
        else:
            groups.append([column])
    blocks = [list(first)]
    for group in groups:
        if len(blocks[-1]) > keys and _total([_least(each) for each in (*blocks[-1], *group)]) > width:
            blocks.append(list(first))
        blocks[-1] += group
    return blocks


def _block(columns: Sequence[Column], width: int) -> list[str]:
    sizes = _sizes(columns, width)
    heads = [folded(column.heading, size) for column, size in zip(columns, sizes, strict=True)]
    deepest = max(map(len, heads))
    lines = [_line(columns, sizes, [("",) * (deepest - len(head)) + tuple(head) for head in heads], k) for k in range(deepest)]
    lines.append(INDENT + GAP.join("-" * size for size in sizes))
    for cells in zip(*(column.cells for column in columns), strict=True):
        parts = [_cell(cell, size) if column.left else [cell] for column, cell, size in zip(columns, cells, sizes, strict=True)]
        lines += [_line(columns, sizes, parts, k) for k in range(max(map(len, parts)))]
    return lines


def _line(columns: Sequence[Column], sizes: Sequence[int], parts: Sequence[Sequence[str]], k: int) -> str:
    shown = [part[k] if k < len(part) else "" for part in parts]
    placed = zip(columns, shown, sizes, strict=True)
    return (INDENT + GAP.join(text.ljust(size) if column.left else text.rjust(size) for column, text, size in placed)).rstrip()


def _sizes(columns: Sequence[Column], width: int) -> list[int]:
    """Widths with which the columns fit: words folded first, then headings, the widest first, none below its least."""
    sizes = [max(len(text) for text in (column.heading, *column.cells)) for column in columns]
    least = [_least(column) for column in columns]
    headed = [max(small, len(column.heading)) for small, column in zip(least, columns, strict=True)]
    for floors in (headed, least):
        while (over := _total(sizes) - width) > 0:
            wide = [i for i, floor in enumerate(floors) if sizes[i] > floor]
            if not wide:
                break
            widest = max(wide, key=lambda i: sizes[i])
            second = max((sizes[i] for i in wide if i != widest), default=0)
            sizes[widest] = max(floors[widest], sizes[widest] - over, min(second, sizes[widest] - 1))
    return sizes


def _total(sizes: Sequence[int]) -> int:
    return len(INDENT) + sum(sizes) + len(GAP) * (len(sizes) - 1)


def _least(column: Column) -> int:
    """The narrowest that a column can be: no word of its heading is parted, no number, and of words only what is longer than ``LEAST``."""
    heading = _widest_word(column.heading)
    if not column.left:
        return max(heading, *map(len, column.cells))
    natural = max(map(len, column.cells))
    unbroken = max(len(part) for cell in column.cells for word in folded(cell, 1) for part in _PARTS.split(word))
    return max(heading, unbroken, min(LEAST, natural))


def _widest_word(heading: str) -> int:
    return max(map(len, folded(heading, 1)), default=0)


def _cell(text: str, size: int) -> list[str]:
    """A cell of words on as many lines as it takes; a name too long for its column is parted behind a colon or a hyphen."""
    if len(text) <= size:
        return [text]
    words = [_parted(word, size) if len(word) > size else word for word in text.split(" ")]
    return folded(" ".join(words), size)


def _parted(word: str, size: int) -> str:
    lines = [""]
    for part in _PARTS.split(word):
        if lines[-1] and len(lines[-1]) + len(part) > size:
            lines.append("")
        lines[-1] += part
    return " ".join(lines)
