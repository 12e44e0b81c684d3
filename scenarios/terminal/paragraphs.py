"""Paragraphs that fit a terminal: folded between words, a quantity with its sigma and unit never torn."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from scenarios.terminal.listening import heard_of

if TYPE_CHECKING:
    from rich.console import Console

WIDTH = 118  # columns where the output is no terminal, and the most that a wide one is used
TEXT_WIDTH = 100  # of a paragraph; longer lines are hard to read
_FIXED = "\N{NO-BREAK SPACE}"
_JOINED = re.compile(  # blanks that hold a quantity together: before a sigma, a unit, behind a comparison
    r" (?=(?:\+-|[<>=]) [\d.-])|(?<=\+-|[ (][<>=]) (?=[\d.-])|(?<=\d) (?=(?:deg|rad|s|ms|Hz|m|g|kg|N|Pa|%)(?![A-Za-z]))"
)


def terminal_width() -> int:
    """Columns that a print may use."""
    return min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns - 1) if sys.stdout.isatty() else WIDTH


def folded(text: str, width: int, first: str = "", further: str = "") -> list[str]:
    """A text on lines of ``width`` characters; what is longer than a line and cannot be folded stands on one of its own, whole."""
    lines = textwrap.wrap(
        _JOINED.sub(_FIXED, text), max(width, 1), initial_indent=first, subsequent_indent=further, break_on_hyphens=False, break_long_words=False
    )
    return [line.replace(_FIXED, " ") for line in lines] or [first]


def wrapped(text: str, width: int = WIDTH, indent: str = "") -> list[str]:
    """A paragraph folded at words; its further lines are moved in. Nothing where there is no text."""
    return folded(text, width, indent, indent + "  ") if text else []


def shortened(text: str, width: int, label: str = "") -> str:
    """One line of ``width`` characters behind ``label``, with dots for what has no room: whole clauses if they fill most of it, else whole words."""
    limit = max(width - len(label), 1)
    clause = text.rfind("; ", 0, limit - 3)
    if len(text) > limit and clause > 0.75 * limit:
        return f"{label}{text[:clause]}; ..."
    words = _JOINED.sub(_FIXED, text)
    first = words.split(" ")[0]
    if len(first) > limit:  # a path is no use without its end
        return label + first.replace(_FIXED, " ")
    lines = textwrap.wrap(words, limit, break_on_hyphens=False, break_long_words=False, max_lines=1, placeholder=" ...")
    return label + (lines[0] if lines else "").replace(_FIXED, " ")


def print_lines(out: Console, lines: Sequence[str]) -> None:
    """Print lines as they stand."""
    for line in lines:
        out.print(line, highlight=False, markup=False, soft_wrap=True)


def print_paragraph(out: Console, text: str, indent: int = 2) -> None:
    """Print a text folded at words, within the console and ``TEXT_WIDTH``, moved in by ``indent`` columns."""
    if (heard := heard_of(out)) is not None:
        heard.append(text)
        return
    margin = " " * indent
    print_lines(out, folded(text, min(out.width - 1, TEXT_WIDTH), margin, margin))
