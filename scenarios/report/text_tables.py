"""Tables and paragraphs that fit a terminal.

Where a table is too wide, cells of words and then headings are folded; where that is not enough,
the columns that are left over follow in further blocks, each begun by the columns that say which
row it is.
"""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console


# ---- Paragraphs that fit a terminal

WIDTH = 118  # columns where the output is no terminal, and the most that a wide one is used
TEXT_WIDTH = 100  # of a paragraph; longer lines are hard to read
_FIXED = "\N{NO-BREAK SPACE}"
# blanks that hold a quantity together: before a sigma, a unit, behind a comparison
_JOINED = re.compile(
    r" (?=(?:\+-|[<>=]) [\d.-])|(?<=\+-|[ (][<>=]) (?=[\d.-])|(?<=\d) "
    r"(?=(?:deg|rad|s|ms|Hz|m|g|kg|N|Pa|%)(?![A-Za-z]))"
)


def terminal_width() -> int:
    """Columns that a print may use."""
    return (
        min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns - 1)
        if sys.stdout.isatty()
        else WIDTH
    )


def folded(text: str, width: int, first: str = "", further: str = "") -> list[str]:
    """A text on lines of ``width`` characters; what is longer than a line and cannot be folded
    stands on one of its own, whole.
    """
    lines = textwrap.wrap(
        _JOINED.sub(_FIXED, text),
        max(width, 1),
        initial_indent=first,
        subsequent_indent=further,
        break_on_hyphens=False,
        break_long_words=False,
    )
    return [line.replace(_FIXED, " ") for line in lines] or [first]


def wrapped(text: str, width: int = WIDTH, indent: str = "") -> list[str]:
    """A paragraph folded at words; its further lines are moved in. Nothing where there is no
    text.
    """
    return folded(text, width, indent, indent + "  ") if text else []


def shortened(text: str, width: int, label: str = "") -> str:
    """One line of ``width`` characters behind ``label``, with dots for what has no room: whole
    clauses if they fill most of it, else whole words.
    """
    limit = max(width - len(label), 1)
    clause = text.rfind("; ", 0, limit - 3)
    if len(text) > limit and clause > 0.75 * limit:
        return f"{label}{text[:clause]}; ..."
    words = _JOINED.sub(_FIXED, text)
    first = words.split(" ")[0]
    if len(first) > limit:  # a path is no use without its end
        return label + first.replace(_FIXED, " ")
    lines = textwrap.wrap(
        words,
        limit,
        break_on_hyphens=False,
        break_long_words=False,
        max_lines=1,
        placeholder=" ...",
    )
    return label + (lines[0] if lines else "").replace(_FIXED, " ")


def print_lines(out: Console, lines: Sequence[str]) -> None:
    """Print lines as they stand."""
    for line in lines:
        out.print(line, highlight=False, markup=False, soft_wrap=True)


def print_paragraph(out: Console, text: str, indent: int = 2) -> None:
    """Print a text folded at words, within the console and ``TEXT_WIDTH``, moved in by ``indent``
    columns.
    """
    margin = " " * indent
    print_lines(out, folded(text, min(out.width - 1, TEXT_WIDTH), margin, margin))


NEXT = "; next: "  # before the command that a caution leads to


def print_caution(out: Console, text: str) -> None:
    """Print a sentence folded at words, and the command behind ``NEXT`` on one line, to copy."""
    told, found, command = text.partition(NEXT)
    print_paragraph(out, f"{told}; next:" if found else told, 0)
    if found:
        print_lines(out, [f"  {command}"])


# ---- Tables

INDENT = "  "
GAP = "  "  # between columns
LEAST = 24  # characters below which a column of words is not folded
# where a long name may be parted: never within a number
_PARTS = re.compile(r"(?<=[A-Za-z][:-])(?=[A-Za-z])")


@dataclass(frozen=True)
class TableColumn:
    """A heading and its cells, all of the same length within a table.

    Numbers stand at the right. ``left``: words, which stand at the left and may be folded.
    ``beside``: in the same block as the column before it, which its heading does not make sense
    without.
    """

    heading: str
    cells: Sequence[str]
    left: bool = False
    beside: bool = False


