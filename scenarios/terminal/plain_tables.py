"""Plain tables and paragraphs for a terminal: columns fold or go where the terminal is narrow, numbers are never cut."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Sequence

WIDTH = 118  # columns where the output is no terminal, and the most that a wide one is used
LEAST = 24  # columns that a folded column of words wants
WORDS = ("parameters", "remarks", "cross-validated?")  # headings of columns of words, at the left wherever they stand
FOLDED = (*WORDS, "candidate", "effect")  # headings of columns that may be folded


def terminal_width() -> int:
    """Columns that a print may use."""
    return min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns - 1) if sys.stdout.isatty() else WIDTH


def wrapped(text: str, width: int = WIDTH, indent: str = "") -> list[str]:
    """A paragraph folded at words; its further lines are moved in."""
    return textwrap.wrap(text, width, initial_indent=indent, subsequent_indent=indent + "  ", break_on_hyphens=False, break_long_words=False)


def table(
    headings: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1, title: str = "", width: int = WIDTH, spare: Sequence[str] = ()
) -> list[str]:
    """Aligned lines no wider than ``width`` if that can be; nothing where there is no row.

    The first ``left`` columns and those of words stand to the left, the others to the right. Where the table is too wide, columns
    ``FOLDED`` are folded; where they would become too narrow, the columns ``spare`` are left out, in their order, and a line says so.
    """
    if not rows:
        return []
    gone: list[str] = []
    heads, cells = list(headings), [list(row) for row in rows]
    while True:
        widths = [max(len(head), *(len(row[i]) for row in cells)) for i, head in enumerate(heads)]
        sizes = _folded(heads, widths, width)
        left_out = next((name for name in spare if name in heads), None)
        if 2 * len(sizes) + sum(sizes) <= width or left_out is None:
            break
        at = heads.index(left_out)
        gone.append(left_out)
        heads, cells = heads[:at] + heads[at + 1 :], [row[:at] + row[at + 1 :] for row in cells]
    lines = [_line(heads, sizes, heads, left)]
    for row in cells:
        parts = [_cell(cell, size) for cell, size in zip(row, sizes, strict=True)]
        lines += [_line(heads, sizes, [part[k] if k < len(part) else "" for part in parts], left) for k in range(max(map(len, parts)))]
    told = wrapped(f"(left out for want of room: {', '.join(gone)}; evidence.csv and report.html of --out have everything)", width, "  ")
    told = told if gone else []
    return [text.rstrip() for text in ([title] if title else []) + lines + told]


def _line(heads: Sequence[str], widths: Sequence[int], cells: Sequence[str], left: int) -> str:
    placed = zip(heads, widths, cells, strict=True)
    return "  " + "  ".join(cell.ljust(size) if i < left or head in WORDS else cell.rjust(size) for i, (head, size, cell) in enumerate(placed))


def _cell(text: str, size: int) -> list[str]:
    if len(text) <= size:
        return [text]
    parts = " ".join(_parts(word, size) for word in text.split(" "))
    return textwrap.wrap(parts, size, break_on_hyphens=False, break_long_words=False)


def _parts(word: str, size: int) -> str:
    """A name too long for its column, parted behind the last colon or hyphen that it has room for."""
    at = max(word.rfind(mark, 0, size) for mark in ":-")
    return word if len(word) <= size or at < 0 else f"{word[: at + 1]} {_parts(word[at + 1 :], size)}"


def _folded(heads: Sequence[str], widths: Sequence[int], width: int) -> list[int]:
    """Widths with which a table fits, its columns of words narrower, the widest first, none below ``LEAST``."""
    sizes = list(widths)
    words = [i for i, head in enumerate(heads) if head in FOLDED]
    while (over := 2 * len(sizes) + sum(sizes) - width) > 0:
        wide = [i for i in words if sizes[i] > LEAST]
        if not wide:
            break
        widest = max(wide, key=lambda i: sizes[i])
        second = max([LEAST, *(sizes[i] for i in wide if i != widest)])
        sizes[widest] = max(LEAST, sizes[widest] - over, second if second < sizes[widest] else sizes[widest] - 1)
    return sizes