def columns_of(
    headings: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1, words: Sequence[str] = ()
) -> list[TableColumn]:
    """Columns of a table that is given by rows: the first ``left`` and those headed by ``words``
    stand at the left.
    """
    return [
        TableColumn(head, [row[i] for row in rows], left=i < left or head in words)
        for i, head in enumerate(headings)
    ]


def table_lines(
    columns: Sequence[TableColumn], *, title: str = "", width: int = WIDTH, keys: int = 1
) -> list[str]:
    """A table as lines no longer than ``width`` characters if that can be; nothing where there is
    no row.

    ``keys``: how many of the first columns begin every block.
    """
    if not columns or not columns[0].cells:
        return []
    lines = wrapped(title, width) if title else []
    for number, block in enumerate(_blocks(columns, width, keys)):
        lines += ([""] if number else []) + _block(block, width)
    return lines


def print_table(out: Console, title: str, columns: Sequence[TableColumn], keys: int = 1) -> None:
    """Print a table on a console, as wide as that is, its title bold."""
    lines = table_lines(columns, width=out.width, keys=keys)
    for line in wrapped(title, out.width) if title and lines else ():
        out.print(line, style="bold", highlight=False, markup=False, soft_wrap=True)
    print_lines(out, lines)


def _blocks(columns: Sequence[TableColumn], width: int, keys: int) -> list[list[TableColumn]]:
    """Columns of each block: as many as fit when they are folded as far as they may be."""
    first, groups = list(columns[:keys]), list[list[TableColumn]]()
    for column in columns[keys:]:
        if column.beside and groups:
            groups[-1].append(column)
        else:
            groups.append([column])
    blocks = [list(first)]
    for group in groups:
        if (
            len(blocks[-1]) > keys
            and _total([_least(each) for each in (*blocks[-1], *group)]) > width
        ):
            blocks.append(list(first))
        blocks[-1] += group
    return blocks


def _block(columns: Sequence[TableColumn], width: int) -> list[str]:
    sizes = _sizes(columns, width)
    heads = [folded(column.heading, size) for column, size in zip(columns, sizes, strict=True)]
    deepest = max(map(len, heads))
    lines = [
        _line(columns, sizes, [("",) * (deepest - len(head)) + tuple(head) for head in heads], k)
        for k in range(deepest)
    ]
    lines.append(INDENT + GAP.join("-" * size for size in sizes))
    for cells in zip(*(column.cells for column in columns), strict=True):
        parts = [
            _cell(cell, size) if column.left else [cell]
            for column, cell, size in zip(columns, cells, sizes, strict=True)
        ]
        lines += [_line(columns, sizes, parts, k) for k in range(max(map(len, parts)))]
    return lines


def _line(
    columns: Sequence[TableColumn], sizes: Sequence[int], parts: Sequence[Sequence[str]], k: int
) -> str:
    shown = [part[k] if k < len(part) else "" for part in parts]
    placed = zip(columns, shown, sizes, strict=True)
    return (
        INDENT
        + GAP.join(
            text.ljust(size) if column.left else text.rjust(size) for column, text, size in placed
        )
    ).rstrip()


def _sizes(columns: Sequence[TableColumn], width: int) -> list[int]:
    """Widths with which the columns fit: words folded first, then headings, the widest first, none
    below its least.
    """
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
            sizes[widest] = max(
                floors[widest], sizes[widest] - over, min(second, sizes[widest] - 1)
            )
    return sizes


def _total(sizes: Sequence[int]) -> int:
    return len(INDENT) + sum(sizes) + len(GAP) * (len(sizes) - 1)


def _least(column: TableColumn) -> int:
    """The narrowest that a column can be: no word of its heading is parted, no number, and of words
    only what is longer than ``LEAST``.
    """
    heading = _widest_word(column.heading)
    if not column.left:
        return max(heading, *map(len, column.cells))
    natural = max(map(len, column.cells))
    unbroken = max(
        len(part)
        for cell in column.cells
        for word in folded(cell, 1)
        for part in _PARTS.split(word)
    )
    return max(heading, unbroken, min(LEAST, natural))


def _widest_word(heading: str) -> int:
    return max(map(len, folded(heading, 1)), default=0)


def _cell(text: str, size: int) -> list[str]:
    """A cell of words on as many lines as it takes; a name too long for its column is parted behind
    a colon or a hyphen.
    """
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
